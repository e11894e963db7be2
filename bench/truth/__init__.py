"""References of measurements and tests; they share no code with the kernels.

- ``reference`` (float64 colours), ``brute_force`` (rays), ``numpy_methods`` (series and steps in NumPy)
- ``configurations``: random calls; ``judge``: errors of calls on directions that no plan has read; ``errors``: measures
"""
