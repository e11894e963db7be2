"""Diagnostics: the summary, and the error bound of scalar diffraction against rigorous solutions."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from conftest import at_angle

import warpdiff as wd
from warpdiff.heightfield.diagnostics import SCALAR_INVALID, scalar_error_bound, scalar_error_text

RIGOROUS = Path(__file__).resolve().parents[2] / "bench" / "suite" / "rigorous.json"


def test_summary_reads_well() -> None:
    summary = wd.gratings.sinusoidal(1.6, 0.2, samples=8).summary()
    assert summary.max_uv == pytest.approx(0.38 / 0.4)
    text = str(summary)
    for part in (
        "1.6 ×",
        "200 × 200 nm",
        "0.2 µm",
        "no feature repeats at least three times (field is one period)",
        "up to 0.95 at 380 nm",
    ):
        assert part in text
    assert "whole hemisphere" in str(wd.gratings.sinusoidal(1.6, 0.2).summary())
    assert "no feature repeats" in str(wd.HeightField([[0.0]], 1.0).summary())


@pytest.mark.parametrize("period", [2.0, 7.0])
def test_a_sine_has_its_own_period(period):
    """(4πs/λ)² λ/P: s² = depth²/8."""
    heightfield = wd.gratings.sinusoidal(period, 0.2, samples=400)
    bound = scalar_error_bound(heightfield.rms_um, heightfield.mean_slope, 500.0)
    assert heightfield.mean_slope == pytest.approx(2.0 * 0.2 / period)
    assert bound == pytest.approx(16.0 * math.pi**2 * 0.2**2 / 8.0 / (0.5 * period))


def test_short_periods_are_all_wrong():
    """Scalar theory takes 1 − J_0² from a mirror that has no other order to give it to."""
    depth, wavelength = 0.01, 500.0
    heightfield = wd.gratings.sinusoidal(0.3, depth)
    orders = wd.order_efficiencies(heightfield, (0, 0, 1), wavelength, ior=math.inf, energy="stam")
    assert orders.orders.tolist() == [[0, 0]]
    bound = scalar_error_bound(heightfield.rms_um, heightfield.mean_slope, wavelength)
    assert bound == pytest.approx(1.0 - orders[0, 0][0], rel=0.01)


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
    assert "reliable at 550 nm: order efficiencies may be off by up to 0 %" in str(flat.summary())


def test_summary_and_plan_say_it():
    heightfield = wd.gratings.sinusoidal(2.0, 0.2)
    for text in (str(heightfield.summary()), str(wd.plan(heightfield)), str(wd.plan(heightfield, method="direct"))):
        assert (
            "qualitative at 550 nm: order efficiencies may be off by up to 72 % of the reflected power (bound 0.718)"
            in text
        )
    assert "qualitative at 550 nm: order efficiencies may be off by up to 100 % of the" in scalar_error_text(1.5)
    assert "reliable at 550 nm: order efficiencies may be off by up to 9.9 % of the" in scalar_error_text(0.0994)


def test_a_plan_warns_where_nothing_is_right():
    heightfield = wd.gratings.lamellar(1.0, 0.5)
    with pytest.warns(wd.WarpdiffWarning, match=r"scalar diffraction is invalid at 550 nm: .*mean slope of 1:"):
        plan = wd.plan(heightfield, (0, 0, 1), (0, 0, 1))
    assert plan.scalar_error >= SCALAR_INVALID
    assert "invalid at 550 nm: the surface is too deep and too steep" in str(heightfield.summary())


@pytest.mark.parametrize(
    "heightfield",
    [wd.gratings.sinusoidal(2.0, 0.25), wd.gratings.lamellar(2.0, 0.25), wd.gratings.blazed(2.0, 0.25),
     wd.gratings.fingers(size_um=12.8), wd.gratings.bumps(), wd.gratings.disc("CD", tracks=4, length_um=14.0),
     wd.gratings.disc("Blu-ray", tracks=4, length_um=4.0)],
    ids=["sine", "lamellar", "blazed", "fingers", "bumps", "CD", "Blu-ray"],
)  # fmt: skip
def test_usual_surfaces_are_not_warned_of(heightfield):
    assert 0.1 < heightfield.summary().scalar_error < SCALAR_INVALID


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
                orders = wd.order_efficiencies(heightfield, at_angle(angle), 1000.0, ior=math.inf, energy="stam")
                ours = [orders[0, first + n][0] for n in range(len(efficiencies))]
                worst = max(worst, float(np.max(np.abs(np.array(efficiencies) * stored["unit"] - ours))))
            errors.append(worst)
            bounds.append(scalar_error_bound(heightfield.rms_um, heightfield.mean_slope, 1000.0))
    error, bound = np.array(errors), np.array(bounds)
    assert np.mean(error[bound <= 0.1] <= 0.1) > 0.98
    assert error[bound <= 0.1].max() < 0.13
    # Gentle gratings are not only within the rule: there the scalar theory is right.
    assert error[bound <= 1e-3].max() < 2e-3
    # It is no rule that warns of everything.
    assert np.mean(bound[error <= 0.1] <= 0.1) > 0.6
    assert np.mean(error[bound >= SCALAR_INVALID] > 0.1) > 0.9


@pytest.mark.parametrize(("case", "make"), [
    ("Sine, perfect mirror", lambda *size: wd.gratings.sinusoidal(*size, samples=128)),
    ("Square grooves, perfect mirror", lambda *size: wd.gratings.lamellar(*size, samples=512)),
    ("Sawtooth, perfect mirror", lambda *size: wd.gratings.blazed(*size, samples=512)),
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
                results = [
                    wd.order_efficiencies(heightfield, at_angle(angle), 1000.0, ior=math.inf, energy=energy)
                    for energy in ("stam", "normalised")
                ]
                right = np.array(efficiencies) * stored["unit"]
                ours = [[orders[0, first + n][0] for n in range(len(right))] for orders in results]
                errors.append(np.max(np.abs(np.array(ours) - right), axis=1))
                bounds.append(scalar_error_bound(heightfield.rms_um, heightfield.mean_slope, 1000.0, normalised=True))
    stam, normalised = np.array(errors).T
    assert np.quantile(normalised, 0.9) < np.quantile(stam, 0.9)
    assert normalised.mean() < 0.75 * stam.mean()
    assert np.mean(normalised <= 1.5 * np.array(bounds)) > 0.9
