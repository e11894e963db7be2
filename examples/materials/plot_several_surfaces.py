"""
Several surfaces in one scene
=============================

A compact disc of aluminium and a snake on a plain table. Each part of the scene has a surface of its own, and all
surfaces share one unit of brightness.
"""

import numpy as np
import trimesh

import warpdiff as wd

scene = trimesh.Scene()
disc, snake, table = wd.meshes.disc(), wd.meshes.snake(), trimesh.creation.box((9.0, 0.1, 7.0))
disc.apply_transform(trimesh.transformations.rotation_matrix(-1.2, (1, 0, 0)))
disc.apply_translation((1.4, 0.95, -1.0))
table.apply_translation((0.0, -0.2, 0.0))
# Each face of the table has vertices and a normal of its own, so that the table has sharp edges.
table.unmerge_vertices()
paint = trimesh.visual.material.PBRMaterial(baseColorFactor=[130, 110, 95, 255])
table = trimesh.Trimesh(
    table.vertices, table.faces, vertex_normals=np.repeat(table.face_normals, 3, axis=0), process=False,
    visual=trimesh.visual.TextureVisuals(uv=table.vertices[:, [0, 2]], material=paint),
)  # fmt: skip
for name, body in (("disc", disc), ("snake", snake), ("table", table)):
    scene.add_geometry(body, geom_name=name)
surfaces = {
    "disc": wd.Surface(
        wd.gratings.disc("CD", tracks=40, length_um=25.6), material=wd.Material.metal("Al"), pigment=0.0
    ),
    "snake": wd.Surface(wd.gratings.fingers(size_um=32.0, pitch_um=0.08), pigment=0.5),
    "table": None,
}
lights = [wd.DirectionalLight((0.3, 1.0, 0.8)), wd.DirectionalLight((-0.8, 0.9, 0.5), power=0.4)]
view = wd.View((0.0, 2.4, 5.2), (0.0, 0.35, 0.0), fov_y_deg=32, width=480, height=270)
image = wd.shade(scene, surfaces, lights, view, tolerance=0.1, coherence=wd.Coherence(sigma_um=5.0))
image.save("several_surfaces.png", background=(0.02, 0.02, 0.02))
