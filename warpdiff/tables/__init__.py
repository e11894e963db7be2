"""Tables of Fourier coefficients and of colours on a device, and the look-ups of colours in these tables.

In: a height field, a ``Plan`` with the numbers of a computation, and a range of directions.
Out: coefficient tables, colour tables with mip levels, and the ``ColourLookup`` that evaluates them.
"""
