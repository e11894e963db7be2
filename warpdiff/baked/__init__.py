"""Baked lobes: colours of all directions in the smallest table that keeps an error, to be taken elsewhere.

In: a height field, a coherence, an illuminant, a colour difference.
Out: ``BakedLobes`` and their file.
"""
