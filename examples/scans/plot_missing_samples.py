"""
Missing samples
===============

NaN marks samples that an instrument could not measure. `filled` interpolates them smoothly.
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

heights_um = wd.gratings.bumps().heights_um.copy()
rows, columns = np.mgrid[: heights_um.shape[0], : heights_um.shape[1]]
heights_um[(rows - 25) ** 2 + (columns - 12) ** 2 < 30] = np.nan
scan = wd.HeightField(heights_um, pitch_um=0.1)
figure, axes = plt.subplots(1, 2, figsize=(7, 3.2), layout="constrained")
for axis, field, title in zip(axes, (scan, scan.filled()), ("measured", "filled"), strict=True):
    axis.imshow(field.heights_um, origin="lower")
    axis.set_title(title)
plt.savefig("missing_samples.png", dpi=100)
plt.close()
