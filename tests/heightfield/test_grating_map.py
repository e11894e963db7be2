"""Grating maps: values of dots from numbers, arrays and images, the reference field, and errors.

A grating map divides a surface into small rectangles (dots). All dots have the same grating, but each dot has its own
rotation, factor of the heights (depth scale) and factor of the lengths (pitch scale).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

import warpdiff as wd

if TYPE_CHECKING:
    from pathlib import Path

CELL = wd.gratings.sinusoidal(1.2, 0.15, samples=16)


def test_values_are_numbers_or_arrays() -> None:
    grating_map = wd.GratingMap(CELL, turn_deg=[[0.0, 30.0], [60.0, 90.0]], depth_scale=0.5)
    assert grating_map.shape == (2, 2)
    assert grating_map.dot(1, 0) == (60.0, 0.5, 1.0)
    assert not grating_map.turn_deg.flags.writeable
    assert wd.GratingMap(CELL).shape == (1, 1)


def test_transforms_are_relative_to_the_largest_scales() -> None:
    grating_map = wd.GratingMap(CELL, turn_deg=[[0.0, 90.0]], depth_scale=[[0.5, 2.0]], pitch_scale=[[0.75, 1.5]])
    np.testing.assert_allclose(grating_map.transforms[0, 0], [0.5, 0.0, 0.25, 1.0], atol=1e-7)
    np.testing.assert_allclose(grating_map.transforms[0, 1], [0.0, 1.0, 1.0, 2.0], atol=1e-7)
    reference = grating_map.reference
    assert reference.height_range_um == pytest.approx(2.0 * CELL.height_range_um)
    assert reference.pitch_um == pytest.approx((1.5 * CELL.pitch_um[0], 1.5 * CELL.pitch_um[1]))
    # All dots (small rectangles of the map) share one table of colours, which is made for the largest pitch scale, 1.5.
    # A source of 1° blurs the diffraction of the dot with the pitch scale 0.75 like a source of 0.5° at the pitch scale
    # 1.5.
    source = wd.Coherence("source", angular_diameter_deg=1.0)
    assert grating_map.table_coherence(source).angular_diameter_deg == pytest.approx(0.5)
    assert grating_map.table_coherence(wd.Coherence()) == wd.Coherence()


def test_a_map_of_turns_alone_uses_the_tables_of_its_cell() -> None:
    assert wd.GratingMap(CELL, turn_deg=[[0.0, 30.0]]).reference is CELL


def test_images_are_linear_between_black_and_white(tmp_path: Path) -> None:
    grey = np.array([[0, 51], [204, 255]], dtype=np.uint8)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    Image.fromarray((grey * np.uint16(257)).astype(np.uint16)).save(tmp_path / "grey16.png")
    for name in ("grey.png", "grey16.png"):
        path = tmp_path / name
        grating_map = wd.GratingMap(CELL, turn_deg=path, depth_scale=str(path), pitch_scale=(path, 1.5, 0.5))
        np.testing.assert_allclose(grating_map.turn_deg, [[0.0, 36.0], [144.0, 180.0]])
        np.testing.assert_allclose(grating_map.depth_scale, [[0.0, 0.2], [0.8, 1.0]])
        np.testing.assert_allclose(grating_map.pitch_scale, [[1.5, 1.3], [0.7, 0.5]])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"turn_deg": [[0.0, np.nan]]}, "turn_deg must be finite, got 1 NaN"),
        ({"turn_deg": [0.0, 1.0]}, r"turn_deg must be one number, or have shape \(rows, columns\).*got shape \(2,\)"),
        ({"turn_deg": np.zeros((0, 3))}, "at least one dot"),
        ({"depth_scale": [[1.0, -0.5]]}, "depth_scale must be at least 0 and at most 1000, got -0.5 at 1 of 2 dots"),
        ({"pitch_scale": [[1.0, 0.0]]}, "pitch_scale must be at least 0.001 and at most 1000, got 0 at 1 of 2 dots"),
        ({"pitch_scale": [[1.0, 5.0]]}, "at most 4 times the smallest one, got 1 to 5: split the map"),
        ({"turn_deg": np.zeros((2, 3)), "depth_scale": np.ones((3, 2))}, r"same shape .*\(2, 3\).*\(3, 2\): resample"),
        ({"pitch_scale": "pitch.png"}, "pitch_scale must state the values of black and white"),
    ],
)
def test_bad_values_have_one_clear_error(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        wd.GratingMap(CELL, **values)


def test_bad_images_have_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="turn_deg: there is no file"):
        wd.GratingMap(CELL, turn_deg=tmp_path / "missing.png")
    with pytest.raises(TypeError, match="must be \\(path, black, white\\)"):
        wd.GratingMap(CELL, turn_deg=("grey.png", 0.0))
    Image.fromarray(np.zeros((2, 2, 3), np.uint8)).save(tmp_path / "colour.png")
    with pytest.raises(ValueError, match=r"turn_deg: .*is a colour image"):
        wd.GratingMap(CELL, turn_deg=tmp_path / "colour.png")


BAD_IMAGES = {
    "folder": (None, "must be an image, got the folder .*: name a file in it"),
    "text": ("no image", "has a format that is not read; save it as a grey image .* or give an array"),
    "colour.png": (np.zeros((2, 2, 3), np.uint8), r"is a colour image \(3 channels\); save it as one grey channel"),
    "deep.tif": (np.zeros((2, 2), np.int32), "must have unsigned integers of 8 or 16 bit, .* got (u?)int32 in"),
    "floats.tif": (np.full((2, 2), 45.0, np.float32), r"must have floats from 0 \(black\) to 1 .*, got 45 to 45"),
}


@pytest.mark.parametrize("name", BAD_IMAGES)
def test_images_have_remedies_for_maps(name: str, tmp_path: Path) -> None:
    """Error messages about images must not propose a file of heights, which grating maps do not accept."""
    content, message = BAD_IMAGES[name]
    path = tmp_path / name
    if content is None:
        path.mkdir()
    elif isinstance(content, str):
        path.write_text(content)
    else:
        Image.fromarray(content).save(path)
    picture = np.ones((2, 2))
    light, cell = (0.0, 0.6, 0.8), wd.gratings.sinusoidal(1.3, 0.2)
    calls = {
        "turn_deg": lambda: wd.GratingMap(CELL, turn_deg=path),
        "first": lambda: wd.hidden_pictures(path, picture, [(0, 0, 8), (5, 1, 6)], light, cell=cell),
    }
    for argument, call in calls.items():
        with pytest.raises(ValueError, match=f"{argument}.*{message}") as error:
            call()
        assert not any(text in str(error.value) for text in ("heights", ".npz", ".x3p"))


def test_pitches_of_dots_are_checked() -> None:
    fine = wd.HeightField.of_known_scale(CELL.heights_um, 1e-14)
    with pytest.raises(ValueError, match=r"pitch_scale must make a pitch of 1e-15 to 1e\+15 µm, got 0.01 to 0.01"):
        wd.GratingMap(fine, pitch_scale=0.01)


def test_the_cell_must_be_a_periodic_height_field() -> None:
    x = 0.05 * np.arange(100)
    with pytest.raises(ValueError, match="cell must be periodic, but its opposite edges differ along x"):
        wd.GratingMap(wd.HeightField(0.01 * x[None, :] ** 2, 0.05))
    with pytest.raises(TypeError, match=r"cell must be a warpdiff\.HeightField, got str"):
        wd.GratingMap("sine")  # type: ignore[arg-type]
    gap = np.array(CELL.heights_um)
    gap[0, 3] = np.nan
    with pytest.raises(ValueError, match="cell must have all samples, but 1 of 16 are missing"):
        wd.GratingMap(wd.HeightField(gap, CELL.pitch_um))


@pytest.mark.parametrize("cell", [wd.gratings.blazed(2.0, 0.25), wd.gratings.lamellar(2.0, 0.2)])
def test_gratings_with_walls_are_periodic(cell: wd.HeightField) -> None:
    wd.GratingMap(cell)


def test_maps_are_saved_as_tables_of_dots_and_loaded(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    values = {"turn_deg": rng.uniform(0.0, 90.0, (3, 4)), "depth_scale": rng.uniform(0.0, 1.0, (3, 4))}
    grating_map = wd.GratingMap(CELL, pitch_scale=1.25, **values)
    path = grating_map.save(tmp_path / "dots.csv")
    heading, *lines = path.read_text(encoding="utf-8").splitlines()
    assert heading == "row,column,turn_deg,depth_scale,pitch_scale"
    assert len(lines) == 12
    # The order of the lines in the CSV file of a grating map has no effect.
    path.write_text("\n".join([heading, *rng.permutation(lines)]), encoding="utf-8")
    loaded = wd.GratingMap.load(path, CELL)
    for name in ("turn_deg", "depth_scale", "pitch_scale"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(grating_map, name))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("row,column\n0,0\n", "at least one of turn_deg, depth_scale, pitch_scale, got row, column"),
        ("turn_deg\n30\n", "must have the columns row, column"),
        ("row,column,turn_deg\n0,0,1\n1,1,2\n", "got 2 lines for 2 × 2 dots: add the missing"),
        ("row,column,turn_deg\n0,0,1\n0,1,2\n0,1,3\n1,1,4\n", "got 4 lines for 2 × 2 dots"),
        ("row,column,turn_deg\n0.5,0,1\n", "whole numbers from 0 as row and column"),
        ("row,column,turn_deg\n-1,0,1\n0,0,1\n", "whole numbers from 0 as row and column"),
        ("row,column,turn_deg\n1e308,0,1\n", "below the number of lines, 1"),
        ("row,column,pitch_scale\n0,0,-1\n", "pitch_scale must be"),
    ],
)
def test_tables_that_do_not_have_each_dot_once_are_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "dots.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        wd.GratingMap.load(tmp_path / "dots.csv", CELL)
