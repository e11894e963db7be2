"""Fits of measured orders, spectra and colours by the derivatives of ``warpdiff.adjoint``."""
