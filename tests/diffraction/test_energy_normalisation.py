"""Energy normalisation: pictures and maps of perfect mirrors conserve energy."""

import math

import numpy as np
import pytest
from conftest import hemisphere, noise

import warpdiff as wd
from bench.truth.pictures import furnace_picture
from warpdiff.diffraction import energy_normalisation

WINDOW = wd.Coherence(sigma_um=8.0)
MIRROR = {"coherence": WINDOW, "ior": math.inf, "masking": False}
SURFACES = {
    "fingers": lambda: wd.gratings.fingers(size_um=3.2, pitch_um=0.08),
    "blazed": lambda: wd.gratings.blazed(2.5, 0.25),
}


def at(polar_deg, azimuth_deg):
    polar, azimuth = math.radians(polar_deg), math.radians(azimuth_deg)
    return (math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), math.cos(polar))


def seen_from(towards):
    return wd.View.orthographic(4.0 * np.array(towards), (0, 0, 0), up=(0, 1, 0.3), extent_y=0.3, width=4, height=3)


@pytest.mark.parametrize("bin_um", [0.0, 1.5, 4.0])
def test_powers_of_all_bins_add_up_to_one(bin_um):
    """By Parseval's theorem the powers of all orders add up to 1. This must also hold if neighbouring orders are summed
    in bins.
    """
    powers = energy_normalisation.Powers(noise((15, 13), (0.1, 0.1)), 8.0, bin_um)
    bins = np.arange(len(powers.frequencies))
    for kappa in (0.0, 1.7, 3.1, 7.9):
        assert powers.at(bins, kappa).sum() == pytest.approx(1.0, rel=1e-6)
    # A bin sums the powers |H|² of neighbouring orders. It has the requested width, rounded to a whole number of
    # orders. The first and the last bin may have fewer orders, so that the distance between the centres of bins may be
    # smaller.
    for frequencies, length in zip(powers.frequencies.T, (1.3, 1.5), strict=True):
        widest = np.max(np.diff(np.unique(frequencies)))
        assert 0.8 < widest / (max(round(bin_um * length), 1) / length) < 1.0 + 1e-9


def test_under_an_even_sky_a_perfect_mirror_is_as_bright_as_the_sky():
    """A perfect mirror in a uniform environment (white furnace) must be as bright as the environment."""
    off, heightfield = [], SURFACES["blazed"]()
    for energy in ("stam", "normalised"):
        image, radius = furnace_picture(heightfield, energy, tolerance=1e-1, size=20)
        off.append(np.sqrt(np.mean((image.xyz[radius < 0.85, 1] - 1.0) ** 2)))
    assert off[1] < 0.08
    assert off[1] < 0.7 * off[0]


def test_pictures_have_the_factors_of_single_directions(square):
    """Kernels apply the factors of the energy normalisation in pictures, and NumPy applies them in ``reflectance``.

    Both must give the same colour.
    """
    heightfield, light, view = SURFACES["fingers"](), at(40.0, 30.0), at(25.0, 130.0)
    factors = energy_normalisation.achromatic_factors(heightfield)
    both = factors.between(np.array([light]), np.array([view]))[0]
    assert abs(both - 1.0) > 0.02
    options = MIRROR | {"tolerance": 3e-3, "coherence": wd.Coherence(sigma_um=3.0)}
    rho = wd.reflectance(heightfield, light, view, energy="normalised", **options)
    np.testing.assert_allclose(rho, both * wd.reflectance(heightfield, light, view, **options), rtol=1e-5)
    options |= {"energy": "normalised", "footprint": False}
    lamp = wd.PointLight(1e4 * np.array(light), power=1e8)
    lights = wd.DirectionalLight(light), lamp
    images = [wd.shade(square, heightfield, light, seen_from(view), **options) for light in lights]
    renderer = wd.Renderer(square, heightfield, lights[1], seen_from(view), **options)
    renderer.draw(lights[0])
    for image in (*images, renderer.image()):
        np.testing.assert_allclose(image.xyz[1, 1], rho, rtol=6e-3)
        assert "Energy is normalised" in str(image.plan)
    assert "nergy" not in str(
        wd.shade(square, heightfield, lights[0], seen_from(view), **options | {"energy": "stam"}).plan
    )


def test_normalised_maps_are_reciprocal_and_report_the_normalisation():
    heightfield, light, view = SURFACES["blazed"](), at(50.0, 10.0), at(20.0, 170.0)
    options = MIRROR | {"energy": "normalised", "tolerance": 1e-3}
    there, back = wd.reflectance(heightfield, [light, view], [view, light], **options)
    np.testing.assert_allclose(there, back, rtol=2e-3)
    stam, normalised = (
        wd.reflectance_map(heightfield, light, size=24, **options | {"energy": form}) for form in ("stam", "normalised")
    )
    illuminated = stam.xyz[..., 1] > 0.0
    ratio = normalised.xyz[illuminated, 1] / stam.xyz[illuminated, 1]
    assert ratio.max() - ratio.min() > 0.1
    assert 0.0 == stam.plan.energy_spread < normalised.plan.energy_spread


def test_the_brdf_at_a_wavelength_does_not_depend_on_other_wavelengths():
    heightfield, views = SURFACES["fingers"](), [at(10.0, 60.0), at(50.0, -30.0), at(45.0, 200.0)]
    options = {"coherence": WINDOW, "ior": math.inf, "energy": "normalised", "tolerance": 1e-3}
    wide = np.array([350.0, *np.arange(400.0, 701.0, 50.0), 800.0])
    among = wd.brdf(heightfield, at(30.0, 20.0), views, wide, **options)
    for column in (0, 4, len(wide) - 1):
        alone = wd.brdf(heightfield, at(30.0, 20.0), views, wide[column], **options)
        assert np.ravel(alone) == pytest.approx(among[:, column], rel=5e-3)


def test_energy_normalisation_hardly_changes_gentle_surfaces():
    """A surface with small slopes has nearly all power in one order, so that its factors of the energy normalisation
    must be near 1.
    """
    x = np.arange(64) / 64.0
    sine = wd.HeightField(0.005 * np.sin(2.0 * math.pi * x)[None], 2.0 / 64.0)
    factors = energy_normalisation.achromatic_factors(sine)
    np.testing.assert_allclose(factors.values[:12], 1.0, atol=3e-3)
    assert factors.spread < 1e-3
    for energy in ("stam", "normalised"):
        both = wd.brdf(sine, (0, 0, 1), [at(16.0, 0.0), at(16.0, 180.0)], 550.0, ior=math.inf, energy=energy)
        np.testing.assert_allclose(both[0], both[1], rtol=1e-3)


def test_the_nyquist_order_has_the_same_energy_factor_on_both_sides():
    steps = wd.HeightField(np.array([[0.0, 0.14]]), 0.5)
    options = MIRROR | {"energy": "normalised"}
    with pytest.warns(wd.WarpdiffWarning, match="pitch"):
        rho = wd.reflectance(steps, (0, 0, 1), [at(33.0, 0.0), at(33.0, 180.0)], **options)
    np.testing.assert_allclose(rho[0], rho[1], rtol=1e-3)


def test_heights_of_another_unit_are_refused_before_their_energy_is_summed(monkeypatch):
    monkeypatch.setattr(energy_normalisation, "Powers", None)
    deep = wd.HeightField.of_known_scale(np.random.default_rng(0).uniform(0.0, 1e3, (256, 256)), 0.1)
    for call in (wd.reflectance, wd.brdf):
        with pytest.raises(ValueError, match="wavelengths of path"):
            call(deep, (0, 0, 1), (0.1, 0, 1), *([[550.0]] if call is wd.brdf else []), energy="normalised")


def test_masking_is_off_with_normalised_energy():
    heightfield, light, view = SURFACES["fingers"](), at(60.0, 0.0), at(70.0, 60.0)
    options = MIRROR | {"energy": "normalised"}
    np.testing.assert_array_equal(
        wd.reflectance(heightfield, light, view, **options | {"masking": True}),
        wd.reflectance(heightfield, light, view, **options),
    )


SHALLOW = {
    "sine": lambda: wd.gratings.sinusoidal(2.0, 0.01),
    "lamellar": lambda: wd.gratings.lamellar(2.5, 0.001),
    "blazed": lambda: wd.gratings.blazed(7.3, 0.01),
    "crossed": lambda: noise((10, 17), (0.15, 0.1)),
}


@pytest.mark.parametrize("name", SHALLOW)
def test_orders_of_weak_gratings_sum_to_one_and_are_reciprocal(name):
    """The efficiencies of a weak grating must sum to 1, and each order must be as efficient as its reversed path.

    Weak orders test the convergence of the normalisation. After 200 sweeps, Sinkhorn's iteration alone would still have
    an error of 1e-3.
    """
    heightfield, light = SHALLOW[name](), at(35.0, 20.0)
    orders = wd.order_efficiencies(heightfield, light, 500.0, ior=math.inf)
    np.testing.assert_allclose(orders.efficiencies.sum(), 1.0, rtol=1e-12)
    back = wd.order_efficiencies(heightfield, orders.to_view[0], 500.0, ior=math.inf)
    np.testing.assert_allclose(back.efficiencies.sum(axis=(1, 2)), 1.0, rtol=1e-12)
    for index, order in enumerate(orders.orders):
        # Light that comes from the direction of an order is diffracted to the original light by the same order. Both
        # calls compute Fourier coefficients with an absolute rounding error of 1e-15.
        returned = back[tuple(order)][index, 0]
        assert returned == pytest.approx(orders.efficiencies[0, index], rel=1e-12, abs=1e-15)


def test_a_balance_without_a_solution_warns():
    matrix = np.array([[1.0, 0.0], [0.0, 0.0]])
    with pytest.warns(wd.WarpdiffWarning, match="has not converged"):
        energy_normalisation.balanced(matrix, np.ones(2), np.ones(2))


def test_responses_of_a_balance_solve_its_linear_equations(rng):
    shares = rng.uniform(0.0, 1.0, (7, 7)) ** 4
    rows, columns = rng.normal(size=(2, 7, 3))
    columns += (rows.sum(axis=0) - columns.sum(axis=0)) / 7
    x, y = energy_normalisation.balance_response(shares, rows, columns)
    np.testing.assert_allclose(shares.sum(axis=1)[:, None] * x + shares @ y, rows, atol=1e-12)
    np.testing.assert_allclose(shares.T @ x + shares.sum(axis=0)[:, None] * y, columns, atol=1e-12)


def test_grid_weights_are_bilinear_between_the_directions_of_the_grid(rng):
    """Bilinear interpolation on the grid of directions must reproduce the values at its directions.

    The weights of any direction must add up to 1.
    """
    directions = energy_normalisation._grid()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-12)
    nodes, weights = energy_normalisation.grid_weights(directions)
    values = rng.uniform(size=len(directions))
    # All entries in the first row of the grid of directions are the same direction, the normal.
    columns = np.count_nonzero(directions[:, 2] > 1.0 - 1e-12)
    values[:columns] = 0.5
    np.testing.assert_allclose(np.sum(weights * values[nodes], axis=1), values, atol=1e-6)
    _, weights = energy_normalisation.grid_weights(hemisphere(rng, 200))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert weights.min() >= 0.0


@pytest.mark.parametrize("contrast", [0.5, 8.0, 55.0])
def test_factors_balance_a_symmetric_matrix(contrast, rng):
    """The factors a of a symmetric matrix K with positive elements must satisfy a (K a) = 1.

    With the largest contrast between the elements, Newton's method converges only if its steps are limited.
    """
    matrix = rng.lognormal(0.0, contrast, (40, 40))
    matrix += matrix.T
    # The first row and column of the matrix have only the diagonal element 1: a direction that reflects light only into
    # itself. Its factor is 1.
    matrix[0], matrix[:, 0], matrix[0, 0] = 0.0, 0.0, 1.0
    factors = energy_normalisation._balanced(matrix)
    np.testing.assert_allclose(factors * (matrix @ factors), 1.0, atol=1e-8)


def test_factors_are_linear_between_wavelengths():
    values = np.array([1.0, 3.0, 2.0])[:, None, None] * np.ones((3, 16, 16))
    factors = energy_normalisation.EnergyFactors(np.array([400.0, 500.0, 800.0]), values)
    for wavelength, expected in ((400.0, 1.0), (425.0, 1.5), (500.0, 3.0), (650.0, 2.5), (800.0, 2.0)):
        np.testing.assert_allclose(factors.at(np.array([at(30.0, 50.0)]), wavelength), expected, rtol=1e-12)


def test_the_reported_spread_is_that_of_the_power_of_single_lights_and_wavelengths(rng):
    """The reported spread of the energy normalisation must be the root-mean-square error of the reflected power.

    The error is the difference from the incident power. The reflected power of a light at one wavelength is the sum
    over orders of the factors of both directions times the efficiency by Stam's model, with the prescribed decrease
    towards the horizon.
    """
    heightfield = SURFACES["blazed"]()
    factors = energy_normalisation.achromatic_factors(heightfield)
    lights, wavelengths = hemisphere(rng, 60, math.cos(math.radians(80.0))), [440.0, 490.0, 540.0, 590.0, 640.0]
    orders = wd.order_efficiencies(heightfield, lights, wavelengths, ior=math.inf, energy="stam")
    light, wavelength, order = np.nonzero(~np.isnan(orders.to_view[..., 0]))
    views = orders.to_view[light, wavelength, order]
    sums = np.zeros((len(lights), len(wavelengths)))
    parts = orders.efficiencies[light, wavelength, order] * factors.between(lights[light], views)
    np.add.at(sums, (light, wavelength), parts * energy_normalisation.rise(views[:, 2]))
    spread = math.sqrt(np.average(np.mean((sums - 1.0) ** 2, axis=1), weights=lights[:, 2]))
    assert factors.spread == pytest.approx(spread, rel=0.25)
