"""Directional lights: normalisation of their direction, and invalid arguments."""

import math

import numpy as np
import pytest

from warpdiff.lights.directional import DirectionalLight


def test_the_direction_to_the_light_is_normalised():
    light = DirectionalLight([0.0, 3e200, 4e200])
    np.testing.assert_allclose(light.to_light, (0.0, 0.6, 0.8), rtol=1e-15)
    assert (light.illuminant, light.power) == ("D65", 1.0)
    assert DirectionalLight((0, 0, 1), power=0).power == 0.0


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [({"to_light": (0, math.inf, 0)}, ValueError, "to_light must be finite"),
     ({"to_light": (1, 0)}, ValueError, "to_light must be a vector of 3"),
     ({"to_light": [[0, 0, 1]]}, ValueError, "to_light must be a vector of 3"),
     ({"to_light": None}, TypeError, "to_light must be an array"),
     ({"illuminant": 65}, TypeError, "illuminant must be the name")],
)  # fmt: skip
def test_invalid_arguments_of_a_light_are_refused(changed, error, message):
    arguments = {"to_light": (0, 0, 1)} | changed
    with pytest.raises(error, match=message):
        DirectionalLight(arguments.pop("to_light"), **arguments)
