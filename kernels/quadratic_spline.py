"""Quadratic B-spline between equally spaced nodes: plain numbers without Warp, for kernels and hosts."""

import math

# Pole of the recursive filter that turns values into the coefficients of the spline through them.
POLE = 2.0 * math.sqrt(2.0) - 3.0


def prefilter(half_taps: int) -> list[float]:
    """Weights, for a coefficient, of the values from ``half_taps`` nodes before to as many behind."""
    return [math.sqrt(2.0) * POLE ** abs(j) for j in range(-half_taps, half_taps + 1)]
