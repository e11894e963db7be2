"""Pipelines of kernel calls: several kernels in sequence over the same elements, such as the rays of a picture.

A GPU launches each kernel over all elements. On the CPU, threads process slices, which are ranges of the elements. A
kernel processes one element per index of its launch, or a block of elements.
"""

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


# On the CPU, the elements of a launch, such as the rays of a picture, are divided into slices. The value is the default
# number of elements per slice. It was chosen because launches of fewer elements have a larger overhead per element.
ELEMENTS_OF_SLICE = 512
# On the CPU, a thread processes several slices (ranges of elements) in one turn. Between turns it checks for interrupts
# and reports progress. `_MOST_AT_ONCE` is the largest number of elements per turn, and `_TURNS_PER_THREAD` is the least
# number of turns per thread. If `_MOST_AT_ONCE` is doubled, progress is reported half as often.
_MOST_AT_ONCE, _TURNS_PER_THREAD = 32_768, 4


@dataclass(frozen=True)
class KernelCall:
    """Warp kernel with its arguments, for launches over ranges of elements such as the rays of a picture.

    Attributes:
        kernel: Warp kernel. Its inputs end with ``first``, the index at which a launch begins, and with ``run`` if
            ``in_runs`` is True.
        inputs: Inputs before ``first``.
        outputs: Arrays that the kernel writes.
        in_runs: Whether the kernel has the input ``run``: the number of indices that one thread processes in a loop. On
            the CPU, this number is the size of a slice, a range of elements. The kernel's arguments, up to a kilobyte,
            are then read once per slice instead of once per index.
        block: Number of elements that the kernel processes per index, for example all subpixel cells of a pixel.
            ``first`` and ``run`` count blocks.
        free: Launches that Warp has recorded on the CPU for repeated use, and that no thread is using now.
    """

    kernel: wp.Kernel
    inputs: list[Any]
    outputs: list[wp.array]
    in_runs: bool = False
    block: int = 1
    free: list[_Recorded] = field(default_factory=list, init=False, repr=False, compare=False)

    def launch(self, elements: range, device: wp.Device) -> None:
        """Launch the kernel on a GPU, or record its launch in a CUDA graph. Each thread processes one index."""
        inputs = self.arguments(elements.start // self.block, 1)
        wp.launch(self.kernel, -(-len(elements) // self.block), inputs, self.outputs, device=device)

    def arguments(self, first: int, run: int) -> list[Any]:
        """Return all inputs of a kernel launch from the index ``first`` on. Each thread processes ``run`` indices."""
        return [*self.inputs, first, run] if self.in_runs else [*self.inputs, first]

    def recorded(self) -> _Recorded:
        """Return a recorded launch that no other thread is using. The caller must add it to ``free`` after use."""
        try:
            return self.free.pop()
        except IndexError:
            return _Recorded(self)


class _Recorded:
    """Recorded launch of a kernel call, for use by one thread at a time."""

    def __init__(self, step: KernelCall) -> None:
        self._block, self._in_runs, self._first = step.block, step.in_runs, len(step.inputs)
        values = [*step.arguments(0, 1), *step.outputs]
        self._launch = wp.launch(step.kernel, 1, values, device="cpu", record_cmd=True)

    def run(self, begin: int, end: int) -> None:
        """Launch the kernel over the elements from ``begin`` to ``end`` (excluded)."""
        first, stop = begin // self._block, -(-end // self._block)
        self._launch.set_param_at_index_from_ctype(self._first, first)
        if self._in_runs:
            self._launch.set_param_at_index_from_ctype(self._first + 1, stop - first)
        else:
            self._launch.set_dim(stop - first)
        self._launch.launch()


class Pipeline:
    """Sequence of kernel calls on the CPU."""

    def __init__(self, steps: Sequence[KernelCall]) -> None:
        """Store the kernel calls, and wait until their kernels are compiled."""
        load_now([step.kernel for step in steps], resolve_device(None))
        self._steps = steps

    def launch(self, elements: range) -> None:
        """Launch the kernels over a range of elements, on the calling thread alone."""
        self.slices(elements, len(elements), 1)()

    def slices(self, elements: range, size: int, at_once: int) -> Callable[[], None]:
        """Return a function that processes the next ``at_once`` slices with all kernels. A slice has ``size`` elements.

        Several threads may call the function at the same time. Each slice is processed once.
        """
        begins, lock = iter(elements[::size]), threading.Lock()

        def take() -> None:
            calls = [step.recorded() for step in self._steps]
            for _ in range(at_once):
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
    kernel: wp.Kernel, size: int, inputs: list[Any], outputs: list[wp.array], *, in_runs: bool = False, **options: Any
) -> None:
    """Launch one kernel: see :class:`KernelCall` and, for the options, :func:`launch_pipeline`."""
    launch_pipeline([KernelCall(kernel, inputs, outputs, in_runs)], size, **options)


def launch_pipeline(
    steps: Sequence[KernelCall], elements: int | range, *, device: wp.Device, threads: int,
    slice_size: int = ELEMENTS_OF_SLICE, progress: Callable[[float], None] | None = None,
) -> None:  # fmt: skip
    """Launch kernels in sequence. Results at an element may depend only on the same element of earlier kernels.

    On the CPU a launch is a serial loop that releases the interpreter lock. Threads therefore process slices (ranges of
    elements) in parallel, each slice through all kernels. The result depends neither on the number of threads nor on
    the slices. On a GPU, and while launches are recorded in a CUDA graph, each kernel is launched once over all
    elements.

    Args:
        steps: Kernel calls in their order.
        elements: Number of elements, or a range of them. The range starts at a multiple of ``KernelCall.block`` of each
            step.
        device: Warp device.
        threads: Largest number of threads on the CPU.
        slice_size: Number of elements per slice, rounded up to a common multiple of ``KernelCall.block`` of all steps.
        progress: Function that is called with the finished share of the slices, 0 to 1; None reports nothing.
    """
    indices = range(elements) if isinstance(elements, int) else elements
    if indices and device.is_cpu and not device.is_capturing:
        block = math.lcm(*(step.block for step in steps))
        size = -(-slice_size // block) * block
        slices = -(-len(indices) // size)
        at_once = max(min(_MOST_AT_ONCE // size, slices // (_TURNS_PER_THREAD * threads)), 1)
        take = Pipeline(steps).slices(indices, size, at_once)
        # Each call of ``take`` processes the next ``at_once`` slices, or fewer at the end. The operating system may
        # pause a thread just before its call. The slices of this call would then wait until the thread continues. There
        # is therefore one additional call for each other thread, which processes these slices.
        times = -(-slices // at_once) + (threads - 1 if at_once > 1 else 0)
        parallel_for(lambda _: take(), range(times), threads=threads, progress=progress)
        return
    for step in steps if indices else ():
        step.launch(indices, device)
    if progress is not None:
        # A caller that reports progress must first wait for the GPU. Other callers wait when they read the results.
        wp.synchronize_device(device)
        progress(1.0)
