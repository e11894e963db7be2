"""Plug-in for Mitsuba 3: baked tables as a BSDF.

In: files of baked lobes or spectra.
Out: a BSDF plug-in.
"""
