// Dots of a grating map at hits. A grating map gives each rectangle of texture coordinates (dot) its own grating.

#pragma once

#include "base_colours.h"

namespace warpdiff {

// Return the index of the dot (a rectangle of a grating map) at a texture coordinate. The range from 0 to 1 has `count`
// dots and is repeated.
WARPDIFF_INLINE int dot_on_axis(float coordinate, int count)
{
    const bool is_inside = coordinate >= 0.0f && coordinate <= 1.0f;
    const float fraction = is_inside ? coordinate : coordinate - wp::floor(coordinate);
    return wp::clamp((int)(fraction * (float)count), 0, count - 1);
}

// Find the dots (rectangles of a grating map) at the hits from `begin` to `end`. The index of a dot is its row times
// `columns` plus its column; row 0 is at v = 1.
//
// At level n of refinement, a pixel has `across` = 2ⁿ subpixel cells per side, each with one ray. The edges of dots are
// often parallel to rows or columns of the picture. The rays of different cells therefore look up their dots at
// different positions within the cell: rows of cells differ in the position to the right, and columns of cells in the
// position downwards. The 4ⁿ positions of a pixel's rays along an axis are then all different (multi-jittered sampling,
// Chiu et al. 1994), so that edges are resolved as well as by 4ⁿ cells per side.
template <class Camera, class Surface, class Pixels, class Numbers>
WARPDIFF_INLINE void find_dots(const Camera& camera, const Surface& surface, const Pixels& pixels, int rows,
    int columns, int across, float least_facing, int begin, int end, Numbers& dots_out)
{
    const int* const hit = numbers<const int>(pixels.hit);
    const int* const face = numbers<const int>(pixels.face);
    const float* const uvs = numbers<const float>(surface.uvs);
    const FilterSteps filter(camera, 1.0f);
    const float spacing = 1.0f / (float)across;
    for (int ray = begin; ray < end; ++ray) {
        int& dot = numbers<int>(dots_out)[ray];
        dot = -1;
        if (hit[ray] == 0) continue;
        const int* const corners = numbers<const int>(surface.faces) + 3LL * face[ray];
        const float* const place = numbers<const float>(pixels.place) + 2LL * ray;
        const PointUv uv(uvs, corners, place);
        float u = uv.u, v = uv.v;
        if (across > 1) {
            const float* const to_view = numbers<const float>(pixels.to_view) + 3LL * ray;
            const UvFootprint pixel(
                numbers<const float>(surface.positions), uvs, corners, place, to_view, filter, least_facing);
            const int cell = ray & (across * across - 1);
            const float right = (((float)(cell / across) + 0.5f) * spacing - 0.5f) * spacing;
            const float down = (((float)(cell % across) + 0.5f) * spacing - 0.5f) * spacing;
            u += right * pixel.changes[0] + down * pixel.changes[2];
            v += right * pixel.changes[1] + down * pixel.changes[3];
        }
        dot = (rows - 1 - dot_on_axis(v, rows)) * columns + dot_on_axis(u, columns);
    }
}

} // namespace warpdiff
