"""Surfaces, bodies, cameras, lights and materials of the test cases of ``bench/dev/corpus.py``."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from PIL import Image as Pixels

from bench.dev.public_names import wd

# Sizes of pictures [pixels].
SIZE = {"width": 96, "height": 72}
SMALL = {"width": 24, "height": 18}
MEDIUM = {"width": 48, "height": 36}
# Two directional lights; coherence of a light source with a diameter of 2°; wavelengths [nm].
ABOVE = wd.DirectionalLight((0.1, 0.9, 1.2))
SIDE = wd.DirectionalLight((-1.0, 0.6, 0.9), power=0.5, illuminant="A")
SOURCE = wd.Coherence("source", angular_diameter_deg=2.0)
WAVELENGTHS_NM = np.linspace(400.0, 700.0, 7)


def fingers() -> Any:
    """Return a new height field with finger-like bumps as on a snake's skin. No tables are cached for it."""
    return wd.gratings.fingers(size_um=12.8, pitch_um=0.09, seed=5)


def tube() -> trimesh.Trimesh:
    """Return a tube with few faces."""
    return wd.meshes.tube(segments_along=48, segments_around=24)


def box() -> trimesh.Trimesh:
    """Return a box with a colour texture. Three of its sides are visible from the camera of ``box_view``."""
    rng = np.random.default_rng(7)
    texture = Pixels.fromarray(rng.integers(0, 255, (16, 16, 3), dtype=np.uint8))
    body = trimesh.creation.box((1.0, 1.0, 1.0))
    faces = np.arange(3 * len(body.faces)).reshape(-1, 3)
    corners = body.triangles.reshape(-1, 3)
    uv = corners[:, :2] + 0.3 * corners[:, 2:] + 0.5
    return trimesh.Trimesh(
        corners, faces, process=False, visual=trimesh.visual.TextureVisuals(uv=uv, image=texture)
    )  # fmt: skip


def two_geometries() -> trimesh.Scene:
    """Return a scene of a tube with a single base colour and a textured box.

    The geometries are named "tube" and "box".
    """
    scene = trimesh.Scene()
    body = tube()
    # Without a base colour, trimesh would write a texture for this material.
    body.visual.material = trimesh.visual.material.PBRMaterial(baseColorFactor=(200, 120, 40, 255))
    scene.add_geometry(body, node_name="tube", geom_name="tube")
    at = trimesh.transformations.translation_matrix((0.0, 0.0, 0.9)) @ np.diag([0.5, 0.5, 0.5, 1.0])
    scene.add_geometry(box(), node_name="box", geom_name="box", transform=at)
    return scene


def tube_view(**size: int) -> Any:
    """Return a perspective camera that looks at the tube."""
    return wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, **(size or SIZE))


def box_view(**size: int) -> Any:
    """Return an orthographic camera that looks at the box."""
    return wd.View.orthographic((1.2, 1.0, 1.6), (0.0, 0.0, 0.0), extent_y=2.2, **(size or SIZE))


def radiances(*, with_sun: bool) -> np.ndarray:
    """Return an environment map of a bluish sky above brown ground, shape (32, 64, 3).

    With ``with_sun``, the sky has a sun, one pixel wide.
    """
    rng = np.random.default_rng(11)
    up = np.linspace(1.0, -1.0, 32)[:, None, None]
    sky = np.array([0.3, 0.5, 0.9]) * (1.0 + up) + 0.2 * rng.random((32, 64, 3))
    ground = np.array([0.3, 0.2, 0.1]) * (1.0 + 0.3 * rng.random((32, 64, 1)))
    result = np.where(up > 0.0, sky, ground)
    if with_sun:
        result[7, 40] = 4e3, 3.6e3, 3e3
    return result


def directions(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random light and view directions on the upper hemisphere."""
    rng = np.random.default_rng(count)
    vectors = rng.normal(size=(2, count, 3))
    vectors[..., 2] = np.abs(vectors[..., 2]) + 0.1
    return vectors[0], vectors[1]


def coated_metal() -> Any:
    """Return the material of aluminium with a 300 nm film of glass."""
    return wd.Material.metal("Al").coated(wd.Material.dielectric(1.5), 300.0)


def disc_view(**size: int) -> Any:
    """Return a camera that looks at the mesh of a disc from a position where diffraction orders are visible."""
    return wd.View((0.0, -1.9, 2.3), (0.0, 0.0, 0.0), **(size or SIZE))
