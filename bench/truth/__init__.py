"""What measurements and tests are judged by; shares no code with the kernels.

- ``reference`` (float64 colours), ``brute_force`` (rays), ``numpy_methods`` (series and steps in NumPy)
- ``configurations``: random calls; ``judge``: judges calls on directions that no plan has read; ``errors``: how
"""
