"""The summary of a height field, and its mean slope."""

import numpy as np
import pytest

import warpdiff as wd


def test_a_summary_states_size_pitch_heights_periods_and_limits() -> None:
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


def test_the_mean_slope_does_not_depend_on_the_samples():
    walls = [wd.gratings.lamellar(2.0, 0.2, samples=n) for n in (10, 400)]
    assert walls[0].mean_slope == pytest.approx(walls[1].mean_slope) == pytest.approx(2.0 * 0.2 / 2.0)
    assert walls[1].rms_slope > 3.0 * walls[0].rms_slope
    y = np.arange(40)[:, None] * 0.1
    sloped = wd.HeightField(0.3 * np.cos(2.0 * np.pi * y / 4.0) * np.ones((1, 3)), 0.1)
    assert sloped.mean_slope == pytest.approx(4.0 * 0.3 / 4.0, rel=1e-2)


def test_a_summary_lists_a_wavering_period(rng):
    """The summary must list the period of ridges with a varying spacing; its standard error must exceed 1 %."""
    drift = np.cumsum(rng.normal(0.0, 0.025, 800))
    ridges = 0.1 * np.cos(2.0 * np.pi * (np.arange(800) * 0.05 + drift - drift.mean())) + np.zeros((40, 1))
    field = wd.HeightField(ridges + rng.normal(0.0, 0.01, ridges.shape), 0.05)
    (period,) = field.periods()
    assert period.standard_error_um > 0.01 * period.period_um
    assert str(period) in str(field.summary())
