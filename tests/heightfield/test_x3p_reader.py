"""Surfaces in .x3p files: valid files, frequent mistakes of writers, limits of size, and errors that name the file."""

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from warpdiff.heightfield.field import HeightField
from warpdiff.heightfield.readers import x3p_reader

HEIGHTS_M = 1e-9 * np.array([[0.0, 10.0, -20.0, 30.0, 5.0], [40.0, 55.0, 60.0, -70.0, 8.0], [1.0, 2.0, 3.0, 4.0, 9.0]])
TYPES = {"I": "<i2", "L": "<i4", "F": "<f4", "D": "<f8"}


def header(**texts: Any) -> str:
    """Return the XML header of a surface of 5 × 3 samples. ``texts`` replaces the texts of some of its elements."""
    known = {
        "kind": "SUR", "type": "D", "x": "2.5e-7", "y": "5e-7", "axis": "I", "z": "", "nx": 5, "ny": 3, "nz": "1",
        "data": "<DataLink><PointDataLink>bindata/data.bin</PointDataLink></DataLink>", "before": "", "p": "p:",
    } | texts  # fmt: skip
    p = known["p"]
    return f"""<?xml version="1.0" encoding="UTF-8"?>{known["before"]}
<{p}ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2"><Record1><Revision>ISO5436 - 2000</Revision>
<FeatureType>{known["kind"]}</FeatureType><Axes>
<CX><AxisType>{known["axis"]}</AxisType><DataType>D</DataType><Increment>{known["x"]}</Increment></CX>
<CY><AxisType>I</AxisType><DataType>D</DataType><Increment>{known["y"]}</Increment></CY>
<CZ><AxisType>A</AxisType><DataType>{known["type"]}</DataType>{known["z"]}</CZ></Axes></Record1>
<Record2><Date>2026-11-27</Date><Instrument><Manufacturer>Maker</Manufacturer><Model>µSurf</Model></Instrument></Record2>
<Record3><MatrixDimension><SizeX>{known["nx"]}</SizeX><SizeY>{known["ny"]}</SizeY><SizeZ>{known["nz"]}</SizeZ>
</MatrixDimension>{known["data"]}</Record3><Record4><ChecksumFile>md5checksum.hex</ChecksumFile></Record4>
</{p}ISO5436_2>"""


def write(path: Path, xml: str, data: bytes | None = None, folder: str = "", **members: bytes) -> Path:
    """Write an .x3p file: a ZIP archive of the header, the heights and further files."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"{folder}main.xml", xml)
        archive.writestr("__MACOSX/._main.xml", b"\0\1")
        archive.writestr(f"{folder}bindata/data.bin", HEIGHTS_M.tobytes() if data is None else data)
        for name, content in members.items():
            archive.writestr(f"{folder}bindata/{name}.bin", content)
    return path


@pytest.mark.parametrize("letter", TYPES)
def test_heights_of_every_number_type_are_read(tmp_path: Path, letter: str) -> None:
    factor = 1e-9 if letter in "IL" else 1.0
    z = "<Increment>1e-9</Increment><Offset>2e-9</Offset>" if letter in "IL" else "<Increment>7</Increment>"
    data = np.round((HEIGHTS_M - (2e-9 if letter in "IL" else 0.0)) / factor, 15).astype(TYPES[letter]).tobytes()
    scan = HeightField.load(write(tmp_path / "a.x3p", header(type=letter, z=z), data))
    np.testing.assert_allclose(scan.heights_um[::-1], 1e6 * HEIGHTS_M, atol=1e-8)
    np.testing.assert_allclose(scan.pitch_um, (0.5, 0.25))
    assert scan.source is not None
    assert scan.source.rows == "up"
    assert scan.source.metadata == {"date": "2026-11-27", "vendor": "Maker", "instrument": "µSurf"}
    np.testing.assert_allclose(HeightField.load(tmp_path / "a.x3p", rows="down").heights_um, 1e6 * HEIGHTS_M, atol=1e-8)
    assert HeightField.channels(tmp_path / "a.x3p") == ()


@pytest.mark.parametrize(("name", "options"), [
    ("a.x3p", {"folder": "scan/"}), ("a.zip", {}), ("a.X3P", {}), ("a", {}),
])  # fmt: skip
def test_subfolders_and_other_suffixes_are_read(tmp_path: Path, name: str, options: dict[str, Any]) -> None:
    scan = HeightField.load(write(tmp_path / name, header(p=""), **options))
    np.testing.assert_allclose(scan.heights_um[::-1], 1e6 * HEIGHTS_M)


def test_masked_nan_and_infinite_samples_are_missing(tmp_path: Path) -> None:
    heights = HEIGHTS_M.copy()
    heights[0, 1], heights[1, 1] = math.inf, math.nan
    link = (
        "<DataLink><PointDataLink>bindata/data.bin</PointDataLink><ValidPointsLink>bindata/valid.bin</ValidPointsLink>"
        "</DataLink>"
    )
    valid = np.packbits(np.arange(15) != 9, bitorder="little").tobytes()
    scan = HeightField.load(write(tmp_path / "a.x3p", header(data=link), heights.tobytes(), valid=valid))
    missing = np.zeros((3, 5), dtype=bool)
    missing[0, 1] = missing[1, 1] = missing[1, 4] = True
    np.testing.assert_array_equal(scan.missing[::-1], missing)


@pytest.mark.parametrize("form", ["{z}", "{x};{y};{z}", "{x}, {y}, {z}"])
def test_heights_within_the_header_are_read(tmp_path: Path, form: str) -> None:
    texts = [form.format(x=k % 5, y=k // 5, z=z) for k, z in enumerate(HEIGHTS_M.ravel())]
    texts[7] = ""
    data = "<DataList>" + "".join(f"<Datum>{text}</Datum>" for text in texts) + "</DataList>"
    scan = HeightField.load(write(tmp_path / "a.x3p", header(data=data)))
    expected = np.where(np.arange(15).reshape(3, 5) == 7, np.nan, 1e6 * HEIGHTS_M)
    np.testing.assert_allclose(scan.heights_um[::-1], expected)


ENTITY = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>'
REFUSED: dict[str, tuple[dict[str, Any], bytes | None, str]] = {
    "a profile": ({"kind": "PRF"}, None, "is a profile, not a surface"),
    "points": ({"kind": "PCL"}, None, "is a cloud of points"),
    "another kind": ({"kind": "XYZ"}, None, "is of type 'XYZ'"),
    "positions one by one": ({"axis": "A"}, None, "positions along CX are stated one by one"),
    "no pitch": ({"x": ""}, None, "Record1/Axes/CX/Increment is no number: ''"),
    "a pitch of zero": ({"y": "0"}, None, "Record1/Axes/CY/Increment must be positive: 0"),
    "layers": ({"nz": 2}, None, "it has 2 layers"),
    "no samples": ({"nx": 0}, None, "SizeX is no number of samples: 0"),
    "half a sample": ({"nx": 2.5}, None, "SizeX is no number of samples"),
    "too few bytes": ({}, HEIGHTS_M.tobytes()[:-1], "data.bin has 119 bytes, and the header states 120"),
    "an unknown type": ({"type": "Q"}, None, "heights are of an unknown type 'Q'"),
    "integers without a unit": ({"type": "I"}, None, "Axes/CZ/Increment is no number"),
    "no such member": ({"data": "<DataLink><PointDataLink>../a.bin</PointDataLink></DataLink>"}, None, "../a.bin"),
    "too few heights": ({"data": "<DataList><Datum>1</Datum></DataList>"}, None, "it lists 1 heights"),
    "words": ({"nx": 1, "ny": 1, "data": "<DataList><Datum>high</Datum></DataList>"}, None, "could not convert"),
    "entities": ({"before": ENTITY, "kind": "&b;"}, None, "a document type is not accepted"),
    "deep elements": ({"z": 40 * "<a>" + 40 * "</a>"}, None, "nested deeper than 32"),
    "no XML": ({"before": "<"}, None, "main.xml: not well-formed"),
    "a size of kilometres": ({"x": "1000"}, None, "beyond any instrument"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_other_archives_are_refused_by_their_path(tmp_path: Path, name: str) -> None:
    texts, data, message = REFUSED[name]
    path = write(tmp_path / "a.x3p", header(**texts), data)
    with pytest.raises(ValueError, match=rf"^path: .*a\.x3p' .*{message}"):
        HeightField.load(path)


def test_files_that_are_no_archive_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.x3p").write_bytes(b"PK\x03\x04 no archive")
    with pytest.raises(ValueError, match=r"^path: .*a\.x3p' cannot be read as \.x3p \(it is no zip archive"):
        HeightField.load(tmp_path / "a.x3p")
    with zipfile.ZipFile(tmp_path / "a.x3p", "w") as archive:
        archive.writestr("other.xml", "<a/>")
    with pytest.raises(ValueError, match=r"^path: .*a\.x3p' .*it has no main\.xml"):
        HeightField.load(tmp_path / "a.x3p")


def test_members_that_expand_without_limit_are_not_expanded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(x3p_reader, "_MOST_XML_BYTES", 10_000)
    path = write(tmp_path / "a.x3p", header() + 20_000 * " ")
    with pytest.raises(ValueError, match=r"main\.xml is larger than 10000 bytes"):
        HeightField.load(path)
    # The file of heights inside the archive is 10 MB too long. Only the bytes of the samples that the header states are
    # read.
    scan = HeightField.load(write(tmp_path / "b.x3p", header(), HEIGHTS_M.tobytes() + bytes(10_000_000)))
    np.testing.assert_allclose(scan.heights_um[::-1], 1e6 * HEIGHTS_M)
    with pytest.raises(MemoryError, match=r"^path: .*c\.x3p' of 2000000000 × 2000000000 samples requires"):
        HeightField.load(write(tmp_path / "c.x3p", header(nx=2_000_000_000, ny=2_000_000_000)))
