"""Forks of the process: what they wait for, so that a child finds nothing held by threads that it lacks."""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import threading
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

_T = TypeVar("_T")
# What is imported where it is used, perhaps by another thread just now.
_SLOW_PACKAGES = {"OpenImageIO", "PIL", "colour", "numpy", "scipy", "trimesh", "warp", "warpdiff"}
REMEDY = "start processes with multiprocessing.get_context('spawn'), or fork where no other thread compiles or renders"


def at_fork(
    *,
    before: Callable[[], object] | None = None,
    in_parent: Callable[[], object] | None = None,
    in_child: Callable[[], object] | None = None,
) -> None:
    """Call functions around each fork, where processes can fork at all."""
    if hasattr(os, "register_at_fork"):
        given = {"before": before, "after_in_parent": in_parent, "after_in_child": in_child}
        os.register_at_fork(**{name: each for name, each in given.items() if each is not None})


def lock() -> threading.RLock:
    """A lock that a fork waits for. Whoever holds one takes no other one and imports nothing."""
    made = threading.RLock()
    at_fork(before=made.acquire, in_parent=made.release, in_child=made.release)
    return made


class cached_property(functools.cached_property[_T]):  # noqa: N801 (named after what it is)
    """A cached property without the lock for all objects that Python 3.11 has: two threads may compute the same."""

    def __init__(self, compute: Callable[[Any], _T]) -> None:
        super().__init__(compute)
        self.lock = contextlib.nullcontext()


def importing() -> list[str]:
    """Slow modules that other threads are importing; a child would wait for these for ever.

    Python documents no way to tell. Where another version of it keeps its locks elsewhere, nothing is told, and a fork
    during another thread's imports is as it is without this package.
    """
    try:
        locks = list(vars(importlib)["_bootstrap"]._module_locks.items())
        owners = {name: getattr(reference(), "owner", None) for name, reference in locks}
    except (AttributeError, KeyError, TypeError, ValueError):
        return []
    return [
        name
        for name, owner in owners.items()
        if owner not in (None, threading.get_ident()) and name.partition(".")[0] in _SLOW_PACKAGES
    ]


def finish_imports() -> None:
    """Wait for what other threads are importing, and for what they go on to import."""
    while names := importing():
        for name in names:
            # What cannot be imported is the other thread's to tell.
            with contextlib.suppress(ImportError):
                importlib.import_module(name)


at_fork(before=finish_imports)
