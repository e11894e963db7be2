"""Files of pictures: ``Image.save`` writes them, and the tests read them through OpenImageIO."""

import contextlib
import dataclasses
import errno
import io
import os
import shutil
import stat
import subprocess
import sys
import types

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the abbreviation of its manual)
import pytest
from endurance import count
from PIL import Image, ImageShow

import warpdiff as wd
from warpdiff.core.options import describe
from warpdiff.image.display_transform import GAMUTS, MEAN_SHOWN
from warpdiff.optics import colorimetry

ROW = "pictures saved on full disks, under file size limits, interrupted"
HEIGHT, WIDTH = 5, 7
# Coverage of the test picture: row 0 is background, row 1 is partly covered, and all other rows are completely covered.
COVERAGE = np.array([0.0, 0.25, 1.0, 1.0, 1.0], np.float32)[:, None] * np.ones((1, WIDTH), np.float32)
ERROR = np.linspace(0.0, 0.1, COVERAGE.size, dtype=np.float32).reshape(COVERAGE.shape)


@pytest.fixture(scope="module")
def plan() -> wd.Plan:
    """Return a plan (method and numbers of a computation), which pictures store. The tests do not depend on it."""
    return wd.plan(wd.HeightField(np.zeros((8, 8)), 0.05), method="direct")


@pytest.fixture
def image(plan, rng) -> wd.Image:
    """Return a picture with colours inside and outside of the gamut, multiplied by its coverage."""
    rgb = rng.uniform(0.0, 2.0, (HEIGHT, WIDTH, 3))
    rgb[3, 3] = (-0.25, 0.5, 0.125)
    xyz = (colorimetry.rgb_to_xyz(rgb) * COVERAGE[..., None]).astype(np.float32)
    return wd.Image(xyz=xyz, mask=COVERAGE > 0.0, illuminated=COVERAGE > 0.0, coverage=COVERAGE, error=ERROR, plan=plan)


def read(path) -> tuple[oiio.ImageSpec, np.ndarray]:
    """Return the header of an image file and its samples, without conversion."""
    source = oiio.ImageInput.open(str(path), straight_alpha())
    assert source is not None, oiio.geterror()
    spec = source.spec()
    pixels = np.asarray(source.read_image(0, 0, 0, spec.nchannels, "unknown"))
    source.close()
    return spec, pixels


def straight_alpha() -> oiio.ImageSpec:
    """Return OpenImageIO's settings for a PNG reader that does not multiply colours by alpha."""
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    return config


def test_exr_is_exact(image, tmp_path):
    path = image.save(tmp_path / "a.exr")
    assert path == tmp_path / "a.exr"
    spec, pixels = read(path)
    assert tuple(spec.channelnames) == ("R", "G", "B", "A", "XYZ.X", "XYZ.Y", "XYZ.Z", "error.Y")
    assert spec.alpha_channel == 3
    assert pixels.dtype == np.float32
    np.testing.assert_array_equal(pixels[..., :3], image.rgb)
    np.testing.assert_array_equal(pixels[..., 3], image.coverage)
    np.testing.assert_array_equal(pixels[..., 4:7], image.xyz)
    np.testing.assert_array_equal(pixels[..., 7], image.error)
    # Saving must preserve the negative component of a colour outside of the gamut.
    np.testing.assert_allclose(pixels[3, 3, :3], (-0.25, 0.5, 0.125), atol=1e-6)


def test_exr_is_scaled_by_an_explicit_exposure(image, tmp_path):
    pixels = read(image.save(str(tmp_path / "a.EXR"), exposure=0.5))[1]
    np.testing.assert_array_equal(pixels[..., :3], image.rgb * np.float32(0.5))
    np.testing.assert_array_equal(pixels[..., 4:7], image.xyz * np.float32(0.5))
    # The channel ``error`` is not scaled, because relative errors do not depend on the exposure.
    np.testing.assert_array_equal(pixels[..., 7], image.error)
    np.testing.assert_array_equal(pixels[..., 3], image.coverage)


@pytest.mark.parametrize("suffix", ["exr", "png"])
def test_files_of_pictures_contain_package_plan_report_and_exposure(image, suffix, tmp_path):
    spec, _ = read(image.save(tmp_path / f"a.{suffix}", exposure=2.5))
    # In some formats OpenImageIO appends its own name to that of the package.
    assert spec.getattribute("Software").startswith("warpdiff")
    assert spec.getattribute("ImageDescription") == f"{image.plan}\n\n{image.report}"
    if suffix == "exr":
        assert spec.getattribute("warpdiff:exposure") == 2.5


@pytest.mark.parametrize("saving", [{}, {"exposure": 2.5, "exposure_stops": 1.0}, {"gamut": "display-p3"}], ids=str)
@pytest.mark.parametrize("display", ["aces", "colorimetric"])
def test_metadata_of_an_exr_file_state_how_the_picture_is_displayed(image, saving, display, tmp_path):
    path = image.save(tmp_path / "a.exr", display=display, **saving)
    spec, pixels = read(path)
    facts = {name: spec.getattribute(f"warpdiff:preview_{name}") for name in ("display", "gamut", "exposure")}
    shown = image.display(display, **saving)
    np.testing.assert_allclose(wd.Image.load(path).display(**facts), shown, atol=1e-5)
    # The EXR file must describe the display transform as the PNG file does. The white point in its metadata must be the
    # colour that R = G = B has with the primaries in its metadata.
    png = read(image.save(tmp_path / "a.png", display=display, **saving))[0].getattribute("warpdiff:display")
    text, _, exposure = spec.getattribute("warpdiff:preview").rpartition("; exposure ")
    assert text == png.rpartition("; exposure ")[0] + "; white point D65"
    assert float(exposure) == pytest.approx(facts["exposure"], rel=1e-5)
    x, y = spec.getattribute("chromaticities")[6:]
    np.testing.assert_allclose(colorimetry.xyz_to_rgb([x / y, 1.0, (1.0 - x - y) / y]), 1.0, atol=1e-3)
    np.testing.assert_array_equal(pixels[..., 4:7], image.xyz * np.float32(spec.getattribute("warpdiff:exposure")))


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (16, np.uint16)])
@pytest.mark.parametrize("exposure", [None, 0.7])
def test_clipped_png_is_srgb(image, bits, dtype, exposure, tmp_path):
    spec, pixels = read(image.save(tmp_path / "a.png", bits=bits, exposure=exposure, display="clip"))
    assert tuple(spec.channelnames) == ("R", "G", "B", "A")
    assert pixels.dtype == dtype
    levels = 2**bits - 1
    np.testing.assert_array_equal(pixels[..., 3], np.round(image.coverage * levels).astype(dtype))
    assert not pixels[0].any(), "the background must be transparent"
    # The expected sRGB values follow IEC 61966-2-1. Colours of PNG files are not multiplied by alpha. The exposure
    # ``auto_exposure`` maps the mean luminance to 0.7, which the display "aces" requires. Other displays require 0.5,
    # so the exposure is multiplied by 0.5/0.7.
    exposure = exposure or image.auto_exposure * 0.5 / 0.7
    linear = exposure * colorimetry.xyz_to_rgb(image.xyz[1:]) / image.coverage[1:, :, None]
    linear = np.clip(linear, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.max(np.abs(pixels[1:, :, :3] - encoded * levels)) <= 0.5 + 1e-3
    assert pixels[3, 3, 0] == 0, "negative components must be clipped"


def test_automatic_exposure_maps_the_mean_of_illuminated_pixels_to_0_7(plan, rng):
    luminance = rng.uniform(0.1, 9.0, (200, 250))
    mask = rng.random(luminance.shape) < 0.5
    dark = mask & (rng.random(luminance.shape) < 0.2)
    luminance[~mask | dark] = 0.0

    def exposure():
        xyz = np.repeat(luminance[..., None], 3, axis=2).astype(np.float32)
        image = wd.Image(
            xyz=xyz, mask=mask, illuminated=mask & ~dark, coverage=mask.astype(np.float32), error=0.0 * luminance,
            plan=plan,
        )  # fmt: skip
        return image.auto_exposure

    illuminated = luminance[mask & ~dark]
    usual = exposure()
    assert np.mean(illuminated * usual) == pytest.approx(0.7, rel=1e-3)
    # A mirror highlight in 1/10,000 of the illuminated pixels does not change the automatic exposure.
    brightest = np.flatnonzero((mask & ~dark).ravel())[: len(illuminated) // 10_000]
    luminance.ravel()[brightest] = 1e6
    assert exposure() == pytest.approx(usual, rel=1e-3)
    # If all other pixels are dark, bright diffraction orders in 1/200 of the pixels determine the automatic exposure.
    luminance[luminance > 0.0] = 1e-9
    orders = np.flatnonzero((mask & ~dark).ravel())[::200]
    luminance.ravel()[orders] = 2.0
    assert 2.0 * exposure() == pytest.approx(0.7 * 200.0, rel=0.05)


def test_a_black_picture_is_saved_as_black(plan, tmp_path):
    nothing = np.zeros((2, 3), np.float32)
    image = wd.Image(
        xyz=np.zeros((2, 3, 3), np.float32), mask=nothing > 0.0, illuminated=nothing > 0.0, coverage=nothing,
        error=nothing, plan=plan,
    )  # fmt: skip
    assert image.auto_exposure == 1.0
    for name in ("a.png", "a.exr"):
        assert not read(image.save(tmp_path / name))[1].any()


def test_exr_is_linear_whatever_the_display(image, tmp_path):
    paths = [image.save(tmp_path / f"{name}.exr", display=name) for name in ("aces", "clip")]
    np.testing.assert_array_equal(*(read(path)[1] for path in paths))


def test_png_contains_the_displayed_colours_and_the_name_of_the_transform(image, tmp_path):
    for display in ("aces", "colorimetric", "clip"):
        spec, pixels = read(image.save(tmp_path / "a.png", display=display, exposure_stops=-1.0))
        np.testing.assert_array_equal(pixels, np.round(255.0 * image.display(display, exposure_stops=-1.0)))
        transform = spec.getattribute("warpdiff:display")
        assert ("ocio://cg-config-v4.0.0_aces-v2.0_ocio-v2.5" in transform) == (display == "aces"), transform
        assert display in transform.lower(), transform


def test_display_p3_is_marked_by_a_chunk_of_the_png(image, tmp_path):
    path = image.save(tmp_path / "a.png", gamut="display-p3")
    assert b"cICP" + bytes([12, 13, 0, 1]) in path.read_bytes()
    assert b"cICP" not in image.save(tmp_path / "a.png").read_bytes()


def test_an_exposure_may_be_in_stops_or_from_another_picture(image):
    brighter = dataclasses.replace(image, xyz=4.0 * image.xyz)
    np.testing.assert_allclose(brighter.display(exposure=0.25), image.display(exposure=1.0), atol=1e-6)
    np.testing.assert_allclose(image.display(exposure_stops=2.0), brighter.display(exposure_from=image), atol=1e-5)
    np.testing.assert_array_equal(brighter.display(exposure=0.5), brighter.display(exposure=2.0, exposure_stops=-2.0))


def test_a_very_dark_picture_is_exposed(plan, tmp_path):
    xyz = np.full((2, 2, 3), 1e-14, np.float32)
    whole = np.ones((2, 2), np.float32)
    dim = wd.Image(xyz=xyz, mask=whole > 0, illuminated=whole > 0, coverage=whole, error=whole, plan=plan)
    assert read(dim.save(tmp_path / "a.png"))[1].min() > 100
    # At the same exposure, a picture that is brighter by a factor of 1e24 is white, and its EXR file has finite values.
    bright = wd.Image(xyz=1e24 * xyz, mask=whole > 0, illuminated=whole > 0, coverage=whole, error=whole, plan=plan)
    assert read(bright.save(tmp_path / "b.png", exposure_from=dim))[1].min() == 255
    assert np.isfinite(read(bright.save(tmp_path / "b.exr", exposure_from=dim, exposure_stops=30.0))[1]).all()


def test_a_background_is_mixed_in_linear_light(image, tmp_path):
    encoded = image.display("clip")
    behind = np.array([1.0, 0.5, 0.0])
    over = image.display("clip", background=behind)
    np.testing.assert_allclose(over[0], np.broadcast_to(behind, over[0].shape), atol=1e-6)
    np.testing.assert_allclose(over[2:], encoded[2:, :, :3], atol=1e-6)
    mixed = 0.25 * colorimetry.srgb_decode(encoded[1, :, :3]) + 0.75 * colorimetry.srgb_decode(behind)
    np.testing.assert_allclose(over[1], colorimetry.srgb_encode(mixed), atol=1e-6)
    # A picture with a coverage of 0.25 in front of a copy of itself as background has a total coverage of 1 − (1 −
    # 0.25)².
    itself = colorimetry.srgb_decode(image.display("clip", background=image)[1])
    np.testing.assert_allclose(itself, (1.0 - 0.75**2) * colorimetry.srgb_decode(encoded[1, :, :3]), atol=1e-5)
    spec, pixels = read(image.save(tmp_path / "a.png", display="clip", background=behind))
    assert tuple(spec.channelnames) == ("R", "G", "B")
    np.testing.assert_array_equal(pixels, np.round(255.0 * over))


@pytest.mark.parametrize("name", ["a.exr", "a.png"])
def test_files_are_replaced_and_have_the_usual_permissions(image, name, tmp_path):
    path = tmp_path / name
    path.write_text("old")
    image.save(path)
    first = path.read_bytes()
    image.save(path, exposure=0.1)
    assert path.read_bytes() != first
    assert [file.name for file in tmp_path.iterdir()] == [name]
    if os.name == "posix":
        (tmp_path / "plain").write_text("")
        assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


class FailingOutput:
    """Stand-in for a file writer of OpenImageIO, which fails at a step: "open", "write", "close" or "interrupt"."""

    def __init__(self, at: str) -> None:
        self._at = at

    def open(self, name, _spec) -> bool:
        with open(name, "wb") as file:  # noqa: PTH123 (as a native writer does)
            file.write(b"half a picture")
        return self._at != "open"

    def write_image(self, _pixels) -> bool:
        if self._at == "interrupt":
            raise KeyboardInterrupt
        return self._at != "write"

    def close(self) -> bool:
        return self._at != "close"

    def geterror(self) -> str:
        return "no space left on device"


@pytest.mark.permanent(ROW)
@pytest.mark.parametrize("name", ["a.exr", "a.png"])
@pytest.mark.parametrize("at", ["create", "open", "write", "close", "interrupt"])
def test_a_write_that_fails_leaves_the_old_file(image, name, at, tmp_path, monkeypatch):
    (tmp_path / name).write_text("precious")
    output = None if at == "create" else FailingOutput(at)
    monkeypatch.setattr(oiio.ImageOutput, "create", staticmethod(lambda *_: output))
    if at == "interrupt":
        with pytest.raises(KeyboardInterrupt):
            image.save(tmp_path / name)
    else:
        with pytest.raises(OSError, match=rf"cannot write .*{name}" + ("" if at == "create" else ": no space left")):
            image.save(tmp_path / name)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "precious"}


@contextlib.contextmanager
def largest_file(size):
    """Limit the size of files that the process writes, within the ``with`` block, to simulate a full disk."""
    resource = pytest.importorskip("resource", reason="file size limits require POSIX")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    # Python ignores the signal SIGXFSZ, so writing beyond the limit fails with an error.
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def cannot_save(image, folder, name, *, message="cannot write", **options):
    """Check that saving fails and leaves all files unchanged, both if the picture file exists and if it does not."""
    for old in ({}, {name: b"precious"}):
        for file, content in old.items():
            (folder / file).write_bytes(content)
        with pytest.raises(OSError, match=message):
            image.save(folder / name, **options)
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == old


@pytest.mark.permanent(ROW)
@pytest.mark.parametrize(("name", "bits"), [("a.exr", 8), ("a.png", 8), ("a.png", 16)])
def test_saving_a_truncated_file_is_an_error(image, name, bits, tmp_path, capfd, tries):
    size = image.save(tmp_path / name, bits=bits).stat().st_size
    for most in tries.of({*range(8, size, count(397, 7)), *range(size - 1, size - 15, -count(4, 1))}):
        (tmp_path / name).unlink()
        with largest_file(most):
            cannot_save(image, tmp_path, name, bits=bits)
    with largest_file(size):
        image.save(tmp_path / name, bits=bits)
    assert not capfd.readouterr().err


@pytest.mark.permanent(ROW)
@pytest.mark.parametrize("name", ["a.exr", "a.png"])
def test_errors_of_file_systems_that_allocate_late_are_reported(image, name, tmp_path, monkeypatch):
    def full(_handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    cannot_save(image, tmp_path, name, message="No space left")


@pytest.mark.permanent(ROW)
@pytest.mark.parametrize("name", ["a.exr", "a.png"])
def test_a_full_disk_is_reported(plan, rng, name, tmp_path):
    shape = (64, 64)
    xyz = rng.random((*shape, 3), dtype=np.float32)
    whole = np.ones(shape, np.float32)
    image = wd.Image(xyz=xyz, mask=whole > 0, illuminated=whole > 0, coverage=whole, error=whole, plan=plan)
    mount = ["mount", "-t", "tmpfs", "-o", "size=8k", "tmpfs", str(tmp_path)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a small file system requires root")
    try:
        cannot_save(image, tmp_path, name)
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)  # noqa: S607 (the path of the mount command above)


def test_saving_does_not_change_the_umask(image, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "umask", lambda _mask: pytest.fail("the umask of the process is changed"))
    image.save(tmp_path / "a.png")


def test_a_folder_as_path_is_refused(image, tmp_path):
    (tmp_path / "a.png").mkdir()
    with pytest.raises(IsADirectoryError, match=r"path must be a file, got the folder '.*a\.png'; name a file in it"):
        image.save(tmp_path / "a.png")


def test_a_rendered_picture_survives_its_file(tmp_path):
    image = wd.reflectance_map(wd.gratings.sinusoidal(1.0, 0.1), [0.0, 0.0, 1.0], size=16)
    pixels = read(image.save(tmp_path / "map.exr"))[1]
    np.testing.assert_array_equal(pixels[..., 4:7], image.xyz)
    np.testing.assert_array_equal(pixels[..., 7], image.error)
    np.testing.assert_array_equal(pixels[..., 3], image.mask)
    assert not pixels[~image.mask].any()


def test_a_picture_is_read_from_its_exr_file(image, tmp_path):
    hits = np.indices((HEIGHT, WIDTH)).sum(axis=0)
    layers = {
        "normal": image.xyz,
        "depth": np.where(hits > 3, hits, np.inf).astype(np.float32),
        "geometry": (hits - 1).astype(np.int32),
    }
    for picture in (image, dataclasses.replace(image, layers=layers)):
        copy = wd.Image.load(picture.save(tmp_path / "a.exr"))
        for name in ("xyz", "mask", "illuminated", "coverage", "error"):
            array = getattr(copy, name)
            np.testing.assert_array_equal(array, getattr(picture, name), strict=True)
        assert copy.plan is None
        assert set(copy.layers) == set(picture.layers)
        for name, layer in copy.layers.items():
            np.testing.assert_array_equal(layer, layers[name], strict=True)
        np.testing.assert_array_equal(copy.display(), image.display())
        again = wd.Image.load(copy.save(tmp_path / "b.exr"))
        np.testing.assert_array_equal(again.xyz, image.xyz, strict=True)
    halved = wd.Image.load(image.save(tmp_path / "c.exr", exposure=0.5))
    np.testing.assert_array_equal(halved.xyz, image.xyz * np.float32(0.5))


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [("absent.exr", FileNotFoundError, r"absent\.exr"),
     ("a.png", ValueError, r"path: '.*a\.png' cannot be read as an EXR file; name one of Image\.save"),
     ("text.exr", ValueError, r"path: '.*text\.exr' cannot be read as an EXR file; name one"),
     ("bytes.exr", ValueError, r"path: '.*bytes\.exr' cannot be read as an EXR file"),
     ("cut.exr", ValueError, r"path: '.*cut\.exr' (is damaged|cannot be read)")],
)  # fmt: skip
def test_files_that_are_not_pictures_are_refused(image, name, error, message, tmp_path, capfd):
    image.save(tmp_path / "a.png")
    (tmp_path / "text.exr").write_text("no picture")
    content = image.save(tmp_path / "a.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(content[:-40])
    (tmp_path / "bytes.exr").write_bytes(content.replace(b"chlist", b"chl\xf3st"))
    with pytest.raises(error, match=message):
        wd.Image.load(tmp_path / name)
    assert not capfd.readouterr().err


def test_a_picture_is_compared_by_identity_and_described_in_one_line(image):
    assert image == image  # noqa: PLR0124 (arrays have no single truth value)
    assert image != dataclasses.replace(image)
    assert repr(image) == "Image(7 × 5 pixels, 80 % illuminated, estimated error 0.099 at the 99th percentile)"
    dark = dataclasses.replace(image, illuminated=np.zeros_like(image.mask))
    assert repr(dark) == "Image(7 × 5 pixels, 0 % illuminated)"


def test_notebooks_and_viewers_show_the_pixels_of_a_png_file(image, tmp_path, monkeypatch):
    pixels = read(image.save(tmp_path / "a.png"))[1]
    np.testing.assert_array_equal(Image.open(io.BytesIO(image._repr_png_())), pixels)
    pictures = []
    monkeypatch.setattr(ImageShow, "show", lambda picture, **_: pictures.append(np.asarray(picture)) or True)
    image.show()
    np.testing.assert_array_equal(pictures[0], pixels)
    monkeypatch.setattr(ImageShow, "show", lambda *_args, **_: False)
    with pytest.raises(RuntimeError, match=r"no viewer of PNG files .*save the picture"):
        image.show()
    # In a notebook, ``show`` displays the picture by IPython.
    notebook = types.SimpleNamespace(
        get_ipython=lambda: types.SimpleNamespace(kernel=True), display=types.SimpleNamespace(display=pictures.append)
    )
    monkeypatch.setitem(sys.modules, "IPython", notebook)
    image.show()
    assert pictures[1] is image


def test_the_arguments_of_save_are_described_for_the_command_line():
    options = describe(wd.Image.save)
    assert options["display"].choices == tuple(MEAN_SHOWN)
    assert options["gamut"].choices == tuple(GAMUTS)
    assert options["bits"].choices == (8, 16)
    assert options["exposure"].range == "more than 0"
    assert (options["exposure_stops"].range, options["exposure_stops"].unit) == ("at least -30 and at most 30", "stops")
    assert all(option.help for option in options.values())
