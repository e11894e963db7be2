"""``BakedSpectrum``: the power spectrum of a height field as a table that needs no height field, and its file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.baked import table_files
from warpdiff.core import validation
from warpdiff.optics.coherence import Coherence

if TYPE_CHECKING:
    import os
    from pathlib import Path

    from numpy.typing import NDArray

FORMAT = "warpdiff baked spectrum, version 1"
_MOST_SIZE = 8192


@dataclass(frozen=True, eq=False)
class BakedSpectrum:
    """The power ⟨|P|²⟩ of a height field under an averaged window, Σ_k s_k(q) f_k(|κ|), and the zeroth order beside.

    q = (u, v)/λ and κ = w/λ. Cells hold means over themselves, so that their sum is the power however coarse they are.
    The mean plane's part, |H₀₀(κ)|² exp(−4π²σ²|q|²), is left out of them. Over 2 dimensions, 4πσ² times the power is
    a density that adds up to 1 over q, as Σ|H|² does.

    Attributes:
        sigma_um: σ of the window [µm].
        largest_q: Cells reach from minus this to this along either axis [1/µm].
        powers: s_k of the cells, shape (size, size, K), float32; the first index goes along v, the second along u.
        least_kappa: The |κ| of the functions' first entry [1/µm].
        largest_kappa: That of the last one.
        functions: f_k at equal steps of |κ|, shape (entries, K), float32; linear in between.
        zeroth: |H₀₀|² at the same |κ|, shape (entries,), float32.
    """

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
            raise ValueError(f"powers must be of 2 to {_MOST_SIZE} cells along a side, got {size}")
        entries = np.shape(self.zeroth)[0] if np.ndim(self.zeroth) else 0
        table_files.check(
            self,
            powers=(np.float32, (size, size, count)),
            functions=(np.float32, (entries, count)),
            zeroth=(np.float32, (entries,)),
        )

    @property
    def coherence(self) -> Coherence:
        """The window."""
        return Coherence(sigma_um=self.sigma_um)

    def __str__(self) -> str:
        size, _, count = self.powers.shape
        return (
            f"Baked spectrum, {self.coherence}: {count} functions of κ at {size} × {size} cells of |q| up to "
            f"{self.largest_q:.3g} /µm, {self.powers.nbytes / 1e6:.2g} MB."
        )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the table as NumPy's ``.npz``, compressed, its arrays named as the attributes, and ``format``.

        An existing file is replaced only once the new one is complete.
        """
        return table_files.save(path, {"format": FORMAT, **vars(self)})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> BakedSpectrum:
        """Read what :meth:`save` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It is no such file, or damaged.
        """
        with table_files.loaded(path, FORMAT, "BakedSpectrum") as found:
            return cls(
                float(found["sigma_um"]), float(found["largest_q"]), found["powers"], float(found["least_kappa"]),
                float(found["largest_kappa"]), found["functions"], found["zeroth"],
            )  # fmt: skip
