"""Basis functions of κ in which Fourier coefficients are expanded, compared with exact coefficients, and their errors.

κ is w/λ, the normal component w of the scattering vector divided by the wavelength. H are the Fourier coefficients of
exp(2πiκh) over one period of the heights h.
"""

import dataclasses
import math

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.diffraction import coefficient_basis, gridding_kernel
from warpdiff.diffraction import fourier_coefficients as fourier
from warpdiff.tables import coefficient_table

RANGES = [(0.0, 5.3), (1.4, 5.3)]


def surface(height_range_um):
    heightfield = wd.gratings.fingers(size_um=6.4, pitch_um=0.1, seed=3)
    return wd.HeightField(
        heightfield.heights_um * (height_range_um / heightfield.height_range_um), heightfield.pitch_um
    )


def build(heightfield, method, kappas, *, adds_powers, terms=40):
    grid = fourier.patch_grid(heightfield)
    block = fourier.Block.covering(grid, 5.3, (1, 1))
    if method in coefficient_basis.EXPANSIONS:
        return coefficient_basis.of_series(heightfield, method, grid, block, kappas, terms=terms, threads=2), block
    terms = coefficient_basis.series_terms(heightfield, kappas)
    series = coefficient_basis.of_series(heightfield, "jacobi-anger", grid, block, kappas, terms=terms, threads=2)
    return coefficient_basis.fitted(heightfield, method, series, kappas, adds_powers=adds_powers), block


def basis_at(coefficients, kappas):
    """Return the basis functions of Fourier coefficients at values of κ = w/λ, by cubic interpolation as in kernels."""
    steps = (kappas - coefficients.kappa_low) / coefficients.step
    entry = np.minimum(steps.astype(int), len(coefficients.basis) - 4)
    t = (steps - entry)[:, None]
    b = [coefficients.basis[entry + k] for k in range(4)]
    return (
        -t * (1 - t) * (2 - t) / 6 * b[0]
        + (1 + t) * (1 - t) * (2 - t) / 2 * b[1]
        + (1 + t) * t * (2 - t) / 2 * b[2]
        - (1 + t) * t * (1 - t) / 6 * b[3]
    )


def transforms(heightfield, block, kappas):
    """Return the Fourier coefficients H_rs of exp(−2πiκh), for heights h that are centred at zero.

    The axes of the result are κ = w/λ and the orders s and r of the block.
    """
    h = heightfield.heights_um - (heightfield.heights_um.max() + heightfield.heights_um.min()) / 2.0
    s, r = block.orders()
    return np.stack([np.fft.ifft2(np.exp(-2j * np.pi * k * h))[np.ix_(s, r)] for k in kappas])


@pytest.mark.parametrize("kappas", RANGES)
@pytest.mark.parametrize("height_range_um", [0.1, 0.6, 2.0])
@pytest.mark.parametrize(
    ("method", "adds_powers"),
    [("low-rank", True), ("low-rank", False), ("power", True), ("jacobi-anger", False)],
)
def test_rows_times_basis_equal_the_coefficients(method, adds_powers, height_range_um, kappas):
    heightfield = surface(height_range_um)
    coefficients, block = build(heightfield, method, kappas, adds_powers=adds_powers, terms=70)
    at = np.linspace(*kappas, 23)
    values = np.einsum("yxpn,kn->kyxp", coefficients.rows.astype(float), basis_at(coefficients, at))
    exact = transforms(heightfield, block, at)
    if adds_powers:
        values, exact = values[..., 0], np.abs(exact) ** 2
    else:
        values = values[..., 0] + 1j * values[..., 1]
    # The method "low-rank" fits basis functions to the powers |H|² divided by about κ² (``_SMALL_KAPPA`` in
    # coefficient_basis.py). The power of the zeroth order is 1 at κ = 0, and the division makes it less accurate by up
    # to two digits. Absolute errors of these powers are therefore allowed to be larger.
    largest = np.abs(exact).max(axis=0)
    assert np.abs(values - exact).max() < (4e-6 if method == "low-rank" and adds_powers else 1e-6)
    assert np.percentile(np.abs(values - exact).max(axis=0) / largest, 99.0) < 2e-5


@pytest.mark.parametrize("kappas", RANGES)
@pytest.mark.parametrize("adds_powers", [True, False])
@pytest.mark.parametrize("method", ["low-rank", "power"])
def test_a_basis_with_the_reported_number_of_terms_meets_a_tolerance(method, adds_powers, kappas):
    if method == "power" and not adds_powers:
        pytest.skip("a series of powers has no amplitudes")
    heightfield = surface(0.6)
    coefficients, block = build(heightfield, method, kappas, adds_powers=adds_powers)
    at = np.linspace(*kappas, 31)
    exact = transforms(heightfield, block, at)
    exact = np.abs(exact)[..., None] ** 2 if adds_powers else np.stack([exact.real, exact.imag], axis=-1)
    weights = 1.0 / np.hypot(at, 0.1 * kappas[1]) ** (2 if adds_powers else 1)
    weights = weights[:, None, None, None]
    scales = np.abs(exact * weights).max(axis=(0, 3))
    for tolerance in (1e-1, 1e-2, 1e-3, 1e-4):
        terms = coefficients.terms_within(tolerance)
        values = np.einsum(
            "yxpn,kn->kyxp", coefficients.rows[..., :terms].astype(float), basis_at(coefficients, at)[:, :terms]
        )
        error = np.abs((values - exact) * weights).max(axis=(0, 3)) / scales
        # ``truncation_errors`` are percentiles over samples of κ. Between these samples, errors are up to twice as
        # large.
        assert np.percentile(error, 99.5) <= 2.0 * tolerance
        assert coefficients.truncation_errors[terms] <= tolerance < coefficients.truncation_errors[terms - 1]


def test_the_fitted_basis_is_the_smallest():
    for height_range_um in (0.3, 1.0, 3.0):
        heightfield = surface(height_range_um)
        low_rank, _ = build(heightfield, "low-rank", RANGES[0], adds_powers=True)
        power, _ = build(heightfield, "power", RANGES[0], adds_powers=True)
        series = coefficient_basis.EXPANSIONS["jacobi-anger"]
        for tolerance in (1e-2, 1e-4):
            argument = 2.0 * math.pi * RANGES[0][1] * series.offset_and_scale(heightfield)[1]
            assert low_rank.terms_within(tolerance) < power.terms_within(tolerance)
            # A term of a series of Fourier amplitudes has two numbers per coefficient (real and imaginary part). A term
            # of a series of powers has one number.
            assert power.terms_within(tolerance) < 2 * series.term_count(argument, tolerance)


@pytest.mark.parametrize("shape", [(1, 1), (1, 12), (12, 1), (5, 7)])
@pytest.mark.parametrize("method", coefficient_basis.METHODS)
def test_powers_of_flat_fields_and_of_fields_with_few_samples_are_accurate(shape, method, rng):
    for heights in (np.zeros(shape), np.full(shape, -3.0), rng.uniform(0.0, 0.3, shape)):
        heightfield = wd.HeightField(heights, 0.08)
        coefficients, block = build(heightfield, method, (0.5, 5.3), adds_powers=True)
        values = np.einsum(
            "yxpn,kn->kyxp", coefficients.rows.astype(float), basis_at(coefficients, np.array([0.5, 3.0, 5.3]))
        )
        powers = values[..., 0] if values.shape[-1] == 1 else np.sum(values**2, axis=-1)
        exact = np.abs(transforms(heightfield, block, (0.5, 3.0, 5.3))) ** 2
        # Heights from 0 to 0.3 µm have an argument x = 2π|κ|·max|h| of at most 10 if they are not centred, and 5
        # otherwise. In Taylor series, terms of the size eˣ cancel, so that uncentred heights have larger rounding
        # errors.
        np.testing.assert_allclose(powers, exact, atol=1e-5 if method == "taylor-uncentred" else 1e-6)


def test_the_basis_does_not_depend_on_the_neighbourhood():
    """A plan holds numbers of a computation, such as the number of neighbouring Fourier coefficients per direction.

    Plans that differ only in this number must share the same fitted basis functions of the Fourier coefficients.
    """
    heightfield = surface(0.3)
    plan = wd.plan(heightfield, (0, 0, 1), (0.3, 0, 1))
    extents = [
        coefficient_table.neighbour_extent(dataclasses.replace(plan, least_weight=weight), heightfield)
        for weight in (0.5, 1e-3, 1e-13)
    ]
    coefficients = [
        coefficient_table.coefficients_for(
            heightfield, "low-rank", wd.Coherence(), plan.direction_range, extent, terms=1, threads=1
        )[0]
        for extent in extents
    ]
    assert coefficients[0] is coefficients[1] is coefficients[2]


@pytest.mark.parametrize("taps", [4, 6, 8])
@pytest.mark.parametrize("samples", [2, 9, 64])
def test_interpolation_between_orders_equals_the_explicit_sum(taps, samples, rng):
    """Fourier coefficients at any frequency are interpolated from their values at multiples of half an order.

    They must equal explicit sums.
    """
    values = np.exp(2j * np.pi * rng.uniform(size=samples))
    place = (np.arange(samples) - samples // 2) / (2 * samples)
    tapered = np.zeros(2 * samples, dtype=complex)
    tapered[:samples] = values / gridding_kernel.kernel_transform(place, taps)
    fine = np.fft.ifft(tapered) * 2.0
    orders = np.arange(2 * samples)
    fine *= np.exp(-2j * np.pi * orders * (samples // 2) / (2 * samples))

    positions = np.concatenate([rng.uniform(-3.0 * samples, 3.0 * samples, 200), np.arange(-4.0, 5.0)])
    exact = np.array([np.mean(values * np.exp(2j * np.pi * t * place)) for t in positions])
    base = np.floor(positions).astype(int)
    weights = np.stack(
        [np.polyval(polynomial, positions - base - 0.5) for polynomial in gridding_kernel.tap_polynomials(taps)], axis=1
    )
    neighbours = base[:, None] - taps // 2 + 1 + np.arange(taps)
    interpolated = np.sum(weights * fine[neighbours % (2 * samples)], axis=1)
    assert np.abs(interpolated - exact).max() < {4: 1e-3, 6: 1e-5, 8: 1e-7}[taps]


def test_the_transform_of_the_interpolation_kernel_equals_a_numerical_integral():
    t = np.linspace(-4.0, 4.0, 20001)
    values = gridding_kernel.kernel(t, 8)
    assert values.max() == pytest.approx(1.0)
    assert gridding_kernel.kernel(np.array([-4.01, 4.01]), 8).tolist() == [0.0, 0.0]
    for frequency in (0.0, 0.1, 0.25):
        numeric = np.trapezoid(values * np.cos(2.0 * np.pi * frequency * t), t)
        assert gridding_kernel.kernel_transform(np.array([frequency]), 8)[0] == pytest.approx(numeric, rel=1e-5)


@pytest.mark.parametrize("method", ["low-rank", "power"])
def test_higher_orders_of_a_shallow_surface_are_accurate(method):
    """The power of order n of a shallow surface is tiny, proportional to κ²ⁿ, but must have a small relative error."""
    x = np.arange(64) / 64.0
    heightfield = wd.HeightField(5e-3 * np.sin(2.0 * np.pi * x)[None, :], 0.05)
    coefficients, block = build(heightfield, method, (1.28, 2.63), adds_powers=True, terms=20)
    at = np.linspace(1.28, 2.63, 41)
    values = np.einsum("xn,kn->kx", coefficients.rows[0, :, 0].astype(float), basis_at(coefficients, at))
    exact = np.abs(transforms(heightfield, block, at)[:, 0]) ** 2
    _, order = block.orders()
    for n in (1, 2):
        of_order = np.abs(order) == n
        np.testing.assert_allclose(values[:, of_order], exact[:, of_order], rtol=1e-5 * n**4)


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("shape", [(3, 5), (20, 40)])
def test_the_strongest_coefficients_are_the_first_64_in_descending_order_of_their_powers(shape, parts, rng):
    """The 64 strongest Fourier coefficients must be selected by their powers |H|² at the middle of the range of |κ|.

    Fewer than 64 coefficients are all returned.
    """
    rows = rng.lognormal(size=(*shape, parts, 2)).astype(np.float32)
    basis = np.stack([np.ones(12), np.arange(-1.0, 11.0)], axis=1).astype(np.float32)
    coefficients = coefficient_basis.Coefficients(rows, basis, 0.0, 0.5, np.zeros(0))
    places, powers = coefficients.strongest
    # ``basis`` has an entry at every step of 0.5 in |κ|, from −0.5 to 5. The upper end of the range counts as one step
    # before the last entry, at 4.5. The middle of the range is the geometric mean of its ends, where the lower end
    # counts as at least 0.1 of the upper end.
    entry = math.sqrt(0.1 * 4.5 * 4.5) / 0.5
    values = rows[..., 0].astype(float) + entry * rows[..., 1]
    expected = values[..., 0] if parts == 1 else np.sum(values**2, axis=2)
    order = np.argsort(-expected.ravel())[:64]
    np.testing.assert_array_equal(places, order)
    np.testing.assert_allclose(powers, expected.ravel()[order], rtol=1e-5)
