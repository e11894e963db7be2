"""Memory: refusals before work begins, and one error for allocations of NumPy and Warp that fail."""

from __future__ import annotations

import contextlib
import functools
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

# What arrays are indexed by is an int32.
MOST_ELEMENTS = 2**31 - 1
_GROUPS, _OWN_GROUPS, _NO_LIMIT = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup"), 2**60
# What NumPy and Warp say, the latter in a RuntimeError.
_REFUSED = re.compile(r"[Aa]llocate (?P<size>[\d.]+) (?P<unit>bytes|[KMGTPE]iB)(?:.* on device '(?P<device>[^']+)')?")
_UNITS = {"bytes": 1.0, "KiB": 2.0**10, "MiB": 2.0**20, "GiB": 2.0**30, "TiB": 2.0**40, "PiB": 2.0**50, "EiB": 2.0**60}
# As measured, while sample fields and bodies are made.
_BYTES_A_SAMPLE, _BYTES_A_FACE = 80.0, 160.0


def require_memory(needed: float, what: str, remedy: str) -> None:
    """Refuse what takes more bytes than there are.

    Args:
        needed: About so many bytes.
        what: What takes them.
        remedy: What to do instead; ``{share}`` in it is the share that would fit, ``{side}`` its square root.

    Raises:
        MemoryError: There are fewer.
    """
    there = available()
    if needed > there:
        # Rounded, it is not to be more.
        share = 0.9 * max(there, 0.0) / needed
        free = max(there, 0.0) / 1e9
        fits = remedy.format(share=f"{share:.2g}", side=f"{math.sqrt(share):.2g}")
        raise MemoryError(f"{what} takes about {needed / 1e9:.2g} GB, and {free:.2g} GB are free: {fits}")


def require_samples(ny: int, nx: int, remedy: str) -> None:
    """Refuse a height field of more samples than there is memory to make it; see `require_memory`."""
    require_memory(_BYTES_A_SAMPLE * ny * nx, f"a field of {ny} × {nx} samples", remedy)


def require_faces(count: int, remedy: str) -> None:
    """Refuse a mesh of more faces than there is memory to make it; see `require_memory`."""
    require_memory(_BYTES_A_FACE * count, f"a mesh of {count} faces", remedy)


def available() -> float:
    """Bytes that this process may still take, as far as the system tells; infinite where it does not."""
    there = math.inf
    try:
        fields = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        there = 1024.0 * sum(int(fields[name].split()[0]) for name in ("MemAvailable", "SwapFree"))
    except (OSError, KeyError, ValueError):
        pass
    try:
        import resource

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if most != resource.RLIM_INFINITY:
            taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            there = min(there, float(most - taken))
    except (ImportError, OSError, IndexError, ValueError):
        pass
    for limit, used, statistics in _limits_of_groups():
        with contextlib.suppress(OSError, ValueError):
            told = dict(line.split() for line in statistics.read_text().splitlines())
            # Files that were read or written long ago give way.
            files = int(told.get("total_inactive_file", told.get("inactive_file", "0")))
            there = min(there, float(limit - int(used.read_text()) + files))
    return there


@functools.cache
def _limits_of_groups() -> list[tuple[int, Path, Path]]:
    """Limits of the control groups that this process is in, as in a container or under a scheduler, at the first look.

    Each with the files that tell what is taken, and statistics of it. The kernel documents them for either version:
    cgroup-v2.rst, and cgroup-v1/memory.rst.
    """
    found = []
    with contextlib.suppress(OSError):
        for _, controllers, path in (line.split(":", 2) for line in _OWN_GROUPS.read_text().splitlines()):
            if controllers not in ("", "memory"):
                continue
            most, taken = ("limit_in_bytes", "usage_in_bytes") if controllers else ("max", "current")
            top = _GROUPS / controllers
            group = top / path.lstrip("/")
            # Any of those above it may have one; within a container they are not seen but for the top.
            for folder in (group, *(each for each in group.parents if each.is_relative_to(top))):
                with contextlib.suppress(OSError, ValueError):
                    # It is "max" where there is none, or more than any machine has.
                    limit = int((folder / f"memory.{most}").read_text())
                    if limit < _NO_LIMIT:
                        found.append((limit, folder / f"memory.{taken}", folder / "memory.stat"))
    return found


@contextlib.contextmanager
def as_memory_error(what: str, remedy: str) -> Iterator[None]:
    """Within it, memory that is not there is told in the words of `require_memory`.

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
    free = f"{max(available(), 0.0) / 1e9:.2g} GB are free: {remedy}"
    if refused is None:
        # Python itself does not say how much it was.
        return f"{what} takes more memory than there is, and {free}"
    size = f"{float(refused['size']) * _UNITS[refused['unit']] / 1e9:.2g}"
    if refused["device"] in (None, "cpu"):
        return f"{what} takes another {size} GB at once, and {free}"
    return f"{what} takes another {size} GB at once, more than is free on {refused['device']}: {remedy}"
