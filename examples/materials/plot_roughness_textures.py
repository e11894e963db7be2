"""
Textures of roughness and emission
==================================

A brass ball with a texture of roughness (green) and metallic (blue), and a ball with a texture of emission.
"""

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial

import warpdiff as wd


def ball(place, radius, **values):
    """Return a ball with longitude and latitude as texture coordinates, with tiny holes at the poles."""
    u, v = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1, 129), np.linspace(0.001, 0.999, 65)))
    normals = np.column_stack([np.sin(2 * np.pi * u), -1 / np.tan(np.pi * v), np.cos(2 * np.pi * u)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    first = (129 * np.arange(64)[:, None] + np.arange(128)).ravel()
    faces = np.concatenate([first[:, None] + [0, 1, 130], first[:, None] + [0, 130, 129]])
    visual = trimesh.visual.TextureVisuals(uv=np.column_stack([u, v]), material=PBRMaterial(**values))
    return trimesh.Trimesh(radius * normals + place, faces, vertex_normals=normals, visual=visual, process=False)


squares = np.kron(np.indices((10, 20)).sum(axis=0) % 2, np.ones((16, 16)))
gloss = Image.fromarray(np.stack([0 * squares, 70 + 120 * squares, 255 + 0 * squares], axis=-1).astype(np.uint8))
stripes = Image.fromarray((255 * (np.arange(64) // 8 % 2)[:, None] * np.ones((1, 4))).astype(np.uint8))
brass = {"baseColorFactor": [255, 190, 90, 255], "metallicFactor": 1.0, "metallicRoughnessTexture": gloss}
glow = {"baseColorFactor": [20, 20, 20, 255], "emissiveFactor": [1.0, 0.45, 0.1], "emissiveTexture": stripes}
disc = wd.meshes.disc()
disc.apply_translation((0.0, 0.9, -0.9))
bodies = {"brass": ball((-0.9, 0.3, 0.6), 0.6, **brass), "glow": ball((1.0, 0.0, 0.6), 0.3, **glow)}
track = wd.Surface(wd.gratings.disc("CD", tracks=4, length_um=12.5), material=wd.Material.metal("Al"), pigment=0.0)
lights = [wd.DirectionalLight((-0.2, 0.7, 1.0), angular_diameter_deg=8), wd.DirectionalLight((0.9, 0.6, 0.5))]
view = wd.View((0.0, 1.2, 5.2), (0.0, 0.5, 0.0), fov_y_deg=30, width=360, height=220)
scene, unit = trimesh.Scene(bodies | {"disc": disc}), wd.Coherence(sigma_um=5.0)
image = wd.shade(scene, {"disc": track, "*": None}, lights, view, tolerance=0.1, coherence=unit)
image.save("roughness_textures.png", background=(0.02, 0.02, 0.02))
