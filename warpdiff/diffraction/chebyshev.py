"""Polynomial interpolation at Chebyshev nodes, and cubic interpolation between equally spaced values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def nodes(low: float, high: float, count: int) -> NDArray[np.float64]:
    """Return the Chebyshev nodes in the range ``low`` to ``high``, in descending order."""
    return np.asarray((low + high) / 2.0 + (high - low) / 2.0 * np.cos(_angles(count)))


def terms(count: int) -> NDArray[np.float64]:
    """Return the polynomials T_n at ``count`` Chebyshev nodes: a matrix with a row per n and a column per node."""
    return np.asarray(np.cos(np.outer(np.arange(count), _angles(count))))


def to_series(count: int) -> NDArray[np.float64]:
    """Return the matrix that converts values at Chebyshev nodes to coefficients of the polynomials T_n.

    The matrix has one row per node.
    """
    result = terms(count).T * (2.0 / count)
    result[:, 0] /= 2.0
    return result


def cardinals(at: NDArray[np.float64], low: float, high: float, count: int) -> NDArray[np.float64]:
    """Return the cardinal polynomials at ``at``: each polynomial is 1 at one Chebyshev node and 0 at all other nodes.

    To interpolate values at the nodes, multiply each cardinal polynomial by the value at its node, and add the
    products. The result has the shape (len(at), count).
    """
    position = np.clip((at - (low + high) / 2.0) / ((high - low) / 2.0 or 1.0), -1.0, 1.0)
    series = np.cos(np.arccos(position)[:, None] * np.arange(count))
    return np.asarray(series @ to_series(count).T)


def cubic_weights(t: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the weights of the values at −1, 0, 1 and 2 for cubic interpolation at t, from 0 to 1."""
    before, after, beyond = t + 1.0, 1.0 - t, 2.0 - t
    return [
        -t * after * beyond / 6.0, before * after * beyond / 2.0, before * t * beyond / 2.0, -before * t * after / 6.0
    ]  # fmt: skip


def _angles(count: int) -> NDArray[np.float64]:
    return np.asarray(math.pi * (np.arange(count) + 0.5) / count)
