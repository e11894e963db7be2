"""Fork safety: a fork of the process waits until other threads have released locks and finished imports.

A child process has none of its parent's other threads. If such a thread held a lock, the lock would never be released
in the child process.
"""

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
# Packages whose import is slow and happens at first use. When the process forks, another thread may be importing one of
# them.
_SLOW_PACKAGES = {"OpenImageIO", "PIL", "colour", "numpy", "scipy", "trimesh", "warp", "warpdiff"}
REMEDY = "start processes with multiprocessing.get_context('spawn'), or fork where no other thread compiles or renders"


def at_fork(**functions: Callable[[], object]) -> None:
    """Register functions by ``os.register_at_fork``, on operating systems that can fork a process."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(**functions)


def lock() -> threading.RLock:
    """Return a lock that a fork waits for.

    A thread that has acquired the lock must not acquire another lock or import a module, because this may deadlock.
    """
    result = threading.RLock()
    at_fork(before=result.acquire, after_in_parent=result.release, after_in_child=result.release)
    return result


class cached_property(functools.cached_property[_T]):  # noqa: N801 (named after the standard library's)
    """Cached property without a lock. Two threads may compute the value at the same time.

    In Python 3.11, ``functools.cached_property`` has one lock for all objects of a class. Threads that compute the
    properties of different objects would therefore wait for each other.
    """

    def __init__(self, compute: Callable[..., _T]) -> None:
        super().__init__(compute)
        self.lock = contextlib.nullcontext()


def importing() -> list[str]:
    """Return the names of the modules of `_SLOW_PACKAGES` that other threads are importing at the moment.

    A child process would wait forever for the locks of these imports. Python has no documented function that lists
    them. If a future Python stores its import locks elsewhere, the list is empty, and forks during imports may hang.
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
    """Wait until no other thread is importing a module of `_SLOW_PACKAGES`."""
    while names := importing():
        for name in names:
            # Importing the same module here waits until the other thread has imported it. If the import fails, the
            # other thread raises the error.
            with contextlib.suppress(ImportError):
                importlib.import_module(name)


at_fork(before=finish_imports)
