"""Undocumented parts of Warp: how it calls compiled kernels, and a lock of its own.

Nothing needs it. Where a version of Warp does not fit what is asked here, calls of kernels are recorded launches, which
take the interpreter for each slice (see :mod:`warpdiff.compute.pipeline`), and a fork waits for no lock.
"""

from __future__ import annotations

import ctypes
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.kernels import launch_slices

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from warpdiff.compute.pipeline import KernelCall


def codegen_lock() -> Any:
    """The lock that Warp, once it is imported, holds while it looks at kernels; None where a version has no such one.

    Without it a child may be forked while another thread looks at kernels, and wait.
    """
    found = getattr(sys.modules.get("warp._src.codegen"), "_codegen_lock", None)
    return found if hasattr(found, "acquire") and hasattr(found, "release") else None


class DoesNotFit(Exception):  # noqa: N818 (it is no error: another way is taken)
    """This version of Warp calls kernels otherwise."""


class _Convention:
    """How Warp calls a kernel for one index on the CPU, which a launch tells.

    Attributes:
        call: The function, which takes pointers to two structs, bounds and arguments.
        function: Its address.
        bounds: The struct for one index.
    """

    def __init__(self, kernel: Any, values: Sequence[Any]) -> None:
        """Launch it without effect, with arguments that Warp checks."""
        recorded = wp.launch(kernel, 1, values, device="cpu", record_cmd=True)
        hooks = getattr(recorded, "hooks", None)
        self.call: Any = getattr(hooks, "forward", None)
        # So that it is not unloaded; what the launch holds may go.
        self._code = getattr(recorded, "module_exec", None)
        if self.call is None or self._code is None:
            raise DoesNotFit
        self._told: tuple[Any, ...] | None = None
        recorded.hooks = self
        try:
            recorded.launch()
        except (AttributeError, TypeError) as error:
            raise DoesNotFit from error
        told: tuple[Any, ...] = self._told or ()
        structs: list[Any] = [getattr(each, "_obj", None) for each in told]
        if len(structs) != 2 or not all(isinstance(each, ctypes.Structure) for each in structs):
            raise DoesNotFit
        self.bounds: Any = structs[0]
        self._struct: Any = type(structs[1])
        if [name for name, _ in self._struct._fields_] != [each.label for each in kernel.adj.args]:
            raise DoesNotFit
        self.function = int(ctypes.cast(self.call, ctypes.c_void_p).value or 0)

    def forward(self, *arguments: Any) -> None:
        """Called by Warp in place of the function."""
        self._told = arguments

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
_conventions: dict[tuple[Any, ...], _Convention] = {}


def _convention_of(kernel: Any, values: Sequence[Any]) -> _Convention:
    """How a kernel is called with values: to ask Warp takes longer than a launch."""
    types = tuple((each.dtype, each.ndim) if isinstance(each, wp.array) else type(each) for each in values)
    key = kernel, types
    # Of two threads that ask at once, both get the first one's.
    return _conventions.get(key) or _conventions.setdefault(key, _Convention(kernel, values))


class NativeCall:
    """A kernel call as ``RecordedCall`` of ``native/launch_slices.h`` has it; what it points at stays."""

    def __init__(self, step: KernelCall) -> None:
        values = [*step.arguments(0, 1), *step.outputs]
        self._convention = convention = _convention_of(step.kernel, values)
        self._arguments = convention.arguments(values)
        self.row = [
            convention.function, ctypes.addressof(convention.bounds), ctypes.addressof(self._arguments),
            ctypes.sizeof(self._arguments), convention.offset("first"),
            convention.offset("run") if step.in_runs else -1, step.block,
        ]  # fmt: skip


class NativeCalls:
    """Kernel calls one after the other, which a native loop takes slices of elements through."""

    def __init__(self, steps: Sequence[KernelCall]) -> None:
        self._calls = [step.prepared(NativeCall) for step in steps]
        self._rows = np.array([call.row for call in self._calls], dtype=np.int64)

    def slices(self, elements: range, size: int, at_a_time: int) -> Callable[[], None]:
        """A function that takes the next slices of elements, so many of them, on any thread."""
        return _NativeSlices(self, self._rows, elements, size, at_a_time).take


class _NativeSlices:
    """Slices of elements, of which any thread takes the next ones; what the native loop points at stays."""

    def __init__(self, calls: NativeCalls, rows: NDArray[np.int64], elements: range, size: int, at_a_time: int) -> None:
        self._calls, self._taken = calls, np.zeros(1, dtype=np.int32)
        values = [
            rows.ctypes.data, len(rows), elements.start, elements.stop, size, at_a_time, self._taken.ctypes.data,
        ]  # fmt: skip
        self._convention = _convention_of(launch_slices.run, values)
        self._arguments = self._convention.arguments(values)

    def take(self) -> None:
        """Take so many slices, those that none has taken."""
        self._convention.call(ctypes.byref(self._convention.bounds), ctypes.byref(self._arguments))
