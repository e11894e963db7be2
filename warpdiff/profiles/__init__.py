"""Shapes with a few parameters and their derivatives, public as ``wd.profiles``.

Examples:
    >>> import warpdiff as wd
    >>> wd.profiles.Outline([0.0, 0.5], [0.0, 0.1], period_um=2.0).height_range_um
    0.1
"""

from warpdiff.profiles.outline import Outline

__all__ = ["Outline"]
