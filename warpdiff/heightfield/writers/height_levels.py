"""Levels to which the heights of a field are rounded, and the rectangles of equal level that tile the field."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Indices = NDArray[np.int64]

# Largest number of height levels. The value is limited by GDS files: all programs read only the layers 0 to 255.
MOST_LEVELS = 256


class Levels(NamedTuple):
    """Heights of all height levels [µm], increasing, shape (k,), and the index of each sample's level, (ny, nx)."""

    heights_um: Array
    indices: Indices

    @property
    def rounded_um(self) -> Array:
        """Heights of the samples, rounded to the levels [µm], shape (ny, nx)."""
        return np.asarray(self.heights_um[self.indices])


def levels_of(heights_um: Array, levels: object) -> Levels:
    """Round the heights of a field to levels.

    Args:
        heights_um: Heights [µm], shape (ny, nx).
        levels: Number of equally spaced levels from the lowest to the highest height, 2 to 256; or heights of levels
            [µm], increasing; or None, if the heights have at most 256 values, which are the levels.
    """
    if levels is None:
        values = np.unique(heights_um)
        if len(values) > MOST_LEVELS:
            raise ArgumentValueError(
                f"{ref('levels')} must be given for a height field with more than {MOST_LEVELS} different heights, got "
                f"None for {len(values)} heights: state their number"
            )
    elif validation.is_sequence(levels):
        values = validation.finite_array(levels, "levels", ndim=1, most=validation.MOST)
        if not 1 <= len(values) <= MOST_LEVELS or np.any(np.diff(values) <= 0.0):
            raise ArgumentValueError(
                f"{ref('levels')} must be 1 to {MOST_LEVELS} increasing heights, got {len(values)} numbers "
                f"{values.tolist()!s:.60}"
            )
    elif isinstance(levels, (int, np.integer)) and not isinstance(levels, bool):
        count = validation.count(levels, "levels", least=2, most=MOST_LEVELS)
        values = np.linspace(heights_um.min(), heights_um.max(), count)
        values = values if values[-1] > values[0] else values[:1]
    else:
        raise ArgumentTypeError(
            f"{ref('levels')} must be an integer, an array of heights or None, got {validation.described(levels)}"
        )
    above = np.searchsorted((values[:-1] + values[1:]) / 2.0, heights_um, side="right")
    return Levels(values, above.astype(np.int64))


class Rectangles(NamedTuple):
    """Rectangles of equal level that tile a field: index of the level, and edges [samples], each of shape (n,)."""

    level: Indices
    left: Indices
    right: Indices
    bottom: Indices
    top: Indices


def rectangles_of(indices: Indices) -> Rectangles:
    """Return rectangles of equal level that tile a field without overlap.

    A run is a group of neighbouring samples of equal level in one row. Equal runs in consecutive rows are joined, so
    that each rectangle is as high as possible.

    Args:
        indices: Level of each sample, shape (ny, nx).
    """
    ny, nx = indices.shape
    starts = np.ones((ny, nx), dtype=bool)
    starts[:, 1:] = indices[:, 1:] != indices[:, :-1]
    row, left = np.nonzero(starts)
    is_last = np.append(row[1:] != row[:-1], True)
    right = np.where(is_last, nx, np.append(left[1:], nx))
    level = indices[row, left]
    # A run (neighbouring samples of equal level in one row) continues the run of the row below if both have the same
    # ends and the same level. Each run continues at most one other run, so that a rectangle is a chain of runs.
    key = np.full((ny, nx), -1, dtype=np.int64)
    key[row, left] = right * (int(indices.max()) + 1) + level
    continues = np.zeros(len(row), dtype=bool)
    inner = row > 0
    continues[inner] = key[row[inner] - 1, left[inner]] == key[row[inner], left[inner]]
    # The runs (neighbouring samples of equal level in one row) are sorted by left end, level and right end, and then by
    # row, so that the runs that make a rectangle are consecutive.
    order = np.lexsort((row, key[row, left], left))
    begins = ~continues[order]
    first = order[begins]
    ends = np.append(np.flatnonzero(begins)[1:], len(order)) - 1
    return Rectangles(level[first], left[first], right[first], row[first], row[order[ends]] + 1)
