"""Strategy of the planner: selects the direct sum, upper bounds, a colour table or a search, by predicted cost.

An evaluation method is either a method that adds powers |H|² of Fourier coefficients H, or a method that adds the
amplitudes H. "Source" means a light source of finite size (coherence of the kind "source").

A plan holds the method and the numbers of a computation, such as the number of wavelengths. The planner first computes
an upper-bound plan, which suffices for all directions of the range. Calls with few directions use this plan. For many
directions, a search finds a cheaper plan, or a colour table replaces the integral over the wavelength. In a search, a
trial measures the errors of plans on a sample of the directions.
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

# Typical cost of evaluating directions by an upper-bound plan (numbers that suffice for any surface), divided by the
# cost by the cheaper plan that a search finds, for each kind of coherence. The numbers were fitted: they are medians of
# 32 random calls (docs/decisions/plans_and_tolerance.md).
_SAVINGS = {"averaged": 2.6, "centred": 3.0, "source": 2.2, "replicas": 4.0}
# Cost of a search for a cheap plan (numbers of a computation), expressed as a number of directions. In the time of a
# search, the plan that it finds could evaluate this number of directions. The number was fitted to 32 random calls.
_SEARCH_DIRECTIONS = 16_000
# If the caller selects a method that adds powers, a trial (an evaluation of sampled directions) measures the rounding
# error of this method in float32. The trial is made only for calls with at least this number of directions. The number
# was chosen because a trial requires about a second, which fewer directions do not justify.
_FEWEST_TRIED = 16
# Assumed number of calls that use the same colour table. It exceeds 1 because pictures are often rendered again with
# another light or view. If the number is doubled, the planner prefers a table already for calls with about half as many
# directions.
_EXPECTED_REPEATS = 3


@accepts(PlanSettings)
def plan(
    heightfield: HeightField, to_light: ArrayLike | None = None, to_view: ArrayLike | None = None, *,
    illuminant: str | Spectrum = "D65", **settings: Unpack[PlanKeywords],
) -> Plan:  # fmt: skip
    """Plan an evaluation of directions without computing it.

    Args:
        heightfield: Height field to evaluate.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3); None is the whole hemisphere.
        to_view: Directions to the viewer in the local frame, shape (3,) or (n, 3); None is the whole hemisphere.
        illuminant: Name in colour-science's ``SDS_ILLUMINANTS`` or ``SDS_LIGHT_SOURCES``, or a ``Spectrum``.

    Returns:
        Plan; ``print(plan)`` explains it.

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
        return plan_for(request, direction_range, sample, count)


def directions_of(
    request: Evaluation, to_light: ArrayLike | None = None, to_view: ArrayLike | None = None
) -> tuple[DirectionRange, DirectionSample, float]:
    """Return the range of the directions of a call, a sample of these directions, and their number.

    None for ``to_light`` or ``to_view`` means all directions of the hemisphere. The number of directions then counts as
    infinite.
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
    if len(lights) and not illuminated.any():
        refusals.warn_of_darkness()
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
    """Return ``MOST_SAMPLED`` of ``directions``; if there are fewer, the list of all of them is repeated."""
    checked, _ = validation.unit_directions(directions, name)
    if not len(checked):
        return np.zeros((MOST_SAMPLED, checked.shape[1]))
    some = checked[stratified(len(checked), MOST_SAMPLED)]
    return np.asarray(some[np.arange(MOST_SAMPLED) % len(some)])


def _any_direction(
    heightfield: HeightField, coherence: Coherence, direction_range: DirectionRange, known: NDArray[np.float64] | None
) -> DirectionRange:
    """Return the range of all pairs of a light and a view direction of which only one direction is known.

    If ``known`` is None, both directions of a pair may be anywhere in the hemisphere.
    """
    max_uv = min_w = max_w = 0.0
    if known is None:
        max_uv, min_w, max_w = 2.0, 0.0, 2.0
    elif np.any(above := known[:, 2] > 0.0):
        z = known[above, 2]
        max_uv = 1.0 + float(np.max(np.hypot(known[above, 0], known[above, 1])))
        min_w, max_w = float(z.min()), 1.0 + float(z.max())
    # The order rate of a light source of finite size (how fast diffraction orders pass a direction as 1/λ changes) has
    # no upper limit near the horizon. The range therefore ends at the largest rate of the sampled directions.
    # Directions with a larger rate are evaluated with the largest number of wavelengths of the plan.
    most = {"source": max(direction_range.max_order_rate, max_uv), "replicas": max_uv * max(heightfield.size_um)}
    return DirectionRange(min(max_uv, 2.0), most.get(coherence.kind, min(max_uv, 2.0)), min_w, max_w)


@single_threaded_blas()
def plan_for(request: Evaluation, direction_range: DirectionRange, sample: DirectionSample, count: float) -> Plan:
    """Return the plan for all directions of a range. A search for this plan uses only the sampled directions.

    ``count`` is the number of directions of the call. If a pixel shows the mean over several directions, ``count`` is
    the number of pixels.
    """
    heightfield, tolerance, method = request.heightfield, request.tolerance, _method(request)
    refusals.check_integration(request)
    if method != "direct":
        check_cycles(heightfield, direction_range.kappas[1])
    upper = bounds.upper_bound_plan(request, direction_range, method=method, tolerance=tolerance)
    refusals.check_size(heightfield, upper)
    refusals.warn_of_aliasing(heightfield, upper, direction_range)
    refusals.warn_of_theory(upper)
    if method == "direct":
        return upper
    if request.footprint and not _has_footprint_table(request):
        count *= refinement_levels.rays_at(refinement_levels.LEAST_LEVEL_OF_POINTS)
    # `unmeasured` completes the upper-bound plan with its number of terms. It is a function, which is called only if it
    # is needed: the number may require a slow fit of the Fourier coefficients by basis functions of κ = w/λ.
    unmeasured = functools.cache(functools.partial(_unmeasured, request, direction_range, sample, upper))
    affordable = _affordable_table_cost(request, unmeasured, count)
    if len(sample) and (affordable > 0.0 or _pays_to_search(request, upper, direction_range, count)):
        result = _measured(request, direction_range, sample, upper, affordable)
    else:
        result = unmeasured()
    if upper.truncation > tolerance * bounds.AMPLITUDE_MARGIN:
        # Even with the largest permitted number of terms, the truncation error of the series is too large. A trial
        # cannot measure this error, because its reference plan uses the same series. The plan therefore reports the
        # upper bound of the error of amplitudes, converted to an error of the result.
        truncation = max(result.truncation, upper.truncation / bounds.AMPLITUDE_MARGIN)
        result = replace(result, truncation=truncation)
    refusals.check_error(request, result)
    return replace(result, footprint=request.footprint)


def _method(request: Evaluation) -> str:
    """Return the evaluation method that the caller requests.

    If the caller sets ``integration`` but no method, ``"low-rank"`` replaces ``"auto"``.
    """
    return AUTOMATIC if request.method == "auto" and request.integration != "auto" else request.method


def _has_footprint_table(request: Evaluation) -> bool:
    """Whether pixels show means over footprints (ranges of (u, v)) that a colour table with mip levels can compute."""
    return request.footprint and request.coherence.adds_powers and _method(request) == "auto"


def _affordable_table_cost(request: Evaluation, unmeasured: Callable[[], Plan], count: float) -> float:
    """Return the largest cost [multiply-adds] at which a colour table saves time for ``count`` directions; 0 for none.

    A colour table saves time if it costs less than the evaluation of the directions by the plan of a search. The result
    is infinite if the caller requests a table, or means over the ranges of (u, v) of pixels, which a table computes.
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
    """Whether a search for a plan saves more time than it requires, or is necessary as the upper-bound plan fails."""
    # For a light source of finite size near the horizon, the number of wavelengths of the upper-bound plan is limited.
    # With too few wavelengths, the plan misses orders, and a search must find another plan.
    if upper.max_order_rate < direction_range.max_order_rate:
        return True
    # In a method that adds powers, Fourier coefficients that vanish towards κ = w/λ = 0 may lose all digits in float32,
    # because large terms of the series cancel. Only a trial (a test on sampled directions) measures this error.
    if _method(request) != "auto" and holds_powers(upper.method, adds_powers=upper.coherence.adds_powers):
        return count >= _FEWEST_TRIED
    return count * (_SAVINGS[upper.coherence.kind] - 1.0) >= _SEARCH_DIRECTIONS


def _unmeasured(request: Evaluation, direction_range: DirectionRange, sample: DirectionSample, upper: Plan) -> Plan:
    """Return the upper-bound plan with its number of terms, aliased power and mean cost, without measured errors."""
    if _method(request) == "auto":
        # Without a trial (a test on sampled directions), a method that adds amplitudes is selected, because series of
        # powers may lose their digits in float32. Trials are omitted only if a call has few directions. For few
        # directions, methods that add amplitudes do not cost more than methods that add powers.
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
    """Return the plan with its number of terms, and with the share of power that aliases (``Plan.aliasing``).

    If the method of the plan fits basis functions of κ = w/λ to the coefficients, the terms are these functions.
    """
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
    """Search for the cheapest plan that meets the tolerance in a sample of directions, with or without a colour table.

    If no light is scattered in any of these directions, errors cannot be measured. The result is then ``upper``, the
    plan from upper bounds of the error, unless ``upper`` has fewer wavelengths than its bounds require. ``affordable``
    is the largest cost of a table [multiply-adds]; 0 excludes tables.
    """
    plan = _with_basis(upper, request, direction_range)
    measured = trial.Trial(plan, request, direction_range, sample, coarse=_coarse_plan(request, direction_range))
    is_truncated = upper.max_order_rate < direction_range.max_order_rate
    if not measured.any_light and not is_truncated:
        return plan
    footprint, explicit = _has_footprint_table(request), request.integration == "table"
    if affordable:
        table = table_ladder.smallest_table(plan, measured, footprint=footprint, needed=explicit, affordable=affordable)
        # If pixels show means over footprints (their ranges of (u, v)), a table is accepted even if it meets the
        # tolerance only without the safety factor. Without a table, such a mean would be taken over a few single
        # directions, which has a larger error.
        if table is not None and (
            explicit or table.error <= plan.tolerance * (trial.SEARCH_SAFETY if footprint else 1.0)
        ):
            return table
        if explicit:
            raise refusals.table_too_large(plan.tolerance)
    return coordinate_search.search(plan, measured, automatic=_method(request) == "auto")


def _coarse_plan(request: Evaluation, direction_range: DirectionRange) -> Plan:
    """Return a cheap, inaccurate plan (numbers of a computation), which only finds the bright directions of a call."""
    coarse = bounds.upper_bound_plan(request, direction_range, method=_method(request), tolerance=0.5)
    terms = coarse.terms if coarse.method in EXPANSIONS else min(coarse.terms, coefficient_table.LANES)
    # The numbers of an upper-bound plan suffice for any surface. To find bright directions, half of the wavelengths of
    # such a plan suffice.
    return replace(coarse, wavelengths=math.ceil(coarse.wavelengths / 2.0), terms=terms)
