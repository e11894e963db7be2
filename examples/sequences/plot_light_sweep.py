"""
Moving light
============

Three frames of a disc under a moving light. The body and the camera are at rest.
"""

import warpdiff as wd

disc, aluminium = wd.gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08), wd.Material.metal("Al")
light = wd.DirectionalLight((0.6, 0.3, 1.0))
view = wd.View((0.0, -1.9, 2.3), (0.0, -0.05, 0.0), fov_y_deg=36.0, width=300, height=210)
renderer = wd.Renderer(wd.meshes.disc(), disc, light, view, material=aluminium, tolerance=0.1)
for k, shot in enumerate(wd.light_sweep(light, view, (-0.6, 0.3, 1.0), count=3)):
    renderer.draw(shot.lights)
    renderer.image().save(f"light_sweep_{k}.png", background=(0.02, 0.02, 0.02))
