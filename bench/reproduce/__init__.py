"""Figures of the documentation, each computed by ``python -m bench.reproduce.NAME``.

- ``crops``: errors of small parts of pictures, relative to many points per pixel
- ``tolerance_sweep``: errors of random calls of the library, relative to their tolerances
- ``lights``, ``lit_scenes``: errors under disc lights and environments, relative to sums over many directions
- ``mitsuba_skies``: environments and disc lights compared with Mitsuba 3
- ``published``, ``thesis``, ``variants``: comparison with the algorithm of Single (2014); the figures of that
  publication
- ``theory_verdict``: estimated accuracy ("verdict") of scalar diffraction, compared with rigorous solutions
- ``iso_25178``: roughness parameters compared with the package surfalize, and coverage of the standard errors
- ``cold_start``: time of a new process to its first picture
"""
