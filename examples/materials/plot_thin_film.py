"""
Thin film
=========

Reflectance of silica films of three thicknesses on aluminium.
"""

import matplotlib.pyplot as plt
import numpy as np

import warpdiff as wd

wavelengths_nm = np.linspace(400.0, 750.0, 176)
for thickness_nm in (0.0, 120.0, 400.0):
    metal = wd.Material.metal("Al")
    film = wd.Material.dielectric(1.46)
    coated = metal.coated(film, thickness_nm=thickness_nm) if thickness_nm else metal
    plt.plot(wavelengths_nm, coated.reflectance(wavelengths_nm, 30.0), label=f"{thickness_nm:g} nm")
plt.xlabel("wavelength [nm]")
plt.ylabel("reflectance at 30°")
plt.legend(title="silica on aluminium")
plt.savefig("thin_film.png", dpi=100)
plt.close()
