"""
Metals
======

The same grating in aluminium, gold and copper. The reflectance follows from Fresnel's equations with
complex indices of refraction.
"""

import warpdiff as wd

body, grating = wd.meshes.tube(), wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
lights = [wd.DirectionalLight((0.3, 1.0, 0.6)), wd.DirectionalLight((-0.8, 0.6, 0.6))]
view = wd.View.fit(body, (0.0, 0.4, 1.0), width=400, height=130)
for symbol in ("Al", "Au", "Cu"):
    image = wd.shade(body, grating, lights, view, material=wd.Material.metal(symbol), tolerance=0.05)
    image.save(f"metal_{symbol}.png", background=(0.02, 0.02, 0.02))
