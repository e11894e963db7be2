"""Fourier coefficients of profiles with known transforms, in float64 and by the kernels."""

import itertools
import math

import numpy as np
import pytest
from scipy.special import jv

import warpdiff as wd
from warpdiff.diffraction import fourier_coefficients, phase_series
from warpdiff.diffraction.phase_series import EXPANSIONS

PERIOD_UM = 2.5
KAPPAS = np.array([-0.4, -1.7, -2.63, -3.9])


def sinusoid(n, depth, kappa, order):
    assert n >= 64
    return jv(order, 2.0 * np.pi * kappa * depth / 2.0) ** 2


def two_levels(n, depth, kappa, order, duty=0.375):
    step = 2.0 * np.pi * kappa * depth
    high = round(duty * n)
    if order == 0:
        return np.abs(high / n * np.exp(1j * step) + 1.0 - high / n) ** 2
    return 4.0 * np.sin(step / 2.0) ** 2 * (np.sin(np.pi * order * high / n) / (n * np.sin(np.pi * order / n))) ** 2


def ramp(n, depth, kappa, order):
    z = kappa * depth + order
    return (np.sin(np.pi * z) / (n * np.sin(np.pi * z / n))) ** 2


PROFILES = {
    "sinusoidal": (lambda n: wd.gratings.sinusoidal(PERIOD_UM, 0.3, samples=n), lambda *a: sinusoid(a[0], 0.3, *a[1:])),
    "lamellar": (lambda n: wd.gratings.lamellar(PERIOD_UM, 0.2, duty=0.375, samples=n),
                 lambda *a: two_levels(a[0], 0.2, *a[1:])),
    "blazed": (lambda n: wd.gratings.blazed(PERIOD_UM, 0.25, samples=n), lambda *a: ramp(a[0], 0.25, *a[1:])),
}  # fmt: skip


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("n", [64, 200])
@pytest.mark.parametrize("method", EXPANSIONS)
def test_float64_coefficients_equal_closed_forms(name, n, method):
    expansion = EXPANSIONS[method]
    make, closed = PROFILES[name]
    heightfield = make(n)
    block = fourier_coefficients.Block.covering(fourier_coefficients.patch_grid(heightfield), 100.0, (0, 0))
    _, scale = expansion.offset_and_scale(heightfield)
    terms = expansion.term_count(2.0 * np.pi * np.abs(KAPPAS).max() * scale, 1e-13)
    series = fourier_coefficients.series_coefficients(heightfield, expansion, terms, block)
    _, r = block.orders()
    basis = expansion.basis(2.0 * np.pi * KAPPAS * scale, terms)
    powers = np.abs(np.einsum("yxn,kn->kyx", series, basis)) ** 2
    np.testing.assert_allclose(powers.sum(axis=(1, 2)), 1.0, atol=1e-10)
    for k, kappa in enumerate(KAPPAS):
        expected = np.array([closed(n, kappa, order) for order in r])
        np.testing.assert_allclose(powers[k, 0], expected, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("kind", ["averaged", "centred", "source", "replicas"])
@pytest.mark.parametrize("method", ["auto", "taylor"])
def test_kernel_coefficients_equal_closed_forms(name, kind, method, device):
    make, closed = PROFILES[name]
    # All periods interfere constructively at an order, so any whole number of periods gives the order its full power.
    coherence = wd.Coherence(kind, periods=(1, 7) if kind == "replicas" else None)
    heightfield = make(128)
    light = np.array([math.sin(0.3), 0.0, math.cos(0.3)])
    wavelengths = np.array([0.4, 0.55, 0.7])
    order, colour = (each.ravel() for each in np.meshgrid(np.arange(-5, 6), np.arange(3), indexing="ij"))
    tangential = -order * wavelengths[colour] / PERIOD_UM - light[0]
    visible = np.abs(tangential) <= 0.98
    assert np.count_nonzero(visible) >= 25
    order, colour, tangential = order[visible], colour[visible], tangential[visible]
    views = np.stack([tangential, np.zeros_like(tangential), np.sqrt(1.0 - tangential**2)], axis=1)
    rho = wd.spectral_reflectance(
        heightfield, light, views, 1e3 * wavelengths, coherence=coherence, ior=math.inf, masking=False,
        tolerance=1e-5, method=method, device=device,
    )  # fmt: skip
    total = light[2] + views[:, 2]
    gain = (1.0 + views @ light) ** 2 / (total**2 * views[:, 2])
    if kind == "source":
        gain /= light[2]
    expected = [closed(128, -total_w / wavelengths[k], n) for total_w, k, n in zip(total, colour, order, strict=True)]
    np.testing.assert_allclose(rho[np.arange(len(order)), colour] / gain, expected, rtol=0.0, atol=1e-5)


def test_powers_of_a_two_dimensional_patch_add_up_to_one():
    heightfield = wd.gratings.fingers(size_um=6.4, pitch_um=0.1, seed=3)
    block = fourier_coefficients.Block.covering(fourier_coefficients.patch_grid(heightfield), 1e3, (0, 0))
    for expansion in EXPANSIONS.values():
        _, scale = expansion.offset_and_scale(heightfield)
        terms = expansion.term_count(2.0 * np.pi * 5.26 * scale, 1e-13)
        series = fourier_coefficients.series_coefficients(heightfield, expansion, terms, block, threads=2)
        for kappa in (-0.5, -2.6, -5.26):
            powers = np.abs(series @ expansion.basis(2.0 * np.pi * kappa * scale, terms)) ** 2
            assert powers.sum() == pytest.approx(1.0, abs=1e-10)


@pytest.mark.parametrize("frequency", [0.5, 2.0, 5.0, 40.0])
@pytest.mark.parametrize("method", EXPANSIONS)
def test_a_block_contains_the_fourier_transform(frequency, method, rng):
    heightfield = wd.HeightField(rng.uniform(0.0, 0.2, (15, 24)), (0.11, 0.07))
    block = fourier_coefficients.Block.covering(fourier_coefficients.patch_grid(heightfield), frequency, (1, 2))
    expansion = EXPANSIONS[method]
    offset, scale = expansion.offset_and_scale(heightfield)
    kappa = -3.3
    terms = expansion.term_count(2.0 * np.pi * abs(kappa) * scale, 1e-14)
    series = fourier_coefficients.series_coefficients(heightfield, expansion, terms, block)
    coefficients = series @ expansion.basis(2.0 * np.pi * kappa * scale, terms)
    coefficients = coefficients * np.exp(2j * np.pi * kappa * offset)
    transform = np.fft.ifft2(np.exp(2j * np.pi * kappa * heightfield.heights_um))
    s, r = block.orders()
    np.testing.assert_allclose(coefficients, transform[s[:, None], r[None, :]], atol=1e-13)
    needed = [int(frequency * length) + extra for length, extra in zip(heightfield.size_um, (1, 2), strict=True)]
    for index, n in zip((s, r), needed, strict=True):
        assert set(range(-n, n + 1)) <= set(index) or len(set(index)) in heightfield.shape


@pytest.mark.parametrize("method", EXPANSIONS)
@pytest.mark.parametrize("argument", [0.0, 0.3, 2.0, 6.0, 12.0])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-5, 1e-9])
def test_the_number_of_terms_is_the_smallest_that_the_remainder_bound_allows(method, argument, tolerance):
    expansion = EXPANSIONS[method]
    terms = expansion.term_count(argument, tolerance)
    x = np.linspace(-argument, argument, 201)[:, None, None]
    g = np.linspace(-1.0, 1.0, 101)
    polynomials = np.stack(
        [1j**n * p for n, p in enumerate(itertools.islice(expansion.polynomials(g), terms))], axis=-1
    )
    error = np.abs(np.sum(expansion.basis(x[:, :, 0], terms) * polynomials, axis=-1) - np.exp(1j * x[:, :, 0] * g))
    assert error.max() <= tolerance * (1.0 + 1e-6)
    assert terms == 1 or expansion.remainder(argument, terms - 1) > tolerance


def test_bessel_functions_equal_tabulated_values():
    """Computed Bessel functions must equal the tables 9.1 and 9.4 of Abramowitz and Stegun."""
    known = {
        (0, 1.0): 0.7651976865579666, (1, 1.0): 0.4400505857449335, (5, 10.0): -0.2340615281867936,
        (10, 20.0): 0.1864825580239450, (30, 5.0): 2.671177278e-21, (100, 100.0): 0.09636667329586,
    }  # fmt: skip
    for (order, argument), value in known.items():
        assert phase_series.bessel_j(argument, order + 1)[order] == pytest.approx(value, abs=2e-14)
        assert phase_series.bessel_j(-argument, order + 1)[order] == pytest.approx((-1) ** order * value, abs=2e-14)


def test_a_block_contains_all_orders_up_to_a_frequency_and_its_neighbours():
    """A block of Fourier coefficients must contain all orders up to a frequency, and a number of further orders beyond
    the last of these orders.

    Up to a frequency of 0.7/µm there are 7 orders of a period of 10 µm, and 14 orders of a period of 20 µm. The test
    requests 1 further order along the axis of 10 µm and 3 along the other axis. The orders of the block must therefore
    end at ±8 and ±17.
    """
    grid = fourier_coefficients.Grid((101, 203), (10.0, 20.0))
    block = fourier_coefficients.Block.covering(grid, 0.7 - 1e-9, (1, 3))
    for orders, last in zip(block.orders(), (8, 17), strict=True):
        np.testing.assert_array_equal(orders, np.arange(-last, last + 1))
