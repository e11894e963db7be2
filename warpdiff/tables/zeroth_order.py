"""Zeroth order of a height field: the reflection of its mean plane, which colour tables store separately.

The lobe of the zeroth order is narrower than the spacing of a table's rings, so that the rows of a table cannot
represent it. The lobe has a closed form instead.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal, and κ is w/λ. H₀₀ is the mean of exp(2πiκh) over the
heights h.
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

# Number of levels of the histogram of heights h from which the zeroth order is computed. Rounding of heights to levels
# causes an error of the phase 2πκh. With this number, the error is at most about 2.5e-4 rad per µm of height range.
_HEIGHTS = 65_536


@dataclass(frozen=True, eq=False)
class ZerothOrder:
    """Power of the zeroth order as a function of |κ| = |w|/λ, and the width of its lobe.

    Attributes:
        power: Power |H₀₀|² of the Fourier coefficient (0, 0) at equally spaced |κ|, for linear interpolation, shape
            (entries,), float32. The array is empty if amplitudes add, because the zeroth order then interferes with the
            other orders.
        least_kappa: |κ| of the first entry [1/µm].
        largest_kappa: |κ| of the last entry [1/µm].
        coherence: Coherence that determines the width of the lobe.
    """

    power: NDArray[np.float32]
    least_kappa: float
    largest_kappa: float
    coherence: Coherence

    @classmethod
    def of_heights(
        cls, heightfield: HeightField, coherence: Coherence, kappas: tuple[float, float], entries: int
    ) -> ZerothOrder:
        """Return the zeroth order over a range of |κ| = |w|/λ, computed from the histogram of the heights."""
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
        """Return the power at the peak of the zeroth order for |κ| = |w|/λ within the tabulated range, shape (n,)."""
        shares = (kappas - self.least_kappa) / (self.largest_kappa - self.least_kappa)
        return between_entries(self.power[:, None], shares)[:, 0]

    def lobe_variance(self, wavelength_um: float) -> float:
        """Return the variance of the zeroth order's lobe along u or v at a wavelength [µm].

        For a source (light source of finite size), the variance depends on the direction of the light; the result is
        for normal incidence.
        """
        if self.coherence.sigma_um is None:
            return self.coherence.spread**2
        return wavelength_um**2 / (8.0 * (math.pi * self.coherence.sigma_um) ** 2)


def between_entries(entries: NDArray[Any], shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate linearly between equally spaced entries of a table.

    ``entries`` has the shape (n, m). The positions ``shares`` at which the entries are interpolated are from 0 (first
    entry) to 1 (last entry).
    """
    at = shares * (len(entries) - 1)
    first = np.clip(at.astype(np.int64), 0, len(entries) - 2)
    t = (at - first)[:, None]
    return np.asarray((1.0 - t) * entries[first] + t * entries[first + 1])
