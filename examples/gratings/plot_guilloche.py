"""
Guilloche of a diffractive foil
===============================

Fine lines whose gratings turn with the line, on one card. A ring of lights at different heights shows each direction of
a grating in a colour of its own. Dots of depth 0 are a mirror between the lines.
"""

import numpy as np

import warpdiff as wd

rows, columns = 288, 384
y, x = np.meshgrid(np.linspace(0.75, -0.75, rows), np.linspace(-1.0, 1.0, columns), indexing="ij")
radius, angle = np.hypot(x, y), np.arctan2(y, x)
# Two rosettes of waves around the middle, as engravers of banknotes draw them.
waves = [np.sin(40.0 * (radius + 0.09 * sign * np.cos(8.0 * angle))) for sign in (-1.0, 1.0)]
lines = [(np.abs(wave) < 0.3) & (radius < 0.68) for wave in waves]
foil = wd.GratingMap(
    wd.gratings.sinusoidal(1.1, 0.2),
    turn_deg=2.0 * np.degrees(angle) + np.where(lines[0], 0.0, 90.0),
    depth_scale=np.where(lines[0] | lines[1], 1.0, 0.0),
)
around = np.radians(np.arange(0.0, 180.0, 15.0))
lights = [wd.DirectionalLight((np.sin(turn), np.cos(turn), 1.9 + 0.4 * np.sin(3.0 * turn))) for turn in around]
view = wd.View((0.0, 0.0, 12.0), (0.0, 0.0, 0.0), fov_y_deg=7.6, width=480, height=360)
# Many dots are smaller than a pixel. A fixed number of rays per pixel shows them faster than refinement.
options = {"coherence": wd.Coherence(sigma_um=2.5), "refine": False, "samples_per_pixel": 16, "tolerance": 0.1}
image = wd.shade(wd.meshes.card(2.0, 1.5), foil, lights, view, **options)
image.save("guilloche.png", background=(0.02, 0.02, 0.02))
