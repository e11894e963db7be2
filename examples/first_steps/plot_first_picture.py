"""
First picture
=============

A snake whose skin diffracts light: a height field, a mesh, a light and a camera.
"""

import warpdiff as wd

skin = wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
body = wd.meshes.snake()
light = wd.DirectionalLight((0.5, 1.0, -0.3))
view = wd.View.fit(body, (0.0, 0.6, 1.0), width=480, height=260)
image = wd.shade(body, skin, light, view, tolerance=0.05, pigment=0.1)
print(image.report)
image.save("first_picture.png", background=(0.02, 0.02, 0.02))
