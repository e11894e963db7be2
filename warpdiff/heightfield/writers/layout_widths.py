"""Least widths of features and gaps in lithography layouts of polygons with horizontal and vertical edges.

All coordinates are integers. On a line across the layout, a feature is an interval that polygons cover, and a gap is an
interval between two features. A step is a horizontal edge of the layout: an interval of x at a height y. A small layout
is measured on the grid through the coordinates of its vertices. Over a larger layout a line is swept, and the ends of
features along the line are updated at each edge of the layout.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Indices = NDArray[np.int64]


# Largest number of cells of the grid through the coordinates of a layout's vertices. A layout with more cells is
# measured by a sweep, which is 50 times slower per edge. If doubled, the memory of the grid doubles to 100 MB.
_MOST_CELLS = 2**22


class Steps(NamedTuple):
    """Horizontal edges of the polygons in a layout, each attribute of shape (n,).

    Attributes:
        y: Height of each edge.
        left: End of each edge with the smaller x.
        right: End of each edge with the larger x.
        change: Change of the number of polygons that cover the layout, from below to above each edge.
    """

    y: Indices
    left: Indices
    right: Indices
    change: Indices


class Measures(NamedTuple):
    """Covered area, least widths of features and gaps along x and y, and number of corners at which two features touch.

    A width is None if no feature or gap has an end along the axis.
    """

    area: int
    width_x: int | None
    gap_x: int | None
    width_y: int | None
    gap_y: int | None
    corners: int


class _Widths(NamedTuple):
    """Least width of a feature and of a gap along one axis, and number of corners at which two features touch."""

    feature: int | None
    gap: int | None
    corners: int


def measured(steps: Steps, size: tuple[int, int]) -> Measures:
    """Measure the union of polygons from their steps (horizontal edges); ``size`` has the layout's periods (x, y)."""
    lines = np.unique(np.concatenate([steps.left, steps.right, [0, size[0]]]))
    rows = np.unique(np.append(steps.y, [0, size[1]]))
    if (len(lines) - 1) * (len(rows) - 1) <= _MOST_CELLS:
        return _on_grid(steps, lines, rows)
    union = _united(steps)
    along_x, along_y = _along_x(union, size), _along_y(union, size)
    return Measures(_area(union), *along_x[:2], *along_y[:2], along_x.corners)


def _on_grid(steps: Steps, lines: Indices, rows: Indices) -> Measures:
    """Measure a layout on the grid through its vertices: each cell of the grid is covered as a whole or not at all."""
    counts = np.zeros((len(rows), len(lines)), dtype=np.int32)
    places = np.searchsorted(rows, steps.y)
    np.add.at(counts, (places, np.searchsorted(lines, steps.left)), steps.change)
    np.add.at(counts, (places, np.searchsorted(lines, steps.right)), -steps.change)
    covered = counts.cumsum(axis=0, out=counts).cumsum(axis=1, out=counts)[:-1, :-1] > 0
    # The sums of lengths are Python integers, because areas may exceed the range of int64.
    lengths = (covered * np.diff(lines)).sum(axis=1).tolist()
    area = sum(length * height for length, height in zip(lengths, np.diff(rows).tolist(), strict=True))
    right, up = np.roll(covered, -1, axis=1), np.roll(covered, -1, axis=0)
    diagonal = np.roll(right, -1, axis=0)
    corners = int(np.sum((covered & diagonal & ~right & ~up) | (~covered & ~diagonal & right & up)))
    return Measures(area, *_least_runs(covered, lines), *_least_runs(covered.T, rows), corners)


def _least_runs(covered: NDArray[np.bool_], edges: Indices) -> tuple[int | None, int | None]:
    """Return the least width of a feature (covered cells) and of a gap (uncovered cells) in periodic rows of a grid.

    ``covered`` has shape (rows, n), and ``edges`` has the n + 1 coordinates of the cells along a row.
    """
    row, start = np.nonzero(covered != np.roll(covered, 1, axis=1))
    if not len(row):
        return None, None
    # A run is a group of neighbouring cells that are all covered, or all uncovered. It ends where the next run of its
    # row starts. The last run of a row ends where the first one starts.
    is_last = np.append(row[1:] != row[:-1], True)
    begins = np.append(0, np.flatnonzero(is_last)[:-1] + 1)
    ends = np.append(edges[start[1:]], 0)
    ends[is_last] = edges[start[begins]] + (edges[-1] - edges[0])
    lengths, is_feature = ends - edges[start], covered[row, start]
    return int(lengths[is_feature].min()), int(lengths[~is_feature].min())


def steps_of_rectangles(left: Indices, bottom: Indices, right: Indices, top: Indices) -> Steps:
    """Return the lower and the upper edges of rectangles as steps, which are the horizontal edges of a layout."""
    ones = np.ones(len(left), dtype=np.int64)
    both = [np.concatenate(pair) for pair in ((bottom, top), (left, left), (right, right), (ones, -ones))]
    return Steps(*both)


def steps_of_polygon(x: list[int], y: list[int]) -> list[tuple[int, int, int, int]]:
    """Return the horizontal edges of a polygon as steps (y, left, right, change), by the even-odd rule.

    The change is that of the number of covering polygons from below to above the edge: 1 or −1. Other edges are
    vertical.

    Args:
        x: Coordinates x of the vertices in their order around the polygon, n numbers.
        y: Coordinates y of the vertices.
    """
    edges = sorted(
        (y[k], min(x[k - 1], x[k]), max(x[k - 1], x[k])) for k in range(len(x)) if y[k - 1] == y[k] and x[k - 1] != x[k]
    )
    # Positions x at which a horizontal line enters or leaves the polygon, in increasing order. When the line moves up
    # over an edge, its part between the ends of the edge changes from covered to not covered, or the reverse.
    places: list[int] = []
    steps = []
    for height, left, right in edges:
        begin, end = bisect_right(places, left), bisect_left(places, right)
        change = -1 if begin % 2 else 1
        ends = [left, *places[begin:end], right]
        for k in range(len(ends) - 1):
            steps.append((height, ends[k], ends[k + 1], change))
            change = -change
        for place in (left, right):
            _reverse(places, place)
    return steps


def _united(steps: Steps) -> Steps:
    """Return the steps (horizontal edges) of the union of polygons, from the steps of all polygons."""
    is_wide = steps.left < steps.right
    y, left, right, change = (part[is_wide] for part in steps)
    lines, columns = np.unique(np.concatenate([left, right]), return_inverse=True)
    order = np.lexsort((left, y))
    y, change = y[order], change[order]
    first, after = columns[: len(y)][order], columns[len(y) :][order]
    if not len(y):
        return Steps(y, left, right, change)
    # Steps (horizontal edges) at one height that overlap or touch form a group. A step changes the number of polygons
    # that cover the layout; these changes are added in a group.
    row = np.cumsum(np.append(0, np.diff(y) != 0)) * (len(lines) + 1)
    reach = np.maximum.accumulate(row + after)
    begins = np.flatnonzero(np.append(True, row[1:] + first[1:] > reach[:-1]))
    ends = np.append(begins[1:], len(y))
    # Number of polygons that cover each interval between neighbouring coordinates x, just below the current group of
    # edges.
    counts = np.zeros(len(lines), dtype=np.int32)
    parts: list[tuple[Indices, Indices, Indices, Indices]] = []
    for begin, end, low, high in zip(
        begins.tolist(), ends.tolist(), first[begins].tolist(), (reach - row)[ends - 1].tolist(), strict=True
    ):
        of_group = slice(begin, end)
        jumps = np.zeros(high - low + 1, dtype=np.int32)
        np.add.at(jumps, first[of_group] - low, change[of_group])
        np.add.at(jumps, after[of_group] - low, -change[of_group])
        before = counts[low:high]
        above = before + np.cumsum(jumps[:-1], dtype=np.int32)
        # For each interval of x, the change is 1 if the union of the polygons begins at this y, −1 if it ends there,
        # else 0.
        changes = np.zeros(high - low + 2, dtype=np.int8)
        np.subtract(above > 0, before > 0, out=changes[1:-1], dtype=np.int8)
        counts[low:high] = above
        bounds = np.flatnonzero(changes[1:] != changes[:-1])
        values = changes[bounds[:-1] + 1]
        is_step = values != 0
        parts.append((
            np.full(int(is_step.sum()), y[begin]), lines[low + bounds[:-1][is_step]], lines[low + bounds[1:][is_step]],
            values[is_step].astype(np.int64),
        ))  # fmt: skip
    return Steps(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _area(steps: Steps) -> int:
    """Return the area of a layout, in squared units of the coordinates."""
    total: int = -sum(
        y * width * change
        for y, width, change in zip(
            steps.y.tolist(), (steps.right - steps.left).tolist(), steps.change.tolist(), strict=True
        )
    )
    return total


def _along_x(steps: Steps, size: tuple[int, int]) -> _Widths:
    """Return the least widths of features and gaps along x, in a layout with the periods ``size`` (x, y)."""
    # The steps (horizontal edges) at y = 0 are repeated at the end of the period, so that corners at the edge of the
    # layout are counted.
    again = steps.y == 0
    rows = np.concatenate([steps.y, np.full(int(again.sum()), size[1])])
    left, right = (np.concatenate([part, part[again]]) for part in (steps.left, steps.right))
    return _swept(np.concatenate([rows, rows]), np.concatenate([left, right]), size[0])


def _along_y(steps: Steps, size: tuple[int, int]) -> _Widths:
    """Return the least widths of features and gaps along y, and 0 corners, because `_along_x` counts them."""
    rows = np.concatenate([steps.left, steps.right])
    return _swept(rows, np.concatenate([steps.y, steps.y]), size[1])._replace(corners=0)


def _swept(rows: Indices, places: Indices, period: int) -> _Widths:
    """Sweep a line over a periodic layout, and return the least widths of features and gaps along the line.

    The line crosses edges of the layout. At each edge, some points of the line become ends of features, or cease to be
    ends. Only the features and gaps that begin or end at such a point are measured.

    Args:
        rows: Position of the line at which a point changes, shape (n,).
        places: Coordinate along the line of the point that changes, 0 to ``period``, shape (n,).
        period: Length of the line.
    """
    if not len(rows):
        return _Widths(None, None, 0)
    order = np.lexsort((places, rows))
    rows, places = rows[order], places[order]
    is_new = np.append(True, (np.diff(rows) != 0) | (np.diff(places) != 0))
    starts = np.flatnonzero(is_new)
    is_odd = (np.diff(np.append(starts, len(rows))) % 2 == 1).tolist()
    begins = np.flatnonzero(np.append(True, np.diff(rows[starts]) != 0)).tolist()
    values = places[starts].tolist()
    # The line that is swept over the layout is periodic: its end is also its beginning, the coordinate 0. `base` is 1
    # if a feature reaches the end of the line, otherwise 0.
    base = 0
    line: list[int] = []
    least: list[int | None] = [None, None]
    corners = 0
    for begin, end in zip(begins, [*begins[1:], len(values)], strict=True):
        touched, odd = values[begin:end], is_odd[begin:end]
        reverses = touched[-1] == period and odd[-1]
        if touched[-1] == period:
            # Changes at the end of the swept line, which is periodic, count as changes at its beginning, the coordinate
            # 0.
            both = touched[0] == 0
            is_reversed = odd[-1] != (both and odd[0])
            touched, odd = [0, *touched[int(both) : -1]], [is_reversed, *odd[int(both) : -1]]
        # If a point of the line changes an even number of times, the changes cancel. An end of a feature at this point
        # stays an end, but of another feature if two features touch at a corner.
        kinds = [(place, _kind(line, base, place)) for place, is_end in zip(touched, odd, strict=True) if not is_end]
        for place, is_end in zip(touched, odd, strict=True):
            if is_end:
                _reverse(line, place)
        base ^= reverses
        corners += sum(kind is not None and _kind(line, base, place) == 1 - kind for place, kind in kinds)
        count = len(line)
        if not count:
            continue
        for place in touched:
            k = bisect_left(line, place)
            # Two intervals of the swept line are measured: the one that ends at the point or contains it, and the one
            # that begins there.
            for start in (k - 1, k) if k < count and line[k] == place else (k - 1,):
                after = start + 1
                low = line[start] if start >= 0 else line[-1] - period
                length = (line[after] if after < count else line[0] + period) - low
                is_gap = (base ^ after) & 1 ^ 1
                shortest = least[is_gap]
                if shortest is None or length < shortest:
                    least[is_gap] = length
    return _Widths(least[0], least[1], corners)


def _kind(line: list[int], base: int, place: int) -> int | None:
    """Return 1 if a feature begins at the coordinate ``place`` of a line, 0 if one ends there, else None."""
    k = bisect_left(line, place)
    return (base ^ k) & 1 ^ 1 if k < len(line) and line[k] == place else None


def _reverse(places: list[int], place: int) -> None:
    """Insert a coordinate into an increasing list, or remove it if the list already contains it."""
    k = bisect_left(places, place)
    if k < len(places) and places[k] == place:
        del places[k]
    else:
        places.insert(k, place)
