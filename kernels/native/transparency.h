// Alpha of faces. Rays pass through a face where its alpha is below a threshold.

#pragma once

#include "textures.h"

namespace warpdiff {

// Return the alpha at a point of a face: the product of the alpha of its texture and the alpha of its vertices.
// `share0` and `share1` are the barycentric coordinates of the first two corners.
template <class Surface, class Textures, class Transparency>
WARPDIFF_INLINE float alpha_at(const Surface& surface, const Textures& textures, const Transparency& transparency,
    int face, float share0, float share1)
{
    const int* const corners = numbers<const int>(surface.faces) + 3LL * face;
    const float place[2] = {share0, share1};
    float alpha = 1.0f;
    if (!is_empty(transparency.vertex_alphas)) {
        const float* const at = numbers<const float>(transparency.vertex_alphas);
        alpha = share0 * at[corners[0]] + share1 * at[corners[1]] + (1.0f - share0 - share1) * at[corners[2]];
    }
    const int number = numbers<const int>(textures.of_base_colour)[numbers<const int>(textures.rows)[face]];
    if (number < 0) return alpha;
    return alpha
        * sample_point(textures, number, PointUv(numbers<const float>(surface.uvs), corners, place)).channels[3];
}

} // namespace warpdiff
