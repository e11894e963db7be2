"""The plan: the numbers that the kernels get, and which methods and tolerances there are."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.diffraction.coefficient_basis import METHODS as EXPANDED
from warpdiff.diffraction.coefficient_basis import POWER_METHODS, holds_powers
from warpdiff.diffraction.phase_series import EXPANSIONS, MAX_TERMS
from warpdiff.heightfield import scalar_validity
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.colorimetry import LONGEST_NM, SHORTEST_NM
from warpdiff.request.directions import DirectionRange

if TYPE_CHECKING:
    from collections.abc import Iterable

METHODS = ("auto", *EXPANDED, "direct")
AUTOMATIC = "low-rank"
LABELS = {
    "low-rank": "Low-rank basis",
    "power": "Chebyshev series of the powers",
    **{name: f"{expansion.label} series" for name, expansion in EXPANSIONS.items()},
}
# What a core of a present processor does in a second, of a kernel's multiply-adds: of sums over wavelengths and of the
# making of tables, and of look-ups, which wait for memory.
_SUMMED_PER_SECOND, _LOOKED_UP_PER_SECOND = 9e9, 2.7e9
# An octave, of a table.
MIN_RINGS, MAX_RINGS = 4, 512
# Functions of w come in multiples of these.
W_BASIS_STEP, MOST_W_BASIS = 4, 32
# Least and most: of components of two unit vectors' sum, which may be rounded, and of wavelengths.
_SCOPE = {
    **dict.fromkeys(("max_uv", "min_w", "max_w"), (0.0, 2.001)),
    **dict.fromkeys(("max_order_rate", "height_range_um"), (0.0, validation.MOST)),
    **dict.fromkeys(("lambda_min_nm", "lambda_max_nm"), (SHORTEST_NM, LONGEST_NM)),
}
# Fields by what they are.
_REQUEST = ("method", "coherence", "tolerance", "footprint")
_NUMBERS = (
    *("terms", "least_weight", "wavelengths", "subdivisions", "bandwidth_um", "adaptive"),
    *("rings_per_octave", "azimuths_per_width", "w_basis_size"),
)
_ERRORS = ("truncation", "neighbourhood", "quadrature", "rounding")
_FINDINGS = (
    *(
        "light_sample_count",
        "refined_share",
        "unconverged_share",
        "unconverged_edge_share",
        "errors",
        "energy_spread",
        "aliasing",
        "scalar_error",
    ),
    *("multiply_adds", "table_multiply_adds", "is_measured", "validation_size"),
)


@dataclass(frozen=True)
class Plan:
    """The numbers of a computation, and why. ``dataclasses.replace(plan, terms=9)`` changes one; pass it as ``plan=``.

    Errors are relative ones of XYZ, as ``tolerance`` is. ``request``, ``kernel_numbers``, ``valid_range``,
    ``predicted_errors`` and ``findings`` are views of the fields by what they are.

    Attributes:
        method: One of ``low_rank_basis.METHODS``, or ``"direct"``.
        coherence: The window, source or periods.
        tolerance: What was asked for.
        terms: Terms of the basis, n = 0 … terms − 1.
        least_weight: Neighbours whose Gaussian weight, on powers or on amplitudes, is less are left out.
        wavelengths: Samples over 380 to 780 nm, equally spaced in 1/λ, or in log λ for a source; 0 where the caller
            gives wavelengths.
        subdivisions: For copies: samples of their factor for one of the patch's.
        bandwidth_um: What a direction takes of them as a, b, c of a·lateral + b·|w| + c, samples per unit of 1/λ;
            lateral is |(u, v)|, for a source stretched along its foreshortening, for copies |(u Lx, v Ly)|.
        adaptive: Whether directions with less than the largest bandwidth take fewer of them.
        rings_per_octave: Nodes an octave of the polar table that the integral over λ is taken from; 0 samples wavelengths.
        azimuths_per_width: Rays of that table in a standard deviation of the spectrum's blur.
        w_basis_size: Functions of w that all colours of the table share, a multiple of 4; 0 takes as many as the tolerance
            asks for.
        footprint: Whether pixels show means over their range of (u, v), which are taken from levels of the table where
            there is one and powers add, and otherwise from many points.
        light_sample_count: Of a picture, how many directions and Gaussians of directions stand for its lights.
        refined_share: Of a picture, the share of the pixels that see the mesh that were split into cells; of several lights,
            of the one under which these are most.
        unconverged_share: The share of its lit pixels that are expected to err by more than the tolerance, as their estimated
            errors tell, of those that no edge passes; 0 of one that is not refined, which promises nothing.
        unconverged_edge_share: The same of those that an edge passes, of the mesh or of what is lit, and of three tolerances.
        errors: Medians and 99th percentiles of the estimated errors of its lit pixels; 0 for directions.
        energy_spread: Where energy is normalised, by how much what single wavelengths and directions send back differs
            from what comes in (root mean square); no part of ``error``. 0 of what is as Stam has it.
        max_uv: Largest |(u, v)| of the directions that the numbers hold for.
        max_order_rate: Largest lateral of these.
        min_w: Smallest |w| of these.
        max_w: Largest |w| of these.
        lambda_min_nm: Shortest wavelength that the numbers hold for [nm].
        lambda_max_nm: Longest wavelength that the numbers hold for [nm].
        height_range_um: Largest height range that the numbers hold for [µm].
        truncation: Predicted error from the terms left out.
        neighbourhood: Predicted error from the neighbours left out.
        quadrature: Predicted error of the integral over λ; 0 without one.
        rounding: Predicted error from float32 arithmetic.
        aliasing: Power of the height field beyond the pitch's limit, which folds back onto the steepest directions,
            relative to theirs. It is a property of the data and no part of ``error``.
        scalar_error: How wrong scalar diffraction can be at 550 nm, see ``scalar_validity.error_bound``. It is a
            property of the surface and no part of ``error``.
        multiply_adds: Predicted cost of a direction, in the mean over the sample.
        is_measured: Whether the errors were measured on some directions; otherwise they are what bounds leave as a rule.
        validation_size: On how many, which the search has not seen where there are enough of them.
        table_multiply_adds: Predicted cost of making the table; 0 without one.
    """

    method: str
    coherence: Coherence
    tolerance: float
    terms: int
    least_weight: float
    wavelengths: int
    subdivisions: int
    bandwidth_um: tuple[float, float, float]
    adaptive: bool
    rings_per_octave: int
    azimuths_per_width: float
    w_basis_size: int
    footprint: bool
    light_sample_count: int
    refined_share: float
    unconverged_share: float
    unconverged_edge_share: float
    errors: tuple[float, float]
    energy_spread: float
    max_uv: float
    max_order_rate: float
    min_w: float
    max_w: float
    lambda_min_nm: float
    lambda_max_nm: float
    height_range_um: float
    truncation: float
    neighbourhood: float
    quadrature: float
    rounding: float
    aliasing: float
    scalar_error: float
    multiply_adds: float
    is_measured: bool
    validation_size: int
    table_multiply_adds: float

    def __post_init__(self) -> None:
        validation.choice(self.method, "method", (*EXPANDED, "direct"))
        validation.instance(self.coherence, Coherence, "coherence")
        validation.number(self.azimuths_per_width, "azimuths_per_width", least=0.0)
        if validation.count(self.rings_per_octave, "rings_per_octave", least=0):
            validation.positive(self.azimuths_per_width, "azimuths_per_width")
            if not MIN_RINGS <= self.rings_per_octave <= MAX_RINGS:
                raise ValueError(
                    f"rings_per_octave must be 0, or {MIN_RINGS} to {MAX_RINGS}, got {self.rings_per_octave}"
                )
        if (
            validation.count(self.w_basis_size, "w_basis_size", least=0) % W_BASIS_STEP
            or self.w_basis_size > MOST_W_BASIS
        ):
            raise ValueError(
                f"w_basis_size must be a multiple of {W_BASIS_STEP} up to {MOST_W_BASIS}, or 0, got {self.w_basis_size}"
            )
        validation.flag(self.footprint, "footprint")
        check_method(self.method, "table" if self.rings_per_octave else "sampled", self.coherence)
        validation.number(self.tolerance, "tolerance", least=1e-5, most=0.5)
        if not 1 <= validation.count(self.terms, "terms") <= MAX_TERMS:
            raise ValueError(f"terms must be 1 to {MAX_TERMS}, got {self.terms}")
        weight = validation.number(self.least_weight, "least_weight", above=0.0)
        if weight >= 1.0:
            raise ValueError(f"least_weight must be less than 1, got {weight:g}: no coefficient has more")
        for name, (least, most) in _SCOPE.items():
            validation.number(getattr(self, name), name, least=least, most=most)
        for name in {*_ERRORS, *_FINDINGS} - {"errors", "is_measured", "validation_size", "light_sample_count"}:
            # Bounds of what diverges are of any size.
            validation.number(getattr(self, name), name, least=0.0, most=sys.float_info.max)
        errors = validation.finite_array(self.errors, "errors")
        if errors.shape != (2,):
            raise ValueError(f"errors must be a pair of numbers, got {self.errors!r}")
        validation.flag(self.is_measured, "is_measured")
        validation.count(self.validation_size, "validation_size", least=0)
        validation.count(self.light_sample_count, "light_sample_count", least=0)
        bandwidth = validation.finite_array(self.bandwidth_um, "bandwidth_um", most=validation.MOST)
        if bandwidth.shape != (3,) or bandwidth.min() < 0.0 or bandwidth[2] == 0.0:
            raise ValueError(f"bandwidth_um must be three numbers >= 0, the last > 0, got {self.bandwidth_um!r}")
        validation.flag(self.adaptive, "adaptive")
        validation.count(self.subdivisions, "subdivisions")
        if validation.count(self.wavelengths, "wavelengths", least=0):
            validation.count(self.wavelengths, "wavelengths", least=2)

    @property
    def error(self) -> float:
        """Predicted error of the call: all sources but aliasing."""
        return float(sum(self.predicted_errors.values()))

    @property
    def request(self) -> dict[str, Any]:
        """The request that it answers, by field."""
        return self._view(_REQUEST)

    @property
    def kernel_numbers(self) -> dict[str, Any]:
        """The numbers that kernels and tables take, by field."""
        return self._view(_NUMBERS)

    @property
    def valid_range(self) -> dict[str, Any]:
        """The range that these numbers hold for, by field."""
        return self._view(_SCOPE)

    @property
    def predicted_errors(self) -> dict[str, float]:
        """The error from each source, by field; their sum is ``error``."""
        return self._view(_ERRORS)

    @property
    def findings(self) -> dict[str, Any]:
        """Findings on the surface, the search and the picture, by field."""
        return self._view(_FINDINGS)

    def _view(self, names: Iterable[str]) -> dict[str, Any]:
        return {name: getattr(self, name) for name in names}

    @property
    def uses_footprints(self) -> bool:
        """Whether a pixel's mean is taken from levels of the table."""
        return self.footprint and self.rings_per_octave > 0 and self.coherence.adds_powers

    @property
    def microseconds(self) -> float:
        """Estimated time of a direction [µs] on one core of a CPU."""
        return 1e6 * self.multiply_adds / (_LOOKED_UP_PER_SECOND if self.rings_per_octave else _SUMMED_PER_SECOND)

    @property
    def table_seconds(self) -> float:
        """Estimated time of making the table [s] on one core of a CPU, once for all calls; 0 without one."""
        return self.table_multiply_adds / _SUMMED_PER_SECOND

    @property
    def direction_range(self) -> DirectionRange:
        """The range of directions and wavelengths that the numbers hold for."""
        return DirectionRange(
            self.max_uv, self.max_order_rate, self.min_w, self.max_w, self.lambda_min_nm, self.lambda_max_nm
        )

    def __str__(self) -> str:
        if self.method == "direct":
            sums = f"Direct sum over the height samples in float64, {self.coherence}"
            return f"{sums}: no approximation but the integral over λ. {self._scalar}"
        direction_range = f"for |(u, v)| up to {self.max_uv:.3g} and |w| {self.min_w:.3g} to {self.max_w:.3g}"
        how = "what bounds leave as a rule"
        if self.is_measured:
            how = f"measured on {self.validation_size} of the directions, which stand for all"
        start = (
            f"{LABELS[self.method]}, {self.coherence}, tolerance {self.tolerance:g}, {direction_range}. Predicted error "
            f"{self.error:.1e}, {how}: {self.terms} terms leave out {self.truncation:.1e}"
        )
        parts = [start]
        if self.coherence.kind != "replicas":
            parts.append(f"neighbours of a weight below {self.least_weight:.1e} leave out {self.neighbourhood:.1e}")
        if self.rings_per_octave:
            rays = f"{self.rings_per_octave} nodes an octave and {self.azimuths_per_width:g} rays a standard deviation"
            pixels = ", blurred for the range of (u, v) that a pixel sees," if self.uses_footprints else ""
            shared = f" and {self.w_basis_size} functions of w" if self.w_basis_size else ""
            parts.append(f"a polar table of {rays}{shared}{pixels} integrates to {self.quadrature:.1e}")
        elif self.wavelengths:
            spacing = "log λ" if self.coherence.kind == "source" else "1/λ"
            asides = [f"each divided by {self.subdivisions} for the copies' factor"] if self.subdivisions > 1 else []
            asides += ["fewer where coefficients pass slower"] if self.adaptive else []
            aside = f" ({', '.join(asides)})" if asides else ""
            spaced = f"{self.wavelengths} wavelengths equally spaced in {spacing}{aside}"
            parts.append(f"{spaced} integrate to {self.quadrature:.1e}")
        if self.light_sample_count > 1:
            parts.append(f"{self.light_sample_count} directions stand for the lights")
        if self.refined_share:
            parts.append(f"{100.0 * self.refined_share:.3g} % of the pixels were split into cells")
            if self.unconverged_share:
                parts.append(
                    f"after which {100.0 * self.unconverged_share:.2g} % are expected to err by more than the tolerance"
                )
        parts.append(f"float32 rounds by {self.rounding:.1e}")
        text = "; ".join(parts)
        text += f". The pitch folds back {self.aliasing:.1e} of the power of the steepest directions."
        if any(self.errors):
            text += " Estimated errors of the lit pixels: median {:.1e}, 99th percentile {:.1e}.".format(*self.errors)
        if self.energy_spread:
            text += (
                " Energy is normalised over all wavelengths together; single ones send back what comes in within "
                f"{self.energy_spread:.2g}."
            )
        text += f" Some {self.multiply_adds:.2g} multiply-adds a direction, {self.microseconds:.2g} µs of a core"
        return (
            text
            + (f", after {self.table_seconds:.2g} s for the table" if self.rings_per_octave else "")
            + f". {self._scalar}"
        )

    @property
    def _scalar(self) -> str:
        return f"Scalar theory itself: {scalar_validity.told(self.scalar_error)}."


def check_method(method: str, integration: str, coherence: Coherence) -> None:
    """Refuse a method, or its integration by a table, that a coherence does not support."""
    if _is_legal(method, integration, coherence):
        return
    why = f"expands powers, but coefficients of {ref('kind', coherence.kind)} add as amplitudes"
    if integration == "table":
        why = f"has no table for coherence of {ref('kind', coherence.kind)}"
    legal = [name for name in METHODS if _is_legal(name, integration, coherence)]
    others = f"use one of {', '.join(map(repr, legal))}" if legal else f"use {ref('integration', 'sampled')}"
    raise ArgumentValueError(f"{ref('method', method)} {why}: {others}")


def _is_legal(method: str, integration: str, coherence: Coherence) -> bool:
    """Whether a coherence supports a method and its integration."""
    if method in POWER_METHODS and not coherence.adds_powers:
        return False
    if integration != "table":
        return True
    return coherence.kind != "replicas" if method == "auto" else method != "direct" and has_table(method, coherence)


def has_table(expansion: str, coherence: Coherence) -> bool:
    """Whether tables of colours can be made for an expansion and a coherence: of what adds as the rows do."""
    return (
        coherence.kind != "replicas"
        and holds_powers(expansion, adds_powers=coherence.adds_powers) == coherence.adds_powers
    )
