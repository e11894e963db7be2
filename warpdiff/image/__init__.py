"""Pictures, their estimated errors, display transforms and picture files. The package does not import Warp.

In: linear CIE XYZ of each pixel, and the plan of the computation.
Out: an ``Image``, display RGB, EXR and PNG files.
"""
