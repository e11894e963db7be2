"""Files of heights: images, .npy, .npz with a pitch, registered readers, and damaged files."""

import math
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the name its own documentation uses)
import pytest
from conftest import noise, write_image
from PIL import Image

from warpdiff.heightfield import readers
from warpdiff.heightfield.field import HeightField
from warpdiff.heightfield.readers import reader_registry


def write_channels(path: Path, samples: np.ndarray, channels: int = 1) -> None:
    write_image(path, np.repeat(samples[..., None], channels, axis=2))


@pytest.mark.parametrize(
    ("dtype", "suffix"), [("uint8", "png"), ("uint16", "png"), ("uint8", "tif"), ("uint16", "tif")]
)
def test_integer_images_span_the_types_full_scale(tmp_path: Path, dtype: str, suffix: str) -> None:
    full = np.iinfo(dtype).max
    samples = np.random.default_rng(1).integers(0, full, (9, 13), dtype=dtype, endpoint=True)
    samples[0, :3] = (0, full, 1)
    write_channels(tmp_path / f"a.{suffix}", samples)
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
        write_channels(tmp_path / f"a.{suffix}", heights)
    field = HeightField.load(tmp_path / f"a.{suffix}", pitch_um=(0.1, 0.2))
    np.testing.assert_array_equal(field.heights_um, heights)
    assert field.pitch_um == (0.1, 0.2)


@pytest.mark.filterwarnings("ignore::warpdiff.WarpdiffWarning")
@pytest.mark.parametrize("suffix", ["pfm", "tif", "bmp", "png"])
def test_rows_of_images_go_down_in_every_format(tmp_path: Path, suffix: str) -> None:
    samples = np.arange(12, dtype=np.float32 if suffix in ("pfm", "tif") else np.uint8).reshape(3, 4)
    Image.fromarray(samples).save(tmp_path / f"a.{suffix}")
    scale = {} if samples.dtype.kind == "f" else {"height_range_um": 255.0}
    scan = HeightField.load(tmp_path / f"a.{suffix}", pitch_um=100.0, **scale)  # type: ignore[arg-type]
    np.testing.assert_allclose(scan.heights_um, samples)
    up = HeightField.load(tmp_path / f"a.{suffix}", pitch_um=100.0, rows="up", **scale)  # type: ignore[arg-type]
    np.testing.assert_allclose(up.heights_um, samples[::-1])


# Heights are integers, so that rows of heights are easy to compare. The pitch is 9 µm, because slopes would be
# implausible with a pitch that is small compared with steps of 1 µm.
@pytest.mark.filterwarnings("ignore::warpdiff.WarpdiffWarning")
@pytest.mark.parametrize("order", "<>")
def test_pfm_stores_the_bottom_row_first(tmp_path: Path, order: str) -> None:
    heights = np.arange(6, dtype=f"{order}f4").reshape(3, 2)
    scale = "-1.0" if order == "<" else "1.0"
    (tmp_path / "a.pfm").write_bytes(f"Pf\n2 3\n{scale}\n".encode() + heights[::-1].tobytes())
    np.testing.assert_array_equal(HeightField.load(tmp_path / "a.pfm", pitch_um=9.0).heights_um, heights)


@pytest.mark.parametrize("name", ["bottom-up.bmp", "top-down.bmp", "bottom-up.tga", "top-down.tga"])
def test_images_that_store_rows_in_either_order(tmp_path: Path, name: str) -> None:
    samples = np.arange(12, dtype=np.uint8).reshape(3, 4)
    is_down, (ny, nx) = name.startswith("top"), samples.shape
    stored = (samples if is_down else samples[::-1]).tobytes()
    if name.endswith("bmp"):
        palette = b"".join(bytes([k, k, k, 0]) for k in range(256))
        size = struct.pack("<IiiHHIIiiII", 40, nx, -ny if is_down else ny, 1, 8, 0, len(stored), 0, 0, 256, 0)
        content = b"BM" + struct.pack("<IHHI", 54 + 1024 + len(stored), 0, 0, 54 + 1024) + size + palette + stored
    else:
        content = struct.pack("<BBBHHBHHHHBB", 0, 0, 3, 0, 0, 0, 0, 0, nx, ny, 8, 32 if is_down else 0) + stored
    (tmp_path / name).write_bytes(content)
    field = HeightField.load(tmp_path / name, pitch_um=1.0, height_range_um=0.255)
    np.testing.assert_allclose(field.heights_um, 1e-3 * samples)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_images_are_upright_as_pillow_shows_them(tmp_path: Path, orientation: int) -> None:
    samples = np.arange(12, dtype=np.uint8).reshape(3, 4)
    output = oiio.ImageOutput.create(str(tmp_path / "a.tif"))
    spec = oiio.ImageSpec(4, 3, 1, "uint8")
    spec.attribute("Orientation", orientation)
    output.open(str(tmp_path / "a.tif"), spec)
    output.write_image(samples[..., None])
    output.close()
    with Image.open(tmp_path / "a.tif") as image:
        shown = np.asarray(image)
    field = HeightField.load(tmp_path / "a.tif", pitch_um=1.0, height_range_um=0.255)
    np.testing.assert_allclose(field.heights_um, 1e-3 * shown)


def bad_files(folder: Path) -> None:
    grey = np.arange(2500, dtype=np.uint8).reshape(50, 50)
    write_channels(folder / "grey.png", grey)
    write_channels(folder / "alpha.png", grey, 2)
    write_channels(folder / "rgb.png", grey, 3)
    write_channels(folder / "float.tif", grey.astype(np.float32))
    write_channels(folder / "infinite.exr", np.array([[0.0, np.inf]], dtype=np.float32))
    noisy = np.random.default_rng(0).integers(0, 255, (50, 50), dtype=np.uint8)
    write_channels(folder / "cut.png", noisy)
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
    [("nowhere.png", SCALE, FileNotFoundError, r"path: there is no file .*check the name"),
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
     ("grey.png", {**SCALE, "extent_um": -1.0}, ValueError, r"extent_um must be a finite number, more than 0"),
     ("grey.png", {**UM, "height_range_um": 0.0}, ValueError, r"height_range_um must be a finite number, more than 0"),
     ("grey.png", {**SCALE, "extent_um": (1.0, 0.0)}, ValueError, r"extent_um\[1\] must be a finite number"),
     ("grey.png", {**SCALE, "extent_um": (1,)}, ValueError, r"extent_um must be one number or a pair"),
     ("grey.png", {"pitch_um": (1, 2, 3), "height_range_um": 1}, ValueError, r"pitch_um must be one number or a pair")],
)  # fmt: skip
def test_bad_files_are_refused(
    tmp_path: Path, name: str, options: dict[str, Any], error: type[Exception], message: str
) -> None:
    bad_files(tmp_path)
    with pytest.raises(error, match=message):
        HeightField.load(tmp_path / name, **options)


@pytest.mark.parametrize(
    "header",
    [b"{'descr': '<f8', 'shape': (", b"{'descr': '<f8', 'fortran_order': False, 'shape': (" + b"9" * 30 + b", 2), }\n"],
    ids=["cut off", "a shape beyond int64"],
)
def test_a_damaged_header_of_npy_is_refused_by_its_path(header, tmp_path):
    """A damaged header of a .npy file must be refused by an error that names the file.

    NumPy parses this header as Python source, and can raise any error of the Python parser.
    """
    path = tmp_path / "a.npy"
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    with pytest.raises(ValueError, match=r"path: .*a\.npy' cannot be read as \.npy"):
        HeightField.load(path, pitch_um=0.1)


def test_messages_of_the_image_reader_may_be_invalid_text(tmp_path, monkeypatch):
    """A file must be refused by a clear error even if the image reader's message quotes invalid bytes of the file."""

    def said():
        return b"\xff".decode()

    monkeypatch.setattr("OpenImageIO.geterror", said)
    (tmp_path / "a.png").write_text("no image")
    with pytest.raises(ValueError, match=r"path: .*a\.png' cannot be read as an image \(its header is damaged\)"):
        HeightField.load(tmp_path / "a.png", pitch_um=0.1)
    # OpenImageIO prints errors that nobody has read when the process ends. The error is read here to prevent this.
    monkeypatch.undo()
    oiio.geterror()


def test_errors_about_heights_name_their_file(tmp_path):
    np.save(tmp_path / "a.npy", [[0.0, 1e20]])
    with pytest.raises(ValueError, match=r"path: .*a\.npy': heights_um must lie within"):
        HeightField.load(tmp_path / "a.npy", pitch_um=0.1)


def test_a_registered_reader_loads_files_of_its_suffix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader_registry, "_readers", reader_registry._readers.copy())

    @readers.register_reader(".spm", ".Probe")
    def read_lines(file: Path) -> readers.FileContent:
        return readers.FileContent(np.loadtxt(file, ndmin=2), (0.2, 0.1) if file.suffix == ".spm" else None)

    for name in ("scan.spm", "scan.probe"):
        (tmp_path / name).write_text("0.0 0.1 nan\n0.2 0.3 0.4\n")
    field = HeightField.load(tmp_path / "scan.spm")
    np.testing.assert_array_equal(field.heights_um, [[0.0, 0.1, np.nan], [0.2, 0.3, 0.4]])
    assert (field.pitch_um, field.missing.sum()) == ((0.2, 0.1), 1)
    assert HeightField.load(tmp_path / "scan.probe", pitch_um=0.3).pitch_um == (0.3, 0.3)
    (tmp_path / "line.probe").write_text("")
    with (
        pytest.warns(UserWarning, match="no data"),
        pytest.raises(ValueError, match=r"line\.probe' has shape \(0, 1\)"),
    ):
        HeightField.load(tmp_path / "line.probe", pitch_um=0.3)


def test_an_extent_is_the_width_along_x_or_a_pair_of_both_sides(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", noise((4, 10)).heights_um)
    assert HeightField.load(tmp_path / "a.npy", extent_um=2.0).pitch_um == (0.2, 0.2)
    assert HeightField.load(tmp_path / "a.npy", extent_um=(2.0, 4.0)).pitch_um == (0.5, 0.4)


@pytest.mark.parametrize("make", [
    lambda: noise((5, 7), (0.1 / 3.0, 0.7)),
    lambda: HeightField([[1.0 / 3.0, np.nan, -0.0]], math.pi / 3.0),
    lambda: HeightField.of_known_scale(noise((3, 4)).heights_um * 1e-9, 1e-7),
    lambda: noise((5, 7)).rotated(),
], ids=["noise", "gap", "another scale", "rotated"])  # fmt: skip
def test_saved_fields_are_restored_exactly(tmp_path: Path, make: Callable[[], HeightField]) -> None:
    field = make()
    path = tmp_path / "a.NPZ"
    assert field.save(path) == path
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = HeightField.load(path)
    assert again.heights_um.tobytes() == field.heights_um.tobytes()
    assert (again.pitch_um, again.shape) == (field.pitch_um, field.shape)
    np.testing.assert_array_equal(again.missing, field.missing)
    # Saving replaces an existing file, and no temporary file remains.
    noise((2, 2)).save(path)
    assert HeightField.load(path).shape == (2, 2)
    assert list(tmp_path.iterdir()) == [path]


def test_archives_may_state_one_pitch_for_both_axes(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", heights_um=np.zeros((2, 3), dtype=np.float32), pitch_um=0.25, unit="µm")
    assert HeightField.load(tmp_path / "a.npz").pitch_um == (0.25, 0.25)


@pytest.mark.parametrize(("arrays", "message"), [
    ({"heights_um": np.zeros((2, 3))}, r"cannot be read as \.npz \(.*pitch_um.*\); write it with HeightField\.save"),
    ({"pitch_um": 0.1}, r"cannot be read as \.npz \(.*heights_um"),
    ({"heights_um": np.zeros((2, 3, 1)), "pitch_um": 0.1}, r"has shape \(2, 3, 1\)"),
    ({"heights_um": np.zeros((0, 3)), "pitch_um": 0.1}, r"has shape \(0, 3\)"),
    ({"heights_um": np.array([["high"]]), "pitch_um": 0.1}, "has samples of type <U4"),
    ({"heights_um": np.array([[None]]), "pitch_um": 0.1}, r"cannot be read as \.npz \(Object arrays"),
    ({"heights_um": [[np.inf]], "pitch_um": 0.1}, "has 1 infinite sample"),
    ({"heights_um": [[np.nan]], "pitch_um": 0.1}, "heights_um must have at least one height"),
    ({"heights_um": [[0.1]], "pitch_um": 0.0}, "pitch_um must be a finite number, more than 0"),
    ({"heights_um": [[0.1]], "pitch_um": [1.0, 2.0, 3.0]}, "pitch_um must be one number or a pair"),
    ({"heights_um": [[0.1]], "pitch_um": ["a", "b"]}, r"pitch_um\[0\] must be a number, got str"),
    ({"heights_um": [[0.1]], "pitch_um": 0.1, "history": [1, 2]}, r"must have a list of sentences as history"),
    ({"heights_um": [[0.1]], "pitch_um": 0.1, "history": "Cut."}, r"must have a list of sentences as history"),
])  # fmt: skip
def test_archives_without_valid_heights_are_refused_by_their_path(tmp_path: Path, arrays: Any, message: str) -> None:
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ValueError, match=rf"^path: .*a\.npz'.* {message}"):
        HeightField.load(tmp_path / "a.npz")


def test_damaged_archives_are_refused_by_their_path(tmp_path: Path, rng: np.random.Generator) -> None:
    field = noise((12, 9))
    field.save(tmp_path / "a.npz")
    whole = (tmp_path / "a.npz").read_bytes()
    damaged = tmp_path / "b.npz"
    refused = 0
    for _ in range(300):
        content = bytearray(whole)
        place = int(rng.integers(len(whole)))
        if rng.random() < 0.3:
            del content[place:]
        else:
            content[place] ^= 1 << int(rng.integers(8))
        damaged.write_bytes(content)
        try:
            again = HeightField.load(damaged)
        except ValueError as error:
            refused += str(error).startswith(f"path: '{damaged}'")
        else:
            # The damage changed only metadata of the archive, such as a time, because a checksum protects the heights.
            # The heights must therefore be unchanged.
            np.testing.assert_array_equal(again.heights_um, field.heights_um)
            refused += 1
    assert refused == 300


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [("a.npy", ValueError, r"path must end in \.npz or \.gds or \.png or \.stl, got '.*a\.npy'"),
     ("none/a.npz", FileNotFoundError, "path: the folder '.*none' does not exist"),
     (None, TypeError, "path must be a string or a path")],
)  # fmt: skip
def test_save_refuses_bad_paths(tmp_path: Path, name: str | None, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        noise((2, 2)).save(name if name is None else tmp_path / name)  # type: ignore[arg-type]


@pytest.mark.parametrize("options", [{"pitch_um": 0.1}, {"extent_um": (1.0, 2.0)}])
def test_a_file_with_a_pitch_accepts_no_other_pitch(tmp_path: Path, options: dict[str, Any]) -> None:
    noise((2, 2)).save(tmp_path / "a.npz")
    with pytest.raises(ValueError, match=rf"^{next(iter(options))} must not be given: .*a\.npz' states its own pitch"):
        HeightField.load(tmp_path / "a.npz", **options)
