"""Baked tables for other renderers: colours in all directions (baked lobes), and the power spectrum.

In: a height field and a coherence; for baked lobes an illuminant and an accepted colour difference, for a spectrum the
    number of its cells and a tolerance.
Out: ``BakedLobes``, the smallest table that meets the colour difference; ``BakedSpectrum``; and their files.
"""
