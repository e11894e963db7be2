"""Reflectance by the direct sum, reflectance maps and the absolute BRDF, compared with references and closed forms.

ωi and ωr are the unit vectors to the light and to the viewer, with the angles θi and θr from the normal. w is the
normal component of the scattering vector −ωi − ωr. σ is the standard deviation of the coherence window.
"""

import itertools
import math

import numpy as np
import pytest
from conftest import at_angle, hemisphere, relative_errors
from scipy import special

import warpdiff as wd
from bench.truth import reference
from warpdiff.evaluate import reflectance as module

UP = (0.0, 0.0, 1.0)
# This coherence window is so short that the orders of the test field, whose period is 1.44 µm, overlap.
SHORT = wd.Coherence(sigma_um=0.3)


@pytest.fixture(scope="module")
def line():
    """Return a height field of one row with 16 random samples."""
    return wd.HeightField(np.random.default_rng(4).uniform(0.0, 0.03, (1, 16)), 0.09)


def test_direct_colours_equal_the_reference_and_report_their_progress(line, rng):
    lights, views = hemisphere(rng, 5, 0.3), hemisphere(rng, 5, 0.3)
    views[3] *= -1.0
    shares = []
    options = {"coherence": SHORT, "tolerance": 1e-3, "method": "direct"}
    colours = wd.reflectance(line, lights, views, progress=shares.append, **options)
    exact = reference.reference_reflectance(line, lights, views, SHORT, tolerance=1e-4)
    assert not colours[3].any()
    illuminated = np.arange(5) != 3
    assert relative_errors(colours[illuminated], exact[illuminated]).max() < 1e-3
    # One of the five directions is below the horizon and is not computed, so that progress is reported in four steps.
    np.testing.assert_allclose(shares, [0.25, 0.5, 0.75, 1.0])


def test_direct_colours_that_have_not_converged_cause_a_warning(line, monkeypatch):
    """A direct sum that reaches its limit of wavelengths before the colour has converged must cause a warning.

    The direct sum halves the wavelength step again and again until the colour converges.
    """
    counts = []
    sums = module.direct_sum.window_power

    def counted(heightfield, coherence, scattering_vectors, wavelengths_um, **options):
        counts.append(len(wavelengths_um))
        return sums(heightfield, coherence, scattering_vectors, wavelengths_um, **options)

    monkeypatch.setattr(module.direct_sum, "window_power", counted)
    options = {"coherence": SHORT, "method": "direct", "tolerance": 1e-4}
    wd.reflectance(line, at_angle(10.0), UP, **options)
    first = counts[0]
    # After each halving of the wavelength step, only the midpoints between the previous wavelengths are computed. There
    # is one midpoint less than there are wavelengths.
    totals = list(itertools.accumulate(counts))
    assert all(new == total - 1 for new, total in zip(counts[1:], totals, strict=False))
    monkeypatch.setattr(module, "_DIRECT_MOST_WAVELENGTHS", 2 * first + 1)
    monkeypatch.setattr(module, "_DIRECT_SETTLED", 0.0)
    counts.clear()
    with pytest.warns(wd.WarpdiffWarning, match="direct sum of 1 of 1 directions has not converged at"):
        wd.reflectance(line, at_angle(10.0), UP, **options)
    assert counts == [first, first - 1]
    monkeypatch.setattr(module, "_DIRECT_MOST_WAVELENGTHS", 2 * first)
    counts.clear()
    with pytest.warns(wd.WarpdiffWarning, match="has not converged"):
        wd.reflectance(line, at_angle(10.0), UP, **options)
    assert counts == [first]


def test_the_brdf_of_a_mirror_in_the_mirror_direction_is_4_pi_sigma_squared_over_lambda_squared():
    """In the mirror direction, the BRDF of a mirror must be 4πσ²/λ². If a direction is below the horizon, it must be 0.

    In all directions the BRDF has the factor R (1 + ωi·ωr)² / (cos θi cos θr w²), where w is the component of ωi + ωr
    along the normal. In the mirror direction of a perfect mirror (R = 1) this factor is 1.
    """
    mirror, wavelengths = wd.HeightField(np.zeros((8, 8)), 0.1), np.array([450.0, 600.0])
    options = {"coherence": SHORT, "ior": math.inf, "energy": "stam"}
    for angle in (0.0, 40.0):
        expected = 4.0 * math.pi * (300.0 / wavelengths) ** 2
        result = wd.brdf(mirror, at_angle(angle), at_angle(-angle), wavelengths, **options)
        np.testing.assert_allclose(result, expected, rtol=1e-4)
    both = np.array([at_angle(40.0), at_angle(100.0)])
    np.testing.assert_array_equal(wd.brdf(mirror, both, both, wavelengths, **options)[1], 0.0)
    with pytest.warns(wd.WarpdiffWarning, match="no pair of to_light and to_view is above the horizon"):
        np.testing.assert_array_equal(wd.brdf(mirror, both[1], UP, wavelengths, **options), 0.0)


def test_pixels_of_a_map_are_means_of_directions_within_the_unit_disc(line):
    """Each pixel of a reflectance map must be the mean over those of its view directions that exist.

    The position in a map is the pair (x, y) of a view direction, within the unit disc. x increases from left to right,
    and y decreases from top to bottom.
    """
    light = at_angle(20.0)
    plan = wd.plan(line, coherence=SHORT, tolerance=1e-1)
    image = wd.reflectance_map(line, light, size=6, samples_per_pixel=4, plan=plan)
    centres = (np.arange(12) + 0.5) / 6.0 - 1.0
    x, y = np.meshgrid(centres, -centres)
    inside = np.hypot(x, y) < 1.0
    views = np.stack([x, y, np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))], axis=-1)
    colours = np.zeros((12, 12, 3))
    colours[inside] = wd.reflectance(line, light, views[inside], plan=plan)
    np.testing.assert_allclose(image.xyz, colours.reshape(6, 2, 6, 2, 3).mean(axis=(1, 3)), rtol=1e-4, atol=1e-7)
    share = inside.reshape(6, 2, 6, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(image.coverage, share)
    np.testing.assert_array_equal(image.mask, share > 0.0)
    assert set(np.unique(share)) > {0.0, 1.0}
    # A plan predicts the error of a computation. The largest estimated error of the pixels must equal this prediction.
    # Errors are relative to the norm of a pixel's XYZ, or to a thousandth of the reference luminance if that is larger.
    np.testing.assert_allclose(image.error[image.mask].max(), plan.error, rtol=1e-3)
    assert not image.error[~image.mask].any()
    assert image.report.refined_share == 0.0


def test_a_normalised_brdf_does_not_depend_on_other_directions_of_the_call():
    grating, view = wd.gratings.blazed(1.7, 0.2), at_angle(-20.0)
    lights = np.array([at_angle(30.0), at_angle(100.0)])
    options = {"coherence": SHORT, "ior": math.inf, "energy": "normalised", "tolerance": 1e-2}
    both, one = wd.brdf(grating, lights, view, 500.0, **options), wd.brdf(grating, lights[0], view, 500.0, **options)
    np.testing.assert_allclose(both[0], one, rtol=1e-4)
    assert not both[1].any()
    assert not math.isclose(
        one[0], wd.brdf(grating, lights[0], view, 500.0, **options | {"energy": "stam"})[0], rel_tol=1e-3
    )


@pytest.mark.parametrize("kind", ["averaged", "source"])
def test_spectra_reach_from_the_ultraviolet_to_the_infrared(kind):
    """At normal incidence and view, the zeroth order of a sine of depth d must have the power J₀²(2πd/λ).

    A metal multiplies this power by its reflectance. Wavelengths from 200 to 1700 nm are tested.
    """
    depth, wavelengths = 0.04, np.array([200.0, 254.0, 300.0, 365.0, 800.0, 1700.0])
    grating, aluminium = wd.gratings.sinusoidal(5.0, depth, samples=512), wd.Material.metal("Al")
    options = {"coherence": wd.Coherence(kind), "tolerance": 1e-3}
    expected = special.j0(2e3 * math.pi * depth / wavelengths) ** 2
    spectrum = wd.spectral_reflectance(grating, UP, UP, wavelengths, **options)
    np.testing.assert_allclose(spectrum, expected, rtol=2e-3, atol=1e-5)
    metal = wd.spectral_reflectance(grating, UP, UP, wavelengths, material=aluminium, **options)
    np.testing.assert_allclose(metal, expected * aluminium.reflectance(wavelengths, 0.0), rtol=2e-3, atol=1e-5)
    orders = wd.order_efficiencies(grating, UP, wavelengths, material=aluminium, energy="stam")
    np.testing.assert_allclose(orders[0, 0], expected * aluminium.reflectance(wavelengths, 0.0), rtol=1e-9)
    with pytest.raises(ValueError, match="material must cover 190 to 300 nm, but 'aluminium' is tabulated from 200 to"):
        wd.spectral_reflectance(grating, UP, UP, [190.0, 300.0], material=aluminium, **options)


def test_saved_spectra_have_the_values_of_the_spectral_reflectance(tmp_path):
    grating, wavelengths = wd.gratings.sinusoidal(2.0, 0.2), [250.0, 500.0, 560.0]
    light, views = wd.direction(30.0, -140.0), wd.direction([-15.0, 15.0], 40.0)
    spectra = wd.reflectance_spectra(grating, light, views, wavelengths)
    values = wd.spectral_reflectance(grating, light, views, wavelengths)
    np.testing.assert_array_equal(spectra.values, values)
    rows = np.genfromtxt(spectra.save(tmp_path / "spectra.csv"), delimiter=",", names=True)
    np.testing.assert_array_equal(rows["relative_reflectance"].astype(np.float32).reshape(2, 3), values)
    np.testing.assert_array_equal(rows["wavelength_nm"].reshape(2, 3), [wavelengths] * 2)
    np.testing.assert_allclose(rows["view_theta_deg"], 15.0)
    np.testing.assert_allclose(rows["view_phi_deg"], [-140.0] * 3 + [40.0] * 3)
    np.testing.assert_allclose(rows["light_theta_deg"], 30.0)
    np.testing.assert_allclose(rows["light_phi_deg"], -140.0)
    assert repr(spectra) == "ReflectanceSpectra(2 spectra, 3 wavelengths, 250 to 560 nm)"
    assert repr(wd.reflectance_spectra(grating, light, views[0], 550.0)).startswith("ReflectanceSpectra(1 spectrum, ")
