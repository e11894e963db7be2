"""Periods from harmonic fits, their standard errors, cropping to whole periods, and warnings about few periods."""

import math
import re
import warnings

import numpy as np
import pytest

import warpdiff as wd

PITCH = 0.05
Y, X = np.meshgrid(np.arange(200) * PITCH, np.arange(200) * PITCH, indexing="ij")


def grooves(period, *, degrees=0.0, height=0.572, noise=0.01, tilt=0.02, seed=0):
    """Return parallel grooves with rounded walls, noise and a tilt."""
    along = X * math.cos(math.radians(degrees)) + Y * math.sin(math.radians(degrees))
    heights = 0.5 * height * np.tanh(4.0 * np.sin(2.0 * np.pi * along / period + 1.2)) + tilt * (X - 0.5 * Y)
    return wd.HeightField(heights + noise * np.random.default_rng(seed).normal(size=X.shape), PITCH)


@pytest.mark.parametrize(("period", "degrees"), [(2.886, 0.0), (2.886, 20.0), (1.1, 70.0), (0.7, 90.0), (2.2, -35.0)])
def test_periods_between_fourier_coefficients_are_accurate_to_their_standard_error(period, degrees):
    field = grooves(period, degrees=degrees)
    result = field.periods(1)[0]
    assert abs(result.period_um - period) < 4.0 * result.standard_error_um < 0.01 * period
    assert abs((result.direction_deg - degrees + 90.0) % 180.0 - 90.0) < 0.1
    assert result.share > 0.98
    assert not result.is_waviness
    assert result.period_um == pytest.approx(1.0 / math.hypot(*result.frequency))
    # The grooves have only odd harmonics, and a first amplitude between those of a sine and of a square wave.
    assert 0.5 * 0.572 < result.harmonics_um[0] < 4.0 / math.pi * 0.5 * 0.572
    assert result.harmonics_um[1] < 0.1 * result.harmonics_um[2]
    if period == 2.886 and degrees == 0.0:
        summary = field.summary()
        assert summary.periods == field.periods()[: len(summary.periods)]
        assert len(summary.periods) >= 1
        assert re.search(r"^periods +2\.8860\d ± 0\.0000\d µm at 0°", str(summary), re.MULTILINE)


def test_a_summary_lists_no_waviness():
    for field in (wd.gratings.lamellar(2.0, 0.2), wd.gratings.blazed(2.5, 0.25), wd.gratings.bumps()):
        assert field.summary().periods == ()
        assert "no feature repeats at least three times (field is one period)" in str(field.summary())


def test_standard_errors_equal_the_deviation_of_many_fits():
    rng = np.random.default_rng(2)
    scores = []
    for _ in range(40):
        wave = 0.1 * np.cos(2.0 * np.pi * (X[:60, :80] / 1.37 + 0.1))
        result = wd.HeightField(wave + 0.1 * rng.normal(size=wave.shape), PITCH).periods(1)[0]
        scores.append((result.period_um - 1.37) / result.standard_error_um)
    assert abs(np.mean(scores)) < 0.6
    assert 0.6 < np.std(scores) < 1.6


@pytest.mark.parametrize("noise", [0.3, 2.0])
def test_standard_errors_are_valid_in_strong_noise(noise):
    rng, x = np.random.default_rng(8), PITCH * np.arange(300)
    scores = []
    for phase in rng.uniform(0.0, 2.0 * np.pi, 60):
        heights = 0.01 * (np.cos(2.0 * np.pi * x / 1.37 + phase) + noise * rng.normal(size=(1, 300)))
        result = wd.HeightField(heights, PITCH).periods(1)[0]
        scores.append(abs(result.period_um - 1.37) / result.standard_error_um)
    # In some of the 60 fields the spectrum of the noise has a higher peak than that of the wave, and the fit finds it.
    assert np.mean(np.array(scores) < 2.0) > 0.85
    assert 0.5 < np.median(scores) / 0.6745 < 1.5


@pytest.mark.parametrize("seed", [87, 115])
def test_a_fit_that_diverges_in_strong_noise_still_gives_a_period(seed):
    """In strong noise the fit can diverge to a period much larger than the field.

    A fraction of such a wave, together with a tilt, would fit any field.
    """
    noise = np.fft.fft2(np.random.default_rng(seed).normal(size=(60, 80)))
    noise *= np.exp(-0.5 * np.hypot(np.fft.fftfreq(60, PITCH)[:, None], np.fft.fftfreq(80, PITCH)))
    noise = np.fft.ifft2(noise).real
    heights = 0.01 * np.cos(2.0 * np.pi * X[:60, :80] / 1.37) + 0.04 * noise / np.std(noise)
    (result,) = wd.HeightField(heights, PITCH).periods(1)
    assert result.share > 0.01
    assert max(result.harmonics_um) < 0.1


def test_sums_of_waves_and_waviness_are_distinguished():
    heights = (
        0.2 * np.cos(2.0 * np.pi * Y / 7.3)
        + 0.1 * np.cos(2.0 * np.pi * X / 1.23)
        + 0.03 * np.sin(2.0 * np.pi * (X + Y) / 0.91)
    )
    # Missing samples do not prevent the fit of periods.
    heights[60:90, 80:140] = np.nan
    waviness, strong, weak = wd.HeightField(heights, PITCH).periods()
    assert [period.is_waviness for period in (waviness, strong, weak)] == [True, False, False]
    assert waviness.period_um == pytest.approx(7.3, rel=0.05)
    assert strong.period_um == pytest.approx(1.23, rel=1e-3)
    assert weak.period_um == pytest.approx(0.91 / math.sqrt(2.0), rel=1e-3)
    assert weak.direction_deg == pytest.approx(45.0, abs=0.2)
    assert strong.harmonics_um[0] == pytest.approx(0.1, rel=0.02)
    assert waviness.share > strong.share > weak.share > 0.0
    assert waviness.share + strong.share + weak.share == pytest.approx(1.0, abs=0.01)


def test_flat_fields_have_no_period_and_one_row_has_one():
    assert wd.HeightField(np.full((20, 30), 0.3), PITCH).periods() == ()
    assert wd.HeightField([[0.1]], PITCH).periods() == ()
    row = wd.HeightField(0.1 * np.cos(2.0 * np.pi * X[:1] / 1.7), PITCH)
    (result,) = row.periods()
    assert result.period_um == pytest.approx(1.7, rel=1e-6)
    assert result.harmonics_um[0] == pytest.approx(0.1, rel=1e-4)
    assert result.direction_deg == pytest.approx(0.0)
    assert repr(result) == "Period(1.700000 ± 0.000000 µm at 0°, share 1)"
    assert result == row.periods()[0]


@pytest.mark.parametrize(("degrees", "shape"), [(0.0, (200, 173)), (90.0, (173, 200))])
def test_whole_periods_match_at_the_edges(degrees, shape):
    field = grooves(2.886, degrees=degrees, noise=0.0, tilt=0.0)
    cut = field.whole_periods()
    # Three periods of 2.886 µm are 173.16 samples, so the field is cropped to 173 samples.
    assert cut.shape == shape
    np.testing.assert_array_equal(cut.heights_um, field.heights_um[: shape[0], : shape[1]])
    axis = int(degrees == 0.0)

    # The line that would follow the cropped field equals its first line, up to the rounding to whole samples.
    lines = np.moveaxis(field.heights_um, axis, 0)
    assert np.abs(lines[173] - lines[0]).max() < 0.01
    assert np.abs(lines[199] - lines[0]).max() > 0.1
    # The cropped field is nearly periodic, so ``periodic()`` changes it little.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cut.periodic().height_range_um < 1.1 * cut.height_range_um


def test_a_field_without_a_period_is_not_cut():
    with pytest.raises(ValueError, match=r"whole_periods\(\) needs a period that repeats.*use periodic\(\)"):
        wd.HeightField(0.1 * np.cos(2.0 * np.pi * X / 7.0), PITCH).whole_periods()


def test_making_few_periods_periodic_causes_a_warning():
    field = grooves(2.886, tilt=0.0)
    with pytest.warns(wd.WarpdiffWarning, match=r"periodic\(\) changed heights by .* range from .* to .*whole_periods"):
        bent = field.periodic()
    assert bent.height_range_um > 1.2 * field.height_range_um
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # The opposite edges of a rough surface differ, but ``periodic()`` changes its heights too little for a warning.
        spectrum = np.fft.rfft2(np.random.default_rng(4).normal(size=(400, 400)))
        frequency = np.hypot(np.fft.fftfreq(400, PITCH)[:, None], np.fft.rfftfreq(400, PITCH))
        rough = np.fft.irfft2(spectrum * np.exp(-((0.5 * frequency) ** 2)), (400, 400))
        wd.HeightField(0.05 * rough / np.std(rough), PITCH).cropped(13.7).levelled(1).periodic()
