"""Coordinate search: the cheapest sums over wavelengths that meet a tolerance on a call's directions.

Bounds suffice for the worst surface and the worst direction, and most calls require less. Each coordinate of a plan
(terms, neighbours, subdivisions, two parts of the bandwidth) is made as coarse as the error budget allows. The budget
grows from coordinate to coordinate, so that each can use what those before it have left. Errors are those of the
training set against a reference. The validation set judges the result; a plan that fails is refined where it helps
most.
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

# Number of repairs of a plan that fails on the validation set; each tries all coordinates, with twice the steps of the
# one before. Chosen so that a search has fewer than fifty trials.
_REPAIRS = 3
# Number of octaves by which a search coarsens a bandwidth. Chosen so that bounds exceed what one surface requires by
# less than this.
_OCTAVES = 3
# Every search, whatever its tolerance, tries only bandwidths that are a whole number of steps from the bandwidth for
# this tolerance. Otherwise a looser tolerance could cost a part of a step more than a tighter one.
_GRID_TOLERANCE = 1e-2
# Least number of bright validation directions that represent all bright directions of the call. Fitted: random calls
# with few bright directions (docs/decisions/plans_and_tolerance.md).
MIN_BRIGHT = 64
# With few bright directions, a search spends only this share of the error that is left. No predicted error is below
# this share of the tolerance. Fitted: the same calls.
_SHARE_BY_FEW = 0.1


@dataclass(frozen=True)
class Coordinate:
    """A number of a plan that a search changes in steps.

    Attributes:
        source: Field of the plan that has the error from this coordinate.
        budget: Error that a plan may have once this coordinate is set.
        most: Largest number of steps.
        coarser: Makes a plan coarser by a number of steps; finer if it is negative.
    """

    source: str
    budget: float
    most: int
    coarser: Callable[[Plan, int], Plan]


def search(plan: Plan, trial: Trial, *, automatic: bool) -> Plan:
    """The cheapest plan found that meets the tolerance on training set and validation set, with its errors.

    Args:
        plan: The plan from bounds.
        trial: Directions of the call.
        automatic: Whether the method may change.
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
        # The validation set finds powers that cancel, which the training set has missed.
        plan, error = refine(_by_amplitudes(plan, trial), trial, coordinates, target)
    # Each source has its share of the predicted error.
    share = predicted_error(error, plan, trial) / sum(errors.values())
    return replace(
        plan, truncation=share * errors["truncation"], neighbourhood=share * errors["neighbourhood"],
        quadrature=share * errors["quadrature"], rounding=share * errors["rounding"], is_measured=True,
        multiply_adds=_cost(plan, trial),
        validation_size=len(trial.validation_set),
    )  # fmt: skip


def predicted_error(error: float, plan: Plan, trial: Trial) -> float:
    """Predict the error of a call from the validation error; the factor is larger if the set is a part of the call."""
    factor = SEARCH_SAFETY if math.isinf(trial.bright[0]) else 2.0
    predicted = min(factor * error, max(SEARCH_SAFETY * error, plan.tolerance))
    return max(predicted, _SHARE_BY_FEW * plan.tolerance)


def refine(plan: Plan, trial: Trial, coordinates: Sequence[Coordinate], target: float) -> tuple[Plan, float]:
    """Refine a plan until its validation error is within the target; return it with this error."""
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
            # No coordinate helps alone, but all of them may.
            for coordinate in coordinates:
                best = coordinate.coarser(best, -steps)
            least = trial.validation_error(best)
            if least >= error:
                break
        plan, error = best, least
    return plan, error


def _cost(plan: Plan, trial: Trial) -> float:
    """Predicted multiply-adds per direction."""
    return cost_model.sampling_multiply_adds(trial.heightfield, plan, *trial.rates)


def more_terms(plan: Plan, trial: Trial, registers: int) -> Plan:
    """The plan with so many more SIMD registers of terms, as far as its basis has them; fewer if negative."""
    most = trial.most_terms(plan)
    terms = coefficient_table.lanes_of(plan.terms) + registers * LANES
    return replace(plan, terms=min(max(terms, min(LANES, most)), most))


def _coordinates(plan: Plan, trial: Trial, error: float, target: float) -> list[Coordinate]:
    """The coordinates of a plan, in the order in which they are searched."""

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
        # The training set may miss the few directions whose light comes almost only from far away from a bright order.
        most = math.floor(math.log(FLOOR * plan.tolerance / plan.least_weight))
        steps.append(("neighbourhood", by_mirror, max(most, 0) if by_mirror == 1.0 else 0, neighbours))
    if trial.integrates and plan.subdivisions > 1:
        steps.append(("quadrature", bright, octave_steps, subdivisions))
    if trial.integrates:
        # All parts of the bandwidth are coarsened together before each part alone: one part could use up the budget
        # that another one needs.
        steps += [("quadrature", bright, octave_steps, part) for part in (bandwidth, order_rate, rest)]
    return [
        Coordinate(source, error + share * max(target - error, 0.0) * number / len(steps), most, coarser)
        for number, (source, share, most, coarser) in enumerate(steps, 1)
    ]


def _coarsened(plan: Plan, error: float, trial: Trial, coordinate: Coordinate) -> tuple[Plan, float]:
    """The plan with the coarsest step of a coordinate that is within its budget, by bisection, and its error."""
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
        # Further steps of the bandwidth save nothing, and would be in the way of repairs.
        while low > 0 and replace(finer := coordinate.coarser(plan, low - 1), bandwidth_um=best.bandwidth_um) == best:
            best, low = finer, low - 1
    return best, error


def _octave_steps(steps: int) -> float:
    """The factor of a number of steps; one octave has ``SETS_PER_OCTAVE`` steps."""
    return float(2.0 ** (steps / SETS_PER_OCTAVE))


def _on_grid(plan: Plan, trial: Trial) -> Plan:
    """The plan whose neighbours and bandwidth are the nearest that a search of another tolerance would try as well."""
    plan = replace(plan, least_weight=math.exp(math.floor(math.log(plan.least_weight))))
    if not trial.integrates:
        return plan
    bandwidth_um = bounds.bandwidth_um(trial.heightfield, plan.coherence, _GRID_TOLERANCE)
    steps = round(SETS_PER_OCTAVE * math.log2(plan.bandwidth_um[0] / bandwidth_um[0]))
    return _with_bandwidth(plan, trial, _scaled(bandwidth_um, _octave_steps(steps), _octave_steps(steps)))


def _scaled(
    bandwidth_um: tuple[float, float, float], rate_factor: float, rest_factor: float
) -> tuple[float, float, float]:
    """A bandwidth with other factors of the order rate and of the rest."""
    per_rate, per_w, constant = bandwidth_um
    return rate_factor * per_rate, rest_factor * per_w, rest_factor * constant


def _with_bandwidth(plan: Plan, trial: Trial, bandwidth_um: tuple[float, float, float]) -> Plan:
    """The plan with another bandwidth and the wavelengths for it."""
    per_rate, per_w, constant = bandwidth_um
    # Bounds for a grazing source end at a largest number of wavelengths, and serve order rates up to a limit. If a
    # smaller bandwidth suffices, the same number of wavelengths serves larger rates, too.
    served = ((plan.wavelengths - 1.0) / cost_model.SPAN - per_w * plan.max_w - constant) / per_rate
    rate = max(plan.max_order_rate, min(served, trial.max_order_rate))
    result = replace(plan, bandwidth_um=bandwidth_um, max_order_rate=rate)
    count = coefficient_table.wavelength_set_size(cost_model.wavelength_count(result, rate, plan.max_w))
    # Wavelengths times subdivisions, the samples of the periods' factor, must not decrease.
    divisions = math.ceil(plan.subdivisions * plan.wavelengths / count) if plan.subdivisions > 1 else 1
    return replace(result, wavelengths=count, subdivisions=divisions)


def _by_amplitudes(plan: Plan, trial: Trial) -> Plan:
    """The plan by the amplitudes of the reference, which do not cancel in float32."""
    return replace(plan, method=trial.reference.method, terms=trial.reference.terms)


def _sufficient(plan: Plan, trial: Trial, target: float, *, automatic: bool) -> tuple[Plan, float]:
    """A plan whose training error leaves half of the target, or the nearest that is found, with this error.

    Powers of coefficients that vanish with a high power of κ cancel in float32; amplitudes do not. Bounds may require
    more wavelengths for a source at the horizon, where they are cut short, and for very tall surfaces.
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
        # With too few samples to find an order, twice as many need not reduce the error yet: the loop goes on. With
        # enough samples, an error that does not halve is the rounding of float32.
        if wider_error > error / 2.0 and wider.wavelengths >= needed:
            break
        plan, error = wider, wider_error
    return plan, error
