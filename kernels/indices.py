"""Indices into arrays that repeat."""

import warp as wp


@wp.func
def cyclic(index: wp.int32, count: wp.int32) -> wp.int32:
    """An index into an axis that repeats, or around a turn."""
    if index < 0 or index >= count:
        index = index % count
        if index < 0:
            index = index + count
    return index
