"""Which device runs the kernels, and how a launch is cut into slices over threads."""

from __future__ import annotations

import functools
import os
import threading
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TYPE_CHECKING, Any

from warpdiff import checks

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import warp as wp

# Enough slices that threads finish together and progress is smooth, and no smaller than what a launch costs.
_SLICES_A_THREAD = 12
_LEAST_SLICE, _MOST_SLICE = 512, 32_768
_LOADERS = 2
_loading: dict[Any, Future[Any]] = {}


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


def load(kernels: Sequence[Any], device: wp.Device) -> list[Future[Any]]:
    """Begin to compile kernels for the CPU, or to load them where they are compiled, side by side with what follows.

    The first time a thread compiles it takes seconds for Warp's headers, and two threads do so at the same time.
    """
    if not device.is_cpu:
        return []
    for kernel in kernels:
        if kernel.module not in _loading:
            # What launches on the CPU take is the module for blocks of one.
            _loading[kernel.module] = _loaders().submit(kernel.module.load, device, 1)
    return [_loading[kernel.module] for kernel in kernels]


def launch(
    kernel: Any,
    size: int,
    inputs: list[Any],
    outputs: list[Any],
    *,
    device: wp.Device,
    threads: int,
    slice_size: int | None = None,
    in_runs: bool = False,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Launch a kernel whose last input is ``first``, the index of its first thread.

    If ``in_runs`` a number ``run`` of indices for each thread comes after it: a thread on the CPU takes its arguments,
    a kilobyte of them for some kernels, once for all of a slice rather than once for each index.

    A launch on the CPU is a serial loop that releases the interpreter lock, so slices run side by side on threads;
    every index is computed by itself, and the result depends neither on their number nor on the slices' size.
    """
    import warp as wp

    if size == 0:
        return
    if not device.is_cpu:
        # Launches of a frame queue up; whoever reads their results waits for them.
        wp.launch(kernel, dim=size, inputs=[*inputs, 0, 1] if in_runs else [*inputs, 0], outputs=outputs, device=device)
        if progress is not None:
            wp.synchronize_device(device)
            progress(1.0)
        return
    if slice_size is None:
        slice_size = min(max(size // (_SLICES_A_THREAD * threads), _LEAST_SLICE), _MOST_SLICE)
    # Threads must not race to compile.
    load([kernel], device)[0].result()
    firsts = range(0, size, slice_size)
    left = iter(firsts)
    lock = threading.Lock()
    done = 0

    def run() -> None:
        """Launch slices until none is left."""
        nonlocal done
        while True:
            with lock:
                first = next(left, None)
            if first is None:
                return
            count = min(slice_size, size - first)
            indices = [first, count] if in_runs else [first]
            wp.launch(kernel, dim=1 if in_runs else count, inputs=[*inputs, *indices], outputs=outputs, device=device)
            with lock:
                done += 1
                if progress is not None:
                    progress(done / len(firsts))

    # This thread is one of them: to hand a slice over and wait for it takes as long as a small one.
    others = [_pool(threads - 1).submit(run) for _ in range(min(threads, len(firsts)) - 1)]
    try:
        run()
    finally:
        wait(others)
    for other in others:
        other.result()


@functools.cache
def _loaders() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=_LOADERS, thread_name_prefix="warpdiff-load")


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Threads that stay: to start them takes as long as a small launch."""
    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix="warpdiff")
