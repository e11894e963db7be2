"""Launches of several kernels on the CPU, slice after slice, without the interpreter in between.

A GPU has a queue for that.
"""

import warp as wp

from warpdiff.kernels import compile_options

# Those of all others: Warp's headers are compiled once for modules of the same options.
wp.set_module_options(compile_options.options("launch_slices.h"))


@wp.func_native("warpdiff::run_slices(launches, count, first, end, size, most, next);")
def run_slices(
    launches: wp.uint64,
    count: wp.int32,
    first: wp.int32,
    end: wp.int32,
    size: wp.int32,
    most: wp.int32,
    next: wp.uint64,
):
    """See the kernel."""


@wp.kernel
def run(
    # In:
    launches: wp.uint64,
    count: wp.int32,
    first: wp.int32,
    end: wp.int32,
    size: wp.int32,
    most: wp.int32,
    # In and out:
    next: wp.uint64,
):
    """Take at most so many slices of elements, the next one that no thread has taken, through all launches in turn.

    Launches are ``RecordedCall`` of ``native/launch_slices.h``; they and what counts the slices up are at addresses.
    """
    run_slices(launches, count, first, end, size, most, next)


@wp.kernel
def count_visits(
    # Out:
    counts_out: wp.array(dtype=wp.int32),
    # In:
    first: wp.int32,
):
    """Count that an element was visited: by this it is told whether slices can be launched so."""
    counts_out[first + wp.tid()] += 1
