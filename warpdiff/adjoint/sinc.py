"""Derivative of sin(y)/y, which the integrals over linear phases and the interference factors of periods require."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Argument |y| below which a power series with `_TERMS` terms is used instead of the formula for the derivative of
# sin(y)/y, which is a quotient. At this argument, the series has an error of 1e-16. At larger arguments, the quotient
# loses at most two digits.
_SMALL, _TERMS = 0.8, 8


def sinc_slope(y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivative of sin(y)/y, (cos y − sin(y)/y)/y, without cancellation near 0."""
    is_small = np.abs(y) < _SMALL
    safe = np.where(is_small, 1.0, y)
    series = np.zeros_like(y)
    for n in range(_TERMS, 0, -1):
        series = series * y**2 + (-1.0) ** n * 2.0 * n / math.factorial(2 * n + 1)
    return np.asarray(np.where(is_small, series * y, (np.cos(safe) - np.sin(safe) / safe) / safe))
