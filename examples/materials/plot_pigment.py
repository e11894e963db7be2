"""
Pigment below the relief
========================

A snake with pigments of three strengths below the relief. A strong pigment hides the iridescent colours.
"""

import warpdiff as wd

body, skin = wd.meshes.snake(), wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
view = wd.View((-1.6, 2.2, 2.6), (-0.56, 0.06, 0.07), fov_y_deg=6.0, width=300, height=200)
for pigment in (0.0, 0.1, 1.0):
    image = wd.shade(body, skin, wd.DirectionalLight((0.6, 1.0, -0.1)), view, tolerance=0.1, pigment=pigment)
    image.save(f"pigment_{pigment:g}.png", background=(0.02, 0.02, 0.02))
