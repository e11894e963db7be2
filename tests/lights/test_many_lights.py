"""Many directional lights, of which each subpixel cell chooses one, compared with sums of pictures with one light."""

import numpy as np
import pytest

import warpdiff as wd
from warpdiff import meshes
from warpdiff.lights.base import MANY_LIGHTS

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


@pytest.fixture(scope="module")
def renderer(fingers):
    body = meshes.tube(segments_along=48, segments_around=24)
    light = hemisphere(1)
    return wd.Renderer(body, fingers, light, VIEW, coherence=wd.Coherence(sigma_um=4.0), tolerance=TOLERANCE)


@pytest.mark.parametrize("others", [[], [wd.PointLight((0.5, 2.0, 1.0)), wd.DirectionalLight((1.0, 1.0, 1.0))]])
def test_a_picture_with_many_lights_is_the_sum_of_pictures_with_one(renderer, others):
    lights = [*hemisphere(MANY_LIGHTS), *others]
    renderer.draw(lights)
    image = renderer.image()
    exact = np.zeros(image.xyz.shape)
    for light in lights:
        renderer.draw(light)
        exact += renderer.image().xyz
    inside = image.illuminated & (image.coverage > 0.999)
    assert np.count_nonzero(inside) > 200
    errors = np.linalg.norm(image.xyz[inside] - exact[inside], axis=1) / np.linalg.norm(exact[inside], axis=1)
    # The sums have errors of their own, up to the tolerance.
    assert np.percentile(errors, 90.0) < TOLERANCE
    assert image.xyz[inside][:, 1].sum() == pytest.approx(exact[inside][:, 1].sum(), rel=0.01)
    wrong = errors > 1.5 * TOLERANCE
    assert np.count_nonzero(image.error[inside][wrong] > TOLERANCE) >= 0.9 * np.count_nonzero(wrong)


def test_a_picture_with_many_lights_does_not_depend_on_the_number_of_threads(fingers):
    body, options = meshes.tube(segments_along=48, segments_around=24), {"tolerance": TOLERANCE, "pigment": 0.1}
    one, two = (
        wd.shade(body, fingers, hemisphere(MANY_LIGHTS, "FL11"), VIEW, threads=threads, strict=False, **options)
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one.xyz, two.xyz)
    np.testing.assert_array_equal(one.error, two.error)
