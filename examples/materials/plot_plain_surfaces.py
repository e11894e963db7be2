"""
Metals and glossy surfaces next to a grating
============================================

A compact disc, two metal balls and a glowing ball on a glossy table. All parts except the disc are plain.
"""

import numpy as np
import trimesh

import warpdiff as wd


def part(body, place, **values):
    """Return a moved body with a material. A body of few faces, such as a box, gets sharp edges."""
    body.apply_translation(place)
    material, normals = trimesh.visual.material.PBRMaterial(**values), body.vertex_normals
    if len(body.faces) < 100:
        body.unmerge_vertices()
        normals = np.repeat(body.face_normals, 3, axis=0)
    visual = trimesh.visual.TextureVisuals(uv=body.vertices[:, [0, 2]], material=material)
    return trimesh.Trimesh(body.vertices, body.faces, vertex_normals=normals, visual=visual, process=False)


disc, table, ball = wd.meshes.disc(), trimesh.creation.box((9.0, 0.1, 6.0)), trimesh.creation.icosphere
disc.apply_transform(trimesh.transformations.rotation_matrix(-1.15, (1, 0, 0)))
disc.apply_translation((0.0, 0.95, -0.7))
wood = {"baseColorFactor": [70, 25, 12, 255], "metallicFactor": 0.0, "roughnessFactor": 0.25}
gold = {"baseColorFactor": [255, 196, 86, 255], "metallicFactor": 1.0, "roughnessFactor": 0.3}
steel = {"baseColorFactor": [150, 145, 135, 255], "metallicFactor": 1.0, "roughnessFactor": 0.5}
glow = {"baseColorFactor": [0, 0, 0, 255], "emissiveFactor": [1.0, 0.5, 0.15]}
scene = trimesh.Scene({
    "disc": disc, "table": part(table, (0, -0.05, 0), **wood), "gold": part(ball(5, 0.6), (-1.5, 0.6, 0.2), **gold),
    "steel": part(ball(5, 0.45), (1.35, 0.45, 0.5), **steel), "glow": part(ball(5, 0.2), (0.5, 0.2, 1.2), **glow),
})  # fmt: skip
track = wd.Surface(wd.gratings.disc("CD", tracks=40, length_um=25.6), material=wd.Material.metal("Al"), pigment=0.0)
lights = [wd.DirectionalLight((-0.5, 0.8, -0.7), angular_diameter_deg=8), wd.DirectionalLight((0.5, 1, 0.8), power=0.6)]
view = wd.View((0.0, 2.0, 5.2), (0.0, 0.45, 0.0), fov_y_deg=30, width=480, height=270)
image = wd.shade(scene, {"disc": track, "*": None}, lights, view, tolerance=0.1, coherence=wd.Coherence(sigma_um=5.0))
image.save("plain_surfaces.png", background=(0.02, 0.02, 0.02))
