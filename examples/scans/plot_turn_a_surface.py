"""
Turn a height field
===================

The same skin with its fingers along and across the body. The method `rotated` rotates the height field by
multiples of 90°.
"""

import warpdiff as wd

body, skin = wd.meshes.tube(), wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
light = wd.DirectionalLight((0.3, 1.0, 0.6))
view = wd.View.fit(body, (0.0, 0.4, 1.0), width=480, height=150)
along = wd.shade(body, skin, light, view, tolerance=0.05)
across = wd.shade(body, skin.rotated(1), light, view, tolerance=0.05)
along.save("fingers_along.png", background=(0.02, 0.02, 0.02))
across.save("fingers_across.png", background=(0.02, 0.02, 0.02), exposure_from=along)
