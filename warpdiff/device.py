"""Which device runs the kernels, and how a launch is cut into slices over threads."""

from __future__ import annotations

import functools
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

from warpdiff import checks

if TYPE_CHECKING:
    from collections.abc import Callable

    import warp as wp

# Enough slices that threads finish together and progress is smooth, and no smaller than what a launch costs.
_SLICES_A_THREAD = 12
_LEAST_SLICE, _MOST_SLICE = 512, 32_768


def resolve_device(device: Any) -> wp.Device:
    """The Warp device of a name such as ``"cpu"`` or ``"cuda:0"``; None is the CPU."""
    import warp as wp

    # Unless told otherwise before it starts, Warp prints a banner, a line a module, and that there is no CUDA driver.
    if wp.config.log_level == wp.LOG_INFO:
        wp.config.log_level = wp.LOG_ERROR
    try:
        return wp.get_device("cpu" if device is None else device)
    except Exception as error:
        raise ValueError(f"device must be 'cpu' or a CUDA device of this machine, got {device!r}: {error}") from None


def resolve_threads(threads: Any) -> int:
    """The number of threads; None is one for each core this process may use."""
    if threads is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return checks.count(threads, "threads")


def launch(
    kernel: Any,
    size: int,
    inputs: list[Any],
    outputs: list[Any],
    *,
    device: wp.Device,
    threads: int,
    slice_size: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Launch a kernel whose last input is ``first``, the index of its first thread.

    A launch on the CPU is a serial loop that releases the interpreter lock, so slices run side by side on threads;
    every index is computed by itself, and the result depends neither on their number nor on the slices' size.
    """
    import warp as wp

    if size == 0:
        return
    if not device.is_cpu:
        wp.launch(kernel, dim=size, inputs=[*inputs, 0], outputs=outputs, device=device)
        wp.synchronize_device(device)
        if progress is not None:
            progress(1.0)
        return
    if slice_size is None:
        slice_size = min(max(size // (_SLICES_A_THREAD * threads), _LEAST_SLICE), _MOST_SLICE)
    # Threads must not race to compile; what launches on the CPU take is the module for blocks of one.
    kernel.module.load(device, 1)
    firsts = range(0, size, slice_size)
    lock = threading.Lock()
    done = 0

    def run(first: int) -> None:
        nonlocal done
        wp.launch(kernel, dim=min(slice_size, size - first), inputs=[*inputs, first], outputs=outputs, device=device)
        with lock:
            done += 1
            if progress is not None:
                progress(done / len(firsts))

    if threads == 1 or len(firsts) == 1:
        for first in firsts:
            run(first)
        return
    for _ in _pool(threads).map(run, firsts):
        pass


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Threads that stay: to start them takes as long as a small launch."""
    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix="warpdiff")
