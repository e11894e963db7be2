"""Measured and synthetic height fields: files, cleaning, periods, diagnostics.

In: files or arrays of heights in µm.
Out: a ``HeightField``, with warnings about units, aliasing and the limits of scalar diffraction.
The package does not import Warp, the library for GPU kernels.
"""
