"""Training and validation sets: they are disjoint, and either represents the whole call."""

import numpy as np
import pytest
from conftest import hemisphere

from warpdiff.planner import validation_directions
from warpdiff.request.directions import DirectionSample


def test_either_set_represents_all_candidates(rng):
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
        # All, the bright and the edge cases have shares of 1, 1 and 1/4. A fifth of the first two are edge cases.
        edge_cases = set(map(tuple, sample.to_lights)) & set(map(tuple, lights[:200]))
        assert len(edge_cases) / len(sample) == pytest.approx((0.2 + 0.2 + 0.25) / 2.25, abs=0.06)


@pytest.mark.parametrize("count", [100, 300, 384])
def test_few_candidates_are_all_validation_directions(count, rng):
    lights = hemisphere(rng, count)
    candidates = DirectionSample(-2.0 * lights, lights, np.ones(count), np.ones(count))
    training, validation = validation_directions.sampled(candidates, np.zeros(count, dtype=bool), lights[:, 2], 1.0)
    assert len(validation) == count
    assert len(training) == min(count, 128)
    assert training.weights.sum() == pytest.approx(count, rel=0.2)
