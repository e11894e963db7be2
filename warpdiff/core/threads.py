"""Threads: parallel loops, and linear algebra of NumPy and SciPy on one thread.

Linear algebra on several threads has three drawbacks. Idle threads of OpenBLAS wait actively and use cores that
compilers and kernels need. The rounding of a sum depends on the number of threads. A child process hangs if it was
forked during a multi-threaded OpenBLAS call of another thread.
"""

from __future__ import annotations

import contextlib
import functools
import os
import sys
import threading
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import TYPE_CHECKING, Generic, TypeVar

from threadpoolctl import ThreadpoolController

from warpdiff.core import forks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from threadpoolctl import LibController

_T = TypeVar("_T")


class _None:
    """Type of the marker for the end of a loop's items. None cannot be the marker, because None may be an item."""


_NONE = _None()


class _Work(Generic[_T]):
    """Loop over items on several threads. A thread that has finished an item continues with the next one."""

    def __init__(
        self, work: Callable[[_T], None], items: Sequence[_T], progress: Callable[[float], None] | None
    ) -> None:
        self._work, self._remaining, self._count, self._progress = work, iter(items), len(items), progress
        self._lock, self._reporting = threading.Lock(), threading.Lock()
        self._done = 0
        self._process = os.getpid()
        self._futures: list[Future[None]] = []

    def finish(self, threads: int) -> None:
        """Run the loop on this thread and on at most ``threads`` − 1 other threads. The first error ends the loop."""
        others = min(threads, self._count) - 1
        # The pool that all loops share has one thread per core. A loop with more threads makes a separate pool, which
        # ends with the loop.
        own = ThreadPoolExecutor(others) if others > cores() else None
        # If the system cannot start another thread, the loop continues on fewer threads.
        with contextlib.suppress(RuntimeError):
            for _ in range(others):
                self._futures.append((own or _pool()).submit(self._run))
        try:
            self._run()
        finally:
            if not self._is_cut_off:
                # Tasks that no thread has started yet are cancelled. This thread does not wait for them, because this
                # could deadlock: all threads of the shared pool may be waiting for this thread.
                self._futures = [future for future in self._futures if not future.cancel()]
                wait(self._futures)
                if own is not None:
                    own.shutdown(wait=False)
        if self._is_cut_off:
            raise RuntimeError(f"this process was forked during work on several threads: {forks.REMEDY}")
        for future in self._futures:
            future.result()

    def _run(self) -> None:
        """Process items until none is left."""
        try:
            while not self._is_cut_off:
                with self._lock:
                    item = next(self._remaining, _NONE)
                if isinstance(item, _None):
                    return
                self._work(item)
                self._report()
        except BaseException:
            # After an error, the items that no thread has started are skipped.
            self._remaining = iter(())
            raise

    def _report(self) -> None:
        """Report progress, one thread at a time, while other threads continue with the remaining items."""
        with self._reporting:
            self._done += 1
            if self._progress is not None:
                self._progress(self._done / self._count)

    @property
    def _is_cut_off(self) -> bool:
        """Whether this is a child process that was forked during the loop, without the loop's other threads."""
        return bool(self._futures) and os.getpid() != self._process


def parallel_for(
    work: Callable[[_T], None], items: Sequence[_T], *, threads: int, progress: Callable[[float], None] | None = None
) -> None:
    """Call ``work`` for each item, on at most ``threads`` threads including the calling one.

    A thread that has finished an item continues with the next one. ``progress`` is called with the finished fraction of
    the items.
    """
    _Work(work, items, progress).finish(threads)


def subprogress(progress: Callable[[float], None] | None, begin: float, end: float) -> Callable[[float], None] | None:
    """Return a callable that reports the progress of one part of the work, or None if ``progress`` is None.

    Args:
        progress: Callable that gets the finished fraction of the whole work, or None.
        begin: Finished fraction of the whole work at the begin of the part.
        end: Finished fraction of the whole work at the end of the part.
    """
    if progress is None:
        return None
    return lambda share: progress(begin + (end - begin) * share)


def slices_of(size: int, *, least: int, most: int, threads: int) -> Iterator[range]:
    """Yield consecutive ranges of indices that cover 0 to ``size`` − 1; their lengths fall from ``most`` to ``least``.

    With short ranges at the end, all threads finish at about the same time.
    """
    first = 0
    while first < size:
        end = min(first + min(max((size - first) // (2 * threads), least), most), size)
        yield range(first, end)
        first = end


def cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@functools.cache
def _pool() -> ThreadPoolExecutor:
    """Return the thread pool of the process, with one thread per core.

    The pool is reused, because starting threads requires as much time as launching a small kernel.
    """
    return ThreadPoolExecutor(cores(), thread_name_prefix="warpdiff")


# A forked child process does not have the threads of its parent's pool. The child process must make a new pool.
forks.at_fork(after_in_child=_pool.cache_clear)


# `_contexts` is the number of active contexts of `single_threaded_blas`. `_former` contains each library of linear
# algebra, with the number of threads that it used before the first of these contexts.
_contexts = 0
_former: dict[str, tuple[LibController, int]] = {}
_lock = forks.lock()


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Restrict the linear algebra of NumPy and SciPy to one thread within the context."""
    global _contexts  # noqa: PLW0603 (a counter of the process, changed under a lock)
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


def _has_count_per_thread(library: LibController) -> bool:
    """Whether a library stores the number of its threads separately for each calling thread, as OpenMP does."""
    return bool(library.threading_layer == "openmp")


def _set(library: LibController, number: int) -> None:
    """Set the number of threads of a library.

    threadpoolctl records the first thread that has set the number, and refuses settings from other threads. Before and
    after the setting, this record is therefore cleared.
    """
    if hasattr(library, "clear_controlling_thread"):
        library.clear_controlling_thread(force=True)
    library.set_num_threads(number)
    if hasattr(library, "clear_controlling_thread"):
        library.clear_controlling_thread(force=True)


def _restore(libraries: Iterable[tuple[LibController, int]]) -> None:
    for library, number in libraries:
        _set(library, number)


def _end() -> None:
    """Restore the numbers of threads that the libraries of linear algebra had before `single_threaded_blas`.

    This happens at the end of the last active context of `single_threaded_blas`, and in a forked child process.
    """
    global _contexts  # noqa: PLW0603 (a counter of the process, changed under a lock)
    _restore(_former.values())
    _former.clear()
    _contexts = 0


forks.at_fork(after_in_child=_end)


@functools.cache
def _libraries(_with_scipy: bool) -> list[LibController]:
    """Return the loaded libraries of linear algebra.

    SciPy loads a library of its own when ``scipy.linalg`` is imported. ``_with_scipy`` says whether this has happened.
    The function body does not use it: it is the key under which the cache stores the list from before the import and
    the list from after it.
    """
    return list(ThreadpoolController().select(user_api="blas").lib_controllers)
