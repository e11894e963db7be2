// Atomic operations for the CPU and the GPU. The atomic operations of Warp are atomic on a GPU only. On the CPU,
// several threads also run parts of one launch at the same time.

#pragma once

#include "simd.h"

namespace warpdiff {

// Increment a counter by 1 atomically. Return its previous value.
WARPDIFF_INLINE int atomic_increment(int* count)
{
#if defined(__CUDA_ARCH__)
    return atomicAdd(count, 1);
#else
    return __atomic_fetch_add(count, 1, __ATOMIC_RELAXED);
#endif
}

#if !defined(__CUDA_ARCH__)

// Replace a number in memory by `value` if `value` is smaller, as one atomic operation.
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
