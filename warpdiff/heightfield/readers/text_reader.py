"""Reader of heights in text: matrices and points x, y, z on a grid, as programs of instruments export them.

One procedure reads the text files of all programs. It tries several separators and decimal signs, and uses the
combination that gives the most numbers. Units come from the header of the file and are never guessed.
"""

from __future__ import annotations

import functools
import math
import re
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import memory
from warpdiff.core.text_encodings import decoded
from warpdiff.heightfield.readers import text_columns, text_facts, text_header, text_points, text_table
from warpdiff.heightfield.readers.reader_registry import FileContent, refusal, register_reader
from warpdiff.heightfield.readers.text_statements import Signs

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from warpdiff.heightfield.readers.reader_registry import Channels
    from warpdiff.heightfield.readers.text_facts import Facts
    from warpdiff.heightfield.readers.text_table import Block, Form

# Measured peak memory while a text file is read [bytes per byte of the file], for a file whose numbers have one digit
# each. If doubled, files that fit into memory are refused.
_BYTES_PER_LETTER = 18.0
# Largest number of rows for which three columns of numbers, without a header, are read as a matrix. If there are more
# rows, the numbers are probably points x, y, z or a list, and not a scan that is three samples wide.
_MOST_NARROW_ROWS = 9
# The first column or row of a matrix may contain indices or positions instead of heights. This is tested only if the
# matrix has about this number of rows or columns, or more. If halved, more small matrices are refused, because their
# heights have equal steps by chance.
_LEAST_NUMBERED = 4


@register_reader(
    ".txt", ".csv", ".tsv", ".asc", ".xyz", ".dat", ".gz", title="text: matrix, or points x, y, z",
    states="sizes and units if its header has them; you state the others", recognises=text_table.is_text,
)  # fmt: skip
def read_text(file: Path) -> FileContent | Channels:
    """Read the heights of a text file: one matrix, several matrices as channels, or points x, y, z on a grid."""
    most = int(min(text_table.MOST_BYTES, memory.available() / _BYTES_PER_LETTER))
    data = text_table.unpacked(file, most)
    if len(data) > most:
        raise refusal(file, f"has more than {most} bytes of text; save it as .npy")
    lines = text_table.lines_of(decoded(data))
    form = text_table.form_of(lines)
    if form is None:
        raise refusal(file, "has no rows of numbers; give a text of heights, an image, .npy, .npz or .x3p")
    if lines[0].startswith("Wyko ASCII"):
        raise refusal(file, "is a Wyko ASCII export, whose lines run along y, without a unit; save it as .opd")
    use = text_table.decimal_use(lines, form)
    # If the header contains a comma, the rows of numbers may not show whether it is a decimal sign. They do not show it
    # if no number has a decimal sign, or if three digits follow the comma in all numbers, so that it may separate
    # thousands.
    is_open = use == "none" or (use == "all" and form.decimal == ",")
    signs = Signs("" if is_open else form.decimal, form.thousands)
    blocks = text_table.blocks_of(lines, form)
    same = _equal_blocks(file, blocks)
    facts = [_facts_of(block, form, signs, blocks[0].header) for block in same]
    _check_signs(file, use, form.decimal, facts[0])
    # A text may have several matrices as channels. The first channel is the default. Matrices whose numbers have a unit
    # other than a length, such as V, therefore come last.
    order = sorted(range(len(same)), key=lambda k: bool(facts[k].not_length) and facts[k].unit is None)
    channels: dict[str, Callable[[], FileContent]] = {}
    for k in order:
        read = functools.partial(_content, file, same[k], form, facts[k], text_points.zygo_pitch(lines))
        name = facts[k].channel or (_title(same[k].header) if len(same) > 1 else "")
        if not name and len(same) == 1:
            return read()
        if not name:
            raise refusal(file, f"has {len(same)} matrices without names; keep one of them")
        channels[name if name not in channels else f"{name} ({k + 1})"] = read
    return channels


def _equal_blocks(file: Path, blocks: list[Block]) -> list[Block]:
    """Return the blocks of numbers that have the shape of the largest block; they are the channels of the file.

    The file is refused if other blocks have as many columns but another number of rows.
    """
    largest = max(blocks, key=lambda block: block.values.size)
    shape = largest.values.shape
    if min(shape) < 2:
        return [largest]
    same = [block for block in blocks if block.values.shape[1] == shape[1]]
    # A single row of numbers before the first matrix belongs to the header of the text.
    while len(same[0].values) == 1:
        del same[0]
    if any(block.values.shape != shape for block in same):
        raise refusal(file, f"has text between its rows of numbers, before line {same[1].line}; remove it")
    return same


def _facts_of(block: Block, form: Form, signs: Signs, first_header: list[str]) -> Facts:
    """Return facts (sizes, units) of the header above a block of numbers; the first header adds what it lacks."""
    facts = text_header.facts_of(block.header, form, signs)
    if first_header is not block.header:
        facts.merge(text_header.facts_of(first_header, form, signs))
    return facts


def _check_signs(file: Path, use: str, sign: str, facts: Facts) -> None:
    """Raise an error if the comma or point in the numbers may be a decimal sign, but may also separate thousands.

    If all numbers have this sign, it is a decimal sign unless a number of the header has the other decimal sign.
    """
    other = "," if sign == "." else "."
    if sign in facts.signs or use in ("none", "certain") or (use == "all" and other not in facts.signs):
        return
    line = f", while its header has {facts.signs[other]}" if other in facts.signs else ""
    raise refusal(
        file, f"has numbers such as 1{sign}234, in which {sign!r} may separate thousands{line}; export them without "
        "thousands signs"
    )  # fmt: skip


def _title(header: list[str]) -> str:
    """Return the last header line before a matrix if it is a title of one to four words, else an empty string."""
    text = header[-1].strip().strip('#%"[]:;, \t') if header else ""
    return text if re.fullmatch(r"[^\W\d_]+(?: [^\W\d_]+){0,3}", text) else ""


def _content(file: Path, block: Block, form: Form, facts: Facts, zygo: float | None) -> FileContent:
    """Return the heights of a block of numbers, which is a matrix or a list of points x, y, z."""
    _check_block(file, block, form)
    if facts.factor_line:
        raise refusal(
            file, f"states a factor of its heights in the line {facts.factor_line}, which is not applied; export the "
            "heights, or delete the line if they contain the factor"
        )  # fmt: skip
    if points := text_points.of_points(file, block, form, facts, zygo):
        return points
    if len(block.parts) > 1 and max(block.parts) > 1:
        raise refusal(
            file, f"has {len(block.parts)} blocks of numbers with blank lines between; keep one, or remove the lines"
        )
    return _of_matrix(file, block, form, facts)


def _check_block(file: Path, block: Block, form: Form) -> None:
    """Raise an error if a row of a block has text among its numbers, or more or fewer numbers than the other rows."""
    width = block.values.shape[1]
    if block.odd_cell:
        cell, line = block.odd_cell
        raise refusal(file, f"has {cell[:20]!r} among the numbers of line {line}; write NaN for a missing sample")
    if block.is_cut and len(block.values) > 1:
        raise refusal(
            file, f"has rows of unequal lengths: line {block.line + len(block.values)} does not have {width} numbers"
        )
    if block.header and width > 2:
        cells = form.cells(block.header[-1])
        odd = [cell for cell in cells if form.number(cell) is None]
        if len(cells) == width and odd and odd != cells[:1] and 2 * len(odd) <= width:
            raise refusal(
                file, f"has {odd[0][:20]!r} among the numbers of its first row; write NaN for a missing sample"
            )


def _of_matrix(file: Path, block: Block, form: Form, facts: Facts) -> FileContent:
    """Return the heights of a block of numbers that is a matrix: one row of numbers per row of samples."""
    rows, width = block.values.shape
    measured = int(np.count_nonzero(np.isfinite(block.values).any(axis=0)))
    if rows < 2 or measured < 3:
        raise refusal(
            file, f"is a profile or a list, with numbers of shape {rows, width}; a matrix or points x, y, z are read"
        )
    if not facts.has_scale and (width == 3 < _MOST_NARROW_ROWS < rows or (width <= 4 and _has_headings(block, form))):
        raise refusal(file, f"has {width} columns, which are neither a matrix nor points x, y, z on an even grid")
    values, label_pitch = _without_labels(file, block, form)
    values = _with_outer_columns(file, values, block, facts)
    ny, nx = values.shape
    for axis, count, line in facts.counts:
        if count != (nx if axis == "x" else ny):
            name = "columns" if axis == "x" else "rows"
            raise refusal(
                file, f"has {nx if axis == 'x' else ny} {name}, and its header states {count} in the line {line}; "
                "export it again"
            )  # fmt: skip
    text_facts.require_length(file, facts)
    values, notes = text_facts.without_codes(file, values, facts)
    is_wsxm = any("WSxM" in line for line in block.header)
    if is_wsxm:
        # The program WSxM writes each row of heights from the largest x to the smallest, and rows from the smallest y
        # to the largest.
        values = values[::-1, ::-1]
        notes = (
            *notes,
            "Loaded: reversed the rows and the columns of the text, because WSxM writes them from the end.",
        )
    pitch, why_no_pitch = text_facts.pitch_of(facts, nx, ny)
    unit = facts.unit
    corner = text_columns.unit_of_corner(form.cells(block.header[-1])[0]) if label_pitch and block.header else None
    if pitch is None and corner is not None and label_pitch is not None:
        pitch, label_pitch = (corner * label_pitch[0], corner * label_pitch[1]), None
    return FileContent(
        np.ascontiguousarray(values if unit is None else unit * values), pitch,
        rows="down" if (pitch, label_pitch, unit) == (None, None, None) else "up", has_unit=unit is not None,
        pitch_in_unit=label_pitch if pitch is None else None, metadata=facts.metadata, notes=notes,
        why_no_pitch=why_no_pitch, why_no_unit=facts.why_no_unit,
    )  # fmt: skip


def _with_outer_columns(file: Path, values: np.ndarray, block: Block, facts: Facts) -> np.ndarray:
    """Return a matrix with its empty first or last column if the column has missing samples, otherwise without it.

    If the header states the number of columns, this number shows whether an empty column belongs to the matrix.
    Otherwise an empty first column has missing samples, and an empty last column comes from separators at the ends of
    the lines. The file is refused if other cells are empty, too, or if the header contradicts the number of columns.
    """
    nx = values.shape[1]
    counts = [count for axis, count, _ in facts.counts if axis == "x"]
    has_empty_first = bool(np.isnan(values[:, 0]).all())
    if nx in counts or not (block.outer or has_empty_first):
        return values
    if block.outer and nx + 1 in counts:
        return np.pad(values, ((0, 0), (0, 1)), constant_values=np.nan)
    if has_empty_first and nx - 1 in counts:
        return values[:, 1:]
    if (block.outer and block.has_gaps) or text_facts.contradict(facts.size_x, facts.pitch_x, nx):
        raise refusal(
            file,
            "has an empty first or last column, of separators or of missing samples; write NaN for missing samples",
        )
    return values


def _has_headings(block: Block, form: Form) -> bool:
    """Whether the line above the numbers has headings: a word for each column, or for each column but the first."""
    words = [cell for cell in (form.cells(block.header[-1]) if block.header else []) if cell]
    is_key = not block.header or text_header.is_statement(block.header[-1])
    width = block.values.shape[1]
    return not is_key and len(words) in (width, width - 1) and all(form.number(word) is None for word in words)


def _without_labels(file: Path, block: Block, form: Form) -> tuple[np.ndarray, tuple[float, float] | None]:
    """Return a matrix without its row and column of indices or positions, and the pitch of the positions or None."""
    values = block.values
    labels = _labels_around(block, form)
    if labels is not None:
        inner, x, y = labels
        if not text_table.is_even(x) or not text_table.is_even(y):
            raise refusal(file, "has a first row or a first column of words or uneven positions; remove them")
        return _at_positions(inner, x, y)
    first, has_headings = values[:, 0], _has_headings(block, form)
    if has_headings and not _is_counted(first) and len(values) > 2 and text_table.is_even(first):
        raise refusal(file, "has a first column of even steps under a heading, as positions have; remove it")
    # If the first row or column has whole numbers that count from 0 or 1, and the other numbers have fractions, the
    # first row or column contains indices and not heights.
    inner = values[1:, 1:]
    has_fractions = bool(np.any(np.mod(inner[np.isfinite(inner)], 1.0)))
    if _is_counted(first) and (has_headings or (has_fractions and len(values) >= _LEAST_NUMBERED)):
        return values[:, 1:], None
    if _is_counted(values[0]) and has_fractions and len(values[0]) >= _LEAST_NUMBERED:
        return values[1:], None
    # Equal steps in the first row may be positions. On a tilted plane, heights also have equal steps, but in every row.
    # The second row is therefore tested, too.
    if min(values.shape) > _LEAST_NUMBERED and _has_even_edges(values) and not text_table.is_even(values[1, 1:]):
        raise refusal(file, "has a first row and a first column of even steps, as positions have; remove them")
    return values, None


def _labels_around(block: Block, form: Form) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return a matrix without its labels, and the labels of its columns and rows; None if there are no labels.

    Labels are indices or positions in the first row and the first column, whose common corner has no number.
    """
    values, width = block.values, block.values.shape[1]
    cells = form.cells(block.header[-1]) if block.header else []
    numbers = [form.number(cell) for cell in cells]
    if len(numbers) == width and numbers[0] is None and None not in numbers[1:]:
        return values[:, 1:], np.array(numbers[1:], dtype=np.float64), values[:, 0]
    if block.above is not None and len(block.above) == width - 1 > 2 and text_table.is_even(block.above):
        return values[:, 1:], block.above, values[:, 0]
    if not math.isnan(values[0, 0]) or min(values.shape) < 3:
        return None
    is_long = min(values.shape) > _LEAST_NUMBERED and _has_even_edges(values)
    if is_long or (_is_counted(values[0, 1:]) and _is_counted(values[1:, 0])):
        return values[1:, 1:], values[0, 1:], values[1:, 0]
    return None


def _is_counted(values: np.ndarray) -> bool:
    """Whether values are consecutive whole numbers that begin with 0 or 1, as indices of rows or columns do."""
    return values[0] in (0.0, 1.0) and np.array_equal(values, values[0] + np.arange(len(values)))


def _has_even_edges(values: np.ndarray) -> bool:
    """Whether the first row and the first column of a matrix, without their common corner, have equal steps."""
    return text_table.is_even(values[0, 1:]) and text_table.is_even(values[1:, 0])


def _at_positions(inner: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, tuple[float, float] | None]:
    """Return a matrix in the order of a picture, by the positions of its columns and rows, and its pitch (dy, dx).

    The first row has the largest y, and x increases along a row. If the positions ``x`` and ``y`` are only indices, the
    matrix is unchanged and the pitch is None.
    """
    if _is_counted(x) and _is_counted(y):
        return inner, None
    dx, dy = x[1] - x[0], y[1] - y[0]
    # In a picture, x increases to the right and y increases upwards. Row 0 is the top.
    return inner[:: -1 if dy > 0.0 else 1, :: 1 if dx > 0.0 else -1], (abs(dy), abs(dx))
