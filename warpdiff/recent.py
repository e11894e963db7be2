"""What was made lately and may be asked for again, as a light or a view that moves needs the same mesh and tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

_T = TypeVar("_T")


def found_again(kept: dict[Any, _T], key: Any, make: Callable[[], _T], *, most: int) -> _T:
    """What is kept under a key, or made now; of more than ``most``, what was not asked for longest goes."""
    # Others may be at it, too.
    try:
        result = kept.pop(key)
    except KeyError:
        result = make()
    kept[key] = result
    while len(kept) > most:
        kept.pop(next(iter(kept)), None)
    return result
