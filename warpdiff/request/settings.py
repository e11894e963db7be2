"""The options of the public functions: one frozen dataclass per group of options.

A field of such a class states the type, range and unit of an option; ``Attributes:`` states its meaning. Everything
else follows from the fields: keyword arguments (:mod:`warpdiff.request.keywords`), signatures and docstrings, the
command line, the viewer's controls and the fuzz tests.
"""

from __future__ import annotations

import math
from collections.abc import Collection  # noqa: TC003 (fields are described at run time)
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar, cast, get_args

import numpy as np
from annotated_types import Ge, Gt, Interval, Unit

from warpdiff.core import validation
from warpdiff.core.options import SPELLINGS, Checked, Names, choices_of
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.colorimetry import check_wavelengths
from warpdiff.request.layer_formats import BY_LIGHT, LAYERS
from warpdiff.request.plan import Plan, check_footprint, check_method

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike

    from warpdiff.optics.materials import Material

Method = Literal[
    "auto", "low-rank", "power", "jacobi-anger", "taylor", "taylor-uncentred", "taylor-uncentered", "direct"
]
Integration = Literal["auto", "sampled", "table"]
Energy = Literal["stam", "normalised", "normalized"]
Display = Literal["aces", "colorimetric", "clip"]
GamutName = Literal["srgb", "display-p3"]
Bits = Literal[8, 16]
TangentRule = Literal["x", "y", "z", "around-x", "around-y", "around-z", "smooth"]
TANGENT_RULES: tuple[str, ...] = get_args(TangentRule)
# Maximum number of camera rays per pixel, 256 × 256. The value was chosen because more rays do not change a picture
# with 8 bits per channel.
MOST_SAMPLES = 2**16
# Smallest step between the wavelengths of a spectral picture [nm]. The value is limited by the names of EXR channels,
# which contain the wavelength with six decimals.
LEAST_STEP_NM = 1e-5
# Largest correction of an exposure [stops]. The value was chosen so that the exposure can change by a factor of 1e9,
# which is more than any picture needs.
MOST_STOPS = 30.0


def check_energy(energy: str) -> Energy:
    """Return a value of the option ``energy`` in British spelling; raise an error for any other value."""
    spelling = SPELLINGS.get(energy, energy) if isinstance(energy, str) else energy
    return cast("Energy", validation.choice(spelling, "energy", choices_of(Energy)))


_Tangents = TypeVar("_Tangents")


def check_tangents(tangents: _Tangents) -> _Tangents:
    """Return ``tangents`` unchanged; raise an error for a text that is not in ``TANGENT_RULES``."""
    if isinstance(tangents, str):
        validation.choice(tangents, "tangents", TANGENT_RULES)
    return tangents


@dataclass(frozen=True, kw_only=True)
class CommonSettings(Checked):
    """Options of every function that evaluates a height field.

    Attributes:
        tolerance: Accepted relative error of XYZ (or ρ for spectra) at the 99th percentile of all directions or
            illuminated pixels, and separately of the bright directions or pixels. The error is relative to the value
            itself, or to 1e-3 of the reference luminance of all directions if that is larger (see the glossary of the
            documentation).
        method: Expansion of exp(2πiκh) in κ = w/λ, where h is the height. ``"auto"`` selects the cheapest expansion
            that meets the tolerance; ``"direct"`` is the float64 sum without an expansion, which is slow.
        integration: Integration over the wavelength: by sampled wavelengths, or by a precomputed table of colours.
        coherence: Window, source or periods; None is an averaged window of σ = 16.25 µm.
        ior: Index of refraction; ``math.inf`` is a perfect mirror; None is 1.5 unless a material is given. Results are
            relative to the reflectance at normal incidence.
        material: Material of the surface instead of ``ior``; results are then relative to a perfect mirror. Pictures
            also accept a mapping from the names of a mesh's geometries to materials.
        strict: Whether a tolerance that cannot be met raises ``ToleranceError``; otherwise it causes a warning.
        device: Warp device, ``"cpu"`` or ``"cuda"``; None is the CPU.
        threads: Threads on the CPU; None is one per core. Results do not depend on the number of threads.
    """

    tolerance: Annotated[float, Interval(ge=1e-5, le=0.5)] = 1e-2
    method: Method = "auto"
    integration: Integration = "auto"
    coherence: Coherence | None = None
    ior: Annotated[float, Interval(gt=1.0, le=math.inf)] | None = None
    material: Material | Mapping[str, Material] | None = None
    strict: bool = True
    device: str | None = None
    threads: Annotated[int, Ge(1)] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.integration != "auto" and self.method == "direct":
            raise ArgumentValueError(
                f"{ref('integration')} must be 'auto' for {ref('method', 'direct')}, got {self.integration!r}: remove "
                "it"
            )
        check_method(self.method, self.integration, self.effective_coherence)

    @property
    def effective_coherence(self) -> Coherence:
        """Coherence of the settings, or the default coherence if ``coherence`` is None."""
        return self.coherence or Coherence()


@dataclass(frozen=True, kw_only=True)
class PlanSettings(CommonSettings):
    """Options of ``plan``.

    Attributes:
        masking: Whether V-cavity masking and shadowing of the relief is included; the option has no effect for
            ``energy="normalised"``.
    """

    masking: bool = True


@dataclass(frozen=True, kw_only=True)
class PlannedSettings(CommonSettings):
    """Options of functions that accept an explicit plan.

    Attributes:
        plan: Explicit plan instead of ``tolerance``, ``method``, ``integration`` and ``coherence``. A plan implies
            ``strict=False``. Pictures with several surfaces also accept a mapping from parts of the mesh to plans.
    """

    plan: Plan | Mapping[str, Plan] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.plan, Plan) and self.coherence not in (None, self.plan.coherence):
            raise ArgumentValueError(
                f"{ref('coherence')} differs from the coherence of {ref('plan')}; give one of them, or change the plan "
                "by dataclasses.replace"
            )

    @property
    def effective_coherence(self) -> Coherence:
        """Coherence of the caller's plan. Without a plan, coherence of the settings. Without both, the default."""
        return self.plan.coherence if isinstance(self.plan, Plan) else super().effective_coherence


@dataclass(frozen=True, kw_only=True)
class EnergySettings(CommonSettings):
    """Options of functions that can normalise the energy.

    Attributes:
        energy: With ``"stam"``, the order efficiencies of a perfect mirror may sum to more or less than 1. With
            ``"normalised"``, these efficiencies sum to 1 for every direction: instead of masking, colours are
            multiplied by a(ωi) a(ωr), the factors of :func:`warpdiff.order_efficiencies` averaged over the wavelengths.
            The factors require about two seconds, once per height field.
    """

    energy: Energy = "stam"


@dataclass(frozen=True, kw_only=True)
class SpectralSettings(PlannedSettings, PlanSettings):
    """Options of ``spectral_reflectance``."""


@dataclass(frozen=True, kw_only=True)
class BrdfSettings(PlannedSettings, EnergySettings):
    """Options of ``brdf``."""


@dataclass(frozen=True, kw_only=True)
class EvaluationSettings(PlannedSettings, EnergySettings, PlanSettings):
    """Options of every function that computes colours."""


@dataclass(frozen=True, kw_only=True)
class PictureSettings(EvaluationSettings):
    """Options of pictures of a mesh.

    Attributes:
        pigment: Strength of the mesh's base colour (texture, vertex colours or one colour), which lies under the
            relief.
        shadows: Whether the mesh can occlude the lights.
        smooth: Whether vertex normals are interpolated; otherwise facets show.
        tangents: Direction of the height field's x axis, instead of tangents and texture coordinates of the mesh.
            ``"x"`` is along the world's x axis, ``"around-x"`` around a parallel to this axis through the centre of
            each object, likewise y and z, and ``"smooth"`` turns least over the surface. An array has one vector for
            all, shape (3,), or one per vertex, shape (n, 3), in the world frame. Only the component in the surface is
            used; where it is zero, the mean direction of neighbouring vertices. None is the tangents of a glTF file, or
            else the u axis of the texture coordinates.
        footprint: Whether a pixel shows the mean over the pixel filter instead of the colour at its centre. The filter
            is a Gaussian with σ = 0.5 pixel, truncated at 1.5 pixels. None is True for averaged windows and sources.
            For other coherences, and for ``method="direct"``, None is False.
        samples_per_pixel: Number of camera rays per pixel. With 1, the ray passes through the pixel centre. With
            footprints, the number is the least number of subpixel cells, the parts of a pixel: 1, 4, 16, … 4,096.
        refine: Whether pixels are subdivided until they meet the tolerance, into 4,096 cells at most, or 1,024 if
            ``tolerance`` is 0.05 or larger. Without refinement the tolerance is not guaranteed; ``image.error``
            estimates the error.
    """

    pigment: Annotated[float, Ge(0.0)] = 1.0
    shadows: bool = True
    smooth: bool = True
    tangents: TangentRule | ArrayLike | None = None
    footprint: bool | None = None
    samples_per_pixel: Annotated[int, Interval(ge=1, le=MOST_SAMPLES)] = 1
    refine: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        check_tangents(self.tangents)
        if self.footprint:
            check_footprint(self.plan.method if isinstance(self.plan, Plan) else self.method)

    @property
    def effective_footprint(self) -> bool:
        """Whether pixels show means over the pixel filter (a Gaussian), and not the colours of single directions."""
        if self.footprint is not None:
            return self.footprint
        if isinstance(self.plan, Plan):
            return self.plan.footprint
        return self.effective_coherence.adds_powers and self.method != "direct"


@dataclass(frozen=True, kw_only=True)
class SinglePictureSettings(PictureSettings):
    """Options of ``shade``.

    Attributes:
        layers: Names of further outputs, for ``image.layers``. ``"light"``, ``"to_light"`` and ``"scattering"`` are one
            layer per light; ``"light.0"`` is the layer of the first light. With ``"light"``, each light is refined
            separately.
        wavelengths_nm: Wavelengths [nm], shape (m,), at which ``image.spectra`` has the radiance of each pixel. Pixels
            are then means over ``samples_per_pixel`` rays instead of footprints. None computes no spectra.
    """

    layers: Annotated[Collection[str], Names(tuple(LAYERS), BY_LIGHT)] = ()
    wavelengths_nm: ArrayLike | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.wavelengths_nm is None:
            return
        wavelengths = check_wavelengths(self.wavelengths_nm)
        if np.any(np.diff(wavelengths) < LEAST_STEP_NM):
            raise ArgumentValueError(
                f"{ref('wavelengths_nm')} must increase in steps of at least {LEAST_STEP_NM:g} nm, got "
                f"{wavelengths.tolist()!s:.60}"
            )
        object.__setattr__(self, "wavelengths_nm", wavelengths)
        if self.footprint:
            raise ArgumentValueError(
                f"{ref('footprint')} must be None or False with {ref('wavelengths_nm')}, got True: give "
                f"{ref('samples_per_pixel')}"
            )
        if self.energy != "stam":
            raise ArgumentValueError(
                f"{ref('energy')} must be 'stam' with {ref('wavelengths_nm')}, because its factors are means over the "
                f"wavelengths, got {self.energy!r}"
            )
        if self.integration == "table":
            raise ArgumentValueError(
                f"{ref('integration')} must be 'auto' or 'sampled' with {ref('wavelengths_nm')}, because a table "
                f"contains colours, got {self.integration!r}"
            )

    @property
    def effective_footprint(self) -> bool:
        """Whether pixels show means over the pixel filter; the pixels of spectral pictures do not."""
        return super().effective_footprint and self.wavelengths_nm is None


@dataclass(frozen=True, kw_only=True)
class ColourSettings(Checked):
    """Options of every function that shows colours, except the choice of the display transform.

    Attributes:
        exposure: Linear factor of the light. None computes it from the mean luminance of the pixels that are not black;
            for EXR files, None is 1. With 1 and ``display="colorimetric"``, a perfect mirror at normal incidence is
            white.
        exposure_stops: Correction of the exposure, a factor of 2 per stop.
    """

    exposure: Annotated[float, Gt(0.0)] | None = None
    exposure_stops: Annotated[float, Interval(ge=-MOST_STOPS, le=MOST_STOPS), Unit("stops")] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exposure is not None:
            validation.positive(self.exposure, "exposure")


@dataclass(frozen=True, kw_only=True)
class GamutSettings(ColourSettings):
    """Options of ``Image.display``, except the choice of the display transform.

    Attributes:
        gamut: Gamut of the display.
    """

    gamut: GamutName = "srgb"


@dataclass(frozen=True, kw_only=True)
class DisplaySettings(GamutSettings):
    """All options of display colours, which ``Image.save`` and ``sequence`` have for PNG files.

    Attributes:
        display: Display transform. ``"aces"`` is the ACES 2.0 view for standard dynamic range, which shows bright
            diffraction orders as smooth colour gradients. ``"colorimetric"`` is exact for colours within the gamut and
            reduces the chroma of other colours. ``"clip"`` clips each channel. EXR files are linear.
        bits: Bits per channel of PNG files.
    """

    display: Display = "aces"
    bits: Bits = 8
