"""Strategy: directions of a plan."""

import math

import numpy as np
import pytest
from conftest import at_angle, hemisphere

from warpdiff.planner import strategy
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.settings import PlanSettings


@pytest.fixture(scope="module")
def request_of_fingers(fingers):
    return Evaluation.of(fingers, PlanSettings(), illuminants=("D65",))


def test_a_sample_has_the_directions_of_the_call(request_of_fingers, rng):
    lights, views = hemisphere(rng, 500), hemisphere(rng, 500)
    direction_range, sample, count = strategy.directions_of(request_of_fingers, lights, views)
    assert count == len(sample) == 500
    np.testing.assert_allclose(sample.to_lights, lights)
    np.testing.assert_allclose(-sample.scattering_vectors - sample.to_lights, views)
    vectors = lights + views
    assert np.hypot(*vectors.T[:2]).max() <= direction_range.max_uv * (1.0 + 1e-9)
    assert direction_range.min_w <= vectors[:, 2].min() * (1.0 + 1e-9)
    assert vectors[:, 2].max() <= direction_range.max_w * (1.0 + 1e-9)


@pytest.mark.parametrize(("side", "light", "view"), [("light", at_angle(30.0), None), ("view", None, at_angle(30.0))])
def test_the_whole_hemisphere_is_assumed_on_the_other_side(side, light, view, request_of_fingers):
    """From one direction at an angle θ, |(u, v)| reaches 1 + sin θ, and |w| lies between cos θ and 1 + cos θ."""
    direction_range, sample, count = strategy.directions_of(request_of_fingers, light, view)
    assert math.isinf(count)
    assert direction_range.max_uv == pytest.approx(1.5)
    assert direction_range.min_w == pytest.approx(math.cos(math.pi / 6.0))
    assert direction_range.max_w == pytest.approx(1.0 + math.cos(math.pi / 6.0))
    views = -sample.scattering_vectors - sample.to_lights
    fixed, other = (sample.to_lights, views) if side == "light" else (views, sample.to_lights)
    np.testing.assert_allclose(fixed, np.broadcast_to(at_angle(30.0), fixed.shape), atol=1e-12)
    # Uniform in z.
    assert other[:, 2].mean() == pytest.approx(0.5, abs=0.02)
