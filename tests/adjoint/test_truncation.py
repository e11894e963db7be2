"""``wd.adjoint``: errors of truncated series and sums, derivatives for one pair of directions, and limiting cases."""

import complex_step
import numpy as np
import pytest
from conftest import coherence_of, noise

import warpdiff as wd
from warpdiff.core import memory
from warpdiff.optics import colorimetry

FIELD = noise((5, 9), (0.21, 0.17))
LIGHT, MIRROR = (0.2, 0.1, 1.0), (-0.2, -0.1, 1.0)
SHORT = wd.Coherence(sigma_um=0.5)
FLAT = wd.HeightField.of_known_scale(np.zeros((4, 4)), 0.2)
GOLD = wd.Material.metal("Au")
FILM = wd.Material.metal("Cr").coated(wd.Material.dielectric(1.5), 1000.0)


def exact_colours(surface, views, material, illuminant, **settings):
    """Return XYZ by Gauss quadrature between neighbouring wavelengths of the tables of material and illuminant.

    The integrand is smooth between these wavelengths, because both tables are interpolated linearly.
    """
    grid, products = colorimetry.VISIBLE_NM, colorimetry.colour_products(illuminant)
    parts = [part for part in (material, getattr(material, "film", None)) if part is not None]
    cuts = np.unique(np.clip(np.concatenate([grid, *[np.asarray(part.wavelengths_nm) for part in parts]]), 380, 780))
    nodes, measure = np.polynomial.legendre.leggauss(8)
    points = (cuts[:-1, None] + np.diff(cuts)[:, None] * (nodes + 1.0) / 2.0).ravel()
    masses = (np.diff(cuts)[:, None] * measure / 2.0).ravel()
    points, masses = np.append(points, grid[[0, -1]]), np.append(masses, [0.5, 0.5])
    weights = masses[:, None] * np.stack([np.interp(points, grid, column) for column in products.T], axis=1)
    weights *= products.sum(axis=0) / weights.sum(axis=0)
    spectra = wd.adjoint.spectral_reflectance(
        surface, LIGHT, views, points, wrt=(), truncation=1e-13, material=material, **settings
    )
    return spectra.value @ weights


@pytest.mark.parametrize(
    ("material", "illuminant", "kind"),
    [(None, "D65", "averaged"), (None, "FL11", "averaged"), (None, "D65", "source"), (GOLD, "D65", "averaged"),
     (FILM, "D65", "averaged")],
)  # fmt: skip
def test_truncation_is_the_largest_error_of_colours(material, illuminant, kind):
    """The error of a colour must be at most ``truncation`` times the colour of a flat mirror.

    More wavelengths are needed if the index of refraction has kinks, or if the illuminant has spectral lines.
    """
    settings = {"coherence": coherence_of(kind, sigma_um=0.5, angular_diameter_deg=8.0)}
    views = [MIRROR, (0.0, 0.0, 1.0), (0.3, 0.1, 1.0)]
    exact = exact_colours(FIELD, views, material, illuminant, **settings)
    mirror = exact_colours(FLAT, [MIRROR], material, illuminant, **settings).max()
    for truncation in (1e-2, 1e-4, 1e-7, *((1e-12,) if material is None else ())):
        value = wd.adjoint.reflectance(
            FIELD, LIGHT, views, wrt=(), truncation=truncation, material=material, illuminant=illuminant, **settings
        ).value
        assert np.abs(value - exact).max() <= truncation * mirror


def test_kinks_of_indices_limit_the_truncation_of_colours():
    with pytest.raises(ValueError, match="use spectral_reflectance"):
        wd.adjoint.reflectance(FIELD, LIGHT, MIRROR, wrt=(), truncation=1e-12, material=GOLD, coherence=SHORT)


@pytest.mark.parametrize("kind", ["averaged", "centred", "source"])
def test_truncation_is_the_largest_error_of_dark_directions_relative_to_a_mirror(kind):
    p = {"heights_um": FIELD.heights_um, "pitch_um": np.array(FIELD.pitch_um), "to_light": np.array(LIGHT), "ior": 1.5}
    p |= {"sigma_um": 1.5, "angular_diameter_deg": 6.0}
    coherence = coherence_of(kind, sigma_um=1.5, angular_diameter_deg=6.0)
    views = np.array([MIRROR, (0.4, 0.1, 1.0), (-0.3, 0.9, 0.7), (0.0, -0.5, 1.0)])
    exact = [complex_step.spectral_reflectance(p | {"to_view": v}, kind, 550.0, masking=True) for v in views]
    flat = p | {"heights_um": np.zeros_like(FIELD.heights_um)}
    mirror = complex_step.spectral_reflectance(flat | {"to_view": views[0]}, kind, 550.0, masking=True)
    for truncation in (1e-2, 1e-5, 1e-13):
        value = wd.adjoint.spectral_reflectance(
            FIELD, LIGHT, views, 550.0, wrt=(), truncation=truncation, coherence=coherence
        ).value[:, 0]
        assert np.abs(value - exact).max() <= max(truncation, 1e-14) * mirror


@pytest.mark.parametrize(("depth_um", "error"), [(1.0, 1e-12), (1e-3, 1e-10), (1e-5, 1e-7)])
def test_single_pairs_have_exact_derivatives_by_the_scale_of_heights(depth_um, error):
    """For one pair of directions and one wavelength, there is only one value of κ = w/λ.

    The range of κ, for which the series of exp(2πiκh) is made, then has the width 0 and must be widened. The derivative
    must still be exact.
    """
    field = noise((5, 9), (0.21, 0.17))
    field = wd.HeightField.of_known_scale(field.heights_um / np.ptp(field.heights_um) * depth_um, field.pitch_um)
    view = np.array([0.3, -0.2, 1.0])
    result = wd.adjoint.spectral_reflectance(
        field, LIGHT, view, 550.0, wrt=("height_scale",), coherence=SHORT, truncation=1e-13
    )
    p = {"heights_um": field.heights_um, "pitch_um": np.array(field.pitch_um), "to_light": np.array(LIGHT)}
    p |= {"to_view": view, "sigma_um": 0.5, "ior": 1.5, "height_scale": 1.0}
    exact = complex_step.derivative(
        lambda q: complex_step.spectral_reflectance(q, "averaged", 550.0, masking=True), p, "height_scale"
    )
    assert result.vjp([1.0])["height_scale"] == pytest.approx(exact, rel=error, abs=0.0)


def test_the_last_entry_of_a_table_has_the_derivative_towards_shorter_wavelengths():
    material = wd.Material.from_nk((400.0, 700.0), (1.2, 2.2), (0.1, 1.1))

    def slope(wavelength_nm):
        value, vjp, _ = wd.adjoint.order_efficiencies(
            FIELD, LIGHT, wavelength_nm, material=material, wrt=("wavelengths_nm",), energy="stam"
        )
        return vjp(np.ones_like(value))["wavelengths_nm"][0]

    assert slope(700.0) == pytest.approx(slope(700.0 - 1e-6), rel=1e-4)
    assert slope(400.0) == pytest.approx(slope(400.0 + 1e-6), rel=1e-4)


def test_a_wavelength_that_is_an_entry_of_two_tables_is_counted_once():
    table = np.array([400.0, 500.0, 600.0])
    film = wd.Material.from_nk(table, [1.3, 1.4, 1.5], [0.0, 0.0, 0.0])
    material = wd.Material.from_nk(table, [1.2, 1.7, 2.2], [1.0, 1.1, 1.3]).coated(film, 50.0)
    with pytest.warns(wd.WarpdiffWarning, match="1 of 2 wavelengths are entries"):
        wd.adjoint.order_efficiencies(FIELD, LIGHT, [500.0, 550.0], material=material, wrt=("wavelengths_nm",))


def test_adjoints_have_the_order_of_wrt_and_do_not_depend_on_it():
    names = ("sigma_um", "to_view", "heights_um", "pitch_um", "to_light")
    results = []
    for order in (names, names[::-1], names + names[:2]):
        value, vjp, _ = wd.adjoint.spectral_reflectance(FIELD, LIGHT, MIRROR, 550.0, wrt=order, coherence=SHORT)
        results.append(vjp(np.ones_like(value)))
        assert tuple(results[-1]) == tuple(dict.fromkeys(order))
    for name in names:
        np.testing.assert_array_equal(results[0][name], results[1][name])
        np.testing.assert_array_equal(results[0][name], results[2][name])


def test_derivatives_do_not_change_with_the_arrays_of_the_caller():
    light = np.array(LIGHT)
    _, vjp, _ = wd.adjoint.spectral_reflectance(FIELD, light, MIRROR, 550.0, wrt=("to_light",), coherence=SHORT)
    before = vjp([1.0])["to_light"]
    light *= 2.0
    np.testing.assert_array_equal(vjp([1.0])["to_light"], before)


def test_values_and_periods_count_as_memory(monkeypatch):
    field, views = noise((300, 300)), np.tile([0.1, 0.0, 1.0], (50_000, 1))
    monkeypatch.setattr(memory, "available", lambda: 1e8)
    with pytest.raises(MemoryError, match="50000 directions and 100 wavelengths"):
        wd.adjoint.spectral_reflectance(FIELD, LIGHT, views, np.linspace(400.0, 700.0, 100), wrt=(), coherence=SHORT)
    monkeypatch.setattr(memory, "available", lambda: 1e6)
    with pytest.raises(MemoryError, match="GB are free"):
        wd.adjoint.spectral_reflectance(field, LIGHT, MIRROR, 500.0, coherence=coherence_of("replicas"))
