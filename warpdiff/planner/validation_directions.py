"""Training and validation sets: samples of a call's directions, with edge cases.

A uniform sample of a call misses what decides where little of it is bright. So geometry alone is looked at for
thousands of directions; of these, a thousand are watched, uniform ones and all that are suspect (near the mirror
direction, near strong orders, of the largest gain, at the ends of the call's ranges), with a coarse plan that tells how
bright they are. Of the watched, a search's training set and its validation set are drawn, nearly half of them for being
bright. Each direction weighs as much as the part of the call that it stands for.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.request.directions import order_rate, stratified
from warpdiff.tables import coefficient_table

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.request.directions import DirectionRange, DirectionSample
    from warpdiff.request.plan import Plan

# Directions whose brightness is looked at, besides the suspects; those that a search tries plans on; those that judge
# what it found.
_CANDIDATES, _TRAINING, _VALIDATION = 1024, 128, 256
# Suspects of each kind, and the orders that count as strong.
_NEAR_MIRROR, _OF_LARGEST_GAIN, _AT_EACH_END = 32, 32, 12
_STRONG_ORDERS, _NEAR_EACH_ORDER, _NEAR_ORDERS = 24, 4, 64
# How often bright directions and suspects are drawn, where those that stand for the call are drawn once.
_BRIGHT_SHARE, _EDGE_CASE_SHARE = 1.0, 0.25
_SEED = 1


def candidates(
    heightfield: HeightField, direction_range: DirectionRange, sample: DirectionSample, plan: Plan, *, threads: int
) -> tuple[DirectionSample, NDArray[np.bool_]]:
    """The directions whose brightness is looked at, and which of them are suspects.

    Args:
        heightfield: The height field.
        direction_range: The call's.
        sample: Directions of the call.
        plan: A coarse one, whose coefficients tell where strong orders are.
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
        candidates: What is watched.
        is_edge_case: Which of them are suspects, shape (n,).
        luminance: How bright they are, about, shape (n,).
        floor: How bright a direction is that counts as bright.
    """
    weights = candidates.weights
    bright = np.where(luminance >= 0.5 * floor, weights, 0.0)
    measure = weights / weights.sum() + _EDGE_CASE_SHARE * is_edge_case / max(int(is_edge_case.sum()), 1)
    measure = measure + _BRIGHT_SHARE * bright / max(float(bright.sum()), 1e-300)
    # In their order by brightness, every third may be a training direction, for either to have its share of what few
    # there are.
    order = np.argsort(luminance, kind="stable")
    if len(order) <= _TRAINING:
        return candidates, candidates
    if len(order) <= _TRAINING + _VALIDATION:
        return _draw(candidates, order, measure, _TRAINING), candidates
    thirds = np.arange(len(order)) % 3
    training, validation = order[thirds == 0], order[thirds > 0]
    return _draw(candidates, training, measure, _TRAINING, 3.0), _draw(
        candidates, validation, measure, _VALIDATION, 1.5
    )


def _draw(
    candidates: DirectionSample, among: NDArray[np.int64], measure: NDArray[np.float64], count: int,
    stands_for: float = 1.0,
) -> DirectionSample:  # fmt: skip
    """``count`` of some directions, drawn in proportion to a measure, evenly along their order, each at most once."""
    if len(among) <= count:
        return candidates.some(among, stands_for * candidates.weights[among])
    share = measure[among] / measure[among].sum() * count
    # What would be drawn more than once is drawn surely, and the others the more.
    while (excess := share > 1.0).any():
        share[excess] = 1.0
        rest = share < 1.0
        share[rest] *= (count - np.count_nonzero(~rest)) / share[rest].sum()
    edges = np.cumsum(share)
    positions = np.arange(np.random.default_rng(_SEED).uniform(), edges[-1], 1.0)
    places = np.minimum(np.searchsorted(edges, positions, side="right"), len(among) - 1)
    chosen = among[places]
    return candidates.some(chosen, stands_for * candidates.weights[chosen] / share[places])


def _edge_cases(
    heightfield: HeightField, direction_range: DirectionRange, sample: DirectionSample, plan: Plan, *, threads: int
) -> NDArray[np.int64]:
    """Directions that may decide however few they are: by the mirror, by orders, of large gain, at the ranges' ends."""
    u, v, w = sample.scattering_vectors.T
    across, light = np.hypot(u, v), sample.to_lights[:, 2]
    order_rates = order_rate(heightfield, plan.coherence, sample.scattering_vectors, sample.to_lights)
    order_light = _order_light(heightfield, direction_range, sample, plan, threads=threads)
    kinds = [
        (-across, _NEAR_MIRROR),
        (sample.gains, _OF_LARGEST_GAIN),
        # Each order by itself, too: many directions by one of them say nothing of the few by another.
        (order_light.max(axis=1, initial=-math.inf), _NEAR_ORDERS),
        *((score, _NEAR_EACH_ORDER) for score in order_light.T),
        *((score, _AT_EACH_END) for score in (across, order_rates, w, -w, -light, light + w)),
    ]
    return np.unique(np.concatenate([np.argpartition(score, -count)[-count:] for score, count in kinds]))


def _order_light(
    heightfield: HeightField, direction_range: DirectionRange, sample: DirectionSample, plan: Plan, *, threads: int
) -> NDArray[np.float64]:
    """How much light directions may see of each of the strongest orders but the mirror's, by the logarithm, (n, m)."""
    coefficients, block, grid = coefficient_table.coefficients_for(
        heightfield, plan.method, plan.coherence, direction_range,
        coefficient_table.neighbour_extent(plan, heightfield), terms=plan.terms, threads=threads,
    )  # fmt: skip
    strongest, powers = coefficients.strongest
    rows, columns = block.orders()
    row, column = np.unravel_index(strongest, (len(rows), len(columns)))
    q = np.stack([columns[column] / grid.lengths_um[1], rows[row] / grid.lengths_um[0]], axis=1)
    # The mirror's is another kind.
    others = np.flatnonzero(q.any(axis=1))[:_STRONG_ORDERS]
    q, powers = q[others], powers[others]
    u = sample.scattering_vectors[:, :2]
    # The place on the way from red to blue that is nearest to each order.
    foot = (u @ q.T) / np.maximum(np.sum(u * u, axis=1), 1e-12)[:, None]
    foot = np.clip(foot, 1e3 / direction_range.lambda_max_nm, 1e3 / direction_range.lambda_min_nm)
    away = (foot * u[:, :1] - q[:, 0]) ** 2 + (foot * u[:, 1:] - q[:, 1]) ** 2
    falloff = 1.0
    if plan.coherence.kind != "replicas":
        falloff = coefficient_table.falloff_um2(plan.coherence, 0.5)
    strength = np.log(np.maximum(powers, 1e-30)) - falloff * away
    return np.asarray(strength + np.log(np.maximum(sample.gains, 1e-30))[:, None])
