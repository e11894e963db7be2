"""Cache of values by keys, which removes the least recently used values first.

Renderers store meshes and tables in such caches.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import TYPE_CHECKING, Generic, TypeVar

from warpdiff.core import forks

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

_T = TypeVar("_T")
# One lock serves all caches. This does not slow down threads, because each thread releases the lock after a short time.
# A fork of the process waits until no thread has the lock.
_lock = forks.lock()


class LruCache(Generic[_T]):
    """Cache of values by keys, from which the least recently used value is removed first. Threads may share it."""

    def __init__(
        self, most: float = math.inf, most_bytes: float = math.inf, bytes_of: Callable[[_T], float] = lambda _: 0.0
    ) -> None:
        """Make an empty cache.

        Args:
            most: Largest number of values.
            most_bytes: Largest total size of the values [bytes]. The newest value is never removed, whatever its size.
            bytes_of: Function that returns the size of a value [bytes].
        """
        self._most, self._most_bytes, self._bytes_of = most, most_bytes, bytes_of
        self._values: OrderedDict[Hashable, _T] = OrderedDict()

    def __contains__(self, key: Hashable) -> bool:
        return key in self._values

    def __len__(self) -> int:
        return len(self._values)

    def get(self, key: Hashable) -> _T | None:
        """Return the value that the cache stores for a key, or None; the key becomes the most recently used one."""
        with _lock:
            value = self._values.get(key)
            if value is not None:
                # The key in the cache becomes the most recently used one. It is not replaced by the caller's equal key,
                # because the caller may modify its own key object later.
                self._values.move_to_end(key)
            return value

    def put(self, key: Hashable, value: _T) -> None:
        """Store a value in the cache for a key, which becomes the most recently used one."""
        with _lock:
            self._values.pop(key, None)
            self._values[key] = value
            self._trim()

    def get_or_make(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """Return the value that the cache stores for a key; make and store it if there is none.

        Several threads may make the value at the same time. All of them get the value that was stored first.
        """
        cached = self.get(key)
        if cached is not None:
            return cached
        made = make()
        with _lock:
            value = self._values.setdefault(key, made)
            self._trim()
        return value

    def clear(self) -> None:
        """Remove all values from the cache."""
        with _lock:
            self._values.clear()

    @property
    def nbytes(self) -> float:
        """Total size of all values in the cache [bytes]."""
        with _lock:
            return sum(self._bytes_of(value) for value in self._values.values())

    def _trim(self) -> None:
        """Remove the least recently used values until number and total size of the rest are within the limits."""
        for oldest in list(self._values)[:-1]:
            if len(self._values) <= self._most and self.nbytes <= self._most_bytes:
                break
            del self._values[oldest]
