"""Optics apart from the surface: coherence, materials, spectra, reflectance factors, colorimetry; no Warp.

In: directions, wavelengths, names of illuminants, indices of refraction.
Out: geometry factors, wavelength quadratures, XYZ and sRGB.
"""
