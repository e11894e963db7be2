"""Exact derivatives of order efficiencies, spectra, colours and pictures, public as ``wd.adjoint``.

Each function returns a ``Linearised`` object: a value with its derivatives. The derivatives are closed formulas in
float64, without finite differences. A variable without a derivative raises an error, so that no gradient is zero by
mistake.

Examples:
    >>> import warpdiff as wd
    >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
    >>> value, vjp, jvp = wd.adjoint.spectral_reflectance(grating, (0, 0, 1), (0, 0, 1), 550.0)
    >>> vjp([1.0])["heights_um"].shape
    (1, 64)
"""

from warpdiff.adjoint.linearised import Linearised
from warpdiff.adjoint.objective_function import objective
from warpdiff.adjoint.order_derivatives import order_efficiencies
from warpdiff.adjoint.picture_derivatives import pixels
from warpdiff.adjoint.spectral_derivatives import reflectance, spectral_reflectance

__all__ = ["Linearised", "objective", "order_efficiencies", "pixels", "reflectance", "spectral_reflectance"]
