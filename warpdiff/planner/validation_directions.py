"""Training and validation sets: samples of the directions of a call, with edge cases.

If few directions of a call are bright, a uniform sample may miss them. The angles of up to 8,192 directions are
therefore examined. About 1,024 of them become candidates: some are selected uniformly, and all edge cases are included.
Edge cases are directions near the mirror direction, near strong diffraction orders, with the largest geometry factors
(gains), or at the ends of the ranges of the call, such as grazing directions. A coarse plan (a cheap, inaccurate
computation) estimates the luminance of the candidates. The training set and the validation set are drawn from the
candidates; bright candidates are drawn with a higher probability. The weight of a drawn direction is proportional to
the number of the call's directions that it represents.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal.
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

# `_CANDIDATES` is the number of candidates (directions that may be drawn into a set) that are selected uniformly among
# the directions of a call. `_TRAINING` is the number of training directions, on which a search measures errors. Both
# numbers were fitted. If both were halved, more than 1 % of the calls would exceed the tolerance. If both were doubled,
# planning would require twice the time.
_CANDIDATES, _TRAINING = 1024, 128
# Number of directions in the validation set, a sample of the directions of a call that judges the plan that a search
# finds. It is larger than the training set, because it decides whether the plan is accepted.
_VALIDATION = 2 * _TRAINING
# Number of edge cases (extreme directions) of each kind, such as the most grazing directions. The directions near one
# strong diffraction order are a kind of edge cases. The same number, 16, is also the number of strong orders that are
# examined. The value was chosen so that all edge cases together are at most a third of the candidates.
_EDGE_CASES = 16
# A candidate is drawn into a set for one of three reasons: by a uniform draw, because it is bright, or because it is an
# edge case. This number is the probability of a draw as an edge case, divided by the probability of each of the other
# two draws. About a ninth of a set is therefore drawn as edge cases. Among the directions that are drawn for the other
# two reasons, there are further edge cases.
_EDGE_CASE_SHARE = 0.25


def candidates(
    heightfield: HeightField, direction_range: DirectionRange, sample: DirectionSample, plan: Plan, *, threads: int
) -> tuple[DirectionSample, NDArray[np.bool_]]:
    """Return the candidates for the training and validation sets, and a mask of the edge cases among them.

    Candidates are sampled directions of a call, from which both sets are drawn.

    Args:
        heightfield: Height field of the call.
        direction_range: Range of the call's directions.
        sample: Sample of the call's directions.
        plan: Coarse plan, whose Fourier coefficients determine the strong diffraction orders.
        threads: Number of threads on the CPU.
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
    """Return a training set and a validation set, drawn from the candidate directions.

    If the candidates are few, the validation set contains all of them.

    Args:
        candidates: Directions from which both sets are drawn.
        is_edge_case: Mask of the edge cases, shape (n,).
        luminance: Approximate luminance of each candidate, shape (n,).
        floor: Smallest luminance of a bright direction.
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
    # Candidates are sorted by luminance. Every third candidate may be drawn for training, and the others for
    # validation. Both sets therefore contain some of the brightest directions, even if few directions are bright.
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
    """Draw ``count`` of the directions with the indices ``among`` by systematic sampling, each direction at most once.

    The probability of a direction is proportional to ``measure``, and the weight of the direction in the result is
    divided by this probability. ``represents`` is the number of all candidates (the directions from which both sets are
    drawn) divided by the number of directions in ``among``. All weights are multiplied by ``represents``, so that the
    drawn directions represent all candidates.
    """
    if len(among) <= count:
        return candidates.some(among, represents * candidates.weights[among])
    share = measure[among] / measure[among].sum() * count
    # A direction whose computed probability exceeds 1 is drawn exactly once. The probabilities of all other directions
    # are increased, so that the number of drawn directions remains the same.
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
    """Return the indices of edge cases: directions near a strong order, or with extreme angles, rates or gains.

    Rates are order rates (how fast orders pass a direction as 1/λ changes), and gains are geometry factors.
    """
    u, v, w = sample.scattering_vectors.T
    across, light = np.hypot(u, v), sample.to_lights[:, 2]
    order_rates = order_rate(heightfield, plan.coherence, sample.scattering_vectors, sample.to_lights)
    # Each strong diffraction order is a separate kind of edge case, because errors near one order do not indicate
    # errors near other orders.
    order_light = _order_light(heightfield, direction_range, sample, plan, threads=threads)
    scores = [-across, sample.gains, *order_light.T, across, order_rates, w, -w, -light, light + w]
    return np.unique(np.concatenate([np.argpartition(score, -_EDGE_CASES)[-_EDGE_CASES:] for score in scores]))


def _order_light(
    heightfield: HeightField, direction_range: DirectionRange, sample: DirectionSample, plan: Plan, *, threads: int
) -> NDArray[np.float64]:
    """Return the logarithm of the power that m strong diffraction orders send to n directions, shape (n, m).

    The powers are estimates.
    """
    coefficients, block, grid = coefficient_table.coefficients_for(
        heightfield, plan.method, plan.coherence, direction_range,
        coefficient_table.neighbour_extent(plan, heightfield), terms=plan.terms, threads=threads,
    )  # fmt: skip
    strongest, powers = coefficients.strongest
    rows, columns = block.orders()
    row, column = np.unravel_index(strongest, (len(rows), len(columns)))
    q = np.stack([columns[column] / grid.lengths_um[1], rows[row] / grid.lengths_um[0]], axis=1)
    # The zeroth order is excluded from the strong orders. Directions near the zeroth order are edge cases for another
    # reason: their |(u, v)| is small.
    others = np.flatnonzero(q.any(axis=1))[:_EDGE_CASES]
    q, powers = q[others], powers[others]
    u = sample.scattering_vectors[:, :2]
    # As λ changes, the frequency (u, v)/λ of a direction moves along a line. `foot` is the visible wavenumber 1/λ at
    # which this frequency is nearest to the frequency q of an order. `away` is the squared distance of the two
    # frequencies there.
    foot = (u @ q.T) / np.maximum(np.sum(u * u, axis=1), TINY)[:, None]
    foot = np.clip(foot, NM_PER_UM / direction_range.lambda_max_nm, NM_PER_UM / direction_range.lambda_min_nm)
    away = (foot * u[:, :1] - q[:, 0]) ** 2 + (foot * u[:, 1:] - q[:, 1]) ** 2
    # The power of an order is multiplied by exp(−falloff · `away`), where `away` is the squared distance of the
    # frequency of a direction from the frequency of the order. Replicated patches have no coherence window. For them,
    # the falloff is an arbitrary 1 µm².
    falloff_um2 = 1.0
    if plan.coherence.kind != "replicas":
        # For a centred coherence window (kind "centred"), the falloff of the amplitude of an order is used, which is
        # half of the falloff of its power. The estimated power then extends farther from each order. Directions in the
        # minima between orders are therefore edge cases, too. Tables have their largest errors in these minima.
        falloff_um2 = coefficient_table.falloff_um2(plan.coherence, 0.5)
    strength = np.log(np.maximum(powers, TINY)) - falloff_um2 * away
    return np.asarray(strength + np.log(np.maximum(sample.gains, TINY))[:, None])
