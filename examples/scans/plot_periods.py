"""
Periods of a surface
====================

Find the periods of a height field with their standard errors, and compute the angles at which they diffract
green light.
"""

import warpdiff as wd

skin = wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
print(skin.periods().table())
print(wd.order_angles(skin, (0, 0, 1), 550.0, most_order=1))
wd.reflectance_map(skin, (0, 0, 1), size=300).save("periods.png")
