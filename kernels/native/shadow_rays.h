// Shadow rays to a distant light, by a grid over the mesh, projected along the light. Each cell of the grid has a list
// of the faces in the cell.
//
// Positions perpendicular to the light are rounded to whole numbers of steps. The test on which side of an edge a point
// lies is then exact. kernels/shadow_rays.py makes the lists of faces with the same rounding.

#pragma once

#include "simd.h"

namespace warpdiff {

// Number of faces in the list of a grid cell that are tested together. It is limited by the size of local arrays.
constexpr int LISTED = 32;

// A batch of points from which shadow rays start. A point has two coordinates perpendicular to the light [steps], and a
// height towards the light. `cell` is the index of its grid cell, or −1 if no test is required. `occluded` is 1 if a
// face occludes the light.
template <int N>
struct ShadowPoints {
    Batch<N, double> x, y, z;
    Batch<N, int> cell, occluded;

    template <class Grid, class Pixels, class Vector>
    WARPDIFF_INLINE void load(const Grid& grid, const Pixels& pixels, const Vector& towards, float facing_away,
        double steps, int from, int count)
    {
        const int* const hit = numbers<const int>(pixels.hit);
        const float* const normals = numbers<const float>(pixels.normal);
        const float* const origins = numbers<const float>(pixels.shadow_origin);
        for (int i = 0; i < N; ++i) {
            const long long k = from + (i < count ? i : 0), at = 3 * k;
            const bool asks = i < count && hit[k] != 0
                && normals[at] * towards[0] + normals[at + 1] * towards[1] + normals[at + 2] * towards[2] > facing_away;
            // A pixel that requires no shadow test may have a point that is infinite or NaN. The point (0, 0, 0) is
            // used instead.
            const double p0 = asks ? origins[at] : 0.0f, p1 = asks ? origins[at + 1] : 0.0f;
            const double p2 = asks ? origins[at + 2] : 0.0f;
            x[i] = rint((p0 * grid.across[0] + p1 * grid.across[1] + p2 * grid.across[2]) * steps);
            y[i] = rint((p0 * grid.up[0] + p1 * grid.up[1] + p2 * grid.up[2]) * steps);
            z[i] = p0 * grid.towards[0] + p1 * grid.towards[1] + p2 * grid.towards[2];
            const int column = (int)floor((x[i] - grid.low_x) * grid.per_step);
            const int row = (int)floor((y[i] - grid.low_y) * grid.per_step);
            const bool inside = column >= 0 && row >= 0 && column < grid.columns && row < grid.rows;
            cell[i] = asks && inside ? row * grid.columns + column : -1;
            occluded[i] = 0;
        }
    }

    // Mark the points of a grid cell that are below (occluded by) a face. `corners` are the corners of the face and
    // `top` is the height of its highest corner.
    WARPDIFF_INLINE void mark_below(const float* corners, float top, int here)
    {
        const double x0 = corners[0], y0 = corners[1], z0 = corners[2], x1 = corners[3], y1 = corners[4];
        const double z1 = corners[5], x2 = corners[6], y2 = corners[7], z2 = corners[8];
        for (int j = 0; j < N; ++j) {
            // Twice the areas of the triangles between the point and the three edges of the face. The areas are exact,
            // as positions are whole numbers.
            const double e0 = (x2 - x1) * (y[j] - y1) - (y2 - y1) * (x[j] - x1);
            const double e1 = (x0 - x2) * (y[j] - y2) - (y0 - y2) * (x[j] - x2);
            const double e2 = (x1 - x0) * (y[j] - y0) - (y1 - y0) * (x[j] - x0);
            const int below =
                (e0 >= 0.0) & (e1 >= 0.0) & (e2 >= 0.0) & (z0 * e0 + z1 * e1 + z2 * e2 > z[j] * (e0 + e1 + e2));
            // A face occludes a point only if its highest corner is above the point. This prevents an error by
            // rounding: a lower face next to the face of the point could otherwise occlude the point.
            occluded[j] |= below & (cell[j] == here) & (top > z[j]);
        }
    }
};

// Test the faces in the list of a grid cell against the points in that cell. The lowest of these points has the height
// `least`.
template <int N, class Grid>
WARPDIFF_INLINE void search_cell(const Grid& grid, int here, double least, ShadowPoints<N>& points)
{
    const float* const corners = numbers<const float>(grid.corners);
    const float* const tops = numbers<const float>(grid.tops);
    const int* const starts = numbers<const int>(grid.starts);
    const int* const faces = numbers<const int>(grid.faces);
    for (int next = starts[here]; next < starts[here + 1];) {
        // Select the faces that are higher than the lowest point. The selection has no branches, because mispredicted
        // branches would take more time.
        int above[LISTED], count = 0;
        float top[LISTED];
        const int stop = wp::min(next + LISTED, starts[here + 1]);
        for (; next < stop; ++next) {
            above[count] = faces[next];
            top[count] = tops[next];
            count += tops[next] > least;
        }
        for (int which = 0; which < count; ++which) points.mark_below(corners + 9LL * above[which], top[which], here);
    }
}

// Determine for the pixels from `begin` to `end` whether the mesh occludes the light. The points of a batch that lie in
// the same grid cell are tested together.
template <int BATCH, class Grid, class Vector, class Pixels, class Flags>
WARPDIFF_INLINE void look_up_shadows(const Grid& grid, const Vector& towards, const Pixels& pixels, float facing_away,
    double steps, int begin, int end, Flags& occluded_out)
{
    constexpr int N = batch_of(BATCH);
    for (int from = begin; from < end; from += N) {
        const int count = wp::min(end - from, N);
        ShadowPoints<N> points;
        points.load(grid, pixels, towards, facing_away, steps, from, count);
        for (int i = 0; i < count; ++i) {
            const int here = points.cell[i];
            if (here < 0) continue;
            double least = 4.0;
            for (int j = i; j < N; ++j)
                if (points.cell[j] == here && points.z[j] < least) least = points.z[j];
            search_cell(grid, here, least, points);
            for (int j = 0; j < N; ++j) points.cell[j] = points.cell[j] == here ? -1 : points.cell[j];
        }
        for (int i = 0; i < count; ++i) numbers<bool>(occluded_out)[from + i] = points.occluded[i] != 0;
    }
}

} // namespace warpdiff
