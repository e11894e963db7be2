"""Fits of profiles to measured orders, spectra and colours, with the derivatives of ``warpdiff.adjoint``."""
