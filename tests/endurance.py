"""Number of attempts of the tests marked ``permanent``: few in the default test command, many in a soak test.

A soak test repeats these tests with random inputs for a given time. ``make soak`` sets two environment variables for
it. ``WARPDIFF_SOAK`` is the time at which the soak test ends, in seconds since the epoch. ``WARPDIFF_SOAK_SEED`` is the
random seed. The tests share the remaining time equally, or by weights, which are the argument ``shares`` of the mark
``permanent``. A test starts no new attempt after its share of the time has passed.
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
# Random seed of this run of the tests. Each run of ``make soak`` sets a different seed.
SEED = int(os.environ.get("WARPDIFF_SOAK_SEED", "0"))
_until = _END


def count(in_tests: int, in_soak: int) -> int:
    """Return the number of attempts: ``in_soak`` during a soak test, otherwise ``in_tests``."""
    return in_soak if IS_SOAK else in_tests


def begin(shares: int, shares_left: int) -> None:
    """Set the end time of the test that runs next.

    Time that earlier tests did not use is divided among all remaining tests.
    """
    global _until  # noqa: PLW0603 (each process runs one test at a time)
    _until = time.time() + (_END - time.time()) * shares / shares_left


def seconds_left() -> float:
    """Return the remaining time of the current test in seconds, or infinity outside of a soak test."""
    return max(_until - time.time(), 0.0) if IS_SOAK else float("inf")


class Tries:
    """Counter of the attempts (repetitions with random inputs) of one test, for the report of a soak test."""

    def __init__(self) -> None:
        self.number = 0

    def of(self, items: Iterable[_T]) -> Iterator[_T]:
        """Yield the items until the time of the test is over, but at least one item."""
        for index, item in enumerate(items):
            if index and not seconds_left():
                return
            self.number += 1
            yield item


def examples(in_tests: int, in_soak: int) -> Callable[[_F], _F]:
    """Return a decorator that sets the number of examples of a Hypothesis test.

    A soak test draws new random examples. Other test runs draw the same examples until a source file of the package
    changes.
    """
    chosen = settings(
        max_examples=count(in_tests, in_soak), deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    from_seed = seed(SEED or _of_the_sources())
    return lambda test: from_seed(chosen(test))


@functools.cache
def _of_the_sources() -> int:
    """Return a checksum of the package's source files. It is the random seed of test runs that are not soak tests."""
    root = Path(__file__).resolve().parents[1]
    sources = sorted(path for folder in ("warpdiff", "kernels") for path in (root / folder).rglob("*.py"))
    return zlib.crc32(b"".join(path.read_bytes() for path in sources))
