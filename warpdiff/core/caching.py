"""LRU cache: moving lights and views reuse meshes and tables."""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import TYPE_CHECKING, Generic, TypeVar

from warpdiff.core import forks

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

_T = TypeVar("_T")
# All caches share one lock, because their calls are short. A fork waits for it.
_lock = forks.lock()


class LruCache(Generic[_T]):
    """Cache of values by keys, from which the least recently used value is removed first. Threads may share it."""

    def __init__(
        self, most: float = math.inf, most_bytes: float = math.inf, bytes_of: Callable[[_T], float] = lambda _: 0.0
    ) -> None:
        """Make an empty cache.

        Args:
            most: Greatest number of values.
            most_bytes: Greatest number of bytes; the value that was added last stays, whatever its size.
            bytes_of: Function of a value that returns its number of bytes.
        """
        self._most, self._most_bytes, self._bytes_of = most, most_bytes, bytes_of
        self._values: OrderedDict[Hashable, _T] = OrderedDict()

    def __contains__(self, key: Hashable) -> bool:
        return key in self._values

    def __len__(self) -> int:
        return len(self._values)

    def get(self, key: Hashable) -> _T | None:
        """Return the value of a key, or None; the key becomes the most recently used one."""
        with _lock:
            value = self._values.get(key)
            if value is not None:
                # `move_to_end` keeps the stored key; the caller's equal key may change later.
                self._values.move_to_end(key)
            return value

    def put(self, key: Hashable, value: _T) -> None:
        """Set the value of a key."""
        with _lock:
            self._values.pop(key, None)
            self._values[key] = value
            self._trim()

    def get_or_make(self, key: Hashable, make: Callable[[], _T]) -> _T:
        """Return the value of a key; make it if there is none. Threads that make it at once all get the first value."""
        cached = self.get(key)
        if cached is not None:
            return cached
        made = make()
        with _lock:
            value = self._values.setdefault(key, made)
            self._trim()
        return value

    def clear(self) -> None:
        """Remove all values."""
        with _lock:
            self._values.clear()

    @property
    def nbytes(self) -> float:
        """Number of bytes of all values."""
        with _lock:
            return sum(self._bytes_of(value) for value in self._values.values())

    def _trim(self) -> None:
        """Remove the least recently used values until the others are within the bounds."""
        for oldest in list(self._values)[:-1]:
            if len(self._values) <= self._most and self.nbytes <= self._most_bytes:
                break
            del self._values[oldest]
