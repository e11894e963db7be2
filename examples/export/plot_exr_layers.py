"""
EXR file with layers
====================

Save linear colours, normals, depth and the contribution of each light for a compositor, and read the file again. Linear
colours under a directional light are small: the exposure factor below makes them visible in a compositor. The picture
is the sum of the contributions of the lights, so that a compositor can change the brightness of each light.
"""

import warpdiff as wd

body, skin = wd.meshes.snake(), wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
view = wd.View.fit(body, (0.0, 0.6, 1.0), width=320, height=180)
lights = [wd.DirectionalLight((0.5, 1.0, -0.3)), wd.DirectionalLight((-1.0, 0.8, 0.2), illuminant="A")]
image = wd.shade(body, skin, lights, view, tolerance=0.1, pigment=0.1, layers=["normal", "depth", "light"])
image.save("layers.exr", exposure=image.auto_exposure)
print(list(wd.Image.load("layers.exr").layers))
image.save("layers.png", background=(1, 1, 1))
