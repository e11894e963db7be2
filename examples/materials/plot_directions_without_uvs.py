"""
Gratings on meshes without texture coordinates
==============================================

The x axis of a height field needs a direction at each point of a mesh. This ring has no texture coordinates: the
direction is that of the world's x axis, runs around the axis of the ring, or turns as little as possible.
"""

import math

import matplotlib.pyplot as plt
import numpy as np
import trimesh

import warpdiff as wd

ring = trimesh.creation.torus(1.0, 0.42, major_sections=128, minor_sections=64)
ring.visual = trimesh.visual.ColorVisuals(ring, vertex_colors=np.full((len(ring.vertices), 4), 255, np.uint8))
grating = wd.gratings.sinusoidal(period_um=1.6, depth_um=0.2)
turns = np.linspace(0.0, 2.0 * math.pi, 10, endpoint=False)
lights = [wd.DirectionalLight((math.cos(turn), math.sin(turn), 1.2)) for turn in turns]
view = wd.View((0.0, -3.4, 4.6), (0.0, 0.0, 0.0), fov_y_deg=29, width=360, height=240)
options = {"tolerance": 0.1, "coherence": wd.Coherence(sigma_um=2.0), "pigment": 0.03}
pictures = [wd.shade(ring, grating, lights, view, tangents=rule, **options) for rule in ("x", "around-z", "smooth")]
shown = [image.display(exposure=pictures[0].auto_exposure, background=(0.02, 0.02, 0.02)) for image in pictures]
plt.imsave("directions_without_uvs.png", np.clip(np.hstack(shown), 0.0, 1.0))
