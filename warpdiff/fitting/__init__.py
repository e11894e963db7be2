"""Fits of measured orders, spectra and colours by the derivatives of :mod:`warpdiff.adjoint`."""
