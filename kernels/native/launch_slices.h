// Calls of compiled kernels on the CPU, slice after slice, without the interpreter in between.

#pragma once

#include "simd.h"

namespace warpdiff {

#if !defined(__CUDA_ARCH__)

// A kernel with its arguments, as the host lays it out.
struct RecordedCall {
    void (*function)(void* bounds, void* arguments);
    void* bounds; // of one index
    const void* arguments;
    long long size;             // of the arguments [bytes]
    long long first_at, run_at; // where among them the first index lies, and the number of indices; or −1
    long long elements_of_an_index;

    // Room among a thread's own arguments, one call's after the other's.
    WARPDIFF_INLINE long long room() const
    {
        return (size + 15) / 16 * 16;
    }

    WARPDIFF_INLINE void call(char* own, long long begin, long long end) const
    {
        const int from = begin / elements_of_an_index, to = (end + elements_of_an_index - 1) / elements_of_an_index;
        int* const first = (int*)(own + first_at);
        if (run_at >= 0) {
            *first = from;
            *(int*)(own + run_at) = to - from;
            function(bounds, own);
            return;
        }
        for (int i = from; i < to; ++i) {
            *first = i;
            function(bounds, own);
        }
    }
};

// Take slices of `size` elements from `first` to before `end`, the next one that no thread has taken, through all calls
// in turn, at most `most` of them.
inline void run_slices(
    unsigned long long calls_at, int count, int first, int end, int size, int most, unsigned long long next_at)
{
    const RecordedCall* const calls = (const RecordedCall*)calls_at;
    // Other threads have indices of their own, in arguments of their own.
    long long bytes = 0;
    for (int k = 0; k < count; ++k) bytes += calls[k].room();
    char* const own = (char*)__builtin_alloca_with_align(bytes, 128);
    char* arguments = own;
    for (int k = 0; k < count; arguments += calls[k++].room()) memcpy(arguments, calls[k].arguments, calls[k].size);
    for (int taken = 0; taken < most; ++taken) {
        const long long slice = __atomic_fetch_add((int*)next_at, 1, __ATOMIC_RELAXED), begin = first + slice * size;
        if (begin >= end) break;
        const long long behind = begin + size < end ? begin + size : end;
        arguments = own;
        for (int k = 0; k < count; arguments += calls[k++].room()) calls[k].call(arguments, begin, behind);
    }
}

#endif

} // namespace warpdiff
