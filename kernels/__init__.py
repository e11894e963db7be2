"""Warp kernels. Each file is a Warp module, which is compiled separately, with its structs and functions."""
