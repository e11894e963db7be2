"""Optics that do not depend on the height field: coherence, materials, spectra, colorimetry; no Warp.

In: directions, wavelengths, names of illuminants, indices of refraction.
Out: geometry factors, wavelength quadratures, XYZ and sRGB.
"""
