"""Interpolation: polynomials through values at the roots of a Chebyshev polynomial, and cubics between equal steps."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def nodes(low: float, high: float, count: int) -> NDArray[np.float64]:
    """The roots, from the highest one down."""
    return np.asarray((low + high) / 2.0 + (high - low) / 2.0 * np.cos(_angles(count)))


def terms(count: int) -> NDArray[np.float64]:
    """T_n at the roots, shape (count of n, count of roots)."""
    return np.asarray(np.cos(np.outer(np.arange(count), _angles(count))))


def to_series(count: int) -> NDArray[np.float64]:
    """From values at the roots to the coefficients of T_n, shape (count of roots, count of n)."""
    result = terms(count).T * (2.0 / count)
    result[:, 0] /= 2.0
    return result


def cardinals(at: NDArray[np.float64], low: float, high: float, count: int) -> NDArray[np.float64]:
    """Polynomials that are 1 at one of the roots and 0 at the others, shape (len(at), count)."""
    position = np.clip((at - (low + high) / 2.0) / ((high - low) / 2.0 or 1.0), -1.0, 1.0)
    series = np.cos(np.arccos(position)[:, None] * np.arange(count))
    return np.asarray(series @ to_series(count).T)


def cubic_weights(t: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Weights of the cubic through values at −1, 0, 1 and 2, at places t within 0 to 1."""
    before, after, beyond = t + 1.0, 1.0 - t, 2.0 - t
    return [
        -t * after * beyond / 6.0, before * after * beyond / 2.0, before * t * beyond / 2.0, -before * t * after / 6.0
    ]  # fmt: skip


def _angles(count: int) -> NDArray[np.float64]:
    return np.asarray(math.pi * (np.arange(count) + 0.5) / count)
