"""Footprints: mean colours over the pixel filter from one look-up, compared with pictures of many rays per pixel.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

import dataclasses

import numpy as np
import pytest
import warp as wp
from conftest import relative_errors, slow

import warpdiff as wd
from bench.truth.brute_force import shading_frame
from warpdiff import meshes
from warpdiff.device.kernel_calls import launch_pipeline
from warpdiff.kernels.structs import Footprint
from warpdiff.lights.surface_optics import SurfaceOptics
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.render.accumulators import Accumulators
from warpdiff.render.picture import Picture
from warpdiff.render.pixel_sampler import LobeIndex
from warpdiff.scene.mesh_import import prepare_surface
from warpdiff.tables import colour_table
from warpdiff.tables.footprint_weights import LINE_TAPS, SPECTRUM_TAPS, footprint_taps
from warpdiff.tables.lookup import ColourLookup

SHORT = wd.Coherence(sigma_um=3.25)
SOURCE = wd.Coherence("source", angular_diameter_deg=3.0)
LIGHT = wd.DirectionalLight((0.1, 0.9, 1.2))
# Number of rays per pixel in the reference picture. With 144 rays, noise of the reference raised the 99th percentile of
# the measured errors to 0.25. With 400 rays, this percentile is 0.06.
RAYS = 400


@pytest.fixture(scope="module")
def tube():
    return meshes.tube(segments_along=64, segments_around=48)


def view():
    return wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=96, height=72)


@pytest.fixture(scope="module")
def pictures(tube, fingers):
    """Return a picture with footprints, a picture with one ray per pixel, and a reference with 400 rays per pixel.

    With footprints, one look-up gives the mean colour over the area of a pixel.
    """
    blurred = wd.shade(tube, fingers, LIGHT, view(), coherence=SHORT, tolerance=3e-2)
    plan = dataclasses.replace(blurred.plan, footprint=False)
    points = wd.shade(tube, fingers, LIGHT, view(), plan=plan)
    finer = dataclasses.replace(plan, rings_per_octave=64, azimuths_per_width=2.0)
    return blurred, points, wd.shade(tube, fingers, LIGHT, view(), plan=finer, samples_per_pixel=RAYS)


def errors(image, exact):
    """Return errors of a picture relative to ``exact``, for pixels completely inside the illuminated surface."""
    inside = (exact.coverage == 1.0) & image.illuminated
    return relative_errors(image.xyz[inside], exact.xyz[inside])


def to_first_order(spreads):
    """Return footprints, shape (n, 4), as an array for kernels: changes of (u, v) along picture rows and columns."""
    return wp.array(spreads, dtype=Footprint, device="cpu")


def test_footprints_are_used_by_default(pictures):
    blurred, points, _ = pictures
    assert blurred.plan.footprint
    assert "mip levels for footprints" in str(blurred.plan)
    assert not points.plan.footprint


def test_footprints_reduce_the_error_of_a_pixel(pictures):
    blurred, points, exact = pictures
    ours, theirs = errors(blurred, exact), errors(points, exact)
    assert len(ours) > 500
    # The allowed error is large because the picture is small: the azimuth of (u, v) changes by at least 0.1 rad from
    # one pixel to the next. The linear change of (u, v) within a pixel (footprint) is then inaccurate.
    assert np.median(ours) < 4e-2
    assert np.median(ours) < 0.2 * np.median(theirs)
    assert np.percentile(ours, 90.0) < 0.4 * np.percentile(theirs, 90.0)


@pytest.mark.parametrize("angle_deg", [-1e-5, 0.0, 1e-5, -0.02, 180.0])
def test_azimuth_samples_form_a_closed_circle(fingers, angle_deg):
    """Colours must be continuous at azimuths (polar angles of (u, v)) of 0° and 180°, because a table's azimuth samples
    are periodic.
    """
    plan = wd.plan(fingers, coherence=SHORT, method="low-rank", integration="table", tolerance=0.1)
    plan = dataclasses.replace(plan, footprint=True)
    device = wp.get_device("cpu")
    lookup = ColourLookup(fingers, plan, plan.direction_range, device=device, threads=1)
    result = []
    for degrees in (angle_deg, angle_deg + 0.05):
        angle = np.radians(degrees)
        uv = 0.6 * np.array([np.cos(angle), np.sin(angle)])
        scattering_vector = wp.array([[*uv, -1.6]], dtype=wp.vec3d, device=device)
        spread = to_first_order([[*(0.03 * uv[::-1] * [-1.0, 1.0]), 0.0, 0.0]])
        xyz = wp.zeros(1, dtype=wp.vec3f, device=device)
        gain = wp.ones(1, dtype=wp.float32, device=device)
        lookup.accumulate(scattering_vector, None, gain, IlluminatedMaterial("D65"), xyz, footprints=spread)
        result.append(xyz.numpy()[0])
    np.testing.assert_allclose(result[0], result[1], rtol=0.05)


@pytest.mark.parametrize(("window", "blurred"), [(SHORT, True), (SHORT, False), (SOURCE, True)])
def test_a_colour_does_not_depend_on_neighbouring_pixels(fingers, window, blurred, rng):
    """Colours must not depend on which look-ups share a SIMD batch. The composition of batches depends on the threads.

    Compiled code could round differently in incomplete batches. For 1 in 2000 look-ups, rounding would select another
    entry of the colour table.
    """
    plan = wd.plan(fingers, coherence=window, method="low-rank", integration="table", tolerance=0.1, strict=False)
    device = wp.get_device("cpu")
    plan = dataclasses.replace(plan, footprint=True)
    lookup = ColourLookup(fingers, plan, plan.direction_range, device=device, threads=1)
    count = 25_000
    # The number of look-ups is not a multiple of the tested batch sizes, so the last batch is incomplete.
    runs = (256, 1, 7, 61)
    uv, w = rng.uniform(-0.9, 0.9, (count, 2)), rng.uniform(-1.9, -0.5, count)
    scattering_vectors = np.column_stack([uv, w])
    spreads = rng.normal(0.0, 0.03, (count, 4)) * rng.choice([0.1, 1.0, 5.0], (count, 1))
    gains = np.where(rng.uniform(size=count) < 0.8, rng.uniform(size=count), 0.0)
    to_lights = wp.array(np.tile([0.3, 0.1, 0.9], (count, 1)), dtype=wp.vec3f, device=device)
    footprints = to_first_order(spreads) if blurred else None
    uvw = wp.array(scattering_vectors, dtype=wp.vec3d, device=device)
    factors = wp.array(gains, dtype=wp.float32, device=device)
    result = []
    for run in runs:
        xyz = wp.zeros(count, dtype=wp.vec3f, device=device)
        step = lookup.kernel_calls(uvw, to_lights, factors, IlluminatedMaterial("D65"), xyz, footprints)[0]
        step = dataclasses.replace(step, inputs=[*step.inputs[:-1], run], block=run)
        launch_pipeline([step], count, device=device, threads=1, slice_size=count)
        result.append(xyz.numpy())
    for other in result[1:]:
        np.testing.assert_array_equal(other, result[0])
    assert np.count_nonzero(result[0][:, 1]) > count / 2


def colours(heightfield, plan, direction_range, uv, footprints):
    """Return XYZ at (u, v), shape (n, 2), for w = −1.5.

    The colours are computed by the plan's colour table, or by sums over the plan's wavelengths if it has no table.
    """
    device = wp.get_device("cpu")
    xyz = wp.zeros(len(uv), dtype=wp.vec3f, device=device)
    scattering_vectors = wp.array(np.column_stack([uv, np.full(len(uv), -1.5)]), dtype=wp.vec3d, device=device)
    gains = wp.ones(len(uv), dtype=wp.float32, device=device)
    lookup = ColourLookup(heightfield, plan, direction_range, device=device, threads=2)
    lookup.accumulate(scattering_vectors, None, gains, IlluminatedMaterial("D65"), xyz, footprints=footprints)
    return xyz.numpy().astype(np.float64)


@pytest.mark.parametrize(
    ("widest", "turn", "median", "most"),
    [(0.04, 0.05, 4.5e-3, 1.2e-2), (0.12, 0.05, 6e-3, 2.5e-2), (0.05, 0.2, 0.018, 0.11)],
)
def test_means_over_footprints_equal_means_of_points(fingers, rng, widest, turn, median, most):
    """Look-ups of footprints (ranges of (u, v) in a pixel) must equal means over 120 points along these ranges.

    The footprints are one-dimensional: radial or oblique lines in (u, v). Wide footprints are included, because their
    look-ups skip rings (circles of constant |(u, v)| in the table), and because their Gaussians are skewed as functions
    of ln |(u, v)|.
    """
    count = 200
    plan = wd.plan(fingers, coherence=SHORT, method="low-rank", integration="table", tolerance=0.02)
    sampled = wd.plan(fingers, coherence=SHORT, method="low-rank", tolerance=1e-3)
    angles, sizes = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.5, 0.9, count)
    along = sizes[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    aside = along[:, ::-1] * [-1.0, 1.0]
    spreads = rng.uniform(0.3 * widest, widest, (count, 1)) * along + rng.uniform(-turn, turn, (count, 1)) * aside

    footprints = to_first_order(np.column_stack([spreads, np.zeros((count, 2))]))
    result = colours(fingers, dataclasses.replace(plan, footprint=True), plan.direction_range, along, footprints)
    places, weights = np.polynomial.hermite_e.hermegauss(120)
    points = along[:, None] + places[:, None] * spreads[:, None]
    of_points = colours(fingers, sampled, plan.direction_range, points.reshape(-1, 2), None).reshape(count, -1, 3)
    exact = np.einsum("p,npc->nc", weights / weights.sum(), of_points)
    relative = np.linalg.norm(result - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert np.median(relative) < median
    assert np.percentile(relative, 90.0) < most


@pytest.mark.parametrize("distance", [0.0, slow(1.0), 3.0])
@pytest.mark.parametrize("surface", ["fingers", "lines"])
def test_means_around_the_mirror_direction_equal_means_of_points(surface, fingers, rng, distance):
    """Look-ups of footprints (ranges of (u, v) in a pixel) close to the mirror direction must equal means over points.

    These footprints include all polar angles of (u, v). Their centres are 0 to 3 standard deviations away from the
    mirror direction.
    """
    heightfield = {"fingers": fingers, "lines": wd.gratings.sinusoidal(5.0, 0.14)}[surface]
    count = 8
    plan = wd.plan(heightfield, coherence=SHORT, method="low-rank", integration="table", tolerance=0.02)
    sampled = wd.plan(heightfield, coherence=SHORT, method="low-rank", tolerance=1e-3)
    rotated, around = rng.uniform(0.0, 2.0 * np.pi, (2, count, 1))
    wide = rng.uniform(0.03, 0.1, (count, 1)) * np.concatenate([np.cos(rotated), np.sin(rotated)], axis=1)
    across = wide[:, ::-1] * [-1.0, 1.0] / rng.uniform(1.0, 6.0, (count, 1))
    middles = distance * (np.cos(around) * wide + np.sin(around) * across)
    footprints = to_first_order(np.column_stack([wide, across]))
    result = colours(heightfield, dataclasses.replace(plan, footprint=True), plan.direction_range, middles, footprints)
    places, weights = np.polynomial.hermite_e.hermegauss(80)
    points = middles[:, None, None] + places[:, None, None] * wide[:, None, None]
    points = (points + places[:, None] * across[:, None, None]).reshape(-1, 2)
    of_points = colours(heightfield, sampled, plan.direction_range, points, None).reshape(count, 80, 80, 3)
    exact = np.einsum("p,q,npqc->nc", weights, weights, of_points) / weights.sum() ** 2
    relative = np.linalg.norm(result - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert np.median(relative) < 5e-3
    assert relative.max() < 5e-2


def test_a_wide_footprint_weights_each_ring_by_its_area():
    """A look-up of a wide footprint (range of (u, v) in a pixel) must equal a closed form.

    The colours of the table are a narrow Gaussian function of |(u, v)|. The footprint and this Gaussian have the mirror
    direction as their common centre. Near this direction, look-ups of wide footprints skip every second ring of the
    table (circle of constant |(u, v)|).
    """
    heightfield = wd.gratings.sinusoidal(5.0, 0.14)
    up = (0.0, 0.0, 1.0)
    plan = wd.plan(heightfield, up, (0.6, 0.0, 0.8), coherence=SHORT, method="low-rank")
    plan = dataclasses.replace(plan, rings_per_octave=24, azimuths_per_width=1.3, footprint=True)
    options = {"device": wp.get_device("cpu"), "threads": 1}
    table = colour_table.table_for(heightfield, plan, plan.direction_range, IlluminatedMaterial("D65"), **options)
    struct, deviation = table.struct, 0.1
    levels, octaves = struct.azimuths.shape
    rings = struct.rings_per_octave
    radii = np.exp2((np.arange(octaves * rings) - struct.ring_of_one) / rings).reshape(octaves, 1, rings, 1)
    rows = struct.rows.numpy()

    def mean_over_footprint(values):
        for level, octave in np.ndindex(levels, octaves):
            first, azimuths = struct.first_rows.numpy()[level, octave], struct.azimuths.numpy()[level, octave]
            rows[first : first + azimuths * rings].reshape(azimuths, rings, -1)[:] = values[octave]
        struct.rows.assign(rows)
        footprints = to_first_order([[deviation, 0.0, 0.0, deviation]])
        return colours(heightfield, plan, plan.direction_range, np.zeros((1, 2)), footprints)[0]

    dark, white = mean_over_footprint(0.0 * radii), mean_over_footprint(radii**0)
    for narrow in (0.4 * deviation, 0.8 * deviation):
        colour = mean_over_footprint(np.exp(-0.5 * (radii / narrow) ** 2))
        expected = narrow**2 / (narrow**2 + deviation**2)
        np.testing.assert_allclose((colour - dark) / (white - dark), expected, rtol=0.05)


def seen_by(surface, view, light, face, column, row, *, smooth):
    """Return (u, v) in float64, shape (n, 2), at the points where camera rays intersect the planes of the faces
    ``face``.

    The rays pass through the picture positions (``column``, ``row``) in pixels.
    """
    frame = view.frame()
    x = (2.0 * column / view.width - 1.0) * frame.half_width
    y = (1.0 - 2.0 * row / view.height) * frame.half_height
    across = x[:, None] * frame.right + y[:, None] * frame.up
    along, origin = across - frame.back, (frame.origin - surface.centre) / surface.radius
    if frame.orthographic:
        along, origin = np.tile(-frame.back, (len(x), 1)), origin + across / surface.radius
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    corners = surface.faces[face]
    p0, p1, p2 = (surface.vertices[corners[:, k]].astype(np.float64) for k in range(3))
    rays = np.stack([p1 - p0, p2 - p0, -along], axis=2)
    share1, share2, _ = np.linalg.solve(rays, (origin - p0)[..., None])[..., 0].T
    shares = np.stack([1.0 - share1 - share2, share1, share2], axis=1)
    uvw = {"normals": surface.normals, "tangents": surface.tangents, "handedness": surface.handedness}
    axes = shading_frame(face, shares, along, surface.vertices, surface.faces, **uvw, smooth=smooth)
    halfway = np.asarray(light.to_light) - along
    return np.stack([np.sum(axis * halfway, axis=1) for axis in axes[:2]], axis=1)


@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("place", ["outside", "inside", "orthographic", "far", "sheared"])
def test_footprints_are_the_derivatives_of_uv_in_the_picture(tube, place, smooth, rng):
    """Footprints, the derivatives of (u, v) in the picture, must equal finite differences between rays.

    The rays intersect the plane of the same face.

    The coarse mesh has sheared tangents, which are not perpendicular to its normals.
    """
    size = {"width": 48, "height": 36}
    camera = {
        "outside": wd.View((0.5, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, **size),
        "inside": wd.View((0.2, 0.0, 0.1), (1.0, 0.3, 0.0), **size),
        "orthographic": wd.View.orthographic((0.3, 1.0, 2.0), (0.0, 0.0, 0.0), extent_y=1.5, **size),
        "far": wd.View((500.0, 1600.0, 3100.0), (0.0, 0.0, 0.0), fov_y_deg=0.03, **size),
        "sheared": wd.View((0.5, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, **size),
    }[place]
    surface, deviation = prepare_surface(tube), 0.4
    if place == "sheared":
        coarse = meshes.tube(segments_along=12, segments_around=12)
        oblique = (1.0, 0.3, 0.5) + 0.3 * rng.normal(size=(len(coarse.vertices), 3))
        surface = prepare_surface(coarse, tangents=oblique)
    optics = SurfaceOptics(SHORT, 1.0, 0.04, shadows=False)
    picture = Picture(surface, camera, [optics], smooth=smooth, means=True, device=wp.get_device("cpu"), threads=1)
    (part,) = LIGHT.parts(SHORT, single_lobe=True, name="light")
    picture.set_lights([part])
    sums = Accumulators.allocate(48 * 36, means=True, device=wp.get_device("cpu"))
    picture.sampler.scatter(0, LobeIndex(0, 0), sums)
    batch = picture.sampler.batch(sums, deviation=deviation)
    picture.rays.launch([part.make_pass(picture.context).filter_footprints(batch)])
    pixels, result = batch.gbuffer.pixels, batch.samples.footprints
    hit = np.flatnonzero(pixels.hit.numpy())
    face, step = pixels.face.numpy()[hit], 1e-3
    at = [(hit % 48 + 0.5 + x, hit // 48 + 0.5 + y) for x, y in ((step, 0), (-step, 0), (0, step), (0, -step))]
    right, left, below, above = (seen_by(surface, camera, LIGHT, face, *other, smooth=smooth) for other in at)
    expected = deviation / (2.0 * step) * np.concatenate([right - left, below - above], axis=1)
    # Pixels viewed at grazing angles are excluded. There kernels tilt normals towards the viewer, which makes
    # derivatives of (u, v) discontinuous.
    cosine = np.sum(pixels.normal.numpy()[hit] * pixels.to_view.numpy()[hit], axis=1)
    facing = cosine > 0.03
    assert np.count_nonzero(facing) > 200
    # The kernel stores the derivatives (footprints) of −u and −v, so only absolute values are compared.
    size = np.linalg.norm(expected[facing], axis=1, keepdims=True)
    error = np.abs(np.abs(result.numpy()[hit][facing]) - np.abs(expected[facing])) / size
    assert np.percentile(error, 99) < 2e-3


def test_rings_are_skipped_only_under_illuminants_with_smooth_spectra():
    per_log = 32.0 / np.log(2.0)
    assert all(colour_table._is_smooth(IlluminatedMaterial(name), per_log) for name in ("D65", "D50", "A", "E"))
    assert not any(colour_table._is_smooth(IlluminatedMaterial(name), per_log) for name in ("FL2", "FL11", "HP1"))


@pytest.mark.parametrize(
    ("rule", "own", "worst"), [(SPECTRUM_TAPS, 1.1, 0.03), (SPECTRUM_TAPS, 1.8, 0.015), (LINE_TAPS, 0.8, 0.05)]
)
def test_few_azimuth_samples_blur_a_gaussian_line(rule, own, worst):
    """A weighted sum of a few azimuth samples must blur a Gaussian spectral line to a wider Gaussian.

    Azimuth samples are the samples of a colour table over the polar angle of (u, v). The line is stored as spline
    coefficients at these samples. For the narrow lines under a light source of finite size (``LINE_TAPS``), the spline
    itself has an error of 3 % of the peak.
    """
    made = footprint_taps("cpu", rule)
    weights, lengths = made.weights.numpy().astype(np.float64), made.lengths.numpy()
    variances = np.arange(len(weights)) / made.per_variance
    np.testing.assert_allclose(weights.sum(axis=2), 1.0, atol=1e-6)
    on_rays = np.arange(-24, 25)
    between = 0.75 * np.eye(49) + 0.125 * (np.eye(49, k=1) + np.eye(49, k=-1))
    for index in range(2, len(weights), 7):
        count, variance = lengths[index], own**2 + variances[index]
        for which in range(0, weights.shape[1], 9):
            fraction = (which + 0.5) / weights.shape[1] - 0.5
            places = np.arange(count) - (count - 1) / 2.0 - fraction
            if rule is SPECTRUM_TAPS:
                moments = weights[index, which, :count] @ np.stack([places, places**2], axis=1)
                np.testing.assert_allclose(moments, [0.0, variances[index] + 0.25], atol=1e-5)
            # Index of the first azimuth sample that the filter uses. With this index, the samples of the filter are in
            # the middle of all 49 samples.
            first = 24 - count // 2
            for line in on_rays[first] - places[0] + np.linspace(-6.0, 6.0, 49):
                values = np.exp(-0.5 * ((on_rays - line) / own) ** 2) / own
                coefficients = np.linalg.solve(between, values)
                result = weights[index, which, :count] @ coefficients[first : first + count]
                away = on_rays[first] - places[0] - line
                exact = np.exp(-0.5 * away**2 / variance) / np.sqrt(variance)
                assert abs(result - exact) * np.sqrt(variance) < worst


def test_a_flat_mesh_under_an_orthographic_camera_has_no_footprints(fingers):
    disc = meshes.disc(inner_radius=0.0, outer_radius=1.0, segments=32, rings=3)
    along_x = np.tile([1.0, 0.0, 0.0], (len(disc.vertices), 1))
    camera = wd.View.orthographic((0.3, 0, 2), (0, 0, 0), extent_y=0.5, width=16, height=12)
    plan = wd.shade(disc, fingers, LIGHT, camera, coherence=SHORT, tangents=along_x).plan
    options = {"plan": plan, "tangents": along_x}
    images = [wd.shade(disc, fingers, LIGHT, camera, footprint=means, **options) for means in (True, False)]
    np.testing.assert_allclose(images[0].xyz, images[1].xyz, rtol=2e-3)
