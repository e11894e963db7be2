"""Angles of orders obey the grating equation. Their standard errors follow from the standard error of the period."""

import math

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.core import memory

PERIOD, WAVELENGTHS = 2.5, [450.0, 650.0]


def period(length_um=PERIOD, error_um=0.01, azimuth_deg=0.0):
    frequency = np.array([math.sin(math.radians(azimuth_deg)), math.cos(math.radians(azimuth_deg))]) / length_um
    return wd.Period(length_um, error_um, azimuth_deg, (0.1,), 1.0, tuple(frequency.tolist()), is_coherent=True)


@pytest.mark.parametrize("incidence", [0.0, 25.0, -40.0])
@pytest.mark.parametrize("azimuth", [0.0, 90.0, 30.0])
def test_orders_in_the_plane_of_incidence_obey_the_grating_equation(incidence, azimuth):
    """Light in the plane of incidence across the grooves must have orders at sin θr = mλ/d − sin θi.

    The plane contains the normal and the wave vector of the grating, m is the number of the order, and d is the period.
    """
    table = wd.order_angles(period(azimuth_deg=azimuth), wd.direction(incidence, azimuth), WAVELENGTHS, most_order=9)
    expected = []
    for wavelength in WAVELENGTHS:
        for m in range(-9, 10):
            sine = m * wavelength * 1e-3 / PERIOD - math.sin(math.radians(incidence))
            if abs(sine) < 1.0:
                expected.append((wavelength, m, math.degrees(math.asin(sine))))
    assert [row[:2] for row in expected] == list(zip(table["wavelength_nm"], table["order"], strict=True))
    forward = np.cos(np.radians(table["view_phi_deg"] - azimuth))
    np.testing.assert_allclose(table["view_theta_deg"] * forward, [row[2] for row in expected], atol=1e-10)


def test_orders_of_oblique_light_keep_the_component_along_the_grooves():
    light = wd.direction(50.0, 70.0)
    table = wd.order_angles(period(), light, 550.0, most_order=4)
    views = wd.direction(table["view_theta_deg"], table["view_phi_deg"])
    np.testing.assert_allclose(views[:, 1], -light[1], atol=1e-12)
    np.testing.assert_allclose(views[:, 0] + light[0], table["order"] * 0.55 / PERIOD, atol=1e-12)


@pytest.mark.parametrize("light", [(0.0, 0.0, 1.0), (0.3, 0.5, 1.0)])
def test_standard_errors_are_the_change_of_the_angle_with_the_period(light):
    error = 1e-5
    table = wd.order_angles(period(error_um=error), light, 550.0, most_order=3)
    longer = wd.order_angles(period(PERIOD + error), light, 550.0, most_order=3)
    assert table["order"].tolist() == longer["order"].tolist()
    expected = np.abs(longer["view_theta_deg"] - table["view_theta_deg"])
    np.testing.assert_allclose(table["standard_error_deg"], expected, rtol=1e-4, atol=1e-12)
    assert expected.max() > 1e-5


def test_an_order_along_the_normal_has_the_error_of_its_direction():
    """An order along the normal must have the standard error of its direction.

    Light at sin θi = λ/d, where d is the period, sends order 1 along the normal. Its polar angle is 0. Because this
    angle cannot be negative, any error of the period increases it.
    """
    sine = 0.55 / PERIOD
    light = (sine, 0.0, math.sqrt(1.0 - sine**2))
    table = wd.order_angles(period(error_um=1e-3), light, 550.0, most_order=1)
    row = table["order"].tolist().index(1)
    assert table["view_theta_deg"][row] == pytest.approx(0.0, abs=1e-10)
    assert table["standard_error_deg"][row] == pytest.approx(math.degrees(sine * 1e-3 / PERIOD), rel=1e-9)


def test_a_measured_field_gives_its_periods_and_a_cell_its_size():
    x = np.arange(730) * 0.02
    measured = wd.HeightField((0.1 * np.cos(2.0 * np.pi * x / 1.7))[None, :], pitch_um=0.02)
    table = wd.order_angles(measured, (0, 0, 1), 550.0, most_order=1)
    np.testing.assert_allclose(
        table["view_theta_deg"], np.degrees(np.arcsin(0.55 / 1.7)) * np.array([1, 0, 1]), atol=1e-4
    )
    cell = wd.order_angles(wd.gratings.bumps(), (0, 0, 1), 550.0, most_order=1)
    assert sorted(set(cell["period_um"])) == [1.0, 2.0]
    assert set(cell["standard_error_deg"]) == {0.0}
    assert cell["order"].tolist() == [-1, 0, 1, -1, 0, 1]
    expected = np.degrees(np.arcsin(0.55 * np.abs(cell["order"]) / cell["period_um"]))
    np.testing.assert_allclose(cell["view_theta_deg"], expected, atol=1e-9)
    along_x = (cell["order"] != 0) & (cell["period_um"] == wd.gratings.bumps().size_um[1])
    np.testing.assert_allclose(
        np.abs(np.cos(np.radians(cell["view_phi_deg"])))[cell["order"] != 0], along_x[cell["order"] != 0], atol=1e-9
    )


@pytest.mark.parametrize(
    ("source", "light", "error", "message"),
    [("2 µm", (0, 0, 1), TypeError, "source must be a warpdiff.HeightField, or periods .* got str"),
     ((), (0, 0, 1), ValueError, "source must have at least one period, got none"),
     (period(1e9), (0, 0, 1), MemoryError, "angles of .* orders .* take a smaller most_order"),
     (period(), (1, 0, 0), ValueError, "to_light must be above the horizon"),
     (wd.HeightField.of_known_scale([[0.1]], 1.0), (0, 0, 1), ValueError, "source must have a period")],
)  # fmt: skip
def test_requests_without_a_period_a_light_or_memory_are_refused(source, light, error, message, monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 1e9)
    with pytest.raises(error, match=message):
        wd.order_angles(source, light, 550.0, most_order=2**40)
