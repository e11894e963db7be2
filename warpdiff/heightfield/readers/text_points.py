"""Points x, y, z in text exports: heights on an even grid, or the reason why the points are on no such grid."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.heightfield.readers import text_columns, text_facts, text_table
from warpdiff.heightfield.readers.reader_registry import FileContent, refusal
from warpdiff.heightfield.readers.text_columns import Columns
from warpdiff.heightfield.readers.text_table import Form

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from warpdiff.heightfield.readers.text_facts import Facts
    from warpdiff.heightfield.readers.text_table import Block

# Number of the line, counted from 1, in which a text file of Zygo instruments states the size of a pixel.
_ZYGO_LINES = 8
# Points x, y, z count as a grid only if more than this fraction of all positions (x, y) of the grid have a point. The
# points of a hexagonal lattice are on one half of the positions of a rectangular grid, and must not be taken for one.
_MOST_EMPTY = 0.5

# Even grid on which points lie: a pair for x and a pair for y. A pair has the coordinates of all columns (or rows) of
# the grid, and the distance between two of them, in the unit of the text file.
_Grid = tuple[tuple[np.ndarray, float], tuple[np.ndarray, float]]


def zygo_pitch(lines: Sequence[str]) -> float | None:
    """Return the size of a pixel [µm] in a Zygo XYZ file, 0 if the file does not state this size; None for other files.

    The size [m] is the seventh number in the eighth line. The unit of the heights depends on a setting of the program
    that wrote the file, and is not in the file.
    """
    top = lines[:_ZYGO_LINES]
    if not top[0].strip().startswith("Zygo XYZ Data File"):
        return None
    cells = top[-1].split()
    size_m = Form(None, ".").number(cells[6]) if len(top) == _ZYGO_LINES and len(cells) > 6 else None
    return 1e6 * size_m if size_m is not None and 0.0 < size_m < math.inf else 0.0


def of_points(file: Path, block: Block, form: Form, facts: Facts, zygo: float | None) -> FileContent | None:
    """Return the heights of points x, y, z on an even grid; None if a block of numbers does not contain such points.

    If headings name the columns x, y and z, points that are not on an even grid raise an error instead.

    Args:
        file: Path of the file, for error messages.
        block: Block of numbers of the text, one row per point.
        form: Form of the numbers in the text: separator, decimal sign and thousands sign.
        facts: Facts that the header of the text states.
        zygo: Result of :func:`zygo_pitch`.
    """
    width = block.values.shape[1]
    columns = text_columns.columns_of(block.header, form, width)
    is_named = (columns is not None and columns.names_z) or zygo is not None
    unclear = None
    if columns is None:
        if width not in (3, 4) or facts.has_scale:
            return None
        columns = Columns((0, 1, 2), (None, None, None))
        unclear = None if zygo is not None else text_columns.unclear_headings(block.header, form, width)
    x, y, z = (block.values[:, position] for position in columns.positions)
    positions = _grid(file, x, y, is_named=is_named)
    if positions is None:
        return None
    if unclear:
        raise refusal(file, f"has columns {', '.join(map(repr, unclear))}; name them x, y, z, or row, column, z")
    z, notes = text_facts.without_codes(file, z, facts)
    (at_x, dx), (at_y, dy) = positions
    column, row = np.rint((x - at_x[0]) / dx).astype(np.int64), np.rint((y - at_y[0]) / dy).astype(np.int64)
    heights = np.full((len(at_y), len(at_x)), np.nan)
    heights[row, column] = z
    # In a picture, row 0 has the largest y. In Zygo files, and under headings that name row numbers, y is counted from
    # the top of the picture, so that the rows keep their order.
    heights = heights if zygo is not None or columns.counts_rows else heights[::-1]
    unit_x, unit_y, unit_z = columns.units
    if unit_x is None and unit_y is None:
        unit_x = unit_y = facts.lateral or facts.global_unit
    unit_z, why_no_unit = _unit_z(unit_z, facts)
    if unit_z is None:
        text_facts.require_length(file, facts)
    pitch, own, why_no_pitch = None, None, facts.unclear_size
    if zygo is not None:
        pitch = (zygo * dy, zygo * dx) if zygo else None
    elif unit_x is not None and unit_y is not None:
        pitch = unit_y * dy, unit_x * dx
    elif facts.has_scale and dx == dy == 1.0:
        # If the positions of points have a step of 1 and no unit, they are indices of samples. The pitch then comes
        # from the header.
        pitch, why_no_pitch = text_facts.pitch_of(facts, *heights.shape[::-1])
    else:
        own = dy, dx
    return FileContent(
        heights if unit_z is None else unit_z * heights, pitch, rows="up", has_unit=unit_z is not None,
        pitch_in_unit=own, metadata=facts.metadata, notes=notes, why_no_pitch=why_no_pitch, why_no_unit=why_no_unit,
    )  # fmt: skip


def _unit_z(heading: float | None, facts: Facts) -> tuple[float | None, str]:
    """Return the unit of heights [µm] from the column's heading or the header, and the reason if there is none."""
    others = [line for unit, line in facts.units.items() if unit != heading]
    # The header may state one unit for all columns, and the heading of the column of heights another unit. The unit in
    # the heading then counts, and the two units do not contradict each other.
    if heading is None or (facts.global_unit is not None and len(facts.units) <= 2):
        return heading or facts.unit, facts.why_no_unit
    return (None, f"{others[0]} contradicts the heading of the heights") if others else (heading, "")


def _grid(file: Path, x: np.ndarray, y: np.ndarray, *, is_named: bool) -> _Grid | None:
    """Return the even grid on which points lie, or None if there is no such grid.

    If headings name the columns (``is_named``), points on no grid raise an error instead.
    """
    grid = _grid_or_reason(x, y)
    if not isinstance(grid, str):
        return grid
    if is_named:
        raise refusal(file, f"has points x, y, z {grid}; interpolate them to an even grid first")
    return None


def _grid_or_reason(x: np.ndarray, y: np.ndarray) -> _Grid | str:
    """Return the even grid on which points lie, or the reason why there is no such grid, for an error message."""
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        return "without a position"
    along_x, along_y = text_table.even_steps(x), text_table.even_steps(y)
    if along_x is None or along_y is None:
        return "on no even grid"
    nx, ny = len(along_x[0]), len(along_y[0])
    # Two or three rows of a matrix with three columns could be read as points on a diagonal of a grid. The number of
    # points must therefore exceed the number of columns of the grid, and its number of rows.
    if len(x) < 4 or len(x) <= max(nx, ny) or len(x) <= _MOST_EMPTY * nx * ny:
        return f"at {len(x)} of the {nx} × {ny} positions of a grid"
    nodes = np.rint((y - along_y[0][0]) / along_y[1]) * nx + np.rint((x - along_x[0][0]) / along_x[1])
    return "at equal positions" if len(np.unique(nodes)) < len(nodes) else (along_x, along_y)
