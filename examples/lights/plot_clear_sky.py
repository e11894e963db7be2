"""
Clear sky
=========

A gold tube under the CIE clear sky with a sun. The sky is also the background of the picture.
"""

import warpdiff as wd

body, skin = wd.meshes.tube(), wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
sky = wd.Environment.clear_sky((0.6, 0.8, 0.3))  # the argument is the direction towards the sun
view = wd.View.fit(body, (0.0, 0.4, 1.0), width=240, height=135)
image = wd.shade(body, skin, sky, view, tolerance=0.1, material=wd.Material.metal("Au"))
image.save("clear_sky.png", background=sky.background(view))
