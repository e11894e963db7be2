"""
Map, profile and power spectrum of a surface
============================================

A map of the heights of a surface, a profile along x, and the power spectrum, in which the periods are marked. The
periods are also written to a CSV file.
"""

import matplotlib.pyplot as plt

import warpdiff as wd

skin = wd.gratings.fingers(size_um=25.6)
skin.periods().save("periods.csv")

figure, axes = plt.subplot_mosaic(
    [["map", "spectrum"], ["profile", "profile"]], figsize=(11, 7), height_ratios=(2.2, 1), layout="constrained"
)
wd.plot.height_map(skin, ax=axes["map"])
wd.plot.power_spectrum(skin, ax=axes["spectrum"])
wd.plot.profile(skin, ax=axes["profile"], along="x")
figure.savefig("height_map_and_spectrum.png", dpi=100)
plt.close(figure)
