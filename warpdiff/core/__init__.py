"""General helpers, which do not import Warp: options, validation, errors, caches, files, memory, threads, forks.

In: arguments of callers, files, work for several threads.
Out: checked values, errors that name arguments, atomic file writes, caches, thread pools, fork safety.
"""
