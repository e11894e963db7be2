"""GDS layouts of height fields: one layer per level of height.

The package gdstk (extra ``lithography``) writes and reads the files.
"""

from __future__ import annotations

import datetime
from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import files, validation
from warpdiff.core.table import Table
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield.writers import gds_records
from warpdiff.heightfield.writers.height_levels import Levels, rectangles_of
from warpdiff.heightfield.writers.layout_widths import Steps, measured, steps_of_polygon, steps_of_rectangles

if TYPE_CHECKING:
    import os
    from pathlib import Path
    from types import ModuleType

    from numpy.typing import NDArray

    Points = NDArray[np.int64]

# Unit of the coordinates in a GDS file [m], and their resolution [m]. Micrometres and nanometres were chosen because
# programs for lithography expect these units.
_UNIT, _PRECISION = 1e-6, 1e-9
# Largest coordinate in a file, in units of the resolution (1 nm). The value is limited by the format's 32-bit integers.
_MOST_COORDINATE = 2**31 - 1
# Time in the header of each file. A constant was chosen so that equal height fields give identical files.
_TIME = datetime.datetime(2000, 1, 1)
# To compare positions, they are rounded to this number of steps per µm, that is to 0.1 nm. The resolution of the files
# is 1 nm, so that this removes errors of the arithmetic and no real difference.
_PER_UM = 10_000
# Largest coordinate in a GDS layout whose widths are measured [µm]. The value is limited by the 64-bit integers of the
# measurement, which count steps of 0.1 nm.
_MOST_UM = 1e14


def _gdstk() -> ModuleType:
    """Return the package gdstk, or raise an error that states how to install it."""
    try:
        import gdstk
    except ImportError:
        raise ImportError("GDS files require the package gdstk: pip install 'warpdiff[lithography]'") from None
    module: ModuleType = gdstk
    return module


def write_gds(target: Path, levels: Levels, pitch_um: tuple[float, float]) -> None:
    """Write a GDS file with a layer per height level: the rectangles of the level, and a label with its height."""
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
    union of all polygons with the same layer and datatype, measured along x and y in the file itself. The layout is
    repeated periodically, so that a feature at an edge continues at the opposite edge. The period is the bounding box
    of all polygons of the file: empty space around them is not part of a gap. Corners that touch have no width along x
    and y; the table counts them.

    Args:
        path: GDS file with one top cell, whose polygons have horizontal and vertical edges only.

    Returns:
        Table with a row per layer and datatype: both numbers, the number of polygons, the largest number of vertices of
        a polygon, the covered area [µm²], the least width of a feature and of a gap along x and y [µm], and the number
        of corners at which two features touch. A width is NaN if no feature or gap has an end along this axis.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The file is not a GDS file or damaged, has several top cells, no polygons, a sloped edge, or a
            reference to a cell that it does not contain.
        MemoryError: The polygons of the layout, with all repetitions of its cells, do not fit into memory.
        ImportError: gdstk is not installed: ``pip install 'warpdiff[lithography]'``.

    Examples:
        >>> import warpdiff as wd
        >>> path = wd.gratings.lamellar(2.0, 0.1, samples=8).save("grating.gds")  # doctest: +SKIP
        >>> print(wd.measure_layout(path))  # doctest: +SKIP
        layer  datatype  polygons  most_vertices  area_um2  least_width_x_um  ...
            0         0         1              4      0.25                 1  ...
            1         0         1              4      0.25                 1  ...
    """
    file = validation.path(path, "path")
    gdstk = _gdstk()
    with files.naming_file(file):
        gds_records.check(file)
    try:
        cells = gdstk.read_gds(str(file), unit=_UNIT).top_level()
    except (OSError, RuntimeError, ValueError) as error:
        raise ArgumentValueError(f"{ref('path')}: {file.name!r} is not a GDS file: {error}") from None
    polygons = cells[0].get_polygons() if len(cells) == 1 else []
    if not polygons:
        raise ArgumentValueError(
            f"{ref('path')} must have one top cell with polygons, got {len(cells)} cells in {file.name!r}"
        )
    points = [polygon.points for polygon in polygons]
    lengths = np.array([len(part) for part in points])
    places_um = np.concatenate(points)
    if not (np.abs(places_um) <= _MOST_UM).all():
        raise ArgumentValueError(
            f"{ref('path')} must have coordinates within ±{_MOST_UM:g} µm: {file.name!r} has others; export it again"
        )
    corners = np.rint(_PER_UM * places_um).astype(np.int64)
    corners -= corners.min(axis=0)
    _check_slopes(corners, lengths, file.name)
    width, height = corners.max(axis=0).tolist()
    parts = np.split(corners, np.cumsum(lengths)[:-1])
    by_layer: dict[tuple[int, int], list[Points]] = defaultdict(list)
    for polygon, part in zip(polygons, parts, strict=True):
        by_layer[polygon.layer, polygon.datatype].append(part)
    rows: list[tuple[float, ...]] = []
    for layer, own in sorted(by_layer.items()):
        area, *widths, corner_count = measured(_steps(own), (width, height))
        lengths_um = [np.nan if length is None else length / _PER_UM for length in widths]
        rows.append((*layer, len(own), max(map(len, own)), area / _PER_UM**2, *lengths_um, corner_count))
    names = (
        "layer", "datatype", "polygons", "most_vertices", "area_um2", "least_width_x_um", "least_gap_x_um",
        "least_width_y_um", "least_gap_y_um", "touching_corners",
    )  # fmt: skip
    columns = dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))
    return Table(columns)


def _check_slopes(corners: Points, lengths: NDArray[np.int64], name: str) -> None:
    """Raise an error if an edge of a polygon in a layout is neither horizontal nor vertical.

    ``corners`` are the vertices of all polygons one after the other, ``lengths`` the numbers of vertices of each
    polygon, and ``name`` is that of the file.
    """
    ends = np.cumsum(lengths)
    after = np.arange(1, len(corners) + 1)
    after[ends - 1] = ends - lengths
    if np.any(np.all(corners != corners[after], axis=1)):
        raise ArgumentValueError(f"{ref('path')} must have horizontal and vertical edges only, got a slope in {name!r}")


def _steps(polygons: list[Points]) -> Steps:
    """Return the horizontal edges of polygons as steps, which state on which side of an edge the polygon is."""
    fours = [points for points in polygons if len(points) == 4]
    boxes = np.array(fours, dtype=np.int64).reshape(-1, 4, 2)
    low, high = boxes.min(axis=1), boxes.max(axis=1)
    steps = steps_of_rectangles(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    others = [step for points in polygons if len(points) != 4 for step in steps_of_polygon(*points.T.tolist())]
    if not others:
        return steps
    return Steps(*(np.concatenate(pair) for pair in zip(steps, np.array(others).T, strict=True)))
