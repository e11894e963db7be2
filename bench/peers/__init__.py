"""Peers: other programs for the same computations, for comparisons of speed and accuracy.

Programs that compute colours from scattering vectors (u, v, w) and geometry factors (gains):

- ``numpy_peer``: the published algorithm (Single 2014, see ``numba_published``) in vectorised NumPy.
- ``numba_published``: the published algorithm in Numba; importing it requires Numba.
- ``drjit_peer``: the published algorithm in Dr.Jit, compiled by LLVM.
- ``stam_analytic``: the analytic shader of Stam's chapter in GPU Gems.

Each module has ``available()``, ``SETTINGS`` and ``prepare(heightfield, coherence, **setting)``. ``available()``
returns None, or the reason why the program cannot run. ``SETTINGS`` is a list of settings, such as the number of
wavelengths, from cheap to accurate. ``prepare`` returns a function ``shade(scattering_vectors, gains, threads)`` that
returns XYZ (n, 3). ``scattering_vectors`` (n, 3) and ``gains`` (n,) are float64. The first call with a new number n of
directions may compile the function: call it once before you time it.

Programs that trace rays:

- ``raycasters``: Mitsuba 3 and Embree.
"""
