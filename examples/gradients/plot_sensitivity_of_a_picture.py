"""
Sensitivity of a picture
========================

The change of every pixel if the relief becomes 1 % deeper, and the gradient of the mean luminance with respect to all
heights. Both come from one call. Pixels that become brighter are red, and pixels that become darker are blue.
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

snake, skin = wd.meshes.tube(), wd.gratings.fingers(size_um=12.8)
light, view = wd.DirectionalLight((0.3, 1.0, 0.8)), wd.View.fit(snake, width=480, height=270)
options = {"coherence": wd.Coherence(sigma_um=2.0), "footprint": False, "refine": False}
renderer = wd.Renderer(snake, skin, light, view, **options)
image = renderer.image()

value, vjp, jvp = wd.adjoint.pixels(renderer, skin, light, wrt=("heights_um", "height_scale"))
change = np.full(image.illuminated.shape, np.nan)
change[image.illuminated] = 100.0 * jvp(height_scale=0.01)[:, 1] / np.maximum(value[:, 1], 1e-5 * value[:, 1].max())
weights = np.zeros_like(value)
weights[:, 1] = 1.0 / value[:, 1].sum()
gradient = 1e3 * vjp(weights)["heights_um"]  # change per nanometre, in millionths

layout = [["picture", "gradient"], ["change", "gradient"]]
figure, axes = plt.subplot_mosaic(layout, figsize=(11, 4.6), layout="constrained")
axes["picture"].imshow(image.display(exposure_stops=4.0))
shown = axes["change"].imshow(change, cmap="RdBu_r", vmin=-5.0, vmax=5.0)
figure.colorbar(shown, ax=axes["change"], label="change [%]")
axes["change"].set_title("Luminance if the relief is 1 % deeper")
for name in ("picture", "change"):
    axes[name].set(xticks=[], yticks=[], ylim=(190, 70))
most, extent = np.percentile(np.abs(gradient), 99.5), (0.0, skin.size_um[1], 0.0, skin.size_um[0])
shown = axes["gradient"].imshow(gradient, origin="lower", extent=extent, cmap="RdBu_r", vmin=-most, vmax=most)
figure.colorbar(shown, ax=axes["gradient"], label="change per nm and sample [10⁻⁶]")
axes["gradient"].set(xlabel="x [µm]", ylabel="y [µm]", title="Mean luminance by the heights")
figure.savefig("sensitivity_of_a_picture.png", dpi=100)
plt.close(figure)
