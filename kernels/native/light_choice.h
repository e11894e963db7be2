// Random choice of one of many distant lights, by the light that the surface is expected to scatter.

#pragma once

#include "fast_math.h"
#include "simd.h"
#include "vectors.h"

namespace warpdiff {

// Number of octaves of |(u, v)| around the disc of the distribution that count as light near the mirror direction.
// Choice: other values change the noise, not the mean.
constexpr float OCTAVES_OF_MIRROR = 2.0f;
// Least cosine w of a direction. Limit: a smaller w would make gains infinite.
constexpr float LEAST_W = 0.01f;

// Shading frame and view direction at a hit. The light near the mirror direction is blurred by the footprint:
// `per_uu`, `per_uv` and `per_vv` are the inverse of its covariance in (u, v), and `peak` is its density there.
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

// Compute the expected brightness of a point under N lights from the index `first` on, without shadows. It is 0 for
// lights below the horizon.
template <int N, class Lights, class Table>
WARPDIFF_INLINE void expect_brightness(const Lights& lights, const Table& table, const ScatteringPoint& point,
    float diffuse, int first, Batch<N>& result)
{
    const double* const places = numbers<const double>(lights.places);
    const double* const strengths = numbers<const double>(lights.strengths);
    const int* const starts = numbers<const int>(table.starts);
    const float* const densities = numbers<const float>(table.densities);
    const int count = lights.places.shape[0];
    const float last = (float)(table.ring_cdf.shape[0] - 1);
    Batch<N> place, turns, per_area;
    for (int i = 0; i < N; ++i) {
        const long long light = first + i < count ? first + i : count - 1;
        float middle[3];
        for (int c = 0; c < 3; ++c) middle[c] = (float)places[4 * light + c];
        const float cosine = dot(middle, point.normal);
        for (int c = 0; c < 3; ++c) middle[c] += point.view[c];
        const float u = -dot(middle, point.tangent), v = -dot(middle, point.bitangent), w = dot(middle, point.normal);
        const LogPolar at = log_polar(u, v, 1.0e-9f);
        const float ring = (0.69314718f * at.log2 - table.least_log) * table.per_log + 1.0f;
        turns[i] = at.turns;
        place[i] = smaller(larger(ring, 0.0f), last);
        const float overlap = dot(middle, middle) / larger(w, LEAST_W);
        const float power = cosine > 0.0f && first + i < count ? (float)strengths[2 * light] : 0.0f;
        const float gain = power * 0.25f * overlap * overlap;
        const float away = point.per_uu * u * u + 2.0f * point.per_uv * u * v + point.per_vv * v * v;
        per_area[i] = ring < 1.0f ? gain : gain / (u * u + v * v + 1.0e-20f);
        result[i] = gain * point.peak * exp_of_negative(-0.5f * away) + power * diffuse * cosine;
    }
    for (int i = 0; i < N; ++i) {
        const int begin = starts[(int)place[i]], size = starts[(int)place[i] + 1] - begin;
        const int azimuth = (int)(turns[i] * (float)size);
        result[i] += per_area[i] * densities[begin + (azimuth < size ? azimuth : size - 1)];
    }
}

// Choose a light for the ray with the given index, by a random number from 0 to 1. Its direction and weight are written
// to `towards_out`, unless all lights are below the horizon.
template <int BATCH, class Lights, class Table, class Pixels, class Footprints, class Directions>
WARPDIFF_INLINE void choose_light(const Lights& lights, const Table& table, float diffuse, const Pixels& pixels,
    const Footprints& footprints, int ray, float random, Directions& towards_out)
{
    constexpr int N = batch_of(BATCH);
    const int count = lights.places.shape[0];
    ScatteringPoint point;
    point.load(table, pixels, footprints, ray);
    Batch<N> expected;
    float total = 0.0f;
    for (int first = 0; first < count; first += N) {
        expect_brightness(lights, table, point, diffuse, first, expected);
        for (int i = 0; i < N; ++i) total += expected[i];
    }
    // If rounding makes the sum smaller than `total`, the last light above the horizon is chosen.
    float sum = 0.0f, share = 0.0f;
    long long chosen = -1;
    for (int first = 0; first < count && !(sum > random * total); first += N) {
        expect_brightness(lights, table, point, diffuse, first, expected);
        for (int i = 0; i < N && !(sum > random * total); ++i) {
            if (!(expected[i] > 0.0f)) continue;
            chosen = first + i;
            share = expected[i];
            sum += share;
        }
    }
    if (chosen < 0) return;
    float* const towards = numbers<float>(towards_out) + 4LL * ray;
    const double* const strengths = numbers<const double>(lights.strengths);
    for (int c = 0; c < 3; ++c) towards[c] = (float)numbers<const double>(lights.places)[4 * chosen + c];
    towards[3] = (float)(strengths[2 * chosen] / strengths[0]) * total / share;
}

} // namespace warpdiff
