"""
Depth tolerance of a two-colour foil
====================================

A foil of eight levels is green at 20° and red at 35°. Its colours change if its relief is deeper or shallower.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

targets = [
    wd.Target.colour((0.275, 0.55, 0.092), (0, 0, 1), wd.direction(20.0), ior=math.inf),
    wd.Target.colour((0.463, 0.25, 0.034), (0, 0, 1), wd.direction(35.0), ior=math.inf),
]
result = wd.design(wd.profiles.Pixels(0.25, np.zeros((1, 128))), targets, levels=8, starts=1)
scales = np.linspace(0.7, 1.3, 13)
table = result.robustness(depth_scales=scales, edge_widths_um=[], tilts_deg=[])
views = wd.direction([20.0, 35.0])
fields = [wd.HeightField(scale * result.heightfield.heights_um, result.heightfield.pitch_um) for scale in scales]
colours = np.array([wd.reflectance(field, (0, 0, 1), views, ior=math.inf) for field in fields])

figure, axes = plt.subplots(3, 1, figsize=(8, 4.6), height_ratios=(3, 1, 1), sharex=True, layout="constrained")
axes[0].plot(100.0 * (scales - 1.0), table["delta_e"][1:])
axes[0].set(ylabel="larger ΔE2000", ylim=(0, None))
for angle, axis, xyz in zip((20, 35), axes[1:], colours.transpose(1, 0, 2), strict=True):
    shown = wd.to_srgb(result.exposure * xyz[None], exposure=1.0)
    axis.imshow(shown, extent=(-30, 30, 0, 1), aspect="auto")
    axis.set(ylabel=f"{angle}°", yticks=[])
axes[2].set_xlabel("change of the depth [%]")
figure.savefig("depth_tolerance.png", dpi=100)
plt.close(figure)
