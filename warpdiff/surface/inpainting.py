"""Gaps of a grid filled by the harmonic function that meets the samples around them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# The residual left, relative to the first.
_SETTLED = 1e-10


def harmonic(heights: NDArray[np.float64], pitch_um: tuple[float, float]) -> NDArray[np.float64]:
    """Return ``heights`` (ny, nx) with each NaN replaced so that the five-point Laplacian vanishes there.

    No slope crosses the edges of the grid. The equations are solved by conjugate gradients; at least one sample must be
    known.
    """
    gaps = np.isnan(heights)
    result = heights.copy()
    if not gaps.any():
        return result
    known = heights[~gaps]
    # About the mean, so that an offset costs no digits.
    mean = float(np.mean(known))
    number = np.full((gaps.shape[0] + 2, gaps.shape[1] + 2), -1)
    count = int(np.count_nonzero(gaps))
    # Known samples and what lies outside of the grid are number ``count``, whose value is 0.
    number[1:-1, 1:-1] = np.where(gaps, np.cumsum(gaps).reshape(gaps.shape) - 1, count)
    outside = number == -1
    number[outside] = count
    boundary = np.pad(np.where(gaps, 0.0, heights - mean), 1)
    y, x = np.nonzero(gaps)
    diagonal, target = np.zeros(count), np.zeros(count)
    neighbours: list[tuple[float, NDArray[np.int64]]] = []
    for axis, pitch in enumerate(pitch_um):
        weight = (min(pitch_um) / pitch) ** 2
        for step in (-1, 1):
            at = (y + 1 + step, x + 1) if axis == 0 else (y + 1, x + 1 + step)
            neighbours.append((weight, number[at]))
            diagonal += weight * ~outside[at]
            target += weight * boundary[at]

    def laplacian(values: NDArray[np.float64]) -> NDArray[np.float64]:
        padded = np.append(values, 0.0)
        total = diagonal * values
        for weight, at in neighbours:
            total -= weight * padded.take(at)
        return total

    solution = np.zeros(count)
    residual = target
    direction = residual / diagonal
    size = first = float(residual @ direction)
    # In exact arithmetic as many steps as unknowns suffice; some gaps' widths in samples do.
    for _ in range(count):
        if size <= _SETTLED**2 * first:
            break
        image = laplacian(direction)
        step_size = size / float(direction @ image)
        solution += step_size * direction
        residual = residual - step_size * image
        scaled = residual / diagonal
        previous, size = size, float(residual @ scaled)
        direction = scaled + (size / previous) * direction
    result[gaps] = solution + mean
    return result
