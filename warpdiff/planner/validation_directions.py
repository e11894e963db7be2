"""Training and validation sets: samples of a call's directions, with edge cases.

A uniform sample of a call misses what decides where little of it is bright. So the geometry of thousands of directions
is examined. About a thousand of these are candidates: uniform ones, and all edge cases (near the mirror direction, near
strong orders, of the largest gain, at the ends of the call's ranges). A coarse plan finds how bright candidates are. A
search's training set and its validation set are drawn from them, nearly half of them for being bright. Each direction
weighs as much as the part of the call that it represents.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.kernels.thresholds import TINY
from warpdiff.optics.colorimetry import NM_PER_UM
from warpdiff.request.directions import order_rate, stratified
from warpdiff.tables import coefficient_table

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.request.directions import DirectionRange, DirectionSample
    from warpdiff.request.plan import Plan

# Number of candidates in addition to the edge cases, and number of training directions. Fitted: half as many miss the
# tolerance in more than one call of a hundred; twice as many cost twice the planning time.
_CANDIDATES, _TRAINING = 1024, 128
# Number of validation directions: more than for training, as they judge the result.
_VALIDATION = 2 * _TRAINING
# Number of edge cases of each kind, and of strong orders, each of which is a kind. Limit: all of them together are at
# most a third of the candidates.
_EDGE_CASES = 16
# Share of the edge cases in a set, relative to the share of a uniform sample of the call; bright directions have the
# same share as that sample. Limit: a fifth of a set remains for edge cases, however many they are.
_EDGE_CASE_SHARE = 0.25


def candidates(
    heightfield: HeightField, direction_range: DirectionRange, sample: DirectionSample, plan: Plan, *, threads: int
) -> tuple[DirectionSample, NDArray[np.bool_]]:
    """The candidates, and which of them are edge cases.

    Args:
        heightfield: The height field.
        direction_range: The range of the call.
        sample: Directions of the call.
        plan: A coarse plan, whose coefficients show where strong orders are.
        threads: Threads on the CPU.
    """
    edge_cases = np.zeros(0, dtype=np.int64)
    if len(sample) > _TRAINING + _VALIDATION:
        edge_cases = _edge_cases(heightfield, direction_range, sample, plan, threads=threads)
    others = np.setdiff1d(np.arange(len(sample)), edge_cases)
    uniform = others[stratified(len(others), _CANDIDATES)]
    chosen = np.concatenate([edge_cases, uniform])
    weights = sample.weights[chosen]
    weights[len(edge_cases) :] *= len(others) / max(len(uniform), 1)
    return sample.some(chosen, weights), np.arange(len(chosen)) < len(edge_cases)


def sampled(
    candidates: DirectionSample, is_edge_case: NDArray[np.bool_], luminance: NDArray[np.float64], floor: float
) -> tuple[DirectionSample, DirectionSample]:
    """Select training set and validation set among the candidates; of few directions, all are validation directions.

    Args:
        candidates: The candidates.
        is_edge_case: Which of them are edge cases, shape (n,).
        luminance: Approximate luminance of each, shape (n,).
        floor: Least luminance of a bright direction.
    """
    weights = candidates.weights
    bright = np.where(luminance >= 0.5 * floor, weights, 0.0)
    measure = weights / weights.sum() + _EDGE_CASE_SHARE * is_edge_case / max(int(is_edge_case.sum()), 1)
    measure = measure + bright / max(float(bright.sum()), TINY)
    order = np.argsort(luminance, kind="stable")
    if len(order) <= _TRAINING:
        return candidates, candidates
    both = _TRAINING + _VALIDATION
    if len(order) <= both:
        return _draw(candidates, order, measure, _TRAINING), candidates
    # Both sets get their share of few bright directions: each run in the order of brightness is divided among them.
    is_training = np.arange(len(order)) % (both // _TRAINING) == 0
    training, validation = order[is_training], order[~is_training]
    return (
        _draw(candidates, training, measure, _TRAINING, len(order) / len(training)),
        _draw(candidates, validation, measure, _VALIDATION, len(order) / len(validation)),
    )


def _draw(
    candidates: DirectionSample, among: NDArray[np.int64], measure: NDArray[np.float64], count: int,
    represents: float = 1.0,
) -> DirectionSample:  # fmt: skip
    """``count`` of some directions, drawn in proportion to a measure, evenly along their order, each at most once.

    Each direction of ``among`` represents so many.
    """
    if len(among) <= count:
        return candidates.some(among, represents * candidates.weights[among])
    share = measure[among] / measure[among].sum() * count
    # Directions that would be drawn more than once are drawn once, and the others more often.
    while (excess := share > 1.0).any():
        share[excess] = 1.0
        rest = share < 1.0
        share[rest] *= (count - np.count_nonzero(~rest)) / share[rest].sum()
    edges = np.cumsum(share)
    positions = np.arange(np.random.default_rng(1).uniform(), edges[-1], 1.0)
    places = np.minimum(np.searchsorted(edges, positions, side="right"), len(among) - 1)
    chosen = among[places]
    return candidates.some(chosen, represents * candidates.weights[chosen] / share[places])


def _edge_cases(
    heightfield: HeightField, direction_range: DirectionRange, sample: DirectionSample, plan: Plan, *, threads: int
) -> NDArray[np.int64]:
    """Directions that may decide, however few: near the mirror or an order, of large gain, at the ranges' ends."""
    u, v, w = sample.scattering_vectors.T
    across, light = np.hypot(u, v), sample.to_lights[:, 2]
    order_rates = order_rate(heightfield, plan.coherence, sample.scattering_vectors, sample.to_lights)
    # Each order is a kind: many directions near one of them say nothing of the few near another.
    order_light = _order_light(heightfield, direction_range, sample, plan, threads=threads)
    scores = [-across, sample.gains, *order_light.T, across, order_rates, w, -w, -light, light + w]
    return np.unique(np.concatenate([np.argpartition(score, -_EDGE_CASES)[-_EDGE_CASES:] for score in scores]))


def _order_light(
    heightfield: HeightField, direction_range: DirectionRange, sample: DirectionSample, plan: Plan, *, threads: int
) -> NDArray[np.float64]:
    """Logarithm of the light that directions may show of each of the strongest orders but the zeroth, shape (n, m)."""
    coefficients, block, grid = coefficient_table.coefficients_for(
        heightfield, plan.method, plan.coherence, direction_range,
        coefficient_table.neighbour_extent(plan, heightfield), terms=plan.terms, threads=threads,
    )  # fmt: skip
    strongest, powers = coefficients.strongest
    rows, columns = block.orders()
    row, column = np.unravel_index(strongest, (len(rows), len(columns)))
    q = np.stack([columns[column] / grid.lengths_um[1], rows[row] / grid.lengths_um[0]], axis=1)
    # The zeroth order is another kind.
    others = np.flatnonzero(q.any(axis=1))[:_EDGE_CASES]
    q, powers = q[others], powers[others]
    u = sample.scattering_vectors[:, :2]
    # The wavenumber in the visible band at which a direction is nearest to each order.
    foot = (u @ q.T) / np.maximum(np.sum(u * u, axis=1), TINY)[:, None]
    foot = np.clip(foot, NM_PER_UM / direction_range.lambda_max_nm, NM_PER_UM / direction_range.lambda_min_nm)
    away = (foot * u[:, :1] - q[:, 0]) ** 2 + (foot * u[:, 1:] - q[:, 1]) ** 2
    # The patch of replicas has no window: 1 µm² stands for its falloff.
    falloff_um2 = 1.0
    if plan.coherence.kind != "replicas":
        # A centred window's is that of amplitudes: with that of powers, valleys between orders are no edge cases, where
        # tables have their largest errors.
        falloff_um2 = coefficient_table.falloff_um2(plan.coherence, 0.5)
    strength = np.log(np.maximum(powers, TINY)) - falloff_um2 * away
    return np.asarray(strength + np.log(np.maximum(sample.gains, TINY))[:, None])
