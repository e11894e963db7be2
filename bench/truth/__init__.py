"""References for measurements and tests, which share no code with the Warp kernels.

- ``reference``: colours and spectra of directions, in float64
- ``coherent_sums``: powers of scattering vectors for each kind of coherence, in float64
- ``pixel_reference``: colours of pixels, in float64, and errors of pictures
- ``brute_force``: intersections of rays with triangles, by tests of all pairs
- ``numpy_methods``: series expansions and sums over wavelengths in NumPy
- ``configurations``: random calls of the library, which test the plans (numbers of wavelengths and terms) it selects
- ``judge``: errors of such calls, on directions that were not used to make their plans
- ``errors``: error measures for colours
"""
