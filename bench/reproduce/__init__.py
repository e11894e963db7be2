"""Figures of the documentation, each computed by ``python -m bench.reproduce.NAME``.

- ``crops``: crops of pictures against their reference
- ``tolerance_sweep``: errors of random calls relative to their tolerances
- ``lights``, ``lit_scenes``: disc lights and environments against sums over many directions
- ``mitsuba_skies``: environments and disc lights compared with Mitsuba 3
- ``published``, ``thesis``, ``variants``: the published algorithm and evaluation
- ``cold_start``: time of a new process to its first picture
"""
