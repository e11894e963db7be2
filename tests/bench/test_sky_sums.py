"""The reference for skies and disc lights, sums over directions (``bench.truth.sky_sums``), must equal closed forms.

σ is the standard deviation of the coherence window.
"""

import math

import numpy as np
import pytest
import trimesh

import warpdiff as wd
from bench.truth.sky_sums import SkySums
from warpdiff.optics import colorimetry
from warpdiff.optics.spectra import colour_science

SIGMA_UM = 8.0
WINDOW = wd.Coherence(sigma_um=SIGMA_UM)
# A short coherence window. It widens the angles of each diffraction order (lobes), which reduces the noise of sums over
# directions.
WIDE = wd.Coherence(sigma_um=1.5)
FLAT = wd.HeightField(np.zeros((32, 32)), 0.09)
# The mesh is a square that faces +y. The camera is above it, and tilted away from +y, because azimuths are not defined
# in that direction.
VIEW = wd.View.orthographic((0.0, 3.0, 2.0), (0.0, 0.0, 0.0), extent_y=0.06, width=8, height=6)
AXIS = np.array([0.0, 3.0, -2.0]) / math.sqrt(13.0)
PIXELS = np.argwhere(np.ones((2, 4))) + 2


def polar_and_azimuth(height):
    """Return two angles for all pixels of a sky: the polar angle from +y, and the azimuth from −z towards +x."""
    polar = (np.arange(height) + 0.5) / height * math.pi
    azimuth = ((np.arange(2 * height) + 0.5) / height - 1.0) * math.pi
    return np.meshgrid(polar, azimuth, indexing="ij")


def towards(polar, azimuth):
    return np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], axis=-1)


def floor(above=None):
    """Return a small square that faces +y, together with an optional mesh above it that occludes a part of the sky."""
    corners = 0.1 * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    vertices = np.stack([corners[:, 0], np.zeros(4), corners[:, 1]], axis=1)
    visual = trimesh.visual.TextureVisuals(uv=corners)
    square = trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)
    return square if above is None else trimesh.util.concatenate([square, above])


def patch(polars, azimuths, count=24):
    """Return a mesh of a part of a sphere around the origin, between two polar angles and two azimuths."""
    grid = np.meshgrid(np.linspace(*polars, count), np.linspace(*azimuths, count), indexing="ij")
    index = np.arange(count * count).reshape(count, count)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    uv = np.stack([part.ravel() for part in grid], axis=1)
    visual = trimesh.visual.TextureVisuals(uv=uv)
    return trimesh.Trimesh(3.0 * towards(*grid).reshape(-1, 3), faces, visual=visual, process=False)


def disc_on_sky():
    """Return a sky with a disc of 40° diameter around the mirror direction of ``VIEW``, and the pixels' azimuths."""
    polar, azimuth = polar_and_azimuth(360)
    return np.where(towards(polar, azimuth) @ AXIS > math.cos(math.radians(20.0)), 1.0, 0.0), azimuth


def test_a_mirror_shows_the_colours_of_the_sky():
    """A mirror must show the colour that the sky has in the mirror direction.

    The radiance of the sky is a linear function of its polar angle and azimuth. The mirror reflects a narrow range of
    directions (lobe) of 0.4°. The mean radiance over this range is therefore the radiance at its centre.
    """
    polar, azimuth = polar_and_azimuth(32)
    sky = np.stack([1.0 + 0.3 * azimuth, 0.3 + 0.5 * polar, 0.8 + 0.2 * azimuth + 0.1 * polar], axis=-1)
    view = wd.View.orthographic((2.0, 3.0, 1.0), (0.0, 0.0, 0.0), extent_y=0.06, width=8, height=6)
    result = SkySums(floor(), FLAT, view, WINDOW).under_sky(PIXELS, np.maximum(sky, 0.0), 96, 0).mean(axis=0)
    polar, azimuth = math.atan2(math.hypot(2.0, 1.0), 3.0), math.atan2(-2.0, 1.0)
    shown = [1.0 + 0.3 * azimuth, 0.3 + 0.5 * polar, 0.8 + 0.2 * azimuth + 0.1 * polar]
    np.testing.assert_allclose(result, colorimetry.RGB_TO_XYZ @ shown, rtol=0.02)


def test_a_mirror_under_a_wide_disc_light_reflects_its_whole_lobe():
    light = wd.DirectionalLight(tuple(AXIS), power=2.0, angular_diameter_deg=10.0)
    result = SkySums(floor(), FLAT, VIEW, WINDOW).under_disc(PIXELS, light, 128, 0).mean(axis=0)
    # The integral of 4πσ²/λ² times the reflectance over all directions is 1. If a disc light contains all directions
    # that the mirror reflects, the reflected light is λ²/(4πσ²), divided by the solid angle of the disc.
    um = 1e-3 * np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1)
    products = colorimetry.colour_products("D65")
    lobe = um**2 @ products / products[:, 1].sum() / (4.0 * math.pi * SIGMA_UM**2)
    np.testing.assert_allclose(result, 2.0 * lobe / (2.0 * math.pi * (1.0 - math.cos(math.radians(5.0)))), rtol=0.02)


@pytest.fixture(scope="module")
def fingers():
    return wd.gratings.fingers(size_um=6.4, pitch_um=0.08)


def test_a_disc_on_a_sky_is_a_disc_light(fingers):
    sums = SkySums(floor(), fingers, VIEW, WIDE)
    under_sky = sums.under_sky(PIXELS, disc_on_sky()[0], 96, 0).mean(axis=0)
    nm = np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1, dtype=float)
    d65 = colour_science().SDS_ILLUMINANTS["D65"]
    spectrum = wd.Spectrum(nm, np.interp(nm, d65.wavelengths, d65.values) / nm**2)
    light = wd.DirectionalLight(tuple(AXIS), illuminant=spectrum, angular_diameter_deg=40.0)
    bright = colorimetry.colour_products("D65")[:, 1]
    # A colour under a disc light is a mean over the solid angle of the disc. A colour under a sky is an integral over
    # the same solid angle. The factor ``scale`` converts the mean to the integral.
    scale = 2.0 * math.pi * (1.0 - math.cos(math.radians(20.0))) * 4.0 * math.pi * WIDE.sigma_um**2
    scale *= (bright / (1e-3 * nm) ** 2).sum() / bright.sum()
    under_light = sums.under_disc(PIXELS, light, 96, 0).mean(axis=0)
    np.testing.assert_allclose(under_sky, scale * under_light, rtol=0.02)


def test_an_occluder_equals_a_black_part_of_the_sky(fingers):
    sky, azimuth = disc_on_sky()
    body = floor(patch(np.radians([5.0, 85.0]), np.radians([-120.0, 5.0])))
    hidden, black, bare = (
        SkySums(body, fingers, VIEW, WIDE, shadows=shadows).under_sky(PIXELS, light, 96, 0).mean(axis=0)
        for shadows, light in ((True, sky), (False, np.where(azimuth < math.radians(5.0), 0.0, sky)), (False, sky))
    )
    assert 0.2 < hidden[1] / bare[1] < 0.8
    np.testing.assert_allclose(hidden, black, rtol=0.02)
