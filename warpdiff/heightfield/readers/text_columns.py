"""Headings of columns in text files of points: the columns of positions x and y (or row and column), and of heights."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from typing import TYPE_CHECKING

from warpdiff.heightfield.readers import length_units, text_header, text_keys
from warpdiff.heightfield.readers.text_keys import UNIT

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from warpdiff.heightfield.readers.text_table import Form

# Words in the headings of columns in a text file, by the axis that they mean. Rows and lines are counted along y,
# columns and pixels of a line along x.
_AXES = {
    **dict.fromkeys(("x", "ix", "xi"), "x"), **dict.fromkeys(("y", "iy", "yi"), "y"), "z": "z",
    **dict.fromkeys(("row", "rows", "line", "zeile", "ligne", "riga", "fila", "linha", "行"), "row"),
    **dict.fromkeys(("col", "column", "columns", "pixel", "spalte", "colonne", "colonna", "columna"), "column"),
    **dict.fromkeys(("coluna", "列"), "column"),
    **dict.fromkeys(("height", "heights", "höhe", "hauteur", "altezza", "altura", "elevation", "topography"), "z"),
}  # fmt: skip


@dataclass
class Columns:
    """Columns of a text that lists points x, y, z.

    Attributes:
        positions: Indices of the columns of x, y and z.
        units: Sizes of the units of x, y and z [µm]; None for a column without a unit.
        counts_rows: Whether y is the index of a row, which is counted from the top of the picture.
        names_z: Whether a heading names the column of heights. Otherwise the heights are the only column that is not x
            or y.
    """

    positions: tuple[int, int, int]
    units: tuple[float | None, float | None, float | None]
    counts_rows: bool = False
    names_z: bool = True


def columns_of(header: Sequence[str], form: Form, width: int) -> Columns | None:
    """Return the columns of x, y and z by the headings in the last header lines; None if no headings name them."""
    lines = [line for line in header[-3:] if len(line) <= text_header.MOST_LENGTH]
    for index in range(len(lines) - 1, -1, -1):
        for cells in _cells(lines[index], form):
            axes: dict[str, int] = {}
            for position, cell in enumerate(cells):
                if axis := _axis_of(cell):
                    axes.setdefault(axis, position)
            # A line whose words form a sentence has no headings of columns.
            if len(cells) != width and not all(map(_axis_of, cells)):
                continue
            names = ("x", "y") if {"x", "y"} <= set(axes) else ("column", "row")
            names_z = "z" in axes
            if len(cells) == width == 3 and len(axes) == 2:
                axes["z"] = ({0, 1, 2} - set(axes.values())).pop()
            if {*names, "z"} <= set(axes) and len(cells) <= width:
                below = next(iter(_cells(lines[index + 1], form)), []) if index + 1 < len(lines) else []
                texts = below if len(below) == len(cells) else cells
                positions = axes[names[0]], axes[names[1]], axes["z"]
                x, y, z = (_unit_of_cell(texts[k], is_alone=texts is below) for k in positions)
                return Columns(positions, (x, y, z), names[1] == "row", names_z)
    return None


def unclear_headings(header: Sequence[str], form: Form, width: int) -> list[str] | None:
    """Return headings of three or four columns that do not name the columns of x and y; None without headings."""
    if not header or text_header.is_statement(header[-1]):
        return None
    for cells in _cells(header[-1], form):
        words = [word.lower() for cell in cells for word in re.findall(r"[^\W\d_]+", _without_unit(cell))[:1]]
        if {"x", "y"} <= {_axis_of(cell) for cell in cells}:
            return None
        if len(words) == len(cells) == width and ({"i", "j"} <= set(words) or form.separator is not None):
            return cells
    return None


def _axis_of(cell: str) -> str:
    """Return the axis that the heading of a column names: "x", "y", "z", "row", "column", or an empty string."""
    words = re.findall(r"[^\W\d_]+", _without_unit(cell).lower())
    axes = {_AXES[word] for word in words if word in _AXES}
    if axes & {"x", "y"}:
        axes &= {"x", "y"}
    return axes.pop() if len(axes) == 1 else ""


def _without_unit(cell: str) -> str:
    """Return the heading of a column without the unit in it, as in "x [µm]", "x_um" and "x/um"."""
    return re.sub(r"[\[(].*|/.*|\bin\b.*|_[^_]*$", "", cell) or cell


def _cells(line: str, form: Form) -> Iterator[list[str]]:
    """Yield the cells of a header line: it is split by the separator of the numbers, then by other usual separators."""
    line = unicodedata.normalize("NFKC", line.strip().lstrip("#%;/*'!\\ \t").strip())
    if form.separator is not None:
        yield [cell.strip('" ') for cell in form.cells(line)]
    for separator in (";", ",", "\t"):
        if separator in line:
            yield [cell.strip('" ') for cell in line.split(separator) if cell.strip()]
    # Before a line of headings is split at white space, each name is joined with the unit after it. Examples are "X
    # [nm] Y [nm] Z [nm]", "x(µm) y(µm) z(nm)" and "x in um y in um z in nm".
    joined = re.sub(r"\s*(?:/|\bin\b)\s*", "/", re.sub(r"\s+([\[(])", r"\1", line))
    yield joined.split()


def _unit_of_cell(cell: str, *, is_alone: bool) -> float | None:
    """Return the size [µm] of the unit in the heading of a column; None if the heading has no unit of length."""
    if is_alone:
        return length_units.factor_of(cell)
    match = re.search(rf"[\[(/_,]\s*({UNIT})\s*[\])]?$|\bin\s+({UNIT})$|\s({UNIT})$", cell)
    return length_units.factor_of(next(filter(None, match.groups()))) if match else None


def unit_of_corner(cell: str) -> float | None:
    """Return the size [µm] of the unit in the top left corner of a table, such as "x / y [µm]"; None without a unit."""
    words = re.findall(r"[^\W\d_]+", text_keys.IN_KEY.sub(" ", cell).lower())
    is_position = bool(words) and {_AXES.get(word) for word in words} <= {"x", "y"}
    return text_keys.unit_in_key(cell)[0] if is_position else None
