"""Order efficiencies: closed forms, an explicit sum, the absolute BRDF, energy, reciprocity and invalid arguments.

κ is w/λ, the normal component w of the scattering vector divided by the wavelength.
"""

import math

import numpy as np
import pytest
from conftest import at_angle, hemisphere
from scipy.special import jv

import warpdiff as wd
from warpdiff.diffraction import energy_normalisation
from warpdiff.evaluate import orders as order_module

WAVELENGTHS = [400.0, 550.0, 780.0]
PERIOD = 2.5


def sine(kappa, depth, order):
    return jv(order, np.pi * kappa * depth) ** 2


def lamellar(kappa, depth, order, duty=0.375):
    step = np.sin(np.pi * kappa * depth) ** 2
    return 1.0 - 4.0 * duty * (1.0 - duty) * step if order == 0 else (2.0 * duty * np.sinc(order * duty)) ** 2 * step


def blazed(kappa, depth, order):
    return np.sinc(kappa * depth - order) ** 2


# For each profile: a height field, the closed form of the power of an order, and the allowed error. This error is
# larger for profiles with steps, because the position of a step is known only to one sample.
PROFILES = {
    "sine": (wd.gratings.sinusoidal(PERIOD, 0.3), sine, 1e-12),
    "lamellar": (wd.gratings.lamellar(PERIOD, 0.3, duty=0.375, samples=4000), lamellar, 1e-4),
    "blazed": (wd.gratings.blazed(PERIOD, 0.3, samples=4000), blazed, 1e-4),
}


def test_coefficients_of_a_tall_surface_equal_a_separate_transform_at_each_kappa(rng):
    """Fourier coefficients that are interpolated over κ must equal Fourier transforms at each κ.

    If the interpolation had too few terms or covered only half of the range of κ, errors would be about 1.
    """
    heightfield = wd.HeightField(rng.uniform(0.0, 6.0, (4, 8)), pitch_um=1.0)
    kappas = rng.uniform(-5.2, -1.0, 40)
    indices = rng.integers(-9, 9, (40, 2))
    values = order_module._coefficients(heightfield, indices, kappas)
    heights = heightfield.heights_um - 0.5 * (heightfield.heights_um.max() + heightfield.heights_um.min())
    transforms = np.fft.ifft2(np.exp(2j * np.pi * kappas[:, None, None] * heights))
    expected = transforms[np.arange(40), indices[:, 0] % 4, indices[:, 1] % 8]
    np.testing.assert_allclose(values, expected, rtol=0.0, atol=1e-12)
    # A series of exp(ixg), where |g| <= 1, requires at least about x terms. At x = 1000 the number of terms must be
    # close to 1000, because computing time is proportional to this number.
    assert order_module._term_count(1000.0) < 1150


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("angle", [0.0, 30.0, -60.0])
def test_order_efficiencies_equal_closed_forms(name, angle):
    """The efficiency of an order must equal its geometry factor times its power, both computed in closed form.

    The grating equation gives the direction of the order and κ, from which the geometry factor follows. The profile's
    Fourier transform at κ gives the power.
    """
    heightfield, closed, error = PROFILES[name]
    result = wd.order_efficiencies(heightfield, at_angle(angle), WAVELENGTHS, ior=math.inf, energy="stam")
    sin_i, cos_i = math.sin(math.radians(angle)), math.cos(math.radians(angle))
    count = 0
    for k, wavelength in enumerate(WAVELENGTHS):
        for m in range(-15, 16):
            sin_r = m * wavelength * 1e-3 / PERIOD - sin_i
            if abs(sin_r) >= 1.0:
                assert result[0, m][k] == 0.0
                continue
            cos_r = math.sqrt(1.0 - sin_r**2)
            kappa = -(cos_i + cos_r) / (wavelength * 1e-3)
            # The amplitude of the diffraction order m is ∫ e^{2πiκh} e^{2πirx/d} dx / d with r = −m. Its squared
            # magnitude is the power.
            power = closed(kappa, 0.3, m)
            geometry = (1.0 + sin_i * sin_r + cos_i * cos_r) ** 2 / (cos_i * cos_r * (cos_i + cos_r) ** 2)
            assert result[0, m][k] == pytest.approx(geometry * power, abs=error * geometry)
            at = result.orders.tolist().index([0, m])
            np.testing.assert_allclose(result.to_view[k, at], [sin_r, 0.0, cos_r], atol=1e-12)
            count += 1
    assert np.count_nonzero(np.isfinite(result.to_view[..., 0])) == count


def test_a_blazed_grating_reflects_into_the_mirror_direction_of_its_facets():
    """The strongest order of a blazed grating must be in the mirror direction of its facets.

    Facets that rise with x are tilted towards −x by α, so that they reflect normally incident light to the angle −2α.
    """
    wavelength = 0.5
    heightfield = wd.gratings.blazed(4.0, 2.0 * wavelength / 2.0, samples=2000)
    result = wd.order_efficiencies(heightfield, (0, 0, 1), 1e3 * wavelength, ior=math.inf, energy="stam")
    best = result.to_view[0, np.argmax(result.efficiencies[0])]
    assert best[0] == pytest.approx(-math.sin(2.0 * math.atan(wavelength / 4.0)), abs=0.03)
    assert result[0, -2][0] > 0.9


def test_orders_of_a_two_dimensional_patch_equal_explicit_sums(rng):
    heightfield = wd.HeightField(rng.uniform(0.0, 0.5, (12, 18)), (0.11, 0.08))
    light = hemisphere(rng, 1, 0.5)[0]
    result = wd.order_efficiencies(heightfield, light, [500.0])
    y, x = np.mgrid[:12, :18]
    assert len(result.orders) > 20
    for (m_y, m_x), view, efficiency in zip(result.orders, result.to_view[0], result.efficiencies[0], strict=True):
        np.testing.assert_allclose((light + view)[:2], [m_x * 0.5 / 1.44, m_y * 0.5 / 1.32], atol=1e-12)
        w = light[2] + view[2]
        amplitude = np.mean(np.exp(-2j * np.pi * (w / 0.5 * heightfield.heights_um + m_x * x / 18 + m_y * y / 12)))
        overlap = 1.0 + light @ view
        fresnel = 0.04 + 0.96 * (1.0 - math.sqrt(overlap / 2.0)) ** 5
        expected = fresnel * overlap**2 * abs(amplitude) ** 2 / (light[2] * view[2] * w**2)
        assert efficiency == pytest.approx(expected, rel=1e-10)


def test_an_order_is_the_integral_of_the_brdf():
    """At the centre of an order, the BRDF must be the efficiency of the order divided by a solid angle.

    The solid angle is λ²/(4πσ²), because a coherence window with standard deviation σ spreads the order over it.
    """
    heightfield, light, sigma = wd.gratings.bumps(), (0.2, -0.1, 1.0), 30.0
    result = wd.order_efficiencies(heightfield, light, 550.0)
    options = {"coherence": wd.Coherence(sigma_um=sigma), "tolerance": 1e-4}
    brdf = wd.brdf(heightfield, light, result.to_view[0], 550.0, **options)[:, 0]
    np.testing.assert_allclose(
        brdf * 0.55**2 / (4.0 * math.pi * sigma**2), result.efficiencies[0], rtol=1e-3, atol=1e-6
    )


@pytest.mark.parametrize("ior", [1.5, math.inf])
def test_a_flat_surface_is_a_mirror(ior):
    heightfield = wd.HeightField(np.full((3, 40), 0.2), 0.05)
    result = wd.order_efficiencies(heightfield, at_angle(50.0), WAVELENGTHS, ior=ior)
    normal = 1.0 if math.isinf(ior) else 0.04
    fresnel = normal + (1.0 - normal) * (1.0 - math.cos(math.radians(50.0))) ** 5
    np.testing.assert_allclose(result[0, 0], fresnel, rtol=1e-12)
    np.testing.assert_allclose(result.efficiencies.sum(axis=1), fresnel, rtol=1e-12)


def test_energy_is_nearly_conserved_where_periods_are_long():
    """Without normalisation, the efficiencies of a sine grating must sum to about 1 if its period is long.

    For a period of 0.6 µm and grazing light, the sum must exceed 1.05. This violation of energy conservation is a known
    error of scalar theory, not of the code.
    """

    def total(period, angle):
        given = wd.gratings.sinusoidal(period, 0.05), at_angle(angle), 550.0
        return wd.order_efficiencies(*given, ior=math.inf, energy="stam").efficiencies.sum()

    assert abs(total(20.0, 0.0) - 1.0) < 1e-4
    assert abs(total(2.0, 0.0) - 1.0) < 2e-2
    assert total(0.6, 75.0) > 1.05


def test_orders_are_reciprocal(rng):
    """Light sent back along a diffraction order must return to its source with the same efficiency."""
    heightfield = wd.HeightField(rng.uniform(0.0, 0.3, (8, 20)), 0.1)
    light = hemisphere(rng, 1, 0.4)[0]
    there = wd.order_efficiencies(heightfield, light, 500.0)
    for order, view, efficiency in zip(there.orders, there.to_view[0], there.efficiencies[0], strict=True):
        back = wd.order_efficiencies(heightfield, view, 500.0)
        assert back[tuple(order)][0] == pytest.approx(efficiency, rel=1e-9)


def test_orders_beyond_the_samples_are_reported():
    with pytest.warns(wd.WarpdiffWarning, match="9 propagate along x, but 12 samples represent half as many"):
        wd.order_efficiencies(wd.gratings.sinusoidal(5.0, 0.1, samples=12), (0, 0, 1), 500.0)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [({"heightfield": np.zeros((4, 4))}, TypeError, r"heightfield must be a warpdiff\.HeightField, got ndarray"),
     ({"to_light": [[0, 1]]}, ValueError, r"to_light must have shape \(3,\) or \(n, 3\), got \(1, 2\)"),
     ({"to_light": [(0, 0, 1), (1, 0, 0)]}, ValueError, r"to_light must be above the horizon .z > 0., got \[\(0, 0, 1"),
     ({"to_light": np.zeros((0, 3))}, ValueError, r"to_light must hold at least one direction, got shape \(0, 3\)"),
     ({"to_light": (1, 0, 0)}, ValueError, r"to_light must be above the horizon .z > 0., got \(1, 0, 0\)"),
     ({"to_light": (0, 0, 0)}, ValueError, "to_light must not contain zero vectors"),
     ({"wavelengths_nm": [0.5]}, ValueError, "wavelengths_nm")],
)  # fmt: skip
def test_invalid_arguments_are_refused(arguments, error, message):
    legal = {"heightfield": wd.gratings.sinusoidal(PERIOD, 0.1), "to_light": (0, 0, 1), "wavelengths_nm": 500.0}
    with pytest.raises(error, match=message):
        wd.order_efficiencies(**legal | arguments)


def test_an_axis_of_one_sample_has_only_the_zeroth_order():
    line = wd.HeightField.of_known_scale(np.linspace(0.0, 0.1, 16)[None], (9.0, 0.1))
    result = wd.order_efficiencies(line, at_angle(20.0), [500.0])
    assert not result.orders[:, 0].any()
    # The light is at 20° from the normal, the wavelength is 0.5 µm and the period 1.6 µm. Only orders m with |m ·
    # 0.5/1.6 − sin 20°| < 1 propagate.
    assert result.orders[:, 1].tolist() == [-2, -1, 0, 1, 2, 3, 4]


def test_an_order_is_a_pair_of_integers():
    result = wd.order_efficiencies(wd.gratings.sinusoidal(PERIOD, 0.1), (0, 0, 1), [500.0])
    assert result[0, 99].tolist() == [0.0]
    with pytest.raises(TypeError, match="order must be an integer"):
        result[0, 0.5]


@pytest.mark.parametrize(("angle", "azimuth"), [(0.0, 0.0), (50.0, 0.0), (70.0, 40.0)])
def test_normalised_orders_of_a_mirror_reflect_all_light(angle, azimuth):
    theta, phi = math.radians(angle), math.radians(azimuth)
    light = (math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta))
    for heightfield in (wd.gratings.blazed(1.7, 0.2), wd.gratings.bumps(spacing_um=(1.2, 1.5), height_um=0.15)):
        stam = wd.order_efficiencies(heightfield, light, WAVELENGTHS, ior=math.inf, energy="stam")
        result = wd.order_efficiencies(heightfield, light, WAVELENGTHS, ior=math.inf)
        np.testing.assert_allclose(result.efficiencies.sum(axis=1), 1.0, rtol=1e-12)
        assert np.max(np.abs(stam.efficiencies.sum(axis=1) - 1.0)) > 1e-3


def test_normalised_orders_are_reciprocal():
    """Normalised efficiencies must be reciprocal. A division by their sum over orders would violate reciprocity."""
    heightfield, light = wd.gratings.blazed(1.7, 0.2), at_angle(35.0)
    result = wd.order_efficiencies(heightfield, light, 600.0, ior=math.inf)
    over_sums = []
    for order, view in zip(result.orders, result.to_view[0], strict=True):
        back = wd.order_efficiencies(heightfield, view, 600.0, ior=math.inf)
        np.testing.assert_allclose(back[tuple(order)], result[tuple(order)], rtol=1e-9, atol=1e-12)
        sums = [
            wd.order_efficiencies(heightfield, each, 600.0, ior=math.inf, energy="stam").efficiencies.sum()
            for each in (light, view)
        ]
        over_sums.append(sums[0] / sums[1] - 1.0)
    assert np.max(np.abs(over_sums)) > 1e-2


@pytest.mark.parametrize("period", [2.0, 5.0, 10.0])
def test_orders_do_not_jump_where_another_one_passes_the_horizon(period):
    """At normal incidence, a period of a whole number of wavelengths has two orders exactly at the horizon.

    A tilt of the light by 1e-5° makes one of them propagate, and must not change the efficiencies of the other orders.
    """
    for grating in (wd.gratings.lamellar(period, 0.125), wd.gratings.blazed(period, 0.2)):
        upright = wd.order_efficiencies(grating, (0, 0, 1), 500.0, ior=math.inf)
        tilted = wd.order_efficiencies(grating, at_angle(1e-5), 500.0, ior=math.inf)
        assert len(tilted.orders) == len(upright.orders) + 1
        for order in upright.orders:
            assert tilted[tuple(order)] == pytest.approx(upright[tuple(order)], rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("angle", [85.0, 88.0, 89.9])
def test_a_grazing_light_stays_in_its_mirror_order(angle):
    """Normalisation must leave most power of a grazing light in its mirror order, and move only a part to other orders.

    The normalisation gives each direction a weight that depends on the cosine of its angle from the normal. The weight
    is 1 for cosines of at least 0.1, and falls to 0 at the horizon. The moved part of the power must be at most the
    weight of the light's direction. The sum of all efficiencies must stay 1, and each order must have the same
    efficiency as its reversed path.
    """
    grating, cosine = wd.gratings.blazed(1.7, 0.2), math.cos(math.radians(angle))
    orders = wd.order_efficiencies(grating, at_angle(angle), 600.0, ior=math.inf)
    weight = 3.0 * (cosine / 0.1) ** 2 - 2.0 * (cosine / 0.1) ** 3
    assert orders.efficiencies.sum() == pytest.approx(1.0, rel=1e-9)
    assert orders[0, 0] >= 1.0 - weight - 1e-9
    for order, view in zip(orders.orders, orders.to_view[0], strict=True):
        back = wd.order_efficiencies(grating, view, 600.0, ior=math.inf)
        np.testing.assert_allclose(back[tuple(order)], orders[tuple(order)], rtol=1e-6, atol=1e-9)


def test_many_orders_do_not_jump_at_the_horizon():
    """With more than 600 orders, factors of the energy normalisation are interpolated from a grid of directions.

    A tilt of the light by 1e-5° adds one order at the horizon. It must change the efficiencies of the 20 brightest
    orders by at most 0.1 %.
    """
    heightfield = wd.gratings.fingers(size_um=9.6, pitch_um=0.08, seed=3)
    upright, tilted = (
        wd.order_efficiencies(heightfield, at_angle(angle), 480.0, ior=math.inf) for angle in (0.0, 1e-5)
    )
    assert len(upright.orders) > energy_normalisation.MOST_EXACT
    assert len(tilted.orders) > len(upright.orders)
    brightest = upright.orders[np.argsort(upright.efficiencies[0])[-20:]]
    for order in brightest:
        assert tilted[tuple(order)] == pytest.approx(upright[tuple(order)], rel=1e-3)


def test_metals_are_normalised_and_glass_is_not():
    heightfield, light = wd.gratings.sinusoidal(1.1, 0.1), at_angle(30.0)
    gold, glass = wd.Material.metal("Au"), wd.Material.dielectric(1.5)
    for material, form in ((gold, "normalised"), (glass, "stam")):
        result = wd.order_efficiencies(heightfield, light, WAVELENGTHS, material=material)
        expected = wd.order_efficiencies(heightfield, light, WAVELENGTHS, material=material, energy=form)
        np.testing.assert_array_equal(result.efficiencies, expected.efficiencies)


def test_a_flat_metal_reflects_by_its_index_at_each_wavelength():
    """A flat surface of a metal with index N must reflect |(N − 1) / (N + 1)|² at normal incidence.

    Wavelengths beyond the measured indices of the material must be refused.
    """
    wavelengths, index = np.array([400.0, 550.0, 700.0]), np.array([1.5 + 2.0j, 0.4 + 2.6j, 0.1 + 4.0j])
    metal = wd.Material.from_nk(wavelengths, index.real, index.imag)
    mirror = wd.HeightField(np.zeros((2, 2)), 0.1)
    reflected = wd.order_efficiencies(mirror, (0, 0, 1), wavelengths, material=metal)[0, 0]
    np.testing.assert_allclose(reflected, np.abs((index - 1.0) / (index + 1.0)) ** 2, rtol=1e-6)
    for beyond in ([390.0, 550.0], [550.0, 710.0]):
        with pytest.raises(ValueError, match="material must cover"):
            wd.order_efficiencies(mirror, (0, 0, 1), beyond, material=metal)


def test_the_normalised_brdf_of_many_orders_conserves_energy():
    """The normalised BRDF at an order must be the BRDF without normalisation times the factor that normalises the
    order.

    With more than 600 orders, these factors are interpolated from a grid of directions.
    """
    heightfield = wd.gratings.fingers(size_um=9.6, pitch_um=0.08, seed=3)
    for angle in (0.0, 45.0, 75.0):
        stam, result = (
            wd.order_efficiencies(heightfield, at_angle(angle), 450.0, ior=math.inf, energy=energy)
            for energy in ("stam", "normalised")
        )
        assert len(result.orders) > energy_normalisation.MOST_EXACT
        assert result.efficiencies.sum() == pytest.approx(1.0, abs=1e-9)
        above = np.argsort(result.efficiencies[0])[-40:]
        given = at_angle(angle), result.to_view[0, above], 450.0
        absolute = [
            wd.brdf(heightfield, *given, ior=math.inf, tolerance=1e-3, energy=form)[:, 0]
            for form in ("stam", "normalised")
        ]
        expected = (result.efficiencies / stam.efficiencies)[0, above]
        np.testing.assert_allclose(absolute[1] / absolute[0], expected, rtol=1e-4)


def test_a_sum_of_stams_efficiencies_that_deviates_from_the_power_causes_a_warning(recwarn):
    """Stam's efficiencies may deviate from the reflected power by up to 20 % without a warning; normalised ones sum
    to 1.
    """
    light, deep, shallow = at_angle(30.0), wd.gratings.sinusoidal(2.0, 0.3), wd.gratings.sinusoidal(1.0, 0.1)
    for wavelengths in (500.0, (500.0, 780.0)):
        with pytest.warns(wd.WarpdiffWarning, match=r"the orders sum to 0\.789 times that power"):
            wd.order_efficiencies(deep, light, wavelengths, ior=math.inf, energy="stam")
    recwarn.clear()
    wd.order_efficiencies(deep, light, 500.0, ior=math.inf, energy="normalised")
    wd.order_efficiencies(shallow, light, 500.0, ior=math.inf, energy="stam")
    assert not recwarn.list


def test_efficiencies_print_their_orders_and_wavelengths():
    orders = wd.order_efficiencies(wd.gratings.sinusoidal(PERIOD, 0.3), (0, 0, 1), [400.0, 700.0, 550.0])
    assert repr(orders) == f"OrderEfficiencies({len(orders.orders)} orders, 3 wavelengths, 400 to 700 nm)"


LIGHTS = wd.direction([-55.0, 0.0, 20.0, 70.0])


def read_columns(path):
    return np.genfromtxt(path, delimiter=",", names=True)


def test_a_saved_table_of_several_lights_has_closed_forms(tmp_path):
    """The saved angles must follow from the grating equation, and the saved efficiencies from Fourier coefficients."""
    heightfield, closed, error = PROFILES["lamellar"]
    result = wd.order_efficiencies(heightfield, LIGHTS, WAVELENGTHS, ior=math.inf, energy="stam")
    assert result.efficiencies.shape == (4, 3, len(result.orders))
    rows = read_columns(result.save(tmp_path / "orders.csv"))
    assert len(rows) == np.count_nonzero(np.isfinite(result.to_view[..., 0]))
    sin_i = np.sin(np.radians(rows["light_theta_deg"])) * np.cos(np.radians(rows["light_phi_deg"]))
    sin_r = rows["m_x"] * rows["wavelength_nm"] * 1e-3 / PERIOD - sin_i
    np.testing.assert_allclose(
        np.sin(np.radians(rows["view_theta_deg"])) * np.cos(np.radians(rows["view_phi_deg"])), sin_r, atol=1e-12
    )
    cos_i, cos_r = np.sqrt(1.0 - sin_i**2), np.sqrt(1.0 - sin_r**2)
    kappas = (cos_i + cos_r) / (rows["wavelength_nm"] * 1e-3)
    powers = [closed(kappa, 0.3, m) for kappa, m in zip(kappas, rows["m_x"], strict=True)]
    geometry = (1.0 + sin_i * sin_r + cos_i * cos_r) ** 2 / (cos_i * cos_r * (cos_i + cos_r) ** 2)
    assert np.all(np.abs(rows["efficiency"] / geometry - powers) < error)


@pytest.mark.parametrize("energy", ["stam", "normalised"])
def test_results_of_several_lights_are_those_of_single_lights(energy, monkeypatch):
    # Lights are processed in groups, which share Fourier transforms. The limit of a group's size is made smaller than
    # its default, so that the lights of this test form several groups.
    monkeypatch.setattr(order_module, "_MOST_TOGETHER", 60)
    heightfield, gold = wd.gratings.lamellar(PERIOD, 0.3, samples=400), wd.Material.metal("Au")
    together = wd.order_efficiencies(heightfield, LIGHTS, WAVELENGTHS, material=gold, energy=energy)
    singles = [wd.order_efficiencies(heightfield, light, WAVELENGTHS, material=gold, energy=energy) for light in LIGHTS]
    for number, single in enumerate(singles):
        for m_y, m_x in together.orders:
            np.testing.assert_allclose(together[m_y, m_x][number], single[m_y, m_x], atol=1e-12)
    assert together.verdict.error == pytest.approx(max(single.verdict.error for single in singles), rel=1e-9)
    assert repr(together).endswith("400 to 780 nm, 4 lights)")
    assert wd.order_efficiencies(heightfield, LIGHTS[:1], 550.0).efficiencies.ndim == 3


def test_interpolated_factors_serve_several_lights(monkeypatch):
    """Interpolated factors of the energy normalisation must be equal for several lights together and for each alone.

    Factors are interpolated if a light has more orders than a limit. The test sets this limit to 10 orders.
    """
    monkeypatch.setattr(energy_normalisation, "MOST_EXACT", 10)
    heightfield = wd.gratings.sinusoidal(PERIOD, 0.3)
    options = {"material": wd.Material.metal("Au"), "energy": "normalised"}
    together = wd.order_efficiencies(heightfield, LIGHTS[:2], 400.0, **options)
    for number, light in enumerate(LIGHTS[:2]):
        single = wd.order_efficiencies(heightfield, light, 400.0, **options)
        np.testing.assert_allclose(together[0, 1][number], single[0, 1], rtol=1e-10)


def test_a_table_of_the_strongest_orders_of_each_wavelength():
    result = wd.order_efficiencies(wd.gratings.blazed(PERIOD, 0.25), (0, 0, 1), WAVELENGTHS)
    table = result.table(2)
    assert table["wavelength_nm"].tolist() == [400.0, 400.0, 550.0, 550.0, 780.0, 780.0]
    for wavelength, values in zip(WAVELENGTHS, result.efficiencies, strict=True):
        strongest = table["efficiency"][table["wavelength_nm"] == wavelength]
        assert sorted(strongest) == sorted(values)[-2:]
    with pytest.raises(ValueError, match="count must be an integer, at least 1, got 0"):
        result.table(0)
    result = wd.order_efficiencies(wd.gratings.fingers(), (0, 0, 1), 550.0)
    table = result.table(30)
    indices = zip(table["m_y"].tolist(), table["m_x"].tolist(), strict=True)
    np.testing.assert_array_equal(np.ravel([result[index] for index in indices]), table["efficiency"])
