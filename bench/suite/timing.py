"""Interleaved timing: in each round, every call runs once. Results are medians and ranges over the rounds."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable


class Times(NamedTuple):
    """Times of a call [s]: median, minimum and maximum over the rounds, and time of the first call minus the median."""

    median: float
    least: float
    most: float
    first: float


def interleaved(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, Times]:
    """Time calls in rounds, in each of which every call runs once. The first round is not part of the medians."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds + 1):
        for name, call in calls.items():
            begin = time.perf_counter()
            call()
            seconds[name].append(time.perf_counter() - begin)
    return {
        name: Times(median := float(np.median(warm)), min(warm), max(warm), max(first - median, 0.0))
        for name, (first, *warm) in seconds.items()
    }
