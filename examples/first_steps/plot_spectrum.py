"""
Spectrum in one direction
=========================

The relative reflectance of a sine grating of 2 µm as a function of the wavelength, in three view directions near the
first order.
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

grating = wd.gratings.sinusoidal(2.0, 0.2)
wavelengths_nm = np.linspace(400.0, 700.0, 151)
for angle_deg in (12.0, 15.0, 18.0):
    to_view = (np.sin(np.radians(angle_deg)), 0.0, np.cos(np.radians(angle_deg)))
    spectrum = wd.spectral_reflectance(grating, (0, 0, 1), to_view, wavelengths_nm)
    plt.plot(wavelengths_nm, spectrum, label=f"{angle_deg:g}°")
plt.xlabel("wavelength [nm]")
plt.ylabel("relative reflectance")
plt.legend(title="view angle")
plt.savefig("spectrum.png", dpi=100)
plt.close()
