"""Thresholds that kernels and hosts share: plain numbers without Warp."""

# Least cosine of a direction above the horizon, 0.00006° from it. Limit: the gain tends to infinity at the horizon.
HORIZON = 1e-6
# Least cosine for which factors of the energy normalisation are computed, at 88° from the normal. Limit: directions
# with smaller cosines use the factors of this one. With twice the cosine, all directions beyond 86° would share a
# factor.
LOWEST = 0.0349
# Share of the reference luminance Y* that is the floor f of relative errors: the divisor of an error is at least f.
# Choice: with twice as much, dark pixels are refined less.
FLOOR = 1e-3
# Share of directions or pixels whose error must be within the tolerance. The reference luminance Y* is at least this
# percentile of Y. Choice: with a larger share, a few outliers would determine plans.
PERCENTILE = 0.99
# Least floor of relative errors, which prevents division by 0 in black pictures: the smallest normal float32.
TINY = 2.0**-126
