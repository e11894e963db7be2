"""Thresholds that kernels and Python code share: plain numbers without Warp."""

# Least cosine of the angle between the normal and a direction that counts as above the horizon, 0.00006° from the
# horizon. The value is limited by the geometry factor (gain), which tends to infinity at the horizon.
HORIZON = 1e-6
# Least cosine of the angle from the normal for which factors of the energy normalisation are computed, at 88°.
# Directions with smaller cosines use the factors of this cosine. With twice the cosine, all directions beyond 86° would
# share a factor.
LOWEST = 0.0349
# The error of a colour is divided by the magnitude of the colour, or by a floor if the magnitude is smaller. This
# number is the floor as a share of the reference luminance Y*, about that of the brightest pixels. The value was chosen
# freely: if it is doubled, dark pixels are refined less.
FLOOR = 1e-3
# Share of the directions or pixels that must have an error within the tolerance. The reference luminance Y* is at least
# the percentile of the luminance Y at this share. The value is below 1, so that a few outliers do not determine the
# result. With a larger share, they would.
PERCENTILE = 0.99
# Least floor of relative errors (the smallest divisor of an error), which prevents division by 0 in black pictures. The
# value is the smallest normal float32.
TINY = 2.0**-126
