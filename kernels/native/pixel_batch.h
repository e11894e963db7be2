// Hits of a batch of pixels, with the corners of the faces that are hit. Each component of a vector has an array of its
// own.

#pragma once

#include "simd.h"

namespace warpdiff {

template <int N>
struct PixelBatch {
    Batch<N, bool> met;
    Batch<N> position[3][3], normal[3][3], tangent[3][3]; // vertex attributes of the face, by corner and axis
    Batch<N> share0, share1;                              // barycentric coordinates of the first two corners
    Batch<N> to_view[3];

    // Load the `count` pixels from the index `from` on. A pixel without a hit gets the corners of an arbitrary face,
    // and 0 for all other values. Array elements after the last pixel are copies of the first pixel.
    template <class Surface, class Pixels>
    WARPDIFF_INLINE void load(const Surface& surface, const Pixels& pixels, int from, int count)
    {
        const int* const hit = numbers<const int>(pixels.hit);
        const float* const places = numbers<const float>(pixels.place);
        const float* const views = numbers<const float>(pixels.to_view);
        const float* const positions = numbers<const float>(surface.positions);
        const float* const normals = numbers<const float>(surface.normals);
        const float* const tangents = numbers<const float>(surface.tangents);
        for (int i = 0; i < N; ++i) {
            const int k = from + (i < count ? i : 0);
            met[i] = hit[k] != 0;
            const int* const corners = corners_of(surface, pixels, k, met[i]);
            for (int which = 0; which < 3; ++which) {
                const long long at = 3LL * corners[which];
                for (int c = 0; c < 3; ++c) {
                    position[which][c][i] = positions[at + c];
                    normal[which][c][i] = normals[at + c];
                    tangent[which][c][i] = tangents[at + c];
                }
            }
            for (int c = 0; c < 3; ++c) to_view[c][i] = met[i] ? views[3LL * k + c] : 0.0f;
            share0[i] = met[i] ? places[2LL * k] : 0.0f;
            share1[i] = met[i] ? places[2LL * k + 1] : 0.0f;
        }
    }

    template <class Surface, class Pixels>
    static WARPDIFF_INLINE const int* corners_of(const Surface& surface, const Pixels& pixels, int pixel, bool is_met)
    {
        return numbers<const int>(surface.faces) + 3LL * (is_met ? numbers<const int>(pixels.face)[pixel] : 0);
    }
};

} // namespace warpdiff
