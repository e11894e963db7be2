"""Memory: requests that exceed it are refused before work begins; allocations that fail raise one kind of error."""

from __future__ import annotations

import contextlib
import functools
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

from warpdiff.core.wording import marked

if TYPE_CHECKING:
    from collections.abc import Iterator

# Limit: arrays are indexed by an int32.
MOST_ELEMENTS = 2**31 - 1
_GROUPS, _OWN_GROUPS, _NO_LIMIT = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup"), 2**60
# Messages of NumPy and Warp, the latter in a RuntimeError.
_REFUSED = re.compile(r"[Aa]llocate (?P<size>[\d.]+) (?P<unit>bytes|[KMGTPE]iB)(?:.* on device '(?P<device>[^']+)')?")
_UNITS = {"bytes": 1.0, "KiB": 2.0**10, "MiB": 2.0**20, "GiB": 2.0**30, "TiB": 2.0**40, "PiB": 2.0**50, "EiB": 2.0**60}
# As measured, while sample fields and bodies are made.
_BYTES_A_SAMPLE, _BYTES_A_FACE = 80.0, 160.0


def require_memory(needed: float, what: str, remedy: str) -> None:
    """Refuse a request that requires more bytes than are free.

    Args:
        needed: Estimated number of bytes.
        what: Noun phrase of what requires them.
        remedy: What to do instead; ``{share}`` in it is the share that would fit, ``{side}`` its square root.

    Raises:
        MemoryError: Fewer bytes are free.
    """
    free = available()
    if needed > free:
        # Rounded, it is not to be more.
        share = 0.9 * max(free, 0.0) / needed
        fits = remedy.format(share=f"{share:.2g}", side=f"{math.sqrt(share):.2g}")
        size = f"about {needed / 1e9:.2g} GB, and {max(free, 0.0) / 1e9:.2g} GB are free"
        raise marked(MemoryError, f"{what} requires {size}: {fits}")


def require_samples(ny: int, nx: int, remedy: str) -> None:
    """Refuse a height field of more samples than fit into memory while it is made; see `require_memory`."""
    require_memory(_BYTES_A_SAMPLE * ny * nx, f"a field of {ny} × {nx} samples", remedy)


def require_faces(count: int, remedy: str) -> None:
    """Refuse a mesh of more faces than fit into memory while it is made; see `require_memory`."""
    require_memory(_BYTES_A_FACE * count, f"a mesh of {count} faces", remedy)


def available() -> float:
    """Bytes that this process may still allocate, as far as the system reports them; infinite where it does not."""
    free = math.inf
    try:
        fields = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        free = 1024.0 * sum(int(fields[name].split()[0]) for name in ("MemAvailable", "SwapFree"))
    except (OSError, KeyError, ValueError):
        pass
    try:
        import resource

        most, _ = resource.getrlimit(resource.RLIMIT_AS)
        if most != resource.RLIM_INFINITY:
            used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
            free = min(free, float(most - used))
    except (ImportError, OSError, IndexError, ValueError):
        pass
    for limit, usage, statistics in _limits_of_groups():
        with contextlib.suppress(OSError, ValueError):
            numbers = dict(line.split() for line in statistics.read_text().splitlines())
            # Files that were read or written long ago give way.
            cached_files = int(numbers.get("total_inactive_file", numbers.get("inactive_file", "0")))
            free = min(free, float(limit - int(usage.read_text()) + cached_files))
    return free


@functools.cache
def _limits_of_groups() -> list[tuple[int, Path, Path]]:
    """Limits of the control groups that this process is in, as in a container or under a scheduler, at the first call.

    Each has the files of its usage and of its statistics. The kernel documents them for either version:
    cgroup-v2.rst, and cgroup-v1/memory.rst.
    """
    limits = []
    with contextlib.suppress(OSError):
        for _, controllers, path in (line.split(":", 2) for line in _OWN_GROUPS.read_text().splitlines()):
            if controllers not in ("", "memory"):
                continue
            most, usage = ("limit_in_bytes", "usage_in_bytes") if controllers else ("max", "current")
            top = _GROUPS / controllers
            group = top / path.lstrip("/")
            # Any of those above it may have one; within a container only the top is visible.
            for folder in (group, *(parent for parent in group.parents if parent.is_relative_to(top))):
                with contextlib.suppress(OSError, ValueError):
                    # It is "max" where there is none, or more than any machine has.
                    limit = int((folder / f"memory.{most}").read_text())
                    if limit < _NO_LIMIT:
                        limits.append((limit, folder / f"memory.{usage}", folder / "memory.stat"))
    return limits


@contextlib.contextmanager
def as_memory_error(what: str, remedy: str) -> Iterator[None]:
    """Turn allocations of NumPy and Warp that fail in the context into an error in the words of `require_memory`.

    A request whose bytes are known is refused before it begins. Other processes may allocate memory meanwhile, and an
    address space may end before memory does.

    Args:
        what: Noun phrase of what was requested.
        remedy: What to do instead.

    Raises:
        MemoryError: An array did not fit.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        refused = _REFUSED.search(str(error))
        if refused is None and (error.args or not isinstance(error, MemoryError)):
            # Another error, or one that says so already.
            raise
        raise marked(MemoryError, _description(refused, what, remedy)) from error


def _description(refused: re.Match[str] | None, what: str, remedy: str) -> str:
    free = f"{max(available(), 0.0) / 1e9:.2g} GB are free: {remedy}"
    if refused is None:
        # Python itself does not say how much it was.
        return f"{what} requires more memory than is free; {free}"
    size = f"{float(refused['size']) * _UNITS[refused['unit']] / 1e9:.2g}"
    if refused["device"] in (None, "cpu"):
        return f"{what} requires another {size} GB at once, and {free}"
    return f"{what} requires another {size} GB at once, more than is free on {refused['device']}: {remedy}"
