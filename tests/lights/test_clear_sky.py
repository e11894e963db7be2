"""Clear skies: luminances and illuminances by the CIE's formulas, and power, width and position of the sun."""

import math

import numpy as np
import pytest

import warpdiff as wd
from warpdiff.lights.sky_grid import extract_suns
from warpdiff.optics import colorimetry

LUMINANCE = colorimetry.RGB_TO_XYZ[1]


def traditional(along, to_sun):
    """Return luminances of the CIE clear sky of 1973.

    Type 12 of the CIE general sky differs from this sky only by rounding.
    """
    angle = np.arccos(np.clip(along @ to_sun, -1.0, 1.0))
    return (0.91 + 10.0 * np.exp(-3.0 * angle) + 0.45 * np.cos(angle) ** 2) * (1.0 - np.exp(-0.32 / along[..., 1]))


def illuminance(to_sun):
    """Return the horizontal illuminance divided by the luminance of the zenith, by Gauss–Legendre quadrature."""
    points, weights = np.polynomial.legendre.leggauss(200)
    cosine, azimuth = 0.5 * (points + 1.0), math.pi * points
    sine = np.sqrt(1.0 - cosine**2)[:, None]
    along = np.stack([sine * np.sin(azimuth), cosine[:, None] + 0.0 * azimuth, -sine * np.cos(azimuth)], axis=-1)
    zenith = traditional(np.array([0.0, 1.0, 0.0]), to_sun)
    return 0.5 * math.pi * (weights * cosine) @ (traditional(along, to_sun) / zenith) @ weights


@pytest.mark.parametrize("altitude", [8.0, 37.0, 90.0])
def test_luminances_and_illuminances_of_the_sky_follow_the_cie(altitude):
    up, level = math.sin(math.radians(altitude)), math.cos(math.radians(altitude))
    to_sun = np.array([0.6 * level, up, 0.8 * level])
    sky = wd.Environment.clear_sky(3.0 * to_sun, sun=0.0, ground_albedo=0.3)
    luminance = sky.radiance_rgb.astype(np.float64) @ LUMINANCE
    polar = (np.arange(512) + 0.5) / 512.0 * math.pi
    # Columns of the sky's latitude-longitude image are ordered by azimuth, counter-clockwise as viewed from above, and
    # are rotated by ``rotation_deg``.
    azimuth = ((np.arange(1024) + 0.5) / 512.0 - 1.0) * math.pi - math.radians(sky.rotation_deg)
    for row, column in ((3, 700), (100, 20), (250, 511), (200, 1023)):
        sine = math.sin(polar[row])
        along = np.array([sine * math.sin(azimuth[column]), math.cos(polar[row]), -sine * math.cos(azimuth[column])])
        expected = math.pi / illuminance(to_sun) * traditional(along, to_sun) / traditional(np.eye(3)[1], to_sun)
        assert luminance[row, column] == pytest.approx(expected, rel=1e-3)
    solid = -np.diff(np.cos(np.arange(257) / 512.0 * math.pi)) * math.pi / 512.0
    assert (luminance[:256].sum(axis=1) * np.cos(polar[:256])) @ solid == pytest.approx(math.pi)
    assert np.allclose(luminance[256:], 0.3)
    assert not wd.Environment.clear_sky(to_sun, sun=0.0, ground_albedo=0.0).radiance_rgb[256:].any()
    around = wd.Environment.clear_sky((-to_sun[2], up, to_sun[0] + 1e-8), sun=0.0, ground_albedo=0.3)
    assert np.array_equal(around.radiance_rgb, sky.radiance_rgb)


@pytest.mark.parametrize("altitude", [10.0, 45.1, 89.9])
def test_the_sun_is_extracted_with_its_power_width_and_position(altitude):
    """The sun that is extracted from a sky must have the power, width and position with which the sky was made.

    The sun has a diameter of 0.53°, and pixels of the sky are 0.35° wide. Of the extracted light, 3 % is the glow of
    the sky around the sun.
    """
    up, level = math.sin(math.radians(altitude)), math.cos(math.radians(altitude))
    sky = wd.Environment.clear_sky((-0.6 * level, up, 0.8 * level), sun=2.0)
    (sun,) = extract_suns(sky.radiance_rgb)[1]
    ratio = 127.5 * math.exp(-0.21 / up) / (0.8 + 15.5 * math.sqrt(up))
    assert sun.rgb @ LUMINANCE == pytest.approx(2.0 * ratio * math.pi, rel=1e-3)
    assert sun.deviation == pytest.approx(math.radians(0.53) / 4.0, rel=0.03)
    turn = math.radians(sky.rotation_deg)
    x, y, z = sun.towards
    placed = np.array([math.cos(turn) * x + math.sin(turn) * z, y, math.cos(turn) * z - math.sin(turn) * x])
    assert np.degrees(np.abs(placed - (-0.6 * level, up, 0.8 * level))).max() < 1e-3
    # Below the horizon, the ground reflects a fifth of the illuminance of the sky and of the sun.
    ground = sky.radiance_rgb[300, 0] @ LUMINANCE
    assert ground == pytest.approx(0.2 * (1.0 + 2.0 * ratio * up), rel=1e-5)


def test_a_sun_at_the_horizon_has_faded():
    with_sun, without = (wd.Environment.clear_sky((1.0, 1e-300, 0.0), sun=sun) for sun in (1.0, 0.0))
    assert np.array_equal(with_sun.radiance_rgb, without.radiance_rgb)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"sun_direction": (1.0, 0.0, 0.0)}, "sun_direction must be above the horizon"),
     ({"sun_direction": (0.0, 0.0, 0.0)}, "sun_direction must not contain zero vectors"),
     ({"sun": -1.0}, "sun must be"), ({"ground_albedo": 1.1}, "ground_albedo must be"),
     ({"scale": -1.0}, "scale must be")],
)  # fmt: skip
def test_invalid_clear_skies_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        wd.Environment.clear_sky(**{"sun_direction": (0.0, 1.0, 0.0)} | arguments)
