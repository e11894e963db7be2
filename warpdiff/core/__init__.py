"""Helpers that know nothing of diffraction; no Warp.

In: arguments of callers, files, work to be divided.
Out: checked values, errors that name arguments, atomic file writes, caches, thread pools, fork safety.
"""
