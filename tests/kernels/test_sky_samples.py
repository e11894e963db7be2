"""Samples of a sky: stratification, densities, gains, scattering vectors, and interpolation between cells of the sky.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

import math

import numpy as np
import pytest
import warp as wp
from conftest import hemisphere, launch

from warpdiff.kernels import compile_options, sample_sequence, sky_samples
from warpdiff.kernels.light_samples import Reflection
from warpdiff.kernels.structs import Footprint, Pixels, SurfaceArrays, Textures, Transparency
from warpdiff.lights.sky_grid import sample_grid
from warpdiff.optics import reflectance_factors

COUNT = 1 << 14
# Cumulative probabilities of a distribution. Because of rounding, their last value may be below 1, as here.
SHORT = [0.3, 0.3, 0.9]


def array(values, dtype):
    return wp.array(values, dtype=dtype, device="cpu")


@wp.kernel(module="unique", module_options=compile_options.options())
def call_functions(
    table: sky_samples.SkyDistribution, sky: sky_samples.Sky, reflection: Reflection, cdf: wp.array(dtype=wp.float32),
    along: wp.array(dtype=wp.vec3f), views: wp.array(dtype=wp.vec3f), points: wp.array(dtype=wp.vec2f),
    indices: wp.array(dtype=wp.uint32), drawn_uv: wp.array(dtype=wp.vec2f), uv_densities: wp.array(dtype=wp.float32),
    drawn: wp.array(dtype=wp.vec3f), densities: wp.array(dtype=wp.float32), powers: wp.array(dtype=wp.vec3f),
    gains: wp.array(dtype=wp.float32), steps: wp.array(dtype=wp.int32),
):  # fmt: skip
    i = wp.tid()
    points[i] = sample_sequence.light_point(wp.uint32(i))
    indices[i] = sample_sequence.morton_index(i % 128, i // 128)
    drawn_uv[i] = sky_samples.draw_uv(table, points[i])
    uv_densities[i] = sky_samples.density_of_uv(table, drawn_uv[i])
    drawn[i] = sky_samples.draw_direction(table, sky, points[i])
    place = sky_samples.place_in_sky(sky, drawn[i])
    densities[i] = sky_samples.density_of_direction(table, place)
    powers[i] = sky_samples.power_at(sky, sky_samples.place_in_sky(sky, along[i]))
    steps[i] = sky_samples.find_step(cdf, 0, cdf.shape[0], points[i][0])
    uv = wp.vec2f(-along[i][0] - views[i][0], -along[i][1] - views[i][1])
    gains[i] = sky_samples.gain_over_cosine(reflection, 0, uv, along[i], views[i])


@pytest.fixture(scope="module")
def results():
    """Return inputs and outputs of the sky-sampling functions for a small table of random probabilities."""
    rng = np.random.default_rng(5)
    table, sky, reflection = sky_samples.SkyDistribution(), sky_samples.Sky(), Reflection()
    rings = np.array([0.2, 0.3, 0.5])
    spokes = [rng.dirichlet(np.full(count, 2.0)) for count in (4, 8, 16)]
    table.ring_cdf, table.starts = array(np.cumsum(rings), wp.float32), array([0, 4, 12, 28], wp.int32)
    table.spoke_cdf = array(np.concatenate([np.cumsum(shares) for shares in spokes]), wp.float32)
    table.least_log, table.per_log = math.log(0.25), 2.0 / math.log(3.0)
    sizes = [math.pi * 0.25**2 / 4.0, 2.0 * math.pi / table.per_log / 8.0, 2.0 * math.pi / table.per_log / 16.0]
    densities = [ring * shares / size for ring, shares, size in zip(rings, spokes, sizes, strict=True)]
    table.densities = array(np.concatenate(densities), wp.float32)
    blocks = rng.dirichlet(np.full(18, 1.0)).reshape(3, 6)
    rows = blocks.sum(axis=1)
    solid = -np.diff(np.cos(np.arange(4) * math.pi / 3.0))[:, None] * math.pi / 3.0
    table.row_cdf = array(np.cumsum(rows), wp.float32)
    table.column_cdf = array(np.cumsum(blocks, axis=1) / rows[:, None], wp.float32)
    table.block_densities = array(blocks / solid, wp.float32)
    grid = rng.uniform(size=(8, 16, 3))
    sky.powers, sky.turn = array(grid, wp.vec3f), 0.3
    reflection.normal_reflectances, reflection.masking = array([0.04], wp.float64), True
    reflection.surfaces = array([0], wp.int32)
    along, views = hemisphere(rng, COUNT), hemisphere(rng, COUNT)
    types = {
        "points": wp.vec2f, "indices": wp.uint32, "drawn_uv": wp.vec2f, "uv_densities": wp.float32, "drawn": wp.vec3f,
        "densities": wp.float32, "powers": wp.vec3f, "gains": wp.float32, "steps": wp.int32,
    }  # fmt: skip
    outputs = {name: wp.zeros(COUNT, dtype=dtype, device="cpu") for name, dtype in types.items()}
    inputs = [table, sky, reflection, array(SHORT, wp.float32), array(along, wp.vec3f), array(views, wp.vec3f)]
    launch(call_functions, COUNT, inputs, list(outputs.values()), device="cpu")
    given = {"along": along, "views": views, "grid": grid, "rings": rings, "spokes": spokes, "blocks": blocks}
    return given, {name: values.numpy() for name, values in outputs.items()}


@pytest.mark.parametrize("size", [4, 16, 64, 1024])
def test_points_of_each_square_of_cells_are_stratified(size, results):
    """The random points must form a (0, 2)-sequence, so that the samples of each square of cells are stratified.

    Let the points of a sequence be split into groups of 2ⁿ consecutive points, and the unit square into 2ⁿ equal boxes.
    In a (0, 2)-sequence, each group has one point in each box, for any number of columns of boxes that is a power of 2.
    Points are assigned to subpixel cells along a Morton curve. For even n, the points of a group therefore belong to a
    square of cells.
    """
    for points in results[1]["points"].reshape(-1, size, 2)[:64]:
        for across in 2 ** np.arange(int(math.log2(size)) + 1):
            boxes = (points * [across, size // across]).astype(int)
            assert len(np.unique(boxes, axis=0)) == size


def test_indices_of_cells_follow_a_morton_curve(results):
    indices = results[1]["indices"].reshape(128, 128)
    np.testing.assert_array_equal(np.sort(indices.ravel()), np.arange(COUNT))
    np.testing.assert_array_equal(indices[:4, :4], [[0, 1, 4, 5], [2, 3, 6, 7], [8, 9, 12, 13], [10, 11, 14, 15]])
    # Along a Morton curve, the cells of each square have consecutive indices, if the side of the square is a power of 2
    # and its position is a multiple of the side.
    assert np.all(np.ptp(indices.reshape(16, 8, 16, 8), axis=(1, 3)) == 63)


def test_points_are_drawn_in_proportion_to_their_density(results):
    given, computed = results
    radius = np.hypot(*computed["drawn_uv"].T)
    ring = np.where(radius < 0.25, 0, 1 + (np.log(radius / 0.25) * 2.0 / math.log(3.0)).astype(int))
    turn = np.arctan2(*computed["drawn_uv"].T[::-1]) / (2.0 * math.pi) % 1.0
    for index, (share, spokes) in enumerate(zip(given["rings"], given["spokes"], strict=True)):
        inside = ring == index
        assert inside.mean() == pytest.approx(share, abs=2e-3)
        counts = np.bincount((turn[inside] * len(spokes)).astype(int), minlength=len(spokes))
        np.testing.assert_allclose(counts / inside.sum(), spokes, atol=3e-3)
    # Points (u, v) are drawn with a known density. The mean of f/density over these points is the integral of f over
    # the disc |(u, v)| < r: πr² for f = 1, and πr⁴/2 for f = |(u, v)|².
    farthest = 0.25 * 3.0
    per_density = 1.0 / computed["uv_densities"]
    assert per_density.mean() == pytest.approx(math.pi * farthest**2, rel=0.01)
    assert (radius**2 * per_density).mean() == pytest.approx(0.5 * math.pi * farthest**4, rel=0.01)


def test_the_last_step_is_drawn_if_rounding_makes_the_sum_of_probabilities_too_small(results):
    computed = results[1]
    expected = np.minimum(np.searchsorted(SHORT, computed["points"][:, 0], side="right"), len(SHORT) - 1)
    assert (computed["points"][:, 0] > SHORT[-1]).any()
    np.testing.assert_array_equal(computed["steps"], expected)


def test_directions_are_drawn_in_proportion_to_their_density(results):
    given, computed = results
    drawn = computed["drawn"]
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0, atol=1e-6)
    row = (np.arccos(np.clip(drawn[:, 1], -1.0, 1.0)) / math.pi * 3.0).astype(int)
    column = ((np.arctan2(drawn[:, 0], -drawn[:, 2]) / (2.0 * math.pi) + 0.5 + 0.3) % 1.0 * 6.0).astype(int)
    counts = np.bincount(6 * row + column, minlength=18)
    np.testing.assert_allclose(counts / COUNT, given["blocks"].ravel(), atol=3e-3)
    # Within a block, the directions are uniform in solid angle, thus in azimuth and in the vertical component.
    along = ((np.arctan2(drawn[:, 0], -drawn[:, 2]) / (2.0 * math.pi) + 0.5 + 0.3) % 1.0 * 6.0) % 1.0
    top, bottom = np.cos(math.pi / 3.0 * row), np.cos(math.pi / 3.0 * (row + 1))
    for within in (along, (top - drawn[:, 1]) / (top - bottom)):
        for block in np.flatnonzero(counts > 500):
            inside = within[6 * row + column == block]
            np.testing.assert_allclose(np.quantile(inside, (0.25, 0.5, 0.75)), (0.25, 0.5, 0.75), atol=0.06)
    per_density = 1.0 / computed["densities"]
    assert per_density.mean() == pytest.approx(4.0 * math.pi, rel=0.01)
    assert (drawn[:, 1] ** 2 * per_density).mean() == pytest.approx(4.0 / 3.0 * math.pi, rel=0.01)


def test_the_sky_is_linear_between_its_cells(results):
    given, computed = results
    expected = sample_grid(given["grid"], given["along"], 0.3 * 2.0 * math.pi)
    np.testing.assert_allclose(computed["powers"], expected, atol=2e-5)


def test_gains_equal_those_of_the_library_for_extended_lights(results):
    given, computed = results
    expected = reflectance_factors.gain(
        given["along"], given["views"], normal=0.04, masking=True, per_light_cosine=True
    )
    np.testing.assert_allclose(computed["gains"], expected, rtol=2e-4)


SKY_RAYS = 256


def frames_of_rays(rng):
    """Return tangents, bitangents and normals of random shading frames, shape (n, 3, 3); half are left-handed."""
    frames = np.linalg.qr(rng.normal(size=(SKY_RAYS, 3, 3)))[0]
    frames[::2, 1] *= -1.0
    assert np.mean(np.linalg.det(frames) > 0.0) == 0.5
    return frames


def pixels_with(frames, views, hit):
    """Return hits with shading frames, shape (n, 3, 3), and directions to the viewer in these frames, shape (n, 3)."""
    pixels = Pixels()
    pixels.hit, pixels.face = array(hit, wp.int32), array(np.zeros(len(hit)), wp.int32)
    pixels.tangent, pixels.bitangent, pixels.normal = (array(frames[:, axis], wp.vec3f) for axis in range(3))
    pixels.to_view = array(np.einsum("na,nac->nc", views, frames), wp.vec3f)
    return pixels


def test_each_sample_scatters_light_from_its_direction_in_the_sky(rng):
    """The scattering vector must be −ωi − ωr, where ωi is the direction of a sample in the sky.

    The geometry factors (gains) must be proportional to the power of the sky in this direction. Both must hold for
    either handedness of the frame, and for both distributions from which directions are drawn: by the colours of the
    surface, and by the sky.
    """
    frames, views = frames_of_rays(rng), hemisphere(rng, SKY_RAYS, 0.3)
    hit = rng.uniform(size=SKY_RAYS) < 0.9
    table, sky, reflection = sky_samples.SkyDistribution(), sky_samples.Sky(), Reflection()
    table.ring_cdf, table.starts = array([0.4, 1.0], wp.float32), array([0, 4, 8], wp.int32)
    table.spoke_cdf = array(2 * [0.25, 0.5, 0.75, 1.0], wp.float32)
    table.densities = array(np.ones(8), wp.float32)
    table.least_log, table.per_log = math.log(0.5), 1.0 / math.log(4.0)
    table.row_cdf, table.column_cdf = array([0.5, 1.0], wp.float32), array(2 * [[0.5, 1.0]], wp.float32)
    table.block_densities, table.sky_share = array(np.full((2, 2), 0.25 / math.pi), wp.float32), 0.5
    grid = np.ones((8, 16, 3))
    grid[..., 0] = rng.uniform(0.5, 2.0, (8, 16))
    sky.powers = array(grid, wp.vec3f)
    reflection.normal_reflectances, reflection.units = array([0.04], wp.float64), array([1.0], wp.float64)
    reflection.surfaces = array([0], wp.int32)
    vectors, lights = wp.zeros(SKY_RAYS, wp.vec3d, device="cpu"), wp.zeros(SKY_RAYS, wp.vec3f, device="cpu")
    gains, none = wp.full((3, SKY_RAYS), 7.0, wp.float32, device="cpu"), wp.zeros(SKY_RAYS, wp.vec3f, device="cpu")
    illuminated = wp.zeros(SKY_RAYS, wp.bool, device="cpu")
    inputs = [
        sky, table, pixels_with(frames, views, hit), array(np.zeros((SKY_RAYS, 4)), Footprint), np.eye(3), reflection,
        0, SurfaceArrays(), Textures(), Transparency(), 0, False, array([], wp.int32), 16, 1, 0, 1, 0, SKY_RAYS // 2,
    ]  # fmt: skip
    launch(sky_samples.sample_sky, (2, 1), inputs, [vectors, lights, gains, none, illuminated], device="cpu")
    light, gain = lights.numpy().astype(float), gains.numpy()
    np.testing.assert_array_equal(vectors.numpy()[~hit], 0.0)
    np.testing.assert_array_equal(gain[:, ~hit], 0.0)
    bright = gain[1] > 0.0
    np.testing.assert_array_equal(illuminated.numpy(), bright)
    assert np.all(light[hit & ~bright, 2] < 0.01)
    assert bright.sum() > 100
    np.testing.assert_allclose(np.linalg.norm(light[bright], axis=1), 1.0, atol=1e-5)
    np.testing.assert_allclose(vectors.numpy()[bright], -(light + views)[bright], atol=1e-5)
    along = np.einsum("na,nac->nc", light, frames)[bright]
    np.testing.assert_allclose(gain[0, bright] / gain[1, bright], sample_grid(grid, along, 0.0)[:, 0], rtol=1e-3)
    # A sky whose power is only in the last spectrum must illuminate the same hits, and a dark sky none.
    for power in (1.0, 0.0):
        sky.powers = array(grid * (0.0, 0.0, power), wp.vec3f)
        illuminated.zero_()
        launch(sky_samples.sample_sky, (2, 1), inputs, [vectors, lights, gains, none, illuminated], device="cpu")
        np.testing.assert_array_equal(illuminated.numpy(), bright & (power > 0.0))


def test_the_share_of_hits_and_the_mirror_directions_are_those_of_the_rays(rng):
    """Light from the mirror direction must have u = v = 0 and w = −2 cos θ.

    Each ray that hits the mesh must add the fraction of the pixel that it represents to the coverage.
    """
    frames, views = frames_of_rays(rng), hemisphere(rng, SKY_RAYS)
    hit = rng.uniform(size=SKY_RAYS) < 0.7
    vectors, gains = wp.zeros(SKY_RAYS, wp.vec3d, device="cpu"), wp.zeros(SKY_RAYS, wp.float32, device="cpu")
    before = rng.uniform(size=SKY_RAYS)
    colours, illuminated = array(np.ones((SKY_RAYS, 3)), wp.vec3f), array(np.ones(SKY_RAYS), wp.bool)
    coverage = array(before, wp.float64)
    for begins, resets in ((False, False), (False, True), (True, True)):
        inputs = [pixels_with(frames, views, hit), 0.25, begins, resets, 0, SKY_RAYS // 2]
        outputs = [vectors, gains, colours, coverage, illuminated]
        launch(sky_samples.mirror_deflections, (2, 1), inputs, outputs, device="cpu")
        np.testing.assert_allclose(vectors.numpy(), hit[:, None] * views[:, 2:] * (0.0, 0.0, -2.0), atol=1e-6)
        np.testing.assert_array_equal(gains.numpy(), hit)
        before = 0.25 * hit + (0.0 if begins else before)
        np.testing.assert_allclose(coverage.numpy(), before, atol=1e-12)
        np.testing.assert_array_equal(colours.numpy(), not resets)
        np.testing.assert_array_equal(illuminated.numpy(), not begins)
