"""Outlines (polygons of a profile): Fourier coefficients and derivatives equal numerical integrals along segments."""

import math

import complex_step
import numpy as np
import pytest

import warpdiff as wd

LIGHT, WAVELENGTH_NM = (0.3, 0.0, 1.0), 500.0
POSITIONS, HEIGHTS = np.array([0.02, 0.11, 0.4, 0.4, 0.83]), np.array([0.0, 0.13, 0.16, 0.05, 0.02])
PERIOD = 2.3
# Nodes and weights of Gauss-Legendre quadrature for each segment of an outline. With 40 nodes, the integral of exp(iφ)
# over a phase φ of a few turns has only rounding errors.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)


def integral(positions, heights, kappa, r):
    """Return the Fourier coefficient ∫ exp(2πi(κh + ru)) du of order r, by quadrature along each segment of a period.

    u is the position in periods, and h the height. The complex result is returned as two real numbers.
    """
    ends, tops = np.append(positions, positions[0] + 1.0), np.append(heights, heights[0])
    share = (NODES[:, None] + 1.0) / 2.0
    u, h = (values[:-1] + share * np.diff(values) for values in (ends, tops))
    real, imaginary = complex_step.phase(2.0 * np.pi * (kappa * h + r * u))
    weights = WEIGHTS[:, None] / 2.0 * np.diff(ends)
    return (weights * real).sum(), (weights * imaginary).sum()


def efficiencies(p, orders):
    light, wavelength = complex_step.unit(np.array(LIGHT)), 1e-3 * WAVELENGTH_NM
    result = []
    for _, m in orders:
        x = m * wavelength / p["period_um"] - light[0]
        view = np.array([x, 0.0 * x, np.sqrt(1.0 - x * x)])
        w = light[2] + view[2]
        overlap = 1.0 + complex_step.dot(light, view)
        mirror = complex_step.power(integral(p["positions"], p["heights_um"], -w / wavelength, -m))
        schlick = complex_step.schlick(np.sqrt(overlap / 2.0), 1.5)
        result.append(mirror * overlap**2 / (light[2] * view[2] * w * w) * schlick)
    return np.array(result)


def orders_of(outline):
    return wd.order_efficiencies(outline.height_field(), LIGHT, WAVELENGTH_NM).orders


def test_order_efficiencies_and_their_derivatives_equal_numerical_integrals(rng):
    outline = wd.profiles.Outline(POSITIONS, HEIGHTS, PERIOD)
    value, vjp, jvp = wd.adjoint.order_efficiencies(outline, LIGHT, WAVELENGTH_NM, wrt=("vertices", "period_um"))
    p = {"positions": POSITIONS, "heights_um": HEIGHTS, "period_um": PERIOD}
    orders = orders_of(outline)
    np.testing.assert_allclose(value[0], efficiencies(p, orders).real, rtol=1e-11, atol=1e-15)
    weights = rng.normal(size=value.shape)
    adjoints = vjp(weights)
    for column, name in enumerate(("positions", "heights_um")):
        for k in range(len(POSITIONS)):
            exact = weights[0] @ complex_step.derivative(lambda q: efficiencies(q, orders), p, name, k)
            assert adjoints["vertices"][k, column] == pytest.approx(exact, rel=1e-10, abs=1e-13)
    exact = weights[0] @ complex_step.derivative(lambda q: efficiencies(q, orders), p, "period_um")
    assert adjoints["period_um"] == pytest.approx(exact, rel=1e-10)
    change = rng.normal(size=(len(POSITIONS), 2))
    assert np.sum(weights * jvp(vertices=change)) == pytest.approx(np.sum(adjoints["vertices"] * change), rel=1e-12)


@pytest.mark.parametrize("energy", ["stam", "normalised"])
def test_samples_converge_to_the_outline(energy):
    outline = wd.profiles.Outline([0.0, 0.2, 0.5, 0.7], [0.0, 0.1, 0.15, 0.05], PERIOD)
    exact = wd.adjoint.order_efficiencies(outline, LIGHT, WAVELENGTH_NM, wrt=(), ior=math.inf, energy=energy).value
    errors = []
    for count in (200, 2000):
        field = outline.height_field(count)
        orders = wd.order_efficiencies(field, LIGHT, WAVELENGTH_NM, ior=math.inf, energy=energy)
        errors.append(np.abs(orders.efficiencies - exact).max())
    assert errors[1] < 2e-6
    assert errors[1] < 0.05 * errors[0]


def test_spectra_of_an_outline_equal_those_of_many_samples(rng):
    outline = wd.profiles.Outline([0.0, 0.2, 0.5, 0.7], [0.0, 0.1, 0.15, 0.05], PERIOD)
    coherence, views = wd.Coherence(sigma_um=2.0), [(0.1, 0.0, 1.0), (-0.4, 0.02, 1.0)]
    value, vjp, jvp = wd.adjoint.spectral_reflectance(
        outline, LIGHT, views, [450.0, 600.0], wrt=("vertices", "period_um"), coherence=coherence
    )
    samples = wd.adjoint.spectral_reflectance(
        outline.height_field(4000), LIGHT, views, [450.0, 600.0], wrt=(), coherence=coherence
    )
    np.testing.assert_allclose(value, samples.value, rtol=1e-4, atol=1e-6 * samples.value.max())
    weights, change = rng.normal(size=value.shape), rng.normal(size=(4, 2))
    assert np.sum(weights * jvp(vertices=change)) == pytest.approx(np.sum(vjp(weights)["vertices"] * change), rel=1e-12)


@pytest.mark.parametrize(
    ("positions", "heights", "message"),
    [
        ([0.0, 0.5], [0.0], "same number"), ([0.5, 0.2], [0.0, 0.1], "must increase"),
        ([0.0, 1.2], [0.0, 0.1], "must increase"), ([0.0], [0.0], "at least 2"),
    ],
)  # fmt: skip
def test_invalid_outlines_are_refused(positions, heights, message):
    with pytest.raises(ValueError, match=message):
        wd.profiles.Outline(positions, heights, 1.0)
