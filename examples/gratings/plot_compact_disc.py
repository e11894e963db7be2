"""
Compact disc
============

A compact disc with pits in aluminium. The tangent of the disc is radial, across the tracks.
"""

import warpdiff as wd

disc = wd.gratings.disc("CD", tracks=40, length_um=64.0, pitch_um=0.08)
light = wd.DirectionalLight((0.1, 0.3, 1.0), angular_diameter_deg=1.0)
view = wd.View((0.0, -1.9, 2.3), (0.0, -0.05, 0.0), fov_y_deg=36.0, width=480, height=340)
image = wd.shade(wd.meshes.disc(), disc, light, view, material=wd.Material.metal("Al"), tolerance=0.05)
image.save("compact_disc.png", background=(0.02, 0.02, 0.02))
