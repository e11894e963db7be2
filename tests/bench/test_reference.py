"""The float64 reference, which is fast enough for pictures, equals the direct sum for all kinds of surfaces."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import coherence_of, hemisphere

from bench.truth import coherent_sums, reference
from warpdiff import gratings
from warpdiff.diffraction import direct_sum
from warpdiff.heightfield.field import HeightField
from warpdiff.optics.coherence import Coherence

WAVELENGTHS_UM = np.array([0.381, 0.47, 0.56, 0.66, 0.779])
# Number of random directions per surface. With five wavelengths for each direction, more than 200 values are compared.
DIRECTIONS = 48


def rough():
    return HeightField(np.random.default_rng(3).uniform(0.0, 0.5, (24, 20)), (0.09, 0.08))


def fingers():
    return gratings.fingers(size_um=3.6, pitch_um=0.09, seed=4)


# Tested surfaces by name. Each value has a height field, the σ of its coherence window [µm], the diameter of its light
# source [degrees], and its numbers of periods (y, x).
REGIMES = {
    "sinusoidal": (lambda: gratings.sinusoidal(1.6, 0.4), 16.25, 0.53, (1, 12)),
    "blazed": (lambda: gratings.blazed(2.0, 0.3), 16.25, 0.53, (400, 3000)),
    "blazed, coarse across": (lambda: HeightField(np.linspace(0.0, 0.3, 25)[None], (0.7, 0.08)), 16.25, 12.0, (3, 5)),
    "flat": (lambda: HeightField(np.zeros((6, 5)), 0.09), 16.25, 0.53, (30, 20)),
    "fingers": (fingers, 16.25, 0.53, (20, 30)), "fingers, short window": (fingers, 1.5, 5.0, (2, 1)),
    "rough": (rough, 16.25, 0.53, (7, 5)), "rough, short window": (rough, 0.8, 20.0, (1, 1)),
}  # fmt: skip
KINDS = ["averaged", "centred", "source", "replicas"]


def direct_reflectance(heightfield, lights, views, wavelengths, coherence):
    """Return the reflectance ρ: the power |P|² by the direct sum, times the geometry factor (gain) of the reference."""
    gains = reference.gain(lights, views, source=coherence.kind == "source")
    power = direct_sum.window_power(heightfield, coherence, -lights - views, wavelengths, to_lights=lights)
    return gains[:, None] * power


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", REGIMES)
def test_spectra_equal_the_direct_sum(name, kind, rng):
    make, *settings = REGIMES[name]
    heightfield, coherence = make(), coherence_of(kind, *settings)
    # The directions to the light are at most 85° from the normal: the cosine of this angle is 0.087.
    lights, views = hemisphere(rng, DIRECTIONS, lowest=0.087), hemisphere(rng, DIRECTIONS)
    # Random views would miss narrow orders. A third of the views is therefore near the mirror direction, and a third
    # near an order.
    third = DIRECTIONS // 3
    views[:third] = views[:third] * 0.01 + lights[:third] * np.array([-1.0, -1.0, 1.0])
    near = slice(third, 2 * third)
    order = rng.integers(-1, 2, (third, 2)) / np.array(heightfield.size_um[::-1]) * 0.56
    across = -lights[near, :2] - order
    across *= np.minimum(1.0, 0.95 / np.linalg.norm(across, axis=1, keepdims=True))
    views[near] = np.column_stack([across, np.sqrt(1.0 - np.sum(across**2, axis=1))])
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    lights[0] = [np.sin(np.radians(85.0)), 0.0, np.cos(np.radians(85.0))]
    views[0] = lights[0] * [-1.0, -1.0, 1.0]
    exact = direct_reflectance(heightfield, lights, views, WAVELENGTHS_UM, coherence)
    values = reference.reference_spectral(heightfield, lights, views, WAVELENGTHS_UM, coherence)
    assert exact.size >= 200
    error = np.abs(values - exact) / np.maximum(exact, 1e-3 * np.percentile(exact, 99.0))
    assert error.max() <= 1e-6
    assert np.count_nonzero(exact > 1e-6 * exact.max()) > 20


def integral(heightfield, lights, views, coherence, points=3):
    """Return XYZ by the direct sum and Gauss quadrature over each 1 nm, where illuminant · CIE functions are linear."""
    at, share = np.polynomial.legendre.leggauss(points)
    nodes = (np.arange(380, 780)[:, None] + 0.5 + at / 2.0).ravel()
    weights = np.tile(share / 2.0, 400)
    nodes, weights = np.append(nodes, [380.0, 780.0]), np.append(weights, [0.5, 0.5])
    table = reference.products("D65")
    curves = np.stack([np.interp(nodes, np.arange(380, 781), table[:, c]) for c in range(3)], axis=1)
    return direct_reflectance(heightfield, lights, views, nodes * 1e-3, coherence) @ (weights[:, None] * curves)


@pytest.mark.parametrize("kind", KINDS)
def test_colours_equal_the_direct_sum(kind, rng):
    heightfield = gratings.fingers(size_um=3.2, pitch_um=0.1, seed=4)
    coherence = coherence_of(kind, 3.0, 2.0, (3, 2))
    lights, views = hemisphere(rng, 4, lowest=0.3), hemisphere(rng, 4)
    views[0] = lights[0] * [-1.0, -1.0, 1.0]
    exact = integral(heightfield, lights, views, coherence)
    values = reference.reference_reflectance(heightfield, lights, views, coherence, tolerance=1e-6)
    np.testing.assert_allclose(values, exact, rtol=1e-5, atol=1e-10 * exact.max())


def resonances(heightfield, lights, views, periods):
    """Return XYZ of a grating with N periods of length Lx along x, in the limit of large N.

    In this limit, the spectrum consists of one narrow line per order. The integral of a line over the phase uLx/λ, in
    turns, is 1/N.
    """
    result = np.zeros((len(lights), 3))
    table, length = reference.products("D65"), heightfield.size_um[1]
    for i, (light, view) in enumerate(zip(lights, views, strict=True)):
        u = abs(-light[0] - view[0])
        for order in range(1, 40):
            wavelength = u * length / order
            if 0.38 < wavelength < 0.78:
                at = np.array([wavelength])
                illuminated = direct_reflectance(heightfield, light[None], view[None], at, periods)[0, 0]
                curve = [np.interp(1e3 * wavelength, np.arange(380, 781), table[:, c]) for c in range(3)]
                # The phase uLx/λ changes by one turn over the wavelength range |dλ| = λ²/(uLx), here in nm.
                result[i] += illuminated * np.array(curve) * 1e3 * wavelength**2 / (u * length) / periods.periods[1]
    return result


def test_the_reference_resolves_narrow_lines_of_many_periods(rng):
    """The reference must not miss narrow lines of the spectrum.

    With 1000 and 4000 periods, its colours must approach the limit of infinitely many periods.
    """
    heightfield = gratings.sinusoidal(1.6, 0.4)
    lights, views = (hemisphere(rng, 6, lowest=0.3) for _ in range(2))
    errors = []
    for count in (1000, 4000):
        periods = Coherence("replicas", periods=(1, count))
        values = reference.reference_reflectance(heightfield, lights, views, periods)
        sharp = resonances(heightfield, lights, views, periods)
        illuminated = sharp[:, 1] > 0.0
        assert illuminated.sum() >= 4
        errors.append(np.max(np.linalg.norm(values[illuminated] - sharp[illuminated], axis=1) / np.linalg.norm(
            sharp[illuminated], axis=1,
        )))  # fmt: skip
    assert errors[0] <= 0.1
    assert errors[1] <= 0.3 * errors[0]


@pytest.mark.parametrize("kind", ["source", "replicas"])
def test_a_smaller_tolerance_changes_results_only_within_the_larger_one(kind, rng):
    """Results at tolerances of 0.01 and 1e-8 must differ by at most 0.01/20.

    A larger difference would mean that a narrow order was missed at the larger tolerance. Light near the horizon is
    included.
    """
    heightfield = fingers()
    lights, views = hemisphere(rng, 12, lowest=0.05), hemisphere(rng, 12)
    views[:3] = lights[:3] * [-1.0, -1.0, 1.0]
    coherence = coherence_of(kind, None, 0.53, (20, 30))
    rough_one = reference.reference_reflectance(heightfield, lights, views, coherence, tolerance=1e-2)
    fine = reference.reference_reflectance(heightfield, lights, views, coherence, tolerance=1e-8)
    moved = np.linalg.norm(rough_one - fine, axis=1)
    assert np.all(moved <= 1e-2 / 20.0 * np.maximum(np.linalg.norm(fine, axis=1), coherent_sums.LEAST))


def test_a_coherence_by_name_equals_a_coherence_object(rng):
    heightfield = fingers()
    lights, views = hemisphere(rng, 3), hemisphere(rng, 3)
    named = reference.reference_reflectance(heightfield, lights, views, "centred", 2.0, centre=(0.7, 2.9))
    data = SimpleNamespace(kind="centred", sigma_um=2.0, spread=0.0, periods=None, centre_um=(0.7, 2.9))
    np.testing.assert_array_equal(named, reference.reference_reflectance(heightfield, lights, views, data))


def test_a_centred_window_at_another_position_equals_the_direct_sum(rng):
    heightfield = fingers()
    lights, views = hemisphere(rng, 8), hemisphere(rng, 8)
    coherence = Coherence("centred", 2.0, centre_um=(0.7, 2.9))
    exact = direct_reflectance(heightfield, lights, views, np.array([0.45, 0.7]), coherence)
    values = reference.reference_spectral(heightfield, lights, views, [0.45, 0.7], "centred", 2.0, centre=(0.7, 2.9))
    np.testing.assert_allclose(values, exact, rtol=1e-6, atol=1e-9 * exact.max())


def test_a_flat_mirror_has_the_white_point_of_d65():
    flat = HeightField(np.zeros((4, 4)), 0.05)
    up = np.array([[0.0, 0.0, 1.0]])
    for coherence in ("averaged", Coherence("source"), Coherence("replicas", periods=(3, 2))):
        white = reference.reference_reflectance(flat, up, up, coherence, tolerance=1e-6, ior=np.inf)[0]
        np.testing.assert_allclose(white, [0.950423, 1.0, 1.088610], atol=1e-6)
