"""Baked tables for other renderers: lobes of colours, and the power spectrum.

In: a height field, a coherence, an illuminant, a colour difference.
Out: ``BakedLobes`` and ``BakedSpectrum``, the smallest tables that meet the error, and their files.
"""
