// Operations on vectors of three components. The vectors are plain arrays, so that compilers vectorise loops over many
// vectors.

#pragma once

#include "simd.h"

namespace warpdiff {

template <class Number>
WARPDIFF_INLINE Number dot(const Number* a, const Number* b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

template <class Number>
WARPDIFF_INLINE void cross(const Number* a, const Number* b, Number* result)
{
    result[0] = a[1] * b[2] - a[2] * b[1];
    result[1] = a[2] * b[0] - a[0] * b[2];
    result[2] = a[0] * b[1] - a[1] * b[0];
}

// Return whether any of `count` pixels hits the mesh.
WARPDIFF_INLINE bool any_hit(const int* hit, int count)
{
    int hits = 0;
    for (int i = 0; i < count; ++i) hits |= hit[i];
    return hits != 0;
}

} // namespace warpdiff
