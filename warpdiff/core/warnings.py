"""Warnings that refer to the user's line of code, outside of the package."""

from __future__ import annotations

import sys
import warnings
from typing import TYPE_CHECKING

from warpdiff.core.wording import WarpdiffWarning

if TYPE_CHECKING:
    from types import FrameType

# Packages whose stack frames are skipped in the search for the user's line of code, to which a warning refers:
# warpdiff, and contextlib, which calls context managers of warpdiff that are used as decorators.
_INNER = (__name__.partition(".")[0], "contextlib")


def warn(message: str) -> None:
    """Warn with a reference to the innermost line of code outside of the package.

    Args:
        message: Text in which ``wording.ref`` has marked the names of arguments.
    """
    level = 1
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _INNER:
        level, frame = level + 1, frame.f_back
    warnings.warn(WarpdiffWarning(message), stacklevel=level + 1)
