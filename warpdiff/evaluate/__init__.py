"""Reflectance at arrays of directions, reflectance maps, and efficiencies of diffraction orders.

In: a height field, directions to light and view, wavelengths or an illuminant.
Out: reflectances ρ(λ), colours XYZ, BRDFs or efficiencies, as NumPy arrays.
"""
