"""Tables of Fourier coefficients and of colours on a device, and the look-ups in them.

In: a height field, a plan, a range of directions.
Out: coefficient tables, colour tables with mip levels, and the ``ColourLookup`` that evaluates them.
"""
