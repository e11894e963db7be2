"""Height fields: closed forms, identities, files, the real scan, and bad input."""

from __future__ import annotations

import math
import weakref
from typing import TYPE_CHECKING, Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the name its own documentation uses)
import pytest

from warpdiff import gratings
from warpdiff.core.wording import WarpdiffWarning
from warpdiff.heightfield.field import HeightField

if TYPE_CHECKING:
    from pathlib import Path

RNG_SEED = 7


def noise(shape: tuple[int, int], pitch: Any = (0.1, 0.05)) -> HeightField:
    return HeightField(np.random.default_rng(RNG_SEED).normal(0.0, 0.05, shape), pitch)


def write_image(path: Path, samples: np.ndarray, channels: int = 1) -> None:
    buffer = oiio.ImageBuf(np.ascontiguousarray(np.repeat(samples[..., None], channels, axis=2)))
    assert buffer.write(str(path)), buffer.geterror()


# The class itself


def test_holds_a_read_only_copy() -> None:
    given = 0.1 * np.arange(6.0).reshape(2, 3)
    field = HeightField(given, (0.5, 0.25))
    given[0, 0] = 9.0
    assert field.heights_um[0, 0] == 0.0
    assert field.heights_um.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        field.heights_um[0, 0] = 1.0
    with pytest.raises(AttributeError):
        field.pitch_um = (1.0, 1.0)  # type: ignore[misc]
    assert (field.shape, field.pitch_um, field.size_um) == ((2, 3), (0.5, 0.25), (1.0, 0.75))


def test_is_compared_by_identity_and_can_be_a_weak_key() -> None:
    first, second = noise((2, 3)), noise((2, 3))
    assert first != second
    assert weakref.WeakKeyDictionary({first: 1, second: 2})[second] == 2
    assert "2 × 3" in repr(first)
    assert "µm" in repr(first)


def test_range_rms_and_slope_have_closed_forms() -> None:
    sine = gratings.sinusoidal(2.0, 0.2, samples=2000)
    assert sine.height_range_um == pytest.approx(0.2)
    assert sine.rms_um == pytest.approx(0.1 / math.sqrt(2.0))
    assert sine.rms_slope == pytest.approx(0.1 * math.pi / math.sqrt(2.0), rel=2e-3)
    plane = HeightField(np.add.outer(0.3 * np.arange(5) * 0.1, 0.4 * np.arange(7) * 0.2), (0.1, 0.2))
    assert plane.rms_slope == pytest.approx(0.5)
    assert HeightField([[1.0]], 1.0).rms_slope == 0.0


# Identities


@pytest.mark.parametrize("order", [0, 1, 2, 5])
@pytest.mark.parametrize("shape", [(40, 30), (1, 30), (3, 50)])
def test_levelling_removes_polynomials_exactly_and_once(order: int, shape: tuple[int, int]) -> None:
    y, x = (np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1) for n in shape)
    rng = np.random.default_rng(3)
    polynomial = sum(
        (rng.normal() * np.outer(y**i, x**j) for i in range(order + 1) for j in range(order + 1 - i)), np.zeros(shape)
    )
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
    # Parseval; only the Nyquist terms of even counts, split in two, hold less.
    if all(n % 2 == 1 for n in shape):
        assert finer.rms_um == pytest.approx(field.rms_um, rel=1e-12)
    assert np.mean(finer.heights_um) == pytest.approx(np.mean(field.heights_um), abs=1e-15)


def test_resampling_by_a_whole_number_keeps_the_samples() -> None:
    field = noise((12, 10))
    finer = field.resampled((field.pitch_um[0] / 2.0, field.pitch_um[1] / 3.0))
    np.testing.assert_allclose(finer.heights_um[::2, ::3], field.heights_um, atol=1e-15)


def test_resampling_interpolates_a_wave_exactly_and_drops_what_does_not_fit() -> None:
    x = np.arange(60) / 60.0
    slow, fast = np.cos(2.0 * np.pi * (3.0 * x + 0.1)), np.cos(2.0 * np.pi * 25.0 * x)
    coarse = HeightField.of_known_scale((slow + fast)[None, :], 1.0 / 60.0).resampled(1.0 / 20.0)
    np.testing.assert_allclose(
        coarse.heights_um[0], np.cos(2.0 * np.pi * (3.0 * np.arange(20) / 20.0 + 0.1)), atol=1e-14
    )
    assert coarse.pitch_um == (1.0 / 60.0, pytest.approx(1.0 / 20.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_resampling_down_to_the_nyquist_term_samples_it(sign: float) -> None:
    # A term of frequency ±n/2 must come out as the samples of the wave, whatever its sign.
    x = np.arange(24) / 24.0
    coarse = HeightField.of_known_scale((sign * np.cos(2.0 * np.pi * 4.0 * x))[None, :], 1.0 / 24.0).resampled(
        1.0 / 8.0
    )
    np.testing.assert_allclose(coarse.heights_um[0], sign * np.cos(np.pi * np.arange(8)), atol=1e-14)


def test_cropping_takes_the_samples_named() -> None:
    field = noise((20, 30), (0.1, 0.2))
    middle = field.cropped((1.0, 2.0))
    np.testing.assert_array_equal(middle.heights_um, field.heights_um[5:15, 10:20])
    corner = field.cropped((0.52, 1.58), offset_um=(0.31, 0.0))
    np.testing.assert_array_equal(corner.heights_um, field.heights_um[3:8, 0:8])
    np.testing.assert_array_equal(field.cropped(field.size_um).heights_um, field.heights_um)
    assert gratings.sinusoidal(2.0, 0.1).cropped(1.0).shape == (1, 32)


def cross(heights: np.ndarray) -> float:
    """Power on the two axes over that on neighbouring lines, from the fifth coefficient on."""
    power = np.abs(np.fft.fft2(heights - heights.mean())) ** 2
    ny, nx = power.shape
    rows, columns = np.arange(5, ny - 4), np.arange(5, nx - 4)
    beside = [-8, -7, -6, -5, -4, -3, 3, 4, 5, 6, 7, 8]
    on = power[rows, 0].sum() + power[0, columns].sum()
    off = sum(power[rows, r].sum() + power[r, columns].sum() for r in beside) / len(beside)
    return float(on / off)


def test_a_periodic_patch_has_no_cross() -> None:
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
    # Inside, the smooth part is harmonic up to nothing at all: its five-point Laplacian vanishes off the edges.
    field = noise((20, 17))
    smooth = field.heights_um - field.periodic().heights_um
    laplacian = sum(np.roll(smooth, s, a) for s in (1, -1) for a in (0, 1)) - 4.0 * smooth
    np.testing.assert_allclose(laplacian[1:-1, 1:-1], 0.0, atol=1e-15)
    assert abs(smooth.mean()) < 1e-16
    # What matches already stays: equal edges, and a single sample across.
    for same in (np.zeros((4, 5)), np.array([[1.0, 2.0, 1.0]])):
        np.testing.assert_allclose(HeightField(same, 1.0).periodic().heights_um, same, atol=1e-15)


CLEAN = {
    "sine": lambda: gratings.sinusoidal(1.6, 0.2),
    "lamellar": lambda: gratings.lamellar(1.6, 0.2),
    "narrow ridges": lambda: gratings.lamellar(1.6, 0.2, duty=0.1),
    "blaze": lambda: gratings.blazed(2.0, 0.3),
    "bumps": gratings.bumps,
    "disc": lambda: gratings.disc(tracks=6, length_um=15.0),
    "fingers": lambda: gratings.fingers(size_um=12.0),
    "flat": lambda: HeightField(np.full((30, 30), 0.37), 0.05),
    "one sample": lambda: HeightField([[1.0]], 0.05),
}


@pytest.mark.parametrize("name", CLEAN)
def test_despiking_leaves_clean_surfaces_alone(name: str) -> None:
    field = CLEAN[name]()
    np.testing.assert_array_equal(field.despiked().heights_um, field.heights_um)


def test_despiking_removes_a_grain_and_keeps_the_rest() -> None:
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


# Summary


def test_dominant_periods_and_directions() -> None:
    y, x = np.meshgrid(np.arange(64) * 0.125, np.arange(80) * 0.1, indexing="ij")
    strong, weak = np.cos(2.0 * np.pi * x / 1.6), 0.5 * np.cos(2.0 * np.pi * (x / 2.0 + y / 2.0))
    field = HeightField(0.1 * (strong + weak + 0.25 * np.sin(2.0 * np.pi * (x / 1.0 - y / 1.0))), (0.125, 0.1))
    expected = [(1.6, 0.0), (math.sqrt(2.0), 45.0), (math.sqrt(0.5), -45.0)]
    np.testing.assert_allclose(field.dominant_periods_um(), expected, atol=1e-9)
    assert len(field.dominant_periods_um(count=1)) == 1
    assert HeightField(np.full((4, 4), 0.3), 0.1).dominant_periods_um() == ()
    assert gratings.lamellar(1.6, 0.2, duty=0.2).dominant_periods_um()[0] == pytest.approx((1.6, 0.0))
    along_y = HeightField(0.1 * np.cos(2.0 * np.pi * y / 2.0), (0.125, 0.1))
    assert along_y.dominant_periods_um()[0] == pytest.approx((2.0, 90.0))


def test_summary_reads_well() -> None:
    summary = gratings.sinusoidal(1.6, 0.2, samples=8).summary()
    assert summary.max_uv == pytest.approx(0.38 / 0.4)
    text = str(summary)
    for part in ("1.6 ×", "200 × 200 nm", "0.2 µm", "none that it holds three of", "up to 0.95 at 380 nm"):
        assert part in text
    assert "whole hemisphere" in str(gratings.sinusoidal(1.6, 0.2).summary())
    assert "none" in str(HeightField([[0.0]], 1.0).summary())


# Files


@pytest.mark.parametrize(
    ("dtype", "suffix"), [("uint8", "png"), ("uint16", "png"), ("uint8", "tif"), ("uint16", "tif")]
)
def test_integer_images_span_the_types_full_scale(tmp_path: Path, dtype: str, suffix: str) -> None:
    full = np.iinfo(dtype).max
    samples = np.random.default_rng(1).integers(0, full, (9, 13), dtype=dtype, endpoint=True)
    samples[0, :3] = (0, full, 1)
    write_image(tmp_path / f"a.{suffix}", samples)
    field = HeightField.load(tmp_path / f"a.{suffix}", extent_um=6.5, height_range_um=0.375)
    np.testing.assert_allclose(field.heights_um, samples * (0.375 / full), rtol=1e-15)
    assert field.pitch_um == (0.5, 0.5)
    np.save(tmp_path / "a.npy", samples)
    same = HeightField.load(str(tmp_path / "a.npy"), pitch_um=(0.5, 0.5), height_range_um=0.375)
    np.testing.assert_array_equal(same.heights_um, field.heights_um)


@pytest.mark.parametrize("suffix", ["exr", "tif", "npy"])
def test_floating_point_files_are_in_micrometres(tmp_path: Path, suffix: str) -> None:
    heights = noise((7, 5)).heights_um.astype(np.float32)
    if suffix == "npy":
        np.save(tmp_path / "a.npy", heights)
    else:
        write_image(tmp_path / f"a.{suffix}", heights)
    field = HeightField.load(tmp_path / f"a.{suffix}", pitch_um=(0.1, 0.2))
    np.testing.assert_array_equal(field.heights_um, heights)
    assert field.pitch_um == (0.1, 0.2)


def bad_files(folder: Path) -> None:
    grey = np.arange(2500, dtype=np.uint8).reshape(50, 50)
    write_image(folder / "grey.png", grey)
    write_image(folder / "alpha.png", grey, 2)
    write_image(folder / "rgb.png", grey, 3)
    write_image(folder / "float.tif", grey.astype(np.float32))
    write_image(folder / "infinite.exr", np.array([[0.0, np.inf]], dtype=np.float32))
    noisy = np.random.default_rng(0).integers(0, 255, (50, 50), dtype=np.uint8)
    write_image(folder / "cut.png", noisy)
    (folder / "cut.png").write_bytes((folder / "cut.png").read_bytes()[:1500])
    (folder / "text.png").write_text("not an image")
    (folder / "text.npy").write_text("not an array")
    (folder / "empty.npy").write_bytes(b"")
    np.save(folder / "cube.npy", np.zeros((2, 3, 4)))
    np.save(folder / "infinite.npy", np.array([[-np.inf, 1.0]]))
    np.save(folder / "int64.npy", np.zeros((2, 3), dtype=np.int64))
    np.save(folder / "object.npy", np.array([[{}]]), allow_pickle=True)
    np.save(folder / "complex.npy", np.zeros((2, 3), dtype=complex))


SCALE: dict[str, Any] = {"extent_um": 5.0, "height_range_um": 0.3}
UM: dict[str, Any] = {"extent_um": 5.0}


@pytest.mark.parametrize(
    ("name", "options", "error", "message"),
    [
        ("nowhere.png", SCALE, FileNotFoundError, r"path: there is no file .*check the name"),
        (".", SCALE, ValueError, r"path: .* is not a file"),
        ("text.png", SCALE, ValueError, r"path: .* cannot be read as an image .*give a grey image"),
        ("cut.png", SCALE, ValueError, r"path: .* is damaged .*export the image again"),
        ("rgb.png", SCALE, ValueError, r"path: .* is a colour image \(3 channels\); save its heights as one grey"),
        ("alpha.png", SCALE, ValueError, r"path: .* is a grey image with alpha; save its heights as one grey"),
        ("infinite.exr", UM, ValueError, r"path: .* has 1 infinite sample.*save missing ones as NaN"),
        ("text.npy", UM, ValueError, r"path: .* cannot be read as .npy .*numpy.save"),
        ("empty.npy", UM, ValueError, r"path: .* cannot be read as .npy .*numpy.save"),
        ("object.npy", UM, ValueError, r"path: .* cannot be read as .npy .*numpy.save"),
        ("cube.npy", UM, ValueError, r"path: .* has shape \(2, 3, 4\); save one array"),
        ("infinite.npy", UM, ValueError, r"path: .* has 1 infinite sample"),
        ("int64.npy", SCALE, ValueError, r"path: .* samples of type int64; save uint8, uint16"),
        ("complex.npy", UM, ValueError, r"path: .* samples of type complex128"),
        ("grey.png", UM, ValueError, r"height_range_um must be given.*full scale 0 to 255"),
        ("float.tif", SCALE, ValueError, r"height_range_um must not be given.*µm already"),
        ("grey.png", {"height_range_um": 0.3}, ValueError, r"exactly one of extent_um .* and pitch_um .*neither"),
        ("grey.png", {**SCALE, "pitch_um": 0.1}, ValueError, r"exactly one of extent_um .* and pitch_um .*both"),
        ("grey.png", {**SCALE, "extent_um": -1.0}, ValueError, r"extent_um must be a finite number > 0"),
        ("grey.png", {**UM, "height_range_um": 0.0}, ValueError, r"height_range_um must be a finite number > 0"),
        (
            "grey.png",
            {"pitch_um": (1, 2, 3), "height_range_um": 1},
            ValueError,
            r"pitch_um must be one number or a pair",
        ),
    ],
)
def test_bad_files(tmp_path: Path, name: str, options: dict[str, Any], error: type[Exception], message: str) -> None:
    bad_files(tmp_path)
    with pytest.raises(error, match=message):
        HeightField.load(tmp_path / name, **options)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda _: HeightField([1.0, 2.0], 0.1), ValueError, r"heights_um must be a 2-D array, got shape \(2,\)"),
        (lambda _: HeightField(np.zeros((0, 3)), 0.1), ValueError, "heights_um must hold at least one sample"),
        (lambda _: HeightField([[np.inf]], 0.1), ValueError, "heights_um must be finite"),
        (lambda _: HeightField("scan.png", 0.1), TypeError, "heights_um must be an array"),
        (lambda _: HeightField([[0.0]], 0.0), ValueError, "pitch_um must be a finite number > 0"),
        (lambda _: HeightField([[0.0]], (0.1, -0.1)), ValueError, r"pitch_um\[1\] must be a finite number > 0"),
        (lambda f: f.levelled(-1), ValueError, "order must be an integer >= 0"),
        (lambda f: f.levelled(1.5), TypeError, "order must be an integer"),
        (lambda f: f.despiked(0.0), ValueError, "threshold must be a finite number > 0"),
        (lambda f: f.despiked(size_um=-1.0), ValueError, "size_um must be a finite number > 0"),
        (lambda f: f.cropped(9.0), ValueError, "size_um along y must be from 0.1 to 2, got 9"),
        (lambda f: f.cropped((1.0, 1e-3)), ValueError, "size_um along x must be from 0.2 to 6, got 0.001"),
        (lambda f: f.cropped(1.0, offset_um=(0.0, 5.5)), ValueError, "offset_um along x must be from 0 to 5"),
        (lambda f: f.cropped(1.0, offset_um=(-0.1, 0)), ValueError, "offset_um along y must be from 0 to 1"),
        (lambda f: f.cropped(1.0, offset_um=1.0), ValueError, r"offset_um must be a pair \(y, x\) or None"),
        (lambda f: f.resampled(0.0), ValueError, "pitch_um must be a finite number > 0"),
        (lambda f: f.resampled((0.1, 20.0)), ValueError, "pitch_um along x must be at most the size 6"),
        (lambda f: f.dominant_periods_um(0), ValueError, "count must be an integer >= 1"),
    ],
)
def test_bad_arguments(call: Any, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        call(noise((20, 30), (0.1, 0.2)))


# The real scan (0 to 255 taken as 0 to 0.375 µm)


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
    assert min(period for period, _ in clean.dominant_periods_um()) == pytest.approx(1.14, abs=0.05)
    whole = clean.periodic()
    seam = np.abs(whole.heights_um[0] - whole.heights_um[-1]).mean()
    assert seam < 2.0 * np.abs(np.diff(whole.heights_um, axis=0)).mean()


@pytest.mark.parametrize(
    "header",
    [b"{'descr': '<f8', 'shape': (", b"{'descr': '<f8', 'fortran_order': False, 'shape': (" + b"9" * 30 + b", 2), }\n"],
    ids=["cut off", "a shape beyond int64"],
)
def test_a_damaged_header_of_npy_is_refused_by_its_path(header, tmp_path):
    """NumPy parses it as Python's text, and raises whatever its parser does."""
    path = tmp_path / "a.npy"
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(ValueError, match=r"path: .*a\.npy' cannot be read as \.npy"):
        HeightField.load(path, pitch_um=0.1)


def test_what_an_image_reader_says_may_be_no_text(tmp_path, monkeypatch):
    """It cites a damaged file's own bytes."""

    def said():
        return b"\xff".decode()

    monkeypatch.setattr("OpenImageIO.geterror", said)
    (tmp_path / "a.png").write_text("no image")
    with pytest.raises(ValueError, match=r"path: .*a\.png' cannot be read as an image \(its header is damaged\)"):
        HeightField.load(tmp_path / "a.png", pitch_um=0.1)
    # What nobody asked for is printed when the process ends.
    monkeypatch.undo()
    oiio.geterror()


def test_heights_that_are_refused_name_the_file(tmp_path):
    np.save(tmp_path / "a.npy", [[0.0, 1e20]])
    with pytest.raises(ValueError, match=r"path: .*a\.npy': heights_um must lie within"):
        HeightField.load(tmp_path / "a.npy", pitch_um=0.1)
