"""Memory limits: requests that exceed free memory raise ``MemoryError`` before work starts, with a remedy."""

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

# Limit on the number of elements of an array, because kernels index arrays by an int32; a larger index overflows.
MOST_ELEMENTS = 2**31 - 1
_GROUPS, _OWN_GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
# Limit of a control group that means "no limit" [bytes]: more memory than any machine has.
_NO_LIMIT = 2**60
# Messages of failed allocations: NumPy raises a MemoryError, Warp a RuntimeError.
_REFUSED = re.compile(r"[Aa]llocate (?P<size>[\d.]+) (?P<unit>bytes|[KMGTPE]iB)(?:.* on device '(?P<device>[^']+)')?")
_UNITS = {"bytes": 1.0, "KiB": 2.0**10, "MiB": 2.0**20, "GiB": 2.0**30, "TiB": 2.0**40, "PiB": 2.0**50, "EiB": 2.0**60}
# Memory at the peak while a sample field or body is made [bytes per height sample, bytes per face], as measured.
# Doubled values refuse requests that would fit.
_BYTES_PER_SAMPLE, _BYTES_PER_FACE = 80.0, 160.0


def require_memory(needed: float, what: str, remedy: str) -> None:
    """Refuse a request that requires more bytes than are free.

    Args:
        needed: Estimated number of bytes.
        what: Noun phrase that names the object, for the message.
        remedy: Advice; ``{share}`` in it becomes the share that would fit, ``{side}`` the square root of that share.

    Raises:
        MemoryError: Fewer bytes are free.
    """
    free = available()
    if needed > free:
        # The factor of 0.9 leaves a margin for the rounding to two digits.
        share = 0.9 * max(free, 0.0) / needed
        fits = remedy.format(share=f"{share:.2g}", side=f"{math.sqrt(share):.2g}")
        size = f"about {needed / 1e9:.2g} GB, and {max(free, 0.0) / 1e9:.2g} GB are free"
        raise marked(MemoryError, f"{what} requires {size}: {fits}")


def require_samples(ny: int, nx: int, remedy: str) -> None:
    """Refuse to make a height field that does not fit into memory; see `require_memory`."""
    require_memory(_BYTES_PER_SAMPLE * ny * nx, f"a field of {ny} × {nx} samples", remedy)


def require_faces(count: int, remedy: str) -> None:
    """Refuse to make a mesh that does not fit into memory; see `require_memory`."""
    require_memory(_BYTES_PER_FACE * count, f"a mesh of {count} faces", remedy)


def available() -> float:
    """Return the number of bytes that this process can still allocate; infinite if the system does not report it."""
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
            # The kernel frees its cache of inactive files when memory is needed.
            cached_files = int(numbers.get("total_inactive_file", numbers.get("inactive_file", "0")))
            free = min(free, float(limit - int(usage.read_text()) + cached_files))
    return free


@functools.cache
def _limits_of_groups() -> list[tuple[int, Path, Path]]:
    """Memory limits [bytes] of the control groups of this process, as in a container, at the first call.

    Each limit comes with the group's files of usage and of statistics. The documentation of the Linux kernel describes
    both versions: cgroup-v2.rst and cgroup-v1/memory.rst.
    """
    limits = []
    with contextlib.suppress(OSError):
        for _, controllers, path in (line.split(":", 2) for line in _OWN_GROUPS.read_text().splitlines()):
            if controllers not in ("", "memory"):
                continue
            most, usage = ("limit_in_bytes", "usage_in_bytes") if controllers else ("max", "current")
            top = _GROUPS / controllers
            group = top / path.lstrip("/")
            # Every parent group may have a limit too. In a container only the top group is visible.
            for folder in (group, *(parent for parent in group.parents if parent.is_relative_to(top))):
                with contextlib.suppress(OSError, ValueError):
                    # Without a limit the file contains "max", or a huge number in version 1.
                    limit = int((folder / f"memory.{most}").read_text())
                    if limit < _NO_LIMIT:
                        limits.append((limit, folder / f"memory.{usage}", folder / "memory.stat"))
    return limits


@contextlib.contextmanager
def as_memory_error(what: str, remedy: str) -> Iterator[None]:
    """Turn failed allocations of NumPy and Warp in the context into a ``MemoryError`` like that of `require_memory`.

    A check before work starts is not enough: other processes may allocate memory meanwhile, and the address space may
    be smaller than the free memory.

    Args:
        what: Noun phrase that names the object, for the message.
        remedy: Advice, for the message.

    Raises:
        MemoryError: An array did not fit.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        refused = _REFUSED.search(str(error))
        if refused is None and (error.args or not isinstance(error, MemoryError)):
            # This is another error, or one that has a full message.
            raise
        raise marked(MemoryError, _description(refused, what, remedy)) from error


def _description(refused: re.Match[str] | None, what: str, remedy: str) -> str:
    free = f"{max(available(), 0.0) / 1e9:.2g} GB are free: {remedy}"
    if refused is None:
        # An allocation by Python itself has no message.
        return f"{what} requires more memory than is free; {free}"
    size = f"{float(refused['size']) * _UNITS[refused['unit']] / 1e9:.2g}"
    if refused["device"] in (None, "cpu"):
        return f"{what} requires another {size} GB at once, and {free}"
    return f"{what} requires another {size} GB at once, more than is free on {refused['device']}: {remedy}"
