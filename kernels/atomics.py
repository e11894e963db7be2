"""Atomic increment of array elements on all devices."""

import warp as wp


# Warp's own increment of an array element is atomic on a GPU only. On the CPU, several threads of the library also run
# parts of one launch at the same time. Kernels on the CPU therefore need :func:`atomic_increment`. Modules that use it
# must include ``native/atomics.h``.
@wp.func_native("return warpdiff::atomic_increment((int*)values.data + index);")
def atomic_increment(values: wp.array(dtype=wp.int32), index: wp.int32) -> wp.int32:
    """Increment an array element by 1 as one atomic operation, and return its previous value."""
