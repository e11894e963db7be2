"""Where scalar diffraction fails: the rule, what summaries and plans say, and rigorous efficiencies to hold it to."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from conftest import at_angle

import warpdiff as wd
from warpdiff.heightfield.scalar_validity import UNTRUSTED, error_bound, told

RIGOROUS = Path(__file__).resolve().parents[2] / "bench" / "suite" / "rigorous.json"


@pytest.mark.parametrize("period", [2.0, 7.0])
def test_a_sine_has_its_own_period(period):
    """(4πs/λ)² λ/P: s² = depth²/8."""
    heightfield = wd.gratings.sinusoidal(period, 0.2, samples=400)
    bound = error_bound(heightfield.rms_um, heightfield.mean_slope, 500.0)
    assert heightfield.mean_slope == pytest.approx(2.0 * 0.2 / period)
    assert bound == pytest.approx(16.0 * math.pi**2 * 0.2**2 / 8.0 / (0.5 * period))


def test_short_periods_are_all_wrong():
    """Scalar theory takes 1 − J_0² from a mirror that has no other order to give it to."""
    depth, wavelength = 0.01, 500.0
    heightfield = wd.gratings.sinusoidal(0.3, depth)
    found = wd.order_efficiencies(heightfield, (0, 0, 1), wavelength, ior=math.inf, energy="stam")
    assert found.orders.tolist() == [[0, 0]]
    bound = error_bound(heightfield.rms_um, heightfield.mean_slope, wavelength)
    assert bound == pytest.approx(1.0 - found[0, 0][0], rel=0.01)


def test_the_mean_slope_does_not_depend_on_the_samples():
    walls = [wd.gratings.lamellar(2.0, 0.2, samples=n) for n in (10, 400)]
    assert walls[0].mean_slope == pytest.approx(walls[1].mean_slope) == pytest.approx(2.0 * 0.2 / 2.0)
    assert walls[1].rms_slope > 3.0 * walls[0].rms_slope
    y = np.arange(40)[:, None] * 0.1
    sloped = wd.HeightField(0.3 * np.cos(2.0 * np.pi * y / 4.0) * np.ones((1, 3)), 0.1)
    assert sloped.mean_slope == pytest.approx(4.0 * 0.3 / 4.0, rel=1e-2)


def test_a_flat_surface_is_right():
    flat = wd.HeightField([[0.2, 0.2]], 1.0)
    assert flat.summary().scalar_error == 0.0
    assert "right within some 0 of" in str(flat.summary())


def test_summary_and_plan_say_it():
    heightfield = wd.gratings.sinusoidal(2.0, 0.2)
    for text in (str(heightfield.summary()), str(wd.plan(heightfield)), str(wd.plan(heightfield, method="direct"))):
        assert "right within some 0.72 of the reflected power at 550 nm" in text
    assert "how bright they are may be all wrong at 550 nm (1.5)" in told(1.5)


def test_a_plan_warns_where_nothing_is_right():
    heightfield = wd.gratings.lamellar(1.0, 0.5)
    with pytest.warns(wd.WarpdiffWarning, match=r"scalar diffraction is not to be trusted at 550 nm.*mean slope of 1:"):
        plan = wd.plan(heightfield, (0, 0, 1), (0, 0, 1))
    assert plan.scalar_error >= UNTRUSTED
    assert "not to be trusted" in str(heightfield.summary())


@pytest.mark.parametrize(
    "heightfield",
    [
        wd.gratings.sinusoidal(2.0, 0.25),
        wd.gratings.lamellar(2.0, 0.25),
        wd.gratings.blazed(2.0, 0.25),
        wd.gratings.fingers(size_um=12.8),
        wd.gratings.bumps(),
        wd.gratings.disc("CD", tracks=4, length_um=14.0),
        wd.gratings.disc("Blu-ray", tracks=4, length_um=4.0),
    ],
    ids=["sine", "lamellar", "blazed", "fingers", "bumps", "CD", "Blu-ray"],
)
def test_usual_surfaces_are_not_warned_of(heightfield):
    assert 0.1 < heightfield.summary().scalar_error < UNTRUSTED


def test_the_rule_holds_against_rigorous_solutions():
    """Sines of a perfect mirror by boundary integrals, on both sides of the rule."""
    stored = json.loads(RIGOROUS.read_text())
    rows = iter(stored["cases"]["Sine, perfect mirror"]["first_order_and_efficiencies"])
    errors, bounds = [], []
    for period in stored["periods"]:
        for depth in stored["depths"]:
            heightfield = wd.gratings.sinusoidal(period, depth, samples=256)
            worst = 0.0
            for angle in stored["angles_deg"]:
                first, *efficiencies = next(rows)
                found = wd.order_efficiencies(heightfield, at_angle(angle), 1000.0, ior=math.inf, energy="stam")
                ours = [found[0, first + n][0] for n in range(len(efficiencies))]
                worst = max(worst, float(np.max(np.abs(np.array(efficiencies) * stored["unit"] - ours))))
            errors.append(worst)
            bounds.append(error_bound(heightfield.rms_um, heightfield.mean_slope, 1000.0))
    error, bound = np.array(errors), np.array(bounds)
    assert np.mean(error[bound <= 0.1] <= 0.1) > 0.98
    assert error[bound <= 0.1].max() < 0.13
    # Gentle gratings are not only within the rule: there the scalar theory is right.
    assert error[bound <= 1e-3].max() < 2e-3
    # It is no rule that warns of everything.
    assert np.mean(bound[error <= 0.1] <= 0.1) > 0.6
    assert np.mean(error[bound >= UNTRUSTED] > 0.1) > 0.9


@pytest.mark.parametrize(("case", "make"), [
    ("Sine, perfect mirror", lambda *given: wd.gratings.sinusoidal(*given, samples=128)),
    ("Square grooves, perfect mirror", lambda *given: wd.gratings.lamellar(*given, samples=512)),
    ("Sawtooth, perfect mirror", lambda *given: wd.gratings.blazed(*given, samples=512)),
])  # fmt: skip
def test_normalised_orders_of_mirrors_are_nearer_to_rigorous_solutions(case, make):
    """Where grooves are no deeper than a quarter of a wavelength; half of the rule holds for them."""
    stored = json.loads(RIGOROUS.read_text())
    rows = iter(stored["cases"][case]["first_order_and_efficiencies"])
    errors, bounds = [], []
    for i, period in enumerate(stored["periods"]):
        for j, depth in enumerate(stored["depths"]):
            for angle in stored["angles_deg"]:
                first, *efficiencies = next(rows)
                # Some of them are enough here.
                if i % 3 or j not in (2, 5) or angle == 0.0:
                    continue
                heightfield = make(period, depth)
                found = [
                    wd.order_efficiencies(heightfield, at_angle(angle), 1000.0, ior=math.inf, energy=energy)
                    for energy in ("stam", "normalised")
                ]
                right = np.array(efficiencies) * stored["unit"]
                ours = [[each[0, first + n][0] for n in range(len(right))] for each in found]
                errors.append(np.max(np.abs(np.array(ours) - right), axis=1))
                bounds.append(error_bound(heightfield.rms_um, heightfield.mean_slope, 1000.0, normalised=True))
    stam, normalised = np.array(errors).T
    assert np.quantile(normalised, 0.9) < np.quantile(stam, 0.9)
    assert normalised.mean() < 0.75 * stam.mean()
    assert np.mean(normalised <= 1.5 * np.array(bounds)) > 0.9
