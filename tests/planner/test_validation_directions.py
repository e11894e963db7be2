"""Training and validation sets are disjoint, and each set represents the whole call.

Both are sets of directions of a call. The planner searches a plan (numbers of wavelengths and terms) on the training
set, and measures its error on the validation set. Both are drawn from candidates. Edge cases are candidates near strong
diffraction orders, or with extreme angles or geometry factors.
"""

import numpy as np
import pytest
from conftest import hemisphere

import warpdiff as wd
from warpdiff.planner import validation_directions
from warpdiff.request.directions import DirectionRange, DirectionSample


def test_the_training_and_the_validation_set_each_represent_all_candidates(rng):
    lights, views = hemisphere(rng, 1000), hemisphere(rng, 1000)
    candidates = DirectionSample(-lights - views, lights, rng.uniform(0.1, 1.0, 1000), np.full(1000, 7.0))
    luminance = rng.lognormal(0.0, 2.0, 1000)
    sets = validation_directions.sampled(candidates, np.arange(1000) < 200, luminance, float(np.median(luminance)))
    assert [len(sample) for sample in sets] == [128, 256]
    lights_of = [set(map(tuple, sample.to_lights)) for sample in sets]
    assert [len(drawn) for drawn in lights_of] == [128, 256]
    assert not lights_of[0] & lights_of[1]
    share = np.mean(views[:, 2] > 0.5)
    for sample in sets:
        assert sample.weights.sum() == pytest.approx(7000.0, rel=0.2)
        steep = -(sample.scattering_vectors + sample.to_lights)[:, 2] > 0.5
        assert sample.weights[steep].sum() / sample.weights.sum() == pytest.approx(share, abs=0.12)
        # Directions are drawn uniformly, by brightness, or as edge cases, in the ratio 1 : 1 : 0.25. A fifth of all
        # candidates (sampled directions of a call) are edge cases. The share of edge cases among the first two kinds is
        # therefore a fifth, too.
        edge_cases = set(map(tuple, sample.to_lights)) & set(map(tuple, lights[:200]))
        assert len(edge_cases) / len(sample) == pytest.approx((0.2 + 0.2 + 0.25) / 2.25, abs=0.06)


@pytest.mark.parametrize("count", [100, 300, 384])
def test_a_few_candidates_are_all_in_the_validation_set(count, rng):
    lights = hemisphere(rng, count)
    candidates = DirectionSample(-2.0 * lights, lights, np.ones(count), np.ones(count))
    training, validation = validation_directions.sampled(candidates, np.zeros(count, dtype=bool), lights[:, 2], 1.0)
    assert len(validation) == count
    assert len(training) == min(count, 128)
    assert training.weights.sum() == pytest.approx(count, rel=0.2)


def test_directions_drawn_with_large_probabilities_appear_only_once(rng):
    """No direction may be drawn twice.

    The weight of a drawn direction must be its original weight divided by the probability that it is drawn.
    """
    lights = hemisphere(rng, 1000)
    candidates = DirectionSample(-2.0 * lights, lights, np.ones(1000), rng.uniform(1.0, 2.0, 1000))
    measure = np.ones(1000)
    # The probability that a direction is drawn is proportional to ``measure``, but at most 1. For 100 draws, the
    # probability of the first eleven directions reaches 1, so that they are always drawn.
    measure[:10], measure[10] = 1e3, 50.0
    drawn = validation_directions._draw(candidates, np.arange(1000), measure, 100, represents=3.0)
    index = {tuple(light): k for k, light in enumerate(lights)}
    places = np.array([index[tuple(light)] for light in drawn.to_lights])
    assert len(places) == len(set(places)) == 100
    assert set(range(11)) <= set(places)
    share = np.where(places < 11, 1.0, 89.0 / 989.0)
    np.testing.assert_allclose(drawn.weights, 3.0 * candidates.weights[places] / share)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_few_directions_at_an_order_are_candidates(axis, rng):
    """The directions at the first order of a grating must become candidates even if there are only twelve of them.

    The planner draws the directions on which it evaluates plans from the candidates.

    All other directions are away from the order, or are dim.
    """
    grating = wd.gratings.sinusoidal(2.0, 0.1)
    heights = np.tile(grating.heights_um, (6, 1))
    pitch = 0.15, grating.pitch_um[1]
    heightfield = wd.HeightField.of_known_scale(heights if axis else heights.T, pitch if axis else pitch[::-1])
    count, few = 6000, 12
    along = rng.choice([-1.0, 1.0], count) * rng.uniform(0.1, 0.5, count)
    aside = rng.choice([-1.0, 1.0], count) * rng.uniform(0.15, 0.5, count)
    at_order, dim = np.split(rng.permutation(count)[: 5 * few], [few])
    along[at_order], aside[at_order] = np.linspace(0.2, 0.38, few) * rng.choice([-1.0, 1.0], few), 0.001
    along[dim], aside[dim] = np.linspace(0.2, 0.38, 4 * few) * rng.choice([-1.0, 1.0], 4 * few), 0.0
    gains = np.full(count, 2.0)
    gains[at_order], gains[dim] = 1.0, 1e-4
    u, v = (along, aside) if axis else (aside, along)
    sample = DirectionSample(
        np.column_stack([u, v, np.full(count, -1.7)]), np.tile([0.0, 0.0, 1.0], (count, 1)), gains,
        np.ones(count),
    )  # fmt: skip
    plan = wd.plan(heightfield, [0.0, 0.0, 1.0], [0.5, 0.0, 0.8], method="low-rank")
    chosen, is_edge_case = validation_directions.candidates(
        heightfield, DirectionRange(0.8, 0.8, 1.7, 1.7), sample, plan, threads=1
    )
    index = {tuple(vector): k for k, vector in enumerate(sample.scattering_vectors)}
    edge_cases = {index[tuple(vector)] for vector in chosen.scattering_vectors[is_edge_case]}
    assert set(at_order.tolist()) <= edge_cases
    assert chosen.weights.sum() == pytest.approx(count)
    assert 1000 <= len(chosen) - len(edge_cases) <= 1024


def test_directions_with_extreme_angles_are_edge_cases(rng):
    """Directions with extreme angles must be edge cases, which always become candidates for sampled directions.

    They have the most grazing lights or views, or the largest or smallest |(u, v)|, the tangential part of the
    scattering vector.
    """
    heightfield = wd.gratings.sinusoidal(2.0, 0.1)
    lights, views = hemisphere(rng, 3000), hemisphere(rng, 3000)
    sample = DirectionSample(-lights - views, lights, np.ones(3000), np.ones(3000))
    plan = wd.plan(heightfield, [0.0, 0.0, 1.0], [0.5, 0.0, 0.8], method="low-rank")
    chosen, is_edge_case = validation_directions.candidates(
        heightfield, DirectionRange(2.0, 2.0, 0.1, 2.0), sample, plan, threads=1
    )
    edge_cases = set(map(tuple, chosen.scattering_vectors[is_edge_case]))
    across = np.hypot(*sample.scattering_vectors[:, :2].T)
    for score in (-lights[:, 2], -views[:, 2], across, -across):
        extreme = sample.scattering_vectors[np.argsort(score)[-16:]]
        assert set(map(tuple, extreme)) <= edge_cases
