"""Atomic increment of array elements on all devices."""

import warp as wp


# Warp's own increment is atomic on a GPU only, but slices of a launch run on several threads of the CPU. Modules that
# use this function include ``native/atomics.h``.
@wp.func_native("return warpdiff::atomic_increment((int*)values.data + index);")
def atomic_increment(values: wp.array(dtype=wp.int32), index: wp.int32) -> wp.int32:
    """Increment an element by 1, and return its previous value."""
