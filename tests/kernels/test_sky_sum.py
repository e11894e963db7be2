"""Functions of the sky sum against closed forms."""

import math

import numpy as np
import pytest
import warp as wp
from conftest import hemisphere
from scipy.stats import norm, truncnorm

from warpdiff.kernels import octahedral_maps, sky_sum
from warpdiff.kernels.light_samples import Reflection
from warpdiff.kernels.structs import Footprint, Pixels
from warpdiff.optics import reflectance_factors

COUNT = 200


@wp.kernel(module="unique", enable_backward=False)
def call_functions(
    along: wp.array(dtype=wp.vec3f), views: wp.array(dtype=wp.vec3f), sky: octahedral_maps.SkyMap,
    table: sky_sum.SkyTable, reflection: Reflection, footprints: wp.array(dtype=Footprint), visibility: sky_sum.open_t,
    places: wp.array(dtype=wp.vec2f), back: wp.array(dtype=wp.vec3f), horizon: wp.array(dtype=wp.vec3f),
    gains: wp.array(dtype=wp.float32), axes: wp.array(dtype=wp.vec4f), light: wp.array(dtype=wp.vec4f),
    rows: wp.array(dtype=wp.mat33f), shares: wp.array(dtype=wp.float32), rotated: wp.array2d(dtype=wp.vec3f),
):  # fmt: skip
    i = wp.tid()
    place = octahedral_maps.on_octahedron(along[i])
    places[i] = place
    back[i] = octahedral_maps.direction_at(place[0], place[1])
    horizon[i] = sky_sum.share_above(views[i][0] + 0.5, 0.3)
    frame = sky_sum.HitFrame()
    frame.view = views[i]
    frame.energy = wp.float32(1.0)
    u = -along[i][0] - views[i][0]
    v = -along[i][1] - views[i][1]
    gains[i] = sky_sum.gain_of(frame, reflection, u, v, along[i], 1.0)
    axes[i] = sky_sum.principal_axes(footprints[i])
    light[i] = octahedral_maps.light_along(sky, along[i], views[i][2])
    rows[i] = sky_sum.row_of(table, 1, 2, 2.0 * views[i][2])
    shares[i] = sky_sum.share_open(visibility, place)
    frame.tangent = wp.vec3f(0.0, 1.0, 0.0)
    frame.bitangent = wp.vec3f(0.0, 0.0, 1.0)
    frame.normal = wp.vec3f(1.0, 0.0, 0.0)
    beside = sky_sum.rotated_by(frame, reflection, 0.3 * along[i][0], 0.3 * along[i][1])
    rotated[i, 0] = beside.tangent
    rotated[i, 1] = beside.bitangent
    rotated[i, 2] = beside.normal
    rotated[i, 3] = beside.view


@wp.kernel(module="unique", enable_backward=False)
def send_near_horizon(
    views: wp.array(dtype=wp.vec3f), sky: octahedral_maps.SkyMap, table: sky_sum.SkyTable, reflection: Reflection,
    lobe: wp.float32, colours: wp.array(dtype=wp.vec3f),
):  # fmt: skip
    i = wp.tid()
    frame = sky_sum.HitFrame()
    frame.tangent = wp.vec3f(1.0, 0.0, 0.0)
    frame.bitangent = wp.vec3f(0.0, 1.0, 0.0)
    frame.normal = wp.vec3f(0.0, 0.0, 1.0)
    frame.view = views[i]
    frame.energy = wp.float32(1.0)
    colours[i] = sky_sum.mirrored_near_horizon(sky, table, frame, reflection, lobe, 0.0).colour


def array(values, dtype):
    return wp.array(values, dtype=dtype, device="cpu")


def affine(x, z):
    """Radiance that is linear on a map, of four spectra."""
    return np.stack([1.0 + x + 2.0 * z, 3.0 * x, 2.0 + z, 5.0 + 0.0 * x], axis=-1)


@pytest.fixture(scope="module")
def results():
    rng = np.random.default_rng(5)
    inputs = {
        "along": hemisphere(rng, COUNT), "views": hemisphere(rng, COUNT), "footprints": rng.normal(size=(COUNT, 4)),
        "rows": rng.uniform(size=(2, 3, 9, 3, 3)), "bits": rng.uniform(size=(16, 16)) < 0.5,
    }  # fmt: skip
    sky, table, reflection = octahedral_maps.SkyMap(), sky_sum.SkyTable(), Reflection()
    # Two maps, of which the second has twice the radiance; a texel more on each side lies on the same plane.
    maps = []
    for level, side in enumerate((6, 3)):
        centres = (np.arange(side + 2) - 0.5) / side
        maps.append((1.0 + level) * affine(*np.meshgrid(centres, centres)).reshape(-1, 4))
    sky.texels, sky.firsts = array(np.concatenate(maps), wp.vec4f), array([0, 64], wp.int32)
    sky.sides, sky.variance = array([6, 3], wp.int32), 0.01
    sky.turn = wp.vec2f(math.cos(0.4), math.sin(0.4))
    table.nodes, table.entries = wp.zeros(3, dtype=wp.vec4f, device="cpu"), 9
    table.rows = array(inputs["rows"].reshape(-1, 3, 3), wp.mat33f)
    reflection.normal_reflectance, reflection.masking = 0.04, True
    words = np.packbits(inputs["bits"].ravel(), bitorder="little").view(np.uint32)
    names = ("places", wp.vec2f), ("back", wp.vec3f), ("horizon", wp.vec3f), ("gains", wp.float32), ("axes", wp.vec4f)
    names += ("light", wp.vec4f), ("rows", wp.mat33f), ("shares", wp.float32)
    outputs = {name: wp.zeros(COUNT, dtype=dtype, device="cpu") for name, dtype in names}
    outputs["rotated"] = wp.zeros((COUNT, 4), dtype=wp.vec3f, device="cpu")
    arguments = [
        array(inputs["along"], wp.vec3f), array(inputs["views"], wp.vec3f), sky, table, reflection,
        array(inputs["footprints"], Footprint), sky_sum.open_t(*map(int, words)),
    ]  # fmt: skip
    wp.launch(call_functions, COUNT, arguments, list(outputs.values()), device="cpu")
    return inputs, {name: values.numpy() for name, values in outputs.items()}


def test_directions_return_from_the_octahedral_map(results):
    inputs, computed = results
    np.testing.assert_allclose(computed["back"], inputs["along"], atol=1e-6)
    size = np.abs(inputs["along"]).sum(axis=1)
    upper = inputs["along"][:, 1] > 0.0
    expected = 0.5 + 0.5 * inputs["along"][:, [0, 2]] / size[:, None]
    np.testing.assert_allclose(computed["places"][upper], expected[upper], atol=1e-6)
    assert np.all(np.abs(computed["places"][~upper] - 0.5).sum(axis=1) > 0.5 - 1e-6)


def test_the_share_above_the_horizon_is_that_of_a_truncated_normal_distribution(results):
    inputs, computed = results
    radius = inputs["views"][:, 0] + 0.5
    inside = (1.0 - radius) / 0.3
    share, moved, per_cosine = computed["horizon"].T
    far, cut = inside > 2.5, (np.abs(inside) < 2.4) & (radius > 0.3)
    assert np.count_nonzero(far) > 10
    np.testing.assert_array_equal(computed["horizon"][far], 1.0)
    distribution = truncnorm(-np.inf, inside[cut], loc=radius[cut], scale=0.3)
    np.testing.assert_allclose(share[cut], 0.5 * np.vectorize(math.erfc)(-inside[cut] / math.sqrt(2.0)), rtol=1e-5)
    np.testing.assert_allclose(moved[cut], np.maximum(distribution.mean(), 0.0) / radius[cut], rtol=1e-4)
    assert np.all((per_cosine[cut] > 1.0) & (per_cosine[cut] < 1.75))


def test_gains_are_those_of_the_library_for_a_light_of_a_size(results):
    inputs, computed = results
    expected = reflectance_factors.gain(
        inputs["along"], inputs["views"], normal=0.04, masking=True, per_light_cosine=True
    )  # fmt: skip
    np.testing.assert_allclose(computed["gains"], expected, rtol=1e-4)


def test_axes_of_a_footprint_are_those_of_its_covariance(results):
    inputs, computed = results
    jacobians = inputs["footprints"].reshape(-1, 2, 2)
    values, vectors = np.linalg.eigh(np.swapaxes(jacobians, 1, 2) @ jacobians)
    np.testing.assert_allclose(computed["axes"][:, :2], values[:, ::-1], rtol=1e-3, atol=1e-5)
    major = vectors[:, :, 1] * np.sqrt(values[:, 1:])
    cosines = np.abs(np.sum(major * computed["axes"][:, 2:], axis=1)) / values[:, 1]
    np.testing.assert_allclose(cosines, 1.0, atol=1e-3)


def test_maps_are_linear_between_texels_and_between_levels(results):
    """The sky is turned about +y; levels are blurred by four times as much each."""
    inputs, computed = results
    x, y, z = inputs["along"].T
    turned = np.stack([math.cos(0.4) * x - math.sin(0.4) * z, y, math.sin(0.4) * x + math.cos(0.4) * z], axis=1)
    size = np.abs(turned).sum(axis=1)
    upper = turned[:, 1] > 0.0
    places = 0.5 + 0.5 * turned[:, [0, 2]] / size[:, None]
    levels = np.clip(0.5 * np.log2(inputs["views"][:, 2] / 0.01), 0.0, 1.0)
    expected = (1.0 + levels)[:, None] * affine(*places.T)
    assert np.count_nonzero(upper) > 50
    np.testing.assert_allclose(computed["light"][upper], expected[upper], rtol=1e-4)


def test_rows_are_linear_between_entries_of_w(results):
    inputs, computed = results
    places = 8.0 * inputs["views"][:, 2]
    before = np.minimum(places.astype(int), 7)
    t = (places - before)[:, None, None]
    rows = inputs["rows"][1, 2]
    np.testing.assert_allclose(computed["rows"], (1.0 - t) * rows[before] + t * rows[before + 1], rtol=1e-4, atol=1e-5)


def test_visibility_is_linear_between_texels_and_folds_at_the_edge(results):
    inputs, computed = results
    padded = np.zeros((18, 18))
    padded[1:-1, 1:-1] = inputs["bits"]
    # Beyond an edge of an octahedral map lies the edge itself, the other way round.
    padded[0, 1:-1], padded[-1, 1:-1] = inputs["bits"][0, ::-1], inputs["bits"][-1, ::-1]
    padded[1:-1, 0], padded[1:-1, -1] = inputs["bits"][::-1, 0], inputs["bits"][::-1, -1]
    padded[[0, 0, -1, -1], [0, -1, 0, -1]] = inputs["bits"][[-1, -1, 0, 0], [-1, 0, -1, 0]]
    place = 16.0 * computed["places"].astype(np.float64) + 0.5
    x, z = place.astype(int).T
    s, t = (place - place.astype(int)).T
    upper = (1.0 - s) * padded[z, x] + s * padded[z, x + 1]
    lower = (1.0 - s) * padded[z + 1, x] + s * padded[z + 1, x + 1]
    np.testing.assert_allclose(computed["shares"], (1.0 - t) * upper + t * lower, atol=1e-4)


def test_a_frame_that_turns_keeps_the_view(results):
    inputs, computed = results
    axes, view = computed["rotated"][:, :3], computed["rotated"][:, 3]
    np.testing.assert_allclose(axes @ np.swapaxes(axes, 1, 2), np.broadcast_to(np.eye(3), (COUNT, 3, 3)), atol=1e-5)
    # The frame before has its tangent along y, its bitangent along z and its normal along x.
    towards = inputs["views"][:, [2, 0, 1]]
    normals = np.column_stack([np.ones(COUNT), 0.3 * inputs["along"][:, :2]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    np.testing.assert_allclose(axes[:, 2], normals, atol=1e-5)
    above = np.sum(normals * towards, axis=1) > 0.05
    np.testing.assert_allclose(np.einsum("nij,nj->ni", axes, towards)[above], view[above], atol=1e-5)
    assert np.all(axes[:, 1, 2] > 0.0)


def test_mirror_directions_are_those_of_reflected_views(rng):
    """The scattering vector is −2 cos θ along the normal of the surface; the light has its direction in the world."""
    views, normals, hit = hemisphere(rng, COUNT), hemisphere(rng, COUNT), np.arange(COUNT) % 10 > 0
    pixels = Pixels()
    pixels.hit, pixels.to_view, pixels.normal = array(hit, wp.int32), array(views, wp.vec3f), array(normals, wp.vec3f)
    vectors, to_lights = array(np.ones((COUNT, 3)), wp.vec3d), array(np.ones((COUNT, 3)), wp.vec3f)
    gains, illuminated = array(np.full(COUNT, 7.0), wp.float32), array(np.zeros(COUNT), wp.bool)
    nothing = array(np.empty((0, 3)), wp.vec3f), array([], wp.float64)
    outputs = [vectors, to_lights, gains, *nothing, illuminated]
    wp.launch(sky_sum.mirror_directions, (2, 1), [pixels, 0.0, True, True, 0, COUNT // 2], outputs, device="cpu")
    cosines = np.sum(views * normals, axis=1, keepdims=True)
    np.testing.assert_allclose(to_lights.numpy(), hit[:, None] * (2.0 * cosines * normals - views), atol=1e-6)
    np.testing.assert_allclose(vectors.numpy(), hit[:, None] * cosines * (0.0, 0.0, -2.0), atol=1e-6)
    np.testing.assert_array_equal(gains.numpy(), hit)


@pytest.mark.parametrize("masking", [True, False])
def test_the_mirror_lobe_near_the_horizon_sends_its_mean_gain(masking):
    """Under an even sky, from views at any azimuth: the lobe's mean of the gain, times the share above the horizon."""
    lobe, sky, table, reflection = 0.02, octahedral_maps.SkyMap(), sky_sum.SkyTable(), Reflection()
    sky.texels, sky.firsts = array(np.tile([1.0, 1.0, 1.0, 0.0], (18, 1)), wp.vec4f), array([0, 9], wp.int32)
    sky.sides, sky.variance, sky.turn = array([1, 1], wp.int32), 0.01, wp.vec2f(1.0, 0.0)
    table.nodes, table.entries = wp.zeros(1, dtype=wp.vec4f, device="cpu"), 2
    table.rows = array(np.tile(np.eye(3), (2, 1, 1)), wp.mat33f)
    reflection.normal_reflectance, reflection.masking = 0.04, masking
    radii, azimuths = np.repeat([0.9, 0.95, 0.98], 4), np.tile([0.3, 1.9, 3.5, 5.5], 3)
    around = np.column_stack([np.cos(azimuths), np.sin(azimuths)])
    views = np.column_stack([radii[:, None] * around, np.sqrt(1.0 - radii**2)])
    colours = wp.zeros(len(views), dtype=wp.vec3f, device="cpu")
    wp.launch(send_near_horizon, len(views), [array(views, wp.vec3f), sky, table, reflection, lobe], [colours])
    # The gain does not depend on the azimuth; float32 rounds it.
    np.testing.assert_allclose(colours.numpy(), np.repeat(colours.numpy()[::4], 4, axis=0), rtol=1e-5)
    for view, radius, colour in zip(views, radii, colours.numpy(), strict=True):
        away = np.linspace(radius - 2.5 * lobe, min(radius + 2.5 * lobe, 1.0), 4001)[:-1]
        lights = np.column_stack([-away[:, None] * view[:2] / radius, np.sqrt(1.0 - away**2)])
        gains = reflectance_factors.gain(
            lights, np.broadcast_to(view, lights.shape), normal=0.04, masking=masking, per_light_cosine=True
        )
        widths = lobe * np.array([1.03, 1.01, 0.83])[:, None]
        means = np.average(np.broadcast_to(gains, (3, 4000)), axis=1, weights=norm.pdf((away - radius) / widths))
        np.testing.assert_allclose(colour, means * norm.cdf((1.0 - radius) / widths[:, 0]), rtol=0.03)
