"""Interpolation of baked lobes: splines along and between the rings of a polar grid over (u, v).

The lobe of a diffraction order is a narrow peak whose distance |(u, v)| from the centre is proportional to λ. The
visible wavelengths spread the lobe along the radius over one octave, so that colours vary slowly along the radius, like
the colour-matching functions. Colours vary fast with the azimuth, within the width of a lobe. A Cartesian grid that
resolves a lobe requires ten times as many nodes (samples).

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.diffraction import chebyshev
from warpdiff.tables.polar_grid import PolarGrid, azimuth_counts

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Largest |(u, v)| of a scattering vector. It occurs if light and view have the same direction along the surface.
_LARGEST = 2.0
# Radius |(u, v)| of the innermost ring (circle) of the polar grid, as a share of the standard deviation of a lobe (the
# peak of a diffraction order). Within this radius, colours are constant.
_FLAT_WITHIN = 0.05


def lobe_grid(rings: int, azimuths: tuple[int, ...]) -> PolarGrid:
    """Return the polar grid of baked lobes over (u, v).

    Args:
        rings: Number of rings (circles) per octave, a doubling of the radius |(u, v)|.
        azimuths: Number of azimuth samples (polar angles) per ring, for each octave.
    """
    return PolarGrid(rings, math.log(_LARGEST) - ring_of_largest(rings, azimuths) * math.log(2.0) / rings, azimuths)


def ring_of_largest(rings: int, azimuths: tuple[int, ...]) -> int:
    """Return the index of the grid's ring |(u, v)| = 2, the largest radius; interpolation also uses the next ring."""
    return rings * len(azimuths) - 2


def grid_for(width: float, rings: int, azimuths_per_width: float) -> PolarGrid:
    """Return the polar grid that resolves lobes (peaks of orders) with a standard deviation of ``width`` in (u, v).

    Along a ring (circle of constant |(u, v)|), the grid has ``azimuths_per_width`` samples per ``width``.
    """
    octaves = max(math.ceil(math.log2(_LARGEST / (_FLAT_WITHIN * width)) + 2.0 / rings), 1)
    tops = _LARGEST * 2.0 ** (np.arange(octaves) - octaves + 1.0)
    return lobe_grid(rings, tuple(azimuth_counts(tops, width, azimuths_per_width).astype(int).tolist()))


def spline_coefficients(grid: PolarGrid, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the coefficients of periodic cubic B-splines through values at the samples (nodes) of each ring (circle).

    Both arrays have the shape (nodes, ...).
    """
    result = np.empty_like(values)
    for first, azimuths in zip(grid.starts[:-1], grid.ring_azimuths, strict=True):
        spectrum = np.fft.rfft(values[first : first + azimuths], axis=0)
        response = (2.0 + np.cos(2.0 * math.pi * np.arange(len(spectrum)) / azimuths)) / 3.0
        spectrum /= response.reshape(-1, *[1] * (values.ndim - 1))
        result[first : first + azimuths] = np.fft.irfft(spectrum, azimuths, axis=0)
    return result


def interpolated(grid: PolarGrid, coefficients: NDArray[np.float32], uv: NDArray[np.float64]) -> NDArray[np.float32]:
    """Interpolate values at points (u, v), shape (n, 2), from the four nearest rings (circles of constant |(u, v)|).

    The interpolation is by splines along the rings, and by cubic polynomials across the rings.
    """
    u, v = uv.T
    last = ring_of_largest(grid.rings, grid.azimuths)
    ring = np.log2(np.maximum(np.hypot(u, v) / _LARGEST, 0.5 * 2.0 ** (-last / grid.rings))) * grid.rings + last
    ring = np.clip(ring, 1.0, last)
    before = np.clip(np.floor(ring), 1, last - 1).astype(np.int64)
    turns = np.arctan2(v, u) / (2.0 * math.pi)
    azimuths, starts = grid.ring_azimuths, grid.starts
    result = np.zeros((len(u), *coefficients.shape[1:]), dtype=np.float32)
    shape = (-1, *[1] * (coefficients.ndim - 1))
    ring_weights = chebyshev.cubic_weights(ring - before)
    for along in range(4):
        at = before - 1 + along
        position = (turns % 1.0) * azimuths[at]
        first = np.floor(position).astype(np.int64)
        azimuth_weights = b_spline(position - first)
        for across in range(4):
            node = starts[at] + (first - 1 + across) % azimuths[at]
            weight = (ring_weights[along] * azimuth_weights[across]).astype(np.float32)
            result += weight.reshape(shape) * coefficients[node]
    return result


def b_spline(t: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the weights of the coefficients at −1, 0, 1 and 2 in the value of a cubic spline at t, 0 to 1."""
    left = 1.0 - t
    return [
        left**3 / 6.0, 2.0 / 3.0 - t**2 + t**3 / 2.0, 2.0 / 3.0 - left**2 + left**3 / 2.0, t**3 / 6.0
    ]  # fmt: skip
