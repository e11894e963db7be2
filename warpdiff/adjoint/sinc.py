"""Derivative of sin(y)/y, which integrals of linear phases and interference factors require."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Argument below which a power series replaces the quotient, and its number of terms. Derived: the series has an error
# of 1e-16 at this argument, and the quotient loses at most two digits above it.
_SMALL, _TERMS = 0.8, 8


def sinc_slope(y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivative of sin(y)/y, (cos y − sin(y)/y)/y, without cancellation near 0."""
    is_small = np.abs(y) < _SMALL
    safe = np.where(is_small, 1.0, y)
    series = np.zeros_like(y)
    for n in range(_TERMS, 0, -1):
        series = series * y**2 + (-1.0) ** n * 2.0 * n / math.factorial(2 * n + 1)
    return np.asarray(np.where(is_small, series * y, (np.cos(safe) - np.sin(safe) / safe) / safe))
