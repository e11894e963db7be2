"""Tables of numbers in text: encoding, separator and decimal sign by counting, and blocks of equal rows."""

from __future__ import annotations

import codecs
import csv
import gzip
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

# Size of a decompressed text above which it is refused [bytes]; 100 million numbers of ten characters. It limits what
# a compressed file may expand to.
MOST_BYTES = 1 << 30
# Sizes of the sample from which separator and decimal sign are counted: lines, and characters in all. If doubled, the
# choice is as good and takes twice as long.
_SAMPLE_LINES, _SAMPLE_CHARACTERS = 400, 200_000
# Number of first bytes that show whether a file is text.
_HEAD_BYTES = 4096
_GZIP = b"\x1f\x8b"
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
)  # fmt: skip
# Words that programs write for a missing sample.
_GAPS = frozenset({
    "nan", "+nan", "-nan", "1.#qnan", "-1.#ind", "nan(ind)", "-nan(ind)", "1.#inf", "-1.#inf", "inf",
    "+inf", "-inf", "infinity", "-infinity", "bad", "-", "--",
    "---", "*", "**", "***", "nodata", "n/a", "#n/a", "na", "null", "none", "missing", "void", "invalid",
    "masked", "undefined",
})  # fmt: skip
_NO_DATA = re.compile(r"(?i)\bno[ _-]?data\b")
_NUMBERS = {
    ".": re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?"),
    # A comma without digits after it separates.
    ",": re.compile(r"[-+]?(?:\d+(?:,\d+)?|,\d+)(?:[eEdD][-+]?\d+)?"),
}
# Separators and decimal signs, preferred in this order if they give equally many numbers. None is white space.
_FORMS: tuple[tuple[str | None, str], ...] = (
    ("\t", "."), (";", "."), (",", "."), (None, "."), ("\t", ","), (";", ","), (",", ","), (None, ","),
)  # fmt: skip
_LINE_END = re.compile(r"\r\n?|\n")


def is_text(file: Path) -> bool:
    """Whether a file begins as a text that contains digits."""
    with file.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    if head.startswith(_GZIP):
        return False
    text = decode(head[: len(head) // 4 * 4] if len(head) == _HEAD_BYTES else head)
    return any(letter.isdigit() for letter in text) and all(
        letter.isprintable() or letter in "\t\r\n\f\ufeff\x1a" for letter in text[:-1]
    )


def unpacked(file: Path, most: int) -> bytes:
    """Return the bytes of a file, decompressed if it is a gzip file, and at most ``most`` + 1 of them.

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


def decode(data: bytes) -> str:
    """Return a text by its byte-order mark or by its content; UTF-8 fails on other encodings."""
    for mark, name in _MARKS:
        if data.startswith(mark):
            return data.decode(name, errors="replace")
    head = data[:400]
    if head.count(0) > len(head) // 4:
        # The zero bytes of Latin letters in UTF-16 are second, or first.
        return data.decode("utf-16-le" if head[1::2].count(0) >= head[::2].count(0) else "utf-16-be", errors="replace")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        # Latin-1 has control characters where Windows has letters.
        return data.decode("cp1252", errors="replace")


class Form(NamedTuple):
    """Separator, or None for white space, and decimal sign."""

    separator: str | None
    decimal: str

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line."""
        if self.separator is None:
            return line.split()
        if '"' in line:
            cells = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True), [])
        else:
            cells = line.split(self.separator)
        return [cell.strip() for cell in cells]

    def number(self, cell: str) -> float | None:
        """Return the number of a cell, NaN for a missing sample; None for another text."""
        cell = cell.strip("\"' ")
        if not cell or cell.lower() in _GAPS:
            return math.nan
        if _NUMBERS[self.decimal].fullmatch(cell) is None:
            return None
        return float(cell.replace(",", ".").upper().replace("D", "E"))

    def row(self, line: str) -> list[float] | None:
        """Return the numbers of a line; None if a cell is no number, or if all are missing and there is one cell."""
        if self.decimal == "." and '"' not in line and "_" not in line:
            try:
                fast = list(map(float, line.split(self.separator)))
            except ValueError:
                pass
            else:
                # An overflow is no missing sample, and "inf" is one.
                if fast and all(map(math.isfinite, fast)):
                    return fast
        cells = self.cells(line)
        numbers = [self.number(cell) for cell in cells]
        if None in numbers or not cells or (len(cells) == 1 and not _NUMBERS[self.decimal].match(cells[0])):
            return None
        return numbers  # type: ignore[return-value]


@dataclass
class Block:
    """Rows of equally many numbers.

    Attributes:
        header: Lines of text before it, from the end of the previous block on.
        values: Numbers, shape (rows, columns).
        parts: Numbers of rows between blank lines.
        line: Number of the line of its first row, from 1.
        is_cut: Whether a row of another length follows directly.
        above: Numbers of the row of another length directly above; None if there is none.
        outer: Numbers of empty columns before and behind, which are separators or missing samples.
        odd_cell: A cell among the numbers that is no number, with its line; None if there is none.
    """

    header: list[str]
    values: NDArray[np.float64]
    parts: list[int]
    line: int
    is_cut: bool = False
    above: NDArray[np.float64] | None = None
    outer: tuple[int, int] = (0, 0)
    odd_cell: tuple[str, int] | None = None


def lines_of(text: str) -> list[str]:
    """Return the lines of a text, with ASCII signs for numbers."""
    text = text.lstrip("\ufeff").rstrip("\x1a\0").replace("\u2212", "-")
    return _LINE_END.split(_NO_DATA.sub("nan", text))


def form_of(lines: Sequence[str]) -> Form | None:
    """Return the separator and decimal sign that give the most numbers in rows of equal length; None if none does."""
    filled = [line for line in lines if line.strip()]
    mean = sum(map(len, filled)) / max(len(filled), 1)
    count = max(min(_SAMPLE_LINES, int(_SAMPLE_CHARACTERS / max(mean, 1.0))), 5)
    sample = filled[:: max(1, -(-len(filled) // count))]
    best, chosen = 0, None
    for separator, decimal in _FORMS:
        form, counts = Form(separator, decimal), dict[int, int]()
        # Only quotes can keep the decimal commas of a cell from its separators.
        if separator == decimal and not any('"' in line for line in sample):
            continue
        for line in sample:
            row = form.row(line)
            if row:
                counts[len(row)] = counts.get(len(row), 0) + sum(map(math.isfinite, row))
        if counts and (score := max(counts.values())) > best:
            best, chosen = score, form
    return chosen


def blocks_of(lines: Sequence[str], form: Form) -> list[Block]:
    """Return the blocks of numbers."""
    lines, outer = _without_outer_separators(lines, form)
    result: list[Block] = []
    header: list[str] = []
    rows: list[NDArray[np.float64]] = []
    parts: list[int] = []
    first, was_blank = 0, False
    above: NDArray[np.float64] | None = None

    def close(*, is_cut: bool) -> None:
        nonlocal above
        if rows:
            result.append(Block(header.copy(), np.array(rows), parts.copy(), first, is_cut, above, outer))
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
    """Return the text among the numbers of a line of as many cells as a row; None if it is another kind of line."""
    cells = form.cells(line)
    if len(cells) != width or width < 3:
        return None
    odd = [cell for cell in cells if form.number(cell) is None]
    return odd[0] if 2 * len(odd) <= width else None


def _without_outer_separators(lines: Sequence[str], form: Form) -> tuple[Sequence[str], tuple[int, int]]:
    """Return lines without the separators that begin, or end, each line of numbers, and how many could be gaps.

    An empty first or last column may also be one of missing samples, if other cells are empty.
    """
    separator = form.separator
    if separator is None:
        return lines, (0, 0)
    rows = [line.strip(" ") for line in lines if len(form.row(line) or ()) > 1]
    begins = bool(rows) and all(line.startswith(separator) for line in rows)
    ends = bool(rows) and all(line.endswith(separator) for line in rows)
    if not begins and not ends:
        return lines, (0, 0)
    inner = [line[begins : len(line) - ends].replace(" ", "") for line in rows]
    has_gaps = any(2 * separator in line or line.startswith(separator) or line.endswith(separator) for line in inner)
    if ends:
        lines = [line.rstrip(" ").removesuffix(separator) for line in lines]
    if begins:
        lines = [line.lstrip(" ").removeprefix(separator) for line in lines]
    return lines, (int(begins and has_gaps), int(ends and has_gaps))


def is_even(values: NDArray[np.float64]) -> bool:
    """Whether at least two numbers have equal steps, up to rounding, that are not zero."""
    steps = np.diff(values)
    return len(steps) > 0 and bool(steps[0] != 0.0 and np.allclose(steps, steps[0], rtol=1e-6, atol=0.0))


def even_steps(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], float] | None:
    """Return the positions of an even lattice that values lie on, and its step; None if they lie on none.

    Positions in text are rounded, and whole rows may be missing.
    """
    low, high = float(np.min(values)), float(np.max(values))
    if not high > low:
        return None
    # Equal positions differ by their rounding.
    distinct = np.unique(np.round((values - low) / (high - low), 9)) * (high - low)
    steps = np.diff(distinct)
    for step in (float(np.median(steps)), float(np.min(steps))):
        count = round((high - low) / step)
        if not 1 <= count <= 4 * len(distinct):
            continue
        step = (high - low) / count  # noqa: PLW2901 (the sum of rounded steps is more precise)
        if np.all(np.abs(distinct / step - np.round(distinct / step)) <= 0.1):
            return low + step * np.arange(count + 1, dtype=np.float64), step
    return None
