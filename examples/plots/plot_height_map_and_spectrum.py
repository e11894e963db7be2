"""
Map, profile and power spectrum of a surface
============================================

The heights of a surface with a profile, and its power spectrum, in which the periods are marked. The periods are also
written to a CSV file.
"""

import matplotlib.pyplot as plt

import warpdiff as wd

skin = wd.gratings.fingers(size_um=25.6)
skin.periods().save("periods.csv")

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
wd.plot.height_map(skin, ax=left, profile_along="x", at_um=2.0)
wd.plot.power_spectrum(skin, ax=right)
figure.savefig("height_map_and_spectrum.png", dpi=100)
plt.close(figure)
