"""
Turntable
=========

An animation of a rotating body. All frames have the same exposure.
"""

import shutil

import warpdiff as wd

body, skin = wd.meshes.snake(), wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
light = wd.DirectionalLight((0.5, 1.0, -0.3))
view = wd.View.fit(body, (0.0, 0.8, 1.0), turning=True, width=240, height=160)
renderer = wd.Renderer(body, skin, light, view, tolerance=0.1, pigment=0.1)
shots = wd.turntable(light, view, count=8)
wd.sequence(renderer, shots, "turn", animation="turntable.webp", frames_per_second=8.0, background=(0, 0, 0))
shutil.copy("turn/frame_0000.png", "turntable.png")
