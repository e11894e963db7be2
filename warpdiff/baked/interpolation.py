"""Interpolation of baked lobes: a polar grid over (u, v) with splines around and between its rings.

As λ goes from red to blue, a lobe runs along a ray of (u, v) over one octave: colours change along it as slowly as the
observer's curves do, in ln |(u, v)|, and across it as fast as a lobe is narrow. A Cartesian grid that resolves a lobe
takes ten times as many nodes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# |(u, v)| ends here.
_LARGEST = 2.0
# Rings beyond it, for cubics.
_BEYOND = 1
# Within this share of a lobe's deviation colours do not change.
_FLAT_WITHIN = 0.05
_FEWEST_AZIMUTHS = 16


@dataclass(frozen=True)
class PolarGrid:
    """Rings of nodes, numbered from the innermost ring on, and on each from the u axis on, towards the v axis.

    Attributes:
        rings: Rings an octave of |(u, v)|.
        rays: Nodes on each ring of each octave, from the innermost on.
    """

    rings: int
    azimuths: tuple[int, ...]

    @classmethod
    def for_lobes(cls, width: float, rings: int, azimuths_per_width: float) -> PolarGrid:
        """The grid for lobes of a standard deviation, in (u, v), with so many rays in each of these."""
        octaves = max(math.ceil(math.log2(_LARGEST / (_FLAT_WITHIN * width)) + 2.0 / rings), 1)
        tops = _LARGEST * 2.0 ** (np.arange(octaves) - octaves + 1.0)
        azimuths = np.maximum(4.0 * np.ceil(2.0 * math.pi * tops / width * azimuths_per_width / 4.0), _FEWEST_AZIMUTHS)
        return cls(rings, tuple(azimuths.astype(int).tolist()))

    @property
    def azimuths_of_rings(self) -> NDArray[np.int64]:
        """Nodes on each ring."""
        return np.repeat(self.azimuths, self.rings)

    @property
    def starts(self) -> NDArray[np.int64]:
        """The first node of each ring, and at the end the number of all."""
        return np.concatenate([[0], np.cumsum(self.azimuths_of_rings)])

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.rings * sum(self.azimuths)

    @property
    def ring_of_largest(self) -> int:
        """The ring with |(u, v)| = 2."""
        return self.rings * len(self.azimuths) - 1 - _BEYOND

    def places(self) -> NDArray[np.float64]:
        """(u, v) of all nodes, shape (nodes, 2)."""
        azimuths = self.azimuths_of_rings
        radii = _LARGEST * 2.0 ** ((np.arange(len(azimuths)) - self.ring_of_largest) / self.rings)
        node = np.arange(self.nodes) - np.repeat(self.starts[:-1], azimuths)
        angles = 2.0 * math.pi * node / np.repeat(azimuths, azimuths)
        return np.asarray(np.repeat(radii, azimuths)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1))

    def coefficients(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Coefficients of the periodic cubic B-spline that passes through each ring's values, (nodes, ...)."""
        result = np.empty_like(values)
        for first, azimuths in zip(self.starts[:-1], self.azimuths_of_rings, strict=True):
            spectrum = np.fft.rfft(values[first : first + azimuths], axis=0)
            response = (2.0 + np.cos(2.0 * math.pi * np.arange(len(spectrum)) / azimuths)) / 3.0
            spectrum /= response.reshape(-1, *[1] * (values.ndim - 1))
            result[first : first + azimuths] = np.fft.irfft(spectrum, azimuths, axis=0)
        return result

    def interpolated(self, coefficients: NDArray[np.float32], uv: NDArray[np.float64]) -> NDArray[np.float32]:
        """What lies at (u, v), shape (n, 2): by the splines around four rings, and the cubic through these."""
        u, v = uv.T
        least = 0.5 * _LARGEST * 2.0 ** (-self.ring_of_largest / self.rings)
        ring = np.log2(np.maximum(np.hypot(u, v), least) / _LARGEST) * self.rings + self.ring_of_largest
        ring = np.clip(ring, 1.0, self.ring_of_largest)
        before = np.clip(np.floor(ring), 1, self.ring_of_largest - 1).astype(np.int64)
        turns = np.arctan2(v, u) / (2.0 * math.pi)
        azimuths, starts = self.azimuths_of_rings, self.starts
        result = np.zeros((len(u), *coefficients.shape[1:]), dtype=np.float32)
        shape = (-1, *[1] * (coefficients.ndim - 1))
        ring_weights = lagrange(ring - before)
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


def lagrange(t: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Weights of the cubic through values at −1, 0, 1 and 2, at places t within 0 to 1."""
    before, after, beyond = t + 1.0, 1.0 - t, 2.0 - t
    return [
        -t * after * beyond / 6.0, before * after * beyond / 2.0, before * t * beyond / 2.0, -before * t * after / 6.0
    ]  # fmt: skip


def b_spline(t: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Weights of a cubic B-spline's coefficients at −1, 0, 1 and 2, at places t within 0 to 1."""
    left = 1.0 - t
    return [
        left**3 / 6.0, 2.0 / 3.0 - t**2 + t**3 / 2.0, 2.0 / 3.0 - left**2 + left**3 / 2.0, t**3 / 6.0
    ]  # fmt: skip
