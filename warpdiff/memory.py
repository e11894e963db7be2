"""Whether there is memory for what is asked, before work begins."""

from __future__ import annotations

import math
from pathlib import Path

# What arrays are indexed by is an int32.
MOST_ELEMENTS = 2**31 - 1


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
