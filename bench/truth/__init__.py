"""References for measurements and tests, which share no code with the kernels.

- ``reference``: colours of directions and pixels in float64
- ``brute_force``: intersections of rays with triangles
- ``numpy_methods``: series and λ steps in NumPy
- ``configurations``: random calls
- ``judge``: errors of calls on directions that no plan has read
- ``errors``: error measures
"""
