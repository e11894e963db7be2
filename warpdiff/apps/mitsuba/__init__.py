"""Bridges to other programs: what is baked here as a plug-in there.

In: files of what was baked.
Out: a BSDF plug-in for Mitsuba 3.
"""
