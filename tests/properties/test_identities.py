"""Identities of every height field: reciprocity, symmetry, invariance, energy and direction of reflection.

κ is w/λ, the normal component w of the scattering vector divided by the wavelength. C is the geometry factor, and M the
masking and shadowing by the relief.
"""

import math

import numpy as np
import pytest
import warp as wp
from conftest import at_angle, coherence_of, hemisphere, launch, slow

import warpdiff as wd
from warpdiff.kernels import light_samples
from warpdiff.kernels.structs import Pixels
from warpdiff.optics import reflectance_factors

KINDS = ["averaged", "centred", "source", "replicas"]


@pytest.fixture(scope="module")
def rough():
    """Return a square patch of random finger-like bumps, whose Fourier spectrum is non-zero along both axes."""
    return wd.gratings.fingers(size_um=6.4, pitch_um=0.08, seed=7)


@pytest.mark.parametrize("kind", ["averaged", "centred", "replicas"])
def test_absolute_brdf_is_reciprocal(rough, kind, rng):
    """The absolute BRDF must be reciprocal for all kinds of coherence except "source".

    The kind "source" is not reciprocal, because its light has an extent and the viewer has none.
    """
    lights, views = hemisphere(rng, 40), hemisphere(rng, 40)
    options = {"coherence": coherence_of(kind, 4.0), "tolerance": 1e-4}
    there = wd.brdf(rough, lights, views, [450.0, 600.0], **options)
    back = wd.brdf(rough, views, lights, [450.0, 600.0], **options)
    np.testing.assert_allclose(there, back, rtol=2e-5, atol=1e-7 * there.max())


@pytest.mark.parametrize("ior", [1.5, 2.4, math.inf])
def test_gain_over_cosine_is_symmetric(ior, rng):
    lights, views = hemisphere(rng, 200, 1e-4), hemisphere(rng, 200, 1e-4)
    normal = reflectance_factors.normal_reflectance(ior)
    there = reflectance_factors.gain(lights, views, normal=normal, masking=False) / lights[:, 2]
    back = reflectance_factors.gain(views, lights, normal=normal, masking=False) / views[:, 2]
    np.testing.assert_allclose(there, back, rtol=1e-12)


def kernel_gain(lights, views, normal, masking, device):
    """Return the gains C·M of n lights and n views, computed by the kernel for n pixels with one light per pixel."""
    reflection = light_samples.Reflection()
    reflection.masking = masking
    count = len(lights)

    def array(values, dtype=wp.vec3f):
        return wp.array(values, dtype=dtype, device=device)

    reflection.normal_reflectances, reflection.units = array([normal], wp.float64), array([1.0], wp.float64)
    reflection.per_light_cosine = array([False], wp.bool)
    given = light_samples.Lights()
    given.places = array(np.column_stack([lights, np.zeros(count)]), wp.vec4d)
    given.strengths = array(np.ones(count), wp.float64)
    pixels = Pixels()
    pixels.hit = array(np.ones(count), wp.int32)
    for name, axis in (("tangent", (1, 0, 0)), ("bitangent", (0, 1, 0)), ("normal", (0, 0, 1))):
        setattr(pixels, name, array(np.tile(axis, (count, 1))))
    pixels.to_view = array(views)
    result = [array(np.ones((count, 3)), wp.vec3d), array(np.ones((count, 3))), array(np.ones(count), wp.float32)]
    none = [array([], dtype) for dtype in (wp.vec3f, wp.float64, wp.bool)]
    for i in range(count):
        inputs = [pixels, given, i, array([], wp.vec4f), reflection, 1.0, 0.0, False, False, array([], wp.bool), i, 1]
        launch(light_samples.scattering_vectors, dim=1, inputs=inputs, outputs=[*result, *none], device=device)
    unit_views = views / np.linalg.norm(views, axis=1, keepdims=True)
    np.testing.assert_allclose(result[0].numpy(), -lights - unit_views, atol=1e-12)
    return result[2].numpy()


def power_width(coherence):
    """Return the width (standard deviation) [1/µm] of the Gaussian over which a coherence window spreads an order."""
    return 1.0 / (2.0 * math.sqrt(2.0) * math.pi * coherence.sigma_um)


@pytest.mark.parametrize("masking", [True, False])
@pytest.mark.parametrize("ior", [1.5, math.inf])
def test_gain_of_the_kernel_equals_the_formula(masking, ior, rng, device):
    """The kernel's gain C·M (geometry factor and masking) must equal ``reflectance_factors.gain`` up to the horizon."""
    lights, views = hemisphere(rng, 400, 0.0017), hemisphere(rng, 400, 0.0017)
    views[:50] = lights[:50] * [-1.0, -1.0, 1.0]  # views in the mirror direction of the light
    views[50:100] = lights[50:100]  # views in the direction of the light (retro-reflection)
    views[100:110, 2] = 0.0
    lights[110:120, 2] *= -1.0
    # The kernel stores view directions in float32. The formula is therefore evaluated for directions that are rounded
    # in the same way.
    views = views.astype(np.float32).astype(np.float64)
    unit_views = views / np.linalg.norm(views, axis=1, keepdims=True)
    unit_lights = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    normal = reflectance_factors.normal_reflectance(ior)
    result = kernel_gain(unit_lights, views, normal, masking, device)
    formula = reflectance_factors.gain(unit_lights, unit_views, normal=normal, masking=masking)
    np.testing.assert_allclose(result, formula, rtol=1e-6)

    half = unit_lights + unit_views
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    cos_d = np.sum(half * unit_views, axis=1)
    cos_i, cos_r = unit_lights[:, 2], unit_views[:, 2]
    fresnel = np.ones_like(cos_d) if ior == math.inf else 0.04 + 0.96 * (1.0 - cos_d) ** 5
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = fresnel / (1.0 if ior == math.inf else 0.04)
        expected = expected * (1.0 + np.sum(unit_lights * unit_views, axis=1)) ** 2 / ((cos_i + cos_r) ** 2 * cos_r)
        if masking:
            cos_h = half[:, 2]
            expected = expected * np.minimum(1.0, 2.0 * cos_h * np.minimum(cos_r, cos_i) / cos_d)
    expected[(cos_i <= 0.0) | (cos_r <= 0.0)] = 0.0
    np.testing.assert_allclose(result, expected, rtol=1e-5)
    assert np.all(np.isfinite(result))


@pytest.mark.parametrize("kind", ["averaged", "source"])
def test_powers_do_not_depend_on_the_position_of_the_patch(rough, kind, rng):
    lights, views = hemisphere(rng, 30), hemisphere(rng, 30)
    shifted = wd.HeightField(np.roll(rough.heights_um, (17, -29), axis=(0, 1)), rough.pitch_um)
    options = {"coherence": coherence_of(kind), "tolerance": 1e-4}
    values = [wd.spectral_reflectance(each, lights, views, [420.0, 580.0], **options) for each in (rough, shifted)]
    np.testing.assert_allclose(*values, rtol=1e-4, atol=1e-6 * values[0].max())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("turns", [1, 2, 3])
@pytest.mark.filterwarnings("ignore:opposite edges")
def test_rotating_patch_and_directions_changes_nothing(kind, turns, rng):
    """If the patch and all directions are rotated by quarter turns, results must not change.

    Each quarter turn maps (x, y) to (−y, x). Its centre is the central sample of the patch of 61 × 61 samples.
    """
    heights = wd.gratings.fingers(size_um=6.4, pitch_um=0.08, seed=7).heights_um[:61, :61]
    heightfield = wd.HeightField(heights, 0.08)
    # The first row of a height field has the smallest y, because row j is at y = j·dy. A quarter turn from x to y is
    # therefore ``numpy.rot90`` with −1.
    rotated = wd.HeightField(np.rot90(heights, -turns), 0.08)
    rotation = np.linalg.matrix_power(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), turns)
    lights, views = hemisphere(rng, 30), hemisphere(rng, 30)
    options = {"wavelengths_nm": [420.0, 580.0], "tolerance": 1e-4}
    before = wd.spectral_reflectance(heightfield, lights, views, coherence=coherence_of(kind, 3.0), **options)
    # The numbers of periods along x and y are exchanged by an odd number of quarter turns.
    coherence = coherence_of(kind, 3.0, periods=(3, 2) if turns % 2 else (2, 3))
    after = wd.spectral_reflectance(rotated, lights @ rotation.T, views @ rotation.T, coherence=coherence, **options)
    np.testing.assert_allclose(after, before, rtol=2e-4, atol=1e-6 * before.max())


def projected_disc(centre, radius, count):
    """Return view directions whose x and y lie in a disc around (``centre``, 0), and their quadrature weights.

    The weights are dω cos θr. The quadrature along x is in the angle θ, which removes the factor 1/cos θr from the
    integrand.
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    low = math.asin(max(0.0, centre - radius)) if centre - radius > 0.0 else -math.asin(min(1.0, radius - centre))
    high = math.asin(min(1.0, centre + radius))
    theta = (high - low) / 2.0 * nodes + (high + low) / 2.0
    y = radius * nodes
    x, measure_x = np.sin(theta), weights * (high - low) / 2.0 * np.cos(theta)
    x, y = np.meshgrid(x, y)
    measure = np.outer(weights * radius, measure_x)
    inside = x * x + y * y < 1.0
    z = np.sqrt(np.where(inside, 1.0 - x * x - y * y, 1.0))
    return np.stack([x, y, z], axis=-1)[inside], measure[inside]


@pytest.mark.parametrize("sigma_um", [3.25, 8.0, 16.25])
@pytest.mark.parametrize("theta_deg", [0.0, 30.0, 60.0, 75.0])
def test_flat_mirror_reflects_all(sigma_um, theta_deg):
    """Check that ∫ BRDF cos θr dω = 1 within 1 %.

    At 75°, the lobe of an order for the shortest coherence window extends to the horizon, where the formula of the BRDF
    itself is inexact. The integral is 1.007 at the tested wavelength of 550 nm, but 1.017 at 450 nm and 0.957 at 780
    nm.
    """
    assert mirror_power(sigma_um, theta_deg, math.inf) == pytest.approx(1.0, rel=1e-2)


@pytest.mark.parametrize("theta_deg", [0.0, 30.0, 60.0, 75.0])
def test_flat_glass_reflects_its_fresnel_power(theta_deg):
    cosine = math.cos(math.radians(theta_deg))
    fresnel = 0.04 + 0.96 * (1.0 - cosine) ** 5
    assert mirror_power(16.25, theta_deg, 1.5) == pytest.approx(fresnel, rel=1e-2)


def mirror_power(sigma_um, theta_deg, ior):
    flat = wd.HeightField(np.zeros((1, 1)), 0.05)
    wavelength = 0.55
    coherence = wd.Coherence(sigma_um=sigma_um)
    views, measure = projected_disc(math.sin(math.radians(theta_deg)), 6.0 * wavelength * power_width(coherence), 160)
    values = wd.brdf(flat, at_angle(-theta_deg), views, 1e3 * wavelength, coherence=coherence, ior=ior)[:, 0]
    return values @ measure


@pytest.mark.parametrize("period_um", [slow(0.7), 1.0, slow(2.0)])
def test_the_excess_energy_of_a_shallow_sine_follows_its_formula(period_um):
    """The total power that a mirror with a shallow sine profile reflects must follow a formula of scalar theory.

    Scalar theory violates the conservation of energy. For a profile of amplitude a, the reflected power is
    1 + (2πa/λ)² (1 − c)²/(2c) times the incident power. c is the cosine of the angle between the first order and the
    normal. The excess is about a millionth. Measuring it requires float64, a shallow profile and narrow lobes.
    """
    wavelength = 0.55
    amplitude = 0.001 * wavelength
    heightfield = wd.gratings.sinusoidal(period_um, 2.0 * amplitude)
    coherence = wd.Coherence(sigma_um=5e4)
    total = 0.0
    for order in (-1, 0, 1):
        centre = abs(order) * wavelength / period_um
        views, measure = projected_disc(centre, 7.0 * wavelength * power_width(coherence), 64)
        views = views * [order or 1, 1.0, 1.0]
        options = {"coherence": coherence, "ior": math.inf, "method": "direct"}
        values = wd.brdf(heightfield, (0, 0, 1), views, 1e3 * wavelength, **options)
        total += float(values[:, 0] @ measure)
    c = math.sqrt(1.0 - (wavelength / period_um) ** 2)
    expected = (2.0 * math.pi * amplitude / wavelength) ** 2 * (1.0 - c) ** 2 / (2.0 * c)
    assert total - 1.0 == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("method", ["auto", "direct"])
@pytest.mark.parametrize("cycles", [1, -1])
def test_a_tilt_reflects_to_twice_its_angle(cycles, method, device):
    """The plane h = x·tan 5° must reflect normally incident light to θr = −10°.

    The plane is repeated as a sawtooth. The height H of its steps is such that H·w/λ is an integer, so that phases are
    continuous at the steps.
    """
    wavelength, slope = 0.5, math.copysign(math.tan(math.radians(5.0)), cycles)
    w = 1.0 + math.cos(math.radians(10.0))
    period = cycles * wavelength / (w * slope)
    n = 128
    heightfield = wd.HeightField(slope * period * np.arange(n)[None, :] / n, (period / n, period / n))
    theta = np.arange(-30.0, 30.0, 0.01)
    options = {"masking": False, "method": method, "device": device}
    rho = wd.spectral_reflectance(heightfield, (0, 0, 1), at_angle(theta), 1e3 * wavelength, **options)[:, 0]
    assert theta[np.argmax(rho)] == pytest.approx(-10.0 * cycles, abs=0.011)
    mirrored = at_angle(-10.0 * cycles)
    power = wd.spectral_reflectance(heightfield, (0, 0, 1), mirrored, 1e3 * wavelength, ior=math.inf, **options)
    cosine = math.cos(math.radians(10.0))
    assert power[0] == pytest.approx(1.0 / cosine, rel=1e-3)  # all power is in this order, so that only C remains


@pytest.mark.parametrize("kind", KINDS)
def test_directions_below_the_horizon_reflect_nothing(rough, kind):
    options = {"coherence": coherence_of(kind, 3.0)}
    up, down = (0.1, 0.0, 1.0), (0.1, 0.0, -1.0)
    several = [up, down, down, up, (0.0, 1.0, 0.0)], [down, up, down, (1.0, 0.0, 0.0), up]
    for light, view in ((up, down), several):
        calls = [
            lambda pair=(light, view): wd.spectral_reflectance(rough, *pair, [400.0, 700.0], **options),
            lambda pair=(light, view): wd.spectral_reflectance(rough, *pair, 500.0, method="direct", **options),
            lambda pair=(light, view): wd.brdf(rough, *pair, 500.0, **options),
            lambda pair=(light, view): wd.reflectance(rough, *pair, **options),
        ]
        for call in calls:
            with pytest.warns(wd.WarpdiffWarning, match="no pair of to_light and to_view is above the horizon"):
                assert np.all(call() == 0.0)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_negative_or_unbounded_over_the_sphere(rough, kind, rng):
    """For all directions, results must be finite and not negative.

    The directions include all special cases: poles, horizon, opposite and equal directions.
    """
    count = 500 if kind == "source" else 1500
    directions = rng.normal(size=(count, 3))
    special = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], [1, 0, 1e-9], [-1, 0, 1e-9], [1, 0, 1e-300]])
    lights = np.concatenate([directions, np.repeat(special, len(special), axis=0)])
    views = np.concatenate([rng.normal(size=(count, 3)), np.tile(special, (len(special), 1))])
    options = {"coherence": coherence_of(kind, 2.0), "tolerance": 0.1}
    for each in (wd.reflectance(rough, lights, views, **options), wd.brdf(rough, lights, views, 500.0, **options)):
        assert np.all(np.isfinite(each))
        assert each.min() >= 0.0
        assert each.max() > 0.0


@pytest.mark.parametrize("shape", [(3,), (1, 3), (5, 3)])
def test_results_have_the_leading_axes_of_the_directions(rough, shape, rng):
    views = np.broadcast_to(hemisphere(rng, 1)[0], shape)
    light = (0.0, 0.3, 1.0)
    leading = () if shape == (3,) else shape[:1]
    assert wd.spectral_reflectance(rough, light, views, [400.0, 500.0]).shape == (*leading, 2)
    assert wd.reflectance(rough, light, views).shape == (*leading, 3)
    assert wd.brdf(rough, light, views, 500.0).shape == (*leading, 1)
    assert wd.reflectance(rough, list(light), views.tolist()).dtype == np.float32


@pytest.mark.parametrize("method", ["auto", "direct"])
def test_calls_without_directions_return_empty_arrays(rough, method):
    none = np.zeros((0, 3))
    assert wd.reflectance(rough, (0, 0, 1), none, method=method).shape == (0, 3)
    assert wd.spectral_reflectance(rough, none, none, [400.0, 500.0], method=method).shape == (0, 2)


@pytest.mark.parametrize("kind", KINDS)
def test_threads_and_repetition_do_not_change_a_bit(rough, kind, rng):
    # Each thread processes slices of 512 directions. The number of directions is larger, so that several slices and
    # threads are tested.
    count = {"averaged": 5000, "source": 800}.get(kind, 1500)
    # Directions near the horizon are excluded, because a light source of finite size there requires thousands of
    # wavelengths per direction.
    lowest = 0.3 if kind == "source" else 0.05
    lights, views = hemisphere(rng, count, lowest), hemisphere(rng, count, lowest)
    options = {"coherence": coherence_of(kind, 4.0), "tolerance": 1e-2 if kind == "averaged" else 0.1}
    one = wd.reflectance(rough, lights, views, threads=1, **options)
    for threads in (1, 2, 5):
        assert np.array_equal(wd.reflectance(rough, lights, views, threads=threads, **options), one)
