"""Tables for light sources of finite size (coherence of kind "source"), whose spectral lines are blurred in look-ups.

Colours are compared with a reference, closed forms and sums over sampled wavelengths. A source is such a light source.
A plan has the numbers of a computation. A table stores colours on rings, circles of constant |(u, v)|.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

import dataclasses

import numpy as np
import pytest
import warp as wp
from conftest import hemisphere, relative_errors, slow

import warpdiff as wd
from bench.truth import reference
from warpdiff import meshes
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.planner import trial
from warpdiff.request.directions import DirectionSample
from warpdiff.tables import polar_grid
from warpdiff.tables.lookup import ColourLookup

SOURCE = wd.Coherence("source", angular_diameter_deg=1.5)
LIGHT = wd.DirectionalLight((0.1, 0.9, 1.2))


@pytest.fixture(scope="module")
def plan(fingers):
    return wd.plan(fingers, tolerance=1e-1, coherence=SOURCE, method="low-rank", integration="table")


def test_a_table_meets_its_tolerance(fingers, plan, rng):
    lights, views = hemisphere(rng, 80), hemisphere(rng, 80)
    assert plan.rings_per_octave > 0
    # The predicted error of a plan is the measured error of its colour table times a safety factor. The predicted error
    # may therefore exceed the tolerance although the table is accepted.
    assert plan.error <= trial.SEARCH_SAFETY * 1e-1
    assert plan.multiply_adds < 1e3
    result = wd.reflectance(fingers, lights, views, plan=plan)
    gains = reflectance_factors.gain(
        lights, views, normal=reflectance_factors.normal_reflectance(1.5), masking=True, per_light_cosine=True
    )
    exact = gains[:, None] * reference.colours(fingers, -lights - views, lights, SOURCE, tolerance=1e-3)
    errors = relative_errors(result, exact)
    assert np.median(errors) < 5e-3
    assert np.percentile(errors, 95.0) <= 1e-1
    # A tolerance of 0.1 requires a table with only few rings (circles of constant |(u, v)|). The median luminance must
    # still be accurate to 0.3 %.
    assert np.median(result[:, 1] / exact[:, 1]) == pytest.approx(1.0, abs=3e-3)


def test_more_rings_have_smaller_errors(fingers, plan, rng):
    lights, views = hemisphere(rng, 150), hemisphere(rng, 150)
    exact = wd.reflectance(fingers, lights, views, coherence=SOURCE, method="low-rank", tolerance=1e-3)
    errors = []
    for nodes in (8, 16, 48):
        sized = dataclasses.replace(plan, rings_per_octave=nodes, azimuths_per_width=2.0)
        errors.append(np.median(relative_errors(wd.reflectance(fingers, lights, views, plan=sized), exact)))
    assert errors[0] > 1.5 * errors[1] > 2.0 * errors[2]


@pytest.mark.parametrize("incidence_deg", [0.0, 50.0])
def test_a_mirror_shows_the_source(incidence_deg):
    """A perfect mirror must show a white image of the source.

    At a distance d in (u, v) from the mirror direction, the brightness of the image is exp(−½ dᵀΣ⁻¹d), with the
    covariance Σ of the source. One tested distance is below the smallest |(u, v)| for which the table has colours, and
    one is above it.
    """
    flat = wd.HeightField(np.zeros((64, 64)), 0.09)
    plan = wd.plan(flat, coherence=SOURCE, method="low-rank")
    tabled = dataclasses.replace(plan, rings_per_octave=24, azimuths_per_width=2.0, least_weight=1e-8)
    theta = np.radians(incidence_deg)
    to_light = np.array([np.sin(theta), 0.0, np.cos(theta)])
    s = SOURCE.spread
    for away in ((0.0, 0.0), (0.5 * s * np.cos(theta), 1.5 * s)):
        x, y = np.array(away) - to_light[:2]
        to_view = np.array([x, y, np.sqrt(1.0 - x**2 - y**2)])
        exact = np.exp(-0.5 * ((away[0] / np.cos(theta)) ** 2 + away[1] ** 2) / s**2)
        gain = reflectance_factors.gain(to_light[None], to_view[None], normal=1.0, masking=True, per_light_cosine=True)
        result = wd.reflectance(flat, to_light, to_view, plan=tabled, ior=np.inf)
        np.testing.assert_allclose(result, exact * gain[0] * colorimetry.colour_products().sum(axis=0), rtol=2e-3)


@pytest.fixture(scope="module")
def sine():
    return wd.gratings.sinusoidal(1.0, 0.2)


@pytest.fixture(scope="module")
def sine_plan(sine):
    source = wd.Coherence("source", angular_diameter_deg=1.0)
    return wd.plan(sine, coherence=source, method="low-rank", strict=False)


@pytest.mark.parametrize(
    ("incidence_deg", "angle_deg"),
    [*((0.0, 0.0), (60.0, 35.0), (75.0, 55.0)),
     *(slow(*case) for case in ((0.0, 35.0), (0.0, 55.0), (60.0, 0.0), (60.0, 55.0), (75.0, 0.0), (75.0, 35.0)))],
)  # fmt: skip
def test_a_single_order_has_the_sources_shape(sine, sine_plan, angle_deg, incidence_deg):
    """Along v, the first diffraction order of a sine grating must have the profile of the source.

    This is tested for several planes of incidence. The grating disperses light only along x. A change of v therefore
    does not change the wavelengths that a direction shows.
    """
    source = sine_plan.coherence
    theta, phi = np.radians(incidence_deg), np.radians(angle_deg)
    to_light = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    u = 0.55 if to_light[0] > 0.3 else -0.55
    v = source.spread * np.linspace(-2.0, 2.0, 17)
    views = np.stack([np.full(17, u - to_light[0]), v - to_light[1], np.zeros(17)], axis=1)
    views[:, 2] = np.sqrt(1.0 - np.sum(views**2, axis=1))
    # Expected colours are sums over wavelengths in steps of 0.4 nm. Fourier transforms give the powers of the orders.
    nm = np.linspace(380.0, 780.0, 1001)
    products = np.stack([np.interp(nm, np.arange(380, 781), c) for c in colorimetry.colour_products().T], axis=1) * 0.4
    exact = []
    for view, away in zip(views, v, strict=True):
        kappas = (to_light[2] + view[2]) / (nm * 1e-3)
        powers = np.abs(np.fft.fft(np.exp(2j * np.pi * kappas[:, None] * sine.heights_um[0]), axis=1) / 64.0) ** 2
        spectral = np.zeros(len(nm))
        for order in (-2, -1, 1, 2):
            d = np.stack([u - order * nm * 1e-3, np.full(len(nm), away)])
            along = to_light[:2] @ d
            exponent = (np.sum(d**2, axis=0) + (along / to_light[2]) ** 2) / source.spread**2
            spectral += powers[:, order] * np.exp(-0.5 * exponent)
        exact.append(spectral @ products)
    gains = reflectance_factors.gain(
        np.tile(to_light, (17, 1)), views, normal=reflectance_factors.normal_reflectance(1.5), masking=True,
        per_light_cosine=True,
    )  # fmt: skip
    exact = gains[:, None] * np.array(exact)
    tabled = dataclasses.replace(sine_plan, rings_per_octave=64, azimuths_per_width=4.0)
    np.testing.assert_allclose(wd.reflectance(sine, to_light, views, plan=tabled), exact, atol=2e-2 * exact.max())


def test_directions_that_the_table_does_not_support_are_sampled(fingers, plan, rng):
    """Directions that the table excludes must be computed by sampled wavelengths, as accurately as other directions.

    The table excludes directions within its inner radius around the mirror direction. The lines of the spectrum in the
    table are already blurred a little. The table therefore also excludes directions in which a source at grazing
    incidence has a smaller blur.
    """
    to_light = np.array([0.6, 0.0, 0.8])
    angles = rng.uniform(0.0, 2.0 * np.pi, 60)
    uv = rng.uniform(0.1, 0.99, 60) * polar_grid.inner_radius(SOURCE)
    near = np.stack([uv * np.cos(angles) - 0.6, uv * np.sin(angles), np.zeros(60)], axis=1)
    grazing = np.tile([np.sqrt(1.0 - 0.02**2), 0.0, 0.02], (60, 1))
    aside = np.stack([-grazing[:, 0], np.linspace(0.2, 0.9, 60) * 0.02, np.zeros(60)], axis=1)
    for all_lights, all_views in ((np.tile(to_light, (60, 1)), near), (grazing, aside)):
        inside = np.sum(all_views**2, axis=1) < 1.0
        lights, views = all_lights[inside], all_views[inside]
        views[:, 2] = np.sqrt(1.0 - np.sum(views**2, axis=1))
        exact = wd.reflectance(fingers, lights, views, coherence=SOURCE, method="low-rank", tolerance=1e-3)
        result = wd.reflectance(fingers, lights, views, plan=plan)
        np.testing.assert_allclose(result, exact, atol=2e-3 * exact.max(), rtol=2e-2)


def test_directions_beyond_the_range_of_the_reference_do_not_count():
    """The percentile of the errors of a table must ignore directions for which the reference has too few wavelengths.

    For a light source at the horizon, there are such directions.
    """
    directions = DirectionSample(np.zeros((10, 3)), np.zeros((10, 3)), np.ones(10), np.ones(10))
    group = trial.Group(directions, wp.get_device("cpu"), 1)
    group.weigh(np.ones((1, 10, 3)), np.array([[1e-3]]))
    errors = np.zeros((1, 10))
    errors[0, 3] = 2.0
    assert trial.worst_percentile(errors, group) == 2.0
    assert trial.worst_percentile(errors, group, np.arange(10) != 3) == 0.0


def test_a_table_that_is_too_large_is_refused(rng):
    """A call must be refused if no colour table of at most 300 MB exists, or if the largest one is too inaccurate."""
    large = wd.gratings.fingers(size_um=25.6, seed=1)
    lights, views = hemisphere(rng, 64), hemisphere(rng, 64)
    for degrees, message in ((0.1, "12 rings per octave are too few"), (0.05, "requires more than 300 MB")):
        sharp = wd.Coherence("source", angular_diameter_deg=degrees)
        with pytest.raises(ValueError, match=message):
            wd.plan(large, lights, views, coherence=sharp, tolerance=1e-2, method="low-rank", integration="table")


def test_colours_are_continuous_at_azimuths_of_0_and_180_degrees(fingers, plan):
    """Colours must be continuous at azimuths of 0° and 180°.

    The azimuth samples (polar angles of (u, v)) of a table are periodic and begin at 0°, so that look-ups near 0° must
    also use the last samples.
    """
    views = []
    for degrees in (-1e-3, 1e-3, 180.0 - 1e-3, 180.0 + 1e-3):
        u, v = 0.6 * np.cos(np.radians(degrees)), 0.6 * np.sin(np.radians(degrees))
        views.append([-u, -v, np.sqrt(1.0 - 0.36)])
    result = wd.reflectance(fingers, (0.0, 0.0, 1.0), views, plan=plan)
    np.testing.assert_allclose(result[0], result[1], rtol=1e-2)
    np.testing.assert_allclose(result[2], result[3], rtol=1e-2)


@pytest.mark.parametrize(("directions", "size", "tolerance"), [
    ([[0.5, 0.4], [-0.9, 0.1], [0.2, -0.7]], 1.0, 3e-2), ([[0.0, 0.0], [0.04, -0.03], [-0.06, 0.1]], 0.4, 1e-3),
], ids=["by the table", "near the mirror direction"])  # fmt: skip
def test_footprints_widen_the_source(fingers, plan, directions, size, tolerance):
    """The colour of a footprint, the range of (u, v) that a pixel covers, must equal the mean over its points.

    Directions near the mirror direction are not in the table, and are integrated over sampled wavelengths.
    """
    from warpdiff.kernels.structs import Footprint

    device = wp.get_device("cpu")
    plan = dataclasses.replace(plan, footprint=True)
    lookup = ColourLookup(fingers, plan, plan.direction_range, device=device, threads=1)
    to_light = np.array([0.5, 0.3, np.sqrt(1.0 - 0.34)])
    footprint = size * np.array([[0.004, 0.009], [-0.006, 0.002]])
    places, weights = np.polynomial.hermite_e.hermegauss(24)
    a, b = np.meshgrid(places, places, indexing="ij")
    offsets = a[..., None] * footprint[0] + b[..., None] * footprint[1]
    share = np.outer(weights, weights) / weights.sum() ** 2

    def colours(uv, spread):
        count = len(uv)
        scattering_vectors = np.column_stack([uv, np.full(count, -1.4)])
        xyz = wp.zeros(count, dtype=wp.vec3f, device=device)
        lookup.accumulate(
            wp.array(scattering_vectors, dtype=wp.vec3d, device=device),
            wp.array(np.tile(to_light, (count, 1)), dtype=wp.vec3f, device=device),
            wp.ones(count, dtype=wp.float32, device=device), IlluminatedMaterial("D65"), xyz, footprints=spread,
        )  # fmt: skip
        return xyz.numpy()

    for uv in directions:
        mean = np.einsum("ab,abc->c", share, colours((uv + offsets).reshape(-1, 2), None).reshape(24, 24, 3))
        spread = wp.array([footprint.ravel()], dtype=Footprint, device=device)
        result = colours(np.array([uv]), spread)[0]
        np.testing.assert_allclose(result, mean, rtol=tolerance, atol=tolerance / 3.0 * mean.max())


def test_progress_increases_to_the_end_once(fingers, plan, rng):
    """The reported progress must increase to 1 only once.

    Directions that the table excludes are computed by sampled wavelengths after the look-ups. Sampling must not restart
    the progress.
    """
    lights, views = hemisphere(rng, 4000), hemisphere(rng, 4000)
    shares = []
    wd.reflectance(fingers, lights, views, plan=plan, progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert shares.count(1.0) == 1


def test_pictures_of_sources_have_footprints(fingers):
    tube = meshes.tube(segments_along=64, segments_around=48)
    view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=72, height=54)
    image = wd.shade(tube, fingers, LIGHT, view, coherence=SOURCE, tolerance=0.2)
    assert image.plan.footprint
    points = dataclasses.replace(image.plan, footprint=False)
    many = wd.shade(tube, fingers, LIGHT, view, plan=points, samples_per_pixel=100)
    one = wd.shade(tube, fingers, LIGHT, view, plan=points)
    inside = (many.coverage == 1.0) & image.illuminated
    errors = [np.median(relative_errors(case.xyz[inside], many.xyz[inside])) for case in (image, one)]
    assert errors[0] < 6e-2
    assert errors[0] < 0.3 * errors[1]
    for threads in (1, 3):
        repeated = wd.shade(tube, fingers, LIGHT, view, plan=image.plan, threads=threads)
        np.testing.assert_array_equal(repeated.xyz, image.xyz)
