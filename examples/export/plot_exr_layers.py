"""
EXR file with layers
====================

Save linear values, normals and depth for a compositor, and read the file again. Linear values under a directional light
are small: the exposure factor below makes them visible in a compositor. The depth of the background is infinite.
"""

import warpdiff as wd

body, skin = wd.meshes.snake(), wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
view = wd.View.fit(body, (0.0, 0.6, 1.0), width=320, height=180)
light = wd.DirectionalLight((0.5, 1.0, -0.3))
image = wd.shade(body, skin, light, view, tolerance=0.1, pigment=0.1, layers=["normal", "depth"])
image.save("layers.exr", exposure=image.auto_exposure)
print(sorted(wd.Image.load("layers.exr").layers))
image.save("layers.png", background=(1, 1, 1))
