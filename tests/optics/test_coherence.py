"""Coherence: direct sums over periods and sources equal explicit sums, and solid angles of all coherence models.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal, and κ is w/λ. q is (u, v)/λ. |P|² is the power that the
surface diffracts into a direction, relative to a flat mirror in its mirror direction. ρ is the reflectance relative to
a flat mirror, and C the geometry factor between |P|² and ρ.
"""

import math

import numpy as np
import pytest
from conftest import hemisphere

from warpdiff.diffraction import direct_sum
from warpdiff.heightfield.field import HeightField
from warpdiff.optics import reflectance_factors
from warpdiff.optics.coherence import KINDS, Coherence

PERIODS = (3, 4)
INCIDENCES = [0.0, 20.0, 50.0, 70.0, 85.0]


@pytest.fixture
def small(rng):
    """Return a rough patch of 10 × 12 samples with unequal sides and pitches."""
    return HeightField(rng.uniform(0.0, 0.25, (10, 12)), (0.13, 0.1))


def tiled_power(heightfield, periods, scattering_vector, wavelength):
    """Return |P|²; P is the mean of exp(2πi(κh + q·x)) over the heights h at x of all samples of all periods."""
    u, v, w = scattering_vector / wavelength
    h = np.tile(heightfield.heights_um, periods)
    y = np.arange(h.shape[0])[:, None] * heightfield.pitch_um[0]
    x = np.arange(h.shape[1])[None, :] * heightfield.pitch_um[1]
    return abs(np.mean(np.exp(2j * np.pi * (w * h + u * x + v * y)))) ** 2


def scattering_vector_at(heightfield, turns_x, turns_y, wavelength, w=-1.3):
    """Return a scattering vector for which the phase changes by the given turns from one period to the next."""
    return np.array([turns_x * wavelength / heightfield.size_um[1], turns_y * wavelength / heightfield.size_um[0], w])


def one(heightfield, coherence, scattering_vector, wavelength, to_light=None):
    lights = None if to_light is None else to_light[None]
    given = heightfield, coherence, scattering_vector[None], np.array([wavelength])
    return direct_sum.window_power(*given, to_lights=lights)[0, 0]


def inclined(theta_deg, azimuth=0.7):
    theta = math.radians(theta_deg)
    return np.array([math.sin(theta) * math.cos(azimuth), math.sin(theta) * math.sin(azimuth), math.cos(theta)])


@pytest.mark.parametrize("periods", [PERIODS, (1, 1), (1, 7), (6, 1)])
def test_replicas_equal_the_sum_over_all_periods(small, rng, periods):
    lights, views = hemisphere(rng, 24), hemisphere(rng, 24)
    for scattering_vector in -(lights + views):
        value = one(small, Coherence("replicas", periods=periods), scattering_vector, 0.5)
        assert value == pytest.approx(tiled_power(small, periods, scattering_vector, 0.5), rel=1e-9, abs=1e-24)


@pytest.mark.parametrize("turns_x", [-2.0, 0.0, 3.0, 1.0 + 1e-9, 1.0 - 1e-9, -3.0 + 1e-9, 0.5, -1.5, 2.25])
@pytest.mark.parametrize("turns_y", [0.0, -1.0, 2.0 + 1e-9, 0.5, 0.1])
def test_replicas_at_and_near_resonances_equal_the_sum_over_all_periods(small, turns_x, turns_y):
    scattering_vector = scattering_vector_at(small, turns_x, turns_y, 0.5)
    value = one(small, Coherence("replicas", periods=PERIODS), scattering_vector, 0.5)
    # The tolerance of 1e-28 allows for cancellation: with half a turn between periods, the sum over four periods is 0.
    assert value == pytest.approx(tiled_power(small, PERIODS, scattering_vector, 0.5), rel=1e-9, abs=1e-28)
    if np.rint(turns_x) == turns_x and np.rint(turns_y) == turns_y:
        coefficient = np.fft.ifft2(np.exp(2j * np.pi * scattering_vector[2] / 0.5 * small.heights_um))
        expected = abs(coefficient[int(turns_y), int(turns_x)]) ** 2
        assert value == pytest.approx(expected, rel=1e-9)


def test_a_period_of_one_sample_is_as_long_as_the_pitch():
    heightfield = HeightField(np.linspace(0.0, 0.3, 9)[None, :], (0.4, 0.1))
    for scattering_vector in (np.array([0.3, 0.21, -1.5]), np.array([0.3, 1.25, -1.1])):
        value = one(heightfield, Coherence("replicas", periods=(5, 2)), scattering_vector, 0.5)
        assert value == pytest.approx(tiled_power(heightfield, (5, 2), scattering_vector, 0.5), rel=1e-9)


@pytest.mark.parametrize("count", [1000, 5001, 100_000])
def test_thousands_of_periods_equal_a_geometric_series(small, count):
    coherence, alone = Coherence("replicas", periods=(1, count)), Coherence("replicas", periods=(1, 1))
    k = np.arange(count)
    for turns in (3.0, 2.0 + 1e-9, 2.0 + 1e-6, 1.0 - 0.37 / count, 2.0 + 1.5 / count, 0.5 + 0.21 / count, 0.317):
        scattering_vector = scattering_vector_at(small, turns, 0.3, 0.5)
        value, patch = one(small, coherence, scattering_vector, 0.5), one(small, alone, scattering_vector, 0.5)
        exact = scattering_vector[0] / 0.5 * small.size_um[1]
        series = abs(np.mean(np.exp(2j * np.pi * ((k * (exact - round(exact))) % 1.0)))) ** 2
        assert value == pytest.approx(patch * series, rel=1e-7, abs=1e-9 * patch / count**2)
    # If the phase difference of neighbouring periods is far from whole turns, their waves cancel: the power of `count`
    # periods is at most 2/count² of the power of one period.
    far = scattering_vector_at(small, 0.25, 0.3, 0.5)
    assert one(small, coherence, far, 0.5) <= 2.0 * one(small, alone, far, 0.5) / count**2 * (1.0 + 1e-9)


def test_a_source_at_normal_incidence_equals_a_window_proportional_to_the_wavelength(small, rng):
    coherence = Coherence("source", angular_diameter_deg=6.0)
    up = np.array([0.0, 0.0, 1.0])
    scattering_vectors = -(up + hemisphere(rng, 24))
    for wavelength in (0.38, 0.55, 0.78):
        window = Coherence("averaged", wavelength / (2.0 * math.sqrt(2.0) * math.pi * coherence.spread))
        expected = direct_sum.window_power(small, window, scattering_vectors, np.array([wavelength]))
        lights = np.broadcast_to(up, scattering_vectors.shape)
        power = direct_sum.window_power(small, coherence, scattering_vectors, np.array([wavelength]), to_lights=lights)
        np.testing.assert_allclose(power, expected, rtol=1e-11, atol=1e-12 * expected.max())


def test_kinds_have_both_spellings_and_print_in_words():
    assert KINDS == ("averaged", "centred", "source", "replicas")
    assert Coherence("centered", 2.0) == Coherence("centred", 2.0)
    assert Coherence("centered").kind == "centred"
    coherences = Coherence(), Coherence("source"), Coherence("replicas", periods=(4, 4))
    expected = ["averaged window with σ = 16.25 µm", "source of 0.53° in diameter", "4 × 4 periods"]
    assert [str(coherence) for coherence in coherences] == expected


def test_the_sun_equals_a_window_of_19_micrometres():
    sigma = 0.55 / (2.0 * math.sqrt(2.0) * math.pi * Coherence("source").spread)
    assert sigma == pytest.approx(18.93, abs=0.01)


def tangent_frame(to_light):
    first = np.cross(to_light, [0.3, -0.2, 0.9])
    first /= np.linalg.norm(first)
    return first, np.cross(to_light, first)


@pytest.mark.parametrize("theta", INCIDENCES)
def test_the_covariance_of_a_source_is_its_projected_spread(theta):
    """The tangential components of the directions to a source must have the covariance s² (1 − ωi ωiᵀ).

    s is the spread of the source: the standard deviation of its directions along each axis. 1 is the unit matrix, and
    ωi has two components here.
    """
    to_light, s = inclined(theta), 1e-4
    first, second = tangent_frame(to_light)
    nodes, weights = np.polynomial.hermite_e.hermegauss(12)
    a, b = np.meshgrid(nodes, nodes)
    weight = np.outer(weights, weights) / (2.0 * math.pi)
    lights = to_light + s * (a[..., None] * first + b[..., None] * second)
    lights /= np.linalg.norm(lights, axis=-1, keepdims=True)
    offset = lights[..., :2] - to_light[:2]
    covariance = np.einsum("ab,abi,abj->ij", weight, offset, offset)
    spread = s**2 * (np.eye(2) - np.outer(to_light[:2], to_light[:2]))
    np.testing.assert_allclose(covariance, spread, atol=1e-6 * s**2)
    assert math.sqrt(np.linalg.det(spread)) == pytest.approx(s**2 * to_light[2], rel=1e-9)
    inverse = (np.eye(2) + np.outer(to_light[:2], to_light[:2]) / to_light[2] ** 2) / s**2
    np.testing.assert_allclose(inverse @ spread, np.eye(2), atol=1e-9)


@pytest.mark.parametrize("theta", INCIDENCES)
def test_every_order_shows_the_radiance_of_the_source(small, theta, rng):
    """Each order must show an image of the source.

    In a view direction, the power of an order must be proportional to the radiance of that point of the source whose
    light the order diffracts into this direction. The points (a, b) lie on a plane tangent to the sky, in units of the
    source's spread. Their radiance is exp(−(a² + b²)/2). The proportionality is exact in the limit of a small source.
    """
    to_light, wavelength = inclined(theta), 0.5
    first, second = tangent_frame(to_light)
    orders = [
        (r, t)
        for r in range(-4, 5)
        for t in range(-4, 5)
        if np.hypot(*(to_light[:2] + wavelength * np.array([r / small.size_um[1], t / small.size_um[0]]))) < 0.95
    ]
    chosen, places = rng.integers(0, len(orders), 16), rng.normal(0, 1, (16, 2))
    cases = [(orders[k], place) for k, place in zip(chosen, places, strict=True)]
    errors = []
    for diameter in (0.02, 0.002):
        coherence = Coherence("source", angular_diameter_deg=diameter)
        s, worst = coherence.spread, 0.0
        for (r, t), place in cases:
            # Direction into which an order diffracts the light from the chosen point of the source.
            origin = to_light + s * (place[0] * first + place[1] * second)
            origin /= np.linalg.norm(origin)
            across = -origin[:2] - wavelength * np.array([r / small.size_um[1], t / small.size_um[0]])
            to_view = np.array([*across, math.sqrt(1.0 - across @ across)])
            scattering_vector = -to_light - to_view
            power = one(small, coherence, scattering_vector, wavelength, to_light)
            coefficient = np.fft.ifft2(np.exp(2j * np.pi * scattering_vector[2] / wavelength * small.heights_um))[t, r]
            expected = abs(coefficient) ** 2 * math.exp(-(place @ place) / 2.0)
            worst = max(worst, abs(power / expected - 1.0))
        errors.append(worst)
    # The test projects the sky onto a plane. Its error is proportional to the spread of the source times tan θi, and at
    # normal incidence to the square of the spread.
    slant = max(math.tan(math.radians(theta)), 0.1)
    assert errors[0] <= 30.0 * slant * Coherence("source", angular_diameter_deg=0.02).spread
    assert errors[1] <= 0.15 * errors[0]


@pytest.mark.parametrize("theta", INCIDENCES)
def test_a_mirror_shows_the_radiance_of_the_source(theta):
    to_light = inclined(theta)
    mirror = to_light * np.array([-1.0, -1.0, 1.0])
    flat = HeightField(np.zeros((4, 4)), 0.1)
    factor = reflectance_factors.gain(to_light[None], mirror[None], normal=1.0, masking=False, per_light_cosine=True)[0]
    assert factor * one(flat, Coherence("source"), -to_light - mirror, 0.55, to_light) == pytest.approx(1.0, rel=1e-12)
    without = reflectance_factors.gain(to_light[None], mirror[None], normal=1.0, masking=False)[0]
    assert factor == pytest.approx(without / to_light[2], rel=1e-12)


def test_a_source_needs_its_direction(small):
    with pytest.raises(ValueError, match="to_lights"):
        direct_sum.window_power(small, Coherence("source"), np.zeros((1, 3)), np.array([0.5]))


@pytest.mark.parametrize(
    "coherence",
    [Coherence("averaged", 2.0), Coherence("centred", 2.0), Coherence("source", angular_diameter_deg=5.0),
     Coherence("replicas", periods=(3, 2))],
    ids=lambda coherence: coherence.kind,
)  # fmt: skip
def test_the_solid_angle_is_the_integral_of_a_mirrors_lobe(coherence):
    """For a flat patch, the integral of the mean power ⟨|P|²⟩ over (u, v) must be the solid angle Ω of the coherence.

    For a light source of finite size, it must be Ω cos θi. With the factor ``brdf_scale``, the integral of the BRDF of
    a perfect mirror must be 1. (u, v) are the tangential components of the scattering vector.
    """
    flat, wavelength, to_light = HeightField(np.zeros((4, 5)), (0.12, 0.1)), 0.5, inclined(60.0)
    area = math.prod(flat.size_um)
    # For a few periods (kind "replicas"), the maximum of the diffracted power is wide. The integral therefore covers
    # one whole period of the power spectrum along u and v. The power spectrum is periodic because the surface is
    # sampled.
    ends = (wavelength / 0.1, wavelength / 0.12) if coherence.kind == "replicas" else (0.5, 0.5)
    count = 60
    u, v = (end * ((np.arange(count) + 0.5) / count - 0.5) for end in ends)
    scattering_vectors = np.stack([*(grid.ravel() for grid in np.meshgrid(u, v)), np.full(count**2, -1.0)], axis=1)
    lights = np.broadcast_to(to_light, scattering_vectors.shape)
    power = direct_sum.window_power(flat, coherence, scattering_vectors, np.array([wavelength]), to_lights=lights)
    gathered = power.sum() * ends[0] * ends[1] / count**2
    solid_angle = reflectance_factors.light_solid_angle(np.array([wavelength]), coherence, area)[0]
    projected = to_light[2] if coherence.kind == "source" else 1.0
    assert gathered == pytest.approx(solid_angle * projected, rel=1e-6)
    # ``scale * gathered`` is the integral of the BRDF of a mirror without its geometry factor. For windows and periods
    # the geometry factor is C, and this integral is 1/cos θi. For a source the geometry factor is C/cos θi, and this
    # integral is 1.
    scale = reflectance_factors.brdf_scale(to_light[None, 2], np.array([wavelength]), coherence, area)[0, 0]
    assert scale * gathered == pytest.approx(projected / to_light[2], rel=1e-6)
    pigment = reflectance_factors.pigment_solid_angle(np.array([wavelength]), coherence, area)[0]
    assert pigment == pytest.approx(solid_angle / math.pi, rel=1e-14)


def test_solid_angles_equal_closed_forms():
    wavelengths = np.array([0.4, 0.7])
    for kind in ("averaged", "centred"):
        pigment = reflectance_factors.pigment_solid_angle(wavelengths, Coherence(kind, 16.0), 9.0)
        np.testing.assert_allclose(pigment, wavelengths**2 / (4.0 * math.pi**2 * 16.0**2))
    source = Coherence("source")
    pigment = reflectance_factors.pigment_solid_angle(wavelengths, source, 9.0)
    np.testing.assert_allclose(pigment, 2.0 * source.spread**2)
    scale = reflectance_factors.brdf_scale(np.array([0.5]), wavelengths, source, 9.0) / 0.5
    np.testing.assert_allclose(scale, 1.0 / (2.0 * math.pi * source.spread**2 * 0.5 * 0.5))
    periods = Coherence("replicas", periods=(2, 5))
    pigment = reflectance_factors.pigment_solid_angle(wavelengths, periods, 9.0)
    np.testing.assert_allclose(pigment, wavelengths**2 / (math.pi * 9.0 * 10.0))
    assert reflectance_factors.brdf_scale(np.ones(3), wavelengths, periods, 9.0).shape == (3, 2)
