"""
Hidden pictures of a dot-matrix foil
====================================

Each dot of this card is a copy of one sine grating, turned and scaled so that its green light arrives at one of two
eyes. One eye sees a star, the other a row of stripes. The third picture is the view from a place between the eyes.
"""

import numpy as np
from PIL import Image

import warpdiff as wd

rows, columns = 48, 64
y, x = np.meshgrid(np.linspace(0.75, -0.75, rows), np.linspace(-1.0, 1.0, columns), indexing="ij")
star = np.where(np.hypot(x, y) < 0.45 + 0.2 * np.cos(5.0 * np.arctan2(x, y)), 1.0, 0.1)
stripes = np.where(np.floor(4.0 * x) % 2.0 == 0.0, 0.8, 0.1)


def position(azimuth_deg, angle_deg, distance=400.0):
    """Return a position by its angle from the card's normal, and the azimuth from the card's upper side."""
    azimuth, angle = np.radians([azimuth_deg, angle_deg])
    across = distance * np.sin(angle)
    return across * np.sin(azimuth), across * np.cos(azimuth), distance * np.cos(angle)


eyes = [position(0.0, 8.0), position(100.0, 25.0)]
to_light = position(0.0, 35.0)
cell = wd.gratings.sinusoidal(1.3, 0.2)
foil = wd.hidden_pictures(star, stripes, eyes, to_light, cell=cell, width=60.0)
card, light = wd.meshes.card(60.0, 45.0), wd.DirectionalLight(to_light)
pictures = []
for eye in (*eyes, np.mean(eyes, axis=0)):
    view = wd.View(eye, (0.0, 0.0, 0.0), fov_y_deg=8.0, width=240, height=180)
    image = wd.shade(card, foil, light, view, tolerance=0.1, material=wd.Material.metal("Al"))
    shown = image.display("colorimetric", exposure=40.0, background=(0.06, 0.06, 0.06))
    pictures.append((255.0 * shown).astype(np.uint8))
Image.fromarray(np.concatenate(pictures, axis=1)).save("hidden_pictures.png")
