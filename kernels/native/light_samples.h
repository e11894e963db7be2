// Scattering vectors, directions to the light and gains of pixels, and what of them is summed up.

#pragma once

#include "simd.h"
#include "vectors.h"

namespace warpdiff {

// Where a pixel's sums begin: from nothing, or with what was summed before.
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

// Where light comes from, in homogeneous coordinates: a direction, of like strength everywhere, or a place.
struct LightPlace {
    double place[4];

    // The vector from a point to the light, not of unit length, and what of the strength is left there: no light comes
    // nearer than a ten-thousandth of the mesh's radius.
    WARPDIFF_INLINE double from(const float* origin, double* towards) const
    {
        for (int c = 0; c < 3; ++c) towards[c] = place[c] - place[3] * origin[c];
        return place[3] == 0.0 ? 1.0 : 1.0 / (dot(towards, towards) + 1.0e-8);
    }
};

// Frames and views of N pixels; where they meet nothing, and behind the last one, whatever is there.
template <int N>
struct ScatteringBatch {
    Batch<N> frame[3][3], to_view[3], origin[3]; // tangent, bitangent and normal, by axis; where light arrives
    Batch<N> towards[4];                         // to the light, if each pixel has a direction of its own, and a weight
    Batch<N, double> light[3], uvw[3];           // to the light, and the sum of both directions, in that frame
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

// The factor between ⟨|P|²⟩ and ρ (Single 2014, eq. 3.15), with Schlick's reflectance over that at normal incidence and
// 1 + ωi·ωr without cancellation; `beyond_normal` is 1/R(0) − 1.
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

// These functions process pixels side by side. Gains below the horizon are 0.
template <int N, class Reflection>
WARPDIFF_INLINE void scatter(const LightPlace& light, bool has_directions, const Reflection& reflection, double scale,
    double horizon, ScatteringBatch<N>& batch)
{
    const double beyond_normal = 1.0 / reflection.normal_reflectance - 1.0;
    const bool masking = reflection.masking, per_cosine = reflection.per_light_cosine;
    for (int i = 0; i < N; ++i) {
        // The frame comes from float32: unit lengths are restored, so that the mirror direction is met exactly.
        const double view_x = batch.to_view[0][i], view_y = batch.to_view[1][i], view_z = batch.to_view[2][i];
        const float origin[3] = {batch.origin[0][i], batch.origin[1][i], batch.origin[2][i]};
        double towards[3], to_light[3], to_view[3];
        double strength = scale * light.from(origin, towards);
        if (has_directions) {
            for (int c = 0; c < 3; ++c) towards[c] = batch.towards[c][i];
            strength *= batch.towards[3][i];
        }
        for (int axis = 0; axis < 3; ++axis) {
            const double x = batch.frame[axis][0][i], y = batch.frame[axis][1][i], z = batch.frame[axis][2][i];
            to_light[axis] = towards[0] * x + towards[1] * y + towards[2] * z;
            to_view[axis] = view_x * x + view_y * y + view_z * z;
        }
        // A light on the surface itself comes from nowhere.
        const double per_light = 1.0 / wp::sqrt(dot(to_light, to_light) + 1.0e-300);
        const double per_view = 1.0 / wp::sqrt(dot(to_view, to_view));
        for (int c = 0; c < 3; ++c) {
            batch.light[c][i] = to_light[c] * per_light;
            batch.uvw[c][i] = batch.light[c][i] + to_view[c] * per_view;
        }
        const double cos_i = batch.light[2][i], cos_r = to_view[2] * per_view;
        const double result = gain_of(
            batch.uvw[0][i], batch.uvw[1][i], batch.uvw[2][i], cos_i, cos_r, beyond_normal, masking, per_cosine);
        batch.gain[i] = (cos_i < cos_r ? cos_i : cos_r) > horizon ? (float)(strength * result) : 0.0f;
    }
}

// Scattering vectors of pixels from begin to end. All that meet the mesh have one, whether they are lit or not: those
// next to them ask how (u, v) changes. `counted` is added to the coverage of those.
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
