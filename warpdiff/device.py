"""Which device runs the kernels, and how a launch is cut into slices over threads."""

from __future__ import annotations

import functools
import math
import os
import threading
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from warpdiff import checks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import warp as wp

# Of a launch: no smaller than what it costs, and no larger than what progress is smooth by.
_LEAST_SLICE, _MOST_SLICE = 512, 32_768
_LOADERS = 2
_loading: dict[Any, Future[Any]] = {}
_load_once = threading.Lock()


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
    with _load_once:
        for kernel in kernels:
            if kernel.module not in _loading:
                # What launches on the CPU take is the module for blocks of one.
                _loading[kernel.module] = _loaders().submit(kernel.module.load, device, 1)
        return [_loading[kernel.module] for kernel in kernels]


def load_now(kernels: Sequence[Any], device: wp.Device) -> None:
    """Wait for kernels: threads must not race to compile."""
    for loaded in load(kernels, device):
        loaded.result()


@dataclass(frozen=True)
class Step:
    """A kernel with its arguments.

    Attributes:
        kernel: Its last input is ``first``, the index of its first thread.
        inputs: Those before ``first``.
        outputs: What it writes.
        in_runs: Whether a number ``run`` of indices for each thread comes after ``first``: a thread on the CPU takes
            its arguments, a kilobyte of them for some kernels, once for all of a slice rather than once for each index.
        block: How many elements one index stands for.
    """

    kernel: Any
    inputs: list[Any]
    outputs: list[Any]
    in_runs: bool = False
    block: int = 1
    _recorded: dict[int, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def launch(self, first: int, count: int, device: wp.Device) -> None:
        """Launch it for so many elements from the first on, on a GPU for each index by itself."""
        import warp as wp

        first, count = first // self.block, -(-count // self.block)
        alone = self.in_runs and device.is_cpu
        indices = [first, count if alone else 1] if self.in_runs else [first]
        thread = threading.get_ident()
        if thread not in self._recorded:
            size, inputs = 1 if alone else count, [*self.inputs, *indices]
            launched = wp.launch(
                self.kernel, dim=size, inputs=inputs, outputs=self.outputs, device=device, record_cmd=device.is_cpu
            )
            if not device.is_cpu:
                return
            self._recorded[thread] = launched
        # A slice's launch takes a third of the time if only what is new of it is looked at.
        recorded = self._recorded[thread]
        for place, index in enumerate(indices, start=len(self.inputs)):
            recorded.set_param_at_index(place, index)
        if not alone:
            recorded.set_dim(count)
        recorded.launch()


def launch(
    kernel: Any,
    size: int,
    inputs: list[Any],
    outputs: list[Any],
    *,
    in_runs: bool = False,
    **options: Any,
) -> None:
    """Launch one kernel: see :class:`Step` and, for the options, :func:`launch_in_turn`."""
    launch_in_turn([Step(kernel, inputs, outputs, in_runs)], size, **options)


def launch_in_turn(
    steps: Sequence[Step],
    size: int,
    *,
    device: wp.Device,
    threads: int,
    least_slice: int = _LEAST_SLICE,
    progress: Callable[[float], None] | None = None,
    meanwhile: Callable[[], object] | None = None,
) -> None:
    """Launch kernels of which each reads of an element what those before it wrote of the same one.

    A launch on the CPU is a serial loop that releases the interpreter lock, so slices run side by side on threads, each
    through all kernels; every index is computed by itself, and the result depends neither on the threads' number nor on
    the slices. ``meanwhile`` is as :func:`side_by_side` has it.
    """
    import warp as wp

    if (size == 0 or not device.is_cpu) and meanwhile is not None:
        meanwhile()
    if size == 0:
        return
    if not device.is_cpu:
        # Launches of a frame queue up; whoever reads their results waits for them.
        for step in steps:
            step.launch(0, size, device)
        if progress is not None:
            wp.synchronize_device(device)
            progress(1.0)
        return
    block = math.lcm(*(step.block for step in steps))
    slices = list(slices_of(size, least=least_slice, most=_MOST_SLICE, threads=threads, block=block))
    load_now([step.kernel for step in steps], device)

    def run(part: range) -> None:
        for step in steps:
            step.launch(part.start, len(part), device)

    side_by_side(run, slices, threads=threads, progress=progress, meanwhile=meanwhile)


def slices_of(size: int, *, least: int, most: int, threads: int, block: int = 1) -> Iterator[range]:
    """Slices that get smaller, so that threads finish together, of whole blocks but for the last."""
    first = 0
    while first < size:
        count = min(max((size - first) // (2 * threads), least), most)
        end = min(first + -(-count // block) * block, size)
        yield range(first, end)
        first = end


def side_by_side(
    work: Callable[[Any], None],
    items: Sequence[Any],
    *,
    threads: int,
    progress: Callable[[float], None] | None = None,
    meanwhile: Callable[[], object] | None = None,
) -> None:
    """Do some work for each item, the next one whenever a thread is free.

    This thread first does what is called for ``meanwhile``, which neither needs that work nor is needed by it, and
    launches on this thread alone.
    """
    left = iter(items)
    lock = threading.Lock()
    done = 0

    def run() -> None:
        """Work until none is left."""
        nonlocal done
        while True:
            with lock:
                item = next(left, None)
            if item is None:
                return
            work(item)
            with lock:
                done += 1
                if progress is not None:
                    progress(done / len(items))

    # This thread is one of them: to hand an item over and wait for it takes as long as a small one.
    others = [_pool(threads - 1).submit(run) for _ in range(min(threads - 1, len(items) - (meanwhile is None)))]
    try:
        if meanwhile is not None:
            meanwhile()
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
