"""Plan search: the cheapest plan that meets a tolerance on a training set and on a validation set.

Bounds hold for the worst surface and the worst direction, and ask for more work than most scenes need. A hundred of a
call's own directions, computed a few dozen times over, tell how much that is, in the time of some ten thousand. Each
source of error is measured by itself against what the bounds ask for, twice as fine; the plan that results is judged as
a whole on directions that the search has not seen, and made finer until it holds there.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.diffraction.phase_series import EXPANSIONS
from warpdiff.planner import cost_model
from warpdiff.request.plan import W_BASIS_STEP
from warpdiff.tables import coefficient_table, mip_layout, polar_grid

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from warpdiff.planner.trial import Trial
    from warpdiff.request.plan import Plan

# The sample stands for the call, whose error may be this much larger.
SEARCH_SAFETY = 1.6
# Shares of what is left of the tolerance.
_NEIGHBOUR_SHARE, _TERMS_SHARE, _QUADRATURE_SHARE = 0.25, 0.3, 0.45
# The exponent of the least weight is tried in these steps, and is at least one of them.
_EXPONENT_STEP = 0.5
# Factors on the parts of the bandwidth, as powers of two.
_RATE_STEPS = np.arange(1.0, -4.01, -0.25)
_HEIGHT_STEPS = np.arange(0.0, -3.01, -1.0)
_COLOUR_STEPS = np.arange(2.5, -4.01, -0.5)
# Up to so many times the lateral of bright training set these tell how little of its bound suffices; else this is the
# least.
_TRUSTED_RATE_FACTOR, _LEAST_RATE_STEP = 2.0, -0.25
_TRIES = 6
# A table is made for each try: of those that are expected to err by about the target, and then of those that will do by
# what it errs. The largest take seconds, and are not the first.
_LIKELY_SHARE, _ALWAYS_MEASURED_FROM_RINGS, _PROMISING_FACTOR = 0.85, 48, 1.25
# More functions of w, which make look-ups dearer, are tried up to so many targets, taken where they leave so little.
_MENDED_BY_W_BASIS, _WORTH_W_BASIS = 4.0, 0.9
_WIDENINGS = 3
# What a validation set finds wanting gets so much more of the least weight's exponent, a register more of terms or half
# an octave more of wavelengths, whichever mends most, where that leaves so little of the error.
_REPAIRS, _MORE_EXPONENT, _WORTH_A_REPAIR = 8, 2.0, 0.95
# The least weight is at most a thousandth, a picture's floor, of the tolerance: training set may miss the few
# directions that see the tail of a bright order and little else.
_LEAST_WEIGHT_SHARE = 1e-3
# A set's errors scatter: a whole plan may exceed its share by this factor, which the safety covers.
_SCATTER_FACTOR = 1.2
_SUBDIVISION_SHARE = 0.3
# Of so few bright directions in the validation set, others may err by more: terms and wavelengths get this share of
# theirs, or wavelengths are left as the bounds have them, and neighbours end where a mirror's light is lost in the
# dark. Tables, whose errors fall slowly with their size, get a larger share.
_ENOUGH_BRIGHT, _FEWEST_BRIGHT, _SHARE_BY_FEW, _TABLE_SHARE_BY_FEW = 64, 8, 0.1, 0.5
# Predicted errors, in those of a validation set that stands for others, if it has enough bright directions and if it
# has few.
_PREDICTED_PER_ERROR, _PREDICTED_PER_ERROR_BY_FEW = 2.0, 2.5
# And no less than this share of the tolerance, which no few hundred directions vouch for.
_LEAST_PREDICTED_SHARE = 0.1
# Error of a fitted basis in float32, measured against the direct sum.
_ROUNDING_OF_POWERS, _ROUNDING_OF_AMPLITUDES = 3e-6, 5e-6
# Sets of wavelengths that err by so many tolerances in the median end the search for smaller ones.
_HOPELESS_FACTOR = 10.0


def search_sampled(plan: Plan, trial: Trial, *, automatic: bool) -> Plan:
    """The cheapest plan found that keeps the tolerance on the training set, its errors as measured.

    Args:
        plan: The plan from bounds.
        trial: Some of the call's directions.
        automatic: Whether the method may change.
    """
    target = plan.tolerance / SEARCH_SAFETY
    plan = dataclasses.replace(plan, least_weight=trial.reference.least_weight)
    by_mirror, bright = trial.bright
    terms_share = (1.0 if by_mirror >= _ENOUGH_BRIGHT else _SHARE_BY_FEW) * _TERMS_SHARE
    fewer, truncation, rounding = _fewer_terms(plan, trial, terms_share * target)
    if rounding > target and automatic:
        # Powers of coefficients that vanish with a high power of κ cancel in float32; amplitudes do not.
        plan = dataclasses.replace(plan, method=trial.reference.method, terms=trial.reference.terms)
        fewer, truncation, rounding = _fewer_terms(plan, trial, terms_share * target)
    plan, neighbourhood, quadrature = fewer, 0.0, 0.0
    if by_mirror >= _ENOUGH_BRIGHT:
        plan, neighbourhood = _fewer_neighbours(plan, trial, _NEIGHBOUR_SHARE * target)
    if trial.integrates and bright >= _FEWEST_BRIGHT:
        # Errors fall so fast with the number of wavelengths that a wide margin takes few more.
        margin = 1.0 if bright >= _ENOUGH_BRIGHT else _SHARE_BY_FEW
        plan, quadrature = _fewer_wavelengths(plan, trial, margin * _QUADRATURE_SHARE * target)
    plan, error = refine(plan, trial, target)
    if error > target and automatic and plan.method != trial.reference.method:
        # What a validation set finds that cancels, and training set have not seen.
        amplitudes = dataclasses.replace(plan, method=trial.reference.method, terms=trial.reference.terms)
        plan, error = refine(amplitudes, trial, target)
    # The sources in proportion to what each leaves out, as much as the whole is wrong by.
    share = predicted_error(error, plan, trial) / (truncation + neighbourhood + quadrature + rounding)
    return dataclasses.replace(
        plan, truncation=share * truncation, neighbourhood=share * neighbourhood, quadrature=share * quadrature,
        rounding=share * rounding,
        multiply_adds=cost_model.sampling_multiply_adds(trial.heightfield, plan, *trial.rates), is_measured=True,
        validation_size=len(trial.validation_set),
    )  # fmt: skip


def search_table(plan: Plan, trial: Trial, *, footprint: bool, needed: bool, affordable: float) -> Plan | None:
    """The smallest polar table that the validation set finds within the tolerance, or the best of those within reach.

    A table is made for each attempt and found again by the call that follows, which adds the levels for footprints.
    None where all are too large, or err too much for points.

    Args:
        plan: The plan from bounds.
        trial: Some of the call's directions.
        footprint: Whether pixels show means.
        needed: Whether the finest is to be tried, however little it promises.
        affordable: Multiply-adds that making one may take.
    """
    table_share = 1.0 if footprint or trial.bright[1] >= _ENOUGH_BRIGHT else _TABLE_SHARE_BY_FEW
    target = plan.tolerance / SEARCH_SAFETY * table_share
    if plan.coherence.kind == "source":
        # What surrounds the mirror direction is sampled.
        plan = dataclasses.replace(plan, least_weight=trial.reference.least_weight)
    plan, truncation = _likely_terms(plan, trial, _TERMS_SHARE * target)
    # What hardly any of the validation set tells, the largest error that tables make does.
    few_orders = polar_grid.orders_are_separate(trial.heightfield, plan.coherence) or trial.bright[1] < _FEWEST_BRIGHT
    sizes = polar_grid.table_sizes(plan.coherence)
    best, least = None, math.inf
    likely = [
        table_size
        for table_size in sizes
        if polar_grid.table_error(table_size[0], few_orders=few_orders) <= _LIKELY_SHARE * target
        or table_size[0] >= _ALWAYS_MEASURED_FROM_RINGS
    ]
    size = 0
    by_terms: float | None = None
    while likely:
        rings, azimuths_per_width = likely.pop(0)
        candidate = dataclasses.replace(
            plan, rings_per_octave=rings, azimuths_per_width=azimuths_per_width, w_basis_size=size
        )
        candidate = trial.with_w_basis(candidate)
        table_cost = cost_model.table_multiply_adds(trial.heightfield, candidate)
        if mip_layout.megabytes(candidate) > polar_grid.MOST_MEGABYTES or table_cost > affordable:
            break
        if best is None:
            trial.update_floors(candidate)
        error = trial.validation_error(candidate)
        if target < error <= _MENDED_BY_W_BASIS * target and not size:
            # What more nodes do not mend may be more functions of w.
            size = candidate.w_basis_size
            richer = trial.with_w_basis(candidate, W_BASIS_STEP)
            if richer.w_basis_size > size and (richer_error := trial.validation_error(richer)) < _WORTH_W_BASIS * error:
                candidate, error, size = richer, richer_error, richer.w_basis_size
        predicted = predicted_error(error, plan, trial)
        if error < least:
            least = error
            best = dataclasses.replace(
                candidate, footprint=footprint, truncation=min(truncation, predicted), neighbourhood=0.0,
                quadrature=max(0.0, predicted - truncation), rounding=0.0,
                multiply_adds=cost_model.look_up_multiply_adds(candidate), table_multiply_adds=table_cost,
                is_measured=True, validation_size=len(trial.validation_set),
            )  # fmt: skip
        if error <= target:
            break
        # Training set may have missed what takes more terms.
        longer = more_terms(plan, trial)
        if longer is not None and by_terms is None:
            by_terms = trial.validation_error(plan)
        if longer is not None and by_terms is not None and by_terms > _TERMS_SHARE * target:
            plan, truncation, by_terms = longer, by_terms, None
            likely.insert(0, (rings, azimuths_per_width))
        else:
            hoped = _PROMISING_FACTOR * target
            promising = [
                table_size
                for table_size in likely
                if error * (rings / table_size[0]) ** polar_grid.ERROR_ORDER <= hoped
            ]
            likely = promising or (_largest_sizes(likely, candidate) if needed else [])
    return best if needed or footprint or least <= target else None


def _largest_sizes(table_sizes: list[tuple[int, float]], plan: Plan) -> list[tuple[int, float]]:
    """The finest of some sizes that a table may have, if there is one."""
    sizes = [
        (table_size, dataclasses.replace(plan, rings_per_octave=table_size[0], azimuths_per_width=table_size[1]))
        for table_size in table_sizes
    ]
    return [table_size for table_size, sized in sizes if mip_layout.megabytes(sized) <= polar_grid.MOST_MEGABYTES][-1:]


def predicted_error(error: float, plan: Plan, trial: Trial) -> float:
    """Predict the error from the validation error: larger, the less the set represents the call."""
    per_error = _PREDICTED_PER_ERROR if trial.bright[1] >= _ENOUGH_BRIGHT else _PREDICTED_PER_ERROR_BY_FEW
    factor = SEARCH_SAFETY if math.isinf(trial.bright[0]) else per_error
    predicted = min(factor * error, max(SEARCH_SAFETY * error, plan.tolerance))
    return max(predicted, _LEAST_PREDICTED_SHARE * plan.tolerance)


def _likely_terms(plan: Plan, trial: Trial, share: float) -> tuple[Plan, float]:
    """The fewest terms within their share and what they leave out, by one try and the residuals of the fitted basis.

    More terms are another kernel, which a table does not need.
    """

    def truncation_error(terms: int) -> float:
        candidate = dataclasses.replace(plan, terms=terms, wavelengths=trial.reference.wavelengths)
        return trial.validation_error(dataclasses.replace(candidate, least_weight=trial.reference.least_weight))

    if plan.method in EXPANSIONS:
        return _fewest_terms(plan, plan.terms, share, truncation_error)
    errors = trial.fitted(plan).truncation_errors
    most = len(errors) - 1
    if most <= coefficient_table.LANES:
        return dataclasses.replace(plan, terms=most), 0.0
    error = truncation_error(coefficient_table.LANES)
    for terms in range(coefficient_table.LANES, most):
        expected = error * float(errors[terms] / errors[coefficient_table.LANES])
        if expected <= share:
            return dataclasses.replace(plan, terms=terms), expected
    return dataclasses.replace(plan, terms=most), 0.0


def refine(plan: Plan, trial: Trial, target: float) -> tuple[Plan, float]:
    """Refine a plan until its validation error is within the target; return it with this error."""
    trial.update_floors(plan)
    error = trial.validation_error(plan)
    for _ in range(_REPAIRS):
        if error <= target:
            break
        candidates = [(trial.validation_error(candidate), candidate) for candidate in _repairs(plan, trial)]
        least, best = min(candidates, key=lambda candidate: candidate[0])
        if least >= _WORTH_A_REPAIR * error:
            # What none of them mends alone may be two of them.
            best = _repairs(_repairs(plan, trial)[0], trial)[-1]
            least = trial.validation_error(best)
            if least >= error:
                break
        plan, error = best, least
    return plan, error


def _repairs(plan: Plan, trial: Trial) -> list[Plan]:
    """The plan with more neighbours, with more terms if there are any, and with more wavelengths if it takes some."""
    deeper = min(plan.least_weight * math.exp(-_MORE_EXPONENT), trial.reference.least_weight)
    repairs = [dataclasses.replace(plan, least_weight=deeper)]
    longer = more_terms(plan, trial)
    if longer is not None:
        repairs.append(longer)
    if plan.wavelengths:
        a, b, c = (math.sqrt(2.0) * part for part in plan.bandwidth_um)
        more = coefficient_table.wavelength_set_size(math.sqrt(2.0) * plan.wavelengths)
        repairs.append(dataclasses.replace(plan, bandwidth_um=(a, b, c), wavelengths=more))
    return repairs


def more_terms(plan: Plan, trial: Trial) -> Plan | None:
    """The plan with a register more of terms, if there are any."""
    most = plan.terms if plan.method in EXPANSIONS else trial.fitted(plan).terms
    terms = min(coefficient_table.lanes_of(plan.terms) + coefficient_table.LANES, most)
    return dataclasses.replace(plan, terms=terms) if terms > plan.terms else None


def _fewer_neighbours(plan: Plan, trial: Trial, share: float) -> tuple[Plan, float]:
    """The least exponent whose neighbourhood is within its share, by bisection, and the error that it leaves."""
    if plan.coherence.kind == "replicas":
        return plan, 0.0
    reference_values = trial.run(plan)

    def attempt(steps: int) -> tuple[Plan, float]:
        candidate = dataclasses.replace(plan, least_weight=math.exp(-steps * _EXPONENT_STEP))
        return candidate, trial.error(trial.run(candidate), reference_values)

    most = math.floor(-math.log(plan.least_weight) / _EXPONENT_STEP)
    best, error = plan, 0.0
    low, high = min(math.ceil(-math.log(_LEAST_WEIGHT_SHARE * plan.tolerance) / _EXPONENT_STEP), most) - 1, most
    while high - low > 1:
        middle = (low + high) // 2
        candidate, candidate_error = attempt(middle)
        if candidate_error <= share:
            high, best, error = middle, candidate, candidate_error
        else:
            low = middle
    return best, error


def _fewer_terms(plan: Plan, trial: Trial, share: float) -> tuple[Plan, float, float]:
    """The fewest terms within their share, in whole SIMD registers; what they leave out, and float32's error."""
    exact = trial.run(dataclasses.replace(plan, method=trial.reference.method, terms=trial.reference.terms))

    def truncation_error(terms: int) -> float:
        return trial.error(trial.run(dataclasses.replace(plan, terms=terms)), exact)

    most = plan.terms if plan.method in EXPANSIONS else trial.fitted(plan).terms
    fewer, truncation = _fewest_terms(plan, most, share, truncation_error)
    rounding = _rounding(plan)
    if not truncation:
        # As many terms as there are leave out nothing that shows: the rest is float32's.
        rounding = max(rounding, truncation_error(fewer.terms))
    return fewer, truncation, rounding


def _rounding(plan: Plan) -> float:
    """Error of a basis in float32 as a rule."""
    return _ROUNDING_OF_POWERS if plan.coherence.adds_powers else _ROUNDING_OF_AMPLITUDES


def _fewest_terms(plan: Plan, most: int, share: float, truncation_error: Callable[[int], float]) -> tuple[Plan, float]:
    """The fewest terms within their share, in whole SIMD registers, and what they leave out: all that there are, 0."""
    for terms in range(coefficient_table.LANES, most, coefficient_table.LANES):
        error = truncation_error(terms)
        if error <= share:
            return dataclasses.replace(plan, terms=terms), error
    return dataclasses.replace(plan, terms=most), 0.0


def _fewer_wavelengths(plan: Plan, trial: Trial, share: float) -> tuple[Plan, float]:
    """The least bandwidth whose integral is within its share, and the error that it leaves."""
    plan = _fewer_subdivisions(plan, trial, share)
    plan, exact = _wide_enough(plan, trial, share)
    per_sample = plan.subdivisions * plan.wavelengths
    for bandwidth in _bandwidths(plan, trial, share, exact):
        a, b, c = bandwidth
        # As many wavelengths serve a grazing source, for which bounds were cut short, nearer to the horizon.
        order_rate = min(((plan.wavelengths - 1.0) / cost_model.SPAN - b * plan.max_w - c) / a, trial.max_order_rate)
        adapted = dataclasses.replace(plan, bandwidth_um=bandwidth, max_order_rate=max(plan.max_order_rate, order_rate))
        most = cost_model.wavelength_count(adapted, adapted.max_order_rate, adapted.max_w)
        adapted = dataclasses.replace(
            adapted, wavelengths=coefficient_table.wavelength_set_size(min(most, 2.0 * plan.wavelengths))
        )
        if plan.subdivisions > 1:
            adapted = dataclasses.replace(adapted, subdivisions=math.ceil(per_sample / adapted.wavelengths))
        error = trial.error(trial.run(adapted), exact)
        if error <= share * _SCATTER_FACTOR:
            return adapted, error
    return plan, trial.error(trial.run(plan), exact)


def _wide_enough(plan: Plan, trial: Trial, share: float) -> tuple[Plan, NDArray[np.float64]]:
    """The plan, widened where its bounds do not suffice, and what twice its wavelengths make of all training set.

    Bounds are for what oscillates; a surface much higher than a wavelength may take a little more than they say.
    """

    def against_twice(candidate: Plan) -> tuple[NDArray[np.float64], float]:
        candidate = dataclasses.replace(candidate, adaptive=False)
        exact = trial.run(dataclasses.replace(candidate, wavelengths=2 * candidate.wavelengths - 1))
        return exact, trial.error(trial.run(candidate), exact)

    exact, error = against_twice(plan)
    # For a source at the horizon bounds were cut short: what is too sparse to see an order need not err less at once.
    bound = cost_model.wavelength_count(plan, float(trial.order_rate.max()), float(trial.w.max()))
    for _ in range(_WIDENINGS):
        if error <= share:
            break
        a, b, c = (2.0 * part for part in plan.bandwidth_um)
        more = coefficient_table.wavelength_set_size(2.0 * plan.wavelengths)
        wider = dataclasses.replace(plan, bandwidth_um=(a, b, c), wavelengths=more)
        values, new_error = against_twice(wider)
        if new_error > error / 2.0 and wider.wavelengths >= bound:
            # What does not fall is float32's.
            break
        plan, exact, error = wider, values, new_error
    if plan.wavelengths > 1.5 * trial.reference.wavelengths:
        trial.refine_reference(plan)
    return plan, exact


def _bandwidths(
    plan: Plan, trial: Trial, share: float, exact: NDArray[np.float64]
) -> Iterator[tuple[float, float, float]]:
    """Bandwidths to try: the cheapest that gives each training direction enough wavelengths, and wider ones."""
    per_sample = plan.subdivisions * plan.wavelengths
    sizes: list[int] = []
    errors: list[NDArray[np.float64]] = []
    size = coefficient_table.wavelength_set_size(plan.wavelengths)
    while not sizes or (size < sizes[-1] and np.median(errors[-1]) < _HOPELESS_FACTOR * plan.tolerance):
        divisions = math.ceil(per_sample / size) if plan.subdivisions > 1 else 1
        values = trial.run(dataclasses.replace(plan, wavelengths=size, subdivisions=divisions, adaptive=False))
        sizes.append(size)
        errors.append(trial.errors(values, exact))
        size = coefficient_table.wavelength_set_size(size * 2.0 ** (-1.0 / coefficient_table.SETS_PER_OCTAVE))

    # Of a source, grazing light is foreshortened beyond what bright training set tell of.
    bright_rate = float(np.max(trial.order_rate, initial=0.0, where=trial.training_set.above.all(axis=0)))
    known_to = plan.coherence.kind != "source" or bright_rate * _TRUSTED_RATE_FACTOR >= trial.max_order_rate
    rate_steps = _RATE_STEPS if known_to else _RATE_STEPS[_RATE_STEPS >= _LEAST_RATE_STEP]
    factors = np.stack(np.meshgrid(rate_steps, _HEIGHT_STEPS, _COLOUR_STEPS, indexing="ij"), axis=-1)
    parts = 2.0 ** factors.reshape(-1, 3) * plan.bandwidth_um
    counts = 1.0 + cost_model.SPAN * (
        np.outer(parts[:, 0], trial.order_rate) + np.outer(parts[:, 1], trial.w) + parts[:, 2:]
    )
    # Rounded down to a size that was tried; nothing below the smallest was.
    which = len(sizes) - np.searchsorted(sizes[::-1], counts, side="right")
    known = which.max(axis=1) < len(sizes)
    parts, counts, which = parts[known], counts[known], which[known]
    by_size = np.stack(errors)
    fit = trial.passes(np.moveaxis(by_size[which, :, np.arange(counts.shape[1])], 2, 1), share)
    if fit.any():
        a, b, c = parts[fit][np.argmin(counts[fit] @ trial.training_set.weights)].tolist()
        for factor in 2.0 ** (np.arange(_TRIES) / coefficient_table.SETS_PER_OCTAVE):
            yield float(factor) * a, float(factor) * b, float(factor) * c


def _fewer_subdivisions(plan: Plan, trial: Trial, share: float) -> Plan:
    """Fewer samples of the copies' factor, as long as they leave a small part of the share."""
    if plan.subdivisions == 1:
        return plan
    reference_values = trial.run(plan)
    while plan.subdivisions > 1:
        candidate = dataclasses.replace(plan, subdivisions=math.floor(plan.subdivisions / 1.2))
        if trial.error(trial.run(candidate), reference_values) > _SUBDIVISION_SHARE * share:
            break
        plan = candidate
    return plan
