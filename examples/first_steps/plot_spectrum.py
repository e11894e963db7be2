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
to_view = wd.direction([12.0, 15.0, 18.0])  # angles from the normal in degrees
spectra = wd.reflectance_spectra(grating, (0, 0, 1), to_view, wavelengths_nm)
axes = wd.plot.spectra(spectra)
axes.figure.savefig("spectrum.png", dpi=100)
plt.close(axes.figure)
