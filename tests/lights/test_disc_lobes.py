"""Lights of a size: the lobes that stand for a disc, and pictures against a disc of many points."""

import math

import numpy as np
import pytest
import trimesh
from conftest import relative_errors, slow

import warpdiff as wd
from bench.truth.sky_sums import SkySums

SHORT = wd.Coherence(sigma_um=8.0)
VIEW = wd.View((0, 2, 4), (0, 0, 0), width=96, height=72)
TOWARDS = (0.2, 0.5, 1.0)


@pytest.fixture(scope="module")
def fingers():
    return wd.gratings.fingers(size_um=12.8, pitch_um=0.08)


def points_of(light, count):
    """Point lights that are even over the disc, on rings of as many as their lengths."""
    axis, radius = np.asarray(light.to_light), math.radians(light.angular_diameter_deg / 2.0)
    aside = np.cross(axis, (1.0, 0.0, 0.0))
    aside /= np.linalg.norm(aside)
    other = np.cross(axis, aside)
    rings = round(math.sqrt(count / math.pi))
    found = []
    for ring in range(rings):
        # Rings of equal width: their solid angles are shared out among as many points as their lengths take.
        inner, outer = radius * ring / rings, radius * (ring + 1) / rings
        middle, points = 0.5 * (inner + outer), max(round(2.0 * math.pi * (ring + 0.5)), 3)
        share = (math.cos(inner) - math.cos(outer)) / (1.0 - math.cos(radius)) / points
        for k in range(points):
            around = 2.0 * math.pi * (k + 0.5 * (ring % 2)) / points
            across = math.cos(around) * aside + math.sin(around) * other
            towards = math.cos(middle) * axis + math.sin(middle) * across
            found.append(wd.DirectionalLight(tuple(towards), power=share))
    return found


@pytest.mark.parametrize("sigma_um", [4.0, 16.25, None])
@pytest.mark.parametrize("diameter", [0.0, 0.53, 5.0, 12.0, 40.0, 60.0])
@pytest.mark.parametrize("single_lobe", [False, True])
def test_lobes_have_the_mean_and_the_variance_of_the_disc(diameter, sigma_um, single_lobe):
    light = wd.DirectionalLight(TOWARDS, power=3.0, angular_diameter_deg=diameter)
    lobes, axis = light.lobes(sigma_um, single_lobe=single_lobe), np.asarray(light.to_light)
    powers = np.array([each.power for each in lobes])
    assert powers.sum() == pytest.approx(3.0)
    cosines = np.clip([axis @ each.to_light for each in lobes], -1.0, 1.0)
    # Per axis: of where lobes lie, half of the mean squared distance, and of what they spread.
    spread2 = [0.0 if each.deviations is None else 0.5 * np.sum(each.deviations**2) for each in lobes]
    variance = np.average(0.5 * np.arccos(cosines) ** 2 + spread2, weights=powers)
    # Several are as even as the disc and end where it does.
    several = diameter > (5.0 if single_lobe else 1.5)
    r = max(math.radians(diameter / 2.0), 1e-3)
    of_disc = (2.0 * r * math.sin(r) + 2.0 * math.cos(r) - r * r * math.cos(r) - 2.0) / (1.0 - math.cos(r)) / 2.0
    window = 0.0 if sigma_um is None else (0.45 / (math.sqrt(8.0) * math.pi * sigma_um)) ** 2
    # As windows see it; ten lobes are closer to the disc's rim than to its width.
    assert variance + window == pytest.approx((of_disc if diameter else 0.0) + window, rel=0.05 if several else 0.01)
    assert len(lobes) >= 10 if several else len(lobes) == 1


@pytest.mark.parametrize(("diameter", "count", "median", "most"), [(5.0, 200, 0.02, 0.1), slow(20.0, 320, 0.02, 0.1)])
def test_a_light_of_a_size_is_a_disc_of_points(diameter, count, median, most, fingers):
    light = wd.DirectionalLight(TOWARDS, angular_diameter_deg=diameter)
    body = wd.meshes.tube(segments_along=48, segments_around=36)
    options = {"tolerance": 1e-1, "coherence": SHORT, "pigment": 0.0, "shadows": False, "refine": False}
    exact = wd.shade(body, fingers, points_of(light, count), VIEW, **options)
    found = wd.shade(body, fingers, light, VIEW, plan=exact.plan, **options | {"coherence": None})
    seen = exact.illuminated & found.illuminated
    errors = relative_errors(found.xyz[seen], exact.xyz[seen])
    assert np.median(errors) < median
    assert np.percentile(errors, 90.0) < most
    # Without its size the light is another one.
    options |= {"coherence": None, "plan": exact.plan}
    point = wd.shade(body, fingers, wd.DirectionalLight(TOWARDS), VIEW, **options)
    others = relative_errors(point.xyz[seen], exact.xyz[seen])
    assert np.percentile(errors, 90.0) < 0.7 * np.percentile(others, 90.0)


@pytest.mark.filterwarnings("ignore:plan is used beyond")
def test_a_wide_light_has_a_soft_shadow(fingers):
    """Behind the edge of a tube that hides the middle of a light, its rim still shines."""
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
    # Its table is for the whole hemisphere.
    assert np.abs(renderer.image().xyz - wide.xyz).max() < 5e-2 * wide.xyz.max()


def test_what_is_hidden_lobe_by_lobe_is_told(fingers):
    """A plate over a floor, whose penumbra is stairs: as high as lobes are bright."""
    floor, plate = trimesh.creation.box((4, 4, 0.1)), trimesh.creation.box((4, 1.5, 0.05))
    body = trimesh.util.concatenate([floor, plate.apply_translation((0, 1.2, 2.0))])
    body.visual.vertex_colors = np.full((len(body.vertices), 4), 200, dtype=np.uint8)
    view = wd.View((0, -3, 3), (0, 0, 0), fov_y_deg=40, width=48, height=36)
    light = wd.DirectionalLight((0.0, 0.5, 1.0), angular_diameter_deg=20.0)
    options = {"tolerance": 5e-2, "coherence": SHORT, "tangents": (1.0, 0.1, 0.05)}
    found = wd.shade(body, fingers, light, view, **options)
    points = points_of(light, 200)
    exact = wd.shade(body, fingers, points, view, plan=found.plan, refine=False, tangents=(1.0, 0.1, 0.05))
    seen = found.illuminated & exact.illuminated & (found.coverage > 0.999)
    errors = np.linalg.norm(found.xyz - exact.xyz, axis=-1)[seen] / np.linalg.norm(exact.xyz, axis=-1)[seen]
    assert np.count_nonzero(errors > 0.1) > 20
    assert np.mean(found.error[seen] >= errors) > 0.8
    assert np.mean(found.error[seen][errors > 0.1] > 5e-2) > 0.6


def test_orders_that_no_table_keeps_for_single_directions_take_the_best_one():
    """A blazed grating on a disc: of single directions its table errs by more than the tolerance, and says so."""
    blazed, light = wd.gratings.blazed(1.5, 0.3), wd.DirectionalLight((0.5, 0.3, 1.0), angular_diameter_deg=10.0)
    with pytest.warns(wd.WarpdiffWarning, match="cannot meet tolerance=0.03"):
        image = wd.shade(wd.meshes.disc(), blazed, light, VIEW, coherence=SHORT, tolerance=3e-2, pigment=0.0)
    assert image.plan.error > 3e-2
    sums = SkySums(wd.meshes.disc(), blazed, VIEW, SHORT)
    inside = sums.interior()
    bright = inside[np.argsort(image.xyz[tuple(inside.T)][:, 1])[-40::8]]
    exact = sums.under_disc(bright, light, 64, 0)
    errors = np.linalg.norm(image.xyz[tuple(bright.T)] - exact, axis=1) / np.linalg.norm(exact, axis=1)
    # That of single directions is told to be 0.09.
    assert np.median(errors) < 0.06
    assert errors.max() < 0.15


def test_a_size_is_said_once_and_takes_footprints(fingers):
    light = wd.DirectionalLight(TOWARDS, angular_diameter_deg=3.0)
    view = wd.View((0, 0, 4), (0, 0, 0), width=8, height=6)
    of_source = {"coherence": wd.Coherence("source")}
    with pytest.raises(ValueError, match="kind 'source', whose diameter is that of all lights"):
        wd.shade(wd.meshes.disc(), fingers, light, view, **of_source)
    for options in ({"footprint": False}, {"coherence": wd.Coherence("centred")}, {"method": "direct"}):
        with pytest.raises(ValueError, match="require footprints"):
            wd.shade(wd.meshes.disc(), fingers, light, view, **options)


@pytest.mark.parametrize(("diameter", "fov_y_deg"), [(20.0, 24.0), slow(4.0, 8.0)])
def test_a_rim_is_as_sharp_as_the_discs(diameter, fov_y_deg, square):
    """A mirror shows a disc whose rim is sharp but for the window's lobe, against sums over points of the disc."""
    flat = wd.HeightField(np.zeros((32, 32)), 0.09)
    light = wd.DirectionalLight((0, 0, 1), angular_diameter_deg=diameter)
    view = wd.View((0, 0, 4), (0, 0, 0), fov_y_deg=fov_y_deg, width=48, height=36)
    image = wd.shade(square, flat, light, view, coherence=SHORT, tolerance=0.1, pigment=0.0, refine=diameter < 5.0)
    # All of whose filters lie on the square.
    places = np.array([[18, column] for column in range(24, 43)])
    exact = SkySums(square, flat, view, SHORT).under_disc(places, light, 64, 0)
    size = np.maximum(np.linalg.norm(exact, axis=1), 1e-3 * np.percentile(image.xyz[..., 1], 99.0))
    errors = np.linalg.norm(image.xyz[tuple(places.T)] - exact, axis=1) / size
    # Some of them lie beyond it.
    assert np.count_nonzero(exact[:, 1] < 0.1 * exact[0, 1]) >= 3
    assert errors.max() < 0.5
    assert np.median(errors) < 0.05


def test_a_mirror_under_a_wide_light_is_no_darker_than_it_should_be(square):
    """Where a flat surface shows the middle of a disc, Y is the part of it that the window's lobe takes."""
    flat = wd.HeightField(np.zeros((32, 32)), 0.09)
    view = wd.View.orthographic((0, 0, 4), (0, 0, 0), extent_y=1.0, width=8, height=6)
    light = wd.DirectionalLight((0.0, 0.0, 1.0), angular_diameter_deg=4.0)
    image = wd.shade(square, flat, light, view, coherence=SHORT, tolerance=0.1, pigment=0.0, refine=False)
    # The lobe is λ/(2√2πσ) wide at each wavelength, and the light's α/2.
    middle, alpha = image.xyz[3, 4], math.radians(2.0) / 2.0
    lobe2 = (0.55 / (2.0 * math.sqrt(2.0) * math.pi * 8.0)) ** 2
    assert middle[1] == pytest.approx(lobe2 / (lobe2 + alpha**2), rel=0.2)
