"""Which device runs the kernels, on how many threads, and when they are compiled."""

from __future__ import annotations

import functools
import os
import sys
import tempfile
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TYPE_CHECKING, Any

import warp as wp

from warpdiff.core import forks, validation
from warpdiff.core.threads import cores
from warpdiff.core.warnings import warn

if TYPE_CHECKING:
    from collections.abc import Sequence


_LOADERS = 2
_loading: dict[Any, Future[Any]] = {}
# A fork waits so long for kernels that are being compiled or loaded.
_MOST_WAIT_S = 1.0


def resolve_device(device: Any) -> wp.Device:
    """The Warp device of a name such as ``"cpu"`` or ``"cuda:0"``; None is the CPU."""
    _refuse_cut_off()
    # Unless told otherwise before it starts, Warp prints a banner, a line a module, and that there is no CUDA driver.
    if wp.config.log_level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_ERROR
    if wp.config.kernel_cache_dir is None and "WARP_CACHE_PATH" not in os.environ and not _has_cache_folder():
        # In a name such as "~" Warp would find a folder to be made in the present one.
        wp.config.kernel_cache_dir = _own_folder().name
    try:
        wp.init()
    except OSError as error:
        raise _unkept(error) from error
    try:
        return wp.get_device("cpu" if device is None else device)
    except Exception as error:
        raise ValueError(f"device must be 'cpu' or a CUDA device of this machine, got {device!r}: {error}") from None


def resolve_threads(threads: Any) -> int:
    """The number of threads; None is one for each core this process may use."""
    if threads is None:
        return cores()
    return validation.count(threads, "threads")


def load(kernels: Sequence[Any], device: wp.Device) -> list[Future[Any]]:
    """Begin to compile kernels for the CPU, or to load them where they are compiled, side by side with what follows.

    The first time a thread compiles it takes seconds for Warp's headers, and two threads do so at the same time.
    """
    if not device.is_cpu:
        return []
    _refuse_cut_off()
    with _load_once:
        for kernel in kernels:
            if kernel.module not in _loading:
                # What launches on the CPU take is the module for blocks of one.
                _loading[kernel.module] = _loaders().submit(_load, kernel.module, device)
        return [_loading[kernel.module] for kernel in kernels]


def load_now(kernels: Sequence[Any], device: wp.Device) -> None:
    """Wait for kernels: threads must not race to compile."""
    for loaded in load(kernels, device):
        loaded.result()


@functools.cache
def _loaders() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(_LOADERS, cores()), thread_name_prefix="warpdiff-load")


def _load(module: Any, device: wp.Device) -> None:
    try:
        wp.load_module(module, device, block_dim=1)
    except OSError as error:
        raise _unkept(error) from error


def _unkept(error: OSError) -> OSError:
    return OSError(f"Warp cannot keep compiled kernels: {error}; name a folder for them in WARP_CACHE_PATH")


def _has_cache_folder() -> bool:
    return bool(os.environ.get("XDG_CACHE_HOME")) or os.path.expanduser("~") != "~"  # noqa: PTH111 (as Warp does)


@functools.cache
def _own_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder for compiled kernels that goes with the process."""
    warn(
        "the user has no home folder: kernels are compiled anew by each process; name a folder for them in "
        "WARP_CACHE_PATH"
    )
    return tempfile.TemporaryDirectory(prefix="warpdiff-kernels-")


# What another thread was at when this process was forked, and nobody in it will end.
_cut_off: list[str] = []


def _refuse_cut_off() -> None:
    """Refuse to wait for what nobody ends."""
    if _cut_off:
        raise RuntimeError(f"this process was forked while a thread {_cut_off[0]}: {forks.REMEDY}")


def codegen_lock() -> Any:
    """The lock that Warp, once it is imported, holds while it looks at kernels; None where a version has no such one.

    It is undocumented. Without it a child may be forked while another thread looks at kernels, and wait.
    """
    found = getattr(sys.modules.get("warp._src.codegen"), "_codegen_lock", None)
    return found if hasattr(found, "acquire") and hasattr(found, "release") else None


# Warp's lock, in a fork.
_held: list[Any] = []
# For a child, what had been loaded before a fork: each future has a lock, which another thread may hold just then.
_loaded: dict[Any, Future[Any]] = {}


def _before_fork() -> None:
    """Wait a little for what is being loaded."""
    done, _ = wait(_loading.values(), timeout=_MOST_WAIT_S)
    for module, loading in _loading.items():
        if loading in done:
            _loaded[module] = Future()
            # None is no error: it is then done, with no result.
            _loaded[module].set_exception(loading.exception())
    lock = codegen_lock()
    if lock is not None and lock.acquire(timeout=_MOST_WAIT_S):
        _held.append(lock)


def _release() -> None:
    _loaded.clear()
    while _held:
        _held.pop().release()


def _in_child() -> None:
    """Keep what is loaded, and know what is not."""
    _loaders.cache_clear()
    _cut_off.extend(f"imported {name}" for name in forks.importing())
    is_all_loaded = len(_loaded) == len(_loading)
    _loading.update(_loaded)
    _release()
    lock = codegen_lock()
    if not is_all_loaded or (lock and not lock.acquire(blocking=False)):
        _cut_off.append("compiled kernels")
    elif lock:
        lock.release()


# What is given last is called first: imports end, nothing else begins to load, and what is being loaded ends.
forks.at_fork(before=_before_fork, in_parent=_release, in_child=_in_child)
_load_once = forks.lock()
forks.at_fork(before=forks.finish_imports)
