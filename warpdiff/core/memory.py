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

# Maximum number of elements of an array. Kernels index arrays by int32; larger indices would overflow.
MOST_ELEMENTS = 2**31 - 1
_GROUPS, _OWN_GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
# Memory limit of a Linux control group (container) from which on it means "no limit" [bytes]. No machine has so much
# memory.
_NO_LIMIT = 2**60
# Pattern of the messages of failed allocations. It recognises a MemoryError of NumPy, and a RuntimeError of Warp about
# memory.
_REFUSED = re.compile(r"[Aa]llocate (?P<size>[\d.]+) (?P<unit>bytes|[KMGTPE]iB)(?:.* on device '(?P<device>[^']+)')?")
# Pattern of two lines of the Linux file ``/proc/meminfo``, whose numbers add up to the free memory [KiB].
_FREE = re.compile(r"^(MemAvailable|SwapFree):\s*(\d+)", re.MULTILINE)
_UNITS = {"bytes": 1.0, "KiB": 2.0**10, "MiB": 2.0**20, "GiB": 2.0**30, "TiB": 2.0**40, "PiB": 2.0**50, "EiB": 2.0**60}
# Memory that is allocated at most while a synthetic height field is made [bytes per height sample], and while a mesh of
# ``warpdiff.meshes`` is made [bytes per face]. Both values were measured. If they were doubled, requests that would fit
# into memory would be refused.
_BYTES_PER_SAMPLE, _BYTES_PER_FACE = 80.0, 160.0


def require_memory(needed: float, what: str, remedy: str) -> None:
    """Raise a ``MemoryError`` if a request requires more memory than is free.

    Args:
        needed: Estimated memory [bytes].
        what: Noun phrase that names the object, for the message.
        remedy: Advice for the message. ``{share}`` in it is replaced by the fraction of the request that would fit, and
            ``{side}`` by the square root of this fraction.

    Raises:
        MemoryError: Less memory is free than ``needed``.
    """
    free = available()
    if needed > free:
        # The message states which fraction of the requested object, such as a height field, would fit, rounded to two
        # digits. The factor of 0.9 ensures that the rounded fraction fits, too.
        share = 0.9 * max(free, 0.0) / needed
        fits = remedy.format(share=f"{share:.2g}", side=f"{math.sqrt(share):.2g}")
        size = f"about {needed / 1e9:.2g} GB, and {max(free, 0.0) / 1e9:.2g} GB are free"
        raise marked(MemoryError, f"{what} requires {size}: {fits}")


def require_samples(ny: int, nx: int, remedy: str) -> None:
    """Raise a ``MemoryError`` if a height field of ny × nx samples does not fit into memory; see `require_memory`."""
    require_memory(_BYTES_PER_SAMPLE * ny * nx, f"a field of {ny} × {nx} samples", remedy)


def require_faces(count: int, remedy: str) -> None:
    """Raise a ``MemoryError`` if a mesh of ``count`` faces does not fit into memory; see `require_memory`."""
    require_memory(_BYTES_PER_FACE * count, f"a mesh of {count} faces", remedy)


def available() -> float:
    """Return the memory that this process can still allocate [bytes]; infinite if the system does not report it."""
    free = math.inf
    try:
        fields = dict(_FREE.findall(Path("/proc/meminfo").read_text()))
        free = 1024.0 * sum(int(fields[name]) for name in ("MemAvailable", "SwapFree"))
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
            # Memory with cached files that are not in use counts as free. The operating system releases it if a process
            # needs memory.
            cached_files = int(numbers.get("total_inactive_file", numbers.get("inactive_file", "0")))
            free = min(free, float(limit - int(usage.read_text()) + cached_files))
    return free


@functools.cache
def _limits_of_groups() -> list[tuple[int, Path, Path]]:
    """Return the memory limits of the Linux control groups of this process, such as those of a container.

    Each limit [bytes] is returned with the paths of the group's files of memory usage and statistics. The limits are
    read at the first call. The documentation of the Linux kernel describes both versions of the files: cgroup-v2.rst
    and cgroup-v1/memory.rst.
    """
    limits = []
    with contextlib.suppress(OSError):
        for _, controllers, path in (line.split(":", 2) for line in _OWN_GROUPS.read_text().splitlines()):
            if controllers not in ("", "memory"):
                continue
            most, usage = ("limit_in_bytes", "usage_in_bytes") if controllers else ("max", "current")
            top = _GROUPS / controllers
            group = top / path.lstrip("/")
            # The control group and each of its parents may have a limit. In a container, only the top group is visible.
            for folder in (group, *(parent for parent in group.parents if parent.is_relative_to(top))):
                with contextlib.suppress(OSError, ValueError):
                    # If a control group has no limit, its file contains the text "max" (version 2), or a huge number
                    # (version 1).
                    limit = int((folder / f"memory.{most}").read_text())
                    if limit < _NO_LIMIT:
                        limits.append((limit, folder / f"memory.{usage}", folder / "memory.stat"))
    return limits


@contextlib.contextmanager
def as_memory_error(what: str, remedy: str) -> Iterator[None]:
    """Context that converts failed allocations of NumPy and Warp into a ``MemoryError`` with a remedy.

    :func:`require_memory` before the work is not enough: other processes may allocate memory meanwhile, and the address
    space of this process may be smaller than the free memory.

    Args:
        what: Noun phrase that names the object, for the message.
        remedy: Advice, for the message.

    Raises:
        MemoryError: An allocation in the context failed.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        refused = _REFUSED.search(str(error))
        if refused is None and (error.args or not isinstance(error, MemoryError)):
            # The error is raised unchanged: it is not a failed allocation, or it is a ``MemoryError`` that already
            # contains a remedy.
            raise
        raise marked(MemoryError, _description(refused, what, remedy)) from error


def _description(refused: re.Match[str] | None, what: str, remedy: str) -> str:
    free = f"{max(available(), 0.0) / 1e9:.2g} GB are free: {remedy}"
    if refused is None:
        # A MemoryError that Python itself raises has no message, so the size of the failed allocation is unknown.
        return f"{what} requires more memory than is free; {free}"
    size = f"{float(refused['size']) * _UNITS[refused['unit']] / 1e9:.2g}"
    if refused["device"] in (None, "cpu"):
        return f"{what} requires another {size} GB at once, and {free}"
    return f"{what} requires another {size} GB at once, more than is free on {refused['device']}: {remedy}"
