"""
Compare a picture with a reference
==================================

`wd.compare` computes the errors of a picture relative to a reference. The picture has a tolerance of 0.1,
and the reference one of 0.005.
"""

import warpdiff as wd

body, skin = wd.meshes.tube(), wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
light, view = wd.DirectionalLight((0.3, 1.0, 0.8)), wd.View.fit(body, (0, 0.4, 1), width=300, height=120)
reference = wd.shade(body, skin, light, view, tolerance=5e-3)
image = wd.shade(body, skin, light, view, tolerance=0.1)
inside = reference.illuminated & (reference.coverage > 0.999)
print(wd.compare(image, reference, pixels=inside))
image.save("compared.png", background=(0.02, 0.02, 0.02))
