"""Tables of coefficients and of colours on a device, made once for a height field, and the look-ups in them.

In: a height field, a plan, a range of directions.
Out: tables of coefficients and of colours with their mip levels, and the ``ColourLookup`` over them.
"""
