"""Disc lights: distribution of their samples, and pictures and shadows compared with many directional lights."""

import dataclasses
import math

import numpy as np
import pytest
import trimesh
import warp as wp
from conftest import launch, relative_errors, slow

import warpdiff as wd
from bench.truth.sky_sums import SkySums
from warpdiff.kernels.disc_samples import MIRROR_SHARE, draw_disc
from warpdiff.kernels.light_samples import Lights
from warpdiff.kernels.structs import Pixels
from warpdiff.lights.base import orthonormal_pair

SHORT, LONG = wd.Coherence(sigma_um=4.0), wd.Coherence(sigma_um=8.0)
VIEW = wd.View((0, 2, 4), (0, 0, 0), width=56, height=42)
TOWARDS = (0.2, 0.5, 1.0)


@pytest.fixture(scope="module")
def fingers():
    return wd.gratings.fingers(size_um=12.8, pitch_um=0.08)


def points_of(light, count):
    """Return many directional lights, in concentric rings (annuli) on a disc light, which they replace."""
    axis, radius = np.asarray(light.to_light), math.radians(light.angular_diameter_deg / 2.0)
    aside = np.cross(axis, (1.0, 0.0, 0.0))
    aside /= np.linalg.norm(aside)
    other = np.cross(axis, aside)
    rings = round(math.sqrt(count / math.pi))
    result = []
    for ring in range(rings):
        # The disc is divided into rings (annuli) of equal width. The number of lights in a ring is proportional to the
        # length of the ring. These lights share the solid angle of the ring equally.
        inner, outer = radius * ring / rings, radius * (ring + 1) / rings
        middle, points = 0.5 * (inner + outer), max(round(2.0 * math.pi * (ring + 0.5)), 3)
        share = (math.cos(inner) - math.cos(outer)) / (1.0 - math.cos(radius)) / points
        for k in range(points):
            around = 2.0 * math.pi * (k + 0.5 * (ring % 2)) / points
            across = math.cos(around) * aside + math.sin(around) * other
            towards = math.cos(middle) * axis + math.sin(middle) * across
            result.append(wd.DirectionalLight(tuple(towards), power=share))
    return result


@pytest.mark.parametrize("diameter", [0.53, 5.0, 40.0])
def test_the_single_lobe_has_the_variance_of_the_disc(diameter):
    lobe = wd.DirectionalLight(TOWARDS, power=3.0, angular_diameter_deg=diameter).lobes()[0]
    assert lobe.power == 3.0
    np.testing.assert_allclose(lobe.deviations @ lobe.to_light, 0.0, atol=1e-12)
    # The standard deviation of points on a uniform disc along one axis is half of the disc's radius.
    sizes = np.linalg.norm(lobe.deviations, axis=1)
    np.testing.assert_allclose(sizes, 0.5 * math.radians(diameter / 2.0), rtol=1e-9)


def drawn_towards(diameter, *, normal, view, lobe, extent=0.0):
    """Return directions that the kernel draws on a disc light, and their weights, for 64 × 64 cells of one pixel.

    ``extent`` is the standard deviation of the Gaussian source that a sample represents, in radii of the disc.
    """
    count, light = 64 * 64, wd.DirectionalLight(TOWARDS, angular_diameter_deg=diameter).lobes()[0]

    def repeated(value):
        return wp.array(np.tile(value, (count, 1)), dtype=wp.vec3f, device="cpu")

    lights, pixels = Lights(), Pixels()
    lights.places = wp.array([(*light.to_light, 0.0)], dtype=wp.vec4d, device="cpu")
    lights.deviations = wp.array(light.deviations[None].astype(np.float32), dtype=wp.vec3f, device="cpu")
    pixels.hit = wp.full(count, 1, dtype=wp.int32, device="cpu")
    tangents = orthonormal_pair(np.asarray(normal))
    pixels.tangent, pixels.bitangent = repeated(tangents[0]), repeated(tangents[1])
    pixels.normal, pixels.to_view = repeated(normal), repeated(view)
    towards = wp.zeros(count, dtype=wp.vec4f, device="cpu")
    tiles = wp.array([5], dtype=wp.int32, device="cpu")
    inputs = [lights, 0, extent, lobe, pixels, tiles, 16, 64, 0, 1, 0, count]
    launch(draw_disc, (1, 1), inputs, [towards], device="cpu")
    return towards.numpy()


@pytest.mark.parametrize("diameter", [3.0, 60.0])
@pytest.mark.parametrize("towards_mirror", [None, 0.4, 0.95])
def test_weighted_directions_are_uniform_over_the_disc(diameter, towards_mirror):
    """Weighted samples of a disc must be distributed uniformly over the disc.

    This must also hold if some samples are drawn near a mirror direction that is on the disc.
    """
    axis, radius = np.asarray(TOWARDS) / np.linalg.norm(TOWARDS), math.radians(diameter / 2.0)
    normal = view = mirror = -axis
    if towards_mirror is not None:
        aside = orthonormal_pair(axis)[0]
        mirror = axis * math.cos(towards_mirror * radius) + aside * math.sin(towards_mirror * radius)
        normal = mirror + 0.3 * orthonormal_pair(mirror)[1]
        normal /= np.linalg.norm(normal)
        view = 2.0 * (normal @ mirror) * normal - mirror
    lobe = 0.2 * radius
    towards = drawn_towards(diameter, normal=normal, view=view, lobe=lobe)
    np.testing.assert_allclose(np.linalg.norm(towards[:, :3], axis=1), 1.0, atol=1e-5)
    weights = towards[:, 3]
    inside = weights > 0.0
    cosines = towards[inside, :3] @ axis
    assert np.all(cosines >= math.cos(radius) - 1e-6)
    if towards_mirror is None:
        np.testing.assert_array_equal(weights, 1.0)
    else:
        # A direction that is drawn around the mirror direction is within one standard deviation of the zeroth order's
        # lobe with a probability of 39 %. Such directions are 12 % of all directions.
        away = towards[:, :3] - mirror
        away -= (away @ normal)[:, None] * normal
        assert np.mean(np.linalg.norm(away, axis=1) < lobe) > 0.1
    # ``share`` is the part of the disc's solid angle that is nearer to its centre than a sample. If the weighted
    # samples are uniform, the weighted histograms of ``share`` and of the azimuth are flat.
    share = (1.0 - cosines) / (1.0 - math.cos(radius))
    around = np.arctan2(*(towards[inside, :3] @ orthonormal_pair(axis).T).T)
    count = len(towards)
    assert weights.sum() / count == pytest.approx(1.0, abs=0.02)
    for values, ends in ((share, (0.0, 1.0)), (around, (-math.pi, math.pi))):
        result = np.histogram(values, 8, ends, weights=weights[inside])[0] / count
        np.testing.assert_allclose(result, 0.125, atol=0.012)


def test_directions_near_the_mirror_direction_spread_as_the_lobe_and_the_source_of_a_sample():
    """Of the directions around the mirror direction, 39 % must be within one standard deviation, as in a Gaussian.

    The variance is the sum of the variances of the zeroth order's lobe and of the source that a sample represents. The
    other directions are uniform over a disc, which is smaller than the light because samples have an extent.
    """
    axis, radius = np.asarray(TOWARDS) / np.linalg.norm(TOWARDS), math.radians(5.0)
    lobe, extent = 0.01, 0.1
    towards = drawn_towards(10.0, normal=axis, view=axis, lobe=lobe, extent=extent)
    spread, edge = math.hypot(lobe, extent * radius), radius * math.sqrt(1.0 - 4.0 * extent**2)
    near = np.mean(np.linalg.norm(towards[:, :3] - axis, axis=1) < spread)
    expected = MIRROR_SHARE * (1.0 - math.exp(-0.5)) + (1.0 - MIRROR_SHARE) * (spread / edge) ** 2
    assert near == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(("diameter", "count", "median", "most"), [(5.0, 120, 0.02, 0.1), slow(20.0, 320, 0.02, 0.1)])
def test_a_disc_light_equals_many_directional_lights(diameter, count, median, most, fingers):
    light = wd.DirectionalLight(TOWARDS, angular_diameter_deg=diameter)
    body = wd.meshes.tube(segments_along=48, segments_around=36)
    options = {"tolerance": 1e-1, "coherence": SHORT, "pigment": 0.0, "shadows": False, "refine": False}
    exact = wd.shade(body, fingers, points_of(light, count), VIEW, **options)
    result = wd.shade(body, fingers, light, VIEW, plan=exact.plan, **options | {"coherence": None})
    visible = exact.illuminated & result.illuminated
    errors = relative_errors(result.xyz[visible], exact.xyz[visible])
    assert np.median(errors) < median
    assert np.percentile(errors, 90.0) < most
    # A picture under a directional light without an angular diameter must be clearly different. Otherwise the
    # comparison with the disc light would be meaningless.
    options |= {"coherence": None, "plan": exact.plan}
    point = wd.shade(body, fingers, wd.DirectionalLight(TOWARDS), VIEW, **options)
    others = relative_errors(point.xyz[visible], exact.xyz[visible])
    assert np.percentile(errors, 90.0) < 0.7 * np.percentile(others, 90.0)


@pytest.mark.filterwarnings("ignore:plan is used beyond")
def test_a_wide_light_has_a_soft_shadow(fingers):
    """Where a tube occludes the centre of a disc light, the edge of the disc must still illuminate some pixels."""
    body = wd.meshes.tube(segments_along=48, segments_around=36)
    view = wd.View((0, 3.4, 4), (0, 0, 0), fov_y_deg=23, width=48, height=36)
    options = {"tolerance": 2e-1, "coherence": SHORT, "pigment": 0.0, "refine": False}
    towards = (0.6, 0.25, -0.1)
    point, wide = (
        wd.shade(body, fingers, wd.DirectionalLight(towards, angular_diameter_deg=size), view, **options)
        for size in (0.0, 40.0)
    )
    assert np.count_nonzero(wide.illuminated & ~point.illuminated) > 20
    renderer = wd.Renderer(body, fingers, wd.DirectionalLight(towards), view, plan=wide.plan, pigment=0.0, refine=False)
    renderer.draw(wd.DirectionalLight(towards, angular_diameter_deg=40.0))
    # The picture ``wide`` uses a colour table for the directions that occur in it. The renderer uses a colour table for
    # the whole hemisphere. Their colours therefore differ by up to 5 % of the largest colour.
    assert np.abs(renderer.image().xyz - wide.xyz).max() < 5e-2 * wide.xyz.max()


def test_the_luminance_in_a_penumbra_is_the_visible_share_of_the_disc():
    """In a penumbra, the luminance must be the share of the disc light that is visible from the pixel.

    The straight edge of a plate divides the disc into a visible and an occluded part.
    """
    floor, plate = trimesh.creation.box((4, 4, 0.1)), trimesh.creation.box((40, 20, 0.05))
    body = trimesh.util.concatenate([floor, plate.apply_translation((0, 10.0, 3.0))])
    body.visual.vertex_colors = np.full((len(body.vertices), 4), 200, dtype=np.uint8)
    view = wd.View((0, -3, 3), (0, 0, 0), fov_y_deg=30, width=24, height=48)
    light = wd.DirectionalLight((0.0, 0.0, 1.0), angular_diameter_deg=10.0)
    flat = wd.HeightField(np.zeros((8, 8)), 0.09)
    options = {"tolerance": 5e-2, "coherence": SHORT, "tangents": (1.0, 0.1, 0.05), "smooth": False}
    # Only the light that the base colour of the mesh (pigment) reflects is compared, because the base colour reflects
    # light from all parts of the disc equally.
    shown, bare = (
        wd.shade(body, flat, light, view, **options, shadows=each, pigment=1.0).xyz
        - wd.shade(body, flat, light, view, **options, shadows=each, pigment=0.0).xyz
        for each in (True, False)
    )
    frame = view.frame()
    y = frame.half_height * (1.0 - 2.0 * (np.arange(48) + 0.5) / 48)
    along = y[:, None] * frame.up - frame.back
    on_floor = np.asarray(view.eye) + (0.05 - view.eye[2]) / along[:, 2:] * along
    # Distance of the plate's edge from the centre of the disc, in radii of the disc.
    edge = np.arctan2(0.0 - on_floor[:, 1], 3.0 - 0.025 - 0.05) / math.radians(5.0)
    cut = np.clip(edge, -1.0, 1.0)
    visible = 0.5 + (np.arcsin(cut) + cut * np.sqrt(1.0 - cut**2)) / math.pi
    rows = np.flatnonzero((visible > 0.05) & (visible < 0.95))
    assert len(rows) >= 6
    result = shown[rows, 8:16, 1].sum(axis=1) / bare[rows, 8:16, 1].sum(axis=1)
    np.testing.assert_allclose(result, visible[rows], atol=0.04)


@pytest.mark.slow
def test_the_best_table_is_used_if_none_meets_the_tolerance_for_single_directions():
    """If no colour table meets the tolerance for single directions, as for this grating, the best table must be used.

    The call must warn of it.
    """
    blazed, light = wd.gratings.blazed(1.5, 0.3), wd.DirectionalLight((0.5, 0.3, 1.0), angular_diameter_deg=10.0)
    view = dataclasses.replace(VIEW, width=96, height=72)
    with pytest.warns(wd.WarpdiffWarning, match="cannot meet tolerance=0.03"):
        image = wd.shade(wd.meshes.disc(), blazed, light, view, coherence=LONG, tolerance=3e-2, pigment=0.0)
    assert image.plan.error > 3e-2
    sums = SkySums(wd.meshes.disc(), blazed, view, LONG)
    inside = sums.interior()
    bright = inside[np.argsort(image.xyz[tuple(inside.T)][:, 1])[-40::8]]
    exact = sums.under_disc(bright, light, 64, 0)
    errors = np.linalg.norm(image.xyz[tuple(bright.T)] - exact, axis=1) / np.linalg.norm(exact, axis=1)
    # For single directions, the colour table reports an error of 0.09. The random directions to the disc light add
    # noise to this error.
    assert np.median(errors) < 0.06
    assert errors.max() < 0.2


def test_disc_lights_require_footprints_and_exclude_a_source_coherence(fingers):
    light = wd.DirectionalLight(TOWARDS, angular_diameter_deg=3.0)
    view = wd.View((0, 0, 4), (0, 0, 0), width=8, height=6)
    of_source = {"coherence": wd.Coherence("source")}
    with pytest.raises(ValueError, match="kind 'source', whose diameter is that of all lights"):
        wd.shade(wd.meshes.disc(), fingers, light, view, **of_source)
    for options in ({"footprint": False}, {"coherence": wd.Coherence("centred")}, {"method": "direct"}):
        with pytest.raises(
            ValueError, match=r"lights\[0\] has an extent and requires footprints, .* got DirectionalLight\(.*=3\.0\)"
        ):
            wd.shade(wd.meshes.disc(), fingers, light, view, **options)


@pytest.mark.parametrize(("diameter", "fov_y_deg"), [(20.0, 24.0), slow(4.0, 8.0)])
def test_the_reflected_rim_of_a_disc_light_is_sharp(diameter, fov_y_deg, square):
    """A mirror must show a disc light whose rim is blurred only by the angular spread due to the coherence window.

    The expected colours are sums over points of the disc.
    """
    flat = wd.HeightField(np.zeros((32, 32)), 0.09)
    light = wd.DirectionalLight((0, 0, 1), angular_diameter_deg=diameter)
    view = wd.View((0, 0, 4), (0, 0, 0), fov_y_deg=fov_y_deg, width=48, height=36)
    image = wd.shade(square, flat, light, view, coherence=LONG, tolerance=0.1, pigment=0.0)
    # All rays that contribute to the compared pixels hit the square mesh.
    places = np.array([[18, column] for column in range(24, 43)])
    exact = SkySums(square, flat, view, LONG).under_disc(places, light, 64, 0)
    size = np.maximum(np.linalg.norm(exact, axis=1), 1e-3 * np.percentile(image.xyz[..., 1], 99.0))
    errors = np.linalg.norm(image.xyz[tuple(places.T)] - exact, axis=1) / size
    # At least three of the compared pixels are outside of the reflection of the disc.
    assert np.count_nonzero(exact[:, 1] < 0.1 * exact[0, 1]) >= 3
    # Each random direction to a disc light counts as a narrow Gaussian source. This blurs the rim of the disc slightly
    # more than the exact sum over points of the disc does.
    assert errors.max() < 0.6
    assert np.median(errors) < 0.05


def test_the_luminance_of_a_mirror_under_a_disc_light_follows_its_formula(square):
    """Y in the mirror direction of the centre of a disc light must equal a closed form.

    The closed form is the share of the light within the angular spread (lobe) due to the coherence window.
    """
    flat = wd.HeightField(np.zeros((32, 32)), 0.09)
    view = wd.View.orthographic((0, 0, 4), (0, 0, 0), extent_y=1.0, width=8, height=6)
    light = wd.DirectionalLight((0.0, 0.0, 1.0), angular_diameter_deg=4.0)
    image = wd.shade(square, flat, light, view, coherence=LONG, tolerance=0.1, pigment=0.0, refine=False)
    # Standard deviations of directions [radians]: `alpha` is that of the light, half of its angular radius. √`lobe2` is
    # that of the lobe that reflects a single direction, λ/(2√2πσ).
    middle, alpha = image.xyz[3, 4], math.radians(2.0) / 2.0
    lobe2 = (0.55 / (2.0 * math.sqrt(2.0) * math.pi * LONG.sigma_um)) ** 2
    assert middle[1] == pytest.approx(lobe2 / (lobe2 + alpha**2), rel=0.2)
