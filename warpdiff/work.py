"""Work on several threads, and what this thread does meanwhile."""

from __future__ import annotations

import functools
import threading
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

_MOST_WAIT_S = 3e-4


class Work:
    """Some work for each item, which others begin with: the next one whenever a thread is free.

    As a context it is finished where that ends, and in between this thread does what neither needs that work nor is
    needed by it, and launches on this thread alone.
    """

    def __init__(
        self,
        work: Callable[[Any], None],
        items: Sequence[Any],
        *,
        threads: int,
        progress: Callable[[float], None] | None = None,
        joins: bool = False,
    ) -> None:
        """Begin on all threads but this one, to which the last item is left if it ``joins`` them at once."""
        self._work, self._left, self._count, self._progress = work, iter(items), len(items), progress
        self._lock = threading.Lock()
        self._done = 0
        self._begun = threading.Event()
        self._others = [_pool(threads - 1).submit(self._help) for _ in range(min(threads - 1, len(items) - joins))]
        if self._others and not joins:
            try:
                # Another thread does not get hold of the interpreter while this one goes on in it.
                self._begun.wait(_MOST_WAIT_S)
            except BaseException:
                self.abandon()
                raise

    def _help(self) -> None:
        """Begin on another thread."""
        self._begun.set()
        self._run()

    def _run(self) -> None:
        """Work until none is left."""
        while True:
            with self._lock:
                item = next(self._left, None)
            if item is None:
                return
            try:
                self._work(item)
            except BaseException:
                self._drop()
                raise
            with self._lock:
                self._done += 1
                if self._progress is not None:
                    self._progress(self._done / self._count)

    def _drop(self) -> None:
        """Leave what nobody has begun with."""
        with self._lock:
            self._left = iter(())

    def _await(self) -> None:
        """Wait for those that have begun."""
        for other in self._others:
            other.cancel()
        wait(self._others)

    def finish(self) -> None:
        """Take part in it until all is done, and raise what was raised; the first error ends it."""
        try:
            self._run()
        finally:
            self._await()
        for other in self._others:
            if not other.cancelled():
                other.result()

    def abandon(self) -> None:
        """End it where it is, whatever was raised."""
        self._drop()
        self._await()

    def __enter__(self) -> Work:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.finish()
        else:
            self.abandon()


def side_by_side(work: Callable[[Any], None], items: Sequence[Any], *, threads: int) -> None:
    """Do some work for each item, the next one whenever a thread is free."""
    Work(work, items, threads=threads, joins=True).finish()


def slices_of(size: int, *, least: int, most: int, threads: int) -> Iterator[range]:
    """Slices that get smaller, so that threads finish together."""
    first = 0
    while first < size:
        end = min(first + min(max((size - first) // (2 * threads), least), most), size)
        yield range(first, end)
        first = end


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Threads that stay: to start them takes as long as a small launch."""
    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix="warpdiff")
