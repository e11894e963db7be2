"""Colorimetry: white point, weights of sampled wavelengths (quadratures), colour matrices and transfer function."""

import itertools
import subprocess
import sys
import warnings

import numpy as np
import pytest
from conftest import relative_errors

import warpdiff as wd
from warpdiff.optics import colorimetry

WHITE_D65 = (0.950423, 1.0, 1.088610)
FLAT = wd.HeightField(np.zeros((8, 8)), 0.05)
NORMAL = (0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def colour():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
    return colour


def one_nm_sum(colour, illuminant, rho=1.0):
    shape = colour.SpectralShape(380, 780, 1)
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    source = colour.SDS_ILLUMINANTS[illuminant].copy().align(shape).values
    return (np.reshape(rho, (-1, 1)) * observer * source[:, None]).sum(axis=0) / (observer[:, 1] * source).sum()


@pytest.mark.parametrize("illuminant", ["D65", "A", "E", "FL2"])
def test_white_is_the_one_nm_sum(colour, illuminant):
    expected = one_nm_sum(colour, illuminant)
    for wavelengths in (
        colorimetry.wavelengths_uniform_in_wavenumber(227),
        np.arange(380, 781),
        [555.0],
        [400, 500, 700],
    ):
        weights = colorimetry.quadrature_weights(wavelengths, illuminant)
        assert weights.min() >= 0.0
        np.testing.assert_allclose(weights.sum(axis=0), expected, rtol=1e-12)
    if illuminant == "D65":
        np.testing.assert_allclose(expected, WHITE_D65, atol=1e-6)


@pytest.mark.parametrize("illuminant", sorted(colorimetry.PRECOMPUTED))
def test_precomputed_products_equal_those_of_colour_science(illuminant):
    """The stored products of illuminants and CIE observer must equal those that the package colour-science computes.

    If this test fails because colour-science has changed, write the stored file again with ``numpy.save``.
    """
    expected = colorimetry.products_by_colour_science(illuminant)
    np.testing.assert_allclose(colorimetry.colour_products(illuminant), expected, rtol=1e-12, atol=0.0)


def test_daylight_needs_no_colour_science():
    code = "import sys, warpdiff.optics.colorimetry as s; s.colour_products(); sys.exit('colour' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("geometric", [False, True])
@pytest.mark.parametrize("illuminant", ["D65", "FL2"])
@pytest.mark.parametrize("count", [2, 17, 227])
def test_uniform_quadratures_give_white_its_exact_colour(colour, geometric, illuminant, count):
    """Sums with equal steps in 1/λ or in ln λ must give a perfect mirror the same colour as a sum over 1 nm steps."""
    wavenumbers, weights = colorimetry.uniform_quadrature(count, illuminant, geometric=geometric)
    np.testing.assert_allclose(1e3 / wavenumbers[[0, -1]], [380.0, 780.0], rtol=1e-14)
    steps = np.diff(np.log(wavenumbers) if geometric else wavenumbers)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    assert weights.min() >= 0.0
    np.testing.assert_allclose(weights.sum(axis=0), one_nm_sum(colour, illuminant), rtol=1e-12)


def test_flat_mirror_is_white(device):
    xyz = wd.reflectance(FLAT, NORMAL, NORMAL, tolerance=1e-5, device=device)
    np.testing.assert_allclose(xyz, WHITE_D65, atol=1e-6)


def test_the_quadrature_of_a_linear_reflectance_is_accurate(colour):
    """The quadrature of a reflectance that is linear in λ must be accurate for steps of 1 to 50 nm.

    The quadrature is of sixth order in 1/λ. At a step of 50 nm some of its weights would be negative. These are added
    to the weights of neighbouring wavelengths, which makes the result less accurate.
    """
    rho = np.linspace(0.2, 0.9, 401)
    exact = one_nm_sum(colour, "D65", rho)
    for step, error in ((1, 1e-8), (5, 1e-8), (10, 1e-8), (25, 1e-7), (50, 1e-2)):
        weights = colorimetry.quadrature_weights(np.arange(380, 781, step))
        assert weights.min() >= 0.0
        np.testing.assert_allclose(rho[::step] @ weights, exact, rtol=0.0, atol=error)


def test_negative_weights_are_added_to_their_neighbours():
    """The sum of the weights (the colour of white) must not change, even if an end has a negative weight."""
    weights = np.array([[-0.2, 1.0, 0.1], [1.0, -0.1, 1.0], [1.0, 1.0, 1.0], [0.3, 1.0, -0.4]])
    result = colorimetry._without_negative(weights)
    assert result.min() >= 0.0
    np.testing.assert_allclose(result.sum(axis=0), weights.sum(axis=0), rtol=1e-6)
    np.testing.assert_allclose(result[:, 1], [0.95, 0.0, 0.95, 1.0], rtol=1e-6)


def test_quadrature_converges_for_a_wave():
    def colour_of(count):
        nodes = colorimetry.wavelengths_uniform_in_wavenumber(count)
        return (1.0 + np.cos(2e3 * np.pi * 3.0 / nodes)) @ colorimetry.quadrature_weights(nodes)

    exact = colour_of(40_001)
    errors = [np.linalg.norm(colour_of(count) - exact) for count in (26, 51, 101, 201)]
    assert errors[-1] < 1e-8
    assert all(later < 0.03 * before for before, later in itertools.pairwise(errors))


@pytest.mark.parametrize("illuminant", ["D65", "FL11", "HP1"])
def test_few_samples_suffice_for_orders_under_illuminants_with_narrow_lines(illuminant):
    """Under illuminants with narrow lines, few wavelengths must suffice for the colours of diffraction orders.

    The tested spectra are Gaussians in 1/λ around 101 positions. An order has such a spectrum under a Gaussian
    coherence window. Narrow lines of the illuminant often lie between two wavelengths of the quadrature.
    """
    centres = np.linspace(1e3 / 780.0, 1e3 / 380.0, 101)

    def colours(count):
        wavenumbers, weights = colorimetry.uniform_quadrature(count, illuminant)
        return np.exp(-0.5 * (18.0 * (wavenumbers - centres[:, None])) ** 2) @ weights

    exact = colours(4001)
    # For each tolerance, the library's upper-bound plan has enough wavelengths for any surface. The tested numbers are
    # slightly smaller.
    for count, tolerance in ((76, 1e-2), (91, 1e-3), (108, 1e-4)):
        assert np.percentile(relative_errors(colours(count), exact), 99.0) < 0.5 * tolerance


def test_matrices_agree_with_colour_science(colour):
    reference = colour.RGB_COLOURSPACES["sRGB"].matrix_XYZ_to_RGB
    np.testing.assert_allclose(colorimetry.XYZ_TO_RGB, reference, atol=1e-12)
    np.testing.assert_allclose(colorimetry.xyz_to_rgb([WHITE_D65])[0], 1.0, atol=2e-3)
    np.testing.assert_allclose(colorimetry.xyz_to_rgb(colorimetry.rgb_to_xyz([[0.2, -0.1, 0.7]]))[0], [0.2, -0.1, 0.7])


def test_srgb_transfer_functions_agree_with_colour_science(colour):
    # The steps are so small that several values are near the end of the linear part, 0.0031308.
    linear = np.linspace(0.0, 1.0, 10_001)
    np.testing.assert_allclose(colorimetry.srgb_encode(linear), colour.models.eotf_inverse_sRGB(linear), atol=1e-12)
    np.testing.assert_allclose(colorimetry.srgb_decode(colorimetry.srgb_encode(linear)), linear, atol=1e-7)
    np.testing.assert_allclose(colorimetry.srgb_encode([-0.5, 2.0]), [0.0, 1.0], atol=1e-15)


def test_importing_the_package_prints_no_message_of_colour_science():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        colorimetry.colour_products.cache_clear()
        colorimetry.colour_products("D65")


@pytest.mark.parametrize(
    ("wavelengths", "message"),
    [([500.0, 400.0], "strictly increasing"),
     ([0.5, 0.6], "give wavelengths in nanometres"),
     ([], "shape"),
     ([[400.0, 500.0]], "shape"),
     ([np.nan], "finite"),
     ("blue", "real numbers")],
)  # fmt: skip
def test_invalid_wavelengths_are_refused(wavelengths, message):
    with pytest.raises((ValueError, TypeError), match=message):
        colorimetry.quadrature_weights(wavelengths)


@pytest.mark.parametrize(
    ("illuminant", "message"), [("D66", "one of"), (6500, "name of a CIE"), ("ISO 7589 Photographic Daylight", "cover")]
)
def test_invalid_illuminants_are_refused(illuminant, message):
    with pytest.raises((ValueError, TypeError), match=message):
        wd.reflectance(FLAT, NORMAL, NORMAL, illuminant=illuminant)


@pytest.mark.parametrize("geometric", [False, True])
def test_cached_quadratures_cannot_be_changed(geometric):
    """The arrays of a quadrature must be read-only, because later calls return the same arrays."""
    for values in colorimetry.uniform_quadrature(17, "D65", geometric=geometric):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0.0
