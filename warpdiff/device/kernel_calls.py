"""Pipelines of kernel calls: whole launches on a GPU, slices of elements that threads take one by one on the CPU."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import warp as wp

from warpdiff.core.threads import parallel_for
from warpdiff.device.devices import load_now, resolve_device

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


# Elements of a slice on the CPU, unless told: what the launches cost is little against them.
ELEMENTS_OF_SLICE = 512
# A thread takes slices until they are so many elements, or such a share of all for each thread, before it looks whether
# it was interrupted and tells of progress.
_MOST_AT_A_TIME, _TURNS_PER_THREAD = 32_768, 4


@dataclass(frozen=True)
class KernelCall:
    """A kernel with its arguments.

    Attributes:
        kernel: Its last input is ``first``, the index of its first thread.
        inputs: Those before ``first``.
        outputs: What it writes.
        in_runs: Whether a number ``run`` of indices for each thread comes after ``first``: a thread on the CPU takes
            its arguments, a kilobyte of them for some kernels, once for all of a slice rather than once for each index.
        block: How many elements one index stands for.
        free: What Warp has recorded of it, which is kept as long as this, and no thread has.
    """

    kernel: Any
    inputs: list[Any]
    outputs: list[Any]
    in_runs: bool = False
    block: int = 1
    free: list[_Recorded] = field(default_factory=list, init=False, repr=False, compare=False)

    def launch(self, elements: range, device: wp.Device) -> None:
        """Launch it for each index by itself."""
        inputs = self.arguments(elements.start // self.block, 1)
        wp.launch(self.kernel, -(-len(elements) // self.block), inputs, self.outputs, device=device)

    def arguments(self, first: int, run: int) -> list[Any]:
        """All inputs for threads from the index ``first`` on."""
        return [*self.inputs, first, run] if self.in_runs else [*self.inputs, first]

    def recorded(self) -> _Recorded:
        """What this thread launches it by, until it is given back."""
        try:
            return self.free.pop()
        except IndexError:
            return _Recorded(self)


class _Recorded:
    """A kernel call that Warp has recorded, for one thread at a time."""

    def __init__(self, step: KernelCall) -> None:
        self._block, self._in_runs, self._first = step.block, step.in_runs, len(step.inputs)
        values = [*step.arguments(0, 1), *step.outputs]
        self._launch = wp.launch(step.kernel, 1, values, device="cpu", record_cmd=True)

    def run(self, begin: int, end: int) -> None:
        """Launch it over elements."""
        first, behind = begin // self._block, -(-end // self._block)
        self._launch.set_param_at_index_from_ctype(self._first, first)
        if self._in_runs:
            self._launch.set_param_at_index_from_ctype(self._first + 1, behind - first)
        else:
            self._launch.set_dim(behind - first)
        self._launch.launch()


class Pipeline:
    """Kernel calls one after the other on the CPU."""

    def __init__(self, steps: Sequence[KernelCall]) -> None:
        """Get ready to call them, once they are compiled."""
        load_now([step.kernel for step in steps], resolve_device(None))
        self._steps = steps

    def launch(self, elements: range) -> None:
        """Launch them over elements on this thread."""
        self.slices(elements, len(elements), 1)()

    def slices(self, elements: range, size: int, at_a_time: int) -> Callable[[], None]:
        """A function that takes the next slices of elements through them, so many of them, on any thread."""
        begins, lock = iter(elements[::size]), threading.Lock()

        def take() -> None:
            calls = [step.recorded() for step in self._steps]
            for _ in range(at_a_time):
                with lock:
                    begin = next(begins, None)
                if begin is None:
                    break
                for call in calls:
                    call.run(begin, min(begin + size, elements.stop))
            for step, call in zip(self._steps, calls, strict=True):
                step.free.append(call)

        return take


def launch(
    kernel: Any,
    size: int,
    inputs: list[Any],
    outputs: list[Any],
    *,
    in_runs: bool = False,
    **options: Any,
) -> None:
    """Launch one kernel: see :class:`KernelCall` and, for the options, :func:`launch_pipeline`."""
    launch_pipeline([KernelCall(kernel, inputs, outputs, in_runs)], size, **options)


def launch_pipeline(
    steps: Sequence[KernelCall],
    elements: int | range,
    *,
    device: wp.Device,
    threads: int,
    slice_size: int = ELEMENTS_OF_SLICE,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Launch kernels of which each reads of an element what those before it wrote of the same one.

    A launch on the CPU is a serial loop that releases the interpreter lock, so slices run side by side on threads, each
    through all kernels; every index is computed by itself, and the result depends neither on the threads' number nor on
    the slices. On a GPU, and where launches are recorded, all is launched at once.

    Args:
        steps: The kernels.
        elements: Their number, or a range that begins with a whole block.
        device: Where.
        threads: At most so many.
        slice_size: Elements that go through the kernels together, rounded up to whole blocks.
        progress: Called with the share that is done.
    """
    among = range(elements) if isinstance(elements, int) else elements
    if among and device.is_cpu and not device.is_capturing:
        block = math.lcm(*(step.block for step in steps))
        size = -(-slice_size // block) * block
        slices = -(-len(among) // size)
        at_a_time = max(min(_MOST_AT_A_TIME // size, slices // (_TURNS_PER_THREAD * threads)), 1)
        take = Pipeline(steps).slices(among, size, at_a_time)
        # Whoever has taken so many helps those that have not.
        times = -(-slices // at_a_time) + (threads - 1 if at_a_time > 1 else 0)
        parallel_for(lambda _: take(), range(times), threads=threads, progress=progress)
        return
    for step in steps if among else ():
        step.launch(among, device)
    if progress is not None:
        # Launches of a frame queue up; whoever reads their results waits for them.
        wp.synchronize_device(device)
        progress(1.0)
