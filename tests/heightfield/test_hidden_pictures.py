"""Hidden pictures: each eye must see its own picture, and dots must have the requested luminances.

Dots are small rectangles of a card. Each dot has a grating that diffracts light towards one of two eyes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

import warpdiff as wd

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

ROWS, COLUMNS, WIDTH = 24, 32, 60.0
CELL = wd.gratings.sinusoidal(1.3, 0.2)
EYES = [(0.0, 55.0, 396.0), (166.0, -30.0, 362.0)]
TO_LIGHT = (0.0, 0.57, 0.82)
Y, X = np.indices((ROWS, COLUMNS))
FIRST = 0.1 + 0.9 * ((Y // 6) % 2)
SECOND = 0.1 + 0.7 * ((X // 8) % 2)


def _luminances(grating_map: wd.GratingMap, eye: tuple[float, float, float]) -> NDArray[np.float32]:
    """Return the luminance of each dot of the card for an eye, by the ray of a pixel near the middle of the dot.

    Dots are small rectangles of the card, each with a grating.
    """
    view = wd.View(eye, (0.0, 0.0, 0.0), fov_y_deg=9.0, width=240, height=180)
    image = wd.shade(
        wd.meshes.card(WIDTH, WIDTH * ROWS / COLUMNS), grating_map, wd.DirectionalLight(TO_LIGHT), view,
        footprint=False, refine=False, tolerance=0.02, ior=np.inf,
    )  # fmt: skip
    frame, side = view.frame(), WIDTH / COLUMNS
    places = np.stack([(X + 0.5 - COLUMNS / 2) * side, (ROWS / 2 - Y - 0.5) * side, 0.0 * X], axis=-1) - frame.origin
    depth = -(places @ frame.back)
    column = ((places @ frame.right) / depth / frame.half_width + 1.0) / 2.0 * view.width
    row = (1.0 - (places @ frame.up) / depth / frame.half_height) / 2.0 * view.height
    return image.xyz[row.astype(int), column.astype(int), 1]


def test_each_eye_sees_its_picture_alone() -> None:
    grating_map = wd.hidden_pictures(FIRST, SECOND, EYES, TO_LIGHT, cell=CELL, width=WIDTH)
    assert grating_map.shape == (ROWS, COLUMNS)
    is_first = (X + Y) % 2 == 0
    maxima = []
    for eye, own, picture, other in ((EYES[0], is_first, FIRST, SECOND), (EYES[1], ~is_first, SECOND, FIRST)):
        seen = _luminances(grating_map, eye)
        assert np.corrcoef(seen[own], picture[own])[0, 1] >= 0.99
        assert abs(np.corrcoef(seen[own], other[own])[0, 1]) <= 0.05
        assert seen[~own].mean() <= 0.02 * seen[own].mean()
        ratios = seen[own] / picture[own]
        # The grating of each dot (small rectangle of the card) is designed for the direction from this dot to the eye.
        # A single direction for the whole card would darken the picture towards the edges.
        assert np.ptp(ratios) < 0.05 * ratios.mean()
        maxima.append(ratios.mean())
    assert maxima[0] == pytest.approx(maxima[1], rel=0.02)


def test_pictures_may_be_grey_images(tmp_path: Path) -> None:
    for name, picture in (("first", FIRST), ("second", SECOND)):
        Image.fromarray(np.round(255.0 * picture).astype(np.uint8)).save(tmp_path / f"{name}.png")
    files = wd.hidden_pictures(tmp_path / "first.png", str(tmp_path / "second.png"), EYES, TO_LIGHT, cell=CELL)
    with pytest.raises(FileNotFoundError, match=r"^second: there is no file '.*missing\.png'"):
        wd.hidden_pictures(FIRST, tmp_path / "missing.png", EYES, TO_LIGHT, cell=CELL)
    arrays = wd.hidden_pictures(FIRST, SECOND, EYES, TO_LIGHT, cell=CELL)
    np.testing.assert_allclose(files.depth_scale, arrays.depth_scale, atol=5e-3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"second": SECOND[1:]}, r"second must have the shape of first, \(24, 32\), got \(23, 32\): resample"),
        ({"first": 2.0 * FIRST}, "first must lie within 0 to 1, with a value above 0, got 0.2 to 2"),
        ({"first": np.full((4, 4), np.nan)}, "first must be finite"),
        ({"eyes": [(0.0, 0.0, 1.0)]}, "eyes must be two positions"),
        ({"eyes": [(0.0, 0.0, 9.0), (0.0, 0.0, -9.0)]}, "eyes must be two positions .* with z above 0"),
        ({"eyes": [(0.0, 0.0, 9.0), (0.1, 0.0, 9.0)]}, "eyes must be at least 2° apart .* got 0.64°"),
        ({"to_light": (0.0, 1.0, -1.0)}, "to_light must be one direction with z above 0"),
        ({"eyes": [(0.0, -27.8, 40.0), (30.0, 0.0, 40.0)]}, "eyes must be away from the mirror direction of to_light"),
        ({"cell": wd.HeightField(np.zeros((1, 8)), 0.2)}, "cell must have heights that differ"),
        ({"eyes": [(0.0, 0.0, 1e-12), (5.0, 1.0, 6.0)]}, "eyes must be visible from all dots, .* raise the eyes"),
        ({"eyes": [(0.0, 0.0, 8.0), (1e300, 0.0, 1e300)]}, r"eyes must be two positions .* within ±1e\+15"),
        ({"to_light": (1.0, 0.0, 1e-9)}, "to_light must be one direction with z above 0, and at least 1e-06"),
        ({"cell": wd.gratings.sinusoidal(1.2, 1e-4)}, "cell must have a height range .* deepen the cell"),
        ({"cell": wd.HeightField.of_known_scale(CELL.heights_um, 1e-7)}, "cell must have a period .* of about 0.806"),
        ({"wavelength_nm": 1000.0}, "wavelength_nm must be .* at most 780"),
    ],
)
def test_bad_arguments_have_one_clear_error(changes: dict[str, Any], message: str) -> None:
    arguments = {"first": FIRST, "second": SECOND, "eyes": EYES, "to_light": TO_LIGHT, "cell": CELL} | changes
    with pytest.raises(ValueError, match=message):
        wd.hidden_pictures(**arguments)
