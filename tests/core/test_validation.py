"""Warnings of calls whose directions look like angles in degrees, or whose lights reach no pixel."""

import warnings

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.core import validation

GRATING = wd.gratings.sinusoidal(2.0, 0.1)
UP = (0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    "vector", [(0, 30, 60), (45.0, 0.0, 90.0), (-30, 0, 1), (10, 180, 0), [(0, 0, 1), (30, 45, 90)], (1, -360, 5)]
)
def test_vectors_that_look_like_degrees_are_warned_of(vector):
    with pytest.warns(wd.WarpdiffWarning, match=r"to_view \(.*\) looks like angles in degrees, but it is a vector"):
        directions, _ = validation.unit_directions(vector, "to_view")
    np.testing.assert_allclose(directions, validation.directions(vector, "to_view")[0])


@pytest.mark.parametrize(
    "vector",
    [UP, (0, 0, 90), (0.3, 0.1, 1.0), (3, 4, 12), (120.5, 30.0, 45.0), (0, 400, 100), (0, 5, 5), np.zeros((0, 3))],
)
def test_other_vectors_are_not_warned_of(vector):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        validation.unit_directions(vector, "to_light")


@pytest.mark.parametrize("call", ["reflectance", "plan", "order_efficiencies", "reflectance_map", "DirectionalLight"])
def test_calls_warn_of_degrees(call):
    degrees = (30, 0, 60)
    calls = {
        "reflectance": lambda: wd.reflectance(GRATING, degrees, UP),
        "plan": lambda: wd.plan(GRATING, degrees, UP),
        "order_efficiencies": lambda: wd.order_efficiencies(GRATING, degrees, 550.0),
        "reflectance_map": lambda: wd.reflectance_map(GRATING, degrees, size=8, tolerance=0.3),
        "DirectionalLight": lambda: wd.DirectionalLight(degrees),
    }
    with pytest.warns(wd.WarpdiffWarning, match=r"to_light \(30, 0, 60\) looks like angles in degrees") as caught:
        calls[call]()
    assert len(caught) == 1


def test_a_picture_that_no_light_reaches_is_warned_of():
    disc, view = wd.meshes.disc(), wd.View((0.0, -1.9, 2.3), (0.0, 0.0, 0.0), width=16, height=12)
    with pytest.warns(wd.WarpdiffWarning, match="none of the lights illuminates a visible point of the mesh"):
        image = wd.shade(disc, GRATING, wd.DirectionalLight((0.0, -0.3, -1.0)), view, tolerance=0.3, pigment=0.0)
    assert image.mask.any()
    assert not image.xyz.any()


@pytest.mark.parametrize("value", [True, [True, False], np.ones((2, 2), dtype=bool)])
def test_flags_are_no_numbers_of_arrays(value):
    calls = {
        "turn_deg": lambda: wd.GratingMap(GRATING, turn_deg=value),
        "heights_um": lambda: wd.HeightField([value], 0.1),
        "efficiencies": lambda: wd.Target.orders({(0, 1): True, (0, 0): 0.0}, UP, 550.0),
    }
    for name, call in calls.items():
        with pytest.raises(TypeError, match=f"{name} must be .*numbers, got True"):
            call()
    assert validation.finite_array(value, "pixels", flags=True).dtype == np.float64


def test_huge_views_are_refused_before_they_are_copied():
    for shape in ((40_000, 40_000), (10**6, 10**6)):
        huge = np.broadcast_to(0.0, shape)
        for call in (lambda view: validation.finite_array(view, "turn_deg", bytes_per_number=1e5),
                     lambda view: wd.GratingMap(GRATING, turn_deg=view)):  # fmt: skip
            with pytest.raises(
                MemoryError, match=r"turn_deg of shape \(\d+, \d+\) requires about .*: take fewer numbers"
            ):
                call(huge)


@pytest.mark.parametrize("order", [1, (0, 1, 2), "01", None, (0.5, 1), 0.5])
@pytest.mark.parametrize("kind", [wd.OrderEfficiencies, wd.RigorousEfficiencies])
def test_an_order_is_a_pair_of_integers(kind, order):
    result = kind.__new__(kind)
    with pytest.raises(TypeError, match=r"order must be a(n integer| pair of integers \(m_y, m_x\)), got"):
        result[order]
