"""Figures of the README and of pictures, each made by ``python -m bench.reproduce.NAME``.

- ``crops``: crops of pictures against their reference; ``tolerance_sweep``: random calls against their tolerance
- ``lights``: disc lights and environments against sums over many directions
- ``published``, ``thesis``, ``variants``: the published algorithm and evaluation
- ``theory_verdict``: verdicts on scalar diffraction against rigorous solutions
- ``cold_start``: time of a new process to its first picture
"""
