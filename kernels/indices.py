"""Indices into periodic arrays."""

import warp as wp


@wp.func
def cyclic(index: wp.int32, count: wp.int32) -> wp.int32:
    """Return an index modulo the length of a periodic axis, in 0 to ``count`` − 1."""
    if index < 0 or index >= count:
        index = index % count
        if index < 0:
            index = index + count
    return index
