"""
Clean a scan
============

Level a tilted height field, remove dust, and make opposite edges match.
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

rng = np.random.default_rng(1)
heights_um = wd.gratings.fingers(size_um=32.0, pitch_um=0.08).heights_um[:300, :300].copy()
rows, columns = np.mgrid[:300, :300]
heights_um += 2e-4 * columns - 1e-4 * rows
heights_um[rng.integers(0, 300, 40), rng.integers(0, 300, 40)] += 0.5
scan = wd.HeightField(heights_um, pitch_um=0.08)
clean = scan.levelled(order=2).despiked().periodic()
figure, axes = plt.subplots(1, 2, figsize=(8, 3.4), layout="constrained")
for axis, field, title in zip(axes, (scan, clean), ("scan", "cleaned"), strict=True):
    extent = (0, field.size_um[1], 0, field.size_um[0])
    shown = axis.imshow(1e3 * field.heights_um, origin="lower", extent=extent)
    axis.set(title=title, xlabel="x [µm]", ylabel="y [µm]")
    figure.colorbar(shown, ax=axis, label="height [nm]")
plt.savefig("clean_a_scan.png", dpi=100)
plt.close()
