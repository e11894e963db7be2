"""Choice of the Warp device and of the number of CPU threads; compilation and loading of kernels."""

from __future__ import annotations

import contextlib
import functools
import os
import sys
import tempfile
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TYPE_CHECKING

import warp as wp

from warpdiff.core import forks, validation
from warpdiff.core.threads import cores
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    import threading
    from collections.abc import Iterator, Sequence


# Largest number of threads that compile or load kernels at the same time. The number is small because each of these
# threads first reads Warp's headers, which takes seconds of computing time.
_LOADERS = 2
_loading: dict[wp.Module, Future[None]] = {}
# Longest time that ``os.fork`` waits for kernels that are being compiled or loaded [s]. It was chosen because a fork
# must not block for long. If the kernels are not ready by then, the child process refuses to run kernels.
_MOST_WAIT_S = 1.0


def resolve_device(device: str | wp.Device | None) -> wp.Device:
    """Return the Warp device of a name such as ``"cpu"``, ``"cuda"`` or ``"cuda:1"``; None is the CPU."""
    _refuse_cut_off()
    # By default, Warp prints a banner and a line for each module that it loads. With the log level of errors, Warp
    # prints neither.
    if wp.config.log_level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_ERROR
    if wp.config.kernel_cache_dir is None and "WARP_CACHE_PATH" not in os.environ and not _has_cache_folder():
        # If the user has no home folder, Warp would store compiled kernels in a new folder named "~" in the working
        # directory. A temporary folder is used instead.
        wp.config.kernel_cache_dir = _own_folder().name
    _start(asks_for_cuda=device is not None and "cpu" not in str(device))
    try:
        return wp.get_device("cpu" if device is None else device)
    except Exception as error:
        raise ArgumentValueError(
            f"{ref('device')} must be 'cpu', or 'cuda' on a machine with a CUDA device, got {device!r}"
        ) from error


@functools.cache
def _start(*, asks_for_cuda: bool) -> None:
    """Initialise Warp if that has not happened yet."""
    try:
        with contextlib.nullcontext() if asks_for_cuda else _without_driver_warning():
            wp.init()
    except OSError as error:
        raise _cache_error(error) from error


@contextlib.contextmanager
def _without_driver_warning() -> Iterator[None]:
    """Suppress Warp's warning that no CUDA driver exists.

    Warp's library writes the warning to standard error and has no option for it. All other lines are passed on.
    """
    try:
        stderr = os.dup(2)
    except OSError:  # standard error is closed
        yield
        return
    with tempfile.TemporaryFile() as lines:
        os.dup2(lines.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            lines.seek(0)
            for line in lines:
                if b"NVIDIA CUDA driver" not in line:
                    os.write(2, line)


def resolve_threads(threads: int | None) -> int:
    """Return the number of threads; None selects one per core that this process may use."""
    if threads is None:
        return cores()
    return validation.count(threads, "threads")


def load(kernels: Sequence[wp.Kernel], device: wp.Device) -> list[Future[None]]:
    """Start to compile or load kernels for the CPU on other threads; return a future for each kernel.

    For a GPU, nothing is started, and the list is empty. At most `_LOADERS` threads compile, because the first
    compilation on each thread reads Warp's headers, which takes seconds.
    """
    if not device.is_cpu:
        return []
    _refuse_cut_off()
    with _load_lock:
        for kernel in kernels:
            if kernel.module not in _loading:
                _loading[kernel.module] = _loaders().submit(_load, kernel.module, device)
        return [_loading[kernel.module] for kernel in kernels]


def load_now(kernels: Sequence[wp.Kernel], device: wp.Device) -> None:
    """Compile or load kernels, and wait until they are ready. Threads that launch them later need not compile them."""
    for loaded in load(kernels, device):
        loaded.result()


@functools.cache
def _loaders() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(min(_LOADERS, cores()), thread_name_prefix="warpdiff-load")


def _load(module: wp.Module, device: wp.Device) -> None:
    try:
        # Warp launches kernels on the CPU in blocks of one thread. Kernels are compiled for this block size.
        wp.load_module(module, device, block_dim=1)
    except OSError as error:
        raise _cache_error(error) from error


def _cache_error(error: OSError) -> OSError:
    return OSError(f"Warp cannot write compiled kernels: {error}; set WARP_CACHE_PATH to a writable folder")


def _has_cache_folder() -> bool:
    return bool(os.environ.get("XDG_CACHE_HOME")) or os.path.expanduser("~") != "~"  # noqa: PTH111 (as Warp does)


@functools.cache
def _own_folder() -> tempfile.TemporaryDirectory[str]:
    """Folder for compiled kernels, which is deleted at the end of the process."""
    warn(
        "the user has no home folder, so that every process compiles the kernels again: set WARP_CACHE_PATH to a "
        "writable folder"
    )
    return tempfile.TemporaryDirectory(prefix="warpdiff-kernels-")


# Descriptions of compilations and imports that other threads had not finished when this process was forked, for error
# messages. A fork copies only the calling thread, so that this work never finishes in the child process.
_cut_off: list[str] = []


def _refuse_cut_off() -> None:
    """Raise an error if this process was forked while another thread compiled kernels or imported a module.

    Without the error, kernels of this process would wait forever for the end of this compilation or import.
    """
    if _cut_off:
        raise RuntimeError(f"this process was forked while a thread {_cut_off[0]}: {forks.REMEDY}")


def codegen_lock() -> threading.Lock | None:
    """Return the lock that Warp uses while it parses kernels, or None if Warp is not imported or has no such lock.

    The lock is undocumented. If another thread holds the lock during a fork, the child process would wait for ever for
    its release.
    """
    lock = getattr(sys.modules.get("warp._src.codegen"), "_codegen_lock", None)
    return lock if hasattr(lock, "acquire") and hasattr(lock, "release") else None


# While this process forks, the list has one element: the lock that Warp holds while it parses kernels. Otherwise the
# list is empty.
_acquired: list[threading.Lock] = []
# Futures for a forked child process, one for each Warp module whose kernels were loaded before the fork. The original
# futures cannot be used in the child process, because another thread may hold their locks during the fork.
_loaded: dict[wp.Module, Future[None]] = {}


def _before_fork() -> None:
    """Wait for kernels that are being compiled or loaded, up to a time limit, and store which of them are loaded."""
    done, _ = wait(_loading.values(), timeout=_MOST_WAIT_S)
    for module, loading in _loading.items():
        if loading in done:
            _loaded[module] = Future()
            # The new future for the child process gets the exception of the original future: None if the kernels were
            # loaded without error.
            _loaded[module].set_exception(loading.exception())
    lock = codegen_lock()
    if lock is not None and lock.acquire(timeout=_MOST_WAIT_S):
        _acquired.append(lock)


def _release() -> None:
    _loaded.clear()
    while _acquired:
        _acquired.pop().release()


def _in_child() -> None:
    """Update the state of a forked child process, in which the other threads of the parent do not exist.

    Afterwards, `_loading` has usable futures for the Warp modules whose kernels are loaded. `_cut_off` lists the work
    of the other threads that will never finish.
    """
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


# Python calls functions that are registered for a fork in reverse order. First, `finish_imports` waits until other
# threads have finished their imports. Second, this process acquires `_load_lock`, so that no other thread can load
# kernels. Third, `_before_fork` waits for kernels that are being loaded.
forks.at_fork(before=_before_fork, after_in_parent=_release, after_in_child=_in_child)
_load_lock = forks.lock()
forks.at_fork(before=forks.finish_imports)
