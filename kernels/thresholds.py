"""Thresholds that kernels and hosts share: plain numbers without Warp."""

# Least cosine of a direction above the horizon, 0.00006° from it. Limit: the gain tends to infinity at the horizon.
HORIZON = 1e-6
# Least cosine for which energy factors are computed, 88° from the normal. Limit: smaller cosines have the factors of
# this one. With twice the cosine, all angles beyond 86° would share a factor.
LOWEST = 0.0349
# Floor f of relative errors: errors are relative to at least f · Y*, where Y* is the reference luminance. Choice: with
# twice as much, dark pixels are refined less.
FLOOR = 1e-3
# Share of directions or pixels whose error must be within the tolerance, and percentile of Y that is the least Y*.
# Choice: with a larger share, a few outliers decide about plans.
PERCENTILE = 0.99
# Least number that errors are relative to, for black pictures: the smallest normal float32.
TINY = 2.0**-126
