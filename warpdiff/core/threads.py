"""Threads: parallel loops, and linear algebra of NumPy and SciPy on one thread.

Their library's other threads wait for a next call by spinning: beside kernels that compile, or slices that are
rendered, they only take a core. Sums over fewer or more threads need not be the same to the bit. And OpenBLAS waits for
ever in a fork while another thread's call is shared out among its threads.
"""

from __future__ import annotations

import contextlib
import functools
import os
import sys
import threading
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from threadpoolctl import ThreadpoolController

from warpdiff.core import forks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

_NONE = object()


class _Work:
    """Some work for each item: the next one whenever a thread is free."""

    def __init__(
        self, work: Callable[[Any], None], items: Sequence[Any], progress: Callable[[float], None] | None
    ) -> None:
        self._work, self._left, self._count, self._progress = work, iter(items), len(items), progress
        self._lock, self._telling = threading.Lock(), threading.Lock()
        self._done = 0
        self._process = os.getpid()
        self._others: list[Future[None]] = []

    def finish(self, threads: int) -> None:
        """Work on so many threads, of which this is one, until all is done; the first error ends it, and is raised."""
        others = min(threads, self._count) - 1
        # More than stay end with the work.
        own = ThreadPoolExecutor(others) if others > cores() else None
        # Fewer do where there is no memory for a thread.
        with contextlib.suppress(RuntimeError):
            for _ in range(others):
                self._others.append((own or _kept()).submit(self._run))
        try:
            self._run()
        finally:
            if not self._is_cut_off:
                # Those that have not begun may never do so: whatever keeps them from it may wait for this thread.
                self._others = [other for other in self._others if not other.cancel()]
                wait(self._others)
                if own is not None:
                    own.shutdown(wait=False)
        if self._is_cut_off:
            raise RuntimeError(f"this process was forked in the midst of work on several threads: {forks.REMEDY}")
        for other in self._others:
            other.result()

    def _run(self) -> None:
        """Work until none is left."""
        try:
            while not self._is_cut_off:
                with self._lock:
                    item = next(self._left, _NONE)
                if item is _NONE:
                    return
                self._work(item)
                self._tell()
        except BaseException:
            # What nobody has begun with is left.
            self._left = iter(())
            raise

    def _tell(self) -> None:
        """Tell of progress, one thread at a time; meanwhile others begin with what is left."""
        with self._telling:
            self._done += 1
            if self._progress is not None:
                self._progress(self._done / self._count)

    @property
    def _is_cut_off(self) -> bool:
        """Whether others were at it when this process was forked: they are in the parent."""
        return bool(self._others) and os.getpid() != self._process


def parallel_for(
    work: Callable[[Any], None],
    items: Sequence[Any],
    *,
    threads: int,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Do some work for each item, the next one whenever a thread is free."""
    _Work(work, items, progress).finish(threads)


def subprogress(progress: Callable[[float], None] | None, begin: float, end: float) -> Callable[[float], None] | None:
    """The progress of what is a part of all."""
    if progress is None:
        return None
    return lambda done: progress(begin + (end - begin) * done)


def slices_of(size: int, *, least: int, most: int, threads: int) -> Iterator[range]:
    """Slices that get smaller, so that threads finish together."""
    first = 0
    while first < size:
        end = min(first + min(max((size - first) // (2 * threads), least), most), size)
        yield range(first, end)
        first = end


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@functools.cache
def _kept() -> ThreadPoolExecutor:
    """Threads that stay, one a core: to start them takes as long as a small launch."""
    return ThreadPoolExecutor(cores(), thread_name_prefix="warpdiff")


# A child has none of its parent's threads.
forks.at_fork(in_child=_kept.cache_clear)


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
