"""Damaged GDS layouts are refused before gdstk reads them, by an error that names the record."""

import struct

import pytest

pytest.importorskip("gdstk", reason="gdstk is not installed")
import warpdiff as wd
from bench.dev.fuzz_mutations import gds_content, gds_records
from bench.dev.fuzz_targets import CORPUS
from warpdiff.core import memory
from warpdiff.heightfield.writers import gds_records as checked

# Records of a valid GDS layout, as pairs of the record's type and data. The tests damage copies of this list.
LAYOUT = gds_records((CORPUS / "gds" / "cells.gds").read_bytes())
# Two bytes that state the type of a GDS record, by the name of the record's kind.
TYPES = {name: bytes([code, kind]) for code, name, kind, _ in checked._TABLE}


def index_of(name, number=0):
    """Return the index in ``LAYOUT`` of the record ``number`` (from 0) among the records with the name ``name``."""
    return [k for k, (kind, _) in enumerate(LAYOUT) if kind == TYPES[name]][number]


def replaced(name, data, number=0, kind=None):
    """Return the bytes of the GDS layout with other data, and optionally another type, in one record."""
    records = LAYOUT.copy()
    index = index_of(name, number)
    records[index] = (kind or records[index][0], data)
    return gds_content(records)


def without(name, number=0):
    """Return the bytes of the GDS layout without the record ``number`` (from 0) of those with the name ``name``."""
    index = index_of(name, number)
    return gds_content(LAYOUT[:index] + LAYOUT[index + 1 :])


def inserted(before, *records):
    """Return the bytes of the GDS layout with further records before its first record with the name ``before``."""
    index = index_of(before)
    return gds_content([*LAYOUT[:index], *((TYPES[name], data) for name, data in records), *LAYOUT[index:]])


REFERENCE = [("SREF", b""), ("SNAME", b"TOP\0"), ("XY", bytes(8)), ("ENDEL", b"")]
CASES = {
    "empty": (b"", "must end with the record ENDLIB"),
    "another format": (b"no layout", "has an unknown type"),
    "cut": (gds_content(LAYOUT)[:-9], "must end with|must be complete"),
    "no end": (without("ENDLIB"), "must end with the record ENDLIB"),
    "size beyond the file": (gds_content(LAYOUT)[:-4] + b"\xff\xfe\x04\0", "ENDLIB at byte .* must be complete"),
    "size of zero": (b"\0\0\0\2" + gds_content(LAYOUT)[4:], "HEADER at byte 0 must be complete"),
    "unknown record": (replaced("LAYER", b"\0\1", kind=b"\x3f\2"), "record 0x3F at byte"),
    "another type of data": (replaced("LAYER", b"\0\1", kind=b"\x0d\3"), "record LAYER .* got type 3"),
    "layer of four bytes": (replaced("LAYER", bytes(4)), "LAYER at byte .* must have 2 bytes of data, got 4"),
    "half a point": (replaced("XY", bytes(36)), "XY at byte .* of whole values, got a size of 40"),
    "no points": (replaced("XY", b""), "BOUNDARY at byte .* must have at least 4 points, got 0"),
    "path of one point": (replaced("XY", bytes(8), 1), "PATH at byte .* must have at least 2 points, got 1"),
    "path without points": (without("XY", 1), "record PATH at byte .* order of the format"),
    "array of two points": (replaced("XY", bytes(16), 4), "AREF at byte .* must have 3 points, got 2"),
    "array without size": (without("COLROW"), "record AREF at byte .* order of the format"),
    "array of no rows": (replaced("COLROW", struct.pack(">hh", 2, 0)), "must have columns and rows, got 2 × 0"),
    "array of negative rows": (replaced("COLROW", struct.pack(">hh", 2, -3)), "columns and rows, got 2 × -3"),
    "array of 20 million": (replaced("COLROW", struct.pack(">hh", 10000, 2000)), "at most 1000000 copies"),
    "array of dense copies": (replaced("COLROW", struct.pack(">hh", 32639, 3)), "one unit apart, got 32639"),
    "element outside of a cell": (without("BGNSTR"), "record STRNAME at byte .* order of the format"),
    "element without an end": (without("ENDEL"), "record BOUNDARY at byte .* order of the format"),
    "cell without a name": (replaced("STRNAME", b""), "STRNAME at byte .* must have a name"),
    "reference without a name": (replaced("SNAME", b"\0\0"), "SNAME at byte .* must have a name"),
    "two cells of a name": (replaced("STRNAME", b"INNER\0", 1), "the cell b'INNER' must occur once"),
    "missing cell": (replaced("SNAME", b"NONE"), "must name a cell of the file, got b'NONE'"),
    "cycle": (inserted("ENDSTR", *REFERENCE), "must not contain themselves, got the cycle b'.*TOP"),
    "units of zero": (replaced("UNITS", bytes(16)), "UNITS at byte .* must be 1e-15 to 1, got 0"),
    "negative units": (replaced("UNITS", b"\xbe" + bytes([65]) * 15), "UNITS at byte .* got -"),
    "magnification": (replaced("MAG", b"\x7f" + bytes([255] * 7)), "MAG at byte .* must be 1e-06 to 1e\\+06, got 7"),
    "round ends": (replaced("PATHTYPE", b"\0\1"), "PATHTYPE 0, 2 or 4"),
    "property without a value": (without("PROPVALUE"), "order of the format"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_damaged_layouts_are_refused_with_their_record(case, tmp_path):
    content, message = CASES[case]
    (tmp_path / "bad.gds").write_bytes(content)
    with pytest.raises(ValueError, match=f"path.*'bad.gds'.*{message}"):
        wd.measure_layout(tmp_path / "bad.gds")


def test_deep_references_are_refused(tmp_path):
    """A layout of 301 cells, each of which contains the next one, must be refused because of its deep nesting."""
    begin, end = LAYOUT[: index_of("BGNSTR")], [(TYPES["ENDLIB"], b"")]
    stamp = LAYOUT[index_of("BGNSTR")]
    cells = []
    for level in range(300):
        cells += [stamp, (TYPES["STRNAME"], b"%06d" % level), (TYPES["SREF"], b"")]
        cells += [(TYPES["SNAME"], b"%06d" % (level + 1)), *((TYPES[name], data) for name, data in REFERENCE[2:])]
        cells.append((TYPES["ENDSTR"], b""))
    cells += [stamp, (TYPES["STRNAME"], b"%06d" % 300), (TYPES["ENDSTR"], b"")]
    (tmp_path / "deep.gds").write_bytes(gds_content([*begin, *cells, *end]))
    with pytest.raises(ValueError, match="at most 256 levels, got 257 copies in 257 levels"):
        wd.measure_layout(tmp_path / "deep.gds")


def test_layouts_that_exceed_memory_are_refused(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 7000.0)
    with pytest.raises(MemoryError, match=r"'cells\.gds' of \d+ vertices .* take a part of the layout"):
        wd.measure_layout(CORPUS / "gds" / "cells.gds")


def test_layouts_of_other_programs_are_read(tmp_path):
    """A layout must be read even if a polygon has several records of points, or if zeros follow the last record."""
    index = index_of("XY")
    points = LAYOUT[index][1]
    parts = [(TYPES["XY"], points[:16]), (TYPES["XY"], points[16:])]
    (tmp_path / "a.gds").write_bytes(gds_content([*LAYOUT[:index], *parts, *LAYOUT[index + 1 :]]) + bytes(2048))
    expected = wd.measure_layout(CORPUS / "gds" / "cells.gds")
    assert wd.measure_layout(tmp_path / "a.gds")["area_um2"].tolist() == expected["area_um2"].tolist()
