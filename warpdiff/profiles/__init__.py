"""Surfaces with a few parameters and their derivatives, for fits and designs, public as ``wd.profiles``.

A profile describes a surface by a few parameters, such as depth and period. It has names, start values and bounds of
these parameters. The method ``surface`` makes the surface from values of the parameters. The method ``pullback``
converts the adjoint of the surface (the derivative of a loss with respect to it) to the adjoints of the parameters. The
method ``pushforward`` converts changes of the parameters to changes of the surface.

Examples:
    >>> import warpdiff as wd
    >>> profile = wd.profiles.Trapezoid(depth_um=0.14, duty=0.4, wall=0.05, period_um=2.0)
    >>> profile.names
    ('depth_um', 'duty', 'wall', 'period_um')
    >>> profile.surface(profile.start)
    Outline(4 vertices, period 2 µm, height range 0.14 µm)
"""

from warpdiff.profiles.outline import Outline
from warpdiff.profiles.outline_profiles import Polygon, Trapezoid
from warpdiff.profiles.profile_base import Profile
from warpdiff.profiles.sampled_profiles import Pixels, Samples, ScanModes

__all__ = ["Outline", "Pixels", "Polygon", "Profile", "Samples", "ScanModes", "Trapezoid"]
