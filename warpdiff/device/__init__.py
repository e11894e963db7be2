"""Warp devices, compilation of kernels, and launches of kernels over slices of arrays.

In: names of devices, kernels and their arguments.
Out: a Warp device, compiled kernels, launches in order.
"""
