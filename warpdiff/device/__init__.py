"""Devices, compilation of kernels, and pipelines of kernel calls over slices of arrays.

In: names of devices, kernels with their arguments.
Out: a Warp device, compiled kernels, launches one after the other.
"""
