"""Zeroth order of a height field: the reflection of its mean plane, which tables hold apart from all other orders.

Its lobe is narrower than the distance of a table's nodes, and has a closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence

# Limit: steps of the height; phases have an error of 1e-4.
_HEIGHTS = 65_536


@dataclass(frozen=True, eq=False)
class ZerothOrder:
    """Power of the zeroth order over |κ|, and the lobe that a coherence makes of it.

    Attributes:
        power: |H₀₀|² at equal steps of |κ|, linear in between, shape (entries,), float32. It is empty for amplitudes,
            of which that of the mean plane cannot be separated.
        least_kappa: |κ| of the first entry [1/µm].
        largest_kappa: |κ| of the last entry [1/µm].
        coherence: Coherence that limits the lobe.
    """

    power: NDArray[np.float32]
    least_kappa: float
    largest_kappa: float
    coherence: Coherence

    @classmethod
    def of_heights(
        cls, heightfield: HeightField, coherence: Coherence, kappas: tuple[float, float], entries: int
    ) -> ZerothOrder:
        """The zeroth order over a range of |κ|, from how often heights occur."""
        import scipy.signal

        heights = heightfield.heights_um - heightfield.heights_um.min()
        span = float(heights.max())
        if span == 0.0:
            return cls(np.ones(entries, dtype=np.float32), *kappas, coherence)
        per_um = (_HEIGHTS - 1) / span
        counts = np.bincount(np.rint(heights.ravel() * per_um).astype(np.int64), minlength=_HEIGHTS)
        means = scipy.signal.zoom_fft(counts / heights.size, kappas, entries, fs=per_um, endpoint=True)
        return cls(np.asarray(np.abs(means) ** 2, dtype=np.float32), *kappas, coherence)

    def at(self, kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """The power at some |κ| of the range, in the peak of the lobe, shape (n,)."""
        shares = (kappas - self.least_kappa) / (self.largest_kappa - self.least_kappa)
        return between_entries(self.power[:, None], shares)[:, 0]

    def lobe_variance(self, wavelength_um: float) -> float:
        """Variance of the lobe in (u, v) along each axis, at a wavelength [µm]; of a source, under light from above."""
        if self.coherence.sigma_um is None:
            return self.coherence.spread**2
        per_window = 8.0 if self.coherence.adds_powers else 4.0
        return wavelength_um**2 / (per_window * (math.pi * self.coherence.sigma_um) ** 2)


def between_entries(entries: NDArray[Any], shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows between entries (n, m) at equal steps, at shares of the whole range from 0 to 1, linear."""
    at = shares * (len(entries) - 1)
    first = np.clip(at.astype(np.int64), 0, len(entries) - 2)
    t = (at - first)[:, None]
    return np.asarray((1.0 - t) * entries[first] + t * entries[first + 1])
