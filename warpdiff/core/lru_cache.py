"""A small LRU cache: moving lights and views reuse meshes and tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

from warpdiff.core import fork_safety

if TYPE_CHECKING:
    from collections.abc import Callable

_T = TypeVar("_T")
_lock = fork_safety.lock()


def get_or_make(kept: dict[Any, _T], key: Any, make: Callable[[], _T], *, most: int) -> _T:
    """The value of a key, made now if it is not there; of more than ``most``, the least recently used one goes."""
    with _lock:
        found = key in kept
        if found:
            kept[key] = result = kept.pop(key)
    if not found:
        # Others may make the same meanwhile: all get the first one's.
        made = make()
        with _lock:
            result = kept.setdefault(key, made)
            while len(kept) > most:
                del kept[next(iter(kept))]
    return result
