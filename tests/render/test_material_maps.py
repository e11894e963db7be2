"""Pictures of plain surfaces whose metallic, roughness and emission are given by textures.

A plain surface has no height field, and reflects by base colour, metallic and roughness.
"""

import math

import numpy as np
import pytest
import trimesh
from PIL import Image
from plain_specification import OPTIONS, POINTS, SURFACES, VIEW, brdf, quad, white_luminance
from texture_specification import bilinear
from trimesh.visual.material import PBRMaterial

import warpdiff as wd
from warpdiff.optics import colorimetry
from warpdiff.render import device_tiles, renderer

COLOUR = (1.0, 0.8, 0.4)
REPEAT = ("repeat", "repeat")


def checker(low, high, size=8):
    """Return an 8-bit image with a chessboard pattern: roughness in the green channel, metallic in the blue channel."""
    texels = np.zeros((size, size, 3), np.uint8)
    odd = np.indices((size, size)).sum(axis=0) % 2 == 1
    texels[..., 1], texels[..., 2] = np.where(odd, high, low), np.where(odd, 255, 128)
    return texels


def mapped(texels, **values):
    return PBRMaterial(
        name="mapped", baseColorFactor=[*(round(255 * value) for value in COLOUR), 255], metallicFactor=0.9,
        roughnessFactor=0.8, metallicRoughnessTexture=Image.fromarray(texels), **values,
    )  # fmt: skip


def scene(own, bend=0.25, grating=None):
    """Return a quad with the material ``own``, and a distant quad with a grating."""
    result = trimesh.Scene({"body": quad(0.0, own, bend)})
    result.add_geometry(quad(0.0, grating, y=-4.0), geom_name="grating")
    return result


def test_pixels_have_the_brdf_of_the_roughness_at_their_texture_coordinates():
    texels = checker(80, 250)
    layers = ["geometry", "to_light", "to_view", "uv"]
    light = wd.DirectionalLight((0.2, 0.1, 1.0), power=3.0)
    image = wd.shade(scene(mapped(texels)), SURFACES, light, VIEW, **POINTS, layers=layers)
    inner = (image.layers["geometry"] == 0) & image.mask
    to_light, to_view, uv = (image.layers[name][inner].astype(float) for name in ("to_light.0", "to_view", "uv"))
    _, green, blue = bilinear(texels / 255.0, REPEAT, uv[:, 0], uv[:, 1]).T
    expected = np.array(
        [
            brdf(to_light[i : i + 1], to_view[i : i + 1], 0.9 * blue[i], 0.8 * green[i], COLOUR)[0]
            for i in range(len(uv))
        ]
    )
    expected = math.pi * 3.0 * white_luminance() * expected * to_light[:, 2:] @ colorimetry.RGB_TO_XYZ.T
    assert len(expected) > 100
    assert np.ptp(green) > 0.5
    error = np.linalg.norm(image.xyz[inner] - expected, axis=1) / np.linalg.norm(expected, axis=1)
    assert np.max(error) <= 1e-3


@pytest.mark.parametrize("options", [POINTS, OPTIONS | {"refine": False}], ids=["points", "means"])
def test_a_texture_of_one_colour_multiplies_the_factors(options):
    texels = np.tile(np.array([7, 102, 51], np.uint8), (4, 4, 1))
    # For surfaces with textures, subpixel cells are weighted by a different filter. Both materials therefore have a
    # texture, although that of the second one is only white.
    white = {"baseColorTexture": Image.new("RGB", (1, 1), (255, 255, 255))}
    plain = PBRMaterial(
        name="mapped", baseColorFactor=[255, 204, 102, 255], metallicFactor=0.9 * 0.2, roughnessFactor=0.8 * 0.4,
        **white,
    )  # fmt: skip
    lights = [wd.DirectionalLight((0.2, 0.1, 1.0))]
    if options is not POINTS:
        disc = wd.DirectionalLight((0.0, 0.1, 1.0), angular_diameter_deg=8.0)
        lights += [disc, wd.Environment.clear_sky((0.3, 0.8, 1.0))]
    for light in lights:
        images = [wd.shade(scene(own), SURFACES, light, VIEW, **options) for own in (mapped(texels, **white), plain)]
        np.testing.assert_allclose(images[0].xyz, images[1].xyz, rtol=1e-4, atol=1e-9)


def test_emission_is_multiplied_by_its_texture():
    texels = np.zeros((4, 4, 3), np.uint8)
    texels[:, :2], texels[:, 2:] = (255, 0, 51), (0, 102, 255)
    lamp = PBRMaterial(
        name="lamp", baseColorFactor=[0, 0, 0, 255], emissiveFactor=[1.0, 0.5, 2.0],
        emissiveTexture=Image.fromarray(texels),
    )  # fmt: skip
    light = wd.DirectionalLight((0.0, 0.0, -1.0), power=4.0)
    view = wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=2.0, width=32, height=32)
    for options in (POINTS, OPTIONS):
        image = wd.shade(scene(lamp, 0.0), SURFACES, light, view, **options, layers=["uv"])
        uv = image.layers["uv"].astype(float)
        linear = colorimetry.srgb_decode(texels / 255.0)
        expected = bilinear(linear, REPEAT, uv[..., 0], uv[..., 1]) * [1.0, 0.5, 2.0]
        expected = 4.0 * white_luminance() * expected @ colorimetry.RGB_TO_XYZ.T
        inner = np.zeros((32, 32), bool)
        inner[2:-2, 2:-2] = True
        if options is OPTIONS:
            # The texture repeats twice. Only columns of pixels in which the filter of the pixel covers a single colour
            # of the texture are compared.
            inner &= np.isin(np.arange(32), [3, 4, 11, 12, 19, 20, 27, 28])
        np.testing.assert_allclose(image.xyz[inner], expected[inner], rtol=2e-3)


def test_height_fields_with_the_material_of_a_plain_part_stay_without_its_textures():
    texels = np.zeros((4, 4, 3), np.uint8)
    own = mapped(texels, emissiveFactor=[0.0, 0.0, 0.0])
    bare = PBRMaterial(name="bare", baseColorFactor=[255, 204, 102, 255])
    view = wd.View.orthographic((0, -4, 5), (0, -4, 0), extent_y=2.0, width=12, height=12)
    light = wd.DirectionalLight((0.2, 0.1, 1.0))
    surfaces = {"body": None, "grating": wd.gratings.sinusoidal(1.5, 0.1)}
    images = [wd.shade(scene(own, grating=other), surfaces, light, view, **POINTS) for other in (own, bare)]
    assert images[0].mask.all()
    assert images[0].illuminated.any()
    np.testing.assert_array_equal(images[0].xyz, images[1].xyz)


@pytest.mark.parametrize("size", [16, 64, 1024])
def test_pictures_with_a_checker_of_roughness_meet_the_tolerance(size):
    light, body = wd.DirectionalLight((0.1, 0.2, 1.0)), scene(mapped(checker(90, 250, size)), 0.3)
    view = wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=1.8, width=24, height=24)
    image = wd.shade(body, SURFACES, light, view, **OPTIONS)
    truth = wd.shade(body, SURFACES, light, view, **POINTS, samples_per_pixel=2048)
    # The reference is a plain mean over each pixel. The picture has a Gaussian pixel filter. Both pictures are averaged
    # over 4 × 4 pixels before they are compared, which makes the filters nearly equal.
    floor = 1e-3 * np.percentile(truth.xyz[..., 1], 99.0)
    means, exact = (values.xyz.reshape(6, 4, 6, 4, 3).mean(axis=(1, 3))[1:-1, 1:-1] for values in (image, truth))
    error = np.linalg.norm(means - exact, axis=-1) / np.maximum(np.linalg.norm(exact, axis=-1), floor)
    assert error.max() <= 0.1
    assert np.all(image.error[image.illuminated] > 0.0)


LIGHTS = {
    "directional": wd.DirectionalLight((0.1, 0.1, 1.0)),
    "disc": wd.DirectionalLight((0.1, 0.1, 1.0), angular_diameter_deg=20.0),
}


def far_view(pixels):
    return wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=1.8, width=pixels, height=pixels)


def blocks():
    """Return a texture of square blocks of 32 × 32 texels, which have one of two roughnesses and of two metallics."""
    return checker(90, 250, 16).repeat(32, axis=0).repeat(32, axis=1)


@pytest.mark.parametrize("name", LIGHTS)
def test_far_textures_reflect_the_mean_light_of_their_roughnesses(name):
    options = OPTIONS | {"shadows": False, "refine": False}
    plain = [
        PBRMaterial(
            name="plain", baseColorFactor=[255, 204, 102, 255], metallicFactor=0.9 * metallic / 255,
            roughnessFactor=0.8 * roughness / 255,
        )
        for roughness, metallic in ((90, 128), (250, 255))
    ]  # fmt: skip
    far, smooth, rough = (
        wd.shade(scene(own, 0.05), SURFACES, LIGHTS[name], far_view(6), **options).xyz.mean(axis=(0, 1))
        for own in (mapped(blocks()), *plain)
    )
    assert smooth[1] > 1.5 * rough[1]
    np.testing.assert_allclose(far, 0.5 * (smooth + rough), rtol=0.03)


def test_far_textures_reflect_the_mean_light_of_a_sky():
    """The mean colour with few subpixel cells must be that with cells that are smaller than a texel.

    Each of the few cells contains texels of different roughnesses.
    """
    texels, sky = checker(90, 250, 64).repeat(8, axis=0).repeat(8, axis=1), wd.Environment.clear_sky((0.0, 0.05, 1.0))
    options = OPTIONS | {"shadows": False, "refine": False}
    few, many = (
        wd.shade(scene(mapped(texels), 0.05), SURFACES, sky, far_view(8), **options, samples_per_pixel=samples)
        for samples in (4, 4096)
    )
    # If each subpixel cell had a single mean roughness, the error would be 6 %. The tolerance is smaller, so that the
    # test detects this.
    np.testing.assert_allclose(few.xyz.mean(axis=(0, 1)), many.xyz.mean(axis=(0, 1)), rtol=0.045)


def test_a_renderer_draws_the_textures_of_shade():
    body = scene(mapped(checker(90, 250), emissiveFactor=[0.1, 0.0, 0.0]))
    light = wd.DirectionalLight((0.2, 0.1, 1.0))
    drawn = wd.Renderer(body, SURFACES, light, VIEW, **OPTIONS)
    expected = wd.shade(body, SURFACES, light, VIEW, **OPTIONS, plan=drawn.plan)
    drawn.draw(light)
    np.testing.assert_allclose(drawn.image().xyz, expected.xyz, rtol=1e-5, atol=1e-9)


def test_recorded_pictures_have_the_textures(monkeypatch):
    monkeypatch.setattr(renderer, "records", lambda _: True)
    monkeypatch.setattr(device_tiles, "_MOST_RAYS", 1 << 15)
    body = scene(mapped(checker(90, 250), emissiveFactor=[0.1, 0.0, 0.0]))
    light = wd.DirectionalLight((0.2, 0.1, 1.0))
    drawn = wd.Renderer(body, SURFACES, light, VIEW, **OPTIONS, threads=1)
    drawn.draw(light)
    expected = wd.shade(body, SURFACES, light, VIEW, **OPTIONS, plan=drawn.plan).xyz
    change = np.linalg.norm(drawn.image().xyz - expected, axis=-1) / np.linalg.norm(expected, axis=-1).max()
    assert np.percentile(change, 90.0) <= 1e-6
