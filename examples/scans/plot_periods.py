"""
Periods of a surface
====================

Find the periods of a height field with their standard errors, and compute the angles at which they diffract
green light.
"""

import math

import warpdiff as wd

skin = wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
for period in skin.periods():
    ratio = 0.55 / period.period_um
    angle = f"has an angle of {math.degrees(math.asin(ratio)):.1f}°" if ratio < 1.0 else "is evanescent"
    print(f"{period}: the first order at 550 nm {angle}")
wd.reflectance_map(skin, (0, 0, 1), size=300).save("periods.png")
