// Shading frames (normal, tangent, bitangent) of pixels, and start points of shadow rays.

#pragma once

#include "pixel_batch.h"
#include "simd.h"
#include "vectors.h"

namespace warpdiff {

struct FrameLimits {
    float least_cosine;   // least cosine between the normal and the view direction
    float least_tangent2; // least squared length of the tangent's component perpendicular to the normal
    float lift;           // height of the origins of shadow rays above the surface [radii of the mesh]
};

// Shading frames of N pixels, with one array per axis. In special pixels, the normal must be rotated towards the
// viewer, or the tangent is parallel to the normal. Special pixels are only marked here and computed separately.
template <int N>
struct ShadingFrames {
    Batch<N> tangent[3], bitangent[3], normal[3], shadow_origin[3];
    Batch<N, bool> is_special;
};

// Compute the start point of a shadow ray (Hanika 2021, "Hacking the shadow terminator"). A point below the tangent
// planes of the face's corners is moved up to these planes, where the smooth surface would be. Without this, faces of a
// convex surface would shadow each other at grazing incidence. The displacement is reduced if the normal of a corner is
// rotated by more than 30° from the normal `across` of the face, and is zero from 45°: the flat sides of a box with
// rounded normals would otherwise be displaced by half their length, to where nothing shadows them.
template <int N>
WARPDIFF_INLINE void lift_to_tangent_planes(const PixelBatch<N>& pixels, int i, const float* share, const float* point,
    const float* across, float side, bool smooth, float* origin)
{
    constexpr float least = 0.70710678f, full = 0.86602540f;
    for (int c = 0; c < 3; ++c) origin[c] = smooth ? 0.0f : point[c];
    for (int which = 0; which < 3; ++which) {
        float above = 0.0f, cosine = 0.0f;
        for (int c = 0; c < 3; ++c) {
            above += side * pixels.normal[which][c][i] * (point[c] - pixels.position[which][c][i]);
            cosine += side * pixels.normal[which][c][i] * across[c];
        }
        const float part = wp::min(wp::max((cosine - least) * (1.0f / (full - least)), 0.0f), 1.0f);
        const float lift = above < 0.0f ? above * side * part : 0.0f;
        for (int c = 0; c < 3; ++c)
            origin[c] += smooth ? share[which] * (point[c] - lift * pixels.normal[which][c][i]) : 0.0f;
    }
}

// Compute the normalised component of a pixel's tangent perpendicular to its normal. Return the squared length of that
// component before normalisation.
template <int N>
WARPDIFF_INLINE float project_tangent(
    const PixelBatch<N>& pixels, int i, const float* share, const float* normal, float* tangent)
{
    float along = 0.0f;
    for (int c = 0; c < 3; ++c) {
        tangent[c] = share[0] * pixels.tangent[0][c][i] + share[1] * pixels.tangent[1][c][i]
            + share[2] * pixels.tangent[2][c][i];
        along += tangent[c] * normal[c];
    }
    for (int c = 0; c < 3; ++c) tangent[c] -= along * normal[c];
    const float left2 = dot(tangent, tangent);
    // If tangent and normal are nearly parallel, the perpendicular component is short and has a large relative rounding
    // error. A second projection removes the error along the normal.
    float again = 0.0f, tangent2 = 0.0f;
    for (int c = 0; c < 3; ++c) again += tangent[c] * normal[c];
    for (int c = 0; c < 3; ++c) {
        tangent[c] -= again * normal[c];
        tangent2 += tangent[c] * tangent[c];
    }
    const float per_tangent = 1.0f / wp::sqrt(tangent2);
    for (int c = 0; c < 3; ++c) tangent[c] *= per_tangent;
    return left2;
}

// Compute the shading frames of a batch of pixels. `handedness` is −1 for pixels whose face has mirrored texture
// coordinates, and +1 for other pixels.
template <int N>
WARPDIFF_INLINE void find_frames(
    const PixelBatch<N>& pixels, const Batch<N>& handedness, bool smooth, FrameLimits limits, ShadingFrames<N>& frames)
{
    for (int i = 0; i < N; ++i) {
        const float share2 = 1.0f - pixels.share0[i] - pixels.share1[i];
        const float share[3] = {pixels.share0[i], pixels.share1[i], share2 > 0.0f ? share2 : 0.0f};
        float edge1[3], edge2[3], across[3], view[3], point[3], blend[3], normal[3], tangent[3], bitangent[3],
            origin[3];
        for (int c = 0; c < 3; ++c) {
            const float p0 = pixels.position[0][c][i], p1 = pixels.position[1][c][i], p2 = pixels.position[2][c][i];
            edge1[c] = p1 - p0;
            edge2[c] = p2 - p0;
            point[c] = share[0] * p0 + share[1] * p1 + share[2] * p2;
            view[c] = pixels.to_view[c][i];
        }
        cross(edge1, edge2, across);
        const float side = dot(across, view) < 0.0f ? -1.0f : 1.0f;
        const float per_across = side / wp::sqrt(dot(across, across));
        for (int c = 0; c < 3; ++c) {
            across[c] *= per_across;
            blend[c] = 0.0f;
            for (int which = 0; which < 3; ++which) blend[c] += share[which] * side * pixels.normal[which][c][i];
        }
        const float size2 = dot(blend, blend), per_size = 1.0f / wp::sqrt(size2);
        const bool blends = smooth && size2 > 1.0e-8f;
        for (int c = 0; c < 3; ++c) normal[c] = blends ? per_size * blend[c] : across[c];
        lift_to_tangent_planes(pixels, i, share, point, across, side, smooth, origin);
        const float left2 = project_tangent(pixels, i, share, normal, tangent);
        frames.is_special[i] = dot(normal, view) < limits.least_cosine || !(left2 > limits.least_tangent2);
        cross(normal, tangent, bitangent);
        for (int c = 0; c < 3; ++c) {
            frames.tangent[c][i] = tangent[c];
            frames.bitangent[c][i] = handedness[i] * bitangent[c];
            frames.normal[c][i] = normal[c];
            frames.shadow_origin[c][i] = origin[c] + limits.lift * across[c];
        }
    }
}

// Store one vector per pixel, with zeros for pixels that do not hit the mesh. A loop that skips these pixels would be
// slower.
template <int N>
WARPDIFF_INLINE void put_vectors(float* out, const Batch<N> (&vectors)[3], const Batch<N, bool>& met, int count)
{
    for (int i = 0; i < count; ++i)
        for (int c = 0; c < 3; ++c) out[3LL * i + c] = met[i] ? vectors[c][i] : 0.0f;
}

// Compute the shading frames of the pixels from `begin` to `end`. Pixels with special cases are only marked, by
// `hit` = SPECIAL, and computed later. Return the number of marked pixels.
template <int BATCH, int SPECIAL, class Surface, class Pixels>
WARPDIFF_INLINE int make_shading_frames(
    const Surface& surface, const Pixels& pixels, int begin, int end, FrameLimits limits)
{
    constexpr int N = batch_of(BATCH);
    int* const hit = numbers<int>(pixels.hit);
    int specials = 0;
    for (int from = begin; from < end; from += N) {
        const int count = wp::min(end - from, N);
        if (!any_hit(hit + from, count)) continue;
        PixelBatch<N> batch;
        batch.load(surface, pixels, from, count);
        Batch<N> handedness;
        for (int i = 0; i < N; ++i)
            handedness[i] = numbers<const float>(
                surface.handedness)[batch.corners_of(surface, pixels, from + (i < count ? i : 0), batch.met[i])[0]];
        ShadingFrames<N> frames;
        find_frames(batch, handedness, surface.smooth, limits, frames);
        put_vectors(numbers<float>(pixels.tangent) + 3LL * from, frames.tangent, batch.met, count);
        put_vectors(numbers<float>(pixels.bitangent) + 3LL * from, frames.bitangent, batch.met, count);
        put_vectors(numbers<float>(pixels.normal) + 3LL * from, frames.normal, batch.met, count);
        put_vectors(numbers<float>(pixels.shadow_origin) + 3LL * from, frames.shadow_origin, batch.met, count);
        for (int i = 0; i < count; ++i) {
            const bool is_special = batch.met[i] && frames.is_special[i];
            hit[from + i] = is_special ? SPECIAL : hit[from + i];
            specials += is_special;
        }
    }
    return specials;
}

} // namespace warpdiff
