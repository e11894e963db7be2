"""Many directional lights, of which each subpixel cell (part of a pixel with one ray) chooses one, compared with all
lights in each cell.
"""

import numpy as np
import pytest
from conftest import slow

import warpdiff as wd
from warpdiff import meshes
from warpdiff.lights.base import MANY_LIGHTS
from warpdiff.render import light_parts
from warpdiff.scene import occluder_grid

TOLERANCE = 0.1
VIEW = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=48, height=36)


def hemisphere(count, illuminant="D65"):
    """Return directional lights of different power that are distributed over the upper hemisphere."""
    index = np.arange(count) + 0.5
    up, turn = 0.05 + 0.95 * index / count, index * np.pi * (3.0 - np.sqrt(5.0))
    level = np.sqrt(1.0 - up**2)
    return [
        wd.DirectionalLight(towards, illuminant=illuminant, power=1.0 + k % 3)
        for k, towards in enumerate(zip(level * np.cos(turn), up, level * np.sin(turn), strict=True))
    ]


@pytest.mark.parametrize("others", [slow([]), [wd.PointLight((0.5, 2.0, 1.0)), wd.DirectionalLight((1.0, 1.0, 1.0))]])
def test_a_choice_of_lights_has_the_colours_of_all_lights(fingers, monkeypatch, others):
    body, lights = meshes.tube(segments_along=48, segments_around=24), [*hemisphere(MANY_LIGHTS), *others]
    coherence = wd.Coherence(sigma_um=4.0)
    renderer = wd.Renderer(body, fingers, lights, VIEW, coherence=coherence, tolerance=TOLERANCE, strict=False)
    image = renderer.image()
    monkeypatch.setattr(light_parts, "MANY_LIGHTS", len(lights) + 1)
    renderer.draw(lights)
    exact = renderer.image().xyz
    inside = image.illuminated & (image.coverage > 0.999)
    assert np.count_nonzero(inside) > 100
    errors = np.linalg.norm(image.xyz[inside] - exact[inside], axis=1) / np.linalg.norm(exact[inside], axis=1)
    assert 0.0 < np.percentile(errors, 50.0) < 0.6 * TOLERANCE
    assert np.percentile(errors, 99.0) < 1.5 * TOLERANCE
    assert image.xyz[inside][:, 1].sum() == pytest.approx(exact[inside][:, 1].sum(), rel=0.02)


def test_a_picture_with_many_lights_does_not_depend_on_the_number_of_threads(fingers):
    body, options = meshes.tube(segments_along=48, segments_around=24), {"tolerance": 4.0 * TOLERANCE, "pigment": 0.1}
    options["coherence"] = wd.Coherence(sigma_um=3.0)
    one, two = (
        wd.shade(body, fingers, hemisphere(MANY_LIGHTS, "FL11"), VIEW, threads=threads, strict=False, **options)
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one.xyz, two.xyz)
    np.testing.assert_array_equal(one.error, two.error)


def test_occluder_grids_are_kept_for_lights_that_do_not_move(fingers, monkeypatch):
    """Occluder grids (grids of faces for shadow rays) must not be made again for the next picture if the lights do not
    move.

    The picture has more lights than the mesh can store grids. Only the object that samples the lights (pass) therefore
    stores all grids.
    """
    made, make = [], occluder_grid._made
    monkeypatch.setattr(occluder_grid, "_made", lambda *args, **options: made.append(1) or make(*args, **options))
    body, lights = meshes.tube(segments_along=48, segments_around=24), hemisphere(7)
    options = {"tolerance": 4.0 * TOLERANCE, "strict": False}
    renderer = wd.Renderer(body, fingers, lights[:6], VIEW, **options)
    renderer.draw()
    before = len(made)
    renderer.draw()
    assert len(made) == before >= 6
    renderer.draw(lights[1:])
    expected = wd.Renderer(meshes.tube(segments_along=48, segments_around=24), fingers, lights[1:], VIEW, **options)
    expected.draw()
    np.testing.assert_array_equal(renderer.image().xyz, expected.image().xyz)
