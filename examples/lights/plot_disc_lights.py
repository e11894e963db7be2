"""
Size of a light
===============

Disc lights of 0.5°, 3° and 10° in diameter. A wider light gives paler spectra.
"""

import warpdiff as wd

disc, aluminium = wd.gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08), wd.Material.metal("Al")
view = wd.View((0.0, -1.9, 2.3), (0.0, -0.05, 0.0), fov_y_deg=36.0, width=300, height=210)
for diameter_deg in (0.5, 3.0, 10.0):
    light = wd.DirectionalLight((0.1, 0.3, 1.0), angular_diameter_deg=diameter_deg)
    image = wd.shade(wd.meshes.disc(), disc, light, view, material=aluminium, tolerance=0.1)
    image.save(f"disc_light_{diameter_deg:g}.png", background=(0.02, 0.02, 0.02))
