"""How often permanent tests try: as often as seconds allow in the test command, and much more often in a soak.

``make soak`` says by WARPDIFF_SOAK when it ends, in seconds since the epoch, and by WARPDIFF_SOAK_SEED which random
numbers are drawn. Each test gets a share of the time that is left, or as many as ``permanent(row, shares=…)`` says, and
tries nothing more once that is over.
"""

import functools
import os
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TypeVar

from hypothesis import HealthCheck, seed, settings

_T, _F = TypeVar("_T"), TypeVar("_F")
_END = float(os.environ.get("WARPDIFF_SOAK", "0"))
IS_SOAK = _END > 0.0
# Random seed. Each soak has another one.
SEED = int(os.environ.get("WARPDIFF_SOAK_SEED", "0"))
_until = _END


def count(in_tests: int, in_soak: int) -> int:
    """How often."""
    return in_soak if IS_SOAK else in_tests


def begin(shares: int, shares_left: int) -> None:
    """Give the next test its shares of the time, of which what others did not take is a part."""
    global _until  # noqa: PLW0603 (of one process, which runs one test at a time)
    _until = time.time() + (_END - time.time()) * shares / shares_left


def seconds_left() -> float:
    """How long a test may still try; for ever in the test command."""
    return max(_until - time.time(), 0.0) if IS_SOAK else float("inf")


class Tries:
    """Counts what a test tries, for the report."""

    def __init__(self) -> None:
        self.number = 0

    def of(self, items: Iterable[_T]) -> Iterator[_T]:
        """The items, of which there is one at least, until the time is up."""
        for index, item in enumerate(items):
            if index and not seconds_left():
                return
            self.number += 1
            yield item


def examples(in_tests: int, in_soak: int) -> Callable[[_F], _F]:
    """Set Hypothesis up: a soak draws new examples; the test command does so only when the package changes."""
    chosen = settings(
        max_examples=count(in_tests, in_soak), deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    from_seed = seed(SEED or _of_the_sources())
    return lambda test: from_seed(chosen(test))


@functools.cache
def _of_the_sources() -> int:
    """A number that any change of the package changes."""
    root = Path(__file__).resolve().parents[1]
    sources = sorted(path for folder in ("warpdiff", "kernels") for path in (root / folder).rglob("*.py"))
    return zlib.crc32(b"".join(path.read_bytes() for path in sources))
