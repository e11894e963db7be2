"""Cameras and lights: orientation, and what they refuse."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from warpdiff.lights.directional import DirectionalLight
from warpdiff.scene.camera import View

EYE, TARGET = (0.0, 0.0, 5.0), (0.0, 0.0, 0.0)


def test_the_camera_looks_along_its_minus_z():
    frame = View(EYE, TARGET).frame()
    np.testing.assert_allclose(frame.right, [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(frame.up, [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(frame.back, [0, 0, 1], atol=1e-15)
    np.testing.assert_array_equal(frame.origin, EYE)
    assert not frame.orthographic


def test_the_axes_are_right_handed_and_orthonormal(rng):
    for _ in range(20):
        eye, target, up = rng.normal(size=(3, 3)) * 10.0 ** rng.integers(-6, 7)
        frame = View(eye, target, up=up).frame()
        axes = np.stack([frame.right, frame.up, frame.back])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        assert frame.up @ up > 0.0


def test_the_field_of_view_is_vertical_and_pixels_are_square():
    frame = View(EYE, TARGET, fov_y_deg=60, width=200, height=100).frame()
    assert frame.half_height == pytest.approx(math.tan(math.radians(30)))
    assert frame.half_width == pytest.approx(2.0 * frame.half_height)


def test_the_orthographic_extent_is_the_image_height():
    view = View.orthographic(EYE, TARGET, extent_y=3.0, width=200, height=100)
    frame = view.frame()
    assert frame.orthographic
    assert (frame.half_width, frame.half_height) == (3.0, 1.5)
    assert (view.width, view.height) == (200, 100)


def test_views_are_values():
    assert View(np.array(EYE), list(TARGET)) == View(EYE, TARGET)
    assert len({View(EYE, TARGET), View(EYE, TARGET)}) == 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        View(EYE, TARGET).width = 3
    assert dataclasses.replace(View(EYE, TARGET), width=3).width == 3


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"eye": TARGET}, ValueError, "eye and target must be two different points"),
        ({"eye": (1, 2)}, ValueError, "eye must be a vector of 3"),
        ({"eye": "here"}, TypeError, "eye must be an array"),
        ({"target": (0, 0, math.nan)}, ValueError, "target must be finite"),
        ({"up": (0, 0, 1)}, ValueError, "up must not be parallel"),
        ({"up": (0, 0, -2e-9)}, ValueError, "up must not be parallel"),
        ({"up": (0, 0, 0)}, ValueError, "up must not contain zero"),
        ({"fov_y_deg": 0}, ValueError, "fov_y_deg must be"),
        ({"fov_y_deg": 180}, ValueError, "fov_y_deg must be"),
        ({"fov_y_deg": math.nan}, ValueError, "fov_y_deg must be"),
        ({"fov_y_deg": "wide"}, TypeError, "fov_y_deg must be a number"),
        ({"width": 0}, ValueError, "width must be an integer >= 1"),
        ({"width": 2.5}, TypeError, "width must be an integer"),
        ({"height": -1}, ValueError, "height must be an integer >= 1"),
        ({"height": True}, TypeError, "height must be an integer"),
        ({"extent_y": 0.0}, ValueError, "extent_y must be"),
    ],
)
def test_bad_views(changed, error, message):
    given = {"eye": EYE, "target": TARGET} | changed
    eye, target = given.pop("eye"), given.pop("target")
    with pytest.raises(error, match=message):
        View(eye, target, **given)


@pytest.mark.parametrize("extent_y", [0.0, -1.0, math.inf])
def test_bad_extents(extent_y):
    with pytest.raises(ValueError, match="extent_y must be"):
        View.orthographic(EYE, TARGET, extent_y=extent_y)


def test_the_direction_to_the_light_is_normalised():
    light = DirectionalLight([0.0, 3e200, 4e200])
    np.testing.assert_allclose(light.to_light, (0.0, 0.6, 0.8), rtol=1e-15)
    assert (light.illuminant, light.power) == ("D65", 1.0)
    assert DirectionalLight((0, 0, 1), power=0).power == 0.0


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"to_light": (0, 0, 0)}, ValueError, "to_light must not contain zero"),
        ({"to_light": (0, math.inf, 0)}, ValueError, "to_light must be finite"),
        ({"to_light": (1, 0)}, ValueError, "to_light must be a vector of 3"),
        ({"to_light": [[0, 0, 1]]}, ValueError, "to_light must be a vector of 3"),
        ({"to_light": None}, TypeError, "to_light must be an array"),
        ({"illuminant": 65}, TypeError, "illuminant must be the name"),
        ({"power": -1.0}, ValueError, "power must be a finite number >= 0"),
        ({"power": math.nan}, ValueError, "power must be a finite number >= 0"),
        ({"power": "bright"}, TypeError, "power must be a number"),
    ],
)
def test_bad_lights(changed, error, message):
    given = {"to_light": (0, 0, 1)} | changed
    with pytest.raises(error, match=message):
        DirectionalLight(given.pop("to_light"), **given)
