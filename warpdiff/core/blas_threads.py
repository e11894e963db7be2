"""Linear algebra of NumPy and SciPy on one thread.

Their library's other threads wait for a next call by spinning: beside kernels that compile, or slices that are
rendered, they only take a core. Sums over fewer or more threads need not be the same to the bit. And OpenBLAS waits for
ever in a fork while another thread's call is shared out among its threads.
"""

from __future__ import annotations

import functools
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from threadpoolctl import ThreadpoolController

from warpdiff.core import forks

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


# How many are within, and which libraries had how many threads before the first one came.
_within = 0
_before: dict[str, tuple[Any, int]] = {}
_lock = forks.lock()


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Keep linear algebra to one thread while someone is within."""
    global _within  # noqa: PLW0603 (of one process, under a lock)
    libraries = _libraries("scipy.linalg" in sys.modules)
    with _lock:
        own = [(each, each.num_threads) for each in libraries if _counts_for_each_caller(each)]
        for each in libraries:
            if not _counts_for_each_caller(each):
                _before.setdefault(each.filepath, (each, each.num_threads))
            _set(each, 1)
        _within += 1
    try:
        yield
    finally:
        with _lock:
            _within -= 1
            _give_back(own)
            if _within <= 0:
                _end()


def _counts_for_each_caller(library: Any) -> bool:
    """Whether other threads of the process have numbers of their own."""
    return bool(library.threading_layer == "openmp")


def _set(library: Any, number: int) -> None:
    """Set it from any thread: threadpoolctl lets only the one that did so first, which may be done with it or not."""
    if hasattr(library, "clear_controlling_thread"):
        library.clear_controlling_thread(force=True)
    library.set_num_threads(number)
    if hasattr(library, "clear_controlling_thread"):
        library.clear_controlling_thread(force=True)


def _give_back(libraries: Iterable[tuple[Any, int]]) -> None:
    for library, number in libraries:
        _set(library, number)


def _end() -> None:
    """Give back what the first one found, where nobody is within, as in a child of a fork."""
    global _within  # noqa: PLW0603 (of one process, under a lock)
    _give_back(_before.values())
    _before.clear()
    _within = 0


forks.at_fork(in_child=_end)


@functools.cache
def _libraries(_with_scipy: bool) -> list[Any]:
    """Those that are loaded; SciPy's comes once something needs it."""
    return list(ThreadpoolController().select(user_api="blas").lib_controllers)
