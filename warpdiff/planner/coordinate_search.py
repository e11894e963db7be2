"""Coordinate search: finds the cheapest plan with sampled wavelengths that meets a tolerance on a call's directions.

A plan holds the numbers of a computation. Upper-bound plans suffice for the worst surface and the worst direction; most
calls require less. The search changes a plan along coordinates: the number of terms of its series, the number of
neighbouring Fourier coefficients that a direction includes, and the bandwidth with its two parts, which sets the number
of wavelengths. Replicated patches also have a number of subdivisions: samples of the interference factor per
wavelength.

The search makes one coordinate after the other as coarse as an error budget permits. The budget grows from coordinate
to coordinate; the part of the budget that one coordinate does not use remains for the coordinates after it. The
training set and the validation set are samples of the directions of the call. A trial measures errors on these sets
against a reference plan, which has more wavelengths. The search uses the errors on the training set. The validation set
then checks the result. If the result fails, the coordinate with the largest effect is refined. The target is the
largest accepted error on the sets: the tolerance divided by a safety factor.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal. The floor is the smallest number by which an error is
divided to give a relative error. A direction is bright if its luminance is at least the floor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from warpdiff.kernels.thresholds import FLOOR
from warpdiff.planner import bounds, cost_model
from warpdiff.planner.trial import SEARCH_SAFETY
from warpdiff.tables import coefficient_table
from warpdiff.tables.coefficient_table import LANES, SETS_PER_OCTAVE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from warpdiff.planner.trial import Trial
    from warpdiff.request.plan import Plan

# Largest number of repairs of a plan whose error on the validation set (sampled directions of a call) is too large. A
# repair refines each coordinate (a parameter, such as the number of terms) of the plan separately, and uses the best of
# the resulting plans. The first repair refines by one step. Each further repair refines by twice as many steps as the
# repair before. The value was chosen so that a search tries fewer than fifty plans.
_REPAIRS = 3
# Largest number of factors of 2 by which a search reduces a bandwidth, the number of wavelength samples per unit of
# 1/λ. Upper bounds are less than 2³ times as large as the bandwidth that calls require.
_OCTAVES = 3
# Tolerance that defines the grid of bandwidths that searches try. The bandwidth is the number of wavelength samples per
# unit of 1/λ. The grid has the values 2^(n/SETS_PER_OCTAVE) times the upper bound of the bandwidth at this tolerance,
# where n is a whole number. It is the same for all calls. Without a common grid, a call with a larger tolerance could
# get a slightly more expensive plan than a call with a smaller one.
_GRID_TOLERANCE = 1e-2
# Number of bright validation directions below which a search uses only a part of its error budget. A direction is
# bright if its luminance is at least about 1e-3 of that of the brightest ones. Validation directions are a sample of
# the directions of a call, on which the plan is checked. If too few validation directions are bright, these few do
# not represent all bright directions of the call. The number was fitted to random calls with few bright directions
# (docs/decisions/plans_and_tolerance.md).
MIN_BRIGHT = 64
# If fewer than MIN_BRIGHT validation directions are bright, a search uses only this share of its remaining error
# budget. Validation directions are sampled directions that check a plan. The same number has a second use: the error
# that a plan predicts is at least this share of the tolerance. The number was fitted to random calls with few bright
# directions (docs/decisions/plans_and_tolerance.md).
_SHARE_BY_FEW = 0.1


@dataclass(frozen=True)
class Coordinate:
    """Parameter of a plan, such as its number of terms, that a search changes in steps.

    Attributes:
        source: Name of the plan's field that reports the error of this coordinate.
        budget: Largest permitted error of a plan on the training set (sampled directions) after this coordinate is
            coarsened.
        most: Largest number of steps by which a search coarsens this coordinate.
        coarser: Function that returns a plan coarsened by a number of steps; a negative number refines it.
    """

    source: str
    budget: float
    most: int
    coarser: Callable[[Plan, int], Plan]


def search(plan: Plan, trial: Trial, *, automatic: bool) -> Plan:
    """Search for the cheapest plan that meets the tolerance on the training set and the validation set.

    Both sets are samples of the directions of the call.

    Args:
        plan: Upper-bound plan.
        trial: Trial, which evaluates plans on sampled directions of the call.
        automatic: Whether the search may replace the method of the plan by the method of the reference plan, which is
            more accurate in float32.

    Returns:
        Plan with its predicted errors.
    """
    target = plan.tolerance / SEARCH_SAFETY
    plan = _on_grid(more_terms(replace(plan, least_weight=trial.reference.least_weight), trial, 0), trial)
    plan, error = _sufficient(plan, trial, target, automatic=automatic)
    errors = dict.fromkeys(("truncation", "neighbourhood", "quadrature"), 0.0)
    errors["rounding"] = max(error, target * FLOOR)
    coordinates = _coordinates(plan, trial, error, target)
    for coordinate in coordinates:
        plan, coarser_error = _coarsened(plan, error, trial, coordinate)
        errors[coordinate.source] += max(coarser_error - error, 0.0)
        error = coarser_error
    plan, error = refine(plan, trial, coordinates, target)
    if error > target and automatic and plan.method != trial.reference.method:
        # A method that expands powers |H|² of Fourier coefficients H in a series has large terms of both signs. In some
        # directions these terms cancel, so that float32 loses most digits. If only the validation set (sampled
        # directions that check the plan) contains such directions, this error becomes visible only at the end of a
        # search. A method that expands the amplitudes H does not have this error.
        plan, error = refine(_by_amplitudes(plan, trial), trial, coordinates, target)
    # The predicted error of the plan (numbers of the computation) is divided among its sources, such as truncation and
    # rounding, in proportion to the errors that the search has measured for these sources of error.
    share = predicted_error(error, plan, trial) / sum(errors.values())
    return replace(
        plan, truncation=share * errors["truncation"], neighbourhood=share * errors["neighbourhood"],
        quadrature=share * errors["quadrature"], rounding=share * errors["rounding"], is_measured=True,
        multiply_adds=_cost(plan, trial),
        validation_size=len(trial.validation_set),
    )  # fmt: skip


def predicted_error(error: float, plan: Plan, trial: Trial) -> float:
    """Predict the error of a call from the error of its plan on the validation set.

    The validation set is a sample of the directions of the call. The prediction is the error on this set times a
    factor. The factor is larger if the call has more directions than the validation set.
    """
    factor = SEARCH_SAFETY if math.isinf(trial.bright[0]) else 2.0
    predicted = min(factor * error, max(SEARCH_SAFETY * error, plan.tolerance))
    return max(predicted, _SHARE_BY_FEW * plan.tolerance)


def refine(plan: Plan, trial: Trial, coordinates: Sequence[Coordinate], target: float) -> tuple[Plan, float]:
    """Refine a plan until its error on the validation set is at most ``target``; return the plan and this error.

    The target is the largest accepted error. The validation set is a sample of the directions of a call; it checks the
    plan that a search has found.
    """
    trial.update_floors(plan)
    error = trial.validation_error(plan)
    for repair in range(_REPAIRS):
        if error <= target:
            break
        steps = 1 << repair
        tried = [(error, plan)]
        for coordinate in coordinates:
            finer = coordinate.coarser(plan, -steps)
            if finer != plan:
                tried.append((trial.validation_error(finer), finer))
        if sufficient := [entry for entry in tried if entry[0] <= target]:
            least, best = min(sufficient, key=lambda entry: _cost(entry[1], trial))
        else:
            least, best = min(tried, key=lambda entry: entry[0])
        if best == plan:
            # If no coordinate (parameter of the plan) reduces the error when it alone is refined, all coordinates are
            # refined together.
            for coordinate in coordinates:
                best = coordinate.coarser(best, -steps)
            least = trial.validation_error(best)
            if least >= error:
                break
        plan, error = best, least
    return plan, error


def _cost(plan: Plan, trial: Trial) -> float:
    """Return the predicted cost of evaluating a direction by a plan, the numbers of a computation [multiply-adds]."""
    return cost_model.sampling_multiply_adds(trial.heightfield, plan, *trial.rates)


def more_terms(plan: Plan, trial: Trial, registers: int) -> Plan:
    """Return the plan with more series terms: as many as fill ``registers`` further SIMD registers, or all that exist.

    With a negative ``registers``, the plan gets fewer terms.
    """
    most = trial.most_terms(plan)
    terms = coefficient_table.lanes_of(plan.terms) + registers * LANES
    return replace(plan, terms=min(max(terms, min(LANES, most)), most))


def _coordinates(plan: Plan, trial: Trial, error: float, target: float) -> list[Coordinate]:
    """Return the coordinates (the parameters that a search changes) of a plan, in the order of the search."""

    def neighbours(plan: Plan, steps: int) -> Plan:
        least = trial.reference.least_weight
        return replace(plan, least_weight=max(plan.least_weight * math.exp(steps), min(plan.least_weight, least)))

    def subdivisions(plan: Plan, steps: int) -> Plan:
        return replace(plan, subdivisions=math.ceil(plan.subdivisions * _octave_steps(-steps)))

    def bandwidth(plan: Plan, steps: int) -> Plan:
        return _with_bandwidth(plan, trial, _scaled(plan.bandwidth_um, _octave_steps(-steps), _octave_steps(-steps)))

    def order_rate(plan: Plan, steps: int) -> Plan:
        return _with_bandwidth(plan, trial, _scaled(plan.bandwidth_um, _octave_steps(-steps), 1.0))

    def rest(plan: Plan, steps: int) -> Plan:
        return _with_bandwidth(plan, trial, _scaled(plan.bandwidth_um, 1.0, _octave_steps(-steps)))

    by_mirror, bright = (1.0 if count >= MIN_BRIGHT else _SHARE_BY_FEW for count in trial.bright)
    registers = math.ceil(plan.terms / LANES)
    octave_steps = _OCTAVES * SETS_PER_OCTAVE
    steps: list[tuple[str, float, int, Callable[[Plan, int], Plan]]] = [
        ("truncation", by_mirror, registers - 1, lambda plan, steps: more_terms(plan, trial, -steps))
    ]
    if plan.coherence.kind != "replicas":
        # In a few directions, nearly all light belongs to the tail of a bright diffraction order, far from the peak of
        # the order, and the training set, a small sample of the directions, may not contain them. The search therefore
        # never excludes Fourier coefficients whose Gaussian weight is at least FLOOR times the tolerance.
        most = math.floor(math.log(FLOOR * plan.tolerance / plan.least_weight))
        steps.append(("neighbourhood", by_mirror, max(most, 0) if by_mirror == 1.0 else 0, neighbours))
    if trial.integrates and plan.subdivisions > 1:
        steps.append(("quadrature", bright, octave_steps, subdivisions))
    if trial.integrates:
        # The bandwidth is the number of wavelength samples per unit of 1/λ. It is a sum of three parts: for the order
        # rate (how fast diffraction orders pass a direction as 1/λ changes), for |w|, and for the colour-matching
        # functions. The search first coarsens all parts together. It then coarsens the part for the order rate alone,
        # and after this the other two parts. In the opposite sequence, the part for the order rate could use the whole
        # error budget.
        steps += [("quadrature", bright, octave_steps, part) for part in (bandwidth, order_rate, rest)]
    return [
        Coordinate(source, error + share * max(target - error, 0.0) * number / len(steps), most, coarser)
        for number, (source, share, most, coarser) in enumerate(steps, 1)
    ]


def _coarsened(plan: Plan, error: float, trial: Trial, coordinate: Coordinate) -> tuple[Plan, float]:
    """Coarsen a coordinate (parameter) of a plan by bisection, as far as its error budget permits.

    Return the coarsened plan and its error on the training set, a sample of the directions of a call.
    """
    best, low, high = plan, 0, coordinate.most + 1
    middle = coordinate.most
    while high - low > 1:
        candidate = coordinate.coarser(plan, middle)
        candidate_error = trial.training_error(candidate)
        if candidate_error <= coordinate.budget:
            best, error, low = candidate, candidate_error, middle
        else:
            high = middle
        middle = (low + high) // 2
    if best.wavelengths == coefficient_table.wavelength_set_size(0.0):
        # The plan has the smallest possible number of wavelengths. Further steps of the search reduced only the
        # bandwidth (samples per unit of 1/λ) that the plan records, and saved no time. The loop undoes these steps.
        # Otherwise a repair, which refines by steps, would first have to undo them.
        while low > 0 and replace(finer := coordinate.coarser(plan, low - 1), bandwidth_um=best.bandwidth_um) == best:
            best, low = finer, low - 1
    return best, error


def _octave_steps(steps: int) -> float:
    """Return the factor by which a bandwidth changes in ``steps`` steps: 2 for ``SETS_PER_OCTAVE`` steps.

    The bandwidth is the number of wavelength samples per unit of 1/λ.
    """
    return float(2.0 ** (steps / SETS_PER_OCTAVE))


def _on_grid(plan: Plan, trial: Trial) -> Plan:
    """Return the plan with its least weight and its bandwidth rounded to the grid of values that all searches try.

    The least weight is the smallest Gaussian weight of Fourier coefficients that the plan includes. The bandwidth is
    the number of wavelength samples per unit of 1/λ.
    """
    plan = replace(plan, least_weight=math.exp(math.floor(math.log(plan.least_weight))))
    if not trial.integrates:
        return plan
    bandwidth_um = bounds.bandwidth_um(trial.heightfield, plan.coherence, _GRID_TOLERANCE)
    steps = round(SETS_PER_OCTAVE * math.log2(plan.bandwidth_um[0] / bandwidth_um[0]))
    return _with_bandwidth(plan, trial, _scaled(bandwidth_um, _octave_steps(steps), _octave_steps(steps)))


def _scaled(
    bandwidth_um: tuple[float, float, float], rate_factor: float, rest_factor: float
) -> tuple[float, float, float]:
    """Return the bandwidth (a, b, c) times factors: (a · ``rate_factor``, b · ``rest_factor``, c · ``rest_factor``).

    The bandwidth states how many wavelength samples a direction requires; ``bounds.bandwidth_um`` defines a, b and c.
    """
    per_rate, per_w, constant = bandwidth_um
    return rate_factor * per_rate, rest_factor * per_w, rest_factor * constant


def _with_bandwidth(plan: Plan, trial: Trial, bandwidth_um: tuple[float, float, float]) -> Plan:
    """Return the plan with a new bandwidth (wavelength samples per unit of 1/λ) and its number of wavelengths."""
    per_rate, per_w, constant = bandwidth_um
    # If a light source of finite size is near the horizon, the number of wavelengths is limited, and the plan is valid
    # only up to a certain order rate (how fast orders pass a direction as 1/λ changes). With a smaller bandwidth, the
    # same number of wavelengths suffices for larger order rates, up to `served`. The new plan is then valid for these
    # rates, too.
    served = ((plan.wavelengths - 1.0) / cost_model.SPAN - per_w * plan.max_w - constant) / per_rate
    rate = max(plan.max_order_rate, min(served, trial.max_order_rate))
    result = replace(plan, bandwidth_um=bandwidth_um, max_order_rate=rate)
    count = coefficient_table.wavelength_set_size(cost_model.wavelength_count(result, rate, plan.max_w))
    # The interference factor of replicated periods is sampled ``subdivisions`` times per wavelength. Fewer wavelengths
    # require more subdivisions, so that the number of samples does not decrease.
    divisions = math.ceil(plan.subdivisions * plan.wavelengths / count) if plan.subdivisions > 1 else 1
    return replace(result, wavelengths=count, subdivisions=divisions)


def _by_amplitudes(plan: Plan, trial: Trial) -> Plan:
    """Return the plan with the method of the reference plan, which expands the amplitudes of Fourier coefficients.

    This method remains accurate where the terms of a series of powers cancel in float32.
    """
    return replace(plan, method=trial.reference.method, terms=trial.reference.terms)


def _sufficient(plan: Plan, trial: Trial, target: float, *, automatic: bool) -> tuple[Plan, float]:
    """Refine a plan until its error on the training set is at most half of ``target``, or as small as possible.

    The target is the largest accepted error. The training set is a sample of the directions of a call. Return the
    refined plan and its error. An upper-bound plan needs this in two cases. First, its method may add powers of Fourier
    coefficients. Coefficients that vanish like a high power of κ = w/λ are then differences of large terms, which
    cancel in float32. A method that adds amplitudes does not have this error. Second, the number of wavelengths of an
    upper-bound plan is limited. It is too small for very tall surfaces, and for light sources near the horizon.
    """
    error = trial.training_error(plan)
    if error > target / 2.0 and automatic and plan.method != trial.reference.method:
        amplitudes = _by_amplitudes(plan, trial)
        error_of_amplitudes = trial.training_error(amplitudes)
        if error_of_amplitudes < error / 2.0:
            plan, error = amplitudes, error_of_amplitudes
    needed = cost_model.wavelength_count(plan, float(trial.order_rate.max()), float(trial.w.max()))
    while trial.integrates and error > target / 2.0 and 2 * plan.wavelengths <= bounds.MOST_WAVELENGTHS:
        wider = _with_bandwidth(plan, trial, _scaled(plan.bandwidth_um, 2.0, 2.0))
        trial.refine_reference(wider)
        wider_error = trial.training_error(wider)
        # As long as a plan has too few wavelengths to resolve an order (`needed`), its error may not decrease when
        # their number is doubled. The loop then doubles it again. If a plan has enough wavelengths, doubling their
        # number at least halves the error of the integral. An error that remains is then the rounding error of float32,
        # and the loop ends.
        if wider_error > error / 2.0 and wider.wavelengths >= needed:
            break
        plan, error = wider, wider_error
    return plan, error
