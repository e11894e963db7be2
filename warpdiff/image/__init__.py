"""Pictures, their estimated errors, display transforms and files; no Warp.

In: XYZ by pixel, and a plan.
Out: an ``Image``, display RGB, EXR and PNG files.
"""
