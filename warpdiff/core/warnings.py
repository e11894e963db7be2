"""Warnings that name the line of the caller outside the package."""

from __future__ import annotations

import sys
import warnings
from typing import TYPE_CHECKING

from warpdiff.core.wording import WarpdiffWarning

if TYPE_CHECKING:
    from types import FrameType

# Modules whose frames are skipped to find the caller; contextlib calls decorated functions of the package.
_INNER = (__name__.partition(".")[0], "contextlib")


def warn(message: str) -> None:
    """Warn at the first line outside the package; the message marks arguments by ``wording.ref``."""
    level = 1
    frame: FrameType | None = sys._getframe(1)
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _INNER:
        level, frame = level + 1, frame.f_back
    warnings.warn(WarpdiffWarning(message), stacklevel=level + 1)
