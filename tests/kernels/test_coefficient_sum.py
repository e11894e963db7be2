"""Kernels that sum over wavelengths and Fourier coefficients: reflectances of materials, and replicated periods."""

import numpy as np
import pytest
import warp as wp
from conftest import coherence_of, hemisphere, launch, noise

import warpdiff as wd
from warpdiff.device.kernel_calls import launch_pipeline
from warpdiff.kernels import coefficient_sum, compile_options
from warpdiff.kernels.structs import Footprint
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.tables.lookup import ColourLookup


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
    """Reflectances of a material are tabulated over angle and wavelength, and interpolated linearly.

    If the reflectance is a bilinear function, interpolation must be exact, also at the ends of both axes.
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


@pytest.mark.parametrize(("periods", "tolerance", "divisions"), [((2, 3), 1e-5, 1), ((1, 40), 1e-3, 3)])
def test_colours_of_replicated_periods_equal_a_direct_sum_over_many_wavelengths(periods, tolerance, divisions, rng):
    """Colours of a patch that is repeated ``periods`` times along y and x must equal a direct sum.

    With many periods, the power of one patch is computed at few wavelengths and interpolated to ``divisions`` times as
    many wavelengths. The interference factor of the periods is computed at all of these wavelengths.
    """
    heightfield, lights, views = noise((4, 8)), hemisphere(rng, 10, 0.3), hemisphere(rng, 10, 0.3)
    options = {"coherence": wd.Coherence("replicas", periods=periods), "tolerance": tolerance}
    assert wd.plan(heightfield, lights, views, **options).subdivisions == divisions
    exact = wd.reflectance(heightfield, lights, views, method="direct", **options)
    result = wd.reflectance(heightfield, lights, views, **options)
    np.testing.assert_allclose(result, exact, rtol=1e-4, atol=1e-5 * exact.max())


@pytest.mark.parametrize("kind", ["averaged", "source", "replicas"])
def test_each_direction_uses_the_smallest_sufficient_set_of_wavelengths(kind, rng):
    """A direction must use the smallest set of wavelengths whose number is sufficient for its bandwidth.

    The bandwidth is the number of wavelengths that the direction requires per unit of 1/λ.

    The weights of the wavelengths in XYZ are replaced: the weight in X is the index of the set, and in Y it is 1. The
    ratio X/Y of a result is then the index of the set that the kernel used. For a light source of finite size
    (coherence of the kind "source"), diffraction orders pass a direction at the rate √(d Σ⁻¹ d) as the wavelength
    changes. Here d is (u, v), and Σ is the covariance of (u, v) for a source whose spread is 1.
    """
    device, count = wp.get_device("cpu"), 60
    heightfield = noise((8, 128), (0.06, 0.05))
    lights, views = hemisphere(rng, count, 0.1), hemisphere(rng, count, 0.1)
    plan = wd.plan(heightfield, coherence=coherence_of(kind, 6.0), tolerance=1e-2, integration="sampled")
    lookup = ColourLookup(heightfield, plan, plan.direction_range, device=device, threads=1)
    vectors = -lights - views
    inputs = [
        wp.array(vectors, dtype=wp.vec3d, device=device), wp.array(lights, dtype=wp.vec3f, device=device),
        wp.array(np.ones(count), dtype=wp.float32, device=device),
    ]  # fmt: skip
    result = wp.zeros(count, dtype=wp.vec3f, device=device)
    call = lookup.kernel_calls(*inputs, IlluminatedMaterial("D65", None), result)[0]
    quadrature = call.inputs[-1]
    sizes = np.diff(quadrature.firsts.numpy())
    weights = np.repeat(
        np.stack([np.arange(len(sizes)), np.ones(len(sizes)), np.ones(len(sizes))], axis=1), sizes, axis=0
    )
    quadrature.weights = wp.array(weights, dtype=wp.vec3f, device=device)
    launch_pipeline([call], count, device=device, threads=1)
    u, v, w = vectors.T
    rate = np.hypot(u, v)
    if kind == "source":
        covariance = np.eye(2) - lights[:, :2, None] * lights[:, None, :2]
        rate = np.sqrt(np.einsum("ni,nij,nj->n", vectors[:, :2], np.linalg.inv(covariance), vectors[:, :2]))
    elif kind == "replicas":
        rate = np.hypot(u * heightfield.size_um[1], v * heightfield.size_um[0])
    per_rate, per_w, constant = plan.bandwidth_um
    needed = per_rate * rate + per_w * -w + constant
    largest = per_rate * plan.max_order_rate + per_w * plan.max_w + constant
    sufficient = needed[:, None] <= largest * 2.0 ** (-0.25 * np.arange(len(sizes)))
    expected = np.where(sufficient[:, 0], sufficient.sum(axis=1) - 1, 0)
    assert len(set(expected)) >= 4
    x, y, _ = result.numpy().T
    np.testing.assert_allclose(x, y * expected, rtol=1e-4)


def test_footprints_under_a_source_add_their_covariance_to_that_of_the_source(rng):
    """The light of a flat surface must be a Gaussian of (u, v), averaged over the source and over the footprint.

    Its covariance Σ is that of the source, s² (I − t tᵀ), plus that of the footprint. Here s is the spread of the
    source, and t is the tangential part of the direction to the light. The power at (u, v) is relative to the power in
    the mirror direction without a footprint.
    """
    device, count = wp.get_device("cpu"), 40
    heightfield, coherence = wd.HeightField(np.zeros((16, 16)), 0.09), wd.Coherence("source", angular_diameter_deg=3.0)
    plan = wd.plan(heightfield, coherence=coherence, tolerance=1e-3, integration="sampled")
    spread = np.radians(1.5) / np.sqrt(2.0)
    lights, footprints = hemisphere(rng, count, 0.5), spread * rng.normal(size=(count, 2, 2)) * (1.5, 0.4)
    of_source = spread**2 * (np.eye(2) - lights[:, :2, None] * lights[:, None, :2])
    covariance = of_source + np.swapaxes(footprints, 1, 2) @ footprints
    uv = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), rng.uniform(-1.0, 1.0, (count, 2)))
    tangential = -uv - lights[:, :2]
    vectors = np.column_stack([uv, -lights[:, 2] - np.sqrt(1.0 - np.sum(tangential**2, axis=1))])
    inputs = [
        wp.array(vectors, dtype=wp.vec3d, device=device), wp.array(lights, dtype=wp.vec3f, device=device),
        wp.array(np.ones(count), dtype=wp.float32, device=device),
    ]  # fmt: skip
    lookup = ColourLookup(heightfield, plan, plan.direction_range, device=device, threads=1)
    result = wp.zeros(count, dtype=wp.vec3f, device=device)
    call = lookup.kernel_calls(*inputs, IlluminatedMaterial("D65", None), result)[0]
    call.inputs[-2] = wp.array(footprints.reshape(count, 4), dtype=Footprint, device=device)
    launch_pipeline([call], count, device=device, threads=1)
    share = np.sqrt(np.linalg.det(of_source) / np.linalg.det(covariance))
    expected = share * np.exp(-0.5 * np.einsum("ni,nij,nj->n", uv, np.linalg.inv(covariance), uv))
    np.testing.assert_allclose(result.numpy()[:, 1], expected, rtol=1e-3)
