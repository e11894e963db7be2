"""Display transforms: comparison with colour-science, hues of narrow bands of light, limits, and tables."""

import os
import subprocess
import sys
import warnings

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.image import display_transform as transform
from warpdiff.optics import colorimetry
from warpdiff.request.settings import DisplaySettings

with warnings.catch_warnings():
    # colour-science warns about optional packages that are not installed.
    warnings.simplefilter("ignore")
    import colour


@pytest.fixture(scope="module")
def bands():
    """Return XYZ of light in bands 10, 30 or 60 nm wide, with centres from 430 to 680 nm, scaled to Y = 0.02 to 2."""
    products, wavelengths = colorimetry.colour_products("D65"), np.arange(380, 781)
    xyz = np.array(
        [
            [products[np.abs(wavelengths - centre) <= 0.5 * width].sum(axis=0) for centre in range(430, 681, 5)]
            for width in (10, 30, 60)
        ]
    )
    xyz /= xyz[..., 1:2]
    return xyz[:, None] * np.array([0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0])[:, None, None]


def encode(xyz, display, gamut, *, exact=True):
    return transform.encode(xyz, DisplaySettings(display=display, gamut=gamut), exact=exact)


def hues_deg(xyz):
    lab = transform.oklab(xyz)
    return np.degrees(np.arctan2(lab[..., 2], lab[..., 1]))


def apart_deg(one, other):
    return np.abs((one - other + 180.0) % 360.0 - 180.0)


def displayed(encoded):
    return colorimetry.rgb_to_xyz(colorimetry.srgb_decode(encoded))


def hue_errors(encoded, bands):
    """Return the change of each spectral band's hue by a display transform [degrees].

    Also return the largest hue difference between neighbouring bands [degrees].
    """
    hues = hues_deg(displayed(encoded))
    return apart_deg(hues, hues_deg(bands)), float(apart_deg(hues[..., 1:], hues[..., :-1]).max())


def test_colours_in_gamut_equal_those_of_colour_science(rng):
    for gamut, name in (("srgb", "sRGB"), ("display-p3", "Display P3")):
        # The matrices of colour-science are rounded to four digits. With them, colours on the border of the gamut could
        # be outside of the gamut.
        rgb = rng.uniform(0.002, 0.998, (500, 3))
        space = colour.RGB_COLOURSPACES[name]
        xyz = colour.RGB_to_XYZ(rgb, space)
        for display in ("colorimetric", "clip"):
            displayed_xyz = colour.RGB_to_XYZ(encode(xyz, display, gamut), space, apply_cctf_decoding=True)
            lab, expected = (colour.XYZ_to_Lab(colours, space.whitepoint) for colours in (displayed_xyz, xyz))
            assert np.max(colour.delta_E(lab, expected, method="CIE 2000")) <= 0.5


def test_oklab_equals_that_of_colour_science(rng):
    xyz = rng.uniform(0.0, 2.0, (50, 3))
    np.testing.assert_allclose(transform.oklab(xyz), colour.XYZ_to_Oklab(xyz), atol=1e-5)
    np.testing.assert_allclose(transform.of_oklab(transform.oklab(xyz)), xyz, atol=1e-9)


def test_aces_preserves_the_hues_of_narrow_bands(bands):
    errors, step = hue_errors(encode(bands, "aces", "srgb"), bands)
    without, step_without = hue_errors(transform.aces(bands.reshape(-1, 3), "srgb").reshape(bands.shape), bands)
    # The limits are somewhat larger than measured values. The ACES transform was measured to change hues by 0.6° in the
    # median and by at most 12.4°. Hues of neighbouring bands differ by at most 17.8° after the transform, and by at
    # most 14.1° before it.
    assert np.median(errors) < 1.0
    assert np.median(without) > 2.0
    assert errors.max() < 13.0
    assert without.max() > 30.0
    assert step < 18.5
    assert step_without > 21.0
    clipped, step_clipped = hue_errors(encode(bands, "clip", "srgb"), bands)
    assert clipped.max() > 50.0
    assert step_clipped > 60.0


def test_colorimetric_preserves_hues_except_near_white(bands):
    encoded = encode(bands, "colorimetric", "srgb")
    errors, _ = hue_errors(encoded, bands)
    lab = transform.oklab(displayed(encoded))
    coloured = np.hypot(lab[..., 1], lab[..., 2]) > 0.01
    assert coloured[:, :4].mean() > 0.9
    assert errors[coloured].max() < 0.5


def test_compression_changes_only_vivid_colours_and_preserves_lightness_and_hue(bands):
    greys = np.linspace(0.0, 3.0, 7)[:, None] * colorimetry.rgb_to_xyz([1.0, 1.0, 1.0])
    np.testing.assert_array_equal(transform.compress_chroma(greys), greys)
    flat = bands.reshape(-1, 3)
    before, after = transform.oklab(flat), transform.oklab(transform.compress_chroma(flat))
    np.testing.assert_allclose(after[:, 0], before[:, 0], rtol=1e-9)
    assert apart_deg(hues_deg(flat), hues_deg(transform.compress_chroma(flat))).max() < 1e-6
    # If two colours differ only in chroma, the colour with more chroma must still have more chroma after
    # ``compress_chroma``.
    share = np.linspace(0.0, 1.0, 50)[:, None, None]
    scaled = before * np.concatenate([np.ones_like(share), share, share], axis=2)
    lab = transform.oklab(transform.compress_chroma(transform.of_oklab(scaled).reshape(-1, 3))).reshape(scaled.shape)
    assert np.all(np.diff(np.hypot(lab[..., 1], lab[..., 2]), axis=0) > 0.0)


@pytest.mark.parametrize("gamut", list(transform.GAMUTS))
def test_a_table_approximates_aces(bands, gamut):
    exact, fast = (encode(bands, "aces", gamut, exact=is_exact) for is_exact in (True, False))
    labs = [colour.XYZ_to_Lab(displayed(encoded), [0.3127, 0.3290]) for encoded in (exact, fast)]
    differences = colour.delta_E(*labs, method="CIE 2000")
    assert np.median(differences) < 0.15
    assert np.percentile(differences, 99) < 1.0


@pytest.mark.parametrize("display", list(transform.MEAN_SHOWN))
@pytest.mark.parametrize("exact", [True, False])
def test_extreme_colours_are_displayable(display, exact):
    light = np.array([0.0, 1e-300, 1e-30, 1e-9, 1e-3, 1.0, 1e9, 1e30])
    for colours in ([0.95, 1.0, 1.09], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.1, 1.0, 0.0]):
        encoded = encode(light[:, None] * colours, display, "srgb", exact=exact)
        assert np.all((encoded >= 0.0) & (encoded <= 1.0))
    white = encode(light[:, None] * colorimetry.rgb_to_xyz([1.0, 1.0, 1.0]), display, "srgb", exact=exact)
    assert np.all(white[0] < 1e-6)
    np.testing.assert_allclose(white[-2:], 1.0, atol=1e-3)
    assert np.all(np.diff(white[:, 1]) >= -1e-6)
    assert encode(np.zeros((0, 3)), display, "srgb", exact=exact).shape == (0, 3)


def test_another_configuration_of_the_environment_is_not_read(tmp_path):
    (tmp_path / "other.ocio").write_text("nonsense")
    code = (
        "import numpy as np, warpdiff as wd\n"
        "assert abs(wd.to_srgb(0.18 * np.array([0.9505, 1.0, 1.089]), exposure=1.0)[1] - 0.349) < 2e-3"
    )
    subprocess.run(
        [sys.executable, "-c", code], check=True, timeout=120, env=os.environ | {"OCIO": str(tmp_path / "other.ocio")}
    )


def test_colours_within_the_gamut_are_those_of_the_standard(rng):
    """For XYZ of random linear sRGB colours, results must equal the formula of the standard IEC 61966-2-1."""
    linear = rng.uniform(0.0, 1.0, (3, 5, 3))
    xyz = linear @ np.linalg.inv([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]).T
    expected = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(wd.to_srgb(xyz, "colorimetric", exposure=1.0), expected, atol=1e-9)
    np.testing.assert_allclose(wd.to_srgb(xyz / 2, "clip", exposure=1.0, exposure_stops=1.0), expected, atol=1e-9)


@pytest.mark.parametrize("display", ["aces", "colorimetric", "clip"])
def test_colours_of_an_array_are_those_of_a_picture(display):
    image = wd.reflectance_map(wd.gratings.sinusoidal(2.0, 0.1), (0, 0, 1), size=16, tolerance=0.3)
    shown = wd.to_srgb(image.xyz[image.mask], display)
    np.testing.assert_allclose(image.display(display)[image.mask][:, :3], shown, atol=2e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"xyz": [0.5, 0.5]}, r"xyz must have shape \(..., 3\), got \(2,\)"),
     ({"display": "srgb"}, "display must be one of"),
     ({"exposure": 0.0}, "exposure must be"), ({"exposure_stops": 31.0}, "exposure_stops must be")],
)  # fmt: skip
def test_colours_and_settings_that_are_not_accepted_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        wd.to_srgb(**{"xyz": [0.1, 0.2, 0.3]} | arguments)


def test_black_colours_stay_black():
    np.testing.assert_array_equal(wd.to_srgb(np.zeros((2, 3))), 0.0)
