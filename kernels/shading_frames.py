"""How a mesh lies where rays meet it: shading frames, and where shadow rays start."""

import warp as wp

from warpdiff.kernels.snippets import filled, simd_batch
from warpdiff.kernels.structs import SPECIAL, Pixels, SurfaceArrays

# How far a shadow ray starts above the surface: some hundred roundings of a position.
LIFT = wp.constant(wp.float32(1.0e-5))
# The least cosine between the shading normal and the view.
LEAST_COSINE = wp.constant(wp.float32(0.01))
# The least square of a tangent's part at right angles to the normal.
LEAST_TANGENT = wp.constant(wp.float32(1.0e-10))


@wp.func
def perpendicular(v: wp.vec3f) -> wp.vec3f:
    """A unit vector at right angles to the unit vector ``v``: the axis that is furthest from it, projected."""
    axis = wp.vec3f(1.0, 0.0, 0.0)
    size = wp.abs(v[0])
    if wp.abs(v[1]) < size:
        axis = wp.vec3f(0.0, 1.0, 0.0)
        size = wp.abs(v[1])
    if wp.abs(v[2]) < size:
        axis = wp.vec3f(0.0, 0.0, 1.0)
    return wp.normalize(axis - wp.dot(axis, v) * v)


@wp.func
def face_the_viewer(normal: wp.vec3f, geometric: wp.vec3f, to_view: wp.vec3f) -> wp.vec3f:
    """Tilt a unit normal towards the viewer until their cosine is at least ``LEAST_COSINE``.

    A normal that points straight away from the viewer leaves open which way to turn; then the geometric one says it.
    """
    result = normal
    if wp.dot(normal, to_view) < LEAST_COSINE:
        aside = normal - wp.dot(normal, to_view) * to_view
        if wp.length_sq(aside) < 1.0e-12:
            aside = geometric - wp.dot(geometric, to_view) * to_view
        if wp.length_sq(aside) < 1.0e-12:
            aside = perpendicular(to_view)
        # Projected twice: a short remainder of two nearly parallel vectors carries their rounding.
        aside = wp.normalize(aside)
        aside = wp.normalize(aside - wp.dot(aside, to_view) * to_view)
        result = LEAST_COSINE * to_view + wp.sqrt(1.0 - LEAST_COSINE * LEAST_COSINE) * aside
    return result


# Pixels side by side, step after step, so that the compiler makes vectors of each; a GPU takes one at a time. Those
# whose normal has to be turned, or whose tangent vanishes, are marked.
_STAND = """
    int* const hit = (int*)pixels.hit.data;
    const int* const faces = (const int*)surface.faces.data;
    const float* const of_corners[3] = {(const float*)surface.positions.data, (const float*)surface.normals.data,
        (const float*)surface.tangents.data};
    const float* const places = (const float*)pixels.place.data;
    const float* const views = (const float*)pixels.to_view.data;
    float* const outs[4] = {(float*)pixels.tangent.data, (float*)pixels.bitangent.data, (float*)pixels.normal.data,
        (float*)pixels.shadow_origin.data};
    const bool smooth = surface.smooth;
    int specials = 0;
    for (int from = begin; from < end; from += ABREAST) {
        const int count = wp::min(end - from, ABREAST);
        int hits = 0;
        for (int i = 0; i < count; ++i) hits |= hit[from + i];
        if (hits == 0) continue;
        // What each corner has, and the pixel; where nothing is met, that of any face.
        float corner[3][3][3][ABREAST], view[3][ABREAST], b0[ABREAST], b1[ABREAST], handed[ABREAST];
        bool met[ABREAST];
        for (int i = 0; i < ABREAST; ++i) {
            const int k = from + (i < count ? i : 0);
            met[i] = hit[k] != 0;
            const int* const corners = faces + 3LL * (met[i] ? ((const int*)pixels.face.data)[k] : 0);
            for (int which = 0; which < 3; ++which) {
                const long long at = 3LL * corners[which];
                for (int what = 0; what < 3; ++what)
                    for (int c = 0; c < 3; ++c) corner[what][which][c][i] = of_corners[what][at + c];
            }
            for (int c = 0; c < 3; ++c) view[c][i] = met[i] ? views[3LL * k + c] : 0.0f;
            b0[i] = met[i] ? places[2LL * k] : 0.0f;
            b1[i] = met[i] ? places[2LL * k + 1] : 0.0f;
            handed[i] = ((const float*)surface.handedness.data)[corners[0]];
        }
        float out[4][3][ABREAST];
        bool special[ABREAST];
        for (int i = 0; i < ABREAST; ++i) {
            const float b2 = 1.0f - b0[i] - b1[i], share[3] = {b0[i], b1[i], b2 > 0.0f ? b2 : 0.0f};
            float position[3][3], edge1[3], edge2[3], across[3], point[3], normal[3], origin[3], blend[3], tangent[3];
            for (int c = 0; c < 3; ++c) {
                for (int which = 0; which < 3; ++which) position[which][c] = corner[0][which][c][i];
                edge1[c] = position[1][c] - position[0][c];
                edge2[c] = position[2][c] - position[0][c];
                point[c] = share[0] * position[0][c] + share[1] * position[1][c] + share[2] * position[2][c];
            }
            across[0] = edge1[1] * edge2[2] - edge1[2] * edge2[1];
            across[1] = edge1[2] * edge2[0] - edge1[0] * edge2[2];
            across[2] = edge1[0] * edge2[1] - edge1[1] * edge2[0];
            const float facing = across[0] * view[0][i] + across[1] * view[1][i] + across[2] * view[2][i];
            const float side = facing < 0.0f ? -1.0f : 1.0f;
            const float per_across = side / wp::sqrt(across[0] * across[0] + across[1] * across[1]
                + across[2] * across[2]);
            for (int c = 0; c < 3; ++c) {
                across[c] *= per_across;
                blend[c] = 0.0f;
                for (int which = 0; which < 3; ++which) blend[c] += share[which] * side * corner[1][which][c][i];
            }
            const float size2 = blend[0] * blend[0] + blend[1] * blend[1] + blend[2] * blend[2];
            const bool blends = smooth && size2 > 1.0e-8f;
            const float per_size = 1.0f / wp::sqrt(size2);
            for (int c = 0; c < 3; ++c) {
                normal[c] = blends ? per_size * blend[c] : across[c];
                origin[c] = smooth ? 0.0f : point[c];
            }
            // Hanika 2021, "Hacking the shadow terminator": start from the smooth surface that the normals stand for,
            // or the facets would shadow each other where the light grazes it: from what is lifted to the tangent
            // planes of the corners where it lies below, which is where the surface is convex.
            for (int which = 0; which < 3; ++which) {
                float above = 0.0f;
                for (int c = 0; c < 3; ++c) above += side * corner[1][which][c][i] * (point[c] - position[which][c]);
                const float lift = above < 0.0f ? above * side : 0.0f;
                for (int c = 0; c < 3; ++c)
                    origin[c] += smooth ? share[which] * (point[c] - lift * corner[1][which][c][i]) : 0.0f;
            }
            float along = 0.0f, cosine = 0.0f;
            for (int c = 0; c < 3; ++c) {
                tangent[c] = share[0] * corner[2][0][c][i] + share[1] * corner[2][1][c][i]
                    + share[2] * corner[2][2][c][i];
                along += tangent[c] * normal[c];
                cosine += normal[c] * view[c][i];
            }
            for (int c = 0; c < 3; ++c) tangent[c] -= along * normal[c];
            const float left2 = tangent[0] * tangent[0] + tangent[1] * tangent[1] + tangent[2] * tangent[2];
            special[i] = cosine < LEAST_COSINE || !(left2 > LEAST_TANGENT);
            // Projected twice: a short remainder of two nearly parallel vectors carries their rounding.
            float again = 0.0f, tangent2 = 0.0f;
            for (int c = 0; c < 3; ++c) again += tangent[c] * normal[c];
            for (int c = 0; c < 3; ++c) {
                tangent[c] -= again * normal[c];
                tangent2 += tangent[c] * tangent[c];
            }
            const float per_tangent = 1.0f / wp::sqrt(tangent2);
            for (int c = 0; c < 3; ++c) {
                tangent[c] *= per_tangent;
                out[0][c][i] = tangent[c];
                out[2][c][i] = normal[c];
                out[3][c][i] = origin[c] + LIFT * across[c];
            }
            out[1][0][i] = handed[i] * (normal[1] * tangent[2] - normal[2] * tangent[1]);
            out[1][1][i] = handed[i] * (normal[2] * tangent[0] - normal[0] * tangent[2]);
            out[1][2][i] = handed[i] * (normal[0] * tangent[1] - normal[1] * tangent[0]);
        }
        // Zeros between pixels that meet it: to skip these takes longer.
        for (int what = 0; what < 4; ++what)
            for (int i = 0; i < count; ++i)
                for (int c = 0; c < 3; ++c) outs[what][3LL * (from + i) + c] = met[i] ? out[what][c][i] : 0.0f;
        for (int i = 0; i < count; ++i) {
            const bool is_special = met[i] && special[i];
            hit[from + i] = is_special ? SPECIAL : hit[from + i];
            specials += is_special;
        }
    }
    return specials;
"""


@wp.func_native(
    filled(
        simd_batch(32) + _STAND,
        LEAST_COSINE=f"{float(LEAST_COSINE)}f",
        LEAST_TANGENT=f"{float(LEAST_TANGENT)}f",
        SPECIAL=int(SPECIAL),
        LIFT=f"{float(LIFT)}f",
    )
)
def shading_frames_run(surface: SurfaceArrays, pixels: Pixels, begin: wp.int32, end: wp.int32) -> wp.int32:
    """Shading frames of pixels one after the other, and where their shadow rays start; returns how many are left."""
