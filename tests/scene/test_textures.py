"""Textures of scenes: pyramids of reduced images, continuation outside of the image, and memory."""

import itertools

import numpy as np
import pytest
import trimesh
from PIL import Image
from texture_specification import bilinear
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from warpdiff.core import memory
from warpdiff.scene.mesh_import import prepare_surface
from warpdiff.scene.scene_parts import TextureMap
from warpdiff.scene.texture_pyramid import mean_products, pyramid, sizes
from warpdiff.scene.texture_table import table_of
from warpdiff.scene.textures import TextureImages


def by_overlaps(lines, size):
    """Return weighted means of texels over ``size`` equal intervals of axis 0.

    The weight of a texel is its overlap with the interval.
    """
    edges, whole = np.linspace(0.0, len(lines), size + 1), np.arange(len(lines))
    overlaps = np.minimum(edges[1:, None], whole + 1.0) - np.maximum(edges[:-1, None], whole)
    weights = np.clip(overlaps, 0.0, None) * size / len(lines)
    return np.tensordot(weights, lines, (1, 0))


@pytest.mark.parametrize("shape", [(1, 1), (8, 8), (7, 5), (1, 13), (33, 2), (100, 57)], ids=str)
def test_texels_of_a_level_are_means_over_their_areas(shape, rng):
    texels = rng.uniform(size=(*shape, 4)).astype(np.float32)
    levels = pyramid(texels)
    assert [level.shape[:2] for level in levels] == sizes(*shape)
    assert levels[-1].shape == (1, 1, 4)
    for before, after in itertools.pairwise(levels):
        rows = by_overlaps(before.astype(np.float64), after.shape[0])
        expected = by_overlaps(rows.swapaxes(0, 1), after.shape[1]).swapaxes(0, 1)
        np.testing.assert_allclose(after, expected, rtol=1e-5)
    np.testing.assert_allclose(levels[-1][0, 0], texels.mean(axis=(0, 1), dtype=np.float64), rtol=1e-5)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (6, 4)], ids=str)
def test_products_are_means_over_texels_of_interpolated_images(shape, rng):
    """``mean_products`` must return the means over texels of the product of two interpolated images.

    The expected value for a texel is the mean of the product at 40 × 40 points of the texel.
    """
    one, two = rng.uniform(size=(2, *shape)).astype(np.float32)
    points = 40
    height, width = shape
    u, v = np.meshgrid(
        (np.arange(width * points) + 0.5) / points / width, 1.0 - (np.arange(height * points) + 0.5) / points / height
    )
    values = [bilinear(values[..., None].astype(float), ("repeat", "repeat"), u, v)[..., 0] for values in (one, two)]
    expected = (values[0] * values[1]).reshape(height, points, width, points).mean(axis=(1, 3))
    np.testing.assert_allclose(mean_products(one, two), expected, rtol=1e-3)


def image_of(rng, size=(4, 6), mode="RGBA"):
    return Image.fromarray(rng.integers(0, 256, (*size, len(mode)), dtype=np.uint8), mode)


def test_equal_images_have_one_copy_on_the_device(rng):
    images, picture = TextureImages(), image_of(rng)
    one = images.texture(TextureMap(picture), (1.0, 0.5, 1.0, 1.0))
    same = images.texture(TextureMap(picture.copy()), (1.0, 0.5, 1.0, 1.0))
    clamped = images.texture(TextureMap(picture, wrap=("clamp", "mirror")), (1.0, 0.5, 1.0, 1.0))
    other = images.texture(TextureMap(picture), (1.0,) * 4)
    assert same is one
    assert clamped is not one
    assert clamped.texels is one.texels
    table = table_of([one, None, clamped, other, same], np.zeros(1, np.int32), "cpu")
    np.testing.assert_array_equal(table.of_base_colour.numpy(), [0, -1, 1, 2, 0])
    np.testing.assert_array_equal(table.table.numpy(), [[0, 4, 0, 0], [0, 4, 1, 2], [4, 4, 0, 0]])
    count = sum(height * width for height, width in sizes(4, 6))
    assert len(table.texels) == 2 * count
    np.testing.assert_array_equal(table.texels.numpy()[: 4 * 6], one.texels.reshape(-1, 4))


def test_alpha_is_read_from_images_with_and_without_it(rng):
    images = TextureImages()
    for mode, alpha in [("RGBA", None), ("RGB", 1.0)]:
        picture = image_of(rng, mode=mode)
        texels = images.texture(TextureMap(picture), (1.0,) * 4).texels
        expected = np.asarray(picture)[..., 3] / 255.0 if alpha is None else alpha
        np.testing.assert_allclose(texels[..., 3], np.broadcast_to(expected, (4, 6)), atol=1e-6)


def test_a_texture_that_does_not_fit_into_memory_is_named(monkeypatch, rng):
    monkeypatch.setattr(memory, "available", lambda: 1e3)
    material = PBRMaterial(baseColorTexture=image_of(rng, mode="RGB"))
    square = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], visual=TextureVisuals(uv=np.eye(3, 2), material=material)
    )
    with pytest.raises(MemoryError, match="the texture 'an image' of mesh, 6 × 4 pixels, requires about"):
        prepare_surface(square)


def test_a_product_with_a_colour_and_the_reductions_must_fit_into_memory(monkeypatch, rng):
    images, source = TextureImages(), TextureMap(image_of(rng, (256, 256)))
    first = images.texture(source, (1.0,) * 4)
    free = 65536 * 68.0
    monkeypatch.setattr(memory, "available", lambda: free)
    with pytest.raises(MemoryError, match="the texture 'an image' of mesh times a colour, 256 × 256 pixels, requires"):
        images.texture(source, (0.5, 1.0, 1.0, 1.0))
    table_of([first], np.zeros(1, np.int32), "cpu")
    # An image with its reductions has 16 · 4/3 bytes per texel of the image. Another 13.3 bytes per texel are required
    # while the reductions are made. The free memory is slightly less than both together.
    free = 65536 * 33.0
    with pytest.raises(MemoryError, match="the textures of mesh, 87381 texels with their reductions"):
        table_of([first], np.zeros(1, np.int32), "cpu")
