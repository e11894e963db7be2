"""
Estimated errors of pixels
==========================

A picture, and the estimated error of each pixel relative to the pixel's colour.
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

body, skin = wd.meshes.snake(), wd.gratings.fingers(size_um=32.0, pitch_um=0.08)
view = wd.View((-1.6, 2.2, 2.6), (-0.56, 0.06, 0.07), fov_y_deg=6.0, width=480, height=300)
image = wd.shade(body, skin, wd.DirectionalLight((0.6, 1.0, -0.1)), view, tolerance=0.1, pigment=0.1)
figure, axes = plt.subplots(2, 1, figsize=(5, 6.2), layout="constrained")
axes[0].imshow(image.display(background=(0, 0, 0)))
shown = axes[1].imshow(np.where(image.illuminated, image.error, np.nan), vmin=0.0, vmax=0.2)
figure.colorbar(shown, ax=axes[1], label="estimated relative error")
for axis in axes:
    axis.axis("off")
plt.savefig("estimated_errors.png", dpi=100)
plt.close()
