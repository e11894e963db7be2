// Atomic changes of numbers: slices of a launch run on several threads, and Warp's own are atomic on a GPU only.

#pragma once

#include "simd.h"

namespace warpdiff {

// Increment by 1, and return the previous value.
WARPDIFF_INLINE int atomic_increment(int* count)
{
#if defined(__CUDA_ARCH__)
    return atomicAdd(count, 1);
#else
    return __atomic_fetch_add(count, 1, __ATOMIC_RELAXED);
#endif
}

#if !defined(__CUDA_ARCH__)

template <class Number>
WARPDIFF_INLINE void keep_smallest(Number* smallest, Number value)
{
    Number known = __atomic_load_n(smallest, __ATOMIC_RELAXED);
    while (value < known
        && !__atomic_compare_exchange_n(smallest, &known, value, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {
    }
}

#endif

} // namespace warpdiff
