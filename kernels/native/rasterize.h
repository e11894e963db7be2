// Rasterization: the nearest face of each camera ray. A batch of faces is projected together. Each face is then tested
// against the rays of the pixels that it may cover. If pixels are subdivided into cells with one ray each, it is tested
// against batches of these rays. Only the CPU uses this file; a GPU traces rays through a hierarchy of bounding boxes.

#pragma once

#include "atomics.h"
#include "simd.h"

namespace warpdiff {

#if defined(__CUDA_ARCH__)

template <int MOST_CELLS, class... Arguments>
WARPDIFF_INLINE void rasterize_faces(const Arguments&...)
{
    __trap();
}

#else

// After projection into the picture, corners of faces are rounded to this number of steps per pixel. The number was
// derived from float64: with 2^14, products of positions are exact, so that no ray passes between two adjacent faces.
// With larger numbers, products would be rounded.
constexpr double PER_PIXEL = 1 << 14;
// Distance of the near plane from the eye [radii of the mesh]. The camera shows only parts of faces beyond this plane;
// the other parts are cut off.
constexpr double NEAR_PLANE = 1.0e-9;
// Number of faces per batch, and number of subpixel cells per batch. `FACES` is limited by the number of elements of
// SIMD vectors, and `CELLS` by the number of registers.
constexpr int FACES = 16, CELLS = 8;

WARPDIFF_INLINE double lesser(double a, double b)
{
    return a < b ? a : b;
}

WARPDIFF_INLINE double greater(double a, double b)
{
    return a > b ? a : b;
}

// A picture that is rasterized: the positions of its rays, and the nearest face of each ray so far.
template <int MOST_CELLS>
struct Raster {
    const double* axes;
    bool orthographic;
    int width, height;
    double per_width, per_height;
    // Distance from the eye to the sphere around the mesh, which is subtracted from stored distances. If the eye is far
    // away, float32 could not distinguish the distances of different faces without this subtraction.
    double before;
    const double* offsets; // offset of each pixel's ray from the pixel centre; null if rays are at the centres
    // Pixels that are subdivided into cells, with one ray per cell. `marks` has one bit per pixel of the picture, in
    // words of 64 bits. `ranks` has the index of each subdivided pixel among all subdivided pixels. `aside` and `below`
    // are the offsets of the cells from the pixel centre [pixels].
    const unsigned long long* marks; // null if pixels are not subdivided
    const int* ranks;
    int cells;
    float aside[MOST_CELLS], below[MOST_CELLS];
    // Largest distance of a subpixel cell, and of any ray, from the pixel centre along x or y [pixels].
    double max_cell_offset, max_offset;
    unsigned long long* nearest;

    template <class Camera, class Sampling, class Cells, class Nearest>
    WARPDIFF_INLINE Raster(
        const Camera& camera, const Sampling& sampling, const Cells& split, double max_ray_offset, Nearest& nearest_out)
    {
        axes = numbers<const double>(camera.axes);
        orthographic = camera.orthographic;
        width = camera.width;
        height = camera.height;
        per_width = 0.5 * width / axes[12];
        per_height = 0.5 * height / axes[13];
        before = wp::max(axes[0] * axes[9] + axes[1] * axes[10] + axes[2] * axes[11] - 1.0, 0.0);
        offsets = is_empty(sampling.offsets) ? nullptr : numbers<const double>(sampling.offsets);
        marks = is_empty(split.ranks) ? nullptr : numbers<const unsigned long long>(split.marks);
        ranks = numbers<const int>(split.ranks);
        nearest = numbers<unsigned long long>(nearest_out);
        const int across = split.across;
        cells = across * across;
        max_cell_offset = 0.5 - 0.5 / across;
        for (int cell = 0; marks && cell < cells; ++cell) {
            aside[cell] = (float)((cell % across + 0.5) / across - 0.5);
            below[cell] = (float)((cell / across + 0.5) / across - 0.5);
        }
        for (int cell = marks ? cells : 0; cell < MOST_CELLS; ++cell) aside[cell] = below[cell] = 0.0f;
        max_offset = marks ? greater(max_ray_offset, max_cell_offset) : max_ray_offset;
    }
};

// A batch of triangles: faces, or the parts of faces beyond the near plane. Arrays of three have one entry per corner,
// or per edge; an edge has the index of the opposite corner.
struct Triangles {
    // Positions of corners in the picture, and depths: distances from the eye along the optical axis. `rises` states
    // whether an edge runs from the vertex with the smaller index to the one with the larger index.
    double column[3][FACES], row[3][FACES], depth[3][FACES];
    bool rises[3][FACES];
    int face[FACES], count = 0;
    // Range of pixels that each triangle may cover, and its edges: start, vector to the end, sign that makes points
    // inside of the triangle positive, and slope in columns per row.
    double low_column[FACES], high_column[FACES], low_row[FACES], high_row[FACES];
    double from_x[3][FACES], from_y[3][FACES], right[3][FACES], down[3][FACES], sign[3][FACES], slope[3][FACES];

    // Compute twice the areas of the triangles between a point (x, y) and the three edges of triangle i. All three
    // areas are positive if the point is inside the triangle.
    WARPDIFF_INLINE void areas(int i, double x, double y, double* inside) const
    {
        for (int k = 0; k < 3; ++k)
            inside[k] = sign[k][i] * (right[k][i] * (y - from_y[k][i]) - down[k][i] * (x - from_x[k][i]));
    }
};

// Round the corners of all triangles to steps of 1/PER_PIXEL pixel, and compute their bounding boxes and edges.
template <class Picture>
WARPDIFF_INLINE void set_up(const Picture& picture, Triangles& triangles)
{
    double sides[FACES];
    for (int i = 0; i < FACES; ++i) {
        for (int k = 0; k < 3; ++k) {
            triangles.column[k][i] = wp::rint(triangles.column[k][i] * PER_PIXEL) / PER_PIXEL;
            triangles.row[k][i] = wp::rint(triangles.row[k][i] * PER_PIXEL) / PER_PIXEL;
        }
        const double x0 = triangles.column[0][i], x1 = triangles.column[1][i], x2 = triangles.column[2][i];
        const double y0 = triangles.row[0][i], y1 = triangles.row[1][i], y2 = triangles.row[2][i];
        const double slack = picture.max_offset;
        sides[i] = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0) < 0.0 ? -1.0 : 1.0;
        triangles.low_column[i] = greater(wp::ceil(lesser(x0, lesser(x1, x2)) - slack - 0.5), 0.0);
        triangles.high_column[i] = lesser(wp::floor(greater(x0, greater(x1, x2)) + slack - 0.5), picture.width - 1.0);
        triangles.low_row[i] = greater(wp::ceil(lesser(y0, lesser(y1, y2)) - slack - 0.5), 0.0);
        triangles.high_row[i] = lesser(wp::floor(greater(y0, greater(y1, y2)) + slack - 0.5), picture.height - 1.0);
    }
    // The stored start of an edge is its vertex with the smaller index. If `rises` is false, the edge of this triangle
    // runs in the opposite direction. Two adjacent faces therefore compute the same number for their common edge, with
    // opposite signs.
    for (int k = 0; k < 3; ++k) {
        const int one = (k + 1) % 3, other = (k + 2) % 3;
        for (int i = 0; i < FACES; ++i) {
            const bool rises = triangles.rises[k][i];
            const double x1 = triangles.column[one][i], x2 = triangles.column[other][i];
            const double y1 = triangles.row[one][i], y2 = triangles.row[other][i];
            triangles.from_x[k][i] = rises ? x1 : x2;
            triangles.from_y[k][i] = rises ? y1 : y2;
            triangles.right[k][i] = rises ? x2 - x1 : x1 - x2;
            triangles.down[k][i] = rises ? y2 - y1 : y1 - y2;
            triangles.sign[k][i] = rises ? sides[i] : -sides[i];
            triangles.slope[k][i] = triangles.right[k][i] / (triangles.down[k][i] == 0.0 ? 1.0 : triangles.down[k][i]);
        }
    }
}

// Store the face of triangle i for a ray if it is nearer than the face stored so far. The stored word has the float32
// bits of the distance in its upper half and the index of the face in its lower half.
template <class Picture>
WARPDIFF_INLINE void keep_nearest(
    const Picture& picture, const Triangles& triangles, int i, double inside0, double inside1, double inside2, int ray)
{
    const double total = inside0 + inside1 + inside2;
    if (!(total > 0.0)) return;
    const double d0 = triangles.depth[0][i], d1 = triangles.depth[1][i], d2 = triangles.depth[2][i];
    const double depth = picture.orthographic ? (inside0 * d0 + inside1 * d1 + inside2 * d2) / total
                                              : total / (inside0 / d0 + inside1 / d1 + inside2 / d2);
    const float distance = (float)wp::max(depth - picture.before, 0.0);
    unsigned int bits;
    memcpy(&bits, &distance, sizeof(bits));
    keep_smallest(picture.nearest + ray, (unsigned long long)bits << 32 | (unsigned int)triangles.face[i]);
}

// Test whether triangle i covers the ray of each pixel of a row, for the pixels from `left` to `end` (excluded).
template <class Picture>
WARPDIFF_INLINE void visit_pixels(const Picture& picture, const Triangles& triangles, int i, int row, int left, int end)
{
    for (int column = left; column < end; ++column) {
        const int ray = row * picture.width + column;
        const double right = picture.offsets ? picture.offsets[2LL * ray] : 0.0;
        const double down = picture.offsets ? picture.offsets[2LL * ray + 1] : 0.0;
        double inside[3];
        triangles.areas(i, column + 0.5 + right, row + 0.5 + down, inside);
        if (inside[0] >= 0.0 && inside[1] >= 0.0 && inside[2] >= 0.0)
            keep_nearest(picture, triangles, i, inside[0], inside[1], inside[2], ray);
    }
}

// Test whether triangle i covers the rays of the cells of one subdivided pixel.
template <class Picture>
WARPDIFF_INLINE void visit_cells(const Picture& picture, const Triangles& triangles, int i, int row, int column)
{
    typedef float Batch __attribute__((vector_size(4 * CELLS), aligned(4)));
    typedef signed Flags __attribute__((vector_size(4 * CELLS)));
    const Flags BITS = {1, 2, 4, 8, 16, 32, 64, 128};
    double inside[3];
    triangles.areas(i, column + 0.5, row + 0.5, inside);
    bool is_beside = false;
    Batch at_centre[3], along[3], athwart[3];
    for (int k = 0; k < 3; ++k) {
        const double right = triangles.right[k][i], down = triangles.down[k][i], sign = triangles.sign[k][i];
        along[k] = Batch{} + (float)(sign * right);
        athwart[k] = Batch{} + (float)(sign * down);
        at_centre[k] = Batch{} + (float)inside[k];
        is_beside |= inside[k] < -picture.max_cell_offset * (wp::abs(right) + wp::abs(down));
    }
    if (is_beside) return;
    const int first = picture.ranks[row * picture.width + column] * picture.cells;
    for (int cell = 0; cell < picture.cells; cell += CELLS) {
        const Batch x = *(const Batch*)(picture.aside + cell), y = *(const Batch*)(picture.below + cell);
        Batch at[3];
        for (int k = 0; k < 3; ++k) at[k] = at_centre[k] + (along[k] * y - athwart[k] * x);
        const Flags inside_bits = (at[0] >= 0.0f) & (at[1] >= 0.0f) & (at[2] >= 0.0f) & BITS;
        int covered = 0;
        for (int j = 0; j < CELLS; ++j) covered |= inside_bits[j];
        if (cell + CELLS > picture.cells) covered &= (1 << (picture.cells - cell)) - 1;
        for (; covered != 0; covered &= covered - 1) {
            const int j = __builtin_ctz(covered);
            keep_nearest(picture, triangles, i, at[0][j], at[1][j], at[2][j], first + cell + j);
        }
    }
}

// Test whether triangle i covers the rays of the cells of the subdivided pixels of a row, from `left` to `end`
// (excluded).
template <class Picture>
WARPDIFF_INLINE void visit_split_pixels(
    const Picture& picture, const Triangles& triangles, int i, int row, int left, int end)
{
    const int words = (picture.width + 63) / 64;
    for (int word = left / 64; 64 * word < end; ++word) {
        unsigned long long pixels = picture.marks[row * words + word];
        if (64 * word < left) pixels &= ~0ULL << (left - 64 * word);
        if (64 * word + 64 > end) pixels &= ~0ULL >> (64 * word + 64 - end);
        for (; pixels != 0; pixels &= pixels - 1)
            visit_cells(picture, triangles, i, row, 64 * word + __builtin_ctzll(pixels));
    }
}

// Find the camera rays that hit the triangles of a batch. For each triangle, only the rays of pixels in or next to its
// bounding box are tested.
template <class Picture>
inline void visit_rays(const Picture& picture, Triangles& triangles)
{
    set_up(picture, triangles);
    for (int i = 0; i < triangles.count; ++i) {
        if (!(triangles.low_row[i] <= triangles.high_row[i] && triangles.low_column[i] <= triangles.high_column[i]))
            continue;
        for (int row = (int)triangles.low_row[i]; row <= (int)triangles.high_row[i]; ++row) {
            // Range of columns that the triangle may cover in this row, with a margin of one pixel.
            double least = triangles.low_column[i], largest = triangles.high_column[i];
            for (int k = 0; k < 3; ++k) {
                const double slope = triangles.slope[k][i], rise = triangles.sign[k][i] * triangles.down[k][i];
                const double beyond = picture.max_offset * (1.0 + wp::abs(slope));
                const double crossing = triangles.from_x[k][i] + slope * (row + 0.5 - triangles.from_y[k][i]) - 0.5;
                if (rise < 0.0) least = greater(least, wp::floor(crossing - beyond));
                if (rise > 0.0) largest = lesser(largest, wp::ceil(crossing + beyond));
            }
            if (!(least <= largest)) continue;
            if (picture.marks)
                visit_split_pixels(picture, triangles, i, row, (int)least, (int)largest + 1);
            else
                visit_pixels(picture, triangles, i, row, (int)least, (int)largest + 1);
        }
    }
}

// Project a corner with the view coordinates (across, up, depth) into the picture.
template <class Picture>
WARPDIFF_INLINE void project_corner(
    const Picture& picture, double across, double up, double depth, Triangles& triangles, int corner, int i)
{
    const double scale = picture.orthographic ? 1.0 : 1.0 / depth;
    triangles.column[corner][i] = 0.5 * picture.width + picture.per_width * scale * across;
    triangles.row[corner][i] = 0.5 * picture.height - picture.per_height * scale * up;
    triangles.depth[corner][i] = depth;
}

// A face clipped at the near plane: up to four corners in view coordinates (across, up, depth). `rises` states for the
// edge after each corner whether it runs from the vertex with the smaller index to the one with the larger index.
struct ClippedFace {
    double corner[4][3];
    bool rises[4];
    int count = 0;
};

template <class Picture>
WARPDIFF_INLINE ClippedFace clip_face(const Picture& picture, const float* positions, const int* vertices)
{
    const double* const axes = picture.axes;
    double in_view[3][3];
    for (int k = 0; k < 3; ++k) {
        const float* const place = positions + 3LL * vertices[k];
        const double x = place[0] - axes[0], y = place[1] - axes[1], z = place[2] - axes[2];
        in_view[k][0] = x * axes[3] + y * axes[4] + z * axes[5];
        in_view[k][1] = x * axes[6] + y * axes[7] + z * axes[8];
        in_view[k][2] = -(x * axes[9] + y * axes[10] + z * axes[11]);
    }
    ClippedFace clipped;
    for (int k = 0; k < 3; ++k) {
        const int next = (k + 1) % 3;
        const bool rises = vertices[k] < vertices[next];
        if (in_view[k][2] >= NEAR_PLANE) {
            for (int c = 0; c < 3; ++c) clipped.corner[clipped.count][c] = in_view[k][c];
            clipped.rises[clipped.count++] = rises;
        }
        if ((in_view[k][2] >= NEAR_PLANE) == (in_view[next][2] >= NEAR_PLANE)) continue;
        // The point where an edge crosses the near plane is interpolated from the vertex with the smaller index, so
        // that both adjacent faces get the same point.
        const int a = rises ? k : next, b = rises ? next : k;
        const double t = (NEAR_PLANE - in_view[a][2]) / (in_view[b][2] - in_view[a][2]);
        for (int c = 0; c < 2; ++c)
            clipped.corner[clipped.count][c] = in_view[a][c] + t * (in_view[b][c] - in_view[a][c]);
        clipped.corner[clipped.count][2] = NEAR_PLANE;
        clipped.rises[clipped.count++] = rises;
    }
    return clipped;
}

// Add the one or two triangles of a clipped face to the batch. New edges are the cut at the near plane, and the
// diagonal between the two triangles.
template <class Picture>
WARPDIFF_INLINE void add_clipped(const Picture& picture, const ClippedFace& clipped, int face, Triangles& triangles)
{
    for (int k = 2; k < clipped.count; ++k) {
        const int which[3] = {0, k - 1, k}, i = triangles.count++;
        for (int c = 0; c < 3; ++c) {
            const double* const corner = clipped.corner[which[c]];
            project_corner(picture, corner[0], corner[1], corner[2], triangles, c, i);
        }
        // Each entry of `rises` is for the edge opposite to a corner. The diagonal is an edge of both triangles. The
        // triangles run along it in opposite directions, and therefore have opposite values.
        triangles.rises[0][i] = clipped.rises[k - 1];
        triangles.rises[1][i] = k == clipped.count - 1 ? clipped.rises[k] : false;
        triangles.rises[2][i] = k == 2 ? clipped.rises[0] : true;
        triangles.face[i] = face;
        if (triangles.count == FACES) {
            visit_rays(picture, triangles);
            triangles.count = 0;
        }
    }
}

// Project `count` faces from the index `from` on. Return whether any of them crosses the near plane.
template <class Picture>
WARPDIFF_INLINE bool project_faces(
    const Picture& picture, const float* positions, const int* faces, int from, int count, Triangles& triangles)
{
    const double* const axes = picture.axes;
    bool behind[FACES] = {};
    for (int corner = 0; corner < 3; ++corner) {
        float places[3][FACES];
        for (int i = 0; i < FACES; ++i) {
            const int* const vertices = faces + 3LL * (from + (i < count ? i : 0));
            const float* const place = positions + 3LL * vertices[corner];
            for (int c = 0; c < 3; ++c) places[c][i] = place[c];
            triangles.rises[corner][i] = vertices[(corner + 1) % 3] < vertices[(corner + 2) % 3];
        }
        for (int i = 0; i < FACES; ++i) {
            const double x = places[0][i] - axes[0], y = places[1][i] - axes[1], z = places[2][i] - axes[2];
            const double depth = -(x * axes[9] + y * axes[10] + z * axes[11]);
            project_corner(picture, x * axes[3] + y * axes[4] + z * axes[5], x * axes[6] + y * axes[7] + z * axes[8],
                depth, triangles, corner, i);
            behind[i] |= !(depth >= NEAR_PLANE);
        }
    }
    bool any = false;
    for (int i = 0; i < count; ++i) {
        triangles.face[i] = from + i;
        any |= behind[i];
    }
    triangles.count = count;
    return any;
}

// Rasterize the faces from `begin` to `end`, and store the nearest face of each ray.
template <int MOST_CELLS, class Camera, class Surface, class Sampling, class Cells, class Nearest>
WARPDIFF_INLINE void rasterize_faces(const Camera& camera, const Surface& surface, const Sampling& sampling,
    const Cells& cells, double max_offset, int begin, int end, Nearest& nearest_out)
{
    const Raster<MOST_CELLS> picture(camera, sampling, cells, max_offset, nearest_out);
    const int* const faces = numbers<const int>(surface.faces);
    const float* const positions = numbers<const float>(surface.positions);
    Triangles triangles;
    for (int from = begin; from < end; from += FACES) {
        const int count = wp::min(end - from, FACES);
        const bool is_cut = project_faces(picture, positions, faces, from, count, triangles);
        if (is_cut) {
            triangles.count = 0;
            for (int face = from; face < from + count; ++face)
                add_clipped(picture, clip_face(picture, positions, faces + 3LL * face), face, triangles);
        }
        if (triangles.count > 0) visit_rays(picture, triangles);
    }
}

#endif

} // namespace warpdiff
