"""Pictures and their files; no Warp.

In: XYZ by pixel, and a plan.
Out: an ``Image``, its estimated errors, what displays show, EXR and PNG files.
"""
