"""Plug-in for the renderer Mitsuba 3, which uses baked tables as a BSDF.

In: files of baked lobes or baked spectra.
Out: a BSDF plug-in.
"""
