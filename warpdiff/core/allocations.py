"""Allocations that fail although what was asked for seemed to fit: one error for those of NumPy and of Warp."""

from __future__ import annotations

import contextlib
import re
from typing import TYPE_CHECKING

from warpdiff.core import free_memory

if TYPE_CHECKING:
    from collections.abc import Iterator

# What NumPy and Warp say, the latter in a RuntimeError.
_REFUSED = re.compile(r"[Aa]llocate (?P<size>[\d.]+) (?P<unit>bytes|[KMGTPE]iB)(?:.* on device '(?P<device>[^']+)')?")
_UNITS = {"bytes": 1.0, "KiB": 2.0**10, "MiB": 2.0**20, "GiB": 2.0**30, "TiB": 2.0**40, "PiB": 2.0**50, "EiB": 2.0**60}


@contextlib.contextmanager
def as_memory_error(what: str, remedy: str) -> Iterator[None]:
    """Within it, memory that is not there is told in the words of `free_memory.require_memory`.

    What takes more than there is, is refused before it begins wherever its bytes are known. Others may take memory
    meanwhile, and an address space may end before memory does.

    Args:
        what: What was asked for.
        remedy: What to do instead.

    Raises:
        MemoryError: An array did not fit.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        found = _REFUSED.search(str(error))
        if found is None and (error.args or not isinstance(error, MemoryError)):
            # Another error, or one that says so already.
            raise
        raise MemoryError(_told(found, what, remedy)) from error


def _told(refused: re.Match[str] | None, what: str, remedy: str) -> str:
    free = f"{max(free_memory.available(), 0.0) / 1e9:.2g} GB are free: {remedy}"
    if refused is None:
        # Python itself does not say how much it was.
        return f"{what} takes more memory than there is, and {free}"
    size = f"{float(refused['size']) * _UNITS[refused['unit']] / 1e9:.2g}"
    if refused["device"] in (None, "cpu"):
        return f"{what} takes another {size} GB at once, and {free}"
    return f"{what} takes another {size} GB at once, more than is free on {refused['device']}: {remedy}"
