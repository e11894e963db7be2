// Dots of a grating map at hits. A grating map gives each rectangle of texture coordinates (dot) its own grating.

#pragma once

#include "base_colours.h"

namespace warpdiff {

// Smallest share of a dot in a subpixel cell that is used. Smaller or negative shares are rounding errors of float32.
// With a much larger value, colours would lose energy.
constexpr float LEAST_SHARE = 1e-6f;

// Polygon in a subpixel cell. `right` and `down` are the positions of its corners in the subpixel cell, from −1 to 1.
struct CellPolygon {
    float right[6] = {-1.0f, 1.0f, 1.0f, -1.0f}, down[6] = {-1.0f, -1.0f, 1.0f, 1.0f};
    int count = 4;

    // Cut off the part where `per_right` · right + `per_down` · down exceeds `limit`.
    WARPDIFF_INLINE void cut(float per_right, float per_down, float limit)
    {
        CellPolygon remaining;
        remaining.count = 0;
        for (int k = 0; k < count; ++k) {
            const int next = k + 1 < count ? k + 1 : 0;
            const float inside = limit - per_right * right[k] - per_down * down[k];
            const float inside_next = limit - per_right * right[next] - per_down * down[next];
            if (inside >= 0.0f) remaining.add(right[k], down[k]);
            if ((inside >= 0.0f) == (inside_next >= 0.0f)) continue;
            const float t = inside / (inside - inside_next);
            remaining.add(right[k] + t * (right[next] - right[k]), down[k] + t * (down[next] - down[k]));
        }
        *this = remaining;
    }

    // Append a corner. A square that is cut by two lines has at most six corners.
    WARPDIFF_INLINE void add(float to_right, float to_down)
    {
        if (count == 6) return;
        right[count] = to_right;
        down[count++] = to_down;
    }

    // Return the area of the polygon relative to the area of the subpixel cell.
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

// Upper limit of the half extent of a subpixel cell along u or v, in dots. Indices of dots are 32-bit integers, which
// overflow at about 2·10⁹. A subpixel cell on more than two dots is not divided. The exact limit therefore has no
// effect.
constexpr float MOST_HALF_EXTENT = 1e6f;

// Factor by which the extent of a subpixel cell is reduced, so that a dot that is only touched does not count. Without
// the factor, rounding errors could make a subpixel cell of exactly two dots seem to overlap three.
constexpr float COUNTED_EXTENT = 1.0f - 1e-5f;

// Rows or columns of dots that a subpixel cell overlaps, from `first` to `last`. `place` is the texture coordinate of
// the middle of the subpixel cell, in dots. `to_right` is the change of `place` from the middle to the right side of
// the subpixel cell, and `to_down` the change to its lower side.
struct DotsOfCell {
    float to_right, to_down, place;
    int first, last;

    // If the map does not repeat, dots end at the texture coordinates 0 and 1.
    WARPDIFF_INLINE DotsOfCell(float coordinate, float right, float down, int count, bool repeats)
        : to_right(right * (float)count),
          to_down(down * (float)count),
          place((repeats ? coordinate - wp::floor(coordinate) : coordinate) * (float)count)
    {
        const float half_extent = wp::min(COUNTED_EXTENT * (wp::abs(to_right) + wp::abs(to_down)), MOST_HALF_EXTENT);
        first = (int)wp::floor(place - half_extent);
        last = (int)wp::floor(place + half_extent);
        if (repeats) return;
        first = wp::clamp(first, 0, count - 1);
        last = wp::clamp(last, 0, count - 1);
    }

    // Cut off the part of a subpixel cell that belongs to the second of two dots.
    WARPDIFF_INLINE void cut(CellPolygon& cell) const
    {
        if (last > first) cell.cut(to_right, to_down, (float)last - place);
    }
};

// Compute the shares of the area of a subpixel cell in up to four dots of a grating map. The first share is that of the
// dot with the smallest u and v. Then follow the next dot along u, the next dot along v, and the next dot along both.
WARPDIFF_INLINE void divide_cell(const DotsOfCell& u, const DotsOfCell& v, float* shares)
{
    CellPolygon before_u, before_v;
    u.cut(before_u);
    v.cut(before_v);
    const float share_u = before_u.share(), share_v = before_v.share();
    v.cut(before_u);
    shares[0] = before_u.share();
    shares[1] = share_v - shares[0];
    shares[2] = share_u - shares[0];
    shares[3] = 1.0f - share_u - shares[1];
    for (int dot = 0; dot < 4; ++dot)
        if (shares[dot] < LEAST_SHARE) shares[dot] = 0.0f;
}

// Return the index of a row or column of dots in a map that repeats after `count` rows or columns.
WARPDIFF_INLINE int repeated(int number, int count)
{
    return (number % count + count) % count;
}

// Find the dots (rectangles of a grating map) at the hits from `begin` to `end`. The index of a dot is its row times
// `columns` plus its column; row 0 is at v = 1. Without a hit, the index is −1. The map `repeats` if the mesh has
// texture coordinates below 0 or above 1.
//
// At level n of refinement, a pixel has `across` = 2ⁿ subpixel cells per side, each with one ray. At level 0, the
// result is the dot at the hit, with the share 1. At higher levels, a subpixel cell is a parallelogram in texture
// coordinates:
//
// - If the subpixel cell overlaps at most two dots along each axis, its shares in these dots are computed exactly. The
//   result is the index of the dot with the smallest u and v.
// - If the subpixel cell overlaps more dots, a single dot gets the share 1. This dot is looked up at one point of the
//   subpixel cell. The horizontal offset of the point depends on the row of the subpixel cell, and its vertical offset
//   on the column. Thus all 4ⁿ horizontal positions in a pixel are different, and so are all vertical ones (the
//   arrangement of multi-jittered sampling, Chiu et al. 1994, without random offsets).
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
        DotsOfCell along_u(uv.u, 0.0f, 0.0f, columns, repeats), along_v(uv.v, 0.0f, 0.0f, rows, repeats);
        if (across > 1) {
            const float* const to_view = numbers<const float>(pixels.to_view) + 3LL * ray;
            // Changes of (u, v) from the middle of the subpixel cell to its right and to its lower side.
            const UvFootprint to_side(
                numbers<const float>(surface.positions), uvs, corners, place, to_view, half_cell, least_facing);
            const float* const change = to_side.changes;
            along_u = DotsOfCell(uv.u, change[0], change[2], columns, repeats);
            along_v = DotsOfCell(uv.v, change[1], change[3], rows, repeats);
            if (along_u.last - along_u.first <= 1 && along_v.last - along_v.first <= 1) {
                divide_cell(along_u, along_v, shares);
            } else {
                const int cell = ray & (across * across - 1);
                const float right = ((float)(cell / across) + 0.5f) * 2.0f * spacing - 1.0f;
                const float down = ((float)(cell % across) + 0.5f) * 2.0f * spacing - 1.0f;
                along_u = DotsOfCell(uv.u + right * change[0] + down * change[2], 0.0f, 0.0f, columns, repeats);
                along_v = DotsOfCell(uv.v + right * change[1] + down * change[3], 0.0f, 0.0f, rows, repeats);
            }
        }
        dot = (rows - 1 - repeated(along_v.first, rows)) * columns + repeated(along_u.first, columns);
    }
}

} // namespace warpdiff
