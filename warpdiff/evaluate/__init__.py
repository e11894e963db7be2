"""Reflectance at arrays of directions, maps of it, and efficiencies of orders.

In: a height field, directions to light and view, wavelengths or an illuminant.
Out: ρ(λ), XYZ, BRDF or efficiencies, as NumPy arrays.
"""
