"""Environments: lobes that share out a picture's power, mirrors under even skies, skies behind pictures."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

import warpdiff as wd
from warpdiff.optics import colorimetry
from warpdiff.scene.environment import lobes_of_environment

WINDOW = wd.Coherence(sigma_um=8.0)
SQUARE = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
UNDER = {"coherence": WINDOW, "tolerance": 1e-1, "ior": math.inf, "refine": False, "pigment": 0.0}


def middles(height):
    """Directions to a picture's pixels, (height, 2 height, 3), and their solid angles."""
    polar = (np.arange(height) + 0.5) / height * math.pi
    azimuth = ((np.arange(2 * height) + 0.5) / height - 1.0) * math.pi
    level = np.sin(polar)[:, None]
    along = [level * np.sin(azimuth), np.cos(polar)[:, None] + 0.0 * azimuth, -level * np.cos(azimuth)]
    edges = np.cos(np.arange(height + 1) / height * math.pi)
    return np.stack(along, axis=-1), (edges[:-1] - edges[1:])[:, None] * math.pi / height


@pytest.fixture(scope="module")
def mirror():
    texture = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    return trimesh.Trimesh(SQUARE, [[0, 1, 2], [0, 2, 3]], visual=texture, process=False)


def seen_at(degrees):
    """A view of a few pixels from an angle to z, towards no axis."""
    angle = math.radians(degrees)
    eye = (4 * math.sin(angle) * 0.6, 4 * math.sin(angle) * 0.8, 4 * math.cos(angle))
    return wd.View.orthographic(eye, (0, 0, 0), up=(0, 1, 0.3), extent_y=0.3, width=4, height=3)


def test_lobes_share_out_the_power_and_are_small_where_it_is_bright():
    along, solid = middles(64)
    radiance = np.where(along[..., 1:2] > 0.0, [0.2, 0.4, 1.0] * (1.0 + along[..., 1:2]), 0.0)
    radiance[12, 40] = 20_000.0
    lobes = lobes_of_environment(wd.Environment(radiance, directions=256), 8.0, 0.1)
    assert 128 < len(lobes) <= 256
    assert len({each.illuminant for each in lobes}) <= 8
    sizes = [np.linalg.norm(each.deviations, axis=1) for each in lobes]
    bright, size = max(zip(lobes, sizes, strict=True), key=lambda each: each[0].power / each[1].prod())
    sun = along[12, 40]
    assert np.asarray(bright.to_light) @ sun > math.cos(math.radians(1.5))
    assert size.max() < 0.02
    assert np.median(np.max(sizes, axis=1)) > 0.05
    # Along an edge lobes are long and low.
    half = wd.Environment(np.repeat(np.where(along[..., 1:2] > 0.0, 1.0, 0.1), 3, axis=2), directions=256)
    beside = [each for each in lobes_of_environment(half, 8.0, 0.1) if abs(each.to_light[1]) < 0.03]
    low = np.array([np.sort(np.linalg.norm(each.deviations, axis=1)) for each in beside])
    assert low[:, 0].max() < 0.03
    assert np.median(low[:, 1] / low[:, 0]) > 3.0
    # Nothing comes from below, but for what the mean of a cell does.
    assert min(each.to_light[1] for each in lobes) > -0.05
    # Of one colour, powers are luminances, so that their first moments are those of the picture.
    grey = np.repeat(radiance @ [[0.2126], [0.7152], [0.0722]], 3, axis=2)
    lobes = lobes_of_environment(wd.Environment(grey, directions=1024), 8.0, 0.1)
    powers = np.array([each.power for each in lobes])
    found = powers @ np.array([each.to_light for each in lobes]) / powers.sum()
    exact = np.sum(grey[..., :1] * solid[..., None] * along, axis=(0, 1)) / np.sum(grey[..., 0] * solid)
    # Lobes meet the means in their middles, and share out the whole power by that.
    assert np.abs(found - exact).max() < 1e-2
    twice = lobes_of_environment(wd.Environment(grey, directions=1024, scale=2.0), 16.0, 0.1)
    assert sum(each.power for each in twice) == pytest.approx(8.0 * powers.sum(), rel=1e-6)


@pytest.mark.parametrize("degrees", [50.0])
def test_a_mirror_under_an_even_sky_is_as_bright_as_the_sky(degrees, mirror):
    flat = wd.HeightField(np.zeros((32, 32)), 0.09)
    colours = {}
    for name, rgb in {"white": (1.0, 1.0, 1.0), "red": (0.8, 0.3, 0.1)}.items():
        sky = wd.Environment(np.tile(rgb, (4, 8, 1)), directions=256 if name == "white" else 16)
        colours[name] = wd.shade(mirror, flat, sky, seen_at(degrees), masking=False, **UNDER).rgb[1, 1]
    # As even as lobes are side by side.
    assert colours["white"][1] == pytest.approx(1.0, abs=0.06)
    gold = wd.Material.metal("Au")
    even = wd.Environment(np.ones((4, 8, 3)), directions=16)
    options = UNDER | {"masking": False, "ior": None}
    shown = [
        wd.shade(mirror, flat, even, seen_at(degrees), **options, material=material).xyz[1, 1]
        for material in (gold, wd.Material([500.0], 1e-3, 100.0))
    ]
    nm = np.arange(380.0, 781.0)
    exact = gold.reflectance(nm, degrees) @ colorimetry.colour_products("D65")
    white = colorimetry.colour_products("D65").sum(axis=0)
    assert shown[0] / shown[1] == pytest.approx(exact / white, abs=0.01)
    # Blue orders are narrower than red ones, so that hue is exact to the lobes' evenness alone.
    assert colours["red"] / colours["red"][0] * 0.8 == pytest.approx([0.8, 0.3, 0.1], abs=0.03)


def test_turning_the_sky_turns_what_a_mirror_sees(mirror):
    flat = wd.HeightField(np.zeros((32, 32)), 0.09)
    view, along = seen_at(40.0), middles(32)[0]
    mirrored = np.array([-view.eye[0], -view.eye[1], view.eye[2]]) / 4.0
    turn = math.radians(70.0)
    before = [
        mirrored[0] * math.cos(turn) - mirrored[2] * math.sin(turn), mirrored[1],
        mirrored[0] * math.sin(turn) + mirrored[2] * math.cos(turn),
    ]  # fmt: skip
    patch = np.repeat((along @ before > math.cos(math.radians(25.0)))[..., None].astype(float), 3, axis=2) + 1e-3
    shown = [
        wd.shade(mirror, flat, wd.Environment(patch, rotation_deg=degrees, directions=32), view, **UNDER).xyz[1, 1, 1]
        for degrees in (0.0, 70.0, -70.0)
    ]
    assert shown[1] > 0.5
    assert max(shown[0], shown[2]) < 0.05


def test_a_sky_is_seen_behind_a_picture(mirror):
    along = middles(32)[0]
    sky = wd.Environment(0.5 + 0.5 * along, scale=2.0)
    view = wd.View((0.3, 0.2, 5.0), (0, 0, 0), fov_y_deg=70, width=12, height=8)
    behind = sky.seen(view)
    frame = view.frame()
    for row, column in ((0, 0), (3, 7), (7, 11)):
        x = frame.half_width * (2.0 * (column + 0.5) / 12 - 1.0)
        y = frame.half_height * (1.0 - 2.0 * (row + 0.5) / 8)
        towards = x * frame.right + y * frame.up - frame.back
        assert behind[row, column] == pytest.approx(1.0 + towards / np.linalg.norm(towards), abs=0.01)
    picture = wd.shade(mirror, wd.HeightField(np.zeros((8, 8)), 0.09), wd.DirectionalLight((0, 0, 1)), view, **UNDER)
    shown = picture.display(display="clip", exposure=0.5, background=behind)
    empty = ~picture.mask
    linear = 0.5 * behind[empty]
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    assert np.abs(shown[empty] - np.clip(encoded, 0.0, 1.0)).max() < 2e-3
    with pytest.raises(ValueError, match=r"background must be a colour .* or radiances of 12 × 8 pixels, got shape"):
        picture.display(background=np.ones((4, 4, 3)))


def test_files_are_read_and_refused(tmp_path, mirror):
    import OpenImageIO as oiio  # noqa: N813

    given = np.random.default_rng(7).random((8, 16, 3)).astype(np.float32)
    spec = oiio.ImageSpec(16, 8, 3, "float")
    for name, pixels in {"sky.exr": given, "dark.exr": 0.0 * given, "nan.exr": given * math.nan}.items():
        output = oiio.ImageOutput.create(str(tmp_path / name))
        output.open(str(tmp_path / name), spec)
        output.write_image(pixels)
        output.close()
    assert np.array_equal(wd.Environment.load(tmp_path / "sky.exr").radiance_rgb, given)
    with pytest.raises(ValueError, match=r"dark\.exr' must hold light somewhere"):
        wd.Environment.load(tmp_path / "dark.exr")
    with pytest.raises(ValueError, match=r"nan\.exr' must be finite"):
        wd.Environment.load(tmp_path / "nan.exr")
    (tmp_path / "text.exr").write_text("no picture")
    with pytest.raises(ValueError, match="cannot be read as an image"):
        wd.Environment.load(tmp_path / "text.exr")
    with pytest.raises(FileNotFoundError, match="path: there is no file"):
        wd.Environment.load(tmp_path / "none.exr")
    sky, flat = wd.Environment(given), wd.HeightField(np.zeros((8, 8)), 0.09)
    for coherence in (wd.Coherence("source"), wd.Coherence("centred")):
        with pytest.raises(ValueError, match=r"light\[0\]: an Environment takes coherence of kind='averaged'"):
            wd.shade(mirror, flat, sky, seen_at(20.0), coherence=coherence)
    with pytest.raises(ValueError, match="an Environment, takes footprints"):
        wd.shade(mirror, flat, sky, seen_at(20.0), footprint=False)


def test_the_tolerance_says_how_many_lobes_stand_for_a_sky(mirror):
    sky, flat = wd.Environment(0.5 + 0.5 * middles(16)[0]), wd.HeightField(np.zeros((8, 8)), 0.09)
    options = UNDER | {"refine": False}
    assert [len(lobes_of_environment(sky, WINDOW.sigma_um, each)) for each in (0.5, 0.25)] == [128, 164]
    assert wd.shade(mirror, flat, sky, seen_at(20.0), **options | {"tolerance": 0.5}).plan.lit_by == 128
    picture = wd.shade(mirror, flat, wd.Environment(sky.radiance_rgb, directions=20), seen_at(20.0), **UNDER)
    assert picture.plan.lit_by == 20
    assert "20 lobes stand for the lights" in str(picture.plan)
