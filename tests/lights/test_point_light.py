"""Point lights: direction and brightness per pixel, footprints, and shadow rays that end at the light."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh

import warpdiff as wd
from warpdiff.lights.base import orthonormal_pair

WINDOW = wd.Coherence(sigma_um=8.0)
VIEW = wd.View.orthographic((0.5, 0.4, 4.0), (0, 0, 0), extent_y=1.6, width=24, height=18)
OPTIONS = {"coherence": WINDOW, "tolerance": 3e-2, "pigment": 0.0}


def square(height=0.0, size=1.0):
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * size + [0, 0, height]
    texture = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=texture, process=False)


@pytest.fixture(scope="module")
def fingers():
    return wd.gratings.fingers(size_um=12.8, pitch_um=0.08)


@pytest.mark.parametrize("size", [1.0, 1000.0])
def test_each_pixel_has_a_light_in_its_own_direction(size, fingers):
    body, position = square(size=size), np.array([0.3, -0.2, 0.9]) * size
    view = wd.View.orthographic(
        np.array(VIEW.eye) * size, (0, 0, 0), extent_y=1.6 * size, width=VIEW.width, height=VIEW.height
    )
    points = OPTIONS | {"footprint": False, "plan": wd.plan(fingers, coherence=WINDOW, tolerance=3e-2)}
    result = wd.shade(body, fingers, wd.PointLight(tuple(position), power=size**2), view, **points)
    frame = view.frame()
    across = frame.half_width * (2.0 * (np.arange(view.width) + 0.5) / view.width - 1.0)
    upward = frame.half_height * (1.0 - 2.0 * (np.arange(view.height) + 0.5) / view.height)
    for row, column in ((3, 4), (9, 12), (15, 20)):
        origin = frame.origin + across[column] * frame.right + upward[row] * frame.up
        met = origin - origin[2] / frame.back[2] * frame.back
        away = position - met
        light = wd.DirectionalLight(tuple(away), power=size**2 / float(away @ away))
        expected = wd.shade(body, fingers, light, view, **points).xyz[row, column]
        assert result.xyz[row, column] == pytest.approx(expected, rel=2e-3)


def test_footprints_include_changes_of_the_direction_to_the_light(fingers):
    """Footprints (changes of the scattering vector within a pixel) must include the changing direction to a near light.

    In an orthographic view of a flat square, only the direction to the light changes within a pixel.
    """
    light = wd.PointLight((1.5, -1.0, 2.0))
    exact = wd.shade(square(), fingers, light, VIEW, footprint=False, samples_per_pixel=1024, **OPTIONS)
    mean = wd.shade(square(), fingers, light, VIEW, refine=False, **OPTIONS)
    point = wd.shade(square(), fingers, light, VIEW, footprint=False, **OPTIONS)
    inside = np.s_[4:-4, 4:-4]
    truth = np.linalg.norm(exact.xyz[inside], axis=-1)
    away = [np.linalg.norm((each.xyz - exact.xyz)[inside], axis=-1) / truth for each in (mean, point)]
    assert np.percentile(away[0], 90.0) < 0.03
    assert np.percentile(away[1], 90.0) > 0.3


def test_a_mirror_at_a_distance_of_one_shows_the_power(fingers):
    flat = wd.HeightField(np.zeros((32, 32)), 0.09)
    view = wd.View.orthographic((0, 0, 4), (0, 0, 0), extent_y=0.02, width=3, height=3)
    for distance, luminance in ((1.0, 2.0), (2.0, 0.5)):
        light = wd.PointLight((0.0, 0.0, distance), power=2.0)
        image = wd.shade(square(), flat, light, view, footprint=False, ior=math.inf, **OPTIONS)
        assert image.xyz[1, 1, 1] == pytest.approx(luminance, rel=1e-2)
    # The base colour of the mesh (pigment) reflects light whose brightness decreases with the square of the distance
    # from the light source, like that of diffracted light.
    coloured = square()
    coloured.visual = trimesh.visual.TextureVisuals(
        uv=coloured.visual.uv, material=trimesh.visual.material.SimpleMaterial(diffuse=[200, 100, 50, 255])
    )
    # Refinement is off, because pixels of the brighter picture could be refined more than those of the darker one.
    options = OPTIONS | {"refine": False}
    shown = [
        wd.shade(coloured, fingers, wd.PointLight((0.0, 0.0, d)), view, **(options | {"pigment": 100.0})).xyz[1, 1]
        - wd.shade(coloured, fingers, wd.PointLight((0.0, 0.0, d)), view, **options).xyz[1, 1]
        for d in (1.0, 2.0)
    ]
    assert shown[0] == pytest.approx(4.0 * shown[1], rel=1e-2)


def test_pigment_under_a_point_light_equals_that_of_a_directional_light_per_pixel(fingers):
    coloured, place = square(), np.array([0.4, -0.3, 0.7])
    coloured.visual = trimesh.visual.TextureVisuals(
        uv=coloured.visual.uv, material=trimesh.visual.material.SimpleMaterial(diffuse=[200, 100, 50, 255])
    )
    view = wd.View.orthographic((0, 0, 4), (0, 0, 0), up=(0, 1, 0), extent_y=1.2, width=3, height=3)
    options = OPTIONS | {"footprint": False, "plan": wd.plan(fingers, coherence=WINDOW, tolerance=3e-2)}

    def pigment(light):
        pictures = [wd.shade(coloured, fingers, light, view, **(options | {"pigment": n})).xyz for n in (0.0, 100.0)]
        return pictures[1] - pictures[0]

    result = pigment(wd.PointLight(tuple(place)))
    for row in range(3):
        for column in range(3):
            away = place - [0.4 * (column - 1), 0.4 * (1 - row), 0.0]
            light = wd.DirectionalLight(tuple(away), power=1.0 / float(away @ away))
            np.testing.assert_allclose(result[row, column], pigment(light)[row, column], rtol=2e-3)


def test_too_much_light_is_refused(fingers):
    with pytest.raises(
        ValueError,
        match=r"lights\[0\] \(PointLight\) has a power of 1e\+06 at one position, and must have at most 1e\+09 times",
    ):
        wd.shade(square(size=1e-3), fingers, wd.PointLight((0.0, 0.0, 1.0), power=1e6), VIEW, **OPTIONS)
    bright = wd.Environment(np.full((2, 4, 3), 1e9), scale=1e6, directions=16)
    with pytest.raises(ValueError, match=r"an Environment has a power of .* at most 1e\+12; give a smaller scale"):
        wd.shade(square(), fingers, bright, VIEW, **OPTIONS)


@dataclass(frozen=True)
class FarLight(wd.PointLight):
    """Light far away from the mesh, with the extent of a disc of ``diameter_deg`` around its position.

    The extent of the light along the direction to it has no effect, because this extent is not visible from the mesh.
    """

    diameter_deg: float = 0.0

    def lobes(self):
        place = np.array(self.position)
        distance = np.linalg.norm(place)
        across = distance * 0.25 * math.radians(self.diameter_deg) * orthonormal_pair(place / distance)
        (lobe,) = super().lobes()
        return (replace(lobe, deviations=across + [[0.0], [0.01]] * place, power=float(place @ place)),)


@pytest.mark.parametrize("size", [1.0, 1000.0])
def test_the_extent_of_a_far_light_equals_that_of_a_disc(size, fingers):
    view = wd.View.orthographic(
        np.array(VIEW.eye) * size, (0, 0, 0), extent_y=1.6 * size, width=VIEW.width, height=VIEW.height
    )
    place = (0.5e4 * size, 0.2e4 * size, 0.9e4 * size)
    options = OPTIONS | {"refine": False}
    light = wd.DirectionalLight(place, angular_diameter_deg=4.0)
    disc = wd.shade(square(size=size), fingers, light, view, **options)
    far, point = (
        wd.shade(square(size=size), fingers, light, view, plan=disc.plan, **options).xyz
        for light in (FarLight(place, diameter_deg=4.0), FarLight(place))
    )
    np.testing.assert_allclose(far, disc.xyz, rtol=1e-2)
    assert np.abs(point - disc.xyz).max() > 0.1 * disc.xyz.max()


@pytest.mark.filterwarnings("ignore:none of the lights illuminates")
def test_shadow_rays_stop_at_the_light(fingers):
    scene = trimesh.Scene([square(), square(height=2.0, size=0.4)])
    view = wd.View.orthographic((3.0, 0.4, 4.0), (0, 0, 0), extent_y=0.3, width=4, height=3)
    below, above = (
        wd.shade(scene, fingers, wd.PointLight((0.02, 0.0, height)), view, **OPTIONS) for height in (1.5, 3.0)
    )
    assert below.mask.all()
    assert below.illuminated.all()
    assert not above.illuminated.any()


@pytest.mark.filterwarnings("ignore:none of the lights illuminates")
def test_a_renderer_may_replace_a_directional_light_by_a_point_light(fingers):
    light = wd.PointLight((0.3, -0.2, 0.9))
    options = OPTIONS | {"refine": False}
    renderer = wd.Renderer(square(), fingers, wd.DirectionalLight((0.1, 0.2, 1.0)), VIEW, **options)
    renderer.draw(light)
    result = renderer.image()
    expected = wd.shade(square(), fingers, light, VIEW, plan=renderer.plan, **options)
    assert np.array_equal(result.xyz, expected.xyz)
    on_the_surface = wd.shade(square(), fingers, wd.PointLight((0.1, 0.1, 0.0)), VIEW, plan=renderer.plan, **options)
    assert np.isfinite(on_the_surface.xyz).all()
