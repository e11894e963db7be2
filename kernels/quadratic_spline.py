"""Quadratic B-spline through values at equally spaced nodes: constants and weights for kernels and Python code."""

import math

# Pole of the filter that converts values at nodes to coefficients of the spline through them: the factor by which the
# weights of the filter decrease from node to node. The number was derived from the values of the quadratic B-spline at
# nodes, 1/8, 3/4 and 1/8. With another number, splines would not pass through the values at nodes.
POLE = 2.0 * math.sqrt(2.0) - 3.0


def prefilter(half_taps: int) -> list[float]:
    """Return the weights of a filter that converts values at nodes to coefficients of the spline through the values.

    The weighted sum of the values at 2 ``half_taps`` + 1 consecutive nodes is the coefficient of the middle node.
    """
    return [math.sqrt(2.0) * POLE ** abs(j) for j in range(-half_taps, half_taps + 1)]
