"""Files for manufacture: GDS layouts, 16-bit grey images and STL solids, each read back by another program."""

import numpy as np
import pytest
import trimesh
from PIL import Image

import warpdiff as wd
from warpdiff.core import files
from warpdiff.heightfield.writers.height_levels import levels_of, rectangles_of

RNG = np.random.default_rng(5)
# Height field with eight different heights, with islands, holes and single samples, and with a pitch that is no whole
# number of nm.
STEPS = RNG.integers(0, 8, (7, 9)) * 0.0375
STEPS[0, 0], STEPS[-1, -1] = 0.0, 7 * 0.0375
PITCH = (0.2, 0.123456)
RELIEF = wd.HeightField.of_known_scale(STEPS, PITCH)


def layout(path):
    """Return layer and corners (left, bottom, right, top) [µm] of all polygons of a file, read by gdstk."""
    gdstk = pytest.importorskip("gdstk", reason="gdstk is not installed")
    library = gdstk.read_gds(str(path))
    assert library.unit == 1e-6
    polygons = library.top_level()[0].polygons
    boxes = np.array([np.ravel(polygon.bounding_box()) for polygon in polygons])
    layers = np.array([polygon.layer for polygon in polygons])
    assert all(len(polygon.points) == 4 for polygon in polygons)
    heights = {label.layer: float(label.text.split()[1]) for label in library.top_level()[0].labels}
    return layers, boxes, heights


def test_gds_layout_is_the_height_field_again(tmp_path):
    pytest.importorskip("gdstk", reason="gdstk is not installed")
    path = RELIEF.save(tmp_path / "foil.gds")
    layers, boxes, heights = layout(path)
    again = np.full(RELIEF.shape, np.nan)
    for layer, (left, bottom, right, top) in zip(layers, boxes, strict=True):
        edges = np.array([left, right]) / PITCH[1], np.array([bottom, top]) / PITCH[0]
        for axis, pitch in zip(edges, PITCH[::-1], strict=True):
            # Coordinates in GDS files are rounded to 1 nm.
            assert np.abs(axis - np.rint(axis)).max() * pitch <= 0.5e-3 + 1e-9
        (a, b), (c, d) = (np.rint(axis).astype(int) for axis in edges)
        assert np.isnan(again[c:d, a:b]).all()
        again[c:d, a:b] = heights[layer]
    np.testing.assert_allclose(again, STEPS, atol=1e-9)
    assert path.read_bytes() == RELIEF.save(tmp_path / "again.gds").read_bytes()


def test_gds_rounds_to_levels_and_merges_runs(tmp_path):
    pytest.importorskip("gdstk", reason="gdstk is not installed")
    layers, boxes, _ = layout(wd.HeightField([[0.0, 0.1, 0.1, 0.0]] * 3, 0.25).save(tmp_path / "a.gds"))
    assert layers.tolist() == [0, 1, 0]
    np.testing.assert_allclose(boxes[1], [0.25, 0.0, 0.75, 0.75])
    sine = wd.gratings.sinusoidal(2.0, 0.1)
    _, _, heights = layout(sine.save(tmp_path / "b.gds", levels=4))
    np.testing.assert_allclose(sorted(heights.values()), np.linspace(-0.05, 0.05, 4), atol=1e-9)
    _, _, heights = layout(sine.save(tmp_path / "c.gds", levels=[-0.04, 0.0, 0.02]))
    assert sorted(heights.values()) == [-0.04, 0.0, 0.02]


def test_rectangles_tile_any_field():
    for shape, count in (((1, 12), 3), ((12, 1), 3), ((20, 30), 2), ((20, 30), 5), ((6, 6), 1)):
        indices = RNG.integers(0, count, shape)
        tiles = rectangles_of(indices)
        again = np.full(shape, -1)
        for level, left, right, bottom, top in zip(*tiles, strict=True):
            assert np.all(again[bottom:top, left:right] == -1)
            again[bottom:top, left:right] = level
        np.testing.assert_array_equal(again, indices)
    stripes = rectangles_of(np.repeat([[0, 1, 1, 0]], 5, axis=0))
    assert len(stripes.level) == 3


def test_layout_measures_features_in_the_file(tmp_path):
    gdstk = pytest.importorskip("gdstk", reason="gdstk is not installed")
    square = np.zeros((6, 10))
    square[1:3, 2:5] = 0.1
    square[3, 5] = 0.1  # a feature that touches the first one at a corner
    square[0, 0] = square[0, 9] = 0.1  # feature that continues at the opposite edge: 2 samples wide, 1 high
    table = wd.measure_layout(wd.HeightField(square, (0.5, 0.25)).save(tmp_path / "a.gds"))
    row = dict(zip(table.columns, table[1], strict=True))
    assert row["layer"] == 1
    assert row["most_vertices"] == 4
    np.testing.assert_allclose(row["area_um2"], 9 * 0.125)
    # The smallest feature is the single sample that touches a corner. The narrowest gaps are those between the feature
    # of 2 × 3 samples and its own periodic copies.
    np.testing.assert_allclose([row["least_width_x_um"], row["least_gap_x_um"]], [0.25, 1.75])
    np.testing.assert_allclose([row["least_width_y_um"], row["least_gap_y_um"]], [0.5, 2.0])
    assert row["touching_corners"] == 1
    # Other programs write a ring as one polygon with a keyhole: a slit from the outer edge to the hole. The hole must
    # be measured as a gap.
    cell = gdstk.Cell("TOP")
    ring = gdstk.boolean(gdstk.rectangle((0, 0), (3, 3)), gdstk.rectangle((1, 1), (2, 1.5)), "not", layer=7)
    cell.add(*ring)
    library = gdstk.Library()
    library.add(cell)
    library.write_gds(str(tmp_path / "ring.gds"))
    table = wd.measure_layout(tmp_path / "ring.gds")
    np.testing.assert_allclose([table["area_um2"][0], table["least_gap_y_um"][0]], [8.5, 0.5])


def test_grey_image_has_16_bits(tmp_path):
    sine = wd.gratings.sinusoidal(2.0, 0.3)
    path = sine.save(tmp_path / "sine.png")
    with Image.open(path) as image:
        assert image.mode.startswith("I;16")
        assert image.text["height_range_um"] == f"{sine.height_range_um:.17g}"
    again = wd.HeightField.load(path, pitch_um=sine.pitch_um, height_range_um=sine.height_range_um)
    expected = sine.heights_um - sine.heights_um.min()
    assert np.abs(again.heights_um - expected).max() <= 0.5 * sine.height_range_um / 65535 + 1e-12
    rounded = wd.HeightField.load(sine.save(tmp_path / "r.png", levels=4), pitch_um=0.1, height_range_um=0.3)
    np.testing.assert_allclose(np.unique(rounded.heights_um), [0.0, 0.1, 0.2, 0.3], atol=1e-5)
    flat = wd.HeightField(np.full((3, 4), 0.2), 0.1).save(tmp_path / "flat.png")
    with Image.open(flat) as image:
        assert np.asarray(image).max() == 0


def test_dose_follows_the_curve_of_the_resist(tmp_path):
    relief = wd.HeightField([[0.0, -0.1, -0.2, -0.3]], 0.1)
    path = relief.save(tmp_path / "dose.png", dose=[(0.0, 0.1), (0.2, 0.5), (0.4, 0.6)])
    with Image.open(path) as image:
        samples = np.asarray(image, dtype=float)[0] / 65535
    np.testing.assert_allclose(samples, [0.1, 0.3, 0.5, 0.55], atol=1e-5)
    # In float64, the difference of these heights is 0.30000000000000004. This is slightly more than the largest depth
    # of ``dose``, but must not raise an error.
    wd.HeightField([[0.1, 0.4]], 1.0).save(tmp_path / "rounded.png", dose=[(0.0, 0.1), (0.3, 1.0)])


@pytest.mark.parametrize("relief", [RELIEF, wd.gratings.sinusoidal(2.0, 0.1, samples=16)], ids=["steps", "row"])
def test_stl_is_a_closed_solid_with_the_heights(relief, tmp_path):
    solid = trimesh.load(relief.save(tmp_path / "relief.stl"))
    assert solid.is_watertight
    assert solid.is_winding_consistent
    (ny, nx), (dy, dx) = relief.shape, relief.pitch_um
    top = solid.vertices[solid.vertices[:, 2] > relief.heights_um.min() - 1e-6]
    j, i = np.rint(top[:, 1] / dy).astype(int) % ny, np.rint(top[:, 0] / dx).astype(int) % nx
    np.testing.assert_allclose(top[:, 2], relief.heights_um[j, i], atol=1e-6)
    np.testing.assert_allclose(solid.extents[:2], (nx * dx, ny * dy), rtol=1e-6)
    base = relief.heights_um.min() - max(relief.height_range_um, 1.0)
    mean = np.pad(relief.heights_um, ((0, 1), (0, 1)), mode="wrap") - base
    mean = (mean[1:, 1:] + mean[:-1, 1:] + mean[1:, :-1] + mean[:-1, :-1]).mean() / 4.0
    assert solid.volume > 0.0
    # The solid has two triangles per cell of four samples. The mean height of the two triangles differs from the mean
    # of the four samples, by at most a part of the height range.
    np.testing.assert_allclose(solid.volume, mean * nx * dx * ny * dy, rtol=0.3 * relief.height_range_um / mean)


@pytest.mark.parametrize(
    ("name", "options", "error", "message"),
    [
        ("a.gds", {}, ValueError, "levels must be given for a height field with more than 256 different heights"),
        ("a.gds", {"levels": 1}, ValueError, "levels must be an integer, at least 2 and at most 256, got 1"),
        ("a.gds", {"levels": [0.1, 0.1]}, ValueError, "levels must be 1 to 256 increasing heights"),
        ("a.png", {"levels": "8"}, TypeError, "levels must be an integer, an array of heights or None, got str '8'"),
        ("a.stl", {"dose": [(0, 0), (1, 1)]}, ValueError, "dose must not be given for .stl files"),
        ("a.png", {"dose": [(0, 0), (0.01, 1)]}, ValueError, "dose must cover the depths 0 to 1"),
        ("a.png", {"dose": [(1, 0), (0, 1)]}, ValueError, "dose must have increasing depths"),
        ("a.png", {"dose": [(0, 0), (1, 2)]}, ValueError, "dose must have increasing depths and doses within 0 to 1"),
        ("a.png", {"dose": [0, 1]}, ValueError, "dose must be a 2-D array"),
    ],
)
def test_refused_before_a_file_is_made(name, options, error, message, tmp_path):
    many = wd.HeightField(np.linspace(0.0, 1.0, 300)[None], 0.1)
    with pytest.raises(error, match=message):
        many.save(tmp_path / name, **options)
    assert not list(tmp_path.iterdir())
    gaps = wd.HeightField([[0.0, np.nan]], 0.1)
    with pytest.raises(ValueError, match="must have all samples"):
        gaps.save(tmp_path / "b.png")
    assert gaps.save(tmp_path / "b.npz").is_file()


def test_refused_layouts(tmp_path):
    gdstk = pytest.importorskip("gdstk", reason="gdstk is not installed")
    fine = wd.HeightField.of_known_scale([[0.0, 0.1]], 5e-4)
    with pytest.raises(ValueError, match=r"resolution of 1 nm, got a pitch of 0\.5"):
        fine.save(tmp_path / "fine.gds")
    (tmp_path / "no.gds").write_bytes(b"no layout")
    with pytest.raises(ValueError, match=r"'no\.gds' is not a GDS file|must have one top cell"):
        wd.measure_layout(tmp_path / "no.gds")
    with pytest.raises(FileNotFoundError, match="there is no file"):
        wd.measure_layout(tmp_path / "none.gds")
    cell = gdstk.Cell("TOP")
    cell.add(gdstk.Polygon([(0, 0), (1, 0), (0.5, 1)]))
    library = gdstk.Library()
    library.add(cell)
    library.write_gds(str(tmp_path / "slope.gds"))
    with pytest.raises(ValueError, match="must have horizontal and vertical edges only"):
        wd.measure_layout(tmp_path / "slope.gds")


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = RELIEF.save(tmp_path / "a.stl")
    old = path.read_bytes()

    def fail(*_arguments):
        raise OSError("disk full")

    monkeypatch.setattr(files.os, "fsync", fail)
    for name in ("a.stl", "a.png"):
        with pytest.raises(OSError, match="disk full"):
            wd.gratings.bumps().save(tmp_path / name)
    assert path.read_bytes() == old
    assert [file.name for file in tmp_path.iterdir()] == ["a.stl"]


def test_levels_round_to_the_nearest():
    rounded = levels_of(np.array([[0.0, 0.04, 0.06, 0.2]]), 3)
    np.testing.assert_allclose(rounded.heights_um, [0.0, 0.1, 0.2])
    assert rounded.indices.tolist() == [[0, 0, 1, 2]]
