"""Reflection of plain surfaces: the BRDF of the specification, and the distribution of microfacets after a blur."""

import math

import numpy as np
import pytest
import warp as wp
from conftest import hemisphere, launch
from plain_specification import brdf

from warpdiff.kernels import compile_options, plain_reflection
from warpdiff.kernels.light_samples import Lights
from warpdiff.kernels.structs import Footprint, Pixels


def array(values, dtype):
    return wp.array(values, dtype=dtype, device="cpu")


@wp.kernel(module="unique", module_options=compile_options.options())
def call_functions(
    diffuse: wp.vec3f, normal_reflectance: wp.vec3f, alpha: wp.float32, covariance: wp.vec3f,
    lights: wp.array(dtype=wp.vec3f), views: wp.array(dtype=wp.vec3f), slopes: wp.array(dtype=wp.vec2f),
    reflected: wp.array(dtype=wp.vec3f), densities: wp.array(dtype=wp.float32),
):  # fmt: skip
    i = wp.tid()
    gloss = plain_reflection.Gloss()
    gloss.view = views[i]
    gloss.diffuse = diffuse
    gloss.normal_reflectance = normal_reflectance
    gloss.alpha2 = alpha * alpha
    gloss.spread = gloss.alpha2
    reflected[i] = plain_reflection.reflected(gloss, lights[i], -(wp.vec3d(lights[i]) + wp.vec3d(views[i])))
    densities[i] = plain_reflection.blurred_density(
        plain_reflection.blurred(gloss, covariance, 1.0), slopes[i][0], slopes[i][1]
    )


def computed(metallic, alpha, colour, *, lights, views, slopes, covariance=(0.0, 0.0, 0.0)):
    """Return π times the BRDF for pairs of a light and a view direction, and the density of microfacets at slopes.

    The density is that of the GGX distribution, blurred by a Gaussian with ``covariance``.
    """
    base = np.array(colour)
    count = len(slopes)
    results = [wp.zeros(count, dtype=dtype, device="cpu") for dtype in (wp.vec3f, wp.float32)]
    inputs = [
        wp.vec3f(*((1.0 - metallic) * base)), wp.vec3f(*(0.04 * (1.0 - metallic) + metallic * base)), alpha,
        wp.vec3f(*covariance), array(lights, wp.vec3f), array(views, wp.vec3f), array(slopes, wp.vec2f),
    ]  # fmt: skip
    launch(call_functions, count, inputs, results, device="cpu")
    return [values.numpy() for values in results]


@pytest.mark.parametrize(("metallic", "roughness"), [(0.0, 0.4), (1.0, 0.3), (0.6, 1.0)])
def test_pairs_of_directions_have_the_brdf_of_the_specification(metallic, roughness, rng):
    colour = (0.8, 0.4, 0.2)
    lights, views = hemisphere(rng, 200, 0.02), hemisphere(rng, 200, 0.02)
    result, _ = computed(metallic, roughness**2, colour, lights=lights, views=views, slopes=np.zeros((200, 2)))
    np.testing.assert_allclose(result, math.pi * brdf(lights, views, metallic, roughness, colour), rtol=2e-4)


@pytest.mark.parametrize(
    ("texture", "metallic", "roughness"),
    [((0.6, 0.5, 0.009, 0.3), 0.6, 0.4), ((1.4, 2.0, 0.0, 0.0), 1.0, 0.8), ((-0.2, 0.5, 0.0, 0.0), 0.0, 0.4)],
)
def test_a_texture_with_nearly_equal_roughness_in_a_footprint_has_the_brdf_of_its_mean(
    texture, metallic, roughness, rng
):
    """The reflected light must be that of the mean roughness, if the roughness hardly varies within a footprint.

    The standard deviation of the first texture, 0.009, is below the smallest one that the kernel takes into account.
    Numbers outside of 0 to 1, which filters with negative weights may cause, count as 0 or 1.
    """
    count, colour = 50, (0.8, 0.4, 0.2)
    to_lights, to_views = hemisphere(rng, count, 0.1), hemisphere(rng, count, 0.1)
    pixels, lights, materials = Pixels(), Lights(), plain_reflection.PlainMaterials()
    pixels.face, pixels.base_colour = array(np.zeros(count), wp.int32), array(np.tile(colour, (count, 1)), wp.vec3f)
    pixels.metallic_roughness = array(np.tile(texture, (count, 1)), wp.vec4f)
    materials.rows, materials.metallic_roughness = array([0], wp.int32), array([(1.0, 0.8)], wp.vec2f)
    lights.places, lights.strengths = array([(0.0, 0.0, 1.0, 0.0)], wp.vec4d), array([1.0], wp.float64)
    lights.white_rgb, lights.rgb_to_xyz = array([(1.0, 1.0, 1.0)], wp.vec3d), wp.mat33d(*np.eye(3).ravel())
    result = wp.zeros(count, wp.vec3f, device="cpu")
    inputs = [
        pixels, lights, 0, array([], wp.vec4f), 1.0, materials, array([], Footprint),
        array(-to_lights - to_views, wp.vec3d), array(to_lights, wp.vec3f), array(np.ones(count), wp.float32), 0, count,
    ]  # fmt: skip
    launch(plain_reflection.add_plain_reflection, (1, 1), inputs, [result], device="cpu")
    expected = math.pi * to_lights[:, 2:] * brdf(to_lights, to_views, metallic, roughness, colour)
    np.testing.assert_allclose(result.numpy(), expected, rtol=2e-4)


@pytest.mark.parametrize("alpha", [0.05, 0.5])
@pytest.mark.parametrize("covariance", [(0.0, 0.0, 0.0), (1e-3, 3e-4, 2e-4), (0.05, -0.02, 0.1), (3.0, 0.0, 0.5)])
def test_microfacets_cover_the_surface_once_after_a_blur(alpha, covariance):
    """The projected areas of all microfacets must add up to the area of the surface: ∫ D cos θ dω = 1.

    D is the GGX distribution of microfacets, blurred by a Gaussian. As an integral over the slopes s of microfacets,
    dω cos θ = ds cos⁴θ. The integral is computed as a mean over slopes that are drawn from the distribution without a
    blur. The tails of the two distributions must be equal.
    """
    trace = min(covariance[0] + covariance[2], 0.18)
    share, turn = np.meshgrid((np.arange(200) + 0.5) / 200, (np.arange(64) + 0.5) / 64 * 2.0 * math.pi)
    square = ((alpha**2 + trace) * share / (1.0 - share)).ravel()
    slopes = np.sqrt(square)[:, None] * np.stack([np.cos(turn.ravel()), np.sin(turn.ravel())], axis=1)
    up = np.tile((0.0, 0.0, 1.0), (len(slopes), 1))
    _, densities = computed(1.0, alpha, (1.0, 1.0, 1.0), lights=up, views=up, slopes=slopes, covariance=covariance)
    of_points = (alpha**2 + trace) / (math.pi * (alpha**2 + trace + square) ** 2)
    assert np.mean(densities / (1.0 + square) ** 2 / of_points) == pytest.approx(1.0, abs=2e-3)
    is_tail = square > 100.0 * (alpha**2 + trace)
    tail = alpha**2 / math.pi * ((1.0 + square) / (alpha**2 + square)) ** 2
    np.testing.assert_allclose(densities[is_tail], tail[is_tail], rtol=0.03)
