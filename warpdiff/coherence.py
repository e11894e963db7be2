"""How far the light stays in step across the surface: the window of the Fourier sum."""

from __future__ import annotations

import math
from dataclasses import dataclass

from warpdiff import checks

KINDS = ("averaged", "centred")


@dataclass(frozen=True)
class Coherence:
    """The Gaussian coherence window exp(−r²/2σ²), and what is done about its position.

    Attributes:
        kind: ``"averaged"`` is the expectation over all positions of the window: real, positive, and independent of
            where the window lies. ``"centred"`` is one window at one place, speckle included (Single 2014, eq. 3.8).
        sigma_um: Standard deviation σ of the window [µm]; the default is a coherence length of 65 µm taken as 4σ.
        centre_um: Position (y, x) of the window for ``"centred"`` [µm]; ``None`` is the centre of the patch,
            (⌊ny/2⌋ dy, ⌊nx/2⌋ dx).
    """

    kind: str = "averaged"
    sigma_um: float = 16.25
    centre_um: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        checks.choice(self.kind, "kind", KINDS)
        object.__setattr__(self, "sigma_um", checks.positive(self.sigma_um, "sigma_um"))
        if self.centre_um is not None:
            if self.kind != "centred":
                raise ValueError(f"centre_um is for kind='centred'; kind={self.kind!r} has no position: leave it out")
            centre = checks.finite_array(self.centre_um, "centre_um")
            if centre.shape != (2,):
                raise ValueError(f"centre_um must be a pair (y, x) in µm, got shape {centre.shape}")
            object.__setattr__(self, "centre_um", (float(centre[0]), float(centre[1])))

    @property
    def power_width(self) -> float:
        """Standard deviation in frequency [1/µm] of the Gaussian that a coefficient's power is spread over."""
        return 1.0 / (2.0 * math.sqrt(2.0) * math.pi * self.sigma_um)

    @property
    def falloff_um2(self) -> float:
        """The a [µm²] of exp(−a |q − q_rs|²): 4π²σ² on powers (averaged), 2π²σ² on amplitudes (centred)."""
        return (4.0 if self.kind == "averaged" else 2.0) * (math.pi * self.sigma_um) ** 2
