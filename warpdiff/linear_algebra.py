"""NumPy's linear algebra on one thread.

Its library's other threads wait for a next call by spinning: beside kernels that compile, or slices that are rendered,
they only take a core. And sums over fewer or more threads need not be the same to the bit.
"""

from __future__ import annotations

import functools
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from warpdiff import forks

if TYPE_CHECKING:
    from collections.abc import Iterator


# What limits the library, once for each who is within.
_within: list[Any] = []
_lock = forks.lock()


@contextmanager
def on_one_thread() -> Iterator[None]:
    """What is done within takes one thread of the library, until the last of those who are within at once leaves."""
    libraries = _libraries()
    with _lock:
        _within.append(_within[0] if _within else libraries.limit(limits=1))
    try:
        yield
    finally:
        with _lock:
            _leave()


def _leave() -> None:
    limits = _within.pop()
    if not _within:
        limits.restore_original_limits()


def _leave_others() -> None:
    """In a child, where those who were within are no more."""
    while _within:
        _leave()


forks.at_fork(in_child=_leave_others)


@functools.cache
def _libraries() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")
