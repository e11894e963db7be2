// Random choice of one of many distant lights, by the light that the surface is expected to scatter.
//
// (u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
// light and to the viewer. The component w is along the normal. Its magnitude |w| is the sum of the cosines of light
// and view.

#pragma once

#include "fast_math.h"
#include "simd.h"
#include "vectors.h"

namespace warpdiff {

// The table of the scattered light has rings (circles of constant |(u, v)|). Light within this number of octaves from
// the innermost ring counts as light near the mirror direction. The value was chosen freely: other values change the
// noise, not the mean.
constexpr float OCTAVES_OF_MIRROR = 2.0f;
// Lights are divided into at most this number of groups, and the summed brightness of each group is stored. The value
// is limited by the size of a local array.
constexpr int GROUPS = 32;
// Least sum of the cosines of light and view, which is |w|. A smaller |w| would make geometry factors (gains) too
// large.
constexpr float LEAST_W = 0.01f;

// Shading frame and view direction at a hit. The light that is scattered near the mirror direction is approximated by a
// Gaussian in (u, v): a narrow lobe around that direction, blurred by the footprint of the pixel. `per_uu`, `per_uv`
// and `per_vv` are the inverse of the covariance of this Gaussian, and `peak` is its value at its centre.
struct ScatteringPoint {
    float tangent[3], bitangent[3], normal[3], view[3];
    float per_uu, per_uv, per_vv, peak;

    template <class Table, class Pixels, class Footprints>
    WARPDIFF_INLINE void load(const Table& table, const Pixels& pixels, const Footprints& footprints, int ray)
    {
        memcpy(tangent, numbers<const float>(pixels.tangent) + 3LL * ray, sizeof(tangent));
        memcpy(bitangent, numbers<const float>(pixels.bitangent) + 3LL * ray, sizeof(bitangent));
        memcpy(normal, numbers<const float>(pixels.normal) + 3LL * ray, sizeof(normal));
        memcpy(view, numbers<const float>(pixels.to_view) + 3LL * ray, sizeof(view));
        const float* const f = numbers<const float>(footprints) + 4LL * ray;
        const float lobe = 2.0f * wp::exp(table.least_log);
        const int rings = table.ring_cdf.shape[0], near = (int)(0.69314718f * OCTAVES_OF_MIRROR * table.per_log);
        const float power = numbers<const float>(table.ring_cdf)[near < rings ? near : rings - 1];
        const float xx = f[0] * f[0] + f[2] * f[2] + lobe * lobe, xy = f[0] * f[1] + f[2] * f[3];
        const float yy = f[1] * f[1] + f[3] * f[3] + lobe * lobe;
        const float per = 1.0f / (xx * yy - xy * xy);
        per_uu = yy * per;
        per_uv = -xy * per;
        per_vv = xx * per;
        peak = power * wp::sqrt(per) / (2.0f * PI);
    }
};

// Compute the expected brightness of a point under N lights, without shadows. `first` is the index of the first light.
// The brightness is 0 for lights below the horizon.
template <int N, class Lights, class Table>
WARPDIFF_INLINE void expect_brightness(
    const Lights& lights, const Table& table, const ScatteringPoint& point, float diffuse, int first, Batch<N>& result)
{
    const double* const places = numbers<const double>(lights.places);
    const double* const strengths = numbers<const double>(lights.strengths);
    const int* const starts = numbers<const int>(table.starts);
    const float* const densities = numbers<const float>(table.densities);
    const int count = lights.places.shape[0];
    const float last = (float)(table.ring_cdf.shape[0] - 1);
    Batch<N> towards[3], power, place, turns, per_area;
    for (int i = 0; i < N; ++i) {
        const long long light = first + i < count ? first + i : count - 1;
        for (int c = 0; c < 3; ++c) towards[c][i] = (float)places[4 * light + c];
        power[i] = first + i < count ? (float)strengths[light] : 0.0f;
    }
    const ScatteringPoint at = point;
    const float least_log = table.least_log, per_log = table.per_log;
    for (int i = 0; i < N; ++i) {
        const float x = towards[0][i], y = towards[1][i], z = towards[2][i];
        const float cosine = x * at.normal[0] + y * at.normal[1] + z * at.normal[2];
        const float mx = x + at.view[0], my = y + at.view[1], mz = z + at.view[2];
        const float u = -(mx * at.tangent[0] + my * at.tangent[1] + mz * at.tangent[2]);
        const float v = -(mx * at.bitangent[0] + my * at.bitangent[1] + mz * at.bitangent[2]);
        const float w = mx * at.normal[0] + my * at.normal[1] + mz * at.normal[2];
        const LogPolar polar = log_polar(u, v, 1.0e-9f);
        const float ring = (0.69314718f * polar.log2 - least_log) * per_log + 1.0f;
        turns[i] = polar.turns;
        place[i] = smaller(larger(ring, 0.0f), last);
        const float overlap = (mx * mx + my * my + mz * mz) / larger(w, LEAST_W);
        const float arriving = cosine > 0.0f ? power[i] : 0.0f;
        const float gain = arriving * 0.25f * overlap * overlap;
        const float away = at.per_uu * u * u + 2.0f * at.per_uv * u * v + at.per_vv * v * v;
        per_area[i] = ring < 1.0f ? gain : gain / (u * u + v * v + 1.0e-20f);
        result[i] = gain * at.peak * exp_of_negative(-0.5f * away) + arriving * diffuse * cosine;
    }
    for (int i = 0; i < N; ++i) {
        const int begin = starts[(int)place[i]], size = starts[(int)place[i] + 1] - begin;
        const int azimuth = (int)(turns[i] * (float)size);
        result[i] += per_area[i] * densities[begin + (azimuth < size ? azimuth : size - 1)];
    }
}

// Choose a light for the ray with the given index, by a random number from 0 to 1. The direction and the weight of the
// light are written to `towards_out`, unless all lights are below the horizon.
template <int BATCH, class Lights, class Table, class Pixels, class Footprints, class Directions>
WARPDIFF_INLINE void choose_light(const Lights& lights, const Table& table, float diffuse, const Pixels& pixels,
    const Footprints& footprints, int ray, float random, Directions& towards_out)
{
    constexpr int N = batch_of(BATCH);
    const int count = lights.places.shape[0];
    ScatteringPoint point;
    point.load(table, pixels, footprints, ray);
    Batch<N> expected;
    // Sums of the brightness over groups of lights. To choose one light of a group, the brightness is computed again
    // for the lights of this group only.
    float sums[GROUPS], total = 0.0f;
    const int size = (count - 1) / (N * GROUPS) * N + N;
    for (int group = 0; group * size < count; ++group) {
        sums[group] = 0.0f;
        for (int first = group * size; first < wp::min((group + 1) * size, count); first += N) {
            expect_brightness(lights, table, point, diffuse, first, expected);
            for (int i = 0; i < N; ++i) sums[group] += expected[i];
        }
        total += sums[group];
    }
    float rest = random * total, share = 0.0f;
    int group = 0;
    while ((group + 1) * size < count && !(sums[group] > rest)) rest -= sums[group++];
    // If rounding makes the summed brightness of a group of lights too small, the last light of the group above the
    // horizon is chosen.
    long long chosen = -1;
    for (int first = group * size; first < wp::min((group + 1) * size, count) && rest >= 0.0f; first += N) {
        expect_brightness(lights, table, point, diffuse, first, expected);
        for (int i = 0; i < N && rest >= 0.0f; ++i) {
            if (!(expected[i] > 0.0f)) continue;
            chosen = first + i;
            share = expected[i];
            rest -= share;
        }
    }
    if (chosen < 0) return;
    float* const towards = numbers<float>(towards_out) + 4LL * ray;
    const double* const strengths = numbers<const double>(lights.strengths);
    for (int c = 0; c < 3; ++c) towards[c] = (float)numbers<const double>(lights.places)[4 * chosen + c];
    towards[3] = (float)(strengths[chosen] / strengths[0]) * total / share;
}

} // namespace warpdiff
