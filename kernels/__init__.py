"""Warp kernels: one Warp module a file, with the structs and functions that it needs."""
