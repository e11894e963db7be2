"""LRU cache: moving lights and views reuse meshes and tables."""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from warpdiff.core import forks

if TYPE_CHECKING:
    from collections.abc import Callable

_T = TypeVar("_T")
# One lock for all caches: their calls are short, and a fork waits for it.
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
        self._values: OrderedDict[Any, _T] = OrderedDict()

    def __contains__(self, key: Any) -> bool:
        return key in self._values

    def __len__(self) -> int:
        return len(self._values)

    def get(self, key: Any) -> _T | None:
        """The value of a key, which is then the most recently used one; None if there is none."""
        with _lock:
            value = self._values.get(key)
            if value is not None:
                # The key stays the one that was put, as the caller's may change.
                self._values.move_to_end(key)
            return value

    def put(self, key: Any, value: _T) -> None:
        """Set the value of a key."""
        with _lock:
            self._values.pop(key, None)
            self._values[key] = value
            self._trim()

    def get_or_make(self, key: Any, make: Callable[[], _T]) -> _T:
        """The value of a key, made now if there is none; of threads that make the same, all get the first one's."""
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
        """Remove the least recently used values until the rest is within bounds."""
        for oldest in list(self._values)[:-1]:
            if len(self._values) <= self._most and self.nbytes <= self._most_bytes:
                break
            del self._values[oldest]
