"""Pipelines of kernel calls: whole launches on a GPU, slices of elements that threads take one by one on the CPU."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.compute.device import load_now, resolve_device
from warpdiff.core.thread_pool import Work
from warpdiff.kernels import launch_slices

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


# Elements of a slice on the CPU, unless told: what the launches cost is little against them.
_ELEMENTS_OF_SLICE = 512
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
    """

    kernel: Any
    inputs: list[Any]
    outputs: list[Any]
    in_runs: bool = False
    block: int = 1
    _native: list[tuple[list[int], Any, _Call]] = field(default_factory=list, init=False, repr=False, compare=False)

    def launch(self, elements: range, device: wp.Device) -> None:
        """Launch it for each index by itself."""
        inputs = self._inputs(elements.start // self.block)
        wp.launch(self.kernel, -(-len(elements) // self.block), inputs, self.outputs, device=device)

    def _inputs(self, first: int) -> list[Any]:
        return [*self.inputs, first, 1] if self.in_runs else [*self.inputs, first]

    def native(self) -> list[int]:
        """The numbers that :mod:`warpdiff.kernels.launch_slices` takes on the CPU; what they point at stays."""
        if not self._native:
            values = [*self._inputs(0), *self.outputs]
            call = _call_of(self.kernel, values)
            arguments = call.arguments(values)
            of_run = call.offset("run") if self.in_runs else -1
            row = [
                call.function, ctypes.addressof(call.bounds), ctypes.addressof(arguments), ctypes.sizeof(arguments),
                call.offset("first"), of_run, self.block,
            ]  # fmt: skip
            self._native.append((row, arguments, call))
        return self._native[0][0]


class _Call:
    """How Warp calls a kernel for one index on the CPU, which a launch tells.

    Attributes:
        call: The function, which takes pointers to two structs, bounds and arguments.
        function: Its address.
        bounds: The struct for one index.
    """

    def __init__(self, kernel: Any, values: Sequence[Any]) -> None:
        """Launch it without effect, with arguments that Warp checks."""
        recorded = wp.launch(kernel, 1, values, device=resolve_device(None), record_cmd=True)
        hooks, recorded.hooks = recorded.hooks, self
        recorded.launch()
        self.call = hooks.forward
        self.function = int(ctypes.cast(self.call, ctypes.c_void_p).value or 0)
        # So that it is not unloaded; what the launch holds may go.
        self._code = recorded.module_exec

    def forward(self, bounds: Any, arguments: Any) -> None:
        """Called by Warp in place of the function."""
        self.bounds, self._struct = bounds._obj, type(arguments._obj)

    def arguments(self, values: Sequence[Any]) -> Any:
        """The struct of arguments of the same types."""
        result = self._struct()
        for (name, _), value in zip(self._struct._fields_, values, strict=True):
            if value is not None:
                setattr(result, name, value.__ctype__() if hasattr(value, "__ctype__") else value)
        return result

    def offset(self, name: str) -> int:
        """The offset of an argument among all of them [bytes]."""
        found: int = getattr(self._struct, name).offset
        return found


# By the kernel, and the types of arguments that Warp has checked.
_calls: dict[tuple[Any, ...], _Call] = {}


def _call_of(kernel: Any, values: Sequence[Any]) -> _Call:
    """How a kernel is called with values: to ask Warp takes longer than a launch."""
    types = tuple((each.dtype, each.ndim) if isinstance(each, wp.array) else type(each) for each in values)
    key = kernel, types
    # Of two threads that ask at once, both get the first one's.
    return _calls.get(key) or _calls.setdefault(key, _Call(kernel, values))


class Pipeline:
    """Kernel calls one after the other on the CPU, without the interpreter in between."""

    def __init__(self, steps: Sequence[KernelCall]) -> None:
        """Get ready to call them, once they are compiled."""
        load_now([step.kernel for step in steps], resolve_device(None))
        self.count = len(steps)
        self._steps, self._rows = steps, np.array([step.native() for step in steps], dtype=np.int64)
        self.address = self._rows.ctypes.data

    def launch(self, elements: range) -> None:
        """Launch them over elements on this thread."""
        _Slices(self, elements, slice_size=len(elements), at_a_time=1).take(0)


class _Slices:
    """Slices of elements, of which any thread takes the next ones through a pipeline."""

    def __init__(self, pipeline: Pipeline, elements: range, *, slice_size: int, at_a_time: int) -> None:
        self._pipeline, self._taken = pipeline, np.zeros(1, dtype=np.int32)
        values = [
            pipeline.address, pipeline.count, elements.start, elements.stop, slice_size, at_a_time,
            self._taken.ctypes.data,
        ]  # fmt: skip
        self._call = _call_of(launch_slices.run, values)
        self._arguments = self._call.arguments(values)

    def take(self, _: int) -> None:
        """Take so many slices, those that none has taken."""
        self._call.call(ctypes.byref(self._call.bounds), ctypes.byref(self._arguments))


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


def launch_pipeline(steps: Sequence[KernelCall], elements: int | range, **options: Any) -> None:
    """Launch kernels of which each reads of an element what those before it wrote of the same one.

    See :func:`begin_pipeline`.
    """
    begin_pipeline(steps, elements, joins=True, **options).finish()


def begin_pipeline(
    steps: Sequence[KernelCall],
    elements: int | range,
    *,
    device: wp.Device,
    threads: int,
    slice_size: int = _ELEMENTS_OF_SLICE,
    progress: Callable[[float], None] | None = None,
    joins: bool = False,
) -> Work:
    """Begin to launch such kernels.

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
        joins: Whether this thread takes part in it at once.
    """
    among = range(elements) if isinstance(elements, int) else elements
    if not among:
        if progress is not None:
            progress(1.0)
        return _NOTHING
    if not device.is_cpu or device.is_capturing:
        # Launches of a frame queue up; whoever reads their results waits for them.
        for step in steps:
            step.launch(among, device)
        if progress is not None:
            wp.synchronize_device(device)
            progress(1.0)
        return _NOTHING
    block = math.lcm(*(step.block for step in steps))
    size = -(-slice_size // block) * block
    slices = -(-len(among) // size)
    at_a_time = max(min(_MOST_AT_A_TIME // size, slices // (_TURNS_PER_THREAD * threads)), 1)
    taken = _Slices(Pipeline(steps), among, slice_size=size, at_a_time=at_a_time)
    # Whoever has taken so many helps those that have not.
    times = -(-slices // at_a_time) + (threads - 1 if at_a_time > 1 else 0)
    return Work(taken.take, range(times), threads=threads, progress=progress, joins=joins)


_NOTHING = Work(lambda _: None, [], threads=1)
