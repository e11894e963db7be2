"""Work on several threads."""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TYPE_CHECKING, Any

from warpdiff.core import forks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

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
