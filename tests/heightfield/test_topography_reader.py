"""Files of instruments, read by the library SurfaceTopography, and objects of this library.

Most tests use a replacement for the library. ``make test-scans`` also runs tests with the library itself.
"""

import struct
import sys
import types
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import write_image

from warpdiff.heightfield.field import HeightField
from warpdiff.heightfield.readers import reader_registry, topography_reader

# Heights in the order of the picture: 2 rows of 3 samples, row 0 at the top. SurfaceTopography's arrays are their
# transpose.
PICTURE_NM = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 60.0]])


def topography(**values: Any) -> SimpleNamespace:
    """Return a stand-in for a height map of the library SurfaceTopography. ``values`` replaces its attributes."""
    known: dict[str, Any] = {
        "heights": lambda: PICTURE_NM.T, "physical_sizes": (600.0, 800.0), "unit": "nm", "dim": 2,
        "info": {"instrument": {"name": "Probe", "serial": None}, "raw_metadata": {"long": "text"}},
    }  # fmt: skip
    return SimpleNamespace(**known | values)


class Channel:
    """Replacement for a channel of a file, as SurfaceTopography describes it."""

    def __init__(self, name: str, index: int, **values: Any) -> None:
        self.name, self.index, self.unit, self.data_unit = name, index, "nm", "nm"
        self.dim, self.nb_grid_pts, self.physical_sizes = 2, (3, 2), (600.0, 800.0)
        self.is_height_channel = True
        self.factor = 1.0
        self.__dict__.update(values)

    def topography(self, physical_sizes: Any = None) -> SimpleNamespace:
        sizes = self.physical_sizes or physical_sizes
        return topography(heights=lambda: self.factor * PICTURE_NM.T, physical_sizes=sizes, unit=self.unit)


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Return a function that replaces the library SurfaceTopography by a stand-in.

    The stand-in finds the given channels in the file whose path the function returns.
    """

    def of(*channels: Channel, default: int = 0, error: Exception | None = None) -> Path:
        def open_topography(path: str, format: str) -> SimpleNamespace:  # noqa: A002 (the name of the library)
            assert (Path(path), format) == (tmp_path / "a.sur", "sur")
            if error:
                raise error
            return SimpleNamespace(channels=channels, default_channel=channels[default])

        package, module = types.ModuleType("SurfaceTopography"), types.ModuleType("SurfaceTopography.IO")
        module.open_topography = open_topography  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "SurfaceTopography", package)
        monkeypatch.setitem(sys.modules, "SurfaceTopography.IO", module)
        (tmp_path / "a.sur").write_bytes(b"DIGITAL SURF")
        return tmp_path / "a.sur"

    return of


def test_heights_are_the_transpose_with_the_picture_s_top_at_the_largest_y(library: Any) -> None:
    scan = HeightField.load(library(Channel("Height", 0)))
    np.testing.assert_allclose(scan.heights_um, 1e-3 * PICTURE_NM[::-1])
    np.testing.assert_allclose(scan.pitch_um, (0.4, 0.2))
    assert scan.source is not None
    assert scan.source.rows == "up"
    assert scan.source.metadata == {"instrument.name": "Probe"}
    down = HeightField.load(library(Channel("Height", 0)), rows="down")
    np.testing.assert_allclose(down.heights_um, 1e-3 * PICTURE_NM)


def test_the_default_channel_is_a_height(library: Any) -> None:
    path = library(
        Channel("Phase", 0, unit="nm", data_unit="deg", is_height_channel=False), Channel("Amplitude", 1, factor=2.0),
        Channel("Height", 2, factor=3.0), Channel("Height", 3, factor=4.0), Channel("Line", 4, dim=1),
        Channel("Error", 5, unit=("nm", None)), default=3,
    )  # fmt: skip
    assert HeightField.channels(path) == ("Height", "Height (2)", "Amplitude")
    for channel, factor in ((None, 4.0), ("Height (2)", 3.0), ("Amplitude", 2.0)):
        scan = HeightField.load(path, channel=channel)
        np.testing.assert_allclose(scan.heights_um[::-1], 1e-3 * factor * PICTURE_NM)
    with pytest.raises(
        ValueError, match=r"^channel must be one of 'Height', 'Height \(2\)', 'Amplitude', which .*'Phase'"
    ):
        HeightField.load(path, channel="Phase")


def test_masked_samples_are_missing() -> None:
    values = np.ma.masked_equal(PICTURE_NM.T, 60.0)
    scan = HeightField.from_topography(topography(heights=lambda: values))
    np.testing.assert_array_equal(scan.missing[::-1], PICTURE_NM == 60.0)


def test_a_file_without_a_size_or_unit_requires_it(library: Any) -> None:
    path = library(Channel("Height", 0, physical_sizes=None))
    with pytest.raises(ValueError, match="exactly one of extent_um"):
        HeightField.load(path)
    assert HeightField.load(path, extent_um=(2.0, 3.0)).pitch_um == (1.0, 1.0)
    path = library(Channel("Height", 0, unit=None, data_unit=None))
    with pytest.raises(ValueError, match=r"^unit must be given: .*a\.sur'"):
        HeightField.load(path)
    np.testing.assert_allclose(HeightField.load(path, unit="nm").pitch_um, (0.4, 0.2))


@pytest.mark.parametrize(
    ("channel", "message"),
    [({"dim": 1}, "has no channel of heights"), ({"unit": "V"}, "has no channel of heights"),
     ({"physical_sizes": (1.6e11, 1.6e11)}, r"states a size of 160 × 160 m, beyond any instrument")],
)  # fmt: skip
def test_channels_that_are_no_maps_are_refused(library: Any, channel: dict[str, Any], message: str) -> None:
    path = library(Channel("Height", 0, **channel))
    with pytest.raises(ValueError, match=rf"^path: .*a\.sur' {message}"):
        HeightField.load(path)


def test_errors_of_the_library_become_one_line(library: Any) -> None:
    path = library(error=RuntimeError("many\nlines " + 300 * "x"))
    with pytest.raises(
        ValueError, match=r"^path: .*a\.sur' cannot be read as a file of SUR \(many lines x+ …\); export"
    ):
        HeightField.load(path)


def test_without_the_library_the_error_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "SurfaceTopography.IO", None)
    (tmp_path / "a.sur").write_bytes(b"DIGITAL SURF")
    with pytest.raises(ValueError, match=r"^path: .*a\.sur' requires the extra scans.*pip install 'warpdiff\[scans\]'"):
        HeightField.load(tmp_path / "a.sur")


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [({"dim": 1}, ValueError, "topography must be a map, got a line scan"),
     ({"unit": None}, ValueError, "topography must have a size and a unit"),
     ({"unit": "V"}, ValueError, "topography must have a unit of length, got 'V'"),
     ({"physical_sizes": None}, ValueError, "topography must have a size and a unit"),
     ({"physical_sizes": (0.0, 1.0)}, ValueError, r"topography must have two positive sizes, got \[0\.0, 1\.0\]"),
     ({"heights": lambda: np.full((3, 2), 1e30)}, ValueError, "topography: heights_um must lie within"),
     ({"heights": lambda: np.zeros((0, 3))}, ValueError, r"must have heights on a grid, got shape \(0, 3\)")],
)  # fmt: skip
def test_topographies_that_are_no_maps_are_refused(
    values: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        HeightField.from_topography(topography(**values))


def test_objects_that_are_no_topographies_are_refused() -> None:
    with pytest.raises(TypeError, match="topography must be a topography of SurfaceTopography, got ndarray"):
        HeightField.from_topography(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="rows must be one of 'down', 'up'"):
        HeightField.from_topography(topography(), rows="left")  # type: ignore[arg-type]


def tiff(order: str, tag: int) -> bytes:
    """Return the bytes of a TIFF file with a single tag, in the given byte order.

    The tag identifies the program that wrote the file.
    """
    magic = {"<": b"II*\0", ">": b"MM\0*"}[order]
    return magic + struct.pack(f"{order}IHHHIII", 8, 1, tag, 4, 1, 0, 0)


FORMATS = {
    "scan.001": (b"\\*File list\r\n\\Version: 0x07200000\r\n", "Bruker Nanoscope"),
    "scan.017": (b"\\*File list\r\n\\Version: 0x07200000\r\n", "Bruker Nanoscope"),
    "scan": (b"\\*File list\r\n\\Version: 0x07200000\r\n", "Bruker Nanoscope"),
    "scan.dat": (b"\x88\x1b\x03\x6f\0\0", "Zygo MetroPro"),
    "text.dat": (b"1 2 3\n4 5 6\n", "text: matrix, or points x, y, z"),
    "text": (b"1 2 3\n4 5 6\n", "text: matrix, or points x, y, z"),
    "park.tiff": (tiff("<", 50432), "Park Systems TIFF"),
    "park.tif": (tiff(">", 50432), "Park Systems TIFF"),
    "image.tif": (tiff("<", 256), "grey image of 8 or 16 bit, or of floats"),
    "cut.tif": (b"II*\0\xff", "grey image of 8 or 16 bit, or of floats"),
    "image.unknown": (b"\x89PNG\r\n\x1a\n\0\0", "grey image of 8 or 16 bit, or of floats"),
    "scan.SUR": (b"", "Digital Surf SURF"),
}  # fmt: skip


@pytest.mark.parametrize("name", FORMATS)
def test_suffix_and_content_select_the_reader(tmp_path: Path, name: str) -> None:
    content, title = FORMATS[name]
    (tmp_path / name).write_bytes(content)
    assert reader_registry.reader_of(tmp_path / name).title == title


def test_image_files_of_any_suffix_are_read(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", np.arange(12, dtype=np.uint8).reshape(3, 4, 1))
    (tmp_path / "a.png").rename(tmp_path / "a.unknown")
    assert HeightField.load(tmp_path / "a.unknown", pitch_um=0.1, height_range_um=0.3).shape == (3, 4)
    (tmp_path / "b.nms").write_bytes(bytes(100))
    with pytest.raises(
        ValueError, match=r"^path: .*b\.nms' has a format that is not read; export it as \.x3p, as text"
    ):
        HeightField.load(tmp_path / "b.nms")


def wsxm(samples: np.ndarray) -> bytes:
    """Return the bytes of a file of the program WSxM, which stores the sample in the lower right corner first."""
    ny, nx = samples.shape
    lines = (
        "[Control]\r\n\r\n    X Amplitude: 0.6 um\r\n    Y Amplitude: 0.8 um\r\n    Z Gain: 1\r\n\r\n"
        "[General Info]\r\n\r\n"
        "    Acquisition channel: Topography\r\n    Head type: AFM\r\n    Image Data Type: double\r\n"
        f"    Number of columns: {nx}\r\n    Number of rows: {ny}\r\n    Z Amplitude: 59 nm\r\n\r\n[Header end]\r\n"
    )
    first = "WSxM file copyright UAM\r\nSxM Image file\r\nImage header size: {:4d}\r\n\r\n"
    first = first.format(len(first.format(0)) + len(lines))
    return (first + lines).encode() + samples[::-1, ::-1].astype("<f8").tobytes()


@pytest.mark.scans
class TestTheLibraryItself:
    """Files that SurfaceTopography itself reads, and its own objects."""

    def test_a_file_of_wsxm_is_read_and_a_truncated_one_refused(self, tmp_path: Path) -> None:
        (tmp_path / "a.stp").write_bytes(wsxm(PICTURE_NM))
        scan = HeightField.load(tmp_path / "a.stp")
        np.testing.assert_allclose(scan.heights_um[::-1], 1e-3 * PICTURE_NM)
        np.testing.assert_allclose(scan.pitch_um, (0.4, 0.2))
        (tmp_path / "a.stp").write_bytes(wsxm(PICTURE_NM)[:-20])
        with pytest.raises(ValueError, match=r"^path: .*a\.stp' cannot be read as a file of WSXM \("):
            HeightField.load(tmp_path / "a.stp")

    def test_a_text_of_iso_25178_is_read(self, tmp_path: Path) -> None:
        header = (
            "aISO-1.0\nManufacID   = A\nCreateDate  = 040120100853\nModDate     = 050320101353\nNumPoints   = 3\n"
            "NumProfiles = 2\nXscale      = 2.0E-7\nYscale      = 4.0E-7\nZscale      = 1.0E-9\nZresolution = 1.0E-10\n"
            "Compression = 0\nDataType    = 7\nCheckType   = 0\n*\n"
        )
        (tmp_path / "a.sdf").write_text(header + "\n".join(" ".join(map(str, row)) for row in PICTURE_NM) + "\n*\n")
        scan = HeightField.load(tmp_path / "a.sdf")
        np.testing.assert_allclose(scan.heights_um[::-1], 1e-3 * PICTURE_NM)
        np.testing.assert_allclose(scan.pitch_um, (0.4, 0.2))

    def test_a_map_of_the_library_is_converted_and_a_line_scan_refused(self) -> None:
        from SurfaceTopography import Topography, UniformLineScan

        scan = HeightField.from_topography(Topography(PICTURE_NM.T, (600.0, 800.0), unit="nm"))
        np.testing.assert_allclose(scan.heights_um[::-1], 1e-3 * PICTURE_NM)
        np.testing.assert_allclose(scan.pitch_um, (0.4, 0.2))
        with pytest.raises(ValueError, match="topography must be a map"):
            HeightField.from_topography(UniformLineScan(PICTURE_NM[0], 600.0, unit="nm"))

    def test_every_listed_format_exists_in_the_library(self) -> None:
        from SurfaceTopography.IO import lookup_reader_by_format

        for _, name, suffixes, _ in topography_reader._FORMATS:
            own = lookup_reader_by_format[name].file_extensions()
            assert {suffix[1:] for suffix in suffixes} & set(own), name
