"""Threads: parallel loops, and linear algebra of NumPy and SciPy on one thread.

Their library's other threads wait for a next call by spinning: while kernels compile, or slices are rendered, they
only take a core. Sums over fewer or more threads need not be the same to the bit. And OpenBLAS waits for
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
    """Work on items: a thread that is free takes the next one."""

    def __init__(
        self, work: Callable[[Any], None], items: Sequence[Any], progress: Callable[[float], None] | None
    ) -> None:
        self._work, self._remaining, self._count, self._progress = work, iter(items), len(items), progress
        self._lock, self._reporting = threading.Lock(), threading.Lock()
        self._done = 0
        self._process = os.getpid()
        self._futures: list[Future[None]] = []

    def finish(self, threads: int) -> None:
        """Work on so many threads, of which this is one, until all is done; the first error ends it, and is raised."""
        others = min(threads, self._count) - 1
        # More threads than the pool has end with the work.
        own = ThreadPoolExecutor(others) if others > cores() else None
        # Fewer threads start where there is no memory for a thread.
        with contextlib.suppress(RuntimeError):
            for _ in range(others):
                self._futures.append((own or _pool()).submit(self._run))
        try:
            self._run()
        finally:
            if not self._is_cut_off:
                # Futures that have not begun may never do so, as the pool's threads may wait for this thread.
                self._futures = [future for future in self._futures if not future.cancel()]
                wait(self._futures)
                if own is not None:
                    own.shutdown(wait=False)
        if self._is_cut_off:
            raise RuntimeError(f"this process was forked in the midst of work on several threads: {forks.REMEDY}")
        for future in self._futures:
            future.result()

    def _run(self) -> None:
        """Work until none is left."""
        try:
            while not self._is_cut_off:
                with self._lock:
                    item = next(self._remaining, _NONE)
                if item is _NONE:
                    return
                self._work(item)
                self._report()
        except BaseException:
            # Items that no thread has begun are dropped.
            self._remaining = iter(())
            raise

    def _report(self) -> None:
        """Report progress, one thread at a time; meanwhile the others take the remaining items."""
        with self._reporting:
            self._done += 1
            if self._progress is not None:
                self._progress(self._done / self._count)

    @property
    def _is_cut_off(self) -> bool:
        """Whether other threads worked when this process was forked: they exist in the parent only."""
        return bool(self._futures) and os.getpid() != self._process


def parallel_for(
    work: Callable[[Any], None], items: Sequence[Any], *, threads: int, progress: Callable[[float], None] | None = None
) -> None:
    """Call ``work`` for each item: a thread that is free takes the next one.

    There are at most ``threads`` threads, the calling one included. ``progress`` is called with the share of the items
    that is done.
    """
    _Work(work, items, progress).finish(threads)


def subprogress(progress: Callable[[float], None] | None, begin: float, end: float) -> Callable[[float], None] | None:
    """Return the progress of a part of the work, from the share ``begin`` to the share ``end`` of all."""
    if progress is None:
        return None
    return lambda share: progress(begin + (end - begin) * share)


def slices_of(size: int, *, least: int, most: int, threads: int) -> Iterator[range]:
    """Yield slices of decreasing size, so that threads finish together."""
    first = 0
    while first < size:
        end = min(first + min(max((size - first) // (2 * threads), least), most), size)
        yield range(first, end)
        first = end


def cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@functools.cache
def _pool() -> ThreadPoolExecutor:
    """Threads that stay, one per core: to start them takes as long as a small launch."""
    return ThreadPoolExecutor(cores(), thread_name_prefix="warpdiff")


# A child has none of its parent's threads.
forks.at_fork(after_in_child=_pool.cache_clear)


# The number of contexts, and the libraries' numbers of threads before the first context began.
_contexts = 0
_former: dict[str, tuple[Any, int]] = {}
_lock = forks.lock()


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Keep linear algebra to one thread within the context."""
    global _contexts  # noqa: PLW0603 (of one process, under a lock)
    libraries = _libraries("scipy.linalg" in sys.modules)
    with _lock:
        own = [(library, library.num_threads) for library in libraries if _has_count_per_thread(library)]
        for library in libraries:
            if not _has_count_per_thread(library):
                _former.setdefault(library.filepath, (library, library.num_threads))
            _set(library, 1)
        _contexts += 1
    try:
        yield
    finally:
        with _lock:
            _contexts -= 1
            _restore(own)
            if _contexts <= 0:
                _end()


def _has_count_per_thread(library: Any) -> bool:
    """Whether the number of threads that a library uses is set for each calling thread separately."""
    return bool(library.threading_layer == "openmp")


def _set(library: Any, number: int) -> None:
    """Set the number from any thread: threadpoolctl allows only the thread that did so first."""
    if hasattr(library, "clear_controlling_thread"):
        library.clear_controlling_thread(force=True)
    library.set_num_threads(number)
    if hasattr(library, "clear_controlling_thread"):
        library.clear_controlling_thread(force=True)


def _restore(libraries: Iterable[tuple[Any, int]]) -> None:
    for library, number in libraries:
        _set(library, number)


def _end() -> None:
    """Restore the former numbers, after the last context or in a child of a fork."""
    global _contexts  # noqa: PLW0603 (of one process, under a lock)
    _restore(_former.values())
    _former.clear()
    _contexts = 0


forks.at_fork(after_in_child=_end)


@functools.cache
def _libraries(_with_scipy: bool) -> list[Any]:
    """Libraries of linear algebra that are loaded; SciPy's is loaded once something needs it."""
    return list(ThreadpoolController().select(user_api="blas").lib_controllers)
