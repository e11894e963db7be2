"""Helpers of every room that know nothing of diffraction; no Warp.

In: arguments of callers, folders, work to be shared out.
Out: checked values, files whole or not there, caches, threads, forks that wait.
"""
