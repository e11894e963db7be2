"""Kernels that sum over wavelengths and Fourier coefficients: reflectances of materials, and replicated periods."""

import numpy as np
import warp as wp
from conftest import hemisphere, launch, noise

import warpdiff as wd
from warpdiff.kernels import coefficient_sum, compile_options


@wp.kernel(module="unique", module_options=compile_options.options())
def reflectances_of(
    quadrature: coefficient_sum.Quadrature, scattering_vectors: wp.array(dtype=wp.vec3d),
    wavenumbers: wp.array(dtype=wp.float64), result: wp.array(dtype=wp.float32),
):  # fmt: skip
    i = wp.tid()
    result[i] = coefficient_sum.reflectance_of(quadrature, scattering_vectors[i], wavenumbers[i])


@wp.kernel(module="unique", module_options=compile_options.options())
def factors_of(
    positions: wp.array(dtype=wp.float64), periods: wp.array(dtype=wp.float64), result: wp.array(dtype=wp.float32)
):
    i = wp.tid()
    result[i] = coefficient_sum.interference_factor(positions[i], periods[i])


def test_interference_of_periods_has_its_closed_form_at_and_near_resonance(rng):
    periods = rng.integers(2, 50, 300).astype(float)
    turns = np.concatenate([rng.uniform(-0.02, 0.02, 150), rng.uniform(-0.5, 0.5, 150) * periods[150:]])
    turns[0] = 0.0
    positions = rng.integers(-20, 20, 300) + turns / periods
    inputs = [wp.array(values, dtype=wp.float64, device="cpu") for values in (positions, periods)]
    result = wp.zeros(300, dtype=wp.float32, device="cpu")
    launch(factors_of, 300, inputs, [result], device="cpu")
    turns[0] = 1e-9
    expected = (np.sin(np.pi * turns) / (periods * np.sin(np.pi * turns / periods))) ** 2
    np.testing.assert_allclose(result.numpy(), expected, rtol=1e-5, atol=1e-6)


def test_reflectances_of_a_material_are_bilinear(rng):
    """A table of reflectances is interpolated between angles and wavelengths.

    Interpolation of a bilinear function must be exact, also at the ends of both axes.
    """

    def reflectance(row, column):
        return 0.1 + 0.05 * row + 0.02 * column + 0.01 * row * column

    quadrature = coefficient_sum.Quadrature()
    quadrature.reflectances = wp.array(reflectance(*np.mgrid[:5, :8]), dtype=wp.float32, device="cpu")
    quadrature.least_nm = 380.0
    cosines, nanometres = rng.uniform(0.0, 1.0, 60), rng.uniform(380.0, 387.0, 60)
    cosines[:3], nanometres[2:5] = (0.0, 1.0, 1.0), (380.0, 387.0, 387.0)
    vectors = -2.0 * cosines[:, None] * hemisphere(rng, 60)
    result = wp.zeros(60, dtype=wp.float32, device="cpu")
    places = (
        wp.array(vectors, dtype=wp.vec3d, device="cpu"), wp.array(1e3 / nanometres, dtype=wp.float64, device="cpu"),
    )  # fmt: skip
    launch(reflectances_of, 60, [quadrature, *places], [result], device="cpu")
    np.testing.assert_allclose(result.numpy(), reflectance(4.0 * cosines, nanometres - 380.0), rtol=1e-5)


def test_colours_of_replicated_periods_meet_a_tight_tolerance(rng):
    heightfield, lights, views = noise((4, 8)), hemisphere(rng, 20, 0.3), hemisphere(rng, 20, 0.3)
    options = {"coherence": wd.Coherence("replicas", periods=(2, 3)), "tolerance": 1e-5}
    exact = wd.reflectance(heightfield, lights, views, method="direct", **options)
    result = wd.reflectance(heightfield, lights, views, **options)
    np.testing.assert_allclose(result, exact, rtol=1e-4, atol=1e-5 * exact.max())
