"""Thresholds of kernels and hosts: plain numbers without Warp."""

# Least cosine of a direction above the horizon, at 0.00006° from it. Limit: the gain grows without bound there.
HORIZON = 1e-6
# Least cosine for which energy factors are computed, 88° from the normal. Limit: factors at smaller cosines are those
# at this one; with twice the cosine this concerns angles beyond 86°.
LOWEST = 0.0349
# f: relative errors refer to at least f Y*, so that darker colours have larger relative errors. With twice as much,
# dark pixels are refined less.
FLOOR = 1e-3
# Share of directions or pixels whose error is to be within the tolerance, and percentile of Y that is the least Y*.
PERCENTILE = 0.99
# Least number that errors are relative to: the smallest normal float32.
TINY = 2.0**-126
