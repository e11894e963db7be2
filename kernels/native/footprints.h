// Footprints of pixels: first-order changes of the tangential scattering vector (u, v) over a pixel. They are computed
// by ray differentials (Igehy 1999) on the face that the camera ray hits.

#pragma once

#include "pixel_batch.h"
#include "simd.h"
#include "vectors.h"

namespace warpdiff {

struct FootprintLimits {
    float least_cosine; // least cosine between a shading normal and the view direction
    float least_facing; // least cosine between the view direction and a face's normal; smaller ones are replaced by it
};

// Displacements of a camera ray in the picture plane by one standard deviation of the pixel filter, to the right and
// downwards. The eye and the backward axis of the camera are stored, too.
struct FilterSteps {
    float step[2][3], back[3], eye[3];
    bool perspective;

    template <class Camera>
    WARPDIFF_INLINE FilterSteps(const Camera& camera, float deviation)
    {
        const double* const axes = numbers<const double>(camera.axes);
        for (int c = 0; c < 3; ++c) {
            step[0][c] = (float)(deviation * 2.0 * axes[12] / camera.width * axes[3 + c]);
            step[1][c] = (float)(-deviation * 2.0 * axes[13] / camera.height * axes[6 + c]);
            back[c] = (float)axes[9 + c];
            eye[c] = (float)axes[c];
        }
        perspective = !camera.orthographic;
    }
};

// Shading frames, scattering vectors and footprints of a batch of pixels.
template <int N>
struct FootprintBatch {
    Batch<N> tangent[3], bitangent[3], normal[3], minus_uvw[3];
    Batch<N> footprint[4];

    template <class Pixels>
    WARPDIFF_INLINE void load(const Pixels& pixels, const double* uvw, const Batch<N, bool>& met, int from, int count)
    {
        const float* const frames[3] = {numbers<const float>(pixels.tangent), numbers<const float>(pixels.bitangent),
            numbers<const float>(pixels.normal)};
        for (int i = 0; i < N; ++i) {
            const long long at = 3LL * (from + (i < count ? i : 0));
            for (int c = 0; c < 3; ++c) {
                tangent[c][i] = met[i] ? frames[0][at + c] : 0.0f;
                bitangent[c][i] = met[i] ? frames[1][at + c] : 0.0f;
                normal[c][i] = met[i] ? frames[2][at + c] : 0.0f;
                minus_uvw[c][i] = met[i] ? (float)-uvw[at + c] : 0.0f;
            }
        }
    }
};

// Derivatives of the barycentric coordinates of a hit with respect to displacements of the camera ray in the picture
// plane. The hit point then moves in the plane of the face: by the displacement of the ray plus a multiple of the view
// direction. `facing` is −1 if the back of the face is towards the camera, and 1 otherwise.
struct HitDifferentials {
    float view[3], of_share1[3], of_share2[3], across[3];
    float slide1, slide2, scale, per_unit, facing;

    // Compute the derivatives of a hit on a face. `edge1` and `edge2` are the edges of the face from its first corner
    // to the other two. `away` is the vector from the hit point to the eye. The member `view`, the unit vector to the
    // viewer, is set before.
    WARPDIFF_INLINE void differentiate(
        const float* edge1, const float* edge2, const float* away, const FilterSteps& filter, float least_facing)
    {
        cross(edge1, edge2, across);
        cross(edge2, across, of_share1);
        cross(across, edge1, of_share2);
        const float area2 = dot(across, across) + 1.0e-30f, rotated = dot(across, view);
        facing = rotated < 0.0f ? -1.0f : 1.0f;
        const float least = least_facing * wp::sqrt(area2);
        const float per_facing = 1.0f / (facing * rotated > least ? rotated : facing * least);
        slide1 = dot(view, of_share1) * per_facing;
        slide2 = dot(view, of_share2) * per_facing;
        // Factors that convert a length in the picture plane: `per_unit` to a change of the view direction, and `scale`
        // to a distance near the hit point.
        per_unit = filter.perspective ? dot(view, filter.back) : 0.0f;
        scale = (filter.perspective ? per_unit * wp::sqrt(dot(away, away)) : 1.0f) / area2;
    }
};

// Derivatives with respect to displacements of the camera ray: of a hit on a face, and of vertex attributes that are
// interpolated with the barycentric coordinates of the hit.
struct FaceDifferentials : HitDifferentials {
    float normal1[3], normal2[3], tangent1[3], tangent2[3], blend[3], tangent[3];
};

template <int N>
WARPDIFF_INLINE FaceDifferentials differentiate_face(
    const PixelBatch<N>& pixels, int i, const FilterSteps& filter, FootprintLimits limits)
{
    FaceDifferentials face;
    const float share1 = pixels.share1[i], share2 = 1.0f - pixels.share0[i] - pixels.share1[i];
    float edge1[3], edge2[3], away[3];
    for (int c = 0; c < 3; ++c) {
        face.view[c] = pixels.to_view[c][i];
        edge1[c] = pixels.position[1][c][i] - pixels.position[0][c][i];
        edge2[c] = pixels.position[2][c][i] - pixels.position[0][c][i];
        face.normal1[c] = pixels.normal[1][c][i] - pixels.normal[0][c][i];
        face.normal2[c] = pixels.normal[2][c][i] - pixels.normal[0][c][i];
        face.tangent1[c] = pixels.tangent[1][c][i] - pixels.tangent[0][c][i];
        face.tangent2[c] = pixels.tangent[2][c][i] - pixels.tangent[0][c][i];
        face.blend[c] = pixels.normal[0][c][i] + share1 * face.normal1[c] + share2 * face.normal2[c];
        face.tangent[c] = pixels.tangent[0][c][i] + share1 * face.tangent1[c] + share2 * face.tangent2[c];
        away[c] = filter.eye[c] - pixels.position[0][c][i] - share1 * edge1[c] - share2 * edge2[c];
    }
    face.differentiate(edge1, edge2, away, filter, limits.least_facing);
    return face;
}

// Compute the changes of (u, v) if the camera ray is displaced along each axis of the picture. A displacement also
// changes the shading frame, because its normal and tangent are interpolated between the corners of the face.
template <int N>
WARPDIFF_INLINE void differentiate_scattering_vector(const FaceDifferentials& face, const FilterSteps& filter,
    bool smooth, float least_cosine, int i, FootprintBatch<N>& batch)
{
    float t[3], b[3], n[3];
    for (int c = 0; c < 3; ++c) {
        t[c] = batch.tangent[c][i];
        b[c] = batch.bitangent[c][i];
        n[c] = batch.normal[c][i];
    }
    const float length2 = dot(face.blend, face.blend);
    const bool blends = smooth && length2 > 1.0e-8f;
    const float per_length = blends ? face.facing / wp::sqrt(length2) : 0.0f;
    const float clamped = blends && per_length * dot(face.blend, face.view) < least_cosine ? 1.0f : 0.0f;
    const float tilt = dot(face.tangent, n), left2 = dot(face.tangent, face.tangent) - tilt * tilt;
    const float per_tangent = left2 > 1.0e-10f ? 1.0f / wp::sqrt(left2) : 0.0f;
    const float t_view = dot(t, face.view), b_view = dot(b, face.view), n_view = dot(n, face.view);
    const float t_normal1 = dot(t, face.normal1), t_normal2 = dot(t, face.normal2);
    const float b_normal1 = dot(b, face.normal1), b_normal2 = dot(b, face.normal2);
    const float b_tangent1 = dot(b, face.tangent1), b_tangent2 = dot(b, face.tangent2);
    for (int axis = 0; axis < 2; ++axis) {
        const float* const step = filter.step[axis];
        const float along = dot(face.view, step), through = dot(face.across, step);
        const float share1 = face.scale * (dot(face.of_share1, step) - face.slide1 * through);
        const float share2 = face.scale * (dot(face.of_share2, step) - face.slide2 * through);
        // Change of the view direction, as components along the three axes of the shading frame.
        const float t_turn = -face.per_unit * (dot(t, step) - along * t_view);
        const float b_turn = -face.per_unit * (dot(b, step) - along * b_view);
        const float n_turn = -face.per_unit * (dot(n, step) - along * n_view);
        float of_t = per_length * (share1 * t_normal1 + share2 * t_normal2);
        float of_b = per_length * (share1 * b_normal1 + share2 * b_normal2);
        // Where the shading normal was rotated towards the viewer, its angle with the view direction remains constant.
        // In the plane of both directions, the change of the normal therefore equals the change of the view direction.
        const float of_cosine = clamped * (of_t * t_view + of_b * b_view + n_turn);
        of_t -= of_cosine * t_view;
        of_b -= of_cosine * b_view;
        const float round = per_tangent * (share1 * b_tangent1 + share2 * b_tangent2 - tilt * of_b);
        batch.footprint[2 * axis][i] = round * batch.minus_uvw[1][i] - of_t * batch.minus_uvw[2][i] + t_turn;
        batch.footprint[2 * axis + 1][i] = -round * batch.minus_uvw[0][i] - of_b * batch.minus_uvw[2][i] + b_turn;
    }
}

// Compute the footprints of the rays from `begin` to `end`; `deviation` is the standard deviation of the filter of a
// pixel or cell [pixels].
template <int BATCH, class Camera, class Surface, class Pixels, class ScatteringVectors, class Footprints>
WARPDIFF_INLINE void find_footprints(const Camera& camera, const Surface& surface, const Pixels& pixels,
    const ScatteringVectors& scattering_vectors, float deviation, int begin, int end, FootprintLimits limits,
    Footprints& footprints_out)
{
    constexpr int N = batch_of(BATCH);
    const int* const hit = numbers<const int>(pixels.hit);
    const FilterSteps filter(camera, deviation);
    const bool smooth = surface.smooth;
    for (int from = begin; from < end; from += N) {
        const int count = wp::min(end - from, N);
        float* const out = numbers<float>(footprints_out) + 4LL * from;
        if (!any_hit(hit + from, count)) {
            memset(out, 0, 4 * count * sizeof(float));
            continue;
        }
        PixelBatch<N> pixel_batch;
        FootprintBatch<N> batch;
        pixel_batch.load(surface, pixels, from, count);
        batch.load(pixels, numbers<const double>(scattering_vectors), pixel_batch.met, from, count);
        for (int i = 0; i < N; ++i) {
            const FaceDifferentials face = differentiate_face(pixel_batch, i, filter, limits);
            differentiate_scattering_vector(face, filter, smooth, limits.least_cosine, i, batch);
        }
        for (int i = 0; i < count; ++i)
            for (int c = 0; c < 4; ++c) out[4LL * i + c] = pixel_batch.met[i] ? batch.footprint[c][i] : 0.0f;
    }
}

} // namespace warpdiff
