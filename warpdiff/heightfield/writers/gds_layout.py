"""GDS layouts of height fields: one layer per level of height.

The package gdstk (extra ``lithography``) writes and reads the files.
"""

from __future__ import annotations

import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import files, memory, validation
from warpdiff.core.table import Table
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield.writers import gds_records
from warpdiff.heightfield.writers.height_levels import Levels, rectangles_of

if TYPE_CHECKING:
    import os
    from pathlib import Path

    from numpy.typing import NDArray

# Unit of the coordinates in a file [m], and their resolution [m]. Micrometres and nanometres were chosen because
# programs for lithography expect these units.
_UNIT, _PRECISION = 1e-6, 1e-9
# Largest coordinate in a file, in units of the resolution. The value is limited by the format's 32-bit integers.
_MOST_COORDINATE = 2**31 - 1
# Time in the header of each file. A constant was chosen so that equal height fields give identical files.
_TIME = datetime.datetime(2000, 1, 1)
# Number of decimal places to which positions [µm] are rounded before they are compared. The value follows from the
# resolution of 1 nm: rounding to 0.1 nm removes errors of the arithmetic and no real difference.
_DIGITS = 4
# Memory of the measurement [bytes per cell between the coordinates of all vertices]: two sums of 8 bytes, and marks.
_BYTES_PER_CELL = 24.0
# Largest number of these cells that all polygons cover, where cells that overlapping polygons share count for each of
# them. Polygons with more than four vertices require about 10 s for so many cells. If doubled, twice this time.
_MOST_CELLS = 10**9


def _gdstk() -> Any:
    """Return the package gdstk, or raise an error that states how to install it."""
    try:
        import gdstk
    except ImportError:
        raise ImportError("GDS files require the package gdstk: pip install 'warpdiff[lithography]'") from None
    return gdstk


def write_gds(target: Path, levels: Levels, pitch_um: tuple[float, float]) -> None:
    """Write a file with a layer per level: the rectangles of the level, and a label with its height."""
    gdstk = _gdstk()
    (dy, dx), (ny, nx) = pitch_um, levels.indices.shape
    if min(dy, dx) < 1e6 * _PRECISION:
        raise ArgumentValueError(
            f"{ref('path')}: GDS files have a resolution of 1 nm, got a pitch of {1e3 * dy:g} × {1e3 * dx:g} nm (y × "
            f"x): use {ref('resampled()')}"
        )
    if max(ny * dy, nx * dx) > 1e6 * _PRECISION * _MOST_COORDINATE:
        raise ArgumentValueError(
            f"{ref('path')}: GDS files hold at most 2.1 m, got {ny * dy:g} × {nx * dx:g} µm: use {ref('cropped()')}"
        )
    library = gdstk.Library(name="WARPDIFF", unit=_UNIT, precision=_PRECISION)
    cell = library.new_cell("RELIEF")
    tiles = rectangles_of(levels.indices)
    corners = np.stack([tiles.left * dx, tiles.bottom * dy, tiles.right * dx, tiles.top * dy], axis=1).tolist()
    cell.add(
        *(
            gdstk.rectangle((left, bottom), (right, top), layer=layer)
            for layer, (left, bottom, right, top) in zip(tiles.level.tolist(), corners, strict=True)
        )
    )
    cell.add(
        *(
            gdstk.Label(f"height {height:.9g} um", (0.0, 0.0), layer=layer)
            for layer, height in enumerate(levels.heights_um.tolist())
        )
    )
    with files.atomic_write(target, suffix=".gds") as temporary:
        library.write_gds(str(temporary), timestamp=_TIME)


def measure_layout(path: str | os.PathLike[str]) -> Table:
    """Measure the smallest width and the smallest gap of the polygons in each layer of a GDS layout.

    The layout may come from :meth:`warpdiff.HeightField.save` or from another program. The widths are those of the
    union of all polygons of a layer, measured along x and y in the file itself. The layout is repeated periodically, so
    that a feature at an edge continues at the opposite edge. Corners that touch have no width along x and y; the table
    counts them.

    Args:
        path: GDS file with one top cell, whose polygons have horizontal and vertical edges only.

    Returns:
        A row per layer, with its number, the number of polygons, the largest number of vertices of a polygon, the
        covered area [µm²], the least width of a feature and of a gap along x and y [µm], and the number of corners at
        which two features touch. Widths of layers that cover a whole line are NaN.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is not a GDS file or damaged, has several top cells, no polygons, or a sloped edge.
        MemoryError: The layout does not fit into memory.
        ImportError: gdstk is not installed: ``pip install 'warpdiff[lithography]'``.

    Examples:
        >>> import warpdiff as wd
        >>> path = wd.gratings.lamellar(2.0, 0.1, samples=8).save("grating.gds")  # doctest: +SKIP
        >>> print(wd.measure_layout(path))  # doctest: +SKIP
        layer  polygons  most_vertices  area_um2  least_width_x_um  least_gap_x_um  ...
            0         1              4      0.25                 1               1  ...
            1         1              4      0.25                 1               1  ...
    """
    file = validation.path(path, "path")
    gdstk = _gdstk()
    with files.naming_file(file):
        gds_records.check(file)
    try:
        cells = gdstk.read_gds(str(file), unit=_UNIT).top_level()
    except (OSError, RuntimeError, ValueError) as error:
        raise ArgumentValueError(f"{ref('path')}: {file.name!r} is not a GDS file: {error}") from None
    polygons = [part for cell in cells[:1] for part in cell.get_polygons()]
    if len(cells) != 1 or not polygons:
        raise ArgumentValueError(
            f"{ref('path')} must have one top cell with polygons, got {len(cells)} cells in {file.name!r}"
        )
    points = [polygon.points for polygon in polygons]
    corners = np.round(np.concatenate(points), _DIGITS)
    if not np.isfinite(corners).all():
        raise ArgumentValueError(
            f"{ref('path')} must have finite coordinates: {file.name!r} has others; export it again"
        )
    # Coordinates of all vertices, increasing: the cells between them are covered as a whole or not at all.
    (xs, across), (ys, along) = (np.unique(part, return_inverse=True) for part in corners.T)
    sizes = np.array([len(part) for part in points])
    ends = np.cumsum(sizes)
    begins = ends - sizes
    following = np.arange(1, len(corners) + 1)
    following[ends - 1] = begins
    if np.any((across != across[following]) & (along != along[following])):
        raise ArgumentValueError(
            f"{ref('path')} must have horizontal and vertical edges only, got a slope in {file.name!r}"
        )
    memory.require_memory(
        _BYTES_PER_CELL * len(xs) * len(ys), f"{ref('path')}: {file.name!r} of {len(xs)} × {len(ys)} coordinates",
        "take a part of the layout",
    )  # fmt: skip
    layers = np.array([polygon.layer for polygon in polygons])
    bounds = [edge.reduceat(lines, begins) for lines in (across, along) for edge in (np.minimum, np.maximum)]
    cells_filled = int(np.sum((bounds[1] - bounds[0]) * (bounds[3] - bounds[2]), dtype=np.float64))
    if cells_filled > _MOST_CELLS:
        raise ArgumentValueError(
            f"{ref('path')}: the polygons of {file.name!r} must cover at most {_MOST_CELLS:g} cells between the "
            f"coordinates of all vertices, got {cells_filled:g}: take a part of the layout"
        )
    rows: list[tuple[float, ...]] = []
    for layer in np.unique(layers).tolist():
        own = np.flatnonzero(layers == layer)
        mask = np.zeros((len(ys) - 1, len(xs) - 1), dtype=bool)
        for k, left, right, bottom, top in zip(own.tolist(), *(bound[own].tolist() for bound in bounds), strict=True):
            part = slice(begins[k], ends[k])
            _fill(mask[bottom:top, left:right], across[part] - left, along[part] - bottom)
        areas = np.diff(ys)[:, None] * np.diff(xs)
        widths = [_least_run(part, np.diff(edges)) for part, edges in _lines(mask, xs, ys)]
        most = int(sizes[own].max())
        rows.append((layer, len(own), most, float(areas[mask].sum()), *widths, _corners(mask)))
    names = (
        "layer", "polygons", "most_vertices", "area_um2", "least_width_x_um", "least_gap_x_um", "least_width_y_um",
        "least_gap_y_um", "touching_corners",
    )  # fmt: skip
    columns = dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))
    return Table(columns)


def _fill(box: NDArray[np.bool_], columns: NDArray[np.int64], rows: NDArray[np.int64]) -> None:
    """Mark the cells of a grid that a polygon covers, by the even-odd rule.

    ``box`` is the part of the grid that contains the polygon. ``columns`` and ``rows`` are the lines between its cells
    on which the vertices of the polygon lie.
    """
    if len(columns) == 4:
        box[:] = True
        return
    crossings = np.zeros(box.shape, dtype=np.int64)
    for column, row, after in zip(columns, rows, np.roll(rows, -1), strict=True):
        if row != after and column < box.shape[1]:
            crossings[min(row, after) : max(row, after), column] += 1
    box |= np.cumsum(crossings, axis=1) % 2 == 1


def _lines(
    mask: NDArray[np.bool_], xs: NDArray[np.float64], ys: NDArray[np.float64]
) -> list[tuple[NDArray[np.bool_], NDArray[np.float64]]]:
    """Return the four cases of widths to measure: features along x, gaps along x, features along y, gaps along y.

    Each case is an array whose rows are lines of marked cells, and the coordinates of the edges of these cells.
    """
    return [(mask, xs), (~mask, xs), (mask.T, ys), (~mask.T, ys)]


def _least_run(lines: NDArray[np.bool_], steps: NDArray[np.float64]) -> float:
    """Return the shortest length of consecutive marked cells within periodic lines.

    The result is NaN if every line has only marked or only unmarked cells.

    Args:
        lines: Marked cells, shape (number of lines, n).
        steps: Lengths of the cells along a line, shape (n,).
    """
    least = np.inf
    # `np.unique` of rows would compare their cells one by one, and require minutes for a long array of copies.
    for content in dict.fromkeys(line.tobytes() for line in lines):
        line = np.frombuffer(content, dtype=bool)
        if line.all() or not line.any():
            continue
        # The periodic line is rotated so that it begins directly after a marked cell that an unmarked cell follows.
        # Marked cells at the end of the line then do not continue at its beginning.
        shift = int(np.flatnonzero(line & ~np.roll(line, -1))[0]) + 1
        rolled, lengths = np.roll(line, -shift), np.roll(steps, -shift)
        starts = np.flatnonzero(np.diff(np.concatenate([[False], rolled])))
        least = min(least, float(np.add.reduceat(lengths, starts)[::2].min()))
    return float(least) if np.isfinite(least) else float("nan")


def _corners(mask: NDArray[np.bool_]) -> int:
    """Return the number of corners at which two features touch, in a periodic layout."""
    if 1 in mask.shape:
        return 0
    right, up = np.roll(mask, -1, axis=1), np.roll(mask, -1, axis=0)
    diagonal = np.roll(right, -1, axis=0)
    return int(np.sum((mask & diagonal & ~right & ~up) | (~mask & ~diagonal & right & up)))
