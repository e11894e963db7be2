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

// Least share of a dot in a subpixel cell that counts. Smaller shares are rounding errors of float32.
constexpr float LEAST_SHARE = 1e-6f;

// Polygon in a subpixel cell. `right` and `down` are positions in the cell, from −1 to 1. Lines cut off parts of it.
struct CellPolygon {
    float right[6] = {-1.0f, 1.0f, 1.0f, -1.0f}, down[6] = {-1.0f, -1.0f, 1.0f, 1.0f};
    int count = 4;

    // Cut off the part where `along` · right + `across` · down exceeds `limit`.
    WARPDIFF_INLINE void cut(float along, float across, float limit)
    {
        CellPolygon kept;
        kept.count = 0;
        for (int k = 0; k < count; ++k) {
            const int next = k + 1 < count ? k + 1 : 0;
            const float inside = limit - along * right[k] - across * down[k];
            const float inside_next = limit - along * right[next] - across * down[next];
            if (inside >= 0.0f) kept.add(right[k], down[k]);
            if ((inside >= 0.0f) == (inside_next >= 0.0f)) continue;
            const float t = inside / (inside - inside_next);
            kept.add(right[k] + t * (right[next] - right[k]), down[k] + t * (down[next] - down[k]));
        }
        *this = kept;
    }

    // Append a corner. Two lines cut at most six corners from a square.
    WARPDIFF_INLINE void add(float to_right, float to_down)
    {
        if (count == 6) return;
        right[count] = to_right;
        down[count++] = to_down;
    }

    // Return the area relative to the whole cell.
    WARPDIFF_INLINE float share() const
    {
        float sum = 0.0f;
        for (int k = 0; k < count; ++k) {
            const int next = k + 1 < count ? k + 1 : 0;
            sum += right[k] * down[next] - right[next] * down[k];
        }
        return 0.125f * sum;
    }
};

// Largest distance from the middle of a subpixel cell to its edge that is computed, in dots. It is limited because
// integers overflow far above it.
constexpr float MOST_REACH = 1e6f;

// Dots along one axis of a grating map that a subpixel cell overlaps. `place` is the middle of the cell, in dots from
// the beginning of the map. `right` and `down` are the changes of this place to the sides of the cell.
struct DotsOfCell {
    float right, down, place;
    int first, last;

    WARPDIFF_INLINE DotsOfCell(float coordinate, float to_right, float to_down, int count, bool repeats)
        : right(to_right * (float)count),
          down(to_down * (float)count),
          place((repeats ? coordinate - wp::floor(coordinate) : coordinate) * (float)count)
    {
        const float reach = wp::min(wp::abs(right) + wp::abs(down), MOST_REACH);
        first = (int)wp::floor(place - reach);
        last = (int)wp::floor(place + reach);
        if (repeats) return;
        first = wp::clamp(first, 0, count - 1);
        last = wp::clamp(last, 0, count - 1);
    }

    // Cut off the part of a cell that belongs to the second of two dots.
    WARPDIFF_INLINE void cut(CellPolygon& cell) const
    {
        cell.cut(right, down, (float)last - place);
    }
};

// Compute the shares of the area of a subpixel cell in up to four dots of a grating map. The order of the dots is: the
// dot at the least (u, v); the next one along u; the next one along v; and the next one along both.
WARPDIFF_INLINE void divide_cell(const DotsOfCell& u, const DotsOfCell& v, float* shares)
{
    CellPolygon along_u, along_v;
    if (u.last > u.first) u.cut(along_u);
    if (v.last > v.first) v.cut(along_v);
    const float before_u = along_u.share(), before_v = along_v.share();
    if (v.last > v.first) v.cut(along_u);
    const float before_both = along_u.share();
    shares[0] = before_both;
    shares[1] = before_v - before_both;
    shares[2] = before_u - before_both;
    shares[3] = 1.0f - before_u - shares[1];
    for (int dot = 0; dot < 4; ++dot)
        if (shares[dot] < LEAST_SHARE) shares[dot] = 0.0f;
}

// Return the remainder of a division as a number from 0 to `count` − 1.
WARPDIFF_INLINE int repeated(int number, int count)
{
    return (number % count + count) % count;
}

// Find the dots (rectangles of a grating map) at the hits from `begin` to `end`. The index of a dot is its row times
// `columns` plus its column; row 0 is at v = 1. If the mesh has texture coordinates below 0 or above 1, the map
// `repeats`.
//
// At level n of refinement, a pixel has `across` = 2ⁿ subpixel cells per side, each with one ray. The ray of a cell
// stands for its area, a parallelogram in texture coordinates. If it overlaps one dot along an axis or two, its shares
// in the dots are computed exactly, and the result is the dot at the least (u, v). If it overlaps more dots, it gets a
// single dot, at a position that differs from cell to cell: rows of cells differ in the position to the right, and
// columns of cells in the position downwards. The 4ⁿ positions of a pixel's rays along an axis are then all different
// (multi-jittered sampling, Chiu et al. 1994).
template <class Camera, class Surface, class Pixels, class Numbers, class Shares>
WARPDIFF_INLINE void find_dots(const Camera& camera, const Surface& surface, const Pixels& pixels, int rows,
    int columns, bool repeats, int across, float least_facing, int begin, int end, Numbers& dots_out,
    Shares& shares_out)
{
    const int* const hit = numbers<const int>(pixels.hit);
    const int* const face = numbers<const int>(pixels.face);
    const float* const uvs = numbers<const float>(surface.uvs);
    const float spacing = 1.0f / (float)across;
    const FilterSteps half_cell(camera, 0.5f * spacing);
    for (int ray = begin; ray < end; ++ray) {
        int& dot = numbers<int>(dots_out)[ray];
        float* const shares = numbers<float>(shares_out) + 4LL * ray;
        dot = -1;
        shares[0] = 1.0f;
        shares[1] = shares[2] = shares[3] = 0.0f;
        if (hit[ray] == 0) continue;
        const int* const corners = numbers<const int>(surface.faces) + 3LL * face[ray];
        const float* const place = numbers<const float>(pixels.place) + 2LL * ray;
        const PointUv uv(uvs, corners, place);
        float u = uv.u, v = uv.v;
        if (across > 1) {
            const float* const to_view = numbers<const float>(pixels.to_view) + 3LL * ray;
            const UvFootprint side(
                numbers<const float>(surface.positions), uvs, corners, place, to_view, half_cell, least_facing);
            const DotsOfCell along_u(u, side.changes[0], side.changes[2], columns, repeats);
            const DotsOfCell along_v(v, side.changes[1], side.changes[3], rows, repeats);
            if (along_u.last - along_u.first <= 1 && along_v.last - along_v.first <= 1) {
                divide_cell(along_u, along_v, shares);
                dot = (rows - 1 - repeated(along_v.first, rows)) * columns + repeated(along_u.first, columns);
                continue;
            }
            const int cell = ray & (across * across - 1);
            const float right = ((float)(cell / across) + 0.5f) * 2.0f * spacing - 1.0f;
            const float down = ((float)(cell % across) + 0.5f) * 2.0f * spacing - 1.0f;
            u += right * side.changes[0] + down * side.changes[2];
            v += right * side.changes[1] + down * side.changes[3];
        }
        dot = (rows - 1 - dot_on_axis(v, rows)) * columns + dot_on_axis(u, columns);
    }
}

} // namespace warpdiff
