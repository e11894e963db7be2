"""
Textures at a low angle, and cut-outs
=====================================

A compact disc on a chess board, behind a fence of wire. Pixels show the mean of each texture over their filter, so that
far squares do not alias. The holes of the fence are a cut-out: its texture has an alpha of 0 there.
"""

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial

import warpdiff as wd


def sheet(corners, repeats, material):
    """Return a parallelogram of three corners, on which a texture is repeated."""
    first, right, up = np.array(corners, dtype=float)
    places = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    visual = trimesh.visual.TextureVisuals(uv=places * repeats, material=material)
    vertices = first + places @ [right - first, up - first]
    return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False, visual=visual)


chess = np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((16, 16)))
wire = np.full((32, 32, 4), 255, np.uint8)
wire[4:, 4:, 3] = 0
paint = PBRMaterial(name="paint", baseColorTexture=Image.fromarray((40 + 200 * chess).astype(np.uint8)))
metal = PBRMaterial(name="wire", baseColorTexture=Image.fromarray(wire), alphaMode="MASK", alphaCutoff=0.5)
disc = wd.meshes.disc()
disc.apply_translation((1.0, 1.0, 0.0))
board = sheet([(-6, 0, 4), (6, 0, 4), (-6, 0, -20)], (3, 6), paint)
fence = sheet([(-2.4, 0, 0.5), (-0.2, 0, 0.5), (-2.4, 1.2, 0.5)], (11, 6), metal)
scene = trimesh.Scene({"board": board, "fence": fence, "disc": disc})
track = wd.gratings.disc("CD", tracks=4, length_um=12.5)
light, view = wd.DirectionalLight((0.4, 1.0, 0.9)), wd.View((0.0, 1.2, 5.0), (0.0, 0.6, 0.0), width=320, height=200)
image = wd.shade(scene, {"disc": track, "*": None}, light, view, tolerance=0.1, coherence=wd.Coherence(sigma_um=5.0))
image.save("textures.png", background=(0.02, 0.02, 0.02))
