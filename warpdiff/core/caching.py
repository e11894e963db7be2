"""A small LRU cache: moving lights and views reuse meshes and tables."""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from warpdiff.core import forks

if TYPE_CHECKING:
    from collections.abc import Callable

_T = TypeVar("_T")
# One for all: what is asked takes no time, and a fork waits for it.
_lock = forks.lock()


class LruCache(Generic[_T]):
    """Values by their keys, of which the least recently used one goes first. Threads may share it.

    Args of its constructor: how many values it holds at most, how many bytes, and how many a value has. The last one
    that came stays, whatever its size.
    """

    def __init__(
        self, most: float = math.inf, most_bytes: float = math.inf, bytes_of: Callable[[_T], float] = lambda _: 0.0
    ) -> None:
        self._most, self._most_bytes, self._bytes_of = most, most_bytes, bytes_of
        self._held: OrderedDict[Any, _T] = OrderedDict()

    def __contains__(self, key: Any) -> bool:
        return key in self._held

    def __len__(self) -> int:
        return len(self._held)

    def get(self, key: Any) -> _T | None:
        """The value of a key, which is then the most recently used one; None if it is not there."""
        with _lock:
            found = self._held.get(key)
            if found is not None:
                # The key stays the one that was put, for which the caller's need not stay as it is.
                self._held.move_to_end(key)
            return found

    def put(self, key: Any, value: _T) -> None:
        """Set the value of a key."""
        with _lock:
            self._held.pop(key, None)
            self._held[key] = value
            self._trim()

    def get_or_make(self, key: Any, make: Callable[[], _T]) -> _T:
        """The value of a key, made now if it is not there. Others may make the same meanwhile: all get the first's."""
        found = self.get(key)
        if found is not None:
            return found
        made = make()
        with _lock:
            result = self._held.setdefault(key, made)
            self._trim()
        return result

    def clear(self) -> None:
        """Let all of them go."""
        with _lock:
            self._held.clear()

    def _trim(self) -> None:
        """Let the least recently used ones go until the rest is within bounds."""
        for oldest in list(self._held)[:-1]:
            size = sum(self._bytes_of(value) for value in self._held.values())
            if len(self._held) <= self._most and size <= self._most_bytes:
                break
            del self._held[oldest]
