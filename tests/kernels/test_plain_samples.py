"""Samples of lights for plain surfaces with a roughness: shading frames, the fraction of the samples that is drawn from
microfacets, disc lights, and the choice of one of many lights.
"""

import math

import numpy as np
import pytest
import warp as wp
from conftest import hemisphere, launch

import warpdiff as wd
from warpdiff.kernels import compile_options, plain_samples, sample_frames
from warpdiff.kernels.light_samples import Lights
from warpdiff.kernels.plain_reflection import Gloss, PlainMaterials
from warpdiff.kernels.structs import Footprint, Pixels
from warpdiff.lights.base import orthonormal_pair

COUNT = 256


def array(values, dtype):
    return wp.array(values, dtype=dtype, device="cpu")


@wp.kernel(module="unique", module_options=compile_options.options("transparency.h"))
def call_functions(
    pixels: Pixels, footprints: wp.array(dtype=Footprint), random: wp.array(dtype=wp.vec2f),
    diffuse: wp.array(dtype=wp.vec3f), normal_reflectances: wp.array(dtype=wp.vec3f),
    tangents: wp.array(dtype=wp.vec3f), bitangents: wp.array(dtype=wp.vec3f), normals: wp.array(dtype=wp.vec3f),
    views: wp.array(dtype=wp.vec3f), shares: wp.array(dtype=wp.float32),
):  # fmt: skip
    i = wp.tid()
    frame = sample_frames.filtered_frame(pixels, i, footprints[i], random[i])
    tangents[i] = frame.tangent
    bitangents[i] = frame.bitangent
    normals[i] = frame.normal
    views[i] = frame.view
    gloss = Gloss()
    gloss.view = frame.view
    gloss.diffuse = diffuse[i]
    gloss.normal_reflectance = normal_reflectances[i]
    shares[i] = plain_samples.share_of_facets(gloss)


def test_frames_within_a_footprint_and_shares_of_microfacets_have_closed_forms(rng):
    """Frames at points of the pixel filter must change (u, v) as the footprint states, also for left-handed frames.

    The footprint has the changes of (u, v) of light from the mirror direction over one standard deviation of the
    filter, along rows and columns.

    The fraction of samples drawn from microfacets must equal the share of the specular reflection in the brightness
    under a white sky, and be at least 0.2.
    """
    frames, local = np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))[0], hemisphere(rng, COUNT, 0.3)
    frames[::2, 1] *= -1.0
    view = np.einsum("na,nac->nc", local, frames)
    mirrored = np.einsum("na,nac->nc", local * (-1.0, -1.0, 1.0), frames)
    footprints, random = rng.normal(scale=1e-3, size=(COUNT, 4)), rng.uniform(size=(COUNT, 2))
    diffuse, normal_reflectances = rng.uniform(size=(2, COUNT, 3))
    diffuse[:20] = 0.0
    normal_reflectances[::2] *= 0.1
    pixels = Pixels()
    pixels.tangent, pixels.bitangent, pixels.normal = (array(frames[:, axis], wp.vec3f) for axis in range(3))
    pixels.to_view = array(view, wp.vec3f)
    outputs = [wp.zeros(COUNT, wp.vec3f, device="cpu") for _ in range(4)]
    shares = wp.zeros(COUNT, wp.float32, device="cpu")
    inputs = [
        pixels, array(footprints, Footprint), array(random, wp.vec2f), array(diffuse, wp.vec3f),
        array(normal_reflectances, wp.vec3f),
    ]  # fmt: skip
    launch(call_functions, COUNT, inputs, [*outputs, shares], device="cpu")
    *axes, views = (values.numpy().astype(float) for values in outputs)
    # A point of the pixel filter by the method of Box and Muller, in standard deviations along rows and columns.
    point = np.sqrt(-2.0 * np.log1p(-random[:, :1])) * np.stack(
        [np.cos(2 * np.pi * random[:, 1]), np.sin(2 * np.pi * random[:, 1])], axis=1
    )
    expected = np.einsum("ns,nsk->nk", point, footprints.reshape(-1, 2, 2))
    uv = -np.stack([np.sum(axis * (mirrored + view), axis=1) for axis in axes[:2]], axis=1)
    np.testing.assert_allclose(uv, expected, atol=5e-5)
    result = np.stack(axes, axis=1)
    np.testing.assert_allclose(result @ np.swapaxes(result, 1, 2), np.tile(np.eye(3), (COUNT, 1, 1)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(result), np.linalg.det(frames), atol=1e-6)
    np.testing.assert_allclose(views, np.einsum("nac,nc->na", result, view), atol=1e-6)
    normal = normal_reflectances.mean(axis=1)
    specular = normal + (1.0 - normal) * (1.0 - views[:, 2]) ** 5
    brightness = specular + (1.0 - specular) * diffuse.mean(axis=1)
    np.testing.assert_allclose(shares.numpy(), np.maximum(specular / brightness, 0.2), rtol=1e-4)


def drawn(diameter, alpha, towards_mirror):
    """Return the axis of a disc light, the mirror direction, and directions on the disc with weights, for 4,096 rays.

    The rays are on a metal with the parameter α of GGX, whose normal is at 17° from the mirror direction. The mirror
    direction is ``towards_mirror`` radii from the centre of the disc.
    """
    count, radius = 64 * 64, math.radians(0.5 * diameter)
    light = wd.DirectionalLight((0.2, 0.5, 1.0), angular_diameter_deg=diameter).lobes()[0]
    axis = np.asarray(light.to_light)
    mirror = axis * math.cos(towards_mirror * radius) + orthonormal_pair(axis)[0] * math.sin(towards_mirror * radius)
    normal = mirror + 0.3 * orthonormal_pair(mirror)[1]
    normal /= np.linalg.norm(normal)
    lights, pixels, materials = Lights(), Pixels(), PlainMaterials()
    lights.places = array([(*axis, 0.0)], wp.vec4d)
    lights.deviations = array(light.deviations[None], wp.vec3f)
    materials.rows, materials.metallic_roughness = array([0], wp.int32), array([(1.0, math.sqrt(alpha))], wp.vec2f)

    def repeated(value):
        return array(np.tile(value, (count, 1)), wp.vec3f)

    pixels.hit, pixels.face = wp.ones(count, wp.int32, device="cpu"), wp.zeros(count, wp.int32, device="cpu")
    pixels.tangent, pixels.bitangent = (repeated(side) for side in orthonormal_pair(normal))
    pixels.normal, pixels.to_view = repeated(normal), repeated(2.0 * (normal @ mirror) * normal - mirror)
    pixels.base_colour = repeated((1.0, 1.0, 1.0))
    towards = wp.zeros(count, wp.vec4f, device="cpu")
    inputs = [lights, 0, 0.0, materials, pixels, array([5], wp.int32), 16, 64, 0, 1, 0, count // 2]
    launch(plain_samples.draw_plain_disc, (2, 1), inputs, [towards], device="cpu")
    return axis, mirror, towards.numpy().astype(float)


@pytest.mark.parametrize(("alpha", "towards_mirror"), [(0.02, 0.4), (0.02, 0.95), (0.3, 0.4)])
def test_directions_on_a_disc_are_uniform_and_many_are_near_the_mirror_direction_of_a_smooth_metal(
    alpha, towards_mirror
):
    """Weighted directions must be uniform over the disc, also if a part of them is drawn from microfacets.

    The mirror direction is on the disc. If the reflection lobe of the surface is narrower than the disc, half of the
    directions are drawn from microfacets. Half of the microfacets have slopes below α, which reflect to within 2α of
    the mirror direction.
    """
    axis, mirror, towards = drawn(20.0, alpha, towards_mirror)
    radius, weights = math.radians(10.0), towards[:, 3]
    np.testing.assert_allclose(np.linalg.norm(towards[:, :3], axis=1), 1.0, atol=1e-5)
    near = np.mean(np.linalg.norm(towards[:, :3] - mirror, axis=1) < 2.0 * alpha)
    if alpha > 0.1:
        np.testing.assert_allclose(weights, 1.0, rtol=1e-5)
    else:
        assert near > 0.2
    inside = weights > 0.0
    cosines = towards[inside, :3] @ axis
    assert np.all(cosines >= math.cos(radius) - 1e-6)
    share = (1.0 - cosines) / (1.0 - math.cos(radius))
    around = np.arctan2(*(towards[inside, :3] @ orthonormal_pair(axis).T).T)
    assert weights.mean() == pytest.approx(1.0, abs=0.02)
    for values, ends in ((share, (0.0, 1.0)), (around, (-math.pi, math.pi))):
        result = np.histogram(values, 8, ends, weights=weights[inside])[0] / len(weights)
        np.testing.assert_allclose(result, 0.125, atol=0.012)


def test_one_of_many_lights_is_chosen_by_the_mean_roughness_of_a_footprint(rng):
    """The chosen lights and their weights must not depend on how much the roughness varies within the footprint.

    They are compared with those of a texture without a variation.
    """
    lights, pixels, materials = Lights(), Pixels(), PlainMaterials()
    lights.places = array(np.column_stack([hemisphere(rng, 5), np.zeros(5)]), wp.vec4d)
    lights.strengths = array(np.ones(5), wp.float64)
    materials.rows, materials.metallic_roughness = array([0], wp.int32), array([(1.0, 1.0)], wp.vec2f)
    pixels.hit, pixels.face = wp.ones(COUNT, wp.int32, device="cpu"), wp.zeros(COUNT, wp.int32, device="cpu")
    pixels.tangent, pixels.bitangent, pixels.normal = (array(np.tile(axis, (COUNT, 1)), wp.vec3f) for axis in np.eye(3))
    pixels.to_view = array(hemisphere(rng, COUNT), wp.vec3f)
    pixels.base_colour = array(np.ones((COUNT, 3)), wp.vec3f)
    footprints = array(np.full((COUNT, 4), 1e-3), Footprint)
    results = []
    for deviation in (0.0, 0.3):
        pixels.metallic_roughness = array(np.tile((1.0, 0.5, deviation, 0.0), (COUNT, 1)), wp.vec4f)
        towards = wp.zeros(COUNT, wp.vec4f, device="cpu")
        inputs = [lights, materials, pixels, footprints, array([], wp.int32), 16, 1, 0, 1, 0, COUNT]
        launch(plain_samples.choose_plain_lights, (1, 1), inputs, [towards], device="cpu")
        results.append(towards.numpy())
    np.testing.assert_array_equal(*results)
    assert len(np.unique(results[0][:, 0])) == 5


def test_lights_are_chosen_with_probabilities_proportional_to_their_reflected_light(rng):
    """A weight must be the power of the chosen light over that of the first light, divided by the probability.

    The probabilities are computed from Lambert's law and the microfacet distribution of the glTF specification, without
    masking, with Schlick's Fresnel term of the view direction. One launch of two threads has all lights and all rays
    but the first and the last.
    """
    count, powers, roughness = 4096, np.array([1.0, 0.3, 2.0, 0.7]), 0.6
    to_light, to_view = hemisphere(rng, 4, 0.2), hemisphere(rng, 1, 0.3)[0]
    lights, pixels, materials = Lights(), Pixels(), PlainMaterials()
    lights.places = array(np.column_stack([to_light, np.zeros(4)]), wp.vec4d)
    lights.strengths = array(powers, wp.float64)
    materials.rows, materials.metallic_roughness = array([0], wp.int32), array([(0.0, roughness)], wp.vec2f)
    pixels.hit, pixels.face = wp.ones(count, wp.int32, device="cpu"), wp.zeros(count, wp.int32, device="cpu")
    pixels.tangent, pixels.bitangent, pixels.normal = (array(np.tile(axis, (count, 1)), wp.vec3f) for axis in np.eye(3))
    pixels.to_view, pixels.base_colour = (
        array(np.tile(row, (count, 1)), wp.vec3f) for row in (to_view, np.full(3, 0.4))
    )
    footprints, tiles = array(np.full((count, 4), 1e-9), Footprint), array(np.arange(1), wp.int32)
    towards = wp.zeros(count, wp.vec4f, device="cpu")
    inputs = [lights, materials, pixels, footprints, tiles, 16, 64, 0, 1, 1, count // 2 - 1]
    launch(plain_samples.choose_plain_lights, (2, 1), inputs, [towards], device="cpu")
    result = towards.numpy().astype(float)
    assert not result[0].any()
    assert not result[-1].any()
    half = to_light + to_view
    cosine = half[:, 2] / np.linalg.norm(half, axis=1)
    alpha2 = roughness**4
    facets = alpha2 / (cosine**2 * (alpha2 - 1.0) + 1.0) ** 2
    fresnel = 0.04 + 0.96 * (1.0 - to_view[2]) ** 5
    brightness = powers * ((1.0 - fresnel) * 0.4 * to_light[:, 2] + fresnel * facets / (4.0 * to_view[2]))
    share = brightness / brightness.sum()
    chosen = np.argmax(result[1:-1, :3] @ to_light.T, axis=1)
    np.testing.assert_allclose(result[1:-1, 3], (powers / powers[0] / share)[chosen], rtol=1e-4)
    np.testing.assert_allclose(np.bincount(chosen, minlength=4) / len(chosen), share, atol=0.01)
