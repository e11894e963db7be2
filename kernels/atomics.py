"""Atomic increment on all devices."""

import warp as wp


# Warp's own is atomic on a GPU only, and slices of a launch run on several threads. Modules that use it include
# ``native/atomics.h``.
@wp.func_native("return warpdiff::atomic_increment((int*)values.data + index);")
def atomic_increment(values: wp.array(dtype=wp.int32), index: wp.int32) -> wp.int32:
    """Count one up; returns what was there."""
