"""
Sensitivity of a colour to each height
======================================

The luminance of one direction, and its gradient with respect to all heights of the surface: red samples make the
direction brighter if they rise, and blue ones darker. One call gives the whole map.
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

skin = wd.gratings.fingers(size_um=12.8)
light, view = wd.direction(35.0), wd.direction(12.0)
coherence = wd.Coherence(sigma_um=4.0)
xyz, vjp, _ = wd.adjoint.reflectance(skin, light, view, coherence=coherence)
gradient = vjp([0.0, 1.0, 0.0])["heights_um"] / xyz[1] * 1e-3  # relative change of Y per nanometre

figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
wd.plot.height_map(skin, ax=left)
most = np.percentile(np.abs(gradient), 99.5)
extent = (0.0, skin.size_um[1], 0.0, skin.size_um[0])
picture = right.imshow(gradient, origin="lower", extent=extent, cmap="RdBu_r", vmin=-most, vmax=most)
figure.colorbar(picture, ax=right, label="change of the luminance per nm and sample")
right.set(xlabel="x [µm]", ylabel="y [µm]", title="Sensitivity of the luminance")
figure.savefig("sensitivity_of_a_colour.png", dpi=100)
plt.close(figure)
