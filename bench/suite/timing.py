"""Times in turns: every call once a round, medians with the spread of the rounds."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable


class Taken(NamedTuple):
    """Seconds: the median, the least and the most of a call's rounds, and what its first call took more."""

    median: float
    least: float
    most: float
    first: float


def in_turns(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, Taken]:
    """Time calls that return when they are done, which take turns after a first round that is apart."""
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds + 1):
        for name, call in calls.items():
            begin = time.perf_counter()
            call()
            taken[name].append(time.perf_counter() - begin)
    return {
        name: Taken(median := float(np.median(warm)), min(warm), max(warm), max(first - median, 0.0))
        for name, (first, *warm) in taken.items()
    }
