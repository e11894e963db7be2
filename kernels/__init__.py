"""Warp kernels: one Warp module per file, with its structs and functions."""
