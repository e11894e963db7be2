"""Warp kernels with their structs and functions. Each file is a Warp module and is compiled separately."""
