"""Cleaning of height fields: levelling, resampling, periodic part, despiking, and the measured scan."""

import re
from pathlib import Path

import numpy as np
import pytest
from conftest import noise

from warpdiff import gratings
from warpdiff.core.wording import WarpdiffWarning
from warpdiff.heightfield.field import HeightField


@pytest.mark.parametrize("order", [0, 1, 2, 5])
@pytest.mark.parametrize("shape", [(40, 30), (1, 30), (3, 50)])
def test_levelling_removes_polynomials_exactly_and_once(order: int, shape: tuple[int, int]) -> None:
    y, x = (np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1) for n in shape)
    rng = np.random.default_rng(3)
    powers = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    polynomial = sum((rng.normal() * np.outer(y**i, x**j) for i, j in powers), np.zeros(shape))
    rough = noise(shape)
    once = rough.levelled(order)
    tilted = HeightField.of_known_scale(rough.heights_um + 100.0 * polynomial, rough.pitch_um)
    np.testing.assert_allclose(tilted.levelled(order).heights_um, once.heights_um, atol=1e-11)
    np.testing.assert_allclose(once.levelled(order).heights_um, once.heights_um, atol=1e-15)
    assert abs(np.mean(once.heights_um)) < 1e-15
    assert once.rms_um <= rough.rms_um


def test_levelling_is_the_least_squares_solution() -> None:
    field = noise((12, 9))
    y, x = np.meshgrid(np.arange(12.0), np.arange(9.0), indexing="ij")
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)
    expected = field.heights_um.ravel() - basis @ np.linalg.lstsq(basis, field.heights_um.ravel(), rcond=None)[0]
    np.testing.assert_allclose(field.levelled(2).heights_um.ravel(), expected, atol=1e-13)


@pytest.mark.parametrize("shape", [(16, 24), (15, 21), (1, 32), (16, 15)])
@pytest.mark.parametrize("factor", [1.5, 2.0, 3.1])
def test_resampling_up_and_down_returns_the_original(shape: tuple[int, int], factor: float) -> None:
    field = noise(shape)
    finer = field.resampled((field.pitch_um[0] / factor, field.pitch_um[1] / factor))
    assert finer.size_um == pytest.approx(field.size_um, rel=1e-15)
    assert finer.shape == tuple(1 if n == 1 else round(n * factor) for n in shape)
    back = finer.resampled(field.pitch_um)
    np.testing.assert_allclose(back.heights_um, field.heights_um, atol=1e-15)
    # By Parseval's theorem, resampling preserves the rms height. Even numbers of samples are exceptions, because their
    # Nyquist term is split between two frequencies.
    if all(n % 2 == 1 for n in shape):
        assert finer.rms_um == pytest.approx(field.rms_um, rel=1e-12)
    assert np.mean(finer.heights_um) == pytest.approx(np.mean(field.heights_um), abs=1e-15)


def test_resampling_by_a_whole_factor_preserves_the_samples() -> None:
    field = noise((12, 10))
    finer = field.resampled((field.pitch_um[0] / 2.0, field.pitch_um[1] / 3.0))
    np.testing.assert_allclose(finer.heights_um[::2, ::3], field.heights_um, atol=1e-15)


def test_resampling_interpolates_a_wave_exactly_and_drops_higher_frequencies() -> None:
    x = np.arange(60) / 60.0
    slow, fast = np.cos(2.0 * np.pi * (3.0 * x + 0.1)), np.cos(2.0 * np.pi * 25.0 * x)
    coarse = HeightField.of_known_scale((slow + fast)[None, :], 1.0 / 60.0).resampled(1.0 / 20.0)
    expected = np.cos(2.0 * np.pi * (3.0 * np.arange(20) / 20.0 + 0.1))
    np.testing.assert_allclose(coarse.heights_um[0], expected, atol=1e-14)
    assert coarse.pitch_um == (1.0 / 60.0, pytest.approx(1.0 / 20.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_resampling_down_to_the_nyquist_term_samples_it(sign: float) -> None:
    # After resampling, a wave at the new Nyquist frequency must have the right sign.
    x = np.arange(24) / 24.0
    wave = HeightField.of_known_scale((sign * np.cos(2.0 * np.pi * 4.0 * x))[None, :], 1.0 / 24.0)
    coarse = wave.resampled(1.0 / 8.0)
    np.testing.assert_allclose(coarse.heights_um[0], sign * np.cos(np.pi * np.arange(8)), atol=1e-14)


def cross(heights: np.ndarray) -> float:
    """Return the spectral power on both axes of the frequency plane, divided by that on nearby lines parallel to them.

    The zero frequency, and the four lowest positive and negative frequencies along an axis, are excluded.
    """
    power = np.abs(np.fft.fft2(heights - heights.mean())) ** 2
    ny, nx = power.shape
    rows, columns = np.arange(5, ny - 4), np.arange(5, nx - 4)
    beside = [-8, -7, -6, -5, -4, -3, 3, 4, 5, 6, 7, 8]
    on = power[rows, 0].sum() + power[0, columns].sum()
    off = sum(power[rows, r].sum() + power[r, columns].sum() for r in beside) / len(beside)
    return float(on / off)


def test_the_spectrum_of_a_periodic_patch_has_no_cross() -> None:
    y, x = np.meshgrid(np.arange(64) / 64.0, np.arange(80) / 80.0, indexing="ij")
    tilted = HeightField(noise((64, 80)).heights_um + 2.0 * x - 1.0 * y + x * y, 0.1)
    with pytest.warns(WarpdiffWarning, match=r"range from 3\.\d+ to 0\.\d+ µm; level"):
        result = tilted.periodic()
    assert cross(tilted.heights_um) > 3.0
    assert cross(result.heights_um) < 1.5
    assert np.mean(result.heights_um) == pytest.approx(np.mean(tilted.heights_um), abs=1e-14)
    assert result.pitch_um == tilted.pitch_um


@pytest.mark.filterwarnings("ignore:periodic")
def test_the_periodic_part_solves_moisans_equation() -> None:
    # ``periodic()`` subtracts the smooth part of Moisan's decomposition. Except at the edges of the field, this part is
    # harmonic: its five-point Laplacian is 0.
    field = noise((20, 17))
    smooth = field.heights_um - field.periodic().heights_um
    laplacian = sum(np.roll(smooth, s, a) for s in (1, -1) for a in (0, 1)) - 4.0 * smooth
    np.testing.assert_allclose(laplacian[1:-1, 1:-1], 0.0, atol=1e-15)
    assert abs(smooth.mean()) < 1e-16
    # Fields with equal opposite edges and fields of a single row are already periodic. ``periodic()`` must not change
    # them.
    for same in (np.zeros((4, 5)), np.array([[1.0, 2.0, 1.0]])):
        np.testing.assert_allclose(HeightField(same, 1.0).periodic().heights_um, same, atol=1e-15)


CLEAN = {
    "sine": lambda: gratings.sinusoidal(1.6, 0.2), "lamellar": lambda: gratings.lamellar(1.6, 0.2),
    "narrow ridges": lambda: gratings.lamellar(1.6, 0.2, duty=0.1), "blaze": lambda: gratings.blazed(2.0, 0.3),
    "bumps": gratings.bumps, "disc": lambda: gratings.disc(tracks=6, length_um=15.0),
    "fingers": lambda: gratings.fingers(size_um=12.0), "flat": lambda: HeightField(np.full((30, 30), 0.37), 0.05),
    "one sample": lambda: HeightField([[1.0]], 0.05),
}  # fmt: skip


@pytest.mark.parametrize("name", CLEAN)
def test_despiking_does_not_change_clean_surfaces(name: str) -> None:
    field = CLEAN[name]()
    np.testing.assert_array_equal(field.despiked().heights_um, field.heights_um)


def test_despiking_removes_a_grain_and_nothing_else() -> None:
    clean = gratings.fingers(size_um=15.0)
    ny, nx = clean.shape
    y, x = np.meshgrid(np.arange(ny) * clean.pitch_um[0], np.arange(nx) * clean.pitch_um[1], indexing="ij")
    distance = np.hypot(y - 6.0, x - 9.0)
    scratch = (np.abs(y - x - 3.0) < 0.1) & (x < 2.0)
    dirty = HeightField(
        clean.heights_um + 0.8 * np.clip(1.4 - 2.0 * distance, 0.0, 1.0) + 0.6 * scratch, clean.pitch_um
    )
    result = dirty.despiked()
    changed = result.heights_um != dirty.heights_um
    assert changed[distance < 0.4].all()
    assert changed[scratch].all()
    assert np.mean(changed[(distance > 1.5) & (np.abs(y - x - 3.0) > 1.0)]) == 0.0
    assert np.mean(changed) < 0.03
    assert result.height_range_um < 1.1 * clean.height_range_um < 0.5 * dirty.height_range_um
    np.testing.assert_array_equal(result.heights_um[~changed], dirty.heights_um[~changed])


@pytest.mark.parametrize("pitch", [0.1, 0.5, 1.0, (0.2, 1.0)])
def test_despiking_replaces_by_heights_of_the_surroundings_at_every_pitch(pitch) -> None:
    heights = 0.02 * np.random.default_rng(1).normal(size=(96, 96))
    rough = np.ptp(heights)
    heights[40:44, 60:64] += 1.0
    clean = HeightField.of_known_scale(heights, pitch).despiked()
    assert np.ptp(clean.heights_um) <= rough
    assert (clean.heights_um != heights)[40:44, 60:64].all()


@pytest.mark.parametrize(("pitch", "size"), [(2.0, 1.0), ((0.1, 20.0), 1.0), (0.1, 0.05)])
def test_a_background_finer_than_the_pitch_is_refused(pitch, size) -> None:
    field = HeightField.of_known_scale(np.random.default_rng(1).normal(size=(30, 40)), pitch)
    with pytest.raises(ValueError, match=r"size_um must be at least the pitch of \S+ µm, got .*give size_um="):
        field.despiked(size_um=size)
    # ``size_um`` is the width of the Gaussian in despiking. Along an axis with a single sample, this width may be less
    # than the pitch. The pitch along this axis is 1000 µm here, which is more than the default width.
    HeightField.of_known_scale(field.heights_um[:1], (1e3, 0.1)).despiked()


def test_each_step_stands_in_the_history(tmp_path: Path) -> None:
    field = gratings.fingers(size_um=12.8)
    assert field.history == ()
    steps = field.cropped(6.4).levelled(2).despiked(2.5).filled().flipped("x").rotated(-1).resampled(0.1).periodic()
    words = ("Cropped to 6.4 × 6.4", "Levelled: .*degree 2", "Despiked with threshold=2.5 and size_um=1: replaced",
             "Filled: replaced 0 missing", "Flipped along x", "Rotated by 270°", "Resampled to a pitch of 0.1",
             "Made periodic: changed heights by")  # fmt: skip
    assert len(steps.history) == len(words)
    for step, word in zip(steps.history, words, strict=True):
        assert re.match(word, step)
        assert step.endswith(".")
    # A further cleaning step must be added to the history of the new field, but not to the history of the field from
    # which the new field was made.
    assert len(steps.levelled().history) == len(words) + 1
    assert len(steps.history) == len(words)
    path = steps.save(tmp_path / "a.npz")
    assert HeightField.load(path).history == steps.history
    with np.load(path) as arrays:
        assert tuple(arrays["history"].tolist()) == steps.history
    x = 0.05 * np.arange(300)
    waves = HeightField(0.1 * np.cos(2.0 * np.pi * x / 1.7)[None], 0.05).whole_periods()
    assert re.match(r"Cut to .* whole periods of 1\.70\d+ ± ", waves.history[-1])


# In the scan's image file, pixel values from 0 to 255 represent heights from 0 to 0.375 µm.
def test_real_scan_is_cleaned(scan_path: Path) -> None:
    scan = HeightField.load(scan_path, extent_um=65.0, height_range_um=0.375)
    assert scan.shape == (1332, 1332)
    assert scan.height_range_um == pytest.approx(0.375)
    level = scan.levelled(2)
    clean = level.despiked()
    changed = clean.heights_um != level.heights_um
    assert all(changed[y, x] for y, x in ((90, 823), (717, 525), (1240, 232)))
    assert 0.003 < np.mean(changed) < 0.012
    assert clean.height_range_um < 0.87 * level.height_range_um
    (fingers,) = clean.periods(1)
    assert fingers.period_um == pytest.approx(1.07, abs=0.03)
    assert 0.01 < fingers.standard_error_um < 0.06
    whole = clean.periodic()
    seam = np.abs(whole.heights_um[0] - whole.heights_um[-1]).mean()
    assert seam < 2.0 * np.abs(np.diff(whole.heights_um, axis=0)).mean()
