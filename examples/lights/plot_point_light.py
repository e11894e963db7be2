"""
Point light
===========

A point light near the body. Its power is specified at a distance of 1, and its spectrum is that of a
fluorescent tube.
"""

import warpdiff as wd

body, skin = wd.meshes.snake(), wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
bulb = wd.PointLight((0.3, 1.2, -0.4), illuminant="FL11", power=2.0)
view = wd.View.fit(body, (0.0, 0.8, 1.0), width=480, height=280)
image = wd.shade(body, skin, bulb, view, tolerance=0.05, pigment=0.1)
image.save("point_light.png", background=(0.02, 0.02, 0.02))
