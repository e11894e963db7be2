"""Reader of heights in text: matrices and points x, y, z on a grid, as programs of instruments export them.

One procedure reads the exports of all programs. It finds the separator and the decimal sign by trying which ones give
the most numbers. It takes units from the header and never guesses them.
"""

from __future__ import annotations

import functools
import math
import re
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import memory
from warpdiff.heightfield.readers import text_header, text_table
from warpdiff.heightfield.readers.reader_registry import FileContent, refusal, register_reader
from warpdiff.heightfield.readers.text_table import Form

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from warpdiff.heightfield.readers.reader_registry import Channels
    from warpdiff.heightfield.readers.text_header import Columns, Facts
    from warpdiff.heightfield.readers.text_table import Block

# Measured peak memory while a text is read, per byte of a text with numbers of one digit. If doubled, texts that fit
# into memory are refused.
_BYTES_PER_LETTER = 18.0
# Largest number of rows for which three columns of numbers, without a header, are read as a matrix. With more rows,
# they are probably points or a list and not a scan that is three samples wide.
_MOST_NARROW_ROWS = 9
# Largest ratio of the pitches along x and y that is accepted from a header. A larger one suggests that the header
# states the range of the heights and not a size. If doubled, more such ranges are mistaken for sizes.
_MOST_ASPECT = 50.0
# Largest relative difference between the size that a header states and its number of samples times its pitch. If
# doubled, more contradictions are accepted.
_MOST_DIFFERENCE = 0.01
# Number of the line, counted from 1, in which a Zygo XYZ file states the size of a pixel.
_ZYGO_LINES = 8
# Smallest share of the positions of a grid at which a file of points x, y, z must have points.
_LEAST_FILLED = 0.5
# Least number of equally spaced numbers in the first row or column that count as positions or indices instead of
# heights. If halved, more small matrices of heights are refused.
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
    lines = text_table.lines_of(text_table.decode(data))
    form = text_table.form_of(lines)
    if form is None:
        raise refusal(file, "has no rows of numbers; give a text of heights, an image, .npy, .npz or .x3p")
    blocks = text_table.blocks_of(lines, form)
    same = _equal_blocks(file, blocks)
    facts = [_facts_of(block, form, blocks[0].header) for block in same]
    # Matrices whose unit is a length come first, because the first channel is the default.
    order = sorted(range(len(same)), key=lambda k: bool(facts[k].not_length) and facts[k].unit is None)
    channels: dict[str, Callable[[], FileContent]] = {}
    for k in order:
        read = functools.partial(_content, file, same[k], form, facts[k], _zygo_pitch(lines[:_ZYGO_LINES]))
        name = facts[k].channel or (_title(same[k].header) if len(same) > 1 else "")
        if not name and len(same) == 1:
            return read()
        if not name:
            raise refusal(file, f"has {len(same)} matrices without names; keep one of them")
        channels[name if name not in channels else f"{name} ({k + 1})"] = read
    return channels


def _equal_blocks(file: Path, blocks: list[Block]) -> list[Block]:
    """Return the largest block of numbers and all other blocks of the same shape, which are channels of the file.

    The file is refused if other blocks have as many columns but another number of rows.
    """
    largest = max(blocks, key=lambda block: block.values.size)
    shape = largest.values.shape
    if min(shape) < 2:
        return [largest]
    same = [block for block in blocks if block.values.shape[1] == shape[1]]
    # A block of a single row before the first matrix belongs to the header.
    while len(same[0].values) == 1:
        del same[0]
    if any(block.values.shape != shape for block in same):
        raise refusal(file, f"has text between its rows of numbers, before line {same[1].line}; remove it")
    return same


def _facts_of(block: Block, form: Form, first_header: list[str]) -> Facts:
    """Return the facts of a block's header. If it states no size or pitch, those of the file's first header apply."""
    facts = text_header.facts_of(block.header, form)
    if not facts.has_scale and first_header is not block.header:
        first = text_header.facts_of(first_header, form)
        for name in ("size_x", "size_y", "size_of_both", "pitch_x", "pitch_y"):
            setattr(facts, name, getattr(first, name))
        if not facts.units and not facts.not_length:
            facts.units |= first.units
    return facts


def _title(header: list[str]) -> str:
    """Return the last header line before a matrix if it is a title of one to four words, else an empty string."""
    text = header[-1].strip().strip('#%"[]:;, \t') if header else ""
    return text if re.fullmatch(r"[^\W\d_]+(?: [^\W\d_]+){0,3}", text) else ""


def _content(file: Path, block: Block, form: Form, facts: Facts, zygo: float | None) -> FileContent:
    """Return the heights of a block of numbers, which is a matrix or a list of points x, y, z."""
    _check_block(file, block, form)
    values = block.values
    columns = text_header.columns_of(block.header, form, values.shape[1])
    if columns is None and values.shape[1] in (3, 4) and not facts.has_scale:
        columns = text_header.Columns((0, 1, 2), (None, None, None))
        is_named = zygo is not None
    else:
        is_named = columns is not None
    if columns is not None and (points := _of_points(file, values, columns, facts, zygo, is_named=is_named)):
        return points
    if len(block.parts) > 1 and max(block.parts) > 1:
        raise refusal(
            file, f"has {len(block.parts)} blocks of numbers with blank lines between; keep one, or remove the lines"
        )
    return _of_matrix(file, block, form, facts)


def _check_block(file: Path, block: Block, form: Form) -> None:
    """Raise an error if a row of a block has text among its numbers, or more or fewer numbers than the others."""
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
    values = _with_outer_columns(file, values, block.outer, facts.count_x)
    ny, nx = values.shape
    for count, actual, name in ((facts.count_x, nx, "columns"), (facts.count_y, ny, "rows")):
        if count is not None and count != actual:
            raise refusal(file, f"has {actual} {name}, and its header states {count}; export it again")
    if facts.not_length and facts.unit is None:
        raise refusal(file, f"has values in {facts.not_length[:20]!r}, which is no unit of length; export the heights")
    if facts.factor_key:
        raise refusal(
            file, f"states a factor of its heights, {facts.factor_key[:20]!r}, which is not applied; export the heights"
        )
    is_wsxm = any("WSxM" in line for line in block.header)
    # The program WSxM writes each row from the largest x to the smallest, and rows from the smallest y to the largest.
    # Both axes are reversed here.
    samples = values[::-1, ::-1] if is_wsxm else values
    pitch = _pitch_of(facts, nx, ny)
    unit = facts.unit
    return FileContent(
        np.ascontiguousarray(samples if unit is None else unit * samples), pitch,
        rows="down" if (pitch, label_pitch, unit) == (None, None, None) else "up", has_unit=unit is not None,
        pitch_in_unit=label_pitch if pitch is None else None, metadata=facts.metadata,
    )  # fmt: skip


def _with_outer_columns(file: Path, values: np.ndarray, outer: tuple[int, int], count: int | None) -> np.ndarray:
    """Return a matrix with its empty first or last column if the header counts this column, and without it if not.

    Without a count in the header, the file is refused: an empty column may be a separator or missing samples.
    """
    if not any(outer) or count == values.shape[1]:
        return values
    if count == values.shape[1] + sum(outer):
        return np.pad(values, ((0, 0), outer), constant_values=np.nan)
    raise refusal(
        file, "has an empty first or last column, of separators or of missing samples; write NaN for missing samples"
    )


def _has_headings(block: Block, form: Form) -> bool:
    """Whether the line above the numbers has headings: a word for each column, or for each but the first."""
    words = [cell for cell in (form.cells(block.header[-1]) if block.header else []) if cell]
    is_key = not block.header or text_header.is_statement(block.header[-1])
    width = block.values.shape[1]
    return not is_key and len(words) in (width, width - 1) and all(form.number(word) is None for word in words)


def _pitch_of(facts: Facts, nx: int, ny: int) -> tuple[float, float] | None:
    """Return the pitch (dy, dx) [µm] that a header states."""
    if _contradict(facts.size_x, facts.pitch_x, nx) or _contradict(facts.size_y, facts.pitch_y, ny):
        return None
    dx = facts.pitch_x or (facts.size_x / nx if facts.size_x else None)
    dy = facts.pitch_y or (facts.size_y / ny if facts.size_y else None)
    # A header may state one size without an axis. It is used only if both axes have equally many samples, because it is
    # ambiguous otherwise.
    if facts.size_of_both is not None and nx == ny:
        dx, dy = dx or facts.size_of_both / nx, dy or facts.size_of_both / ny
    # If the pitch along y is more than 50 times the pitch along x, or less than 1/50 of it, the "height" in the header
    # is probably the range of the heights and not the size along y.
    is_likely = dx is not None and dy is not None and dx / _MOST_ASPECT <= dy <= dx * _MOST_ASPECT
    return (dy, dx) if is_likely else None  # type: ignore[return-value]


def _contradict(size: float | None, pitch: float | None, count: int) -> bool:
    """Whether a size contradicts a pitch: ``count`` pitches, or one less, do not give the size."""
    if size is None or pitch is None:
        return False
    return not (1.0 - _MOST_DIFFERENCE) * (count - 1) <= size / pitch <= (1.0 + _MOST_DIFFERENCE) * count


def _without_labels(file: Path, block: Block, form: Form) -> tuple[np.ndarray, tuple[float, float] | None]:
    """Return a matrix without its row and column of indices or positions, and the pitch of these positions or None."""
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
    # A first row or column of whole numbers that count from 0 or 1 has indices and not heights, if the other numbers
    # have fractions.
    inner = values[1:, 1:]
    has_fractions = bool(np.any(np.mod(inner[np.isfinite(inner)], 1.0)))
    if _is_counted(first) and (has_headings or (has_fractions and len(values) >= _LEAST_NUMBERED)):
        return values[:, 1:], None
    if _is_counted(values[0]) and has_fractions and len(values[0]) >= _LEAST_NUMBERED:
        return values[1:], None
    # The heights of a tilted plane are also equally spaced, but in every row. The second row is therefore tested, too.
    if min(values.shape) > _LEAST_NUMBERED and _has_even_edges(values) and not text_table.is_even(values[1, 1:]):
        raise refusal(file, "has a first row and a first column of even steps, as positions have; remove them")
    return values, None


def _labels_around(block: Block, form: Form) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return a matrix without its labels, and the labels of its columns and rows; None if the matrix has none.

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
    """Whether values are consecutive whole numbers that begin with 0 or 1."""
    return values[0] in (0.0, 1.0) and np.array_equal(values, values[0] + np.arange(len(values)))


def _has_even_edges(values: np.ndarray) -> bool:
    """Whether the first row and the first column of a matrix are equally spaced numbers; their corner is ignored."""
    return text_table.is_even(values[0, 1:]) and text_table.is_even(values[1:, 0])


def _at_positions(inner: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, tuple[float, float] | None]:
    """Return a matrix with rows from the largest y to the smallest and x ascending, and its pitch (dy, dx).

    If the labels ``x`` and ``y`` are only indices, the matrix is unchanged and the pitch is None.
    """
    if _is_counted(x) and _is_counted(y):
        return inner, None
    dx, dy = x[1] - x[0], y[1] - y[0]
    # In a picture, x increases to the right and y increases upwards. Row 0 is the top.
    return inner[:: -1 if dy > 0.0 else 1, :: 1 if dx > 0.0 else -1], (abs(dy), abs(dx))


def _zygo_pitch(top: list[str]) -> float | None:
    """Return the size of a pixel [µm] in a Zygo XYZ file, 0 if the file does not state it; None for other files.

    The size [m] is the seventh number in the eighth line. The unit of the heights depends on a setting of the program
    that wrote the file, and is not in the file.
    """
    if not top[0].strip().startswith("Zygo XYZ Data File"):
        return None
    cells = top[-1].split()
    size_m = Form(None, ".").number(cells[6]) if len(top) == _ZYGO_LINES and len(cells) > 6 else None
    return 1e6 * size_m if size_m is not None and 0.0 < size_m < math.inf else 0.0


def _of_points(
    file: Path, values: np.ndarray, columns: Columns, facts: Facts, zygo: float | None, *, is_named: bool
) -> FileContent | None:
    """Return the heights of points x, y, z on an even grid; None if the columns do not contain such points.

    If headings name the columns x, y and z (``is_named``), points that are not on an even grid raise an error instead.
    """
    x, y, z = (values[:, position] for position in columns.positions)
    positions = _grid(file, x, y, is_named=is_named)
    if positions is None:
        return None
    (at_x, dx), (at_y, dy) = positions
    column, row = np.rint((x - at_x[0]) / dx).astype(np.int64), np.rint((y - at_y[0]) / dy).astype(np.int64)
    heights = np.full((len(at_y), len(at_x)), np.nan)
    heights[row, column] = z
    # The rows of a picture go from the largest y to the smallest. In Zygo files, y is a row number of the camera, which
    # is 0 at the top.
    heights = heights if zygo is not None else heights[::-1]
    unit_x, unit_y, unit_z = columns.units
    if unit_x is None and unit_y is None:
        unit_x = unit_y = facts.lateral or facts.global_unit
    unit_z = unit_z or facts.unit
    if facts.not_length and unit_z is None:
        raise refusal(file, f"has values in {facts.not_length[:20]!r}, which is no unit of length; export the heights")
    pitch, own = None, None
    if zygo is not None:
        pitch = (zygo * dy, zygo * dx) if zygo else None
    elif unit_x is not None and unit_y is not None:
        pitch = unit_y * dy, unit_x * dx
    elif facts.has_scale and dx == dy == 1.0:
        # Positions with a step of 1 and no unit are indices of the samples, and the header states the size.
        pitch = _pitch_of(facts, *heights.shape[::-1])
    else:
        own = dy, dx
    return FileContent(
        heights if unit_z is None else unit_z * heights, pitch, rows="up", has_unit=unit_z is not None,
        pitch_in_unit=own, metadata=facts.metadata,
    )  # fmt: skip


def _grid(
    file: Path, x: np.ndarray, y: np.ndarray, *, is_named: bool
) -> tuple[tuple[np.ndarray, float], tuple[np.ndarray, float]] | None:
    """Return the positions and the step of an even grid of points, along x and along y; None if there is no grid.

    If headings name the columns (``is_named``), points on no grid raise an error instead.
    """
    reason = _why_no_grid(x, y)
    if reason and is_named:
        raise refusal(file, f"has points x, y, z {reason}; interpolate them to an even grid first")
    along_x, along_y = (None, None) if reason else (text_table.even_steps(x), text_table.even_steps(y))
    return None if along_x is None or along_y is None else (along_x, along_y)


def _why_no_grid(x: np.ndarray, y: np.ndarray) -> str:
    """Return the reason why points are not on an even grid, for an error message; an empty string if they are."""
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        return "without a position"
    along_x, along_y = text_table.even_steps(x), text_table.even_steps(y)
    if along_x is None or along_y is None:
        return "on no even grid"
    nx, ny = len(along_x[0]), len(along_y[0])
    # Two or three rows of a matrix with three columns could be read as points on a diagonal of a grid. Points must
    # therefore fill more than one position per row and column.
    if len(x) < 4 or len(x) <= max(nx, ny) or len(x) < _LEAST_FILLED * nx * ny:
        return f"at {len(x)} of the {nx} × {ny} positions of a grid"
    nodes = np.rint((y - along_y[0][0]) / along_y[1]) * nx + np.rint((x - along_x[0][0]) / along_x[1])
    return "at equal positions" if len(np.unique(nodes)) < len(nodes) else ""
