"""Periods from harmonic fits, their standard errors, cropping to whole periods, and warnings about few periods."""

import math
import re
import warnings

import numpy as np
import pytest

import warpdiff as wd
from bench.reproduce.periods import noise_field, noise_profile, score, wavering

PITCH = 0.05
Y, X = np.meshgrid(np.arange(200) * PITCH, np.arange(200) * PITCH, indexing="ij")


def grooves(period, *, degrees=0.0, height=0.572, noise=0.01, tilt=0.02, seed=0):
    """Return a height field of parallel grooves with rounded walls, noise and a tilt."""
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
    assert result.is_coherent
    assert result.period_um == pytest.approx(1.0 / math.hypot(*result.frequency))
    # The profile of the grooves is between a sine and a square wave of equal height. The amplitude of its fundamental
    # wave must therefore be between the amplitudes for these two profiles, and its second harmonic must nearly vanish.
    assert 0.5 * 0.572 < result.harmonics_um[0] < 4.0 / math.pi * 0.5 * 0.572
    assert result.harmonics_um[1] < 0.1 * result.harmonics_um[2]
    if period == 2.886 and degrees == 0.0:
        summary = field.summary()
        assert summary.periods == field.periods()[: len(summary.periods)]
        assert len(summary.periods) >= 1
        assert re.search(r"^periods +2\.88\d+ ± 0\.000\d+ µm at 0°", str(summary), re.MULTILINE)


def test_a_summary_lists_no_waviness():
    for field in (wd.gratings.lamellar(2.0, 0.2), wd.gratings.blazed(2.5, 0.25), wd.gratings.bumps()):
        assert field.summary().periods == ()
        assert "no feature repeats at least three times (field is one period)" in str(field.summary())


def test_standard_errors_equal_the_deviation_of_many_fits():
    rng = np.random.default_rng(2)
    scores = []
    for _ in range(15):
        wave = 0.1 * np.cos(2.0 * np.pi * (X[:24, :120] / 1.37 + 0.1))
        result = wd.HeightField(wave + 0.1 * rng.normal(size=wave.shape), PITCH).periods(1)[0]
        scores.append((result.period_um - 1.37) / result.standard_error_um)
    assert abs(np.mean(scores)) < 0.6
    assert 0.4 < np.std(scores) < 1.4


@pytest.mark.parametrize(("noise", "least"), [(0.3, 30), (1.0, 10)])
def test_standard_errors_cover_the_true_ones_in_strong_noise_too(noise, least):
    rng, x = np.random.default_rng(8), PITCH * np.arange(300)
    scores = []
    for phase in rng.uniform(0.0, 2.0 * np.pi, 30):
        heights = 0.01 * (np.cos(2.0 * np.pi * x / 1.37 + phase) + noise * rng.normal(size=(1, 300)))
        # No period is returned for a wave that may be noise. The list ``scores`` contains the error of each returned
        # period in units of its standard error, so that a field without a returned period adds no entry.
        scores += [
            abs(result.period_um - 1.37) / result.standard_error_um
            for result in wd.HeightField(heights, PITCH).periods(1)
        ]
    assert len(scores) >= least
    assert np.mean(np.array(scores) < 2.0) > 0.85
    assert 0.3 < np.median(scores) / 0.6745 < 1.5


def test_structure_below_waviness_is_found_and_waviness_is_no_period():
    heights = (
        0.2 * np.cos(2.0 * np.pi * Y / 7.3)
        + 0.1 * np.cos(2.0 * np.pi * X / 1.23)
        + 0.03 * np.sin(2.0 * np.pi * (X + Y) / 0.91)
        + 2.0 * X
    )
    # Missing samples do not prevent the fit of periods.
    heights[60:90, 80:140] = np.nan
    strong, weak = wd.HeightField(heights, PITCH).periods()
    assert strong.period_um == pytest.approx(1.23, rel=2e-3)
    assert weak.period_um == pytest.approx(0.91 / math.sqrt(2.0), rel=2e-3)
    assert weak.direction_deg == pytest.approx(45.0, abs=0.3)
    assert strong.harmonics_um[0] == pytest.approx(0.1, rel=0.03)
    assert strong.share > weak.share > 0.0


def test_two_waves_of_similar_periods_are_two_and_a_wavering_one_is_one():
    x, y = X[:100], Y[:100]
    noise = 0.01 * np.random.default_rng(5).normal(size=x.shape)
    heights = 0.1 * np.cos(2.0 * np.pi * x / 0.6) + 0.08 * np.cos(2.0 * np.pi * x / 0.9) + noise
    two = wd.HeightField(heights, PITCH).periods()
    assert sorted(period.period_um for period in two) == pytest.approx([0.6, 0.9], rel=0.01)
    for depth, length in ((0.3, 2.3), (0.8, 2.3), (2.4, 5.0)):
        phase = 2.0 * np.pi * x / 0.9 + depth * np.sin(2.0 * np.pi * y / length + 0.4)
        (one,) = wd.HeightField(0.1 * np.cos(phase) + noise, PITCH).periods()
        assert abs(one.period_um - 0.9) < max(2.0 * one.standard_error_um, 1e-3)
        assert one.share > 0.5
    # The local frequency of this wave increases along x by 0.4 cycles per µm, so that its mean is 0.2 above its first
    # value.
    (chirp,) = wd.HeightField(0.1 * np.cos(2.0 * np.pi * (x / 0.9 + 0.02 * x**2)) + noise, PITCH).periods()
    assert not chirp.is_coherent
    assert abs(1.0 / chirp.period_um - (1.0 / 0.9 + 0.2)) < 0.02
    assert chirp.standard_error_um > 0.01


def test_nothing_depends_on_the_unit():
    rng = np.random.default_rng(3)
    phase = 2.0 * np.pi * X / 0.9 + 0.3 * np.cumsum(rng.normal(size=200))[:, None]
    heights = 0.1 * np.cos(phase) + 0.03 * rng.normal(size=X.shape)
    (expected,) = wd.HeightField(heights, PITCH).periods(1)
    for of_heights, of_pitch in ((1e-9, 1.0), (1e6, 1e7)):
        (period,) = wd.HeightField.of_known_scale(of_heights * heights, of_pitch * PITCH).periods(1)
        assert period.period_um == pytest.approx(of_pitch * expected.period_um, rel=1e-6)
        assert period.standard_error_um == pytest.approx(of_pitch * expected.standard_error_um, rel=1e-4)
        assert period.harmonics_um == pytest.approx([of_heights * a for a in expected.harmonics_um], rel=1e-4)
        assert period.share == pytest.approx(expected.share, rel=1e-6)


def test_standard_errors_include_the_variation_of_the_period():
    """At least 85 % of the measured periods must differ from the true period by at most two standard errors.

    The fields are like those of bench/reproduce/periods.py, but have other random seeds.
    """
    scores = [score(wavering(seed)) for seed in (*range(5003, 5063, 4), 5000, 5001, 5002, 5004)]
    found = np.array([value for value in scores if value is not None])
    assert len(found) >= len(scores) - 3
    assert np.mean(np.abs(found) <= 2.0) >= 0.85
    assert np.sqrt(np.mean(found**2)) > 0.4


def test_noise_has_no_period():
    assert sum(bool(noise_profile(seed).periods()) for seed in range(5000, 5014)) == 0
    assert sum(bool(noise_field(seed).periods()) for seed in range(5000, 5010)) == 0


def test_flat_fields_have_no_period_and_one_row_has_one():
    assert wd.HeightField(np.full((20, 30), 0.3), PITCH).periods() == ()
    assert wd.HeightField([[0.1]], PITCH).periods() == ()
    row = wd.HeightField(0.1 * np.cos(2.0 * np.pi * X[:1] / 1.7), PITCH)
    (result,) = row.periods()
    assert result.period_um == pytest.approx(1.7, rel=1e-6)
    assert result.harmonics_um[0] == pytest.approx(0.1, rel=1e-4)
    assert result.direction_deg == pytest.approx(0.0)
    assert re.fullmatch(r"Period\(1\.700000 ± 0\.00000\d µm at 0°, share 1\)", repr(result))
    assert result == row.periods()[0]


@pytest.mark.parametrize(("degrees", "shape"), [(0.0, (200, 173)), (90.0, (173, 200))])
def test_whole_periods_match_at_the_edges(degrees, shape):
    field = grooves(2.886, degrees=degrees, noise=0.0, tilt=0.0)
    cut = field.whole_periods()
    # Three periods of 2.886 µm are 173.16 samples, so the field is cropped to 173 samples.
    assert cut.shape == shape
    np.testing.assert_array_equal(cut.heights_um, field.heights_um[: shape[0], : shape[1]])
    axis = int(degrees == 0.0)

    # Lines are rows or columns of samples along the grooves. The cropped field ends before line 173 of the original
    # field, and contains a whole number of periods. Line 173 therefore nearly equals line 0. The last line of the
    # original field does not.
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


def test_a_broad_line_beside_that_of_a_short_period_does_not_move_it(rng):
    # The field has a wave with 819 periods whose phase varies, and noise. The noise has a third of the wave's power, in
    # a broad line of the spectrum at 1.18 times the frequency of the wave. This line must not change the period that is
    # found.
    count, length = 4096, 5.0
    smooth = np.fft.irfft(
        np.fft.rfft(rng.normal(size=count)) * np.exp(-0.5 * (250.0 * np.fft.rfftfreq(count)) ** 2), count
    )
    phase = 2.0 * np.pi / length * np.cumsum(1.0 + 0.01 * smooth / np.std(smooth))
    band = np.exp(-0.5 * ((length * np.fft.rfftfreq(count) - 1.18) / 0.06) ** 2)
    beside = np.fft.irfft(np.fft.rfft(rng.normal(size=count)) * band, count)
    heights = np.cos(phase) + 0.6 * beside / np.std(beside) + rng.normal(0.0, 0.05, count)
    (period,) = wd.HeightField.of_known_scale(0.05 * heights[None], 0.1).periods(1)
    assert not period.is_coherent
    assert abs(period.period_um - 0.5) < 3.0 * period.standard_error_um < 0.01


def test_periods_of_less_than_three_samples_are_not_resolved():
    x = 0.1 * np.arange(200)
    heights = np.cos(2.0 * np.pi * x / 0.33)[None] + 0.5 * np.cos(2.0 * np.pi * x / 0.27)
    periods = wd.HeightField(0.05 * heights, 0.1).periods()
    assert [period.is_resolved for period in periods] == [True, False]


def test_periods_are_a_tuple_that_is_saved_as_a_table(tmp_path):
    x = 0.02 * np.arange(900)
    heights = 0.1 * np.cos(2.0 * np.pi * x / 0.61) + 0.03 * np.cos(2.0 * np.pi * x / 1.7)
    periods = wd.HeightField(heights[None], 0.02).periods()
    assert isinstance(periods, tuple)
    path = periods.save(tmp_path / "periods.csv")
    rows = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    np.testing.assert_allclose(rows["period_um"], [0.61, 1.7], rtol=1e-3)
    np.testing.assert_allclose(rows["amplitude_um"], [0.1, 0.03], rtol=1e-2)
    assert rows["standard_error_um"].tolist() == [period.standard_error_um for period in periods]
    assert rows["is_coherent"].tolist() == [True, True]
    assert len(wd.HeightField([[0.1]], PITCH).periods().table()) == 0
