"""
Blazed grating under a ring of lights
=====================================

A blazed grating of 2.5 µm on a disc shows the spectrum of each of nine lights.
"""

import math

import warpdiff as wd

lights = []
for k in range(9):
    turn = 0.2 + 2.0 * math.pi * k / 9.0
    to_light = (0.62 * math.cos(turn), 0.62 * math.sin(turn), 0.78)
    lights.append(wd.DirectionalLight(to_light, angular_diameter_deg=1.4, power=1.0 / 9.0))
view = wd.View((0.0, -1.9, 2.3), (0.0, -0.05, 0.0), fov_y_deg=36.0, width=480, height=340)
grating, aluminium = wd.gratings.blazed(2.5, 0.25), wd.Material.metal("Al")
image = wd.shade(wd.meshes.disc(), grating, lights, view, material=aluminium, tolerance=0.1)
image.save("blazed_disc.png", background=(0.02, 0.02, 0.02))
