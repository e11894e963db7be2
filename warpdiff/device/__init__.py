"""Warp devices, compilation of kernels, and kernel launches over slices of arrays.

In: names of devices, kernels and their arguments.
Out: a Warp device, compiled kernels, launches in a fixed order.
"""
