"""Forks of the process: locks and imports that they wait for, so that a child does not wait for threads it lacks."""

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
# Packages that are imported where they are used, perhaps by another thread just now.
_SLOW_PACKAGES = {"OpenImageIO", "PIL", "colour", "numpy", "scipy", "trimesh", "warp", "warpdiff"}
REMEDY = "start processes with multiprocessing.get_context('spawn'), or fork where no other thread compiles or renders"


def at_fork(**functions: Callable[[], object]) -> None:
    """Call functions around each fork, where processes can fork at all: the arguments of ``os.register_at_fork``."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(**functions)


def lock() -> threading.RLock:
    """Return a lock that a fork waits for. A thread that holds it must take no other one and import nothing."""
    result = threading.RLock()
    at_fork(before=result.acquire, after_in_parent=result.release, after_in_child=result.release)
    return result


class cached_property(functools.cached_property[_T]):  # noqa: N801 (named after the standard library's)
    """Cached property without the lock for all objects that Python 3.11 has: two threads may compute the same."""

    def __init__(self, compute: Callable[[Any], _T]) -> None:
        super().__init__(compute)
        self.lock = contextlib.nullcontext()


def importing() -> list[str]:
    """Slow modules that other threads are importing; a child would wait for them for ever.

    Python documents no way to find them. If another version of it keeps its locks elsewhere, the list is empty, and a
    fork during another thread's imports has the same risk as without this package.
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
    """Wait for the imports of other threads, and for those that they begin meanwhile."""
    while names := importing():
        for name in names:
            # The other thread reports an import that fails.
            with contextlib.suppress(ImportError):
                importlib.import_module(name)


at_fork(before=finish_imports)
