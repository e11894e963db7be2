"""Synthetic gratings: closed forms, continuity across periods, statistics of random surfaces, invalid arguments."""

from typing import Any

import numpy as np
import pytest
from conftest import slow

from warpdiff import gratings


def test_sine_has_one_harmonic() -> None:
    field = gratings.sinusoidal(1.6, 0.2)
    assert (field.shape, field.size_um[1]) == ((1, 64), pytest.approx(1.6))
    assert field.pitch_um[0] == field.pitch_um[1] == 1.6 / 64
    assert field.height_range_um == pytest.approx(0.2, abs=1e-15)
    spectrum = np.fft.fft(field.heights_um[0]) / 64
    expected = np.zeros(64)
    expected[[1, -1]] = 0.05
    np.testing.assert_allclose(spectrum, expected, atol=1e-16)


@pytest.mark.parametrize("make", [gratings.sinusoidal, gratings.lamellar, gratings.blazed])
@pytest.mark.parametrize("period", [0.5, 2.56, 2.5601, 20.0])
def test_default_pitch_is_fine_enough(make: Any, period: float) -> None:
    field = make(period, 0.1)
    assert field.shape[1] >= 64
    assert field.pitch_um[1] <= 0.04 * (1.0 + 1e-9)
    assert field.size_um[1] == pytest.approx(period)
    assert make(period, 0.1, samples=10).shape == (1, 10)


@pytest.mark.parametrize(("duty", "high"), [(0.5, 32), (0.25, 16), (0.01, 1), (0.99, 63)])
def test_a_lamellar_grating_has_two_levels(duty: float, high: int) -> None:
    heights = gratings.lamellar(1.0, 0.15, duty=duty).heights_um[0]
    np.testing.assert_array_equal(heights, [0.15] * high + [0.0] * (64 - high))


def test_blaze_rises_with_x() -> None:
    np.testing.assert_allclose(gratings.blazed(2.0, 0.3, samples=6).heights_um, [[0, 0.05, 0.1, 0.15, 0.2, 0.25]])


DISC_TRUTH = {
    "CD": (1.6, 0.126, 0.278, 3, 11), "DVD": (0.74, 0.105, 0.1333, 3, 11), "Blu-ray": (0.32, 0.063, 0.0745, 2, 8),
}  # fmt: skip


@pytest.mark.parametrize("kind", ["CD", slow("DVD"), "Blu-ray"])
def test_a_disc_has_the_track_pitch_depth_and_run_lengths_of_its_kind(kind: str) -> None:
    track_pitch, depth, bit, shortest, longest = DISC_TRUTH[kind]
    field = gratings.disc(kind, tracks=8, length_um=20.0, pitch_um=0.02, seed=5)
    assert field.size_um == pytest.approx((20.0, 8 * track_pitch))
    assert field.height_range_um == pytest.approx(depth)
    assert field.heights_um.max() == 0.0
    (period,) = field.periods(count=1)
    assert (period.period_um, period.direction_deg) == pytest.approx((track_pitch, 0.0), abs=1e-4)
    across = field.shape[1] // 8
    runs = []
    for centre in field.heights_um[:, across // 2 :: across].T:
        pit = centre < -0.5 * depth
        edges = np.nonzero(pit != np.roll(pit, 1))[0]
        runs += list(np.diff(edges) * field.pitch_um[0] / bit)
    assert min(runs) > shortest - 0.75
    assert max(runs) < longest + 0.75
    assert 0.4 < np.mean(field.heights_um[:, across // 2 :: across] < -0.5 * depth) < 0.6


def test_a_bump_has_the_requested_size_and_height() -> None:
    field = gratings.bumps()
    assert field.size_um == pytest.approx((2.0, 1.0))
    heights = field.heights_um
    ny, nx = field.shape
    assert heights[ny // 2, nx // 2] == heights.max() == 0.15
    assert heights.min() == 0.0
    up = np.nonzero(heights > 0.0)
    assert (np.ptp(up[0]) + 2) * field.pitch_um[0] == pytest.approx(1.0, abs=2.0 * field.pitch_um[0])
    assert (np.ptp(up[1]) + 2) * field.pitch_um[1] == pytest.approx(0.5, abs=2.0 * field.pitch_um[1])
    # The volume of an elliptic paraboloid cap is half of base area times height.
    volume = heights.sum() * np.prod(field.pitch_um)
    assert volume == pytest.approx(0.5 * np.pi * 0.5 * 0.25 * 0.15, rel=0.01)


def test_fingers_have_the_requested_size_height_and_period() -> None:
    field = gratings.fingers()
    assert (field.shape, field.size_um) == ((512, 512), pytest.approx((25.6, 25.6)))
    assert field.height_range_um == pytest.approx(0.3, abs=1e-15)
    assert field.heights_um.max() == pytest.approx(0.15)
    (period,) = field.periods(count=1)
    assert (period.period_um, period.direction_deg) == pytest.approx((1.1, 0.0), abs=0.05)
    other = gratings.fingers(size_um=(12.0, 20.0), pitch_um=(0.06, 0.04), period_um=0.8, length_um=2.0, height_um=1.0)
    assert (other.shape, other.height_range_um) == ((200, 500), pytest.approx(1.0))
    # The finger-like bumps are elongated along y, so heights are correlated much farther along y than along x.
    centred = field.heights_um - field.heights_um.mean()
    correlation = np.fft.ifft2(np.abs(np.fft.fft2(centred)) ** 2).real / (centred**2).sum()
    assert correlation[10, 0] > 0.8
    assert correlation[0, 10] < 0.2


RANDOM = {
    "disc": lambda seed: gratings.disc("DVD", tracks=4, length_um=10.0, seed=seed),
    "fingers": lambda seed: gratings.fingers(size_um=10.0, seed=seed),
}


@pytest.mark.parametrize("name", RANDOM)
def test_equal_seeds_give_equal_heights_and_other_seeds_do_not(name: str) -> None:
    make = RANDOM[name]
    np.testing.assert_array_equal(make(1).heights_um, make(1).heights_um)
    assert not np.array_equal(make(1).heights_um, make(2).heights_um)


SEAMLESS = {
    **{name: (lambda make=make: make(0)) for name, make in RANDOM.items()},
    "sine": lambda: gratings.sinusoidal(1.0, 0.1),
    "bumps": gratings.bumps,
}


@pytest.mark.parametrize("name", SEAMLESS)
@pytest.mark.parametrize("axis", [0, 1])
def test_height_differences_at_the_seam_equal_those_elsewhere(name: str, axis: int) -> None:
    heights = SEAMLESS[name]().heights_um
    steps = np.abs(heights - np.roll(heights, 1, axis)).mean(axis=1 - axis)
    assert steps[0] <= 1.5 * np.quantile(steps, 0.98) + 1e-15


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [(lambda: gratings.sinusoidal(0.0, 0.1), ValueError, "period_um must be a finite number, more than 0"),
     (lambda: gratings.sinusoidal(1.0, -0.1), ValueError, "depth_um must be a finite number, at least 0"),
     (lambda: gratings.sinusoidal(1.0, 0.1, samples=1), ValueError, "samples must be an integer, at least 2"),
     (lambda: gratings.lamellar(1.0, 0.1, duty=0.0), ValueError, "duty must be a finite number, more than 0"),
     (lambda: gratings.lamellar(1.0, 0.1, duty=1.0), ValueError, "duty must leave at least one of 64"),
     (lambda: gratings.lamellar(1.0, 0.1, duty=0.1, samples=4), ValueError, "duty must leave at least one of 4"),
     (lambda: gratings.disc(tracks=0), ValueError, "tracks must be an integer, at least 1"),
     (lambda: gratings.disc(length_um=1.0), ValueError, "length_um must be a finite number, at least 12.232"),
     (lambda: gratings.disc("Blu-ray", pitch_um=0.1), ValueError, "pitch_um must be at most half of a pit's width"),
     (lambda: gratings.disc(seed=-1), ValueError, "seed must be an integer, at least 0"),
     (lambda: gratings.bumps(height_um=-1.0), ValueError, "height_um must be a finite number, at least 0"),
     (lambda: gratings.bumps(spacing_um=0.7), ValueError, r"spacing_um\[0\] must be at least length_um = 1"),
     (lambda: gratings.bumps(spacing_um=(1.0, 0.4)), ValueError, r"spacing_um\[1\] must be at least width_um = 0.5"),
     (lambda: gratings.fingers(size_um=1.0), ValueError, "size_um must be at least one finger"),
     (lambda: gratings.fingers(pitch_um=0.2), ValueError, "pitch_um must be at most an eighth of a finger")],
)  # fmt: skip
def test_invalid_arguments_of_gratings_are_refused(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call()
