"""Refinement: subdivided pixels with uneven colours must equal those of a picture with many rays per pixel.

A pixel is divided into subpixel cells, each with its own ray. With footprints, a cell has the mean colour over the
scattering vectors that it covers; without footprints, it is a point sample. A plan states how colours are computed: the
method, the number of wavelengths and so on. It may use a table of colours.
"""

import dataclasses
import itertools
import types

import numpy as np
import pytest
import trimesh
from conftest import relative_errors
from trimesh.visual import TextureVisuals

import warpdiff as wd
from bench.truth.pictures import finer
from warpdiff import meshes
from warpdiff.image.report import Report
from warpdiff.kernels import refinement_levels
from warpdiff.render import pixel_filter, threaded_tiles
from warpdiff.render.shade import warn_unconverged

SHORT = wd.Coherence(sigma_um=3.25)
LIGHT = wd.DirectionalLight((0.1, 0.9, 1.2))
SIZE = 24, 18


@pytest.fixture(scope="module")
def table(fingers):
    """Return a plan with a colour table that is so fine that averages over pixel areas cause most of the error."""
    plan = wd.plan(fingers, coherence=SHORT, method="low-rank", integration="table", tolerance=3e-3)
    return dataclasses.replace(plan, footprint=True, tolerance=5e-2)


# Camera targets by mesh name. At these points the picture contains a silhouette of the mesh.
TARGETS = {"tube": (0.2, 0.2, 0.1), "lumpy": (0.75, 0.1, 0.75)}


def view(body="tube", size=SIZE):
    """Return a view of a small part of the mesh, at a silhouette."""
    return wd.View((0.4, 1.6, 3.1), TARGETS[body], fov_y_deg=5.0, width=size[0], height=size[1])


def lumpy(subdivisions=3):
    """Return a ball with bumps and a texture seam, with few faces."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y, z = mesh.vertices.T
    mesh.vertices *= (1.0 + 0.12 * np.sin(5.0 * x + 1.0) * np.sin(4.0 * y))[:, None]
    uv = np.column_stack([np.arctan2(y, x) / (2.0 * np.pi), z])
    return trimesh.Trimesh(mesh.vertices, mesh.faces, visual=TextureVisuals(uv=uv), process=False)


BODIES = {"tube": lambda: meshes.tube(segments_along=48, segments_around=32), "lumpy": lumpy}


def by_points(mesh, heightfield, light, camera, plan, points=24):
    """Return XYZ of pixels by ``points`` × ``points`` rays each, their coverage, and a mask of the inner pixels.

    All rays of an inner pixel hit the illuminated surface. The picture of the rays has a margin, because the pixel
    filter extends beyond the pixel.
    """
    margin = 2
    fine = finer(camera, points, margin)
    image = wd.shade(mesh, heightfield, light, fine, plan=dataclasses.replace(plan, footprint=False))

    def filtered(size):
        places = (np.arange((size + 2 * margin) * points) + 0.5) / points - margin
        away = places - (np.arange(size)[:, None] + 0.5)
        weights = np.where(np.abs(away) <= 1.5, np.exp(-2.0 * away**2), 0.0)
        return weights / weights.sum(axis=1, keepdims=True)

    rows, columns = filtered(camera.height), filtered(camera.width)
    xyz = np.stack([rows @ image.xyz[..., c] @ columns.T for c in range(3)], axis=-1)
    coverage = rows @ image.mask.astype(float) @ columns.T
    illuminated = image.illuminated[margin * points : -margin * points, margin * points : -margin * points]
    inside = illuminated.reshape(camera.height, points, camera.width, points).all(axis=(1, 3))
    return xyz, coverage, inside


@pytest.fixture(scope="module", params=BODIES)
def truth(request, fingers, table):
    mesh, camera = BODIES[request.param](), view(request.param)
    return mesh, camera, by_points(mesh, fingers, LIGHT, camera, table)


def errors(image, exact):
    """Return the errors of inner pixels, relative to the exact colour, or to a dark colour if that is brighter."""
    xyz, _, inside = exact
    return relative_errors(image.xyz[inside], xyz[inside])


def test_pictures_meet_their_tolerance(truth, fingers, table):
    mesh, camera, exact = truth
    for tolerance in (1e-1, 3e-2):
        image = wd.shade(mesh, fingers, LIGHT, camera, plan=dataclasses.replace(table, tolerance=tolerance))
        result = errors(image, exact)
        assert len(result) > 100
        assert np.percentile(result, 99.0) < tolerance
        assert np.median(result) < 0.25 * tolerance
        assert 0.0 < image.report.refined_share < 1.0
        assert f"meets its tolerance of {tolerance:g}" in str(image.report).splitlines()[0]


def test_reported_errors_bound_and_rank_the_true_ones(truth, fingers, table):
    """Reported errors must exceed true errors in over 95 % of the pixels, and both must rank pixels similarly."""
    mesh, camera, exact = truth
    true, reported = [], []
    for tolerance, refine in ((1e-1, False), (1e-1, True), (3e-2, True)):
        plan = dataclasses.replace(table, tolerance=tolerance)
        image = wd.shade(mesh, fingers, LIGHT, camera, plan=plan, refine=refine)
        assert not image.error[~image.illuminated].any()
        assert image.report.errors[0] < image.report.errors[1]
        true.append(errors(image, exact))
        reported.append(image.error[exact[2]])
    true, reported = np.concatenate(true), np.concatenate(reported)
    assert np.mean(true <= reported) > 0.95
    ranks = [np.argsort(np.argsort(each)) for each in (true, reported)]
    assert np.corrcoef(*ranks)[0, 1] > 0.5


def test_more_cells_are_never_worse(truth, fingers, table):
    """More subpixel cells must not increase errors, neither with footprints nor with point samples.

    With footprints, a cell has the mean colour of its area, which requires a colour table. The second plan has no
    table, so that its cells are point samples.
    """
    mesh, camera, exact = truth
    for plan in (table, dataclasses.replace(table, coherence=table.coherence, rings_per_octave=0)):
        result = [
            errors(wd.shade(mesh, fingers, LIGHT, camera, plan=plan, samples_per_pixel=n, refine=False), exact)
            for n in ((1, 4, 16, 64) if plan.uses_footprints else (16, 64))
        ]
        for one, more in itertools.pairwise(result):
            for quantile in (50.0, 90.0, 99.0):
                # Errors below 1e-3 are mainly errors of the colour table, which more cells per pixel cannot reduce.
                assert np.percentile(more, quantile) < max(0.8 * np.percentile(one, quantile), 1e-3)


def test_silhouettes_are_covered_in_part(truth, fingers, table):
    mesh, camera, (xyz, coverage, _) = truth
    image = wd.shade(mesh, fingers, LIGHT, camera, plan=table)
    rim = (coverage > 0.1) & (coverage < 0.9)
    assert np.count_nonzero(rim) > 15
    # Pixels at the silhouette of the mesh have coverages with errors of at most 0.1, and of 0.03 in the median.
    away = np.abs(image.coverage - coverage)[rim]
    assert np.median(away) < 0.03
    assert away.max() < 0.1
    # Colours are multiplied by the coverage, both in the picture and in the reference.
    size = np.linalg.norm(xyz, axis=2)
    bright = rim & (size > 0.05 * np.percentile(size[coverage > 0.99], 90.0))
    relative = np.linalg.norm(image.xyz - xyz, axis=2)[bright] / size[bright]
    assert np.all(np.isfinite(relative))
    assert np.median(np.append(relative, 0.0)) < 5e-2
    alone = wd.shade(mesh, fingers, LIGHT, camera, plan=table, refine=False)
    assert set(np.unique(alone.coverage)) == {0.0, 1.0}


def test_unrefined_pixels_have_the_requested_number_of_cells(fingers, table):
    """Without refinement, pixels at silhouettes must have four cells like all other pixels, as their coverage shows."""
    mesh, camera = BODIES["tube"](), view()
    image = wd.shade(mesh, fingers, LIGHT, camera, plan=table, samples_per_pixel=4, refine=False)
    hit = wd.shade(mesh, fingers, LIGHT, finer(camera, 2, 1), plan=dataclasses.replace(table, footprint=False)).mask

    def filtered(size):
        weights, result = pixel_filter.weights_of(1, means=True), np.zeros((size, 2 * size + 4))
        for pixel in range(size):
            result[pixel, 2 * pixel : 2 * pixel + 6] = weights
        return result

    expected = filtered(camera.height) @ hit.astype(float) @ filtered(camera.width).T
    assert np.count_nonzero((expected > 0.01) & (expected < 0.99)) > 15
    # If the rays through the centres of a pixel and its neighbours miss the mesh, the renderer does not trace the cells
    # of the pixel. Their small coverage is missing in the picture.
    np.testing.assert_allclose(image.coverage, expected, atol=1e-3)


def test_pictures_without_a_table_for_means_sum_points(fingers):
    """With ``footprint=True`` but without a table of colours, each pixel must be the mean of many point samples.

    The coherence model "centred" has no tables of means.
    """
    mesh, coherence = BODIES["lumpy"](), wd.Coherence("centred", sigma_um=3.25)
    plan = wd.plan(fingers, coherence=coherence, method="low-rank", tolerance=3e-3)
    exact = by_points(mesh, fingers, LIGHT, view("lumpy"), plan, points=8)
    plan = dataclasses.replace(plan, tolerance=5e-2)
    result = wd.shade(mesh, fingers, LIGHT, view("lumpy"), plan=plan, footprint=True)
    assert result.plan.footprint
    assert not result.plan.uses_footprints
    assert np.percentile(errors(result, exact), 95.0) < 5e-2


@pytest.mark.parametrize("method", ["auto", "low-rank", "jacobi-anger"])
def test_means_are_on_at_any_tolerance(method):
    heightfield = wd.gratings.blazed(2.5, 0.25)
    small = view("lumpy", (16, 12))
    for tolerance in (1e-1, 1e-3):
        options = {"coherence": SHORT, "tolerance": tolerance, "method": method}
        assert wd.shade(lumpy(), heightfield, LIGHT, small, **options).plan.footprint
    assert not wd.shade(lumpy(), heightfield, LIGHT, small, coherence=SHORT, footprint=False).plan.footprint


def test_pixels_that_do_not_converge_cause_a_warning(fingers, table):
    """Pixels whose errors remain too large must cause a warning.

    In this view of a distant mesh, each pixel covers thousands of bumps, which no refinement resolves.
    """
    far = wd.View((12.0, 48.0, 93.0), (0.0, 0.0, 0.0), fov_y_deg=1.5, width=48, height=36)
    mesh, fine = lumpy(5), dataclasses.replace(table, tolerance=1e-3)
    with pytest.warns(
        wd.WarpdiffWarning, match=r"of the illuminated interior pixels are expected to exceed .* see image.error"
    ):
        image = wd.shade(mesh, fingers, LIGHT, far, plan=fine)
    assert image.report.unconverged_share > 0.01
    assert "does not meet its tolerance of 0.001 everywhere" in str(image.report).splitlines()[0]


def test_edge_pixels_are_distinguished_from_inner_pixels(truth, fingers, table):
    """Pixels with an edge must be marked in the mask of edges, and inner pixels must not.

    The whole square of an inner pixel shows the mesh and is illuminated.
    """
    mesh, camera, (_, _, inside) = truth
    renderer = wd.Renderer(mesh, fingers, LIGHT, camera, plan=table, samples_per_pixel=16)
    illuminated = renderer.image().illuminated
    edges = renderer._mine.picture._cropped(renderer._mine.picture._sums.edges)
    assert not edges[inside].any()
    assert np.count_nonzero(illuminated & ~inside) > 20
    # Some edges are so close to the border of their pixel that none of its 16 cells detects them. It suffices that 80 %
    # of the pixels with edges are marked as such.
    assert np.mean(edges[illuminated & ~inside]) > 0.8


@pytest.mark.parametrize(
    ("name", "most", "message"),
    [("unconverged_share", 0.01, r"1\.1 % of"), ("unconverged_edge_share", 0.05, r"5\.1 % of")],
)
def test_the_warning_allows_more_unconverged_pixels_at_edges(name, most, message):
    converged = Report(1e-2, (1e-3, 1e-2), True, 0.5, 0.0, 0.0, 1)

    def warned(share):
        warn_unconverged(types.SimpleNamespace(report=dataclasses.replace(converged, **{name: share})))

    warned(most - 0.001)
    with pytest.warns(wd.WarpdiffWarning, match=message):
        warned(most + 0.001)


def test_pictures_do_not_depend_on_threads_or_parts(fingers, table, monkeypatch):
    mesh = BODIES["lumpy"]()
    expected = wd.shade(mesh, fingers, LIGHT, view(), plan=table)
    for threads in (1, 3):
        result = wd.shade(mesh, fingers, LIGHT, view(), plan=table, threads=threads)
        np.testing.assert_array_equal(result.xyz, expected.xyz)
        np.testing.assert_array_equal(result.error, expected.error)
    # With small limits of buffer sizes, the renderer splits the picture into parts, as if little memory were free.
    monkeypatch.setattr(pixel_filter, "_MOST_RASTERIZED", 1024)
    result = wd.shade(mesh, fingers, LIGHT, view(), plan=table)
    np.testing.assert_array_equal(result.xyz, expected.xyz)
    monkeypatch.setattr(threaded_tiles, "_MOST_PIXELS", 300)
    result = wd.shade(mesh, fingers, LIGHT, view(), plan=table)
    assert np.percentile(np.linalg.norm(result.xyz - expected.xyz, axis=2), 99.0) < 1e-3 * expected.xyz.max()


def test_lights_and_pigments_add_up(fingers, table):
    mesh = BODIES["tube"]()
    brown = trimesh.visual.material.SimpleMaterial(diffuse=(200, 120, 60, 255))
    mesh.visual = TextureVisuals(uv=mesh.visual.uv, material=brown)
    other = wd.DirectionalLight((-0.7, 0.6, 0.8), power=0.4)
    alone = [wd.shade(mesh, fingers, light, view(), plan=table) for light in (LIGHT, other)]
    both = wd.shade(mesh, fingers, [LIGHT, other], view(), plan=table)
    # A picture with one light is refined until it meets the tolerance. With two lights, only their sum must meet the
    # tolerance. The picture with two lights therefore differs slightly from the sum of the two other pictures.
    expected = alone[0].xyz + alone[1].xyz
    away = relative_errors(both.xyz[both.illuminated], expected[both.illuminated])
    assert np.percentile(away, 99.0) < table.tolerance
    assert np.median(away) < 0.1 * table.tolerance
    bare = wd.shade(mesh, fingers, LIGHT, view(), plan=table, pigment=0.0)
    assert np.all(alone[0].xyz[bare.illuminated][:, 1] > bare.xyz[bare.illuminated][:, 1])


@pytest.mark.parametrize("means", [True, False])
@pytest.mark.parametrize("level", refinement_levels.LEVELS)
def test_cell_weights_and_footprints_approximate_the_pixel_filter(level, means):
    """The weighted Gaussians of all cells must sum to the pixel filter, a Gaussian with σ = 0.5 pixel.

    Each cell is averaged over a Gaussian. Without footprints, cells are points, and their weights are values of the
    pixel filter.
    """
    weights, deviation = pixel_filter.weights_of(level, means=means), pixel_filter.deviation_at(level, means=means)
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(weights, weights[::-1])
    places = (np.arange(3 * 2**level) + 0.5) / 2**level - 1.5
    assert weights @ places**2 + deviation**2 == pytest.approx(refinement_levels.FILTER_SIGMA**2, rel=0.05)
    if means:
        x = np.linspace(-1.0, 1.0, 41)
        ours = np.exp(-0.5 * ((x[:, None] - places) / deviation) ** 2) @ weights / deviation
        exact = np.exp(-0.5 * (x / refinement_levels.FILTER_SIGMA) ** 2) / refinement_levels.FILTER_SIGMA
        # A sum of equal Gaussians with σ = s · spacing (a spacing is the distance of cells) has ripples of 2
        # exp(−2π²s²). The truncation of the filter at 1.5 pixels adds an error.
        ripples = 2.0 * np.exp(-2.0 * (np.pi * deviation * 2**level) ** 2)
        np.testing.assert_allclose(ours, exact, atol=(ripples + 0.25 / 4**level) * exact.max())


def test_dark_lights_do_not_reduce_the_reported_share_of_unconverged_pixels(fingers, table):
    far = wd.View((12.0, 48.0, 93.0), (0.0, 0.0, 0.0), fov_y_deg=1.5, width=48, height=36)
    mesh, fine = lumpy(5), dataclasses.replace(table, tolerance=1e-3)
    below = wd.DirectionalLight((-12.0, -48.0, -93.0))
    with pytest.warns(wd.WarpdiffWarning, match="see image.error"):
        one = wd.shade(mesh, fingers, LIGHT, far, plan=fine)
    with pytest.warns(wd.WarpdiffWarning, match="see image.error"):
        several = wd.shade(mesh, fingers, [LIGHT, below, below], far, plan=fine)
    assert several.report.unconverged_share == one.report.unconverged_share
    assert several.report.refined_share == one.report.refined_share


def test_progress_ends_when_pixels_are_split(fingers, table):
    shares = []
    fine = dataclasses.replace(table, tolerance=1e-2)
    image = wd.shade(BODIES["lumpy"](), fingers, LIGHT, view("lumpy"), plan=fine, progress=shares.append)
    assert image.report.refined_share > 0.0
    assert shares == sorted(shares)
    assert sum(0.3 < share < 1.0 for share in shares) >= 2
    assert shares[-1] == 1.0


def test_more_cells_than_the_highest_level_has_are_refused(fingers):
    with pytest.raises(ValueError, match="samples_per_pixel must be at most 4096 with footprints, got 4097"):
        wd.shade(BODIES["tube"](), fingers, LIGHT, view(), coherence=SHORT, samples_per_pixel=4097)


def test_cells_detect_details_between_pixel_centres(fingers, table):
    """Subpixel cells must detect a mesh of bars that are 0.3 pixels wide, one every 5.3 pixels.

    The rays through most pixel centres miss this mesh.
    """
    bars = [
        trimesh.Trimesh(
            [(x, -9.0, 0.0), (x + 0.3, -9.0, 0.0), (x + 0.3, 9.0, 0.0), (x, 9.0, 0.0)], [(0, 1, 2), (0, 2, 3)],
            visual=TextureVisuals(uv=[(0, 0), (1, 0), (1, 1), (0, 1)]), process=False,
        )
        for x in np.arange(-9.0, 9.0, 5.3) + 0.05
    ]  # fmt: skip
    camera = wd.View((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), extent_y=18.0, width=24, height=18)
    mesh = trimesh.util.concatenate(bars)
    options = {"plan": table, "refine": False}
    images = [wd.shade(mesh, fingers, LIGHT, camera, **options, samples_per_pixel=n) for n in (16, 256)]
    expected = 0.3 * len(bars) / 24.0
    for image, away in zip(images, (0.25, 0.05), strict=True):
        assert abs(image.coverage.mean() - expected) < away * expected


def test_cells_detect_shadows_between_pixel_centres(fingers, table):
    """Subpixel cells must detect the shadow of a strip that is narrower than a pixel and between pixel centres."""
    floor = trimesh.creation.box((4.0, 4.0, 0.1))
    strip = trimesh.creation.box((2.4, 0.04, 0.01))
    strip.apply_translation((3.0, 0.08, 3.0))
    light = wd.DirectionalLight((1.0, 0.0, 1.0))
    camera = wd.View((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), extent_y=1.6, width=16, height=16)
    options = {"plan": table, "samples_per_pixel": 16, "refine": False, "smooth": False}
    illuminated, beside = (
        wd.shade(mesh, fingers, light, camera, tangents=np.tile((1.0, 0.0, 0.0), (len(mesh.vertices), 1)), **options)
        for mesh in (floor, trimesh.util.concatenate([floor, strip]))
    )
    shares = beside.xyz[..., 1] / illuminated.xyz[..., 1]
    assert shares.min() < 0.8
    assert shares.mean() == pytest.approx(1.0 - 0.04 / 1.6, abs=0.01)
