"""Textures of plain surfaces at hits: look-ups at points and over footprints, compared with sums over many points."""

import dataclasses

import numpy as np
import pytest
import trimesh
import warp as wp
from PIL import Image
from texture_specification import bilinear

import warpdiff as wd
from warpdiff.scene.camera_rays import rays_for
from warpdiff.scene.mesh_import import prepare_surface
from warpdiff.scene.scene_parts import Appearance, ScenePart, TextureMap

CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
# Transforms of the texture coordinates of the two textures. They differ from each other and from the transform of the
# base colour.
OF_ROUGHNESS = np.array([[0.8, -0.6, 0.3], [0.6, 0.8, -0.2]])
OF_EMISSION = np.array([[1.5, 0.0, 0.0], [0.0, -1.0, 0.7]])


def surface_of(roughness, emission, scale, wraps, monkeypatch):
    """Return the prepared surface of two squares, one with textures of roughness and emission, one without textures.

    Before their transforms, the coordinates of the textures range from −``scale`` to ``scale``.
    """
    maps = [
        TextureMap(Image.fromarray(texels), 1, transform, wrap)
        for texels, transform, wrap in zip((roughness, emission), (OF_ROUGHNESS, OF_EMISSION), wraps, strict=True)
    ]
    glossy = Appearance(
        "glossy", (1.0,) * 4, roughness=0.5, emission=(1.0, 2.0, 3.0), metallic_roughness_texture=maps[0],
        emission_texture=maps[1],
    )  # fmt: skip
    faces, uv = np.array([[0, 1, 2], [0, 2, 3]]), CORNERS[:, :2] * scale
    parts = [
        ScenePart("a", glossy, CORNERS, faces, np.arange(4), 4, uvs={0: CORNERS[:, :2], 1: uv}),
        ScenePart("b", None, CORNERS + np.array([2.0, 0.0, 0.0]), faces, np.arange(4), 4, uvs={0: CORNERS[:, :2]}),
    ]
    monkeypatch.setattr(
        "warpdiff.scene.mesh_import.labelled_parts", lambda _: [(part, part.geometry) for part in parts]
    )
    return prepare_surface(trimesh.Trimesh(), plain={"*": True})


def values_of(surface, view, deviation):
    """Return values at the hits of all rays: metallic and roughness, emission, index of the square, coordinates."""
    rays = rays_for(surface, view, device=wp.get_device("cpu"), threads=1)
    rays.launch(rays.trace(0, 1, deviation))
    pixels = rays.gbuffer.pixels
    assert (pixels.hit.numpy() == 1).all()
    place, face = pixels.place.numpy().astype(np.float64), pixels.face.numpy()
    shares = np.column_stack([place, 1.0 - place.sum(axis=1)])
    uvs = [
        np.einsum("nk,nkc->nc", shares, values[surface.faces[face]].astype(np.float64))
        for values in (surface.maps.metallic_roughness_uvs, surface.maps.emission_uvs)
    ]
    return pixels.metallic_roughness.numpy(), pixels.emission.numpy(), surface.geometries[face], uvs


def decode(texels):
    value = texels / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


WRAPS = [
    (("repeat", "repeat"), ("clamp", "mirror")), (("mirror", "clamp"), ("repeat", "repeat")),
    (("clamp", "repeat"), ("mirror", "mirror")),
]  # fmt: skip


@pytest.mark.parametrize("wraps", WRAPS, ids=str)
def test_points_are_interpolated_between_texels_of_both_textures(wraps, rng, monkeypatch):
    roughness, emission = (rng.integers(0, 256, size, dtype=np.uint8) for size in ((5, 7, 3), (4, 3, 3)))
    surface = surface_of(roughness, emission, 2.3, wraps, monkeypatch)
    view = wd.View.orthographic((1.0, 0.0, 3.0), (1.0, 0, 0), extent_y=1.9, width=60, height=40)
    gloss, emitted, part, uvs = values_of(surface, view, 0.0)
    np.testing.assert_array_equal(gloss[part == 1], [[1.0, 1.0, 0.0, 0.0]] * np.sum(part == 1))
    np.testing.assert_array_equal(emitted[part == 1], 1.0)
    inside = part == 0
    assert 500 < inside.sum() < 2000
    expected = bilinear(roughness / 255.0, wraps[0], *uvs[0][inside].T)
    np.testing.assert_allclose(gloss[inside, :2], expected[:, [2, 1]], atol=2e-5)
    np.testing.assert_array_equal(gloss[inside, 2:], 0.0)
    expected = bilinear(decode(emission), wraps[1], *uvs[1][inside].T)
    np.testing.assert_allclose(emitted[inside], expected, atol=2e-5)
    # The texture coordinates at the corners are computed by the formula of the texture transform.
    world = (surface.vertices * surface.radius + surface.centre)[:4, :2] * 2.3
    np.testing.assert_allclose(
        surface.maps.metallic_roughness_uvs[:4], world @ OF_ROUGHNESS[:, :2].T + OF_ROUGHNESS[:, 2], atol=1e-5
    )


@pytest.mark.parametrize(("scale", "eye"), [(0.4, (0, 0, 3.0)), (3.0, (0.3, -2.0, 1.2))], ids=str)
def test_filtered_values_are_means_over_the_pixel_filter(scale, eye, rng, monkeypatch):
    """Filtered values must equal means of the textures over the pixel filter, which are sums over 61 × 61 points on the
    same plane.
    """
    repeat = ("repeat", "repeat")
    roughness, emission = (rng.integers(0, 256, size, dtype=np.uint8) for size in ((64, 48, 3), (40, 40, 3)))
    surface = surface_of(roughness, emission, scale, (repeat, repeat), monkeypatch)
    view = wd.View.orthographic(eye, (0, 0, 0), extent_y=0.3, width=12, height=12)
    deviation = 0.5
    gloss, emitted, _, uvs = values_of(surface, view, deviation)
    points = values_of(surface, view, 0.0)
    x, y = np.meshgrid(*2 * [np.linspace(-3.5, 3.5, 61)])
    weights = np.exp(-0.5 * (x * x + y * y))[..., None]
    for uv, texels, value, point in (
        (uvs[0], roughness[..., [2, 1]] / 255.0, gloss[:, :2], points[0][:, :2]),
        (uvs[1], decode(emission), emitted, points[1]),
    ):  # fmt: skip
        right, down = (uv[1] - uv[0]) * deviation, (uv[12] - uv[0]) * deviation
        exact = np.array(
            [
                np.sum(
                    weights * bilinear(texels, repeat, *(at[c] + x * right[c] + y * down[c] for c in (0, 1))), (0, 1)
                )
                for at in uv
            ]
        ) / np.sum(weights)
        size = np.linalg.norm(exact, axis=1)
        error = np.sqrt(np.mean((np.linalg.norm(value - exact, axis=1) / size) ** 2))
        assert error < 0.15
        assert error < 0.5 * np.sqrt(np.mean((np.linalg.norm(point - exact, axis=1) / size) ** 2))


def test_textures_at_the_coordinates_of_the_base_colour_share_them(rng, monkeypatch):
    texels = rng.integers(0, 256, (4, 4, 3), dtype=np.uint8)
    source = TextureMap(Image.fromarray(texels))
    material = Appearance("a", (1.0,) * 4, roughness=0.5, metallic_roughness_texture=source)
    part = ScenePart("a", material, CORNERS, np.array([[0, 1, 2], [0, 2, 3]]), np.arange(4), 4, uvs={0: CORNERS[:, :2]})
    monkeypatch.setattr("warpdiff.scene.mesh_import.labelled_parts", lambda _: [(part, "mesh")])
    surface = prepare_surface(trimesh.Trimesh(), plain={"*": True})
    assert surface.maps.metallic_roughness_uvs is None
    # A surface with a height field does not show textures of metallic, roughness and emission, so that they are not
    # decoded.
    monkeypatch.setattr("warpdiff.scene.mesh_import.labelled_parts", lambda _: [(dataclasses.replace(part), "mesh")])
    assert not prepare_surface(trimesh.Trimesh(), plain={"*": False}).has_maps
