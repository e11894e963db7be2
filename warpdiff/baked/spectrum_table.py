"""``BakedSpectrum``: table of a height field's power spectrum, and its file; the height field is not needed.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal, and κ is w/λ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.baked import table_files
from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.optics.coherence import Coherence

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Largest number of cells per side of the square of frequencies in a table. Memory is proportional to its square.
_MOST_SIZE = 8192


@dataclass(frozen=True, eq=False)
class BakedSpectrum(table_files.SavedTable):
    """Table of the power ⟨|P|²⟩ of a height field under an averaged window: Σ_k s_k(q) f_k(|κ|) plus the zeroth order.

    P is the mean of exp(ik(wh + ux + vy)) over the surface, weighted by the window. q is (u, v)/λ, and κ is w/λ. A
    square of q is divided into cells. Each cell contains the mean of s_k over its area, so that the total power does
    not depend on the size of the cells. The cells exclude the zeroth order, |H₀₀(κ)|² exp(−4π²σ²|q|²), whose factor
    |H₀₀|² is in ``zeroth``. H are the Fourier coefficients of exp(2πiκh) over the patch, and H₀₀ is the one of
    frequency 0. Together, cells and zeroth order are normalised: 4πσ² times the integral of the power over q is Σ|H|² =
    1. Files contain the attributes by name.

    Attributes:
        sigma_um: Standard deviation σ of the window [µm].
        largest_q: Half the side of the square of cells, which is centred on q = 0 [1/µm].
        powers: s_k of the cells, shape (size, size, K), float32; the first index is along v, the second along u.
        least_kappa: |κ| of the first entry of ``functions`` [1/µm].
        largest_kappa: |κ| of the last entry of ``functions`` [1/µm].
        functions: f_k at equally spaced |κ|, for linear interpolation, shape (entries, K), float32.
        zeroth: |H₀₀|² at the |κ| of ``functions``, shape (entries,), float32.

    Examples:
        >>> import warpdiff as wd
        >>> window = wd.Coherence(sigma_um=2.0)
        >>> spectrum = wd.bake_spectrum(wd.gratings.sinusoidal(2.0, 0.1), size=16, tolerance=0.1, coherence=window)
        >>> spectrum.save("spectrum.npz").name
        'spectrum.npz'
    """

    FORMAT = "warpdiff baked spectrum, version 1"

    sigma_um: float
    largest_q: float
    powers: NDArray[np.float32]
    least_kappa: float
    largest_kappa: float
    functions: NDArray[np.float32]
    zeroth: NDArray[np.float32]

    def __post_init__(self) -> None:
        validation.positive(self.sigma_um, "sigma_um")
        validation.positive(self.largest_q, "largest_q")
        validation.number(self.least_kappa, "least_kappa", least=0.0)
        validation.number(self.largest_kappa, "largest_kappa", above=self.least_kappa)
        size, count = (np.shape(self.powers)[0], np.shape(self.powers)[-1]) if np.ndim(self.powers) else (0, 0)
        if not 2 <= size <= _MOST_SIZE:
            raise ArgumentValueError(f"{ref('powers')} must have 2 to {_MOST_SIZE} cells along a side, got {size}")
        entries = np.shape(self.zeroth)[0] if np.ndim(self.zeroth) else 0
        table_files.check(
            self, powers=(np.float32, (size, size, count)), functions=(np.float32, (entries, count)),
            zeroth=(np.float32, (entries,)),
        )  # fmt: skip

    @property
    def coherence(self) -> Coherence:
        """Averaged coherence window of the spectrum."""
        return Coherence(sigma_um=self.sigma_um)

    def __repr__(self) -> str:
        size, _, count = self.powers.shape
        cells = f"{count} functions of κ at {size} × {size} cells, {self.powers.nbytes / 1e6:.2g} MB"
        return f"BakedSpectrum({self.coherence}, {cells})"

    def __str__(self) -> str:
        size, _, count = self.powers.shape
        return (
            f"Baked spectrum, {self.coherence}: {count} functions of κ at {size} × {size} cells of |q| up to "
            f"{self.largest_q:.3g} /µm, {self.powers.nbytes / 1e6:.2g} MB."
        )
