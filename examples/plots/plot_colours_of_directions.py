"""
Colours against the view direction
==================================

The colours of a compact disc over all view directions, and in the plane of the light.
"""

import matplotlib.pyplot as plt

import warpdiff as wd

disc = wd.gratings.disc("CD", tracks=20, length_um=32.0, pitch_um=0.08)
to_light = wd.direction(20.0)
picture = wd.reflectance_map(disc, to_light, size=480)

figure, (left, right) = plt.subplots(1, 2, figsize=(12, 5), width_ratios=(1, 1.2), layout="constrained")
wd.plot.reflectance_map(picture, to_light, ax=left)
wd.plot.colour_strip(disc, to_light, ax=right)
right.set_box_aspect(0.2)
figure.savefig("colours_of_directions.png", dpi=100)
plt.close(figure)
