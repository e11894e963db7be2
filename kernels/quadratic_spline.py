"""Quadratic B-spline between equally spaced nodes: plain numbers without Warp, for kernels and hosts."""

import math

# Pole of the recursive filter that converts values into the coefficients of the spline through them. Derived from the
# values of the quadratic B-spline at nodes, 1/8, 3/4 and 1/8. With another pole, splines do not pass through the
# values.
POLE = 2.0 * math.sqrt(2.0) - 3.0


def prefilter(half_taps: int) -> list[float]:
    """Return the weights of 2 ``half_taps`` + 1 neighbouring values; their sum is the middle node's coefficient."""
    return [math.sqrt(2.0) * POLE ** abs(j) for j in range(-half_taps, half_taps + 1)]
