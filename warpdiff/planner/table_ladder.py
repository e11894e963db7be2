"""Table ladder: search for the smallest colour table that meets a tolerance on the validation directions.

A colour table holds colours on a polar grid over (u, v), the tangential components of the scattering vector. Tables
have a few sizes, in ascending order. The size sets the number of rings (circles of samples) of the polar grid. The
validation directions are a sample of the call's directions. A trial measures the error of a table on them, against a
more accurate reference plan. A plan holds the numbers of a computation. The target is the largest accepted error: the
tolerance divided by a safety factor.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from warpdiff.diffraction.phase_series import EXPANSIONS
from warpdiff.planner import cost_model
from warpdiff.planner.coordinate_search import MIN_BRIGHT, predicted_error
from warpdiff.planner.trial import SEARCH_SAFETY
from warpdiff.request.plan import MOST_W_BASIS, W_BASIS_STEP
from warpdiff.tables import mip_layout, polar_grid
from warpdiff.tables.coefficient_table import LANES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpdiff.planner.trial import Trial
    from warpdiff.request.plan import Plan


# A search for the smallest sufficient colour table first tries the smallest one whose expected error is at most this
# share of the tolerance. The share was fitted to the planning times of 32 calls of ``wd.reflectance`` and similar
# functions (docs/decisions/plans_and_tolerance.md). If the share was doubled, the first table would miss the tolerance
# in half of the calls, and another table would have to be computed.
_FIRST_SHARE = 0.35
# A search for a colour table tries a larger one only if the present table has reduced the error enough: to at most this
# number times the least error of the tables before. In addition, the present error must be at most twice the error that
# the order of convergence predicts. The number must exceed 0.6, because the smallest step of the table size, to 1.3
# times as many rings, reduces the error to 0.6 times its value.
_HELPS = 0.7


def smallest_table(plan: Plan, trial: Trial, *, footprint: bool, needed: bool, affordable: float) -> Plan | None:
    """Return a plan with the smallest colour table whose validation error meets the target, or with the best table.

    The target is the tolerance divided by ``SEARCH_SAFETY``. The search computes a table of each size that it tries.
    These tables stay in the cache, and the call that follows uses the last one. The result is None if no table was
    computed: no size was expected to suffice, or all sizes were too large or too costly. The result is also None if the
    error of the best table exceeds the target, unless ``needed`` or ``footprint`` is True.

    Args:
        plan: Upper-bound plan.
        trial: Training and validation directions of the call, and the reference plan for them.
        footprint: Whether pixels show means over their footprints (ranges of (u, v)).
        needed: Whether the caller requests a table by ``integration="table"``.
        affordable: Largest cost of computing a table [multiply-adds].
    """
    target = plan.tolerance / SEARCH_SAFETY
    if plan.coherence.kind == "source":
        # The colour table of a light source of finite size excludes directions near the mirror direction. These
        # directions are computed by sampled wavelengths. For them, the plan needs the same least weight of Fourier
        # coefficients as the reference plan.
        plan = replace(plan, least_weight=trial.reference.least_weight)
    plan, truncation = _few_terms(plan, trial, target / 2.0)
    sizes = polar_grid.table_sizes(plan.coherence)
    size = _first_size(plan, trial, needed=needed or footprint)
    best, least, w_basis_size = None, math.inf, 0
    sampled_error: float | None = None
    last_rings = 0
    while size is not None:
        rings, azimuths_per_width = sizes[size]
        candidate = trial.with_w_basis(
            replace(plan, rings_per_octave=rings, azimuths_per_width=azimuths_per_width, w_basis_size=w_basis_size)
        )
        table_cost = cost_model.table_multiply_adds(trial.heightfield, candidate)
        if mip_layout.megabytes(candidate) > polar_grid.MOST_MEGABYTES or table_cost > affordable:
            if not needed or best is not None or size == 0:
                break
            # If the caller requests a colour table and the first size of the table is too large or too costly, the
            # search tries the next smaller size.
            size -= 1
            continue
        if best is None:
            trial.update_floors(candidate)
        error = trial.validation_error(candidate)
        before, least = least, min(error, least)
        if error < before:
            best = _measured(candidate, trial, error, truncation, table_cost, footprint=footprint)
        if error <= target:
            break
        more_terms = min(plan.terms + LANES // 2, trial.most_terms(plan))
        if sampled_error is None and more_terms > plan.terms:
            # The number of basis functions (terms) of the Fourier coefficients is only an estimate. After the first
            # failure of a table, the search therefore measures the error of sampled wavelengths with the same number of
            # terms. If this error is too large as well, the terms cause it, and the search uses more terms.
            sampled_error = trial.validation_error(plan)
            if sampled_error > target / 2.0:
                plan, truncation = replace(plan, terms=more_terms), sampled_error
            if error < 2.0 * sampled_error:
                continue
        larger = _next_size(sizes, size, error / target, candidate if needed else None)
        helps = last_rings == 0 or error <= min(2.0 * (last_rings / rings) ** polar_grid.ERROR_ORDER, _HELPS) * before
        last_rings = rings
        if not w_basis_size and (not helps or (larger is None and error <= 2.0 * plan.tolerance)):
            # If more rings (circles of samples in the table) do not reduce the error, or if no larger size exists, the
            # search increases the number of functions of w in the table. w is the normal component of the scattering
            # vector.
            w_basis_size = min(candidate.w_basis_size + W_BASIS_STEP, MOST_W_BASIS)
            continue
        size = larger if helps else None
    return best if needed or footprint or least <= target else None


def _first_size(plan: Plan, trial: Trial, *, needed: bool) -> int | None:
    """Return the index of the first table size to try, or None if no size is expected to suffice.

    If a table is ``needed``, the result is a middle size instead of None.
    """
    # The expected errors are larger in two cases: if diffraction orders are far apart, and if few validation directions
    # (sampled directions of the call) are bright. In the second case, the validation set misses bright directions of
    # the call.
    few_orders = polar_grid.orders_are_separate(trial.heightfield, plan.coherence) or trial.bright[1] < MIN_BRIGHT
    sizes = polar_grid.table_sizes(plan.coherence)
    errors = [polar_grid.table_error(rings, few_orders=few_orders) for rings, _ in sizes]
    return next(
        (k for k, error in enumerate(errors) if error <= _FIRST_SHARE * plan.tolerance),
        len(sizes) // 2 if needed else None,
    )


def _measured(plan: Plan, trial: Trial, error: float, truncation: float, table_cost: float, *, footprint: bool) -> Plan:
    """Return the plan of a colour table with the errors and costs that are predicted for this table.

    The errors are predicted from ``error``, which a trial has measured on the validation set, sampled directions of a
    call. ``table_cost`` is the cost of computing the table [multiply-adds].
    """
    predicted = predicted_error(error, plan, trial)
    return replace(
        plan, footprint=footprint, truncation=min(truncation, predicted), neighbourhood=0.0,
        quadrature=max(0.0, predicted - truncation), rounding=0.0, is_measured=True,
        multiply_adds=cost_model.look_up_multiply_adds(plan), table_multiply_adds=table_cost,
        validation_size=len(trial.validation_set),
    )  # fmt: skip


def _next_size(sizes: Sequence[tuple[int, float]], size: int, excess: float, explicit: Plan | None) -> int | None:
    """Return the index of the next table size to try, or None if no size is expected to suffice.

    The error of the present size exceeds the target (largest accepted error) by the factor ``excess``. Rings are
    circles of samples of the table. The order of convergence predicts the first size whose error is within the target.
    The next size has at most twice the rings of the present size, because small tables converge more slowly than the
    order of convergence predicts. If no size suffices, a plan that requires a table (``explicit``) continues with the
    largest size that fits into memory and has at most twice the rings.
    """
    rings = sizes[size][0]
    larger = range(size + 1, len(sizes))
    within = [k for k in larger if sizes[k][0] <= 2 * rings]
    for k in larger:
        if excess * (rings / sizes[k][0]) ** polar_grid.ERROR_ORDER <= 1.0:
            return min(k, within[-1])
    if explicit is None:
        return None
    fitting = [
        k
        for k in within
        if mip_layout.megabytes(replace(explicit, rings_per_octave=sizes[k][0], azimuths_per_width=sizes[k][1]))
        <= polar_grid.MOST_MEGABYTES
    ]
    return fitting[-1] if fitting else None


def _few_terms(plan: Plan, trial: Trial, budget: float) -> tuple[Plan, float]:
    """Return a plan with the fewest terms whose truncation error is at most ``budget``, and this error.

    A term is a function of κ = w/λ that is fitted to the Fourier coefficients. A trial measures the error of a plan
    with ``LANES`` terms, as many as fill one SIMD register. For more terms, this error is scaled in proportion to the
    truncation errors of the fit.
    """
    if plan.method in EXPANSIONS or plan.terms <= LANES:
        return plan, 0.0
    errors = trial.fitted(plan).truncation_errors
    error = trial.validation_error(
        replace(plan, terms=LANES, wavelengths=trial.reference.wavelengths, least_weight=trial.reference.least_weight)
    )
    for terms in range(LANES, plan.terms):
        expected = error * float(errors[terms] / errors[LANES])
        if expected <= budget:
            return replace(plan, terms=terms), expected
    return plan, 0.0
