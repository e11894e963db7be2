"""Coherence: the part of the surface that interferes, as a window, a source size or a number of periods."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from annotated_types import Ge, Interval, Unit

from warpdiff.core import validation
from warpdiff.core.options import SPELLINGS, Checked
from warpdiff.core.wording import ArgumentValueError, ref

Kind = Literal["averaged", "centred", "centered", "source", "replicas"]
KINDS = tuple(kind for kind in get_args(Kind) if kind not in SPELLINGS)
# Default standard deviation σ of the coherence window [µm]. The value is a convention: a coherence length of 65 µm is
# interpreted as 4σ. If σ is doubled, the diffraction orders of a grating are half as wide in angle.
DEFAULT_SIGMA_UM = 16.25
# Angular diameter of the sun [degrees], from astronomy.
_DEFAULT_DIAMETER_DEG = 0.53
_WINDOWS = ("averaged", "centred")
# Largest angular diameter of a light source [degrees]. In the model, the directions to the source are points of the
# plane that touches the unit sphere at the centre of the source, instead of points of the sphere. For wider sources
# this model is not accurate.
_MAX_DIAMETER_DEG = 30.0
# Largest number of periods along an axis. The value was chosen because 100,000 periods of 1 µm are ten centimetres,
# which is more than the size of typical gratings.
_MAX_PERIODS = 100_000


@dataclass(frozen=True)
class Coherence(Checked):
    """Part of the surface that interferes: a window, a source size or a number of periods.

    Attributes:
        kind: Kind of coherence. ``"averaged"`` is a Gaussian window exp(−r²/2σ²); the reflected power is averaged over
            all positions of the window. ``"centred"`` is one window at one position, speckle included (Single 2014, eq.
            3.8). ``"source"`` is a light source of finite size on an endless surface: by the theorem of van Cittert and
            Zernike, it acts like a window whose σ is proportional to the wavelength. ``"replicas"`` is a finite number
            of whole periods of the patch that interfere (Single 2014, eq. 3.35).
        sigma_um: Standard deviation σ of the window for ``"averaged"`` and ``"centred"``, by default 16.25: a coherence
            length of 65 µm, taken as 4σ. None for the other kinds.
        centre_um: Position (y, x) of the window for ``"centred"`` [µm]; None is the centre of the patch,
            (⌊ny/2⌋ dy, ⌊nx/2⌋ dx).
        angular_diameter_deg: Angular diameter of the light source for ``"source"``, by default the sun's, 0.53. None
            for the other kinds.
        periods: Number of periods (y, x) of the patch for ``"replicas"``, each 1 to 100,000. None for the other kinds.

    Examples:
        >>> import warpdiff as wd
        >>> print(wd.Coherence())
        averaged window with σ = 16.25 µm
        >>> print(wd.Coherence("source", angular_diameter_deg=0.53))
        source of 0.53° in diameter
        >>> print(wd.Coherence("replicas", periods=(1, 100)))
        1 × 100 periods
    """

    kind: Kind = "averaged"
    sigma_um: Annotated[float, Ge(validation.LEAST), Unit("µm")] | None = None
    centre_um: Annotated[tuple[float, float], Unit("µm")] | None = None
    angular_diameter_deg: Annotated[float, Interval(ge=validation.LEAST, le=_MAX_DIAMETER_DEG), Unit("°")] | None = None
    periods: Annotated[tuple[int, int], Interval(ge=1, le=_MAX_PERIODS)] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._only_for("sigma_um", *_WINDOWS)
        self._only_for("centre_um", "centred")
        self._only_for("angular_diameter_deg", "source")
        self._only_for("periods", "replicas")
        if self.kind in _WINDOWS and self.sigma_um is None:
            self._set("sigma_um", DEFAULT_SIGMA_UM)
        if self.kind == "source" and self.angular_diameter_deg is None:
            self._set("angular_diameter_deg", _DEFAULT_DIAMETER_DEG)
        if self.kind == "replicas" and self.periods is None:
            raise ArgumentValueError(
                f"{ref('periods')} must be given for {ref('kind', 'replicas')}, such as {ref('periods', (1, 100))}"
            )

    def __str__(self) -> str:
        if self.kind == "source":
            return f"source of {self.angular_diameter_deg:g}° in diameter"
        if self.periods is not None:
            return f"{self.periods[0]} × {self.periods[1]} periods"
        return f"{self.kind} window with σ = {self.sigma_um:g} µm"

    @property
    def adds_powers(self) -> bool:
        """Whether powers |H|² of neighbouring Fourier coefficients are added; otherwise amplitudes H are added."""
        return self.kind in {"averaged", "source"}

    @property
    def spread(self) -> float:
        """Standard deviation s = α/√2 [radians] of the Gaussian that approximates a source of the angular radius α."""
        return math.radians((self.angular_diameter_deg or 0.0) / 2.0) / math.sqrt(2.0)

    def _set(self, name: str, value: float) -> None:
        object.__setattr__(self, name, value)

    def _only_for(self, name: str, *kinds: str) -> None:
        if getattr(self, name) is not None and self.kind not in kinds:
            others = " or ".join(ref("kind", kind) for kind in kinds)
            raise ArgumentValueError(f"{ref(name)} is for {others}, not {self.kind!r}: remove it")
