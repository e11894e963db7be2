"""Footprints of pixels in (u, v), to first order: ray differentials (Igehy 1999) on the face that a ray has met.

The eye's direction, the point of the face's plane, its shading frame and so (u, v) change with the place in the picture
in closed form. Nothing is asked of the pixels beside, so that nothing leaks over edges, and every ray has its own.
"""

import warp as wp

from warpdiff.kernels.shading_frames import LEAST_COSINE
from warpdiff.kernels.snippets import filled, simd_batch
from warpdiff.kernels.structs import Camera, Footprint, Pixels, SurfaceArrays

# The least cosine between the view and a face that its plane is followed at: below, a footprint is a streak anyway.
_LEAST_FACING = 1e-4

# Pixels side by side, step after step, so that the compiler makes vectors of each; a GPU takes one at a time.
_SPREAD = """
    const double* const axes = (const double*)camera.axes.data;
    const int* const is_hit = (const int*)pixels.hit.data;
    const int* const faces = (const int*)surface.faces.data;
    const float* const of_corners[3] = {(const float*)surface.positions.data, (const float*)surface.normals.data,
        (const float*)surface.tangents.data};
    const float* const of_pixels[4] = {(const float*)pixels.tangent.data, (const float*)pixels.bitangent.data,
        (const float*)pixels.normal.data, (const float*)pixels.to_view.data};
    const float* const places = (const float*)pixels.place.data;
    const double* const uvw = (const double*)deflections.data;
    float* const out = (float*)footprints_out.data;
    const bool smooth = surface.smooth, perspective = !camera.orthographic;
    // By a deviation to the right, and downwards.
    float steps[2][3], back[3], eye[3];
    for (int c = 0; c < 3; ++c) {
        steps[0][c] = (float)(deviation * 2.0 * axes[12] / camera.width * axes[3 + c]);
        steps[1][c] = (float)(-deviation * 2.0 * axes[13] / camera.height * axes[6 + c]);
        back[c] = (float)axes[9 + c];
        eye[c] = (float)axes[c];
    }
    auto dot = [](const float* a, const float* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; };
    auto cross = [](const float* a, const float* b, float* result) {
        result[0] = a[1] * b[2] - a[2] * b[1];
        result[1] = a[2] * b[0] - a[0] * b[2];
        result[2] = a[0] * b[1] - a[1] * b[0];
    };
    for (int from = begin; from < end; from += ABREAST) {
        const int count = wp::min(end - from, ABREAST);
        int hits = 0;
        for (int i = 0; i < count; ++i) hits |= is_hit[from + i];
        if (hits == 0) {
            memset(out + 4LL * from, 0, 4 * count * sizeof(float));
            continue;
        }
        // Where nothing is met, what is there of any face and pixel.
        float corner[3][3][3][ABREAST], frame[4][3][ABREAST], b0[ABREAST], b1[ABREAST], seen[3][ABREAST];
        float made[4][ABREAST];
        for (int i = 0; i < ABREAST; ++i) {
            const int k = from + (i < count ? i : 0);
            const bool met = is_hit[k] != 0;
            const int* const corners = faces + 3LL * (met ? ((const int*)pixels.face.data)[k] : 0);
            for (int which = 0; which < 3; ++which) {
                const long long at = 3LL * corners[which];
                for (int what = 0; what < 3; ++what)
                    for (int c = 0; c < 3; ++c) corner[what][which][c][i] = of_corners[what][at + c];
            }
            for (int what = 0; what < 4; ++what)
                for (int c = 0; c < 3; ++c) frame[what][c][i] = met ? of_pixels[what][3LL * k + c] : 0.0f;
            for (int c = 0; c < 3; ++c) seen[c][i] = met ? (float)-uvw[3LL * k + c] : 0.0f;
            b0[i] = met ? places[2LL * k] : 0.0f;
            b1[i] = met ? places[2LL * k + 1] : 0.0f;
        }
        for (int i = 0; i < ABREAST; ++i) {
            const float share[3] = {b0[i], b1[i], 1.0f - b0[i] - b1[i]};
            float t[3], b[3], n[3], view[3], edge1[3], edge2[3], across[3], of_share1[3], of_share2[3], away[3];
            float blend[3], tangent[3], normal1[3], normal2[3], tangent1[3], tangent2[3];
            for (int c = 0; c < 3; ++c) {
                t[c] = frame[0][c][i];
                b[c] = frame[1][c][i];
                n[c] = frame[2][c][i];
                view[c] = frame[3][c][i];
                edge1[c] = corner[0][1][c][i] - corner[0][0][c][i];
                edge2[c] = corner[0][2][c][i] - corner[0][0][c][i];
                normal1[c] = corner[1][1][c][i] - corner[1][0][c][i];
                normal2[c] = corner[1][2][c][i] - corner[1][0][c][i];
                tangent1[c] = corner[2][1][c][i] - corner[2][0][c][i];
                tangent2[c] = corner[2][2][c][i] - corner[2][0][c][i];
                blend[c] = corner[1][0][c][i] + share[1] * normal1[c] + share[2] * normal2[c];
                tangent[c] = corner[2][0][c][i] + share[1] * tangent1[c] + share[2] * tangent2[c];
                away[c] = eye[c] - corner[0][0][c][i] - share[1] * edge1[c] - share[2] * edge2[c];
            }
            // What a move in the picture's plane, projected along the view, changes of the shares of corners.
            cross(edge1, edge2, across);
            cross(edge2, across, of_share1);
            cross(across, edge1, of_share2);
            const float area2 = dot(across, across) + 1.0e-30f, turned = dot(across, view);
            const float facing = turned < 0.0f ? -1.0f : 1.0f, least = LEAST_FACING * wp::sqrt(area2);
            const float per_facing = 1.0f / (facing * turned > least ? turned : facing * least);
            const float slide1 = dot(view, of_share1) * per_facing, slide2 = dot(view, of_share2) * per_facing;
            // How far along the view a unit of that plane lies, and the mesh.
            const float per_unit = perspective ? dot(view, back) : 0.0f;
            const float scale = (perspective ? per_unit * wp::sqrt(dot(away, away)) : 1.0f) / area2;
            // The frame turns as a whole: with the normal, and about it with the tangent.
            const float length2 = dot(blend, blend);
            const bool blends = smooth && length2 > 1.0e-8f;
            const float per_length = blends ? facing / wp::sqrt(length2) : 0.0f;
            const float clamped = blends && per_length * dot(blend, view) < LEAST_COSINE ? 1.0f : 0.0f;
            const float tilt = dot(tangent, n), tangent2_left = dot(tangent, tangent) - tilt * tilt;
            const float per_tangent = tangent2_left > 1.0e-10f ? 1.0f / wp::sqrt(tangent2_left) : 0.0f;
            const float t_view = dot(t, view), b_view = dot(b, view), n_view = dot(n, view);
            const float t_normal1 = dot(t, normal1), t_normal2 = dot(t, normal2);
            const float b_normal1 = dot(b, normal1), b_normal2 = dot(b, normal2);
            const float b_tangent1 = dot(b, tangent1), b_tangent2 = dot(b, tangent2);
            for (int axis = 0; axis < 2; ++axis) {
                const float* const step = steps[axis];
                const float along = dot(view, step), through = dot(across, step);
                const float share1 = scale * (dot(of_share1, step) - slide1 * through);
                const float share2 = scale * (dot(of_share2, step) - slide2 * through);
                // What the view changes by, of each axis of the frame.
                const float t_turn = -per_unit * (dot(t, step) - along * t_view);
                const float b_turn = -per_unit * (dot(b, step) - along * b_view);
                const float n_turn = -per_unit * (dot(n, step) - along * n_view);
                float of_t = per_length * (share1 * t_normal1 + share2 * t_normal2);
                float of_b = per_length * (share1 * b_normal1 + share2 * b_normal2);
                // A normal that was turned to the viewer keeps its angle with the view.
                const float of_cosine = clamped * (of_t * t_view + of_b * b_view + n_turn);
                of_t -= of_cosine * t_view;
                of_b -= of_cosine * b_view;
                const float round = per_tangent * (share1 * b_tangent1 + share2 * b_tangent2 - tilt * of_b);
                made[2 * axis][i] = round * seen[1][i] - of_t * seen[2][i] + t_turn;
                made[2 * axis + 1][i] = -round * seen[0][i] - of_b * seen[2][i] + b_turn;
            }
        }
        for (int i = 0; i < count; ++i)
            for (int c = 0; c < 4; ++c) out[4LL * (from + i) + c] = is_hit[from + i] != 0 ? made[c][i] : 0.0f;
    }
"""


@wp.func_native(
    filled(simd_batch(16) + _SPREAD, LEAST_COSINE=f"{float(LEAST_COSINE)}f", LEAST_FACING=f"{_LEAST_FACING}f")
)
def pixel_footprints_run(
    camera: Camera,
    surface: SurfaceArrays,
    pixels: Pixels,
    deflections: wp.array(dtype=wp.vec3d),
    deviation: wp.float32,
    begin: wp.int32,
    end: wp.int32,
    footprints_out: wp.array(dtype=Footprint),
):
    """Footprints of rays one after the other."""
