"""Peers: other programs that compute the same, for comparisons of speed and accuracy.

Shading, all of scattering vectors (u, v, w) and gains:

- ``numpy_peer``: the published algorithm in plain vectorised NumPy.
- ``numba_published``: the same in Numba; importing it requires Numba.
- ``drjit_peer``: the same in Dr.Jit, compiled by LLVM.
- ``stam_analytic``: the analytic shader of Stam's chapter in GPU Gems.

Each has ``available()``, which returns None or the reason why it cannot run, ``SETTINGS``, from cheap to accurate, and
``prepare(heightfield, coherence, **setting)``. The latter returns ``shade(scattering_vectors, gains, threads)`` -> XYZ
(n, 3).

``scattering_vectors`` (n, 3) and ``gains`` (n,) are float64. A first call may compile: warm up with arrays of the
length that is timed.

- ``raycasters``: Mitsuba 3 and Embree, for the rays.
"""
