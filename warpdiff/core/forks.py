"""Fork safety: a fork waits for locks and imports of other threads, because a child process has none of them."""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import threading
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

_T = TypeVar("_T")
# Packages that are imported at first use, so that another thread may be importing one during a fork.
_SLOW_PACKAGES = {"OpenImageIO", "PIL", "colour", "numpy", "scipy", "trimesh", "warp", "warpdiff"}
REMEDY = "start processes with multiprocessing.get_context('spawn'), or fork where no other thread compiles or renders"


def at_fork(**functions: Callable[[], object]) -> None:
    """Call ``os.register_at_fork`` with these arguments, on systems that can fork."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(**functions)


def lock() -> threading.RLock:
    """Return a lock that a fork waits for. A thread that has it must not take another lock or import a module."""
    result = threading.RLock()
    at_fork(before=result.acquire, after_in_parent=result.release, after_in_child=result.release)
    return result


class cached_property(functools.cached_property[_T]):  # noqa: N801 (named after the standard library's)
    """Cached property without the lock that Python 3.11 shares between all objects; two threads may both compute it."""

    def __init__(self, compute: Callable[..., _T]) -> None:
        super().__init__(compute)
        self.lock = contextlib.nullcontext()


def importing() -> list[str]:
    """Return the slow modules that other threads are importing; a child process would wait for them for ever.

    Python documents no way to find them. If a Python version stores its import locks elsewhere, the list is empty, and
    a fork during another thread's imports has the same risk as without this package.
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
    """Wait until no other thread is importing a slow module."""
    while names := importing():
        for name in names:
            # If the import fails, the other thread raises the error.
            with contextlib.suppress(ImportError):
                importlib.import_module(name)


at_fork(before=finish_imports)
