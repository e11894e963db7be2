"""Tables of numbers in text files: detection of encoding, separator, decimal sign, and blocks of equally long rows."""

from __future__ import annotations

import csv
import gzip
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from warpdiff.core.text_encodings import decoded

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

# A file is refused if its decompressed text is larger than this size [bytes]: 100 million numbers of ten characters.
# The limit also stops small compressed files that expand to very large texts.
MOST_BYTES = 1 << 30
# The separator and the decimal sign of a text are found by trials on a sample of its lines. The sample has at most
# `_SAMPLE_LINES` lines and `_SAMPLE_CHARACTERS` characters. If doubled, the trials take twice as long and have the same
# results.
_SAMPLE_LINES, _SAMPLE_CHARACTERS = 400, 200_000
# Number of bytes at the beginning of a file that are read to find out whether the file is text.
_HEAD_BYTES = 4096
_GZIP = b"\x1f\x8b"
# Characters that a text may contain although they are not printable. If a text in another encoding is read as Latin-1,
# some of its letters become C1 control characters (0x80 to 0x9F).
_CONTROLS = frozenset("\t\r\n\f\ufeff\x1a") | {chr(code) for code in range(0x80, 0xA0)}
# Words that programs of instruments write for a missing sample.
_GAPS = frozenset({
    "nan", "+nan", "-nan", "1.#qnan", "-1.#ind", "nan(ind)", "-nan(ind)", "1.#inf", "-1.#inf", "inf",
    "+inf", "-inf", "infinity", "-infinity", "bad", "-", "--",
    "---", "*", "**", "***", "nodata", "n/a", "#n/a", "na", "null", "none", "missing", "void", "invalid",
    "masked", "undefined",
})  # fmt: skip
# Matches "no data" in a cell, but not in a header line that states the code of missing samples.
_NO_DATA = re.compile(r"(?i)\bno[ _-]?data\b(?!\s*(?:value|code|[:=]))")
# `_APOSTROPHE` matches an apostrophe between digits that separates thousands. `_GROUPED` matches a number with any
# thousands sign. `_SPACES` matches the narrow spaces that some programs use as this sign.
_APOSTROPHE = re.compile(r"(?<=\d)['’](?=\d{3}(?!\d))")
_GROUPED = re.compile(r"\d[,. \xa0]\d{3}(?!\d)")
_SPACES = re.compile("[\u2009\u202f]")
_NUMBERS = {
    (".", ""): re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"),
    # If the decimal sign is a comma, digits must follow it in a number. A comma without digits after it is a separator.
    (",", ""): re.compile(r"[-+]?(?:\d+(?:,\d+)?|,\d+)(?:[eEdD][-+]?\d+)?"),
    **{
        (decimal, sign): re.compile(
            rf"[-+]?(?:\d{{1,3}}(?:{re.escape(sign)}\d{{3}})+|\d+)(?:{re.escape(decimal)}\d+)?(?:[eEdD][-+]?\d+)?"
        )
        for decimal, sign in ((".", ","), (".", "\xa0"), (",", "."), (",", "\xa0"))
    },
}
# Pairs of a separator and a decimal sign that are tried; a separator of None is white space. If several pairs give
# equally many numbers, the first of these pairs is used.
_FORMS: tuple[tuple[str | None, str], ...] = (
    ("\t", "."), (";", "."), (",", "."), (None, "."), ("\t", ","), (";", ","), (",", ","), (None, ","),
)  # fmt: skip
# Thousands signs that are tried, by the decimal sign. Before them, all separators and decimal signs are tried without a
# thousands sign. A no-break space also stands for other kinds of spaces, and is not tried if white space separates the
# numbers.
_THOUSANDS = {".": (",", "\xa0"), ",": (".", "\xa0")}
# Positions of points along an axis are assigned to equally spaced coordinates. The difference between a rounded
# position and its coordinate may be at most `_MOST_ROUNDING`. Positions with noise that count as equal may spread over
# at most `_MOST_NOISE`. Both numbers are relative to the spacing. If doubled, more scattered points are taken for a
# grid.
_MOST_ROUNDING, _MOST_NOISE = 0.1, 0.01
# Positions of points along an axis that are equal up to noise form a group. The gap between two groups is at least this
# fraction of the largest gap. If twenty (1/0.05) neighbouring coordinates of the axis have no point, all other gaps are
# smaller than this limit, and the text is refused. If the number is doubled, ten such coordinates suffice.
_GROUP_GAP = 0.05
_LINE_END = re.compile(r"\r\n?|\n")


def is_text(file: Path) -> bool:
    """Whether the first 4096 bytes of a file are text that contains digits."""
    with file.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    if head.startswith(_GZIP):
        return False
    text = decoded(head[: len(head) // 4 * 4] if len(head) == _HEAD_BYTES else head)
    return any(letter.isdigit() for letter in text) and all(
        letter.isprintable() or letter in _CONTROLS for letter in text[:-1]
    )


def unpacked(file: Path, most: int) -> bytes:
    """Return at most ``most`` + 1 bytes of a file, which is decompressed if it is a gzip file.

    Raises:
        ValueError: The compressed data are damaged.
    """
    with file.open("rb") as stream:
        if stream.read(2) != _GZIP:
            stream.seek(0)
            return stream.read(most + 1)
        stream.seek(0)
        try:
            with gzip.GzipFile(fileobj=stream) as archive:
                return archive.read(most + 1)
        except Exception as error:
            raise ValueError(f"its compressed data are damaged: {error}") from None


class Form(NamedTuple):
    """Form of the numbers in a text.

    Attributes:
        separator: Separator between the numbers; None is white space.
        decimal: Decimal sign.
        thousands: Thousands sign; an empty string if numbers have none.
    """

    separator: str | None
    decimal: str
    thousands: str = ""

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line: the texts between its separators."""
        if self.separator is None:
            return line.split()
        if '"' in line:
            cells = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True), [])
        else:
            cells = line.split(self.separator)
        return [cell.strip() for cell in cells]

    def number(self, cell: str) -> float | None:
        """Return the number in a cell: NaN for a missing sample, None if the text of the cell is no number."""
        cell = cell.strip("\"' ")
        if self.thousands == "\xa0":
            cell = cell.replace(" ", "\xa0")
        if not cell or cell.lower() in _GAPS:
            return math.nan
        if _NUMBERS[self.decimal, self.thousands].fullmatch(cell) is None:
            return None
        if self.thousands:
            cell = cell.replace(self.thousands, "")
        return float(cell.replace(",", ".").upper().replace("D", "E"))

    def row(self, line: str) -> list[float] | None:
        """Return the numbers of a line; None if a cell is no number, or if the only cell is a missing sample."""
        if self.decimal == "." and not self.thousands and '"' not in line and "_" not in line:
            try:
                fast = list(map(float, line.split(self.separator)))
            except ValueError:
                pass
            else:
                # Lines with infinite numbers are not accepted here. The word "inf" means a missing sample, but a number
                # that is too large for float64 also becomes infinite. The slower code below distinguishes them.
                if fast and all(map(math.isfinite, fast)):
                    return fast
        cells = self.cells(line)
        numbers = []
        for cell in cells:
            # In most lines that are no row of numbers, the first cell is no number, so that the loop ends early.
            if (number := self.number(cell)) is None:
                return None
            numbers.append(number)
        return None if not cells or (len(cells) == 1 and self._is_gap(cells[0])) else numbers

    def _is_gap(self, cell: str) -> bool:
        """Whether the text of a cell does not begin with a number, so that it is a word for a missing sample."""
        return _NUMBERS[self.decimal, self.thousands].match(cell) is None


@dataclass
class Block:
    """Block of consecutive rows of a text in which all rows have equally many numbers.

    Attributes:
        header: Lines of text between the previous block and this one.
        values: Numbers, shape (rows, columns).
        parts: Number of rows in each part of the block; blank lines separate the parts.
        line: Line number of the block's first row, from 1.
        is_cut: Whether the next line is a row with more or fewer numbers.
        above: Numbers of the row directly above the block, which has more or fewer numbers than the block's rows; None
            if there is no such row.
        outer: Number of empty columns at the end of each row that are not part of ``values``, 0 or 1. Such a column
            comes from a separator at the end of the line, or from missing samples.
        has_gaps: Whether other cells of the text are empty, too.
        odd_cell: Text of a cell that is no number in a row of numbers, and its line number; None if there is no such
            cell.
    """

    header: list[str]
    values: NDArray[np.float64]
    parts: list[int]
    line: int
    is_cut: bool = False
    above: NDArray[np.float64] | None = None
    outer: int = 0
    has_gaps: bool = False
    odd_cell: tuple[str, int] | None = None


def lines_of(text: str) -> list[str]:
    """Return the lines of a text. Unicode minus signs become hyphens, and "no data" becomes "nan".

    Apostrophes that separate thousands are removed.
    """
    text = _SPACES.sub("\xa0", text.lstrip("\ufeff").rstrip("\x1a\0").replace("\u2212", "-"))
    if "'" in text or "’" in text:
        text = _APOSTROPHE.sub("", text)
    return _LINE_END.split(_NO_DATA.sub("nan", text))


def _sample_of(lines: Sequence[str]) -> list[str]:
    """Return a part of the lines of a text, on which separators and decimal signs are tried."""
    filled = [line for line in lines if line.strip()]
    mean = sum(map(len, filled)) / max(len(filled), 1)
    count = max(min(_SAMPLE_LINES, int(_SAMPLE_CHARACTERS / max(mean, 1.0))), 5)
    return filled[:: max(1, -(-len(filled) // count))]


def form_of(lines: Sequence[str]) -> Form | None:
    """Return the separator and signs that give the most numbers in rows of equal length; None if no row has numbers."""
    sample = _sample_of(lines)
    has_quotes = any('"' in line for line in sample)
    plain = [Form(*pair) for pair in _FORMS]
    best, chosen = _best_form(plain, sample, has_quotes=has_quotes)
    # A thousands sign is tried only if a line has a number with such a sign and is not yet read as a row of numbers.
    if any(_GROUPED.search(line) and (chosen is None or chosen.row(line) is None) for line in sample):
        grouped = [Form(*pair, sign) for pair in _FORMS for sign in _THOUSANDS[pair[1]] if pair[0] or sign != "\xa0"]
        score, form = _best_form(grouped, sample, has_quotes=has_quotes)
        chosen = form if score > best else chosen
    return chosen


def _best_form(forms: Sequence[Form], sample: Sequence[str], *, has_quotes: bool) -> tuple[int, Form | None]:
    """Try several forms of numbers on lines of a text, and return the form that reads the most numbers.

    A form is a separator of cells, a decimal sign and a thousands sign. Only numbers in rows of equal length count. The
    result is the count of numbers that the best form reads, and this form.
    """
    best, chosen = 0, None
    for form in forms:
        counts = dict[int, int]()
        # If a comma separates the cells of a line and is also used in numbers, only quotes around the cells show which
        # commas are separators.
        if form.separator in (form.decimal, form.thousands) and not has_quotes:
            continue
        for line in sample:
            row = form.row(line)
            if row:
                counts[len(row)] = counts.get(len(row), 0) + sum(map(math.isfinite, row))
        if counts and (score := max(counts.values())) > best:
            best, chosen = score, form
    return best, chosen


def decimal_use(lines: Sequence[str], form: Form) -> Literal["none", "all", "some", "certain"]:
    """Return how the numbers of a text use their decimal sign, which may be a thousands sign instead.

    "none": no number has the sign. "all": in all numbers, three digits follow the sign, so that it may separate
    thousands. "some": three digits follow the sign in some numbers, and the other numbers are whole, as usual with
    thousands signs. "certain": the sign is a decimal sign.
    """
    if form.thousands:
        return "certain"
    grouped = re.compile(rf"[-+]?[1-9]\d{{0,2}}{re.escape(form.decimal)}\d{{3}}")
    has_sign = has_whole = False
    for line in _sample_of(lines):
        if (row := form.row(line)) is None or len(row) < 2:
            continue
        for cell in form.cells(line):
            text = cell.strip("\"' ")
            if form.decimal not in text:
                has_whole = has_whole or text.lstrip("+-").isdigit()
            elif grouped.fullmatch(text) is None:
                return "certain"
            else:
                has_sign = True
    return "none" if not has_sign else "some" if has_whole else "all"


def blocks_of(lines: Sequence[str], form: Form) -> list[Block]:
    """Return all blocks of rows of numbers in the lines of a text, each with the header lines above it."""
    lines, outer, has_gaps = _without_last_separators(lines, form)
    result: list[Block] = []
    header: list[str] = []
    rows: list[NDArray[np.float64]] = []
    parts: list[int] = []
    first, was_blank = 0, False
    above: NDArray[np.float64] | None = None

    def close(*, is_cut: bool) -> None:
        nonlocal above
        if rows:
            result.append(Block(header.copy(), np.array(rows), parts.copy(), first, is_cut, above, outer, has_gaps))
            above = rows[-1] if is_cut else None
            header.clear()
            rows.clear()
            parts.clear()

    for number, line in enumerate(lines, 1):
        row = form.row(line) if line.strip() else None
        if row is None:
            if line.strip():
                odd = odd_cell(form, line, len(rows[0])) if rows else None
                close(is_cut=False)
                if odd is not None:
                    result[-1].odd_cell = odd, number
                header.append(line)
            was_blank = True
            continue
        if rows and len(row) != len(rows[0]):
            close(is_cut=True)
        if not rows:
            first = number
            parts.append(0)
        elif was_blank:
            parts.append(0)
        parts[-1] += 1
        rows.append(np.array(row))
        was_blank = False
    close(is_cut=False)
    return result


def odd_cell(form: Form, line: str, width: int) -> str | None:
    """Return the first cell that is no number, in a line of ``width`` cells that are mostly numbers; otherwise None."""
    cells = form.cells(line)
    if len(cells) != width or width < 3:
        return None
    odd = [cell for cell in cells if form.number(cell) is None]
    return odd[0] if 2 * len(odd) <= width else None


def _without_last_separators(lines: Sequence[str], form: Form) -> tuple[Sequence[str], int, bool]:
    """Return lines without the separator after the last number, if every row has such a separator.

    The separator may also mean that the last column is empty, because its samples are missing. The second result is the
    number of columns that may be empty: 1 if a separator was removed, otherwise 0. The third result is whether other
    cells of the text are empty, too.
    """
    separator = form.separator
    if separator is None:
        return lines, 0, False
    rows = []
    for line in lines:
        if len(form.row(line) or ()) > 1:
            rows.append(line.strip(" "))
            if not rows[-1].endswith(separator):
                return lines, 0, False
    if not rows:
        return lines, 0, False
    inner = [line[:-1].replace(" ", "") for line in rows]
    has_gaps = any(2 * separator in line or line.startswith(separator) or line.endswith(separator) for line in inner)
    return [line.rstrip(" ").removesuffix(separator) for line in lines], 1, has_gaps


def is_even(values: NDArray[np.float64]) -> bool:
    """Whether the steps between consecutive values are equal, up to rounding, and not zero."""
    steps = np.diff(values)
    return len(steps) > 0 and bool(steps[0] != 0.0 and np.allclose(steps, steps[0], rtol=1e-6, atol=0.0))


def even_steps(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], float] | None:
    """Return the coordinates and the step of an evenly spaced axis on which all values lie; None if no axis fits.

    The values may have been rounded in a text file. Some coordinates of the axis may have no value.
    """
    ordered = np.unique(values)
    extent = float(ordered[-1] - ordered[0])
    if not extent > 0.0:
        return None
    # Positions that should be equal may differ by rounding errors and by noise; they form a group. Gaps between groups
    # are far larger than the differences inside a group.
    gaps = np.diff(ordered)
    for bound, most_width in ((1e-9 * extent, math.inf), (_GROUP_GAP * float(np.max(gaps)), _MOST_NOISE)):
        ends = np.flatnonzero(np.append(gaps > bound, True))
        starts = np.append(0, ends[:-1] + 1)
        axis = _axis_through(0.5 * (ordered[starts] + ordered[ends])) if len(ends) > 1 else None
        if axis is None or float(np.max(ordered[ends] - ordered[starts])) > most_width * axis[1]:
            continue
        if most_width == math.inf:
            return axis
        # A straight line fitted through all coordinates gives a more precise step than the first and the last group of
        # values.
        numbers = np.rint((values - axis[0][0]) / axis[1])
        step, low = (float(number) for number in np.polyfit(numbers, values, 1))
        return low + step * np.arange(len(axis[0]), dtype=np.float64), step
    return None


def _axis_through(centres: NDArray[np.float64]) -> tuple[NDArray[np.float64], float] | None:
    """Return the coordinates and step of an evenly spaced axis that contains the ascending ``centres``, or None."""
    low, high = float(centres[0]), float(centres[-1])
    steps = np.diff(centres)
    for typical in (float(np.median(steps)), float(np.min(steps))):
        count = round((high - low) / typical)
        if not 1 <= count <= 4 * len(centres):
            continue
        # The mean distance of neighbouring coordinates is more precise than a single distance, because positions of
        # points are rounded.
        step = (high - low) / count
        if np.all(np.abs((centres - low) / step - np.round((centres - low) / step)) <= _MOST_ROUNDING):
            return low + step * np.arange(count + 1, dtype=np.float64), step
    return None
