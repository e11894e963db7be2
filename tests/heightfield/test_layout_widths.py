"""Widths in GDS layouts: two methods of measurement agree, large layouts are fast, and cell references are checked."""

import time

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.heightfield.writers import layout_widths

gdstk = pytest.importorskip("gdstk", reason="gdstk is not installed")


def saved(path, *polygons, references=(), others=()):
    """Write a GDS layout of polygons, whose top cell is named TOP, and return the path of the file."""
    library = gdstk.Library()
    top = library.new_cell("TOP")
    top.add(*polygons, *references)
    library.add(*others)
    library.write_gds(str(path))
    return path


def random_polygon(rng):
    """Return a rectangle, or a polygon that may cross itself, within a small square."""
    if rng.random() < 0.5:
        low, size = rng.integers(0, 12, 2), rng.integers(1, 6, 2)
        return gdstk.rectangle(tuple(low.astype(float)), tuple((low + size).astype(float)))
    x, y = rng.integers(0, 14, (2, 4)).astype(float)
    return gdstk.Polygon([point for k in range(4) for point in ((x[k], y[k]), (x[(k + 1) % 4], y[k]))])


def reference(polygons):
    """Return covered area, least widths and number of touching corners of polygons, from a grid of 1 µm squares."""
    corners = np.concatenate([polygon.points for polygon in polygons])
    origin, shape = corners.min(axis=0), np.ptp(corners, axis=0).astype(int)
    y, x = (np.arange(n) + 0.5 + low for n, low in zip(shape[::-1], origin[::-1], strict=True))
    samples = np.stack(np.meshgrid(x, y), axis=-1)
    mask = np.zeros(samples.shape[:2], dtype=bool)
    for polygon in polygons:
        points = polygon.points
        crossings = np.zeros(mask.shape, dtype=int)
        for (x0, y0), (_, y1) in zip(points, np.roll(points, -1, axis=0), strict=True):
            is_between = (samples[..., 1] > min(y0, y1)) & (samples[..., 1] < max(y0, y1))
            crossings += is_between & (x0 < samples[..., 0])
        mask |= crossings % 2 == 1

    def least(lines):
        runs = []
        for line in lines:
            if line.any() and not line.all():
                turned = np.roll(line, -int(np.flatnonzero(~line)[0]))
                edges = np.flatnonzero(np.diff(np.concatenate([[False], turned, [False]])))
                runs += np.diff(edges)[::2].tolist()
        return min(runs, default=np.nan)

    right, up = np.roll(mask, -1, axis=1), np.roll(mask, -1, axis=0)
    both = np.roll(right, -1, axis=0)
    touching = (mask & both & ~right & ~up) | (~mask & ~both & right & up)
    return [mask.sum(), least(mask), least(~mask), least(mask.T), least(~mask.T), touching.sum()]


@pytest.mark.parametrize("most_cells", [0, layout_widths._MOST_CELLS], ids=["sweep", "grid"])
def test_measures_equal_those_of_samples(most_cells, tmp_path, monkeypatch):
    monkeypatch.setattr(layout_widths, "_MOST_CELLS", most_cells)
    rng = np.random.default_rng(3)
    columns = ["area_um2", "least_width_x_um", "least_gap_x_um", "least_width_y_um", "least_gap_y_um"]
    for _ in range(25):
        polygons = [random_polygon(rng) for _ in range(rng.integers(2, 8))]
        table = wd.measure_layout(saved(tmp_path / "a.gds", *polygons))
        measures = [table[name][0] for name in [*columns, "touching_corners"]]
        np.testing.assert_allclose(measures, reference(polygons))


def test_large_layouts_are_fast(tmp_path):
    rng = np.random.default_rng(0)
    corners = rng.uniform(0.0, 400.0, (2000, 2))
    squares = [gdstk.rectangle(tuple(corner), tuple(corner + 4.0)) for corner in corners]
    begin = time.process_time()
    table = wd.measure_layout(saved(tmp_path / "squares.gds", *squares))
    # A method with a grid line at each coordinate of a corner would need 16 million grid cells and 60 s. The tested
    # method must be faster.
    assert time.process_time() - begin < 10.0
    assert table["polygons"][0] == 2000
    assert table["least_width_x_um"][0] == pytest.approx(4.0)


def test_layers_and_datatypes_have_rows_of_their_own(tmp_path):
    wide, narrow = gdstk.rectangle((0, 0), (4, 4), layer=2), gdstk.rectangle((1, 1), (2, 2), layer=2, datatype=5)
    table = wd.measure_layout(saved(tmp_path / "a.gds", wide, narrow))
    assert table["layer"].tolist() == [2, 2]
    assert table["datatype"].tolist() == [0, 5]
    np.testing.assert_allclose(table["area_um2"], [16.0, 1.0])


def test_references_are_measured(tmp_path):
    part = gdstk.Cell("PART")
    part.add(gdstk.rectangle((0, 0), (1, 1)))
    array = gdstk.Reference(part, (0, 0), columns=5, rows=4, spacing=(3, 2))
    table = wd.measure_layout(saved(tmp_path / "a.gds", references=[array], others=[part]))
    assert table["polygons"][0] == 20
    np.testing.assert_allclose([table["least_gap_x_um"][0], table["least_gap_y_um"][0]], [2.0, 1.0])
    square = gdstk.rectangle((0, 0), (1, 1))
    with pytest.raises(ValueError, match=r"a reference must name a cell of the file, got b'PART'"):
        wd.measure_layout(saved(tmp_path / "b.gds", square, references=[array]))


def test_coordinates_in_metres_are_refused(tmp_path):
    path = saved(tmp_path / "a.gds", gdstk.rectangle((0, 0), (1e6, 1e6)))
    data = path.read_bytes()
    # The record UNITS has the resolution in user units and in metres, as real numbers of base 16.
    at = data.index(b"\x00\x14\x03\x05") + 12
    path.write_bytes(data[:at] + b"\x41\x10" + bytes(6) + data[at + 8 :])
    with pytest.raises(ValueError, match=r"must have coordinates within ±1e\+14 µm: 'a.gds' has others; export"):
        wd.measure_layout(path)
