"""Thresholds of kernels and hosts: plain numbers without Warp."""

# Directions closer to the horizon than this (0.00006°) count as below it: the gain grows without bound there.
HORIZON = 1e-6
# Factors of energy are computed down to this cosine, of 88° from the normal; below, they are those there.
LOWEST = 0.0349
# f: errors of what is darker are relative to so much of Y*.
FLOOR = 1e-3
# The share of directions or pixels whose error is to be within the tolerance, and percentile of Y that Y* is at least.
PERCENTILE = 0.99
# And never to nothing: the least normal float32.
TINY = 2.0**-126
