"""Check of the records of a GDS layout before gdstk reads it, because damaged records crash gdstk, and so the process.

The names of records and elements are those of the GDSII stream format, release 6. A file is a sequence of records.
Several records make an element, such as a polygon or a reference. A cell is a named list of elements. A reference
places one or more copies of another cell.
"""

from __future__ import annotations

import graphlib
import re
import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NoReturn

from warpdiff.core import memory
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from pathlib import Path

# Numbers of the data types of GDS records: bits, integers of 2 and 4 bytes, real numbers of 8 bytes, and text.
_NONE, _BITS, _INT2, _INT4, _REAL, _TEXT = 0, 1, 2, 3, 5, 6
# Code, name, data type and number of bytes of each kind of GDS record; None permits any number of bytes. Records of
# other programs that no layout requires are not listed.
_TABLE = (
    (0x00, "HEADER", _INT2, 2), (0x01, "BGNLIB", _INT2, 24), (0x02, "LIBNAME", _TEXT, None), (0x03, "UNITS", _REAL, 16),
    (0x04, "ENDLIB", _NONE, 0), (0x05, "BGNSTR", _INT2, 24), (0x06, "STRNAME", _TEXT, None), (0x07, "ENDSTR", _NONE, 0),
    (0x08, "BOUNDARY", _NONE, 0), (0x09, "PATH", _NONE, 0), (0x0A, "SREF", _NONE, 0), (0x0B, "AREF", _NONE, 0),
    (0x0C, "TEXT", _NONE, 0), (0x0D, "LAYER", _INT2, 2), (0x0E, "DATATYPE", _INT2, 2), (0x0F, "WIDTH", _INT4, 4),
    (0x10, "XY", _INT4, None), (0x11, "ENDEL", _NONE, 0), (0x12, "SNAME", _TEXT, None), (0x13, "COLROW", _INT2, 4),
    (0x15, "NODE", _NONE, 0), (0x16, "TEXTTYPE", _INT2, 2), (0x17, "PRESENTATION", _BITS, 2),
    (0x19, "STRING", _TEXT, None), (0x1A, "STRANS", _BITS, 2), (0x1B, "MAG", _REAL, 8), (0x1C, "ANGLE", _REAL, 8),
    (0x1F, "REFLIBS", _TEXT, None), (0x20, "FONTS", _TEXT, None), (0x21, "PATHTYPE", _INT2, 2),
    (0x22, "GENERATIONS", _INT2, 2), (0x23, "ATTRTABLE", _TEXT, None), (0x26, "ELFLAGS", _BITS, 2),
    (0x2A, "NODETYPE", _INT2, 2), (0x2B, "PROPATTR", _INT2, 2), (0x2C, "PROPVALUE", _TEXT, None),
    (0x2D, "BOX", _NONE, 0), (0x2E, "BOXTYPE", _INT2, 2), (0x2F, "PLEX", _INT4, 4), (0x30, "BGNEXTN", _INT4, 4),
    (0x31, "ENDEXTN", _INT4, 4), (0x34, "STRCLASS", _BITS, 2), (0x36, "FORMAT", _INT2, 2), (0x37, "MASK", _TEXT, None),
    (0x38, "ENDMASKS", _NONE, 0),
)  # fmt: skip
_RECORDS = {code: (name, kind, size) for code, name, kind, size in _TABLE}
_CODES = {name: code for code, name, _, _ in _TABLE}
# Smallest and largest number of points of each kind of GDS element, such as polygon or reference; None is no limit.
_POINTS = {
    "BOUNDARY": (4, None), "BOX": (4, None), "PATH": (2, None), "SREF": (1, 1), "AREF": (3, 3), "TEXT": (1, 1),
    "NODE": (1, 50),
}  # fmt: skip
# Largest depth of nested references: a cell in a cell, and so on. Layouts have a depth of less than 30. gdstk calls a
# function for each level of the nesting, and the stack of a process has room for about ten thousand calls.
_MOST_DEPTH = 256
# Largest number of copies of cells that all references place together. The measurement of a million rectangles requires
# about 12 s. If doubled, damaged files can require twice this time.
_MOST_COPIES = 10**6
# Peak memory per vertex of the polygons [bytes], while a layout is read and measured. The value was measured for
# squares at random positions.
_BYTES_PER_VERTEX = 760.0
# Accepted ranges: the resolution of a layout [m], and the magnification with which a reference places a cell.
_RESOLUTIONS, _MAGNIFICATIONS = (1e-15, 1.0), (1e-6, 1e6)
# The regular expressions below check the order of records. One character stands for one record. The code point of the
# character is this number plus the code of the record.
_FIRST_LETTER = 0x100


def _expression(text: str) -> re.Pattern[str]:
    """Compile a regular expression of names of records, after each name is replaced by the character of the record."""
    return re.compile(re.sub(r"[A-Z][A-Z0-9]+", lambda name: chr(_FIRST_LETTER + _CODES[name[0]]), text), re.VERBOSE)


_PROPERTIES, _TURN = "(?: PROPATTR PROPVALUE )*", "(?: STRANS MAG? ANGLE? )?"
_HEAD = _expression(
    f"HEADER BGNLIB LIBNAME REFLIBS? FONTS? ATTRTABLE? GENERATIONS? (?: FORMAT (?: MASK+ ENDMASKS )? )? UNITS "
    f"{_PROPERTIES}"
)
_CELL = _expression(f"BGNSTR STRNAME STRCLASS? {_PROPERTIES}")
_ELEMENT = _expression(
    "(?: BOUNDARY ELFLAGS? PLEX? LAYER DATATYPE XY+ | BOX ELFLAGS? PLEX? LAYER BOXTYPE XY "
    "| PATH ELFLAGS? PLEX? LAYER DATATYPE PATHTYPE? WIDTH? BGNEXTN? ENDEXTN? XY+ "
    f"| SREF ELFLAGS? PLEX? SNAME {_TURN} XY | AREF ELFLAGS? PLEX? SNAME {_TURN} COLROW XY "
    f"| TEXT ELFLAGS? PLEX? LAYER TEXTTYPE PRESENTATION? PATHTYPE? WIDTH? {_TURN} XY STRING "
    f"| NODE ELFLAGS? PLEX? LAYER NODETYPE XY ) {_PROPERTIES} ENDEL"
)


@dataclass
class _Cell:
    """Number of vertices of a cell's own polygons, and names of the cells that it contains, with numbers of copies."""

    vertices: int = 0
    copies: list[tuple[bytes, int]] = field(default_factory=list)


class _Layout:
    """Records of a GDS file, with their positions and order.

    Attributes:
        data: Content of the file.
        name: Name of the file, for messages.
        begins: Position of each record.
        letters: Text with one character per record, see `_FIRST_LETTER`.
    """

    def __init__(self, data: bytes, name: str) -> None:
        self.data, self.name = data, name
        self.begins: list[int] = []
        at, codes = 0, list[int]()
        while not codes or codes[-1] != _CODES["ENDLIB"]:
            if at + 4 > len(data):
                self.refuse("it must end with the record ENDLIB")
            size, code, kind = struct.unpack_from(">HBB", data, at)
            title, expected_kind, bytes_of_data = _RECORDS.get(code, (f"0x{code:02X}", None, None))
            if kind != expected_kind:
                self.refuse(f"record {title} at byte {at} has an unknown type or unknown data, got type {kind}")
            if size < 4 or (size - 4) % (8 if title == "XY" else 2) or at + size > len(data):
                self.refuse(f"record {title} at byte {at} must be complete and of whole values, got a size of {size}")
            if bytes_of_data is not None and size != 4 + bytes_of_data:
                self.refuse(f"record {title} at byte {at} must have {bytes_of_data} bytes of data, got {size - 4}")
            self.begins.append(at)
            codes.append(code)
            at += size
        self.letters = "".join(chr(_FIRST_LETTER + code) for code in codes)

    def refuse(self, reason: str) -> NoReturn:
        """Raise the error for a damaged GDS file."""
        raise ArgumentValueError(f"{ref('path')}: {self.name!r} is not a GDS file: {reason}; export it again")

    def match(self, expression: re.Pattern[str], begin: int) -> int:
        """Return the index after the records from ``begin`` that match; raise an error if their order is wrong."""
        match = expression.match(self.letters, begin)
        if match is None:
            self.refuse(
                f"record {self.title(begin)} at byte {self.begins[begin]} and the records that follow are not in the "
                "order of the format"
            )
        return match.end()

    def title(self, index: int) -> str:
        """Return the name of the record with an index, such as "BOUNDARY"."""
        return _RECORDS[ord(self.letters[index]) - _FIRST_LETTER][0]

    def content(self, index: int) -> bytes:
        """Return the data bytes of the record with an index."""
        begin = self.begins[index]
        return self.data[begin + 4 : begin + int.from_bytes(self.data[begin : begin + 2])]

    def integers(self, index: int) -> tuple[int, ...]:
        """Return the data of the record with an index as integers of two bytes."""
        content = self.content(index)
        return struct.unpack(f">{len(content) // 2}h", content)

    def text(self, index: int) -> bytes:
        """Return the name of a cell from the data of the record with an index."""
        text = self.content(index).removesuffix(b"\0")
        if not text or b"\0" in text:
            self.refuse(f"record {self.title(index)} at byte {self.begins[index]} must have a name, got {text!r}")
        return text

    def check_real(self, index: int, begin: int, limits: tuple[float, float]) -> None:
        """Raise an error if the real number at the byte ``begin`` of a record's data is not within ``limits``.

        Its eight bytes are a sign bit, an exponent of the base 16 with 7 bits, and a mantissa of 7 bytes.
        """
        content = self.content(index)[begin : begin + 8]
        value = int.from_bytes(content[1:]) / 2.0**56 * 16.0 ** ((content[0] & 127) - 64)
        if not (content[0] < 128 and limits[0] <= value <= limits[1]):
            self.refuse(
                f"record {self.title(index)} at byte {self.begins[index]} must be {limits[0]:g} to {limits[1]:g}, got "
                f"{-value if content[0] > 127 else value:g}"
            )


def check(file: Path) -> None:
    """Raise an error if a file is not a complete GDS layout that fits into memory.

    The check covers sizes, types and order of the records, numbers of points, names and cycles of references, and
    numbers of copies.

    Raises:
        ValueError: The file is damaged.
        MemoryError: The file, or the polygons of its top cell, do not fit into memory.
    """
    memory.require_memory(10.0 * file.stat().st_size, f"{ref('path')}: {file.name!r}", "take a part of the layout")
    layout = _Layout(file.read_bytes(), file.name)
    at = layout.match(_HEAD, 0)
    units = layout.letters.index(chr(_FIRST_LETTER + _CODES["UNITS"]))
    for begin in (0, 8):
        layout.check_real(units, begin, _RESOLUTIONS)
    cells: dict[bytes, _Cell] = {}
    while layout.title(at) != "ENDLIB":
        begin, at = at, layout.match(_CELL, at)
        name = layout.text(begin + 1)
        if name in cells:
            layout.refuse(f"the cell {name!r} must occur once")
        cell = cells[name] = _Cell()
        while layout.title(at) != "ENDSTR":
            begin, at = at, layout.match(_ELEMENT, at)
            _add(layout, cell, begin, at)
        at += 1
    _check_references(layout, cells)


def _add(layout: _Layout, cell: _Cell, begin: int, end: int) -> None:
    """Check the values of an element (polygon, reference, text), and add its vertices or copies to its cell."""
    records = {layout.title(index): index for index in range(begin, end)}
    title = layout.title(begin)
    points = sum(len(layout.content(index)) // 8 for index in range(begin, end) if layout.title(index) == "XY")
    least, most = _POINTS[title]
    if points < least or (most is not None and points > most):
        limits = f"at least {least}" if most is None else f"{least} to {most}" if least < most else f"{least}"
        layout.refuse(f"the {title} at byte {layout.begins[begin]} must have {limits} points, got {points}")
    if title == "PATH" and "PATHTYPE" in records and layout.integers(records["PATHTYPE"])[0] not in (0, 2, 4):
        layout.refuse(f"the PATH at byte {layout.begins[begin]} must have straight ends, PATHTYPE 0, 2 or 4")
    if "MAG" in records:
        layout.check_real(records["MAG"], 0, _MAGNIFICATIONS)
    if title in ("BOUNDARY", "BOX", "PATH"):
        cell.vertices += points
    if title in ("SREF", "AREF"):
        columns, rows = layout.integers(records["COLROW"]) if title == "AREF" else (1, 1)
        if min(columns, rows) < 1:
            layout.refuse(f"the AREF at byte {layout.begins[begin]} must have columns and rows, got {columns} × {rows}")
        if title == "AREF":
            x, y, *corners = struct.unpack(">6i", layout.content(records["XY"]))
            for count, to_x, to_y in zip((columns, rows), corners[::2], corners[1::2], strict=True):
                if 1 < count > max(abs(to_x - x), abs(to_y - y)):
                    layout.refuse(
                        f"the AREF at byte {layout.begins[begin]} must have copies at least one unit apart, got "
                        f"{count} copies in less"
                    )
        cell.copies.append((layout.text(records["SNAME"]), columns * rows))


def _check_references(layout: _Layout, cells: dict[bytes, _Cell]) -> None:
    """Raise an error if a reference names no cell of the file, a cell contains itself, or copies are too many."""
    graph = {name: {other for other, _ in cell.copies} for name, cell in cells.items()}
    missing = sorted(set().union(*graph.values()) - set(graph))
    if missing:
        layout.refuse(f"a reference must name a cell of the file, got {missing[0]!r}")
    try:
        order = [*graphlib.TopologicalSorter(graph).static_order()]
    except graphlib.CycleError as error:
        layout.refuse(f"references must not contain themselves, got the cycle {b' > '.join(error.args[1])!r}")
    # For each cell: numbers of copies and of vertices, including those of all cells inside, and depth of nested
    # references.
    totals: dict[bytes, tuple[int, int, int]] = {}
    for name in order:
        copies, vertices, depth = 0, cells[name].vertices, 0
        for other, count in cells[name].copies:
            inner = totals[other]
            copies, vertices = copies + count * (1 + inner[0]), vertices + count * inner[1]
            depth = max(depth, 1 + inner[2])
        if copies > _MOST_COPIES or depth > _MOST_DEPTH:
            raise ArgumentValueError(
                f"{ref('path')}: {layout.name!r} must have at most {_MOST_COPIES} copies of cells in at most "
                f"{_MOST_DEPTH} levels, got {copies} copies in {depth} levels: take a part of the layout"
            )
        totals[name] = copies, vertices, depth
    most = max((vertices for _, vertices, _ in totals.values()), default=0)
    what = f"{ref('path')}: {layout.name!r} of {most} vertices"
    memory.require_memory(_BYTES_PER_VERTEX * most, what, "take a part of the layout")
