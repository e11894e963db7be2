"""NumPy's linear algebra on one thread.

Its library's other threads wait for a next call by spinning: beside kernels that compile, or slices that are rendered,
they only take a core. And sums over fewer or more threads need not be the same to the bit.
"""

from __future__ import annotations

import functools
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from threadpoolctl import ThreadpoolController

from warpdiff.core import fork_safety

if TYPE_CHECKING:
    from collections.abc import Iterator


# Limits of those who entered since there was someone within, and of those of them who have left.
_entered: list[Any] = []
_left: list[Any] = []
_lock = fork_safety.lock()


@contextmanager
def on_one_thread() -> Iterator[None]:
    """Keep NumPy's linear algebra to one thread while within."""
    libraries = _libraries()
    with _lock:
        limits = libraries.limit(limits=1)
        _entered.append(limits)
    try:
        yield
    finally:
        with _lock:
            # Some versions of the library count threads for each caller, others for all of them: there whoever leaves
            # last gives back what the first one found.
            limits.restore_original_limits()
            _left.append(limits)
            if len(_left) >= len(_entered):
                _end()


def _end() -> None:
    """Give back what the first one found, where nobody is within, as in a child of a fork."""
    if _entered:
        _entered[0].restore_original_limits()
    _entered.clear()
    _left.clear()


fork_safety.at_fork(in_child=_end)


@functools.cache
def _libraries() -> Any:
    return ThreadpoolController().select(user_api="blas")
