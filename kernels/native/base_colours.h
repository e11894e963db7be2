// Base colours at hits: look-ups of textures, filtered by the footprint of each ray on the face that the ray hits.

#pragma once

#include "footprints.h"
#include "textures.h"

namespace warpdiff {

// Footprint of a ray in texture coordinates (u, v): the changes of (u, v) over one standard deviation of the ray's
// filter. The first two numbers are the change along rows of the picture, and the last two the change along columns.
struct UvFootprint {
    float changes[4];

    // Compute the changes of the texture coordinates around a hit on a face, over one standard deviation of the ray's
    // filter. `place` has the barycentric coordinates of the hit.
    WARPDIFF_INLINE UvFootprint(const float* positions, const float* uvs, const int* corners, const float* place,
        const float* to_view, const FilterSteps& filter, float least_facing)
    {
        HitDifferentials hit;
        const float share1 = place[1], share2 = 1.0f - place[0] - place[1];
        float edge1[3], edge2[3], away[3];
        for (int c = 0; c < 3; ++c) {
            const float start = positions[3LL * corners[0] + c];
            edge1[c] = positions[3LL * corners[1] + c] - start;
            edge2[c] = positions[3LL * corners[2] + c] - start;
            hit.view[c] = to_view[c];
            away[c] = filter.eye[c] - start - share1 * edge1[c] - share2 * edge2[c];
        }
        hit.differentiate(edge1, edge2, away, filter, least_facing);
        for (int axis = 0; axis < 2; ++axis) {
            const float* const step = filter.step[axis];
            const float through = dot(hit.across, step);
            const float change1 = hit.scale * (dot(hit.of_share1, step) - hit.slide1 * through);
            const float change2 = hit.scale * (dot(hit.of_share2, step) - hit.slide2 * through);
            for (int c = 0; c < 2; ++c) {
                const float start = uvs[2LL * corners[0] + c];
                changes[2 * axis + c] =
                    change1 * (uvs[2LL * corners[1] + c] - start) + change2 * (uvs[2LL * corners[2] + c] - start);
            }
        }
    }
};

// Replace the negative base colours of the hits from `begin` to `end`. A negative base colour marks a hit where a
// texture may determine the colour. The result is the colour of the texture of the material, or black without a
// texture. `deviation` is the standard deviation of the filter of each ray [pixels]. If it is 0, textures are sampled
// at points.
template <class Camera, class Surface, class Textures, class Pixels>
WARPDIFF_INLINE void look_up_base_colours(const Camera& camera, const Surface& surface, const Textures& textures,
    const Pixels& pixels, float deviation, float least_facing, int begin, int end)
{
    const int* const hit = numbers<const int>(pixels.hit);
    const int* const face = numbers<const int>(pixels.face);
    const float* const positions = numbers<const float>(surface.positions);
    const float* const uvs = numbers<const float>(surface.uvs);
    const FilterSteps filter(camera, deviation);
    for (int ray = begin; ray < end; ++ray) {
        float* const colour = numbers<float>(pixels.base_colour) + 3LL * ray;
        if (hit[ray] == 0 || !(colour[0] < 0.0f)) continue;
        const int row = numbers<const int>(textures.rows)[face[ray]];
        const int number = row < 0 ? -1 : numbers<const int>(textures.of_base_colour)[row];
        if (number < 0) {
            colour[0] = colour[1] = colour[2] = 0.0f;
            continue;
        }
        const int* const corners = numbers<const int>(surface.faces) + 3LL * face[ray];
        const float* const place = numbers<const float>(pixels.place) + 2LL * ray;
        const PointUv uv(uvs, corners, place);
        Rgba sampled;
        if (deviation > 0.0f) {
            const float* const to_view = numbers<const float>(pixels.to_view) + 3LL * ray;
            const UvFootprint footprint(positions, uvs, corners, place, to_view, filter, least_facing);
            sampled = sample_footprint(textures, number, uv.u, uv.v, footprint.changes);
        } else {
            sampled = sample_point(textures, number, uv);
        }
        for (int c = 0; c < 3; ++c) colour[c] = sampled.channels[c];
    }
}

} // namespace warpdiff
