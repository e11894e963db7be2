"""Baked tables for other renderers: lobes of colours, and the power spectrum.

In: a height field and a coherence; for lobes an illuminant and an accepted colour difference, for a spectrum the number
    of cells and a tolerance.
Out: ``BakedLobes``, the smallest table that meets the colour difference; ``BakedSpectrum``; and their files.
"""
