"""Spectra of light sources: temperatures, files, names of colour-science, and invalid arguments."""

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.optics.colorimetry import colour_products
from warpdiff.optics.spectra import colour_science


def white(illuminant):
    return colour_products(illuminant).sum(axis=0)


def test_a_black_body_of_2855_kelvin_equals_illuminant_a():
    """A black body of 2855.5 K must have the white point of illuminant A.

    The CIE defined illuminant A by an older value of the radiation constant c₂. With today's value, its temperature is
    2855.5 K.
    """
    np.testing.assert_allclose(white(wd.Spectrum.blackbody(2855.5)), white("A"), rtol=2e-4)


def test_daylight_of_6504_kelvin_equals_d65():
    np.testing.assert_allclose(white(wd.Spectrum.daylight(6504.0)), white("D65"), rtol=2e-3)


def test_hot_and_cold_bodies_have_their_colours():
    cold, hot = white(wd.Spectrum.blackbody(500.0)), white(wd.Spectrum.blackbody(1e5))
    assert cold[2] < 1e-3
    assert hot[2] > 1.5
    assert np.isfinite([cold, hot]).all()


@pytest.mark.parametrize("kelvin", [500.0, 2855.5, 1e5])
def test_a_black_body_follows_plancks_law_relative_to_560_nm(kelvin):
    body = wd.Spectrum.blackbody(kelvin)
    # CIE 15 uses the radiation constant c₂ = 1.4388e-2 m K.
    power = body.wavelengths_nm**-5 / np.expm1(1.4388e7 / (kelvin * body.wavelengths_nm))
    np.testing.assert_allclose(body.values, power / power[body.wavelengths_nm == 560.0], rtol=1e-6)


def test_a_file_is_read_by_its_columns(tmp_path):
    nm = np.arange(360, 831, 5)
    body = wd.Spectrum.blackbody(4000.0)
    values = np.interp(nm, body.wavelengths_nm, body.values)
    for sign in (",", ";", "\t", "  "):
        text = f"# a bulb\nwavelength{sign}power\n" + "".join(
            f"{n}{sign}{v:.6g}\n" for n, v in zip(nm, values, strict=True)
        )
        (tmp_path / "lamp.csv").write_text(text)
        spectrum = wd.Spectrum.from_csv(tmp_path / "lamp.csv")
        assert spectrum.name == "lamp"
        np.testing.assert_allclose(white(spectrum), white(body), rtol=1e-3)


def test_spectra_with_equal_numbers_are_equal():
    assert wd.Spectrum.blackbody(3000.0) == wd.Spectrum.blackbody(3000.0)
    assert hash(wd.Spectrum.blackbody(3000.0)) == hash(wd.Spectrum.blackbody(3000.0))
    assert wd.Spectrum.blackbody(3000.0) != wd.Spectrum.blackbody(3001.0)
    assert repr(wd.Spectrum.blackbody(3000.0)) == "Spectrum(name='black body of 3000 K')"


def test_a_constant_spectrum_equals_illuminant_e_in_calls_and_pictures():
    even, heightfield = wd.Spectrum([300.0, 900.0], [2.0, 2.0]), wd.gratings.sinusoidal(1.2, 0.1)
    directions = (0.1, 0.2, 1.0), [(0.3, 0.0, 1.0), (0.0, -0.1, 1.0)]
    of_even, of_e = (wd.reflectance(heightfield, *directions, illuminant=i, tolerance=1e-3) for i in (even, "E"))
    np.testing.assert_allclose(of_even, of_e, rtol=1e-4)
    view = wd.View((0, 0, 4), (0, 0, 0), width=12, height=9)
    lights = [wd.DirectionalLight((0.2, 0.3, 1.0), illuminant=illuminant) for illuminant in (even, "E")]
    one, other = (wd.shade(wd.meshes.disc(), heightfield, light, view, refine=False, tolerance=0.1) for light in lights)
    np.testing.assert_allclose(one.xyz, other.xyz, rtol=1e-3, atol=1e-6)


def lines(*peaks, half_width=0.08):
    """Return a spectrum of narrow triangular lines; each of ``peaks`` is a wavelength [nm] and the power of a line."""
    knots, values = [300.0], [0.0]
    for nm, power in peaks:
        knots += [nm - half_width, nm, nm + half_width]
        values += [0.0, power / half_width, 0.0]
    return wd.Spectrum([*knots, 900.0], [*values, 0.0], name="lines")


@pytest.mark.parametrize("peaks", [
    [(532.4, 1.0)], [(450.31, 1.0), (610.77, 3.0)], [(543.5, 0.5), (632.8, 1.0), (633.0, 2.0)],
    [(404.66, 1.0), (435.83, 2.0), (546.07, 1.0), (546.3, 1.0), (576.96, 0.8), (579.07, 0.8)],
])  # fmt: skip
def test_lines_narrower_than_a_nanometre_keep_their_power(peaks):
    """The white point of narrow lines must equal the sum over lines of power times the curves of the CIE observer.

    The expected XYZ is this sum divided by its Y.
    """
    observer = colour_science().MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    curves = [np.interp([nm for nm, _ in peaks], observer.wavelengths, values) for values in observer.values.T]
    expected = np.array(curves) @ [power for _, power in peaks]
    np.testing.assert_allclose(white(lines(*peaks)), expected / expected[1], rtol=2e-4)


def test_a_fine_table_of_a_smooth_spectrum_has_the_colour_of_a_coarse_one():
    nm = np.arange(380.0, 780.01, 0.1)
    coarse = wd.Spectrum.blackbody(3200.0)
    fine = wd.Spectrum(nm, np.interp(nm, coarse.wavelengths_nm, coarse.values))
    np.testing.assert_allclose(colour_products(fine), colour_products(coarse), rtol=1e-4, atol=1e-7)


def test_light_sources_are_selected_by_name():
    assert white("LED-B1")[1] == pytest.approx(1.0)
    assert white("Kinoton 75P")[1] == pytest.approx(1.0)


BAD = {
    "must have the same shape": lambda: wd.Spectrum([380.0, 780.0], [1.0]),
    "strictly increasing": lambda: wd.Spectrum([380.0, 780.0, 700.0], [1.0, 1.0, 1.0]),
    "must cover 380 to 780 nm, got 400 to 800": lambda: wd.Spectrum([400.0, 800.0], [1.0, 1.0]),
    "must not be negative": lambda: wd.Spectrum([380.0, 780.0], [1.0, -1.0]),
    "values must exceed 1e-15 between 400 and 700 nm, got 0": lambda: wd.Spectrum([380.0, 780.0], [0.0, 0.0]),
    "temperature_k must be a finite number, at least 4000": lambda: wd.Spectrum.daylight(3000.0),
    "temperature_k must be a finite number, at least 500": lambda: wd.Spectrum.blackbody(0.0),
}


@pytest.mark.parametrize("message", BAD)
def test_bad_spectra_are_refused(message):
    with pytest.raises(ValueError, match=message):
        BAD[message]()


def test_files_without_a_spectrum_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text("nothing")
    with pytest.raises(ValueError, match=r"a\.csv must have two columns of numbers"):
        wd.Spectrum.from_csv(tmp_path / "a.csv")
    with pytest.raises(FileNotFoundError, match="path: there is no file"):
        wd.Spectrum.from_csv(tmp_path / "b.csv")
