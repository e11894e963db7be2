"""Launches of several kernels on the CPU, slice after slice, without the interpreter in between.

A GPU has a queue for that.
"""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.snippets import filled

# Those of all others: Warp's headers are compiled once for modules of the same options.
wp.set_module_options(compile_options.options())

# Of a launch that is recorded, in numbers of 64 bits: the function, its bounds of one index, its arguments, their size,
# where among them the first index and the number of indices are (−1 for kernels that take one a call), and how many
# elements an index stands for.
FIELDS = 7

_RUN = """
    typedef void (*kernel)(void* bounds, void* arguments);
    const long long* const all = (const long long*)launches;
    // Other threads have indices of their own, in arguments of their own, one launch's after the other's.
    auto room_for = [=](int k) { return (all[FIELDS * k + 3] + 15) / 16 * 16; };
    long long bytes = 0;
    for (int k = 0; k < count; ++k) bytes += room_for(k);
    char* const own = (char*)__builtin_alloca_with_align(bytes, 128);
    char* arguments = own;
    for (int k = 0; k < count; arguments += room_for(k++))
        memcpy(arguments, (const void*)all[FIELDS * k + 2], all[FIELDS * k + 3]);
    for (int taken = 0; taken < most; ++taken) {
        const long long slice = __atomic_fetch_add((int*)next, 1, __ATOMIC_RELAXED);
        const long long begin = first + slice * size, behind = wp::min(begin + size, (long long)end);
        if (begin >= end) break;
        arguments = own;
        for (int k = 0; k < count; arguments += room_for(k++)) {
            const long long* const launch = all + FIELDS * k;
            const kernel function = (kernel)launch[0];
            const int from = begin / launch[6], to = (behind + launch[6] - 1) / launch[6];
            int* const index = (int*)(arguments + launch[4]);
            if (launch[5] >= 0) {
                *index = from;
                *(int*)(arguments + launch[5]) = to - from;
                function((void*)launch[1], arguments);
                continue;
            }
            for (int i = from; i < to; ++i) {
                *index = i;
                function((void*)launch[1], arguments);
            }
        }
    }
"""


@wp.func_native(filled(_RUN, FIELDS=FIELDS))
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

    Launches are so many times ``FIELDS`` numbers, and they and what counts the slices up are at addresses.
    """
    run_slices(launches, count, first, end, size, most, next)
