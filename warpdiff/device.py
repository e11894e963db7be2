"""Which device runs the kernels, on how many threads, and when they are compiled."""

from __future__ import annotations

import functools
import os
import tempfile
import threading
import warnings
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

from warpdiff import checks
from warpdiff.errors import WarpdiffWarning

if TYPE_CHECKING:
    from collections.abc import Sequence

    import warp as wp

_LOADERS = 2
_loading: dict[Any, Future[Any]] = {}
_load_once = threading.Lock()


def resolve_device(device: Any) -> wp.Device:
    """The Warp device of a name such as ``"cpu"`` or ``"cuda:0"``; None is the CPU."""
    import warp as wp

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
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return checks.count(threads, "threads")


def load(kernels: Sequence[Any], device: wp.Device) -> list[Future[Any]]:
    """Begin to compile kernels for the CPU, or to load them where they are compiled, side by side with what follows.

    The first time a thread compiles it takes seconds for Warp's headers, and two threads do so at the same time.
    """
    if not device.is_cpu:
        return []
    from warpdiff.kernels import in_turn

    # Those that begin at once, and then what launches any of them.
    in_order = [*kernels[:_LOADERS], in_turn.run, *kernels[_LOADERS:]]
    with _load_once:
        for kernel in in_order:
            if kernel.module not in _loading:
                # What launches on the CPU take is the module for blocks of one.
                _loading[kernel.module] = _loaders().submit(_load, kernel.module, device)
        return [_loading[kernel.module] for kernel in in_order]


def load_now(kernels: Sequence[Any], device: wp.Device) -> None:
    """Wait for kernels: threads must not race to compile."""
    for loaded in load(kernels, device):
        loaded.result()


@functools.cache
def _loaders() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=_LOADERS, thread_name_prefix="warpdiff-load")


def _load(module: Any, device: wp.Device) -> None:
    try:
        module.load(device, 1)
    except OSError as error:
        raise _unkept(error) from error


def _unkept(error: OSError) -> OSError:
    return OSError(f"Warp cannot keep compiled kernels: {error}; name a folder for them in WARP_CACHE_PATH")


def _has_cache_folder() -> bool:
    return bool(os.environ.get("XDG_CACHE_HOME")) or os.path.expanduser("~") != "~"  # noqa: PTH111 (as Warp does)


@functools.cache
def _own_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder for compiled kernels that goes with the process."""
    warnings.warn(
        "the user has no home folder: kernels are compiled anew by each process; name a folder for them in "
        "WARP_CACHE_PATH",
        WarpdiffWarning,
        stacklevel=2,
    )
    return tempfile.TemporaryDirectory(prefix="warpdiff-kernels-")
