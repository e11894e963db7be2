"""Strategy of a plan: direct sum, bounds, colour table or search, by method, number of directions and cost.

Bounds that hold for all directions of the range come first. Calls of few directions are computed by them; for many, a
search finds on a sample of the directions how much of the bounds is needed, or a colour table replaces the integral
over the wavelength.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

import numpy as np

from warpdiff.core import memory, validation
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.wording import ref
from warpdiff.diffraction.coefficient_basis import holds_powers
from warpdiff.diffraction.phase_series import EXPANSIONS, check_cycles
from warpdiff.heightfield import diagnostics
from warpdiff.kernels import refinement_levels
from warpdiff.optics import reflectance_factors
from warpdiff.optics.colorimetry import NM_PER_UM
from warpdiff.planner import bounds, coordinate_search, cost_model, refusals, table_ladder, trial
from warpdiff.request.directions import (
    MOST_SAMPLED,
    DirectionRange,
    DirectionSample,
    hemisphere_pairs,
    order_rate,
    stratified,
)
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.plan import AUTOMATIC, Plan, has_table
from warpdiff.request.settings import PlanSettings
from warpdiff.request.signatures import accepts
from warpdiff.tables import coefficient_table, polar_grid

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.spectra import Spectrum
    from warpdiff.request.keywords import PlanKeywords

# Cost of bounds over the cost of the plan that a search finds, by kind of coherence. Fitted: medians of 32 random calls
# (docs/decisions/plans_and_tolerance.md).
_SAVINGS = {"averaged": 2.6, "centred": 3.0, "source": 2.2, "replicas": 4.0}
# Number of directions that a plan from a search computes in the time of the search. Fitted: the same calls.
_SEARCH_DIRECTIONS = 16_000
# Least number of directions for which an explicit method that adds powers in float32 is tried: only a trial finds its
# rounding. Limit: fewer are not worth a second.
_FEWEST_TRIED = 16
# Assumed number of calls like this one that share the cost of a table. Limit: a picture that is worth a table is
# rendered again, with another light or view.
_EXPECTED_REPEATS = 3


@accepts(PlanSettings)
def plan(
    heightfield: HeightField, to_light: ArrayLike | None = None, to_view: ArrayLike | None = None, *,
    illuminant: str | Spectrum = "D65", **settings: Unpack[PlanKeywords],
) -> Plan:  # fmt: skip
    """Plan an evaluation of directions without computing it.

    Args:
        heightfield: The height field.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3); None is the whole hemisphere.
        to_view: Directions to the viewer, shape (3,) or (n, 3); None is the whole hemisphere.
        illuminant: Name in colour-science's ``SDS_ILLUMINANTS`` or ``SDS_LIGHT_SOURCES``, or a ``Spectrum``.

    Returns:
        The plan; ``print(plan)`` explains it.

    Raises:
        ToleranceError: The tolerance cannot be met, and ``strict`` is True.

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> plan = wd.plan(grating, (0, 0, 1), (0.3, 0.0, 1.0), tolerance=0.01)
        >>> plan.method, plan.tolerance
        ('jacobi-anger', 0.01)
    """
    request = Evaluation.of(heightfield, PlanSettings(**settings), illuminants=(illuminant,))
    with memory.as_memory_error("plan()", f"use a larger {ref('tolerance')}, or a smaller {ref('heightfield')}"):
        direction_range, sample, count = directions_of(request, to_light, to_view)
        result = plan_for(request, direction_range, sample, count)
    refusals.warn_of_scalar_error(heightfield, result)
    return result


def directions_of(
    request: Evaluation, to_light: ArrayLike | None = None, to_view: ArrayLike | None = None
) -> tuple[DirectionRange, DirectionSample, float]:
    """The range of directions, a sample of them, and their number; None is the whole hemisphere.

    A plan for directions that are not yet known is made for many.
    """
    heightfield, coherence = request.heightfield, request.coherence
    hemisphere_lights, hemisphere_views = hemisphere_pairs(MOST_SAMPLED, seed=0)
    if to_light is not None and to_view is not None:
        lights, views, _ = validation.light_and_view(to_light, to_view)
    else:
        lights = hemisphere_lights if to_light is None else _repeated(to_light, "to_light")
        views = hemisphere_views if to_view is None else _repeated(to_view, "to_view")
    count = float(len(lights)) if to_light is not None and to_view is not None else math.inf
    scattering_vectors, illuminated = -lights - views, (lights[:, 2] > 0.0) & (views[:, 2] > 0.0)
    direction_range = DirectionRange.of(heightfield, coherence, scattering_vectors, lights, illuminated)
    if to_light is None or to_view is None:
        known = views if to_light is None else lights
        direction_range = _any_direction(
            heightfield, coherence, direction_range, None if to_light is None and to_view is None else known
        )
    gains = reflectance_factors.gain(
        lights, views, normal=request.normal_reflectance, masking=request.masking,
        per_light_cosine=coherence.kind == "source",
    )  # fmt: skip
    return direction_range, DirectionSample.among(scattering_vectors, lights, gains), count


def _repeated(directions: ArrayLike, name: str) -> NDArray[np.float64]:
    """As many of some directions as represent the hemisphere, repeated where they are fewer."""
    checked, _ = validation.directions(directions, name)
    if not len(checked):
        return np.zeros((MOST_SAMPLED, checked.shape[1]))
    some = checked[stratified(len(checked), MOST_SAMPLED)]
    return np.asarray(some[np.arange(MOST_SAMPLED) % len(some)])


def _any_direction(
    heightfield: HeightField, coherence: Coherence, direction_range: DirectionRange, known: NDArray[np.float64] | None
) -> DirectionRange:
    """Return the range of the whole hemisphere on one side and of the known directions, or all, on the other."""
    max_uv = min_w = max_w = 0.0
    if known is None:
        max_uv, min_w, max_w = 2.0, 0.0, 2.0
    elif np.any(above := known[:, 2] > 0.0):
        z = known[above, 2]
        max_uv = 1.0 + float(np.max(np.hypot(known[above, 0], known[above, 1])))
        min_w, max_w = float(z.min()), 1.0 + float(z.max())
    # A grazing source has no largest bandwidth: directions beyond the sample's use the largest set of wavelengths.
    most = {"source": max(direction_range.max_order_rate, max_uv), "replicas": max_uv * max(heightfield.size_um)}
    return DirectionRange(min(max_uv, 2.0), most.get(coherence.kind, min(max_uv, 2.0)), min_w, max_w)


@single_threaded_blas()
def plan_for(request: Evaluation, direction_range: DirectionRange, sample: DirectionSample, count: float) -> Plan:
    """Return the plan for all directions of a range, which a search judges on a sample of them.

    There are ``count`` directions, or fewer where pixels show means.
    """
    heightfield, tolerance, method = request.heightfield, request.tolerance, _method(request)
    refusals.check_integration(request)
    if method != "direct":
        check_cycles(heightfield, direction_range.kappas[1])
    upper = bounds.upper_bound_plan(request, direction_range, method=method, tolerance=tolerance)
    refusals.check_size(heightfield, upper)
    refusals.warn_of_aliasing(heightfield, upper, direction_range)
    if method == "direct":
        return upper
    if request.footprint and not _has_footprint_table(request):
        count *= refinement_levels.rays_at(refinement_levels.LEAST_LEVEL_OF_POINTS)
    # It may take a basis of its own, which a search does not.
    unmeasured = functools.cache(functools.partial(_unmeasured, request, direction_range, sample, upper))
    affordable = _affordable_table_cost(request, unmeasured, count)
    if len(sample) and (affordable > 0.0 or _pays_to_search(request, upper, direction_range, count)):
        result = _measured(request, direction_range, sample, upper, affordable)
    else:
        result = unmeasured()
    if upper.truncation > tolerance * bounds.AMPLITUDE_MARGIN:
        # The series that all bases are made from and judged by ends too soon. Its remainder is that of an amplitude.
        truncation = max(result.truncation, upper.truncation / bounds.AMPLITUDE_MARGIN)
        result = replace(result, truncation=truncation)
    refusals.check_error(heightfield, result, strict=request.strict)
    return replace(result, footprint=request.footprint)


def _method(request: Evaluation) -> str:
    """The method: an explicit integration without a method is for the automatic expansion."""
    return AUTOMATIC if request.method == "auto" and request.integration != "auto" else request.method


def _has_footprint_table(request: Evaluation) -> bool:
    """Whether a table is to show means over footprints."""
    return request.footprint and request.coherence.adds_powers and _method(request) == "auto"


def _affordable_table_cost(request: Evaluation, unmeasured: Callable[[], Plan], count: float) -> float:
    """Multiply-adds that making a table may cost: what it saves so many directions of a plan by bounds; 0 for no table.

    A table that is asked for, or that shows footprints, may cost any number.
    """
    if request.integration == "table" or _has_footprint_table(request):
        return math.inf
    if _method(request) != "auto" or not request.integrates or not has_table(AUTOMATIC, request.coherence):
        return 0.0
    bounded = unmeasured()
    table_size = polar_grid.smallest_sufficient_size(bounded)
    if table_size is None:
        return 0.0
    rings, azimuths_per_width = table_size
    smallest = replace(bounded, method=AUTOMATIC, rings_per_octave=rings, azimuths_per_width=azimuths_per_width)
    directions = _EXPECTED_REPEATS * count - _SEARCH_DIRECTIONS
    saved = directions * bounded.multiply_adds / _SAVINGS[bounded.coherence.kind]
    return saved if saved > cost_model.table_multiply_adds(request.heightfield, smallest) else 0.0


def _pays_to_search(request: Evaluation, upper: Plan, direction_range: DirectionRange, count: float) -> bool:
    """Whether a search takes less time than it saves, or is needed because bounds do not hold."""
    # Bounds that were cut short for a source at the horizon are none, and may miss all light.
    if upper.max_order_rate < direction_range.max_order_rate:
        return True
    # Powers of coefficients that vanish with κ cancel in float32, which only a trial finds.
    if _method(request) != "auto" and holds_powers(upper.method, adds_powers=upper.coherence.adds_powers):
        return count >= _FEWEST_TRIED
    return count * (_SAVINGS[upper.coherence.kind] - 1.0) >= _SEARCH_DIRECTIONS


def _unmeasured(request: Evaluation, direction_range: DirectionRange, sample: DirectionSample, upper: Plan) -> Plan:
    """The plan from bounds, with the mean cost of some directions, where there are any."""
    if _method(request) == "auto":
        # Without a trial amplitudes are safer than powers, which cancel in float32, and take no longer.
        upper = bounds.upper_bound_plan(
            request, direction_range, method=trial.REFERENCE_METHOD, tolerance=request.tolerance
        )
    plan = _with_basis(bounds.with_neighbours_of_darkness(upper), request, direction_range)
    if not len(sample):
        return plan
    rates = order_rate(request.heightfield, plan.coherence, sample.scattering_vectors, sample.to_lights)
    cost = cost_model.sampling_multiply_adds(request.heightfield, plan, rates, np.abs(sample.scattering_vectors[:, 2]))
    return replace(plan, multiply_adds=cost)


def _with_basis(plan: Plan, request: Evaluation, direction_range: DirectionRange) -> Plan:
    """The plan with the terms that a fitted basis requires, and with the power that aliases."""
    if plan.method not in EXPANSIONS:
        basis, _, _ = coefficient_table.coefficients_for(
            request.heightfield, plan.method, plan.coherence, direction_range,
            coefficient_table.neighbour_extent(plan, request.heightfield), terms=plan.terms, threads=request.threads,
        )  # fmt: skip
        terms = basis.terms_within(trial.NEGLIGIBLE_SHARE * plan.tolerance)
        plan = replace(plan, terms=terms, truncation=float(basis.truncation_errors[terms]))
    highest = direction_range.max_uv * NM_PER_UM / direction_range.lambda_min_nm
    return replace(plan, aliasing=diagnostics.folded_power(request.heightfield, highest))


def _measured(
    request: Evaluation, direction_range: DirectionRange, sample: DirectionSample, upper: Plan, affordable: float
) -> Plan:
    """The plan that a search finds, with a table or without, or the bounds where all directions are dark.

    A table may cost ``affordable`` multiply-adds to make; 0 is none.
    """
    plan = _with_basis(upper, request, direction_range)
    measured = trial.Trial(plan, request, direction_range, sample, coarse=_coarse_plan(request, direction_range))
    is_truncated = upper.max_order_rate < direction_range.max_order_rate
    if not measured.any_light and not is_truncated:
        return plan
    footprint, explicit = _has_footprint_table(request), request.integration == "table"
    if affordable:
        table = table_ladder.smallest_table(plan, measured, footprint=footprint, needed=explicit, affordable=affordable)
        # Points instead of means have a larger error than a table that meets the tolerance without any safety.
        if table is not None and (
            explicit or table.error <= plan.tolerance * (trial.SEARCH_SAFETY if footprint else 1.0)
        ):
            return table
        if explicit:
            raise refusals.table_too_large(plan.tolerance)
    return coordinate_search.search(plan, measured, automatic=_method(request) == "auto")


def _coarse_plan(request: Evaluation, direction_range: DirectionRange) -> Plan:
    """A plan that only finds the bright directions, for the largest tolerance."""
    coarse = bounds.upper_bound_plan(request, direction_range, method=_method(request), tolerance=0.5)
    terms = coarse.terms if coarse.method in EXPANSIONS else min(coarse.terms, coefficient_table.LANES)
    # Bounds are generous: half of their wavelengths suffice.
    return replace(coarse, wavelengths=math.ceil(coarse.wavelengths / 2.0), terms=terms)
