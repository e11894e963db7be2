// Scattering vectors, directions to the light and gains (geometry factors) of pixels. Sums of coverage and illumination
// over several samples are updated, too.
//
// (u, v, w) is the scattering vector −ωi − ωr in the shading frame, where ωi and ωr are the unit vectors to the light
// and to the viewer. |P|² is the power that the surface diffracts into a direction, relative to a flat mirror in its
// mirror direction. ρ is the reflectance relative to a flat mirror.

#pragma once

#include "simd.h"
#include "vectors.h"

namespace warpdiff {

// Sums per pixel over several samples of lights: colours XYZ, share of the samples that hit the mesh (coverage), and
// whether light arrives. With `resets_xyz` or `resets_coverage`, the sums are set to 0 before values are added.
struct SumsOfPixels {
    float* xyz;
    double* coverage;
    bool* illuminated;
    bool resets_xyz, resets_coverage;

    WARPDIFF_INLINE void begin(int from, int count) const
    {
        if (resets_xyz) memset(xyz + 3LL * from, 0, 3 * count * sizeof(float));
        if (!resets_coverage) return;
        memset(coverage + from, 0, count * sizeof(double));
        memset(illuminated + from, 0, count * sizeof(bool));
    }
};

// Direction to a distant light, or position of a point light, in homogeneous coordinates: the fourth coordinate is 0
// for a direction and 1 for a position.
struct LightPlace {
    double place[4];

    // Compute the vector from a point to the light, not normalised. Return the relative irradiance: 1 for a direction,
    // and the inverse square of the distance for a point light. Distances count as at least 1e-4 radii of the mesh.
    WARPDIFF_INLINE double from(const float* origin, double* towards) const
    {
        for (int c = 0; c < 3; ++c) towards[c] = place[c] - place[3] * origin[c];
        return place[3] == 0.0 ? 1.0 : 1.0 / (dot(towards, towards) + 1.0e-8);
    }
};

// Shading frames, view directions and light directions of N pixels. Values are arbitrary if a pixel does not hit the
// mesh, or if there are fewer than N pixels.
template <int N>
struct ScatteringBatch {
    // `frame` has the tangent, the bitangent and the normal, and `origin` is the origin of the shadow ray. `towards` is
    // the direction to the light and its weight, if each pixel has its own direction. `light` and `uvw` are the
    // direction to the light and the scattering vector in the shading frame. `beyond_normal` is 1/R(0) − 1. `unit` is
    // the factor from the colours of a surface to the common scale of the picture. `per_cosine` states whether the gain
    // (geometry factor) is divided by the cosine of the angle between light and normal.
    Batch<N> frame[3][3], to_view[3], origin[3];
    Batch<N> towards[4];
    Batch<N, double> light[3], uvw[3];
    Batch<N, double> beyond_normal, unit;
    Batch<N, bool> per_cosine;
    Batch<N> gain;

    template <class Pixels>
    WARPDIFF_INLINE void load(const Pixels& pixels, bool is_at_a_place, const float* directions, int from, int count)
    {
        const float* const frames[3] = {numbers<const float>(pixels.tangent), numbers<const float>(pixels.bitangent),
            numbers<const float>(pixels.normal)};
        const float* const views = numbers<const float>(pixels.to_view);
        const float* const origins = numbers<const float>(pixels.shadow_origin);
        for (int i = 0; i < N; ++i) {
            const long long at = 3LL * (from + (i < count ? i : 0));
            for (int c = 0; c < 3; ++c) {
                for (int axis = 0; axis < 3; ++axis) frame[axis][c][i] = frames[axis][at + c];
                to_view[c][i] = views[at + c];
                origin[c][i] = is_at_a_place ? origins[at + c] : 0.0f;
            }
            for (int c = 0; c < 4; ++c) towards[c][i] = directions ? directions[at / 3 * 4 + c] : 0.0f;
        }
    }
};

// Set the parameters of each pixel's finish, which is a surface with one of its materials.
template <int N, class Pixels, class Reflection>
WARPDIFF_INLINE void load_finishes(
    const Pixels& pixels, const Reflection& reflection, int from, int count, ScatteringBatch<N>& batch)
{
    const int* const hit = numbers<const int>(pixels.hit);
    const int* const faces = numbers<const int>(pixels.face);
    const int* const finishes = is_empty(reflection.finishes) ? nullptr : numbers<const int>(reflection.finishes);
    const double* const normals = numbers<const double>(reflection.normal_reflectances);
    const double* const units = numbers<const double>(reflection.units);
    const bool* const per_cosine = numbers<const bool>(reflection.per_light_cosine);
    for (int i = 0; i < N; ++i) {
        const int at = from + (i < count ? i : 0);
        const int finish = finishes && hit[at] ? finishes[faces[at]] : 0;
        batch.beyond_normal[i] = 1.0 / normals[finish] - 1.0;
        batch.unit[i] = units[finish];
        batch.per_cosine[i] = per_cosine[finish];
    }
}

// Return the gain (geometry factor): the factor from the diffracted power ⟨|P|²⟩ to the relative reflectance ρ (Single
// 2014, eq. 3.15), times Schlick's reflectance relative to normal incidence. `beyond_normal` is 1/R(0) − 1. The sum 1 +
// ωi·ωr is computed from the scattering vector, because the direct formula would subtract nearly equal numbers.
WARPDIFF_INLINE double gain_of(
    double u, double v, double w, double cos_i, double cos_r, double beyond_normal, bool masking, bool per_cosine)
{
    const double overlap = 0.5 * (u * u + v * v + w * w);
    const double cos_d = wp::sqrt(0.5 * overlap), m = 1.0 - (cos_d < 1.0 ? cos_d : 1.0);
    const double least = cos_i < cos_r ? cos_i : cos_r;
    const double mask = masking ? least * w * wp::sqrt(2.0 / overlap) / cos_d : 1.0;
    const double schlick = 1.0 + beyond_normal * m * m * m * m * m;
    return schlick * overlap * overlap * (mask < 1.0 ? mask : 1.0) / (w * w * cos_r * (per_cosine ? cos_i : 1.0));
}

// Compute the scattering vectors and gains (geometry factors) of a batch of pixels. The gain is 0 where the light or
// the viewer is below the horizon.
template <int N, class Reflection>
WARPDIFF_INLINE void scatter(const LightPlace& light, bool has_directions, const Reflection& reflection, double scale,
    double horizon, ScatteringBatch<N>& batch)
{
    const bool masking = reflection.masking;
    for (int i = 0; i < N; ++i) {
        // The axes of the shading frame are rounded to float32, so that directions expressed in it do not have exactly
        // unit length. They are normalised again: otherwise (u, v) would not be 0 in the mirror direction.
        const double view_x = batch.to_view[0][i], view_y = batch.to_view[1][i], view_z = batch.to_view[2][i];
        const float origin[3] = {batch.origin[0][i], batch.origin[1][i], batch.origin[2][i]};
        double towards[3], to_light[3], to_view[3];
        double strength = scale * batch.unit[i] * light.from(origin, towards);
        if (has_directions) {
            for (int c = 0; c < 3; ++c) towards[c] = batch.towards[c][i];
            strength *= batch.towards[3][i];
        }
        for (int axis = 0; axis < 3; ++axis) {
            const double x = batch.frame[axis][0][i], y = batch.frame[axis][1][i], z = batch.frame[axis][2][i];
            to_light[axis] = towards[0] * x + towards[1] * y + towards[2] * z;
            to_view[axis] = view_x * x + view_y * y + view_z * z;
        }
        // The added 1e-300 prevents a division by 0 for a light that lies on the surface.
        const double per_light = 1.0 / wp::sqrt(dot(to_light, to_light) + 1.0e-300);
        const double per_view = 1.0 / wp::sqrt(dot(to_view, to_view));
        for (int c = 0; c < 3; ++c) {
            batch.light[c][i] = to_light[c] * per_light;
            batch.uvw[c][i] = batch.light[c][i] + to_view[c] * per_view;
        }
        const double cos_i = batch.light[2][i], cos_r = to_view[2] * per_view;
        const double result = gain_of(batch.uvw[0][i], batch.uvw[1][i], batch.uvw[2][i], cos_i, cos_r,
            batch.beyond_normal[i], masking, batch.per_cosine[i]);
        batch.gain[i] = (cos_i < cos_r ? cos_i : cos_r) > horizon ? (float)(strength * result) : 0.0f;
    }
}

// Compute the scattering vectors, light directions and gains (geometry factors) of the pixels from `begin` to `end`.
// Each pixel that hits the mesh gets a scattering vector, even in shadow, because the error estimate of a neighbouring
// pixel compares the two vectors. `counted` is added to the coverage of these pixels.
template <int BATCH, class Pixels, class Vector, class Directions, class Reflection, class Flags,
    class ScatteringVectors, class Lights, class Gains, class Colours, class Coverage>
WARPDIFF_INLINE void find_scattering_vectors(const Pixels& pixels, const Vector& place, const Directions& towards,
    const Reflection& reflection, double scale, double horizon, double counted, bool begins, bool resets,
    const Flags& occluded, int begin, int end, ScatteringVectors& scattering_vectors_out, Lights& to_lights_out,
    Gains& gains_out, Colours& xyz_out, Coverage& coverage_out, Flags& illuminated_out)
{
    constexpr int N = batch_of(BATCH);
    const LightPlace light = {{place[0], place[1], place[2], place[3]}};
    const int* const hit = numbers<const int>(pixels.hit);
    const float* const directions = is_empty(towards) ? nullptr : numbers<const float>(towards);
    const bool* const is_occluded = is_empty(occluded) ? nullptr : numbers<const bool>(occluded);
    const bool sums = !is_empty(coverage_out);
    const SumsOfPixels sums_of = {numbers<float>(xyz_out), numbers<double>(coverage_out),
        numbers<bool>(illuminated_out), sums && resets, sums && begins};
    for (int from = begin; from < end; from += N) {
        const int count = wp::min(end - from, N);
        double* const scattering_vectors = numbers<double>(scattering_vectors_out) + 3LL * from;
        float* const to_lights = numbers<float>(to_lights_out) + 3LL * from;
        float* const gains = numbers<float>(gains_out) + from;
        sums_of.begin(from, count);
        if (!any_hit(hit + from, count)) {
            memset(scattering_vectors, 0, 3 * count * sizeof(double));
            memset(to_lights, 0, 3 * count * sizeof(float));
            memset(gains, 0, count * sizeof(float));
            continue;
        }
        ScatteringBatch<N> batch;
        batch.load(pixels, place[3] != 0.0, directions, from, count);
        load_finishes(pixels, reflection, from, count, batch);
        scatter(light, directions != nullptr, reflection, scale, horizon, batch);
        for (int i = 0; i < count; ++i) {
            const bool is_hit = hit[from + i] != 0;
            const bool is_illuminated = is_hit && batch.gain[i] > 0.0f && !(is_occluded && is_occluded[from + i]);
            for (int c = 0; c < 3; ++c) scattering_vectors[3 * i + c] = is_hit ? -batch.uvw[c][i] : 0.0;
            for (int c = 0; c < 3; ++c) to_lights[3 * i + c] = is_illuminated ? (float)batch.light[c][i] : 0.0f;
            gains[i] = is_illuminated ? batch.gain[i] : 0.0f;
        }
        if (!sums) continue;
        for (int i = 0; i < count; ++i) {
            sums_of.coverage[from + i] += hit[from + i] != 0 ? counted : 0.0;
            sums_of.illuminated[from + i] |= gains[i] > 0.0f;
        }
    }
}

} // namespace warpdiff
