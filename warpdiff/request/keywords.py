"""Types of the keyword arguments of public functions, written by ``python -m bench.dev.write_keywords``."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TypedDict

from numpy.typing import ArrayLike

from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import Material
from warpdiff.request.plan import Plan
from warpdiff.request.settings import Bits, Display, Energy, GamutName, Integration, Method, TangentRule


class CommonKeywords(TypedDict, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.CommonSettings`."""

    tolerance: float
    method: Method
    integration: Integration
    coherence: Coherence | None
    ior: float | None
    material: Material | Mapping[str, Material] | None
    strict: bool
    device: str | None
    threads: int | None


class PlanKeywords(CommonKeywords, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.PlanSettings`."""

    masking: bool


class PlannedKeywords(CommonKeywords, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.PlannedSettings`."""

    plan: Plan | Mapping[str, Plan] | None


class EnergyKeywords(CommonKeywords, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.EnergySettings`."""

    energy: Energy


class SpectralKeywords(PlannedKeywords, PlanKeywords, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.SpectralSettings`."""


class BrdfKeywords(PlannedKeywords, EnergyKeywords, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.BrdfSettings`."""


class EvaluationKeywords(PlannedKeywords, EnergyKeywords, PlanKeywords, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.EvaluationSettings`."""


class PictureKeywords(EvaluationKeywords, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.PictureSettings`."""

    pigment: float
    shadows: bool
    smooth: bool
    tangents: TangentRule | ArrayLike | None
    footprint: bool | None
    samples_per_pixel: int
    refine: bool


class SinglePictureKeywords(PictureKeywords, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.SinglePictureSettings`."""

    layers: Collection[str]
    wavelengths_nm: ArrayLike | None


class ColourKeywords(TypedDict, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.ColourSettings`."""

    exposure: float | None
    exposure_stops: float


class GamutKeywords(ColourKeywords, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.GamutSettings`."""

    gamut: GamutName


class DisplayKeywords(GamutKeywords, total=False):
    """Keyword arguments of :class:`warpdiff.request.settings.DisplaySettings`."""

    display: Display
    bits: Bits
