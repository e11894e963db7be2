"""Base colours of textured hits: look-ups at points and over footprints, compared with sums over many points."""

import dataclasses

import numpy as np
import pytest
import trimesh
import warp as wp
from PIL import Image
from texture_specification import bilinear
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial

import warpdiff as wd
from warpdiff.scene.camera_rays import rays_for
from warpdiff.scene.mesh_import import prepare_surface
from warpdiff.scene.scene_parts import Appearance, TextureMap
from warpdiff.scene.trimesh_parts import parts_of


def textured(texels, scale, wrap, monkeypatch):
    """Return the prepared surface of a square with a texture; its coordinates range from −``scale`` to ``scale``."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    visual = TextureVisuals(uv=corners[:, :2] * scale, material=SimpleMaterial(image=Image.fromarray(texels)))
    (part,) = parts_of(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False))
    appearance = Appearance("paint", (1.0,) * 4, TextureMap(part.appearance.base_texture.image, wrap=wrap))
    entry = dataclasses.replace(part, appearance=appearance)
    monkeypatch.setattr("warpdiff.scene.mesh_import.labelled_parts", lambda _: [(entry, "mesh")])
    return prepare_surface(trimesh.Trimesh())


def colours_of(surface, view, deviation):
    """Return base colours and texture coordinates at the hits of the rays through pixel centres."""
    rays = rays_for(surface, view, device=wp.get_device("cpu"), threads=1)
    rays.launch(rays.trace(0, 1, deviation))
    pixels = rays.gbuffer.pixels
    assert (pixels.hit.numpy() == 1).all()
    place = pixels.place.numpy().astype(np.float64)
    corners = surface.uvs[surface.faces[pixels.face.numpy()]].astype(np.float64)
    shares = np.column_stack([place, 1.0 - place.sum(axis=1)])
    return pixels.base_colour.numpy(), np.einsum("nk,nkc->nc", shares, corners)


WRAPS = [("repeat", "repeat"), ("clamp", "mirror"), ("mirror", "clamp"), ("clamp", "repeat")]


@pytest.mark.parametrize("wrap", WRAPS, ids=str)
def test_points_are_interpolated_between_texels(wrap, rng, monkeypatch):
    surface = textured(rng.integers(0, 256, (5, 7, 3), dtype=np.uint8), 2.3, wrap, monkeypatch)
    view = wd.View.orthographic((0.0, 0.0, 3.0), (0, 0, 0), extent_y=1.9, width=40, height=40)
    colours, uv = colours_of(surface, view, 0.0)
    texels = surface.textures[0].texels[..., :3].astype(np.float64)
    np.testing.assert_allclose(colours, bilinear(texels, wrap, uv[:, 0], uv[:, 1]), atol=2e-5)


@pytest.mark.parametrize("size", [(1, 1), (1, 6), (3, 1), (5, 7)], ids=str)
@pytest.mark.parametrize("shift", [-1.0, -1000.25, 4096.5])
def test_odd_images_are_continued_at_negative_and_large_coordinates(size, shift, rng, monkeypatch):
    view = wd.View.orthographic((0.0, 0.0, 3.0), (0, 0, 0), extent_y=1.9, width=20, height=20)
    for wrap in WRAPS:
        surface = textured(rng.integers(0, 256, (*size, 3), dtype=np.uint8), 1.3, wrap, monkeypatch)
        surface = dataclasses.replace(surface, uvs=surface.uvs + np.float32(shift))
        texels = surface.textures[0].texels[..., :3].astype(np.float64)
        for deviation in (0.0, 1e-3):
            colours, uv = colours_of(surface, view, deviation)
            exact = bilinear(texels, wrap, uv[:, 0], uv[:, 1])
            # The allowed error includes rounding: texture coordinates of about 4096 are rounded to 2⁻¹² in float32.
            np.testing.assert_allclose(colours, exact, atol=2e-5 + 4e-6 * abs(shift))


@pytest.mark.parametrize("scale", [1e12, 3e14])
def test_huge_footprints_have_the_mean_of_the_image(scale, rng, monkeypatch):
    surface = textured(rng.integers(0, 256, (64, 4096, 3), dtype=np.uint8), scale, ("repeat", "repeat"), monkeypatch)
    view = wd.View.orthographic((0.0, 0.0, 3.0), (0, 0, 0), extent_y=1.9, width=20, height=20)
    colours, _ = colours_of(surface, view, 0.5)
    mean = surface.textures[0].texels[..., :3].mean(axis=(0, 1), dtype=np.float64)
    np.testing.assert_allclose(colours, np.tile(mean, (400, 1)), rtol=1e-4)


@pytest.mark.parametrize("wrap", [("repeat", "repeat"), ("mirror", "repeat")], ids=str)
@pytest.mark.parametrize(("scale", "eye"), [(0.4, (0, 0, 3.0)), (2.0, (0, 0, 3.0)), (3.0, (0.5, -2.0, 1.2))], ids=str)
def test_filtered_colours_are_means_over_the_pixel_filter(wrap, scale, eye, rng, monkeypatch):
    """Filtered base colours must equal means of the texture over the pixel filter.

    The means are computed from 81 × 81 points of the filter. Clamped textures are not tested: outside of the image, a
    coarse mip level has the colours of its own edge texels, which are wider than the texels of the image.
    """
    surface = textured(rng.integers(0, 256, (64, 48, 3), dtype=np.uint8), scale, wrap, monkeypatch)
    view = wd.View.orthographic(eye, (0, 0, 0), extent_y=0.3, width=16, height=16)
    deviation = 0.5
    colours, uv = colours_of(surface, view, deviation)
    # Texture coordinates are an affine function of the position in the picture.
    right, down = (uv[1] - uv[0]) * deviation, (uv[16] - uv[0]) * deviation
    steps = np.linspace(-3.5, 3.5, 81)
    x, y = np.meshgrid(steps, steps)
    weights = np.exp(-0.5 * (x * x + y * y))[..., None]
    texels = surface.textures[0].texels[..., :3].astype(np.float64)
    exact = np.array(
        [
            np.sum(weights * bilinear(texels, wrap, *(at[c] + x * right[c] + y * down[c] for c in (0, 1))), axis=(0, 1))
            for at in uv
        ]
    ) / np.sum(weights)
    size = np.linalg.norm(exact, axis=1)
    error = np.linalg.norm(colours - exact, axis=1) / size
    points = np.linalg.norm(colours_of(surface, view, 0.0)[0] - exact, axis=1) / size
    # The allowed error is large because the texture is white noise: the values of neighbouring texels differ by up to
    # their whole range.
    assert np.sqrt(np.mean(error**2)) < 0.15
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(np.mean(points**2))
