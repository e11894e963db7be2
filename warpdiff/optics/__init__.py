"""Light apart from the surface: coherence, Fresnel and masking factors, colorimetry; no Warp.

In: directions, wavelengths, names of illuminants, an index of refraction.
Out: gains, quadratures over the wavelength, XYZ and sRGB.
"""
