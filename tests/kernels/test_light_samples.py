"""Light samples: factors of the energy normalisation and transmittances by angle, and footprints under lights that are
extended or nearby.
"""

import numpy as np
import pytest
import warp as wp
from conftest import hemisphere, launch

from warpdiff.kernels import compile_options, light_samples, thresholds
from warpdiff.kernels.structs import Camera, Footprint, Pixels, SurfaceArrays

COUNT = 100


@wp.kernel(module="unique", module_options=compile_options.options())
def interpolated(
    reflection: light_samples.Reflection, directions: wp.array(dtype=wp.vec3f),
    energy_out: wp.array(dtype=wp.float32), transmittance_out: wp.array(dtype=wp.vec3f),
):  # fmt: skip
    i = wp.tid()
    energy_out[i] = light_samples.energy_factor(reflection, 1, directions[i])
    transmittance_out[i] = light_samples.transmittance(reflection, 1, directions[i][2])


def array(values, dtype):
    return wp.array(values, dtype=dtype, device="cpu")


def test_factors_are_linear_between_angles(rng):
    """Between tabulated angles, energy factors must be linear in √(1 − cos θ), and transmittances linear in cos θ.

    θ is the angle between a direction and the normal. Factors of the energy normalisation also depend on the azimuth of
    the direction (x, y, z). Within each quadrant, they must be linear in y / (|x| + |y|).
    """
    directions = hemisphere(rng, COUNT, thresholds.LOWEST)
    directions[0] = (1e-5, 1e-5, 1.0)
    energy, transmittances = rng.uniform(0.5, 1.5, (5, 8)), rng.uniform(size=(3, 6, 3))
    # The test looks up the finish with index 1 and the surface with index 1. The transmittances of the next finish and
    # the energy factors of the other surface are NaN, so that a look-up that reads them by mistake has the result NaN.
    transmittances[2] = np.nan
    reflection = light_samples.Reflection()
    energies = np.stack([np.full_like(energy, np.nan), energy])
    reflection.energy, reflection.transmittances = array(energies, wp.float32), array(transmittances, wp.vec3f)
    energy_factors, through = array(np.zeros(COUNT), wp.float32), array(np.zeros((COUNT, 3)), wp.vec3f)
    launch(interpolated, COUNT, [reflection, array(directions, wp.vec3f)], [energy_factors, through], device="cpu")
    x, y, z = directions.T
    rows = 4.0 * np.sqrt((1.0 - z) / (1.0 - thresholds.LOWEST))
    share = y / (np.abs(x) + np.abs(y))
    # The table of energy factors has eight columns per turn of the azimuth, so that a quarter turn has two. The first
    # column follows the last.
    columns = 2.0 * np.where(x < 0.0, 2.0 - share, share % 4.0)
    around = np.column_stack([energy, energy[:, 0]])
    by_column = np.array([[np.interp(c, np.arange(9), row) for row in around] for c in columns])
    expected = [np.interp(r, np.arange(5), values) for r, values in zip(rows, by_column, strict=True)]
    np.testing.assert_allclose(energy_factors.numpy(), expected, rtol=1e-4)
    for channel in range(3):
        linear = np.interp(5.0 * z, np.arange(6), transmittances[1, :, channel])
        np.testing.assert_allclose(through.numpy()[:, channel], linear, rtol=1e-4)


def test_the_extent_of_a_light_adds_its_covariance_to_footprints(rng):
    pixels, lights = Pixels(), light_samples.Lights()
    tangents, normals = hemisphere(rng, COUNT), hemisphere(rng, COUNT)
    bitangents = np.cross(normals, tangents)
    pixels.tangent, pixels.bitangent = array(tangents, wp.vec3f), array(bitangents, wp.vec3f)
    deviations = rng.normal(size=(2, 2, 3))
    lights.deviations = array(deviations, wp.vec3f)
    footprints = rng.normal(size=(COUNT, 4))
    result = array(footprints, Footprint)
    inputs = [lights, 1, array([], wp.vec4f), 0.0, pixels, 0, COUNT // 2]
    launch(light_samples.add_light_extent, (2, 1), inputs, [result], device="cpu")

    def covariances(values):
        changes = values.reshape(-1, 2, 2)
        return np.swapaxes(changes, 1, 2) @ changes

    axes = np.stack([tangents, bitangents], axis=1)
    added = axes @ deviations[1].T
    expected = covariances(footprints) + added @ np.swapaxes(added, 1, 2)
    np.testing.assert_allclose(covariances(result.numpy().astype(float)), expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("orthographic", [False, True])
def test_the_rotation_of_a_near_light_equals_differences_between_neighbouring_rays(orthographic, rng):
    """The kernel's change of the direction to a near light must equal the difference between two rays 0.0005 pixels
    apart.

    The kernel adds this change to the change of (u, v) within a pixel (footprint).
    """
    corners = np.array([[-1.0, -0.9, 0.1], [0.9, -1.0, -0.2], [0.1, 1.0, 0.3]])
    plane = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    place, eye = np.array([0.4, -0.3, 0.7]), np.array([1.5, 1.0, 2.0])
    back = eye / np.linalg.norm(eye)
    right = np.cross([0.0, 1.0, 0.0], back) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], back))
    up = np.cross(back, right)
    half, width, height, deviation = np.array([0.2, 0.15]), 16, 12, 0.5

    def met(x, y):
        """Return where the ray at a picture position meets the plane of the face, and the direction to the camera."""
        across = x * right + y * up
        origin, along = (eye + across, -back) if orthographic else (eye, across - back)
        return origin + along * (plane @ (corners[0] - origin)) / (plane @ along), -along / np.linalg.norm(along)

    def towards(point):
        return (place - point) / np.linalg.norm(place - point)

    camera, surface, pixels, lights = Camera(), SurfaceArrays(), Pixels(), light_samples.Lights()
    camera.axes = array([eye, right, up, back, (*half, 0.0)], wp.vec3d)
    camera.orthographic, camera.width, camera.height = orthographic, width, height
    surface.positions, surface.faces = array(corners, wp.vec3f), array([[0, 1, 2]], wp.int32)
    lights.places = array([(0.0, 0.0, 1.0, 0.0), (*place, 1.0)], wp.vec4d)
    x, y = rng.uniform(-0.15, 0.15, (2, COUNT))
    hits = [met(*at) for at in zip(x, y, strict=True)]
    tangents, bitangents = hemisphere(rng, COUNT), hemisphere(rng, COUNT)
    pixels.hit, pixels.face = array(np.ones(COUNT), wp.int32), array(np.zeros(COUNT), wp.int32)
    pixels.to_view, pixels.shadow_origin = array([v for _, v in hits], wp.vec3f), array([p for p, _ in hits], wp.vec3f)
    pixels.tangent, pixels.bitangent = array(tangents, wp.vec3f), array(bitangents, wp.vec3f)
    result = array(np.ones((COUNT, 4)), Footprint)
    inputs = [camera, surface, pixels, lights, 1, deviation, 0, COUNT // 2]
    launch(light_samples.add_light_rotation, (2, 1), inputs, [result], device="cpu")
    steps = np.diag([2.0, -2.0]) * deviation * half / (width, height) * 1e-3
    for i in range(COUNT):
        turns = [1e3 * (towards(hits[i][0]) - towards(met(x[i] + dx, y[i] + dy)[0])) for dx, dy in steps]
        expected = 1.0 + np.array([turn @ axis for turn in turns for axis in (tangents[i], bitangents[i])])
        np.testing.assert_allclose(result.numpy()[i], expected, atol=1e-4)


def test_only_pixels_with_a_finish_keep_their_gains(rng):
    """Two threads process all pixels but the first. A pixel without a hit has the gain 0 and no face."""
    gains, faces, finishes = rng.uniform(0.1, 1.0, 21), rng.integers(0, 6, 21), np.array([0, 1, 2, 1, 0, 2])
    gains[5], faces[5] = 0.0, -1
    result = wp.full(21, -1.0, dtype=wp.float32, device="cpu")
    inputs = [
        wp.array(gains, dtype=wp.float32, device="cpu"), wp.array(faces, dtype=wp.int32, device="cpu"),
        wp.array(finishes, dtype=wp.int32, device="cpu"), 1, 1, 10,
    ]  # fmt: skip
    launch(light_samples.select_finish, (2, 1), inputs, [result], device="cpu")
    expected = np.where(finishes[faces] == 1, gains, 0.0)
    np.testing.assert_allclose(result.numpy(), [-1.0, *expected[1:]], rtol=1e-6)
