"""Atomic increment of array elements on all devices."""

import warp as wp


# Warp's own increment is atomic on a GPU only, but on the CPU several threads run slices of one launch. Modules that
# use this function must include ``native/atomics.h``.
@wp.func_native("return warpdiff::atomic_increment((int*)values.data + index);")
def atomic_increment(values: wp.array(dtype=wp.int32), index: wp.int32) -> wp.int32:
    """Increment an element by 1, and return its previous value."""
