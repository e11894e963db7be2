"""Which device runs the kernels, and how a launch is cut into slices over threads."""

from __future__ import annotations

import copy
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
    _prepared: list[Any] = field(default_factory=list, init=False, repr=False, compare=False)
    _recorded: dict[int, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def launch(self, first: int, count: int, device: wp.Device) -> None:
        """Launch it for so many elements from the first on, on a GPU for each index by itself."""
        import warp as wp

        first, count = first // self.block, -(-count // self.block)
        if not device.is_cpu:
            inputs = [*self.inputs, first, 1] if self.in_runs else [*self.inputs, first]
            wp.launch(self.kernel, dim=count, inputs=inputs, outputs=self.outputs, device=device)
            return
        thread = threading.get_ident()
        recorded = self._recorded.get(thread)
        if recorded is None:
            self.prepare(device)
            recorded = self._recorded[thread] = self._of_a_thread()
        # A slice's launch takes a tenth of the time if only what is new of it is looked at.
        recorded.set_param_at_index_from_ctype(len(self.inputs), first)
        if self.in_runs:
            recorded.set_param_at_index_from_ctype(len(self.inputs) + 1, count)
        else:
            recorded.set_dim(count)
        recorded.launch()

    def prepare(self, device: wp.Device) -> None:
        """Get ready for launches on the CPU, as the first one takes longer."""
        import warp as wp

        if device.is_cpu and not self._prepared:
            inputs = [*self.inputs, 0, 1] if self.in_runs else [*self.inputs, 0]
            self._prepared.append(
                wp.launch(self.kernel, dim=1, inputs=inputs, outputs=self.outputs, device=device, record_cmd=True)
            )

    def _of_a_thread(self) -> Any:
        """A launch whose indices no other thread changes."""
        launched = copy.copy(self._prepared[0])
        launched.params = list(launched.params)
        for place in range(len(self.inputs) + 1, len(self.inputs) + 2 + self.in_runs):
            launched.params[place] = copy.copy(launched.params[place])
        return launched


class Work:
    """Some work for each item, which others begin with: the next one whenever a thread is free.

    As a context it is finished where that ends, and in between this thread does what neither needs that work nor is
    needed by it, and launches on this thread alone.
    """

    def __init__(
        self,
        work: Callable[[Any], None],
        items: Sequence[Any],
        *,
        threads: int,
        progress: Callable[[float], None] | None = None,
        joins: bool = False,
    ) -> None:
        """Begin on all threads but this one, to which the last item is left if it ``joins`` them at once."""
        self._work, self._left, self._count, self._progress = work, iter(items), len(items), progress
        self._lock = threading.Lock()
        self._done = 0
        self._others = [_pool(threads - 1).submit(self._run) for _ in range(min(threads - 1, len(items) - joins))]

    def _run(self) -> None:
        """Work until none is left."""
        while True:
            with self._lock:
                item = next(self._left, None)
            if item is None:
                return
            try:
                self._work(item)
            except BaseException:
                self._drop()
                raise
            with self._lock:
                self._done += 1
                if self._progress is not None:
                    self._progress(self._done / self._count)

    def _drop(self) -> None:
        """Leave what nobody has begun with."""
        with self._lock:
            self._left = iter(())

    def _await(self) -> None:
        """Wait for those that have begun."""
        for other in self._others:
            other.cancel()
        wait(self._others)

    def finish(self) -> None:
        """Take part in it until all is done, and raise what was raised; the first error ends it."""
        try:
            self._run()
        finally:
            self._await()
        for other in self._others:
            if not other.cancelled():
                other.result()

    def abandon(self) -> None:
        """End it where it is, whatever was raised."""
        self._drop()
        self._await()

    def __enter__(self) -> Work:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.finish()
        else:
            self.abandon()


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


def launch_in_turn(steps: Sequence[Step], elements: int | range, **options: Any) -> None:
    """Launch kernels of which each reads of an element what those before it wrote of the same one.

    See :func:`begin_in_turn`.
    """
    begin_in_turn(steps, elements, joins=True, **options).finish()


def begin_in_turn(
    steps: Sequence[Step],
    elements: int | range,
    *,
    device: wp.Device,
    threads: int,
    least_slice: int = _LEAST_SLICE,
    most_slice: int = _MOST_SLICE,
    progress: Callable[[float], None] | None = None,
    joins: bool = False,
) -> Work:
    """Begin to launch such kernels.

    A launch on the CPU is a serial loop that releases the interpreter lock, so slices run side by side on threads, each
    through all kernels; every index is computed by itself, and the result depends neither on the threads' number nor on
    the slices. On a GPU all is launched at once.

    Args:
        steps: The kernels.
        elements: Their number, or a range that begins with a whole block.
        device: Where.
        threads: At most so many.
        least_slice: Elements that are worth a launch.
        most_slice: As many as progress is smooth by.
        progress: Called with the share that is done.
        joins: Whether this thread takes part in it at once.
    """
    import warp as wp

    among = range(elements) if isinstance(elements, int) else elements
    if not len(among) and progress is not None:
        progress(1.0)
    if not device.is_cpu and len(among):
        # Launches of a frame queue up; whoever reads their results waits for them.
        for step in steps:
            step.launch(among.start, len(among), device)
        if progress is not None:
            wp.synchronize_device(device)
            progress(1.0)
    slices: list[range] = []
    if device.is_cpu and len(among):
        block = math.lcm(*(step.block for step in steps))
        slices = list(slices_of(len(among), least=least_slice, most=most_slice, threads=threads, block=block))
        load_now([step.kernel for step in steps], device)

    def run(part: range) -> None:
        for step in steps:
            step.launch(among.start + part.start, len(part), device)

    return Work(run, slices, threads=threads, progress=progress, joins=joins)


def slices_of(size: int, *, least: int, most: int, threads: int, block: int = 1) -> Iterator[range]:
    """Slices that get smaller, so that threads finish together, of whole blocks but for the last."""
    first = 0
    while first < size:
        count = min(max((size - first) // (2 * threads), least), most)
        end = min(first + -(-count // block) * block, size)
        yield range(first, end)
        first = end


def side_by_side(work: Callable[[Any], None], items: Sequence[Any], *, threads: int) -> None:
    """Do some work for each item, the next one whenever a thread is free."""
    Work(work, items, threads=threads, joins=True).finish()


@functools.cache
def _loaders() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=_LOADERS, thread_name_prefix="warpdiff-load")


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Threads that stay: to start them takes as long as a small launch."""
    return ThreadPoolExecutor(max_workers=threads, thread_name_prefix="warpdiff")
