"""
Spectral picture
================

Render the radiance of each pixel at 41 wavelengths, and plot the spectra of three pixels: the brightest at 450, 550 and
650 nm. The EXR file has a channel per wavelength in the layout of Fichet et al. (2021).
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

body, skin = wd.meshes.tube(), wd.gratings.fingers(size_um=12.8, pitch_um=0.08)
light, view = wd.DirectionalLight((0.3, 1.0, 0.8)), wd.View.fit(body, (0, 0.4, 1), width=160, height=90)
window, nm = wd.Coherence(sigma_um=4.0), np.linspace(380.0, 780.0, 41)
image = wd.shade(body, skin, light, view, coherence=window, tolerance=0.05, wavelengths_nm=nm)
image.save("spectral.exr")

for wavelength, colour in ((450.0, "tab:blue"), (550.0, "tab:green"), (650.0, "tab:red")):
    radiance = image.spectra[..., np.argmin(np.abs(nm - wavelength))]
    row, column = np.unravel_index(radiance.argmax(), radiance.shape)
    plt.plot(nm, image.spectra[row, column], color=colour, label=f"row {row}, column {column}")
plt.xlabel("wavelength [nm]")
plt.ylabel("relative radiance")
plt.legend()
plt.savefig("spectral.png", dpi=100)
plt.close()
