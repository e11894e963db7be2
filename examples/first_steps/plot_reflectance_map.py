"""
Colours in all directions
=========================

The reflectance of synthetic snake skin in all view directions, under light along the surface normal. The
centre of the picture is the normal, and its rim is the horizon.
"""

import warpdiff as wd

skin = wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
wd.reflectance_map(skin, (0, 0, 1), size=400).save("reflectance_map.png")
