// Hits of camera rays: where a ray meets its nearest face, which is already known.

#pragma once

#include "simd.h"
#include "vectors.h"

namespace warpdiff {

// A batch of rays that hit a face: indices of rays and faces, and positions of the rays in the picture [pixels].
template <int N>
struct KnownHits {
    int count = 0;
    Batch<N, int> ray, face;
    Batch<N, double> right = {}, down = {};
};

// Corners of the faces that a batch of rays hits. The results of the intersection are the directions to the viewer and
// the barycentric coordinates.
template <int N>
struct Intersections {
    Batch<N> corner[3][3], to_view[3], share[2];
};

template <int N, class Surface>
WARPDIFF_INLINE void load_corners(const Surface& surface, const KnownHits<N>& hits, Intersections<N>& intersections)
{
    const int* const faces = numbers<const int>(surface.faces);
    const float* const positions = numbers<const float>(surface.positions);
    for (int i = 0; i < N; ++i) {
        const int* const corners = faces + 3LL * (i < hits.count ? hits.face[i] : 0);
        for (int which = 0; which < 3; ++which)
            for (int c = 0; c < 3; ++c) intersections.corner[which][c][i] = positions[3LL * corners[which] + c];
    }
}

// Compute barycentric coordinates of hits by the method of Möller and Trumbore, and directions to the viewer. A hit
// that is outside of its face by rounding is moved to the edge of the face. The computation uses float64, because the
// eye may be thousands of mesh radii away from the mesh.
template <int N, class Camera>
WARPDIFF_INLINE void intersect(const Camera& camera, const KnownHits<N>& hits, Intersections<N>& intersections)
{
    const double* const axes = numbers<const double>(camera.axes);
    const bool orthographic = camera.orthographic;
    const double per_width = 2.0 * axes[12] / camera.width, per_height = 2.0 * axes[13] / camera.height;
    for (int i = 0; i < N; ++i) {
        const double x = per_width * hits.right[i] - axes[12], y = axes[13] - per_height * hits.down[i];
        double along[3], edge1[3], edge2[3], away[3], across1[3], across2[3];
        for (int c = 0; c < 3; ++c) {
            const double across = x * axes[3 + c] + y * axes[6 + c];
            along[c] = (orthographic ? 0.0 : across) - axes[9 + c];
            away[c] = axes[c] + (orthographic ? across : 0.0) - intersections.corner[0][c][i];
            edge1[c] = (double)intersections.corner[1][c][i] - intersections.corner[0][c][i];
            edge2[c] = (double)intersections.corner[2][c][i] - intersections.corner[0][c][i];
        }
        const double per_length = 1.0 / wp::sqrt(dot(along, along));
        for (int c = 0; c < 3; ++c) {
            along[c] *= per_length;
            intersections.to_view[c][i] = -(float)along[c];
        }
        cross(along, edge2, across2);
        cross(away, edge1, across1);
        const double determinant = dot(edge1, across2);
        const double inverse = determinant == 0.0 ? 0.0 : 1.0 / determinant;
        const double share1 = inverse * dot(away, across2), share2 = inverse * dot(along, across1);
        const double clamped1 = wp::min(wp::max(share1, 0.0), 1.0),
                     clamped2 = wp::min(wp::max(share2, 0.0), 1.0 - clamped1);
        intersections.share[0][i] = (float)(1.0 - clamped1 - clamped2);
        intersections.share[1][i] = (float)clamped1;
    }
}

// Store the hits of a batch of rays, and empty the batch.
template <int N, class Camera, class Surface, class Pixels>
WARPDIFF_INLINE void put_hits(const Camera& camera, const Surface& surface, const Pixels& pixels, KnownHits<N>& hits)
{
    Intersections<N> intersections;
    load_corners(surface, hits, intersections);
    intersect(camera, hits, intersections);
    for (int i = 0; i < hits.count; ++i) {
        const long long at = hits.ray[i];
        numbers<int>(pixels.hit)[at] = 1;
        numbers<int>(pixels.face)[at] = hits.face[i];
        for (int c = 0; c < 2; ++c) numbers<float>(pixels.place)[2 * at + c] = intersections.share[c][i];
        for (int c = 0; c < 3; ++c) numbers<float>(pixels.to_view)[3 * at + c] = intersections.to_view[c][i];
    }
    hits.count = 0;
}

// Intersect the rays of pixels or subpixel cells from `begin` to `end` with the nearest face of each ray. UNSEEN marks
// rays that hit no face.
template <int BATCH, unsigned long long UNSEEN, class Camera, class Surface, class Sampling, class Pixels>
WARPDIFF_INLINE void intersect_known_faces(
    const Camera& camera, const Surface& surface, const Sampling& sampling, const Pixels& pixels, int begin, int end)
{
    const unsigned long long* const nearest = numbers<const unsigned long long>(pixels.nearest);
    const int* const tiles = numbers<const int>(sampling.tiles);
    const double* const places = numbers<const double>(sampling.places);
    const double* const offsets = numbers<const double>(sampling.offsets);
    const bool of_tiles = !is_empty(sampling.tiles), scattered = !is_empty(sampling.offsets);
    const int width = camera.width, of_tile = of_tiles ? (int)sampling.places.shape[0] : 1;
    KnownHits<batch_of(BATCH)> hits;
    for (int ray = begin; ray < end;) {
        const int pixel = of_tiles ? tiles[ray / of_tile] : ray, row = pixel / width, column = pixel % width;
        // Number of rays that are processed in this round, beginning with `ray`. The round ends at the end of the
        // picture row, or after the last cell of the pixel, or at the ray `end`.
        int count = of_tiles ? of_tile - ray % of_tile : width - column;
        count = count < end - ray ? count : end - ray;
        for (int k = 0; k < count; ++k) {
            const int at = ray + k;
            numbers<int>(pixels.hit)[at] = 0;
            numbers<int>(pixels.face)[at] = -1;
            if (nearest[at] == UNSEEN) continue;
            const int i = hits.count++;
            hits.ray[i] = at;
            hits.face[i] = (int)(unsigned int)nearest[at];
            const double* const place = of_tiles ? places + 2 * (at % of_tile) : scattered ? offsets + 2 * at : nullptr;
            hits.right[i] = column + (of_tiles ? 0 : k) + 0.5 + (place ? place[0] : 0.0);
            hits.down[i] = row + 0.5 + (place ? place[1] : 0.0);
            if (hits.count == batch_of(BATCH)) put_hits(camera, surface, pixels, hits);
        }
        ray += count;
    }
    if (hits.count > 0) put_hits(camera, surface, pixels, hits);
}

} // namespace warpdiff
