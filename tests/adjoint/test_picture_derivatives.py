"""``wd.adjoint.pixels``: colours and derivatives equal those of pictures and explicit sums; bad calls raise errors."""

import dataclasses
import functools
import math
import re
from unittest import mock

import complex_step
import numpy as np
import pytest
from conftest import noise, relative_errors
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

import warpdiff as wd
from warpdiff.adjoint import picture_model, series_length
from warpdiff.adjoint.coefficient_series import CoefficientSeries, SeriesSize
from warpdiff.adjoint.colour_splines import curve_weights, ring_count
from warpdiff.adjoint.gaussian_lobes import Pairs
from warpdiff.adjoint.lobe_pyramid import LobePyramid
from warpdiff.adjoint.polar_grid_sums import PolarGridSums, RingGrid, RingSizes, kappa_margin
from warpdiff.adjoint.series_length import term_count
from warpdiff.adjoint.sites import Block
from warpdiff.adjoint.surfaces import Relief
from warpdiff.adjoint.wavelength_sums import WavelengthSums
from warpdiff.core import memory
from warpdiff.kernels import lobe_sums
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.render.picture_samples import LitPixels, samples_of

FIELD = noise((50, 56), (0.094, 0.09))
WINDOW = wd.Coherence(sigma_um=1.5)
SOURCE = wd.Coherence("source", angular_diameter_deg=4.0)
LIGHT = wd.DirectionalLight((0.3, 1.0, 0.8))
POINTS = {"footprint": False, "refine": False, "coherence": WINDOW}


@pytest.fixture(scope="module")
def body():
    return wd.meshes.tube(radius=0.3, bend_deg=0.0, segments_along=24, segments_around=24)


@pytest.fixture(scope="module")
def view():
    """Return a view of a part of the tube. Directions change little within its pixels (small footprints)."""
    return wd.View((0.0, 2.0, 0.6), (0.0, 0.3, 0.0), up=(0.0, 0.0, -1.0), fov_y_deg=10.0, width=13, height=8)


def renderer_of(body, view, light=LIGHT, surface=FIELD, **options):
    return wd.Renderer(body, surface, light, view, **(POINTS | {"ior": math.inf, "tolerance": 1e-3} | options))


@pytest.fixture(scope="module")
def renderers(body, view):
    """Return a function that returns a renderer for a name in ``OPTIONS``. Each renderer is made only once."""
    return functools.cache(lambda name: renderer_of(body, view, **OPTIONS[name]))


@pytest.fixture
def points(renderers):
    return renderers("points")


def check_transposes(result, rng, *names):
    """Check ⟨y, J x⟩ = ⟨Jᵀ y, x⟩ for random x and y, where J is the matrix of derivatives by one of the variables.

    jvp gives J x, and vjp gives Jᵀ y.
    """
    y = rng.normal(size=result.value.shape)
    adjoints = result.vjp(y)
    assert set(adjoints) == set(names)
    for name, adjoint in adjoints.items():
        change = rng.normal(size=adjoint.shape)
        scale = np.sum(np.abs(y * result.jvp(**{name: change})))
        assert abs(np.sum(y * result.jvp(**{name: change})) - np.sum(adjoint * change)) <= 1e-12 * scale, name


def reflected(renderer, surface, wrt=(), light=LIGHT, **options):
    """Return XYZ in the directions of all pixels, with derivatives, and the ratios of pixel colours to these XYZ."""
    (lit,) = samples_of(renderer, light).lobes
    views = -lit.scattering_vectors - lit.to_lights
    ratio = lit.gains / reflectance_factors.gain(lit.to_lights, views, normal=1.0, masking=True)
    result = wd.adjoint.reflectance(
        surface, lit.to_lights, views, wrt=wrt, coherence=WINDOW, ior=math.inf, truncation=1e-8, **options
    )
    return result, ratio[:, None]


MEANS = {"footprint": True, "integration": "table", "tolerance": 0.05}
OPTIONS = {
    "points": {}, "footprints": MEANS, "source": {"coherence": SOURCE, "tolerance": 0.05},
    "footprints of a source": {"coherence": SOURCE, **MEANS}, "ior": {"ior": 1.4},
    "material": {"ior": None, "material": wd.Material.metal("Au"), "tolerance": 1e-2}, "no masking": {"masking": False},
}  # fmt: skip


@pytest.mark.parametrize("name", OPTIONS)
def test_values_are_those_of_the_picture(name, renderers):
    renderer = renderers(name)
    image = renderer.image()
    value = wd.adjoint.pixels(renderer, FIELD, LIGHT, wrt=(), tolerance=1e-3).value
    shown = image.xyz[image.illuminated]
    most = 5e-3 if renderer.plan.tolerance < 1e-2 else 2e-2
    assert np.quantile(relative_errors(shown, value), 0.9) <= most
    assert np.linalg.norm(shown - value) <= most * np.linalg.norm(value)


def test_values_and_gradients_are_those_of_reflectances_at_the_pixels(points, rng):
    names = ("heights_um", "height_scale")
    exact, ratio = reflected(points, FIELD, names)
    weights = rng.normal(size=exact.value.shape)
    expected = exact.vjp(weights * ratio)
    for tolerance, most in ((1e-2, 5e-3), (1e-3, 1e-3)):
        result = wd.adjoint.pixels(points, FIELD, LIGHT, wrt=names, tolerance=tolerance)
        assert np.linalg.norm(result.value - ratio * exact.value) <= most * np.linalg.norm(result.value)
        gradient = result.vjp(weights)
        off = np.linalg.norm(gradient["heights_um"] - expected["heights_um"])
        assert off <= most * np.linalg.norm(expected["heights_um"])
        assert abs(gradient["height_scale"] - expected["height_scale"]) <= most * np.sum(
            np.abs(expected["heights_um"] * FIELD.heights_um)
        )


@pytest.mark.parametrize("name", ["points", "footprints"])
def test_tangents_are_those_of_pictures(name, body, view, rng):
    """Derivatives by ``wd.adjoint`` must equal central differences of pictures, which are rendered by other code."""
    # The default method fits basis functions to each surface. Two fits would differ by more than the pictures do.
    options = OPTIONS[name] | {"method": "power" if name == "footprints" else "jacobi-anger"}
    renderer = renderer_of(body, view, **options)
    change = rng.normal(size=FIELD.shape)

    def picture(step):
        surface = wd.HeightField.of_known_scale(FIELD.heights_um + step * change, FIELD.pitch_um)
        footprint = name == "footprints"
        image = wd.shade(
            body, surface, LIGHT, view, plan=renderer.plan, footprint=footprint, refine=False, ior=math.inf
        )
        return image.xyz[image.illuminated].astype(np.float64)

    difference = (picture(1e-3) - picture(-1e-3)) / 2e-3
    tangent = wd.adjoint.pixels(renderer, FIELD, LIGHT, tolerance=1e-3).jvp(heights_um=change)
    assert np.linalg.norm(tangent - difference) <= 2e-2 * np.linalg.norm(difference)


def test_a_pixel_has_the_derivative_of_an_explicit_sum(body, view):
    """The derivative of a pixel must equal that of an explicit sum over wavelengths, computed by complex steps."""
    surface = wd.HeightField.of_known_scale(np.random.default_rng(3).normal(0.0, 0.05, (6, 8)), (0.09, 0.08))
    renderer = renderer_of(body, view, surface=surface)
    result = wd.adjoint.pixels(renderer, surface, LIGHT, tolerance=1e-4)
    brightest = int(np.argmax(result.value[:, 1]))
    (lit,) = samples_of(renderer, LIGHT).lobes
    to_light, vector = lit.to_lights[brightest], lit.scattering_vectors[brightest]
    wavenumbers, weights = colorimetry.uniform_quadrature(60, "D65")
    p = {
        "heights_um": surface.heights_um, "pitch_um": np.array(surface.pitch_um), "to_light": to_light,
        "to_view": -vector - to_light, "sigma_um": WINDOW.sigma_um, "ior": np.inf,
    }  # fmt: skip
    ones = np.zeros_like(result.value)
    ones[brightest, 1] = 1.0
    index = (2, 3)
    slopes = [
        complex_step.derivative(
            lambda q, nm=1e3 / tau: complex_step.spectral_reflectance(q, "averaged", nm, masking=True),
            p, "heights_um", index,
        )
        for tau in wavenumbers
    ]  # fmt: skip
    gain = reflectance_factors.gain(to_light[None], (-vector - to_light)[None], normal=1.0, masking=True)[0]
    expected = lit.gains[brightest] / gain * np.sum(np.array(slopes) * weights[:, 1])
    assert result.vjp(ones)["heights_um"][index] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("name", OPTIONS)
def test_tangents_are_the_transposes_of_adjoints(name, renderers, rng):
    names = ("heights_um", "height_scale", *(["ior"] if name == "ior" else []))
    result = wd.adjoint.pixels(renderers(name), FIELD, LIGHT, wrt=names)
    check_transposes(result, rng, *names)


@pytest.mark.parametrize("shape", [(40, 48), (1, 48), (48, 1)])
def test_sums_over_rings_and_their_transpose(shape, rng):
    """Sums over rings and their transpose must equal explicit sums of random Fourier coefficients.

    A ring is a circle of the polar grid of frequencies. Directions are random. The test is made with and without an
    excluded Fourier coefficient.
    """
    relief = Relief.of(noise(shape))
    vectors = np.column_stack([rng.normal(0.0, 0.4, (300, 2)), -rng.uniform(0.5, 1.9, 300)])
    vectors[0, :2] = 0.0
    lit = LitPixels(
        np.arange(300), vectors, np.zeros((300, 3)), rng.uniform(0.5, 2.0, 300), None,
        IlluminatedMaterial("D65"),
    )  # fmt: skip
    sizes, falloff, exponent = RingSizes(24, 1.3), 40.0, 12.0
    grid = RingGrid([lit], sizes, falloff)
    block = grid.block(exponent, relief.shape, relief.size_um)
    margin = kappa_margin(sizes)
    size = SeriesSize.of(relief, (0.4 / margin, 5.5 * margin), 1e-4, powers=True)
    series = CoefficientSeries(relief, block, size, powers=True)
    for excluded in (-1, int(rng.integers(block.size))):
        sums = PolarGridSums(grid, series.lobes(exponent), [lit], excluded)
        coefficients = rng.normal(size=(2 * series.sites.count, size.count))
        adjoints, rows = rng.normal(size=(300, 3)), np.zeros((block.size, size.count))
        sums.spread([adjoints], rows)
        (xyz,) = sums.sums(coefficients)
        left, right = np.sum(adjoints * xyz), np.sum(rows * coefficients[series.sites.places])
        assert abs(left - right) <= 1e-12 * np.sum(np.abs(adjoints * xyz))
        assert excluded < 0 or not rows[excluded].any()


@pytest.mark.parametrize("shape", [(60, 70), (1, 90), (80, 1)])
def test_sums_under_wide_lobes_and_their_transpose(shape, rng):
    """Sums over orders with wide Gaussian weights (lobes) may add neighbouring orders first, with a small error.

    The lobes have very different sizes and directions.
    """
    relief = Relief.of(noise(shape))
    first, counts = ([0 if n == 1 else 3 - n // 2 for n in shape], [1 if n == 1 else n - 7 for n in shape])
    block = Block((first[0], first[1]), (counts[0], counts[1]))
    size = SeriesSize.of(relief, (1.0, 5.0), 1e-4, powers=True)
    series = CoefficientSeries(relief, block, size, powers=True)
    count, steps = 60, 1.0 / np.array(relief.size_um)[::-1]
    deviations = np.exp(rng.uniform(np.log(0.3), np.log(25.0), (count, 2))) * steps
    turns = rng.uniform(-0.9, 0.9, count)
    xx, yy = deviations.T**2
    xy = turns * np.sqrt(xx * yy)
    forms = 0.5 * np.stack([yy, -xy, xx], axis=1) / (xx * yy - xy * xy)[:, None]
    centres = rng.uniform(-0.3, 0.3, (count, 2)) * (np.array(shape)[::-1] - 1) * steps
    pairs = Pairs(centres, forms, rng.uniform(1.0, 5.0, count))
    coefficients = rng.uniform(0.0, 1.0, (2 * series.sites.count, size.count)) * [1.0, *[0.1] * (size.count - 1)]
    series.powers()
    exact = series.lobes(16.0).sums(pairs, coefficients)
    pyramid = LobePyramid(series, relief.size_um, 16.0)
    sums = pyramid.sums_of(coefficients)(pairs)
    np.testing.assert_allclose(sums, exact, rtol=5e-3, atol=1e-3 * exact.max())
    if min(shape) > 1:
        assert np.linalg.norm(sums - exact) <= 2e-4 * np.sqrt(count) * exact.max()
    assert {level for level, *_ in pyramid._split(pairs)} >= {0, 1, 2}
    adjoints, rows = rng.normal(size=count), np.zeros((block.size, size.count))
    pyramid.spread([(pairs, adjoints)], rows)
    expected = np.sum(rows * coefficients[series.sites.places])
    assert abs(np.sum(adjoints * sums) - expected) <= 1e-12 * np.sum(np.abs(adjoints * sums))


def test_unused_azimuths_are_not_needed(rng):
    """A polar grid with only the azimuth samples that directions use must give the same colours as a full grid."""
    turns = np.concatenate([rng.uniform(0.1, 0.12, 20), np.linspace(0.0, 1.0, 400, endpoint=False)])
    vectors = np.column_stack([np.cos(2.0 * np.pi * turns), np.sin(2.0 * np.pi * turns), np.full(420, -1.5)])
    lit = LitPixels(np.arange(420), vectors, np.zeros((420, 3)), np.ones(420), None, IlluminatedMaterial("D65"))
    relief, falloff, exponent = Relief.of(noise((60, 61))), 200.0, 12.0
    colours = []
    for group in (lit.among(np.arange(20)), lit):
        grid = RingGrid([group], RingSizes(24, 1.3), falloff)
        block = grid.block(exponent, relief.shape, relief.size_um)
        size = SeriesSize.of(relief, (1.0, 5.0), 1e-4, powers=True)
        series = CoefficientSeries(relief, block, size, powers=True)
        (xyz,) = PolarGridSums(grid, series.lobes(exponent), [group], -1).sums(series.powers())
        colours.append(xyz[:20])
    np.testing.assert_allclose(*colours, rtol=1e-6)


@pytest.mark.parametrize("rings", [24, 40])
def test_splines_of_colour_curves_integrate_smooth_spectra(rings):
    """Splines fitted to colour curves must give the colours of sums over λ; the spectrum oscillates every 90 nm."""
    products, nm = colorimetry.colour_products("D65"), np.arange(380.0, 781.0)
    for interval in (0, 17, 64):
        step = math.log(2.0) / rings
        centres = 780.0 * np.exp(-(np.arange(ring_count(rings)) + interval / 64 - 2.0) * step)
        fine = np.linspace(-1.5, 1.5, 301)
        b_spline = np.where(np.abs(fine) < 0.5, 0.75 - fine**2, 0.5 * (1.5 - np.abs(fine)) ** 2)
        values = [step * np.trapezoid(b_spline * spectrum(c * np.exp(-fine * step)), fine) for c in centres]
        xyz = np.asarray(values) @ curve_weights("D65", rings)[interval]
        np.testing.assert_allclose(xyz, spectrum(nm) @ products, rtol=4e-3)


def spectrum(nm):
    return 1.0 + np.cos(2.0 * np.pi * nm / 90.0)


def test_finer_grids_are_used_until_the_tolerance_is_met(points):
    """The polar grid of spatial frequencies must become finer until the tolerance is met.

    If no grid suffices, sums over wavelengths must be used.
    """
    used = []
    by_rings = picture_model.PictureModel._by_rings

    def recorded(model, sizes, size):
        used.append(sizes.rings_per_octave)
        return by_rings(model, sizes, size)

    with mock.patch.object(picture_model.PictureModel, "_by_rings", recorded):
        wd.adjoint.pixels(points, FIELD, LIGHT, wrt=(), tolerance=0.1)
        assert used == [24]
        used.clear()
        value = wd.adjoint.pixels(points, FIELD, LIGHT, wrt=(), tolerance=1e-5).value
        assert used == [24, 32, 48, 96]
    exact, ratio = reflected(points, FIELD)
    assert np.linalg.norm(value - ratio * exact.value) <= 1e-6 * np.linalg.norm(value)


def test_deep_surfaces_have_grids(points):
    """For heights of several wavelengths, a polar grid of frequencies must meet the tolerance, without sums over λ."""
    deep = wd.HeightField.of_known_scale(20.0 * FIELD.heights_um[:9, :10], FIELD.pitch_um)
    with mock.patch.object(picture_model.PictureModel, "_by_wavelengths", side_effect=AssertionError):
        value = wd.adjoint.pixels(points, deep, LIGHT, wrt=()).value
    with mock.patch.object(picture_model, "_SIZES", ()):
        exact = wd.adjoint.pixels(points, deep, LIGHT, wrt=()).value
    assert np.linalg.norm(value - exact) <= 1e-2 * np.linalg.norm(exact)


def test_series_with_more_terms_than_kernels_support_use_no_grid(points):
    """A height range of 20 µm needs longer series than kernels support. Sums over λ must replace the polar grid."""
    deep = wd.HeightField.of_known_scale(10.0 * np.sin(np.arange(64.0) * np.pi / 32.0)[None], FIELD.pitch_um)
    with mock.patch.object(picture_model, "PolarGridSums", side_effect=AssertionError):
        value = wd.adjoint.pixels(points, deep, LIGHT, wrt=()).value
    assert np.isfinite(value).all()
    assert term_count(series_length._MOST_ARGUMENT, 0.0) <= lobe_sums.MOST_TERMS


def test_derivatives_by_the_index_of_refraction(square):
    """Derivatives of pixels by the index of refraction must equal those of ``wd.adjoint.reflectance`` there."""
    view, light = wd.View((0.0, -3.0, 1.0), (0.0, 0.0, 0.0), width=8, height=6), wd.DirectionalLight((0.3, 3.0, 1.0))
    results = [
        wd.adjoint.pixels(renderer_of(square, view, light, ior=ior, tolerance=0.1), FIELD, light, wrt=("ior",))
        for ior in (1.398, 1.4, 1.402)
    ]
    difference = (results[2].value - results[0].value) / 0.004
    np.testing.assert_allclose(results[1].jvp(ior=1.0), difference, rtol=1e-3)


def test_pictures_of_metals_and_films_have_grids(body, view):
    """Metals and thin films must use polar grids; each ring (circle) uses the reflectance at its wavelengths."""
    film = wd.Material.metal("Cr").coated(wd.Material.dielectric(1.4), 300.0)
    renderer = renderer_of(body, view, ior=None, material=film, tolerance=0.1)
    with mock.patch.object(picture_model.PictureModel, "_by_wavelengths", side_effect=AssertionError):
        value = wd.adjoint.pixels(renderer, FIELD, LIGHT, wrt=(), tolerance=3e-3).value
    with mock.patch.object(picture_model, "_SIZES", ()):
        exact = wd.adjoint.pixels(renderer, FIELD, LIGHT, wrt=(), tolerance=1e-3).value
    assert np.linalg.norm(value - exact) <= 2e-3 * np.linalg.norm(exact)


def test_pixels_in_the_mirror_direction(square, rng):
    """Pixels in the mirror direction must include the zeroth order.

    The scene is a flat square under a light behind the camera.
    """
    view = wd.View((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), width=24, height=24)
    light = wd.PointLight((0.0, 0.0, 3.0))
    renderer = renderer_of(square, view, light)
    image = renderer.image()
    result = wd.adjoint.pixels(renderer, FIELD, light, tolerance=1e-3)
    assert np.linalg.norm(image.xyz[image.illuminated] - result.value) <= 3e-3 * np.linalg.norm(result.value)
    with mock.patch.object(picture_model, "_SIZES", ()):
        exact = wd.adjoint.pixels(renderer, FIELD, light, tolerance=1e-3)
    weights = rng.normal(size=exact.value.shape)
    expected = exact.vjp(weights)["heights_um"]
    assert np.linalg.norm(result.vjp(weights)["heights_um"] - expected) <= 2e-3 * np.linalg.norm(expected)
    check_transposes(result, rng, "heights_um")


def test_several_lights_pigment_and_materials_by_part(body, view, rng):
    """Colours under several lights must add up. The light that the pigment reflects must not depend on heights."""
    pigmented = body.copy()
    material = PBRMaterial(baseColorFactor=[200, 120, 50, 255])
    pigmented.visual = TextureVisuals(uv=body.visual.uv, material=material)
    lights = [LIGHT, wd.PointLight((-1.0, 2.0, 1.0), power=4.0, illuminant="A")]
    renderer = renderer_of(pigmented, view, lights, ior=1.4)
    image = renderer.image()
    result = wd.adjoint.pixels(renderer, FIELD, lights, tolerance=1e-3)
    assert np.linalg.norm(image.xyz[image.illuminated] - result.value) <= 5e-3 * np.linalg.norm(result.value)
    flat = wd.adjoint.pixels(renderer, wd.HeightField(np.zeros((4, 4)), 0.1), lights, wrt=()).value
    assert np.quantile(flat[:, 1], 0.1) > 0.0
    check_transposes(result, rng, "heights_um")
    # The colours under each single light are added at the pixels of the picture under all lights.
    total = np.zeros((*image.illuminated.shape, 3))
    plain = renderer_of(body, view, lights)
    for light in lights:
        alone = renderer_of(body, view, light).image().illuminated
        total[alone] += wd.adjoint.pixels(plain, FIELD, light, wrt=(), tolerance=1e-4).value
    both = wd.adjoint.pixels(plain, FIELD, lights, wrt=(), tolerance=1e-4).value
    np.testing.assert_allclose(both, total[image.illuminated], atol=1e-3 * both.max())


def test_discs_widen_footprints(body, view):
    disc = wd.DirectionalLight((0.3, 1.0, 0.8), angular_diameter_deg=1.0)
    renderer = renderer_of(body, view, disc, footprint=True, tolerance=0.02)
    image = renderer.image()
    value = wd.adjoint.pixels(renderer, FIELD, disc, wrt=()).value
    assert np.linalg.norm(image.xyz[image.illuminated] - value) <= 3e-2 * np.linalg.norm(value)


def test_footprints_at_silhouettes_have_a_largest_size(body):
    view = wd.View.fit(body, width=24, height=16)
    renderer = renderer_of(body, view, footprint=True, tolerance=0.1, strict=False)
    (lit,) = samples_of(renderer, LIGHT).lobes
    uu, uv, vv = lit.footprints.T
    largest = np.sqrt((uu + vv) / 2.0 + np.hypot((uu - vv) / 2.0, uv))
    assert largest.max() == pytest.approx(0.35)
    assert largest.min() < 0.35
    assert np.isfinite(wd.adjoint.pixels(renderer, FIELD, LIGHT, wrt=()).value).all()


def test_grazing_lights_of_a_source_warn_of_missing_wavelengths():
    to_light = np.array([[0.9998, 0.0, 0.02], [0.0, 0.0, 1.0]])
    vectors, ones = -to_light - [0.6, 0.0, 0.8], np.ones(2)
    lit = LitPixels(np.arange(2), vectors, to_light, ones, None, IlluminatedMaterial("D65"))
    with pytest.warns(wd.WarpdiffWarning, match=r"1 of 2 samples require more than 20000 wavelengths"):
        WavelengthSums([lit], wd.Coherence("source", angular_diameter_deg=0.1), 1e-4, 0.1)


def test_thick_films_require_more_wavelengths(points):
    (lit,) = samples_of(points, LIGHT).lobes
    lit = dataclasses.replace(lit, scattering_vectors=lit.scattering_vectors * [0.01, 0.01, 1.0])
    film = wd.Material.metal("Cr").coated(wd.Material.dielectric(1.4), 1000.0)
    coated = dataclasses.replace(lit, illuminated=IlluminatedMaterial("D65", film))
    plain, thick = (WavelengthSums([group], WINDOW, 1e-4, 0.01).pair_count for group in (lit, coated))
    assert thick >= 2 * plain


def test_outlines_replace_the_height_field(points, rng):
    grating = wd.profiles.Trapezoid(0.12, 0.4, 0.05, 1.5)
    outline = grating.surface(grating.start)
    result = wd.adjoint.pixels(points, outline, LIGHT, wrt=("vertices", "height_scale"), tolerance=1e-3)
    check_transposes(result, rng, "vertices", "height_scale")
    exact, ratio = reflected(points, outline, ("vertices",))
    weights = rng.normal(size=exact.value.shape)
    expected = exact.vjp(weights * ratio)["vertices"]
    np.testing.assert_allclose(result.vjp(weights)["vertices"], expected, atol=2e-3 * np.abs(expected).max())


def test_the_renderer_and_its_picture_remain_unchanged(points):
    before = points.image().xyz
    wd.adjoint.pixels(points, FIELD, wd.DirectionalLight((0.0, 1.0, 0.1)), wrt=())
    assert np.array_equal(points.image().xyz, before)


def test_a_dark_picture_has_no_pixels_and_warns(square):
    behind = wd.DirectionalLight((0.0, 0.1, -1.0))
    renderer = renderer_of(square, wd.View((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), width=8, height=8), behind)
    with pytest.warns(wd.WarpdiffWarning, match="horizon"):
        result = wd.adjoint.pixels(renderer, FIELD, behind)
    assert result.value.shape == (0, 3)
    assert not result.vjp(np.zeros((0, 3)))["heights_um"].any()
    assert result.jvp(heights_um=np.ones(FIELD.shape)).shape == (0, 3)


REFUSED = {
    "refine=False": {"refine": True}, "samples_per_pixel=1": {"samples_per_pixel": 4},
    "energy='stam'": {"energy": "normalised"},
    "kind 'averaged' or 'source', got 'centred'": {"coherence": wd.Coherence("centred", 1.5)},
    "kind 'averaged' or 'source', got 'replicas'": {"coherence": wd.Coherence("replicas", periods=(2, 2))},
}  # fmt: skip


@pytest.mark.parametrize("message", REFUSED)
def test_pictures_without_derivatives_are_refused(message, body, view):
    options = POINTS | {"tolerance": 0.1} | REFUSED[message]
    surface = noise((8, 9), (0.094, 0.09))
    renderer = wd.Renderer(body, surface, LIGHT, view, strict=False, **options)
    with pytest.raises(ValueError, match=re.escape(message)):
        wd.adjoint.pixels(renderer, surface, LIGHT)


def test_other_arguments_are_refused(body, view, points):
    with pytest.raises(TypeError, match="renderer"):
        wd.adjoint.pixels(body, FIELD, LIGHT)
    with pytest.raises(TypeError, match="lights"):
        wd.adjoint.pixels(points, FIELD, [])
    with pytest.raises(TypeError, match="HeightField or a warpdiff"):
        wd.adjoint.pixels(points, FIELD.heights_um, LIGHT)
    with pytest.raises(ValueError, match=r"tolerance.*at least"):
        wd.adjoint.pixels(points, FIELD, LIGHT, tolerance=1e-9)
    for name in ("pitch_um", "sigma_um", "to_light", "n"):
        with pytest.raises(ValueError, match=r"pixels has derivatives by heights_um, height_scale$"):
            wd.adjoint.pixels(points, FIELD, LIGHT, wrt=(name,))
    with pytest.raises(ValueError, match=r"requires footprints"):
        wd.adjoint.pixels(points, FIELD, dataclasses.replace(LIGHT, angular_diameter_deg=1.0))
    footprints = renderer_of(body, view, footprint=True, tolerance=0.1)
    for light in (wd.Environment(np.ones((8, 16, 3))), dataclasses.replace(LIGHT, angular_diameter_deg=20.0)):
        with pytest.raises(ValueError, match="skies and wide discs have no derivative"):
            wd.adjoint.pixels(footprints, FIELD, light)
    cells = renderer_of(body, view, footprint=True, integration="sampled")
    with pytest.raises(ValueError, match="with a plan without footprints"):
        wd.adjoint.pixels(cells, FIELD, LIGHT)
    surfaces = wd.Renderer(body, {"mesh 0/material_0": FIELD}, LIGHT, view, tolerance=0.1, strict=False, **POINTS)
    with pytest.raises(ValueError, match="pictures of several surfaces have no derivative"):
        wd.adjoint.pixels(surfaces, FIELD, LIGHT)


def test_too_much_memory_is_refused_before_work_starts(points, monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 1e6)
    with pytest.raises(MemoryError, match="GB are free"):
        wd.adjoint.pixels(points, FIELD, LIGHT)


def test_blocks_are_joined():
    assert Block((-1, 2), (3, 4)).joined(Block((0, -5), (8, 2))) == Block((-1, -5), (9, 11))
