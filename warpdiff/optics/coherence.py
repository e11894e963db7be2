"""How far the light stays in step across the surface: the window, source or number of copies of the Fourier sum."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from warpdiff.core import validation

KINDS = ("averaged", "centred", "source", "replicas")
DEFAULT_SIGMA_UM = 16.25
# Which kinds an argument is for.
_WINDOWS = ("averaged", "centred")
# Beyond this a light is no point in the sky, and the tangent plane that it is projected on no approximation.
_WIDEST_SOURCE_DEG = 30.0
_MOST_COPIES = 100_000


@dataclass(frozen=True)
class Coherence:
    """The window, source or number of copies that limits the coherent part of the surface.

    Attributes:
        kind: ``"averaged"`` is the expectation over all positions of a Gaussian window exp(−r²/2σ²): real, positive,
            and independent of where the window lies. ``"centred"`` is one window at one place, speckle included
            (Single 2014, eq. 3.8). ``"source"`` is a light of finite size on an endless surface: by van Cittert and
            Zernike's theorem a window that grows with the wavelength. ``"replicas"`` is a finite number of whole copies
            of the patch in step with each other (Single 2014, eq. 3.35).
        sigma_um: Standard deviation σ of the window [µm], for ``"averaged"`` and ``"centred"``; the default, 16.25, is
            a coherence length of 65 µm taken as 4σ. None for the other kinds.
        centre_um: Position (y, x) of the window for ``"centred"`` [µm]; ``None`` is the centre of the patch,
            (⌊ny/2⌋ dy, ⌊nx/2⌋ dx).
        angular_diameter_deg: Diameter of the light in the sky for ``"source"`` [degrees]; the default is the sun's,
            0.53. None for the other kinds.
        periods: Copies (y, x) of the patch for ``"replicas"``. None for the other kinds.
    """

    kind: str = "averaged"
    sigma_um: float | None = None
    centre_um: tuple[float, float] | None = None
    angular_diameter_deg: float | None = None
    periods: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        validation.choice(self.kind, "kind", KINDS)
        self._only_for("sigma_um", *_WINDOWS)
        self._only_for("centre_um", "centred")
        self._only_for("angular_diameter_deg", "source")
        self._only_for("periods", "replicas")
        if self.kind in _WINDOWS:
            sigma = DEFAULT_SIGMA_UM if self.sigma_um is None else validation.positive(self.sigma_um, "sigma_um")
            self._set("sigma_um", sigma)
        if self.centre_um is not None:
            centre = validation.finite_array(self.centre_um, "centre_um", most=validation.MOST)
            if centre.shape != (2,):
                raise ValueError(f"centre_um must be a pair (y, x) in µm, got shape {centre.shape}")
            self._set("centre_um", (float(centre[0]), float(centre[1])))
        if self.kind == "source":
            diameter = 0.53 if self.angular_diameter_deg is None else self.angular_diameter_deg
            self._set(
                "angular_diameter_deg",
                validation.positive(diameter, "angular_diameter_deg", most=_WIDEST_SOURCE_DEG),
            )
        if self.kind == "replicas":
            if self.periods is None:
                raise ValueError("copies must be given for kind='replicas': a pair (y, x), such as (1, 100)")
            if not isinstance(self.periods, (tuple, list)) or len(self.periods) != 2:
                raise ValueError(f"copies must be a pair (y, x) of whole numbers, got {self.periods!r}")
            pair = [validation.count(each, f"periods[{axis}]") for axis, each in enumerate(self.periods)]
            if max(pair) > _MOST_COPIES:
                raise ValueError(f"copies must be at most {_MOST_COPIES} along an axis, got {tuple(pair)}")
            self._set("periods", tuple(pair))

    def __str__(self) -> str:
        if self.kind == "source":
            return f"source of {self.angular_diameter_deg:g}° in diameter"
        if self.periods is not None:
            return f"{self.periods[0]} × {self.periods[1]} copies in step"
        return f"{self.kind} window with σ = {self.sigma_um:g} µm"

    @property
    def adds_powers(self) -> bool:
        """Whether coefficients add as powers; otherwise as amplitudes."""
        return self.kind in {"averaged", "source"}

    @property
    def spread(self) -> float:
        """Standard deviation s = α/√2 [radians] of the Gaussian that stands for a source of angular radius α."""
        return math.radians((self.angular_diameter_deg or 0.0) / 2.0) / math.sqrt(2.0)

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _only_for(self, name: str, *kinds: str) -> None:
        if getattr(self, name) is not None and self.kind not in kinds:
            raise ValueError(f"{name} is for kind={' or '.join(map(repr, kinds))}, not {self.kind!r}: leave it out")
