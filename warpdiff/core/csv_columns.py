"""Reader of the numeric columns of CSV files, with several separators, decimal commas, units and percent signs."""

from __future__ import annotations

import csv
import io
import math
import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from warpdiff.core import files
from warpdiff.core.text_encodings import decoded
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

# Characters that may separate the cells of a line in a CSV file. The reader uses the character that splits the first
# line into the most known column names.
_SEPARATORS = ",;\t"
# Factors that convert the unit in brackets in a column heading, such as "wavelength [µm]", to the unit of this package.
# Names of columns in this package end with their unit, such as "nm" in "wavelength_nm". Names without a unit are
# ratios.
_UNITS = {
    "nm": {"nm": 1.0, "µm": 1e3, "μm": 1e3, "um": 1e3},
    "deg": {"deg": 1.0, "°": 1.0, "degree": 1.0, "degrees": 1.0, "rad": math.degrees(1.0)},
    "": {"": 1.0, "1": 1.0, "-": 1.0, "%": 1e-2},
}
# Matches a heading with a unit in brackets, such as "wavelength [µm]".
_HEADING = re.compile(r"(?P<name>.*?)\s*[\[(]\s*(?P<unit>[^\])]*?)\s*[\])]")


class _Column(NamedTuple):
    """Column of a CSV file: its index, its name in this package, and the factor that converts its unit."""

    place: int
    name: str
    factor: float


def read(path: Path, known: Iterable[str]) -> dict[str, NDArray[np.float64]]:
    """Return the known columns of a CSV file by their names; other columns are ignored.

    The first line that is neither empty nor a comment (#) names the columns. Cells are separated by commas, semicolons
    or tabs. If semicolons or tabs separate the cells, numbers may have decimal commas. A name may have its unit in
    brackets. Ratios may be in percent, with the percent sign in the heading or in the cells.

    Args:
        path: Path of the file.
        known: Names of columns, with a unit at the end unless they are ratios.

    Raises:
        FileNotFoundError: The file does not exist.
        OSError: The file cannot be read.
        ValueError: A cell is not a number, a column occurs twice, or the file is not a table.
    """
    if not path.is_file():
        raise FileNotFoundError(f"path: {str(path)!r} is not a file")
    with files.naming_file(path):
        text = decoded(path.read_bytes())
    if "\0" in text:
        raise ArgumentValueError(f"{ref('path')}: {str(path)!r} is not a CSV file, because it contains NUL characters")
    names = tuple(known)
    try:
        headings = {mark: next(_lines(text, mark), None) for mark in _SEPARATORS}
        if headings[","] is None:
            raise ArgumentValueError(
                f"{ref('path')}: {str(path)!r} is empty: it must have a line that names the columns"
            )
        separator = max(headings, key=lambda mark: len(_columns((headings[mark] or (0, []))[1], names)))
        (_, heading), *lines = _lines(text, separator)
    except csv.Error as error:
        raise ArgumentValueError(f"{ref('path')}: {str(path)!r} is not a CSV file: {error}") from None
    columns = _columns(heading, names)
    distinct = [column.name for column in columns]
    for name in distinct:
        if distinct.count(name) > 1:
            raise ArgumentValueError(f"{ref('path')}: column {name!r} occurs {distinct.count(name)} times: remove one")
    rows: list[list[float]] = []
    for line, cells in lines:
        if any(cells[len(heading) :]):
            raise ArgumentValueError(
                f"{ref('path')}: line {line} must have {len(heading)} cells, got {len(cells)}: separate columns by "
                "semicolons if numbers have decimal commas"
            )
        rows.append([_number(cells, column, line, separator) for column in columns])
    if columns and not rows:
        raise ArgumentValueError(f"{ref('path')}: {str(path)!r} must have at least one line of numbers")
    return {column.name: np.array([row[k] for row in rows]) for k, column in enumerate(columns)}


def _lines(text: str, separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the number and the cells of each line, without empty lines, comments, and the line ``sep=;`` of Excel."""
    reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    for cells in reader:
        row = [cell.strip() for cell in cells]
        if any(row) and not row[0].lower().startswith(("#", "sep=")):
            yield reader.line_num, row


def _columns(heading: list[str], known: tuple[str, ...]) -> list[_Column]:
    """Return the columns of a CSV file whose headings are among the names ``known``."""
    columns = []
    units = [(name, next((end for end in _UNITS if end and name.endswith(f"_{end}")), "")) for name in known]
    for place, cell in enumerate(heading):
        match = _HEADING.fullmatch(cell)
        title, unit = (match["name"], match["unit"]) if match else (cell, None)
        lower = re.sub(r"[\s-]+", "_", title).lower()
        for name, own in units:
            # The case of single letters matters: X, Y and Z are colours, while x, y and z are positions.
            title_name = title if len(name) == 1 else lower
            is_short = bool(own) and title_name == name.removesuffix(f"_{own}") and unit is not None
            factor = _UNITS[own].get((own if unit is None else unit).lower())
            # A heading with two different units, such as "wavelength_nm [µm]", is not accepted as a known column.
            is_full = title_name == name and (not own or factor == 1.0)
            if factor is not None and (is_full or is_short):
                columns.append(_Column(place, name, factor))
    return columns


def _number(cells: list[str], column: _Column, line: int, separator: str) -> float:
    """Return the number in the cell of a column, converted to the unit of the column's name."""
    cell = cells[column.place] if column.place < len(cells) else ""
    place = f"{ref('path')}: column {column.name!r} in line {line}"
    if not cell:
        raise ArgumentValueError(f"{place} must be a finite number, got an empty cell: fill it, or remove the line")
    text, factor = cell, column.factor
    if cell.endswith("%") and not any(column.name.endswith(f"_{unit}") for unit in _UNITS if unit):
        # A percent sign in the heading and one in the cell mean the same percentage: the factor 0.01 is applied once.
        text, factor = cell[:-1].strip(), 1e-2
    if separator != "," and "." not in text:
        text = text.replace(",", ".")
    try:
        value = float(text) * factor
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ArgumentValueError(f"{place} must be a finite number, got {cell!r}: correct it, or remove the line")
    return value
