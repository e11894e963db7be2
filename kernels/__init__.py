"""Warp kernels and the structs and functions that they use. Each file is a Warp module and is compiled separately."""
