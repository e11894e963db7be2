"""Images of textures: conversion of every mode of Pillow to linear RGBA, and errors for images that cannot be used."""

import io

import numpy as np
import pytest
from PIL import Image

from warpdiff.core.wording import WarpdiffWarning
from warpdiff.scene.mesh_images import linear_rgba, opened


def decode(value):
    value = np.asarray(value, dtype=np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def palette():
    image = Image.new("P", (2, 1))
    image.putpalette([255, 0, 0, 51, 102, 255])
    image.putdata([0, 1])
    return image


def transparent_palette():
    image = palette()
    image.info["transparency"] = bytes([0, 102])
    return image


def of(values, dtype=np.uint8, mode=None):
    return Image.fromarray(np.array(values, dtype), mode) if mode else Image.fromarray(np.array(values, dtype))


def with_key(image, value):
    image.info["transparency"] = value
    return image


# For each image mode of Pillow: an image of two pixels, and the expected sRGB-encoded RGBA of both pixels.
MODES = {
    "1": (of([[0, 255]]).convert("1"), [[0, 0, 0, 1], [1, 1, 1, 1]]),
    "L": (of([[51, 255]]), [[0.2] * 3 + [1], [1] * 4]),
    "L with a key": (with_key(of([[51, 255]]), 51), [[0.2] * 3 + [0], [1] * 4]),
    "LA": (of([[[51, 102], [255, 0]]]), [[0.2] * 3 + [0.4], [1, 1, 1, 0]]),
    "La": (of([[[51, 255], [0, 0]]]).convert("La"), [[0.2] * 3 + [1], [0] * 4]),
    "P": (palette(), [[1, 0, 0, 1], [0.2, 0.4, 1, 1]]),
    "P with alpha": (transparent_palette(), [[1, 0, 0, 0], [0.2, 0.4, 1, 0.4]]),
    "RGB": (of([[[51, 102, 255], [0, 0, 0]]]), [[0.2, 0.4, 1, 1], [0, 0, 0, 1]]),
    "RGBA": (of([[[51, 102, 255, 102], [0, 0, 0, 0]]]), [[0.2, 0.4, 1, 0.4], [0] * 4]),
    "RGBa": (of([[[51, 102, 255, 255], [0, 0, 0, 0]]]).convert("RGBa"), [[0.2, 0.4, 1, 1], [0] * 4]),
    "CMYK": (of([[[51, 102, 255], [0, 0, 0]]]).convert("CMYK"), [[0.2, 0.4, 1, 1], [0, 0, 0, 1]]),
    "I;16": (of([[13107, 65535]], np.uint16), [[0.2] * 3 + [1], [1] * 4]),
    "I;16 with a key": (with_key(of([[13107, 65535]], np.uint16), 65535), [[0.2] * 3 + [1], [1, 1, 1, 0]]),
    "I;16B": (of([[13107, 65535]], ">u2"), [[0.2] * 3 + [1], [1] * 4]),
    "I": (of([[13107, 65535]], np.int32), [[0.2] * 3 + [1], [1] * 4]),
}


@pytest.mark.parametrize("name", MODES)
def test_every_mode_is_read(name):
    image, encoded = MODES[name]
    expected = np.array([encoded], dtype=np.float64)
    assert image.mode == name.split()[0]
    np.testing.assert_allclose(linear_rgba(image, is_data=True), expected, atol=1e-6)
    expected[..., :3] = decode(expected[..., :3])
    np.testing.assert_allclose(linear_rgba(image), expected, atol=1e-6)


@pytest.mark.parametrize("is_data", [False, True])
def test_float_images_are_linear(is_data):
    stream = io.BytesIO()
    of([[0.25, 3.0], [0.0, 1.0]], np.float32).save(stream, "tiff")
    image = opened(stream.getvalue())
    assert image.mode == "F"
    rgba = linear_rgba(image, is_data=is_data)
    np.testing.assert_array_equal(rgba[..., 1], [[0.25, 3.0], [0.0, 1.0]])
    np.testing.assert_array_equal(rgba[..., 3], 1.0)


@pytest.mark.parametrize(
    ("image", "reason"),
    [
        (of([[0.5, np.nan]], np.float32), "its numbers must be finite and at least 0"),
        (of([[0.5, np.inf]], np.float32), "its numbers must be finite and at least 0"),
        (of([[0.5, -1.0]], np.float32), "its numbers must be finite and at least 0"),
        (of([[0, 1 << 20]], np.int32), "its numbers must be from 0 to 65535, got 0 to 1.04858e[+]06"),
    ],
)
def test_images_that_cannot_be_used_are_named(image, reason):
    with pytest.warns(WarpdiffWarning, match=rf"texture 'an image' is damaged and ignored: {reason}"):
        assert linear_rgba(image) is None
