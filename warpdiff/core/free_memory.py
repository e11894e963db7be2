"""Whether there is memory for what is asked, before work begins."""

from __future__ import annotations

import math
from pathlib import Path

# What arrays are indexed by is an int32.
MOST_ELEMENTS = 2**31 - 1
# As measured, while sample fields and bodies are made.
_BYTES_A_SAMPLE, _BYTES_A_FACE = 80.0, 160.0


def require(needed: float, what: str, remedy: str) -> None:
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
    """Refuse a height field of more samples than there is memory to make it; see `require`."""
    require(_BYTES_A_SAMPLE * ny * nx, f"a field of {ny} × {nx} samples", remedy)


def require_faces(count: int, remedy: str) -> None:
    """Refuse a mesh of more faces than there is memory to make it; see `require`."""
    require(_BYTES_A_FACE * count, f"a mesh of {count} faces", remedy)


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
    return there
