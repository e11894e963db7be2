"""Height fields: measured or synthetic, cleaned, described; no Warp.

In: files of heights, or the numbers of a grating.
Out: a ``HeightField``, with what is doubtful about it: gaps, units, aliasing, where scalar theory fails.
"""
