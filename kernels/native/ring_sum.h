// Mean colours over footprints that are wide compared with their distance from the mirror direction, or reach around
// it.
//
// Such a footprint is no range of angles and ratios. Its rows are weighed by the Gaussian of (u, v) itself, at the
// rings and azimuth samples that it covers. Rows of a mip level are means over arcs of the
// ring, so that the Gaussian along the ring is made narrower by as much.

#pragma once

#include "fast_math.h"
#include "simd.h"

namespace warpdiff {

// Number of azimuths per batch (limit: SIMD lanes).
constexpr int ARC = batch_of(8);
// Extent of the summed Gaussian [standard deviations]: outwards, and towards the mirror direction, where surfaces are
// brightest. Limits: a larger extent sums more rows.
constexpr float OUTWARDS = 3.2f, INWARDS = 4.5f;
// Largest distance of the summed rings, in ln |(u, v)|, where colours are smooth, and in standard deviations along
// (u, v). It doubles within `WITHIN` narrow standard deviations. With twice the distances, sums over narrow
// Gaussians are inaccurate.
constexpr float RINGS_APART = 0.1f, RINGS_PER_DEVIATION = 1.2f, WITHIN = 0.5f;
// Innermost ring, in the narrow deviations or in deviations of the narrowest lobe, whichever is less, and the least
// deviation in those of that lobe.
constexpr float INNERMOST = 0.1f, INNERMOST_OF_LOBE = 0.3f, NARROWEST = 0.3f;
// Largest part of the variance along a ring that a level has, and the distance of its azimuths in standard deviations.
constexpr float MOST_BLUR2 = 0.7f, AZIMUTHS_APART = 1.0f;

// A Gaussian of (u, v): its middle, and the inverse of its covariance.
struct Gaussian2 {
    float u, v, uu, uv, vv;
};

// A level for rings of one octave: where its rows are, how far its azimuths are apart [rad], the variance of what lies
// on them, less that of their spline [rad²], whose coefficients are sharper than its values by as much, and from which
// variance along the ring on the next one serves.
struct RingLevel {
    int octave, level, azimuths, first_row;
    float spacing, blur2, until;
};

// The weight of a Gaussian at a place (x, y) of the unit circle times the radius, once it is narrower by a variance
// along the ring, if it is within so many deviations. There it is one whose exponent has the same slope and curvature.
WARPDIFF_INLINE float weight_on_ring(
    const Gaussian2& gaussian, float x, float y, float radius, float blur2, float cutoff)
{
    const float u = radius * x - gaussian.u, v = radius * y - gaussian.v;
    const float pu = gaussian.uu * u + gaussian.uv * v, pv = gaussian.uv * u + gaussian.vv * v;
    const float slope = radius * (x * pv - y * pu);
    const float across = gaussian.uu * y * y - 2.0f * gaussian.uv * x * y + gaussian.vv * x * x;
    const float curvature = radius * (radius * across - (x * pu + y * pv));
    const float left = larger(1.0f - blur2 * curvature, 1.0f - 1.2f * MOST_BLUR2);
    const float exponent = u * pu + v * pv;
    const float weight = exp_of_negative(-0.5f * (exponent + slope * slope * blur2 / left)) / wp::sqrt(left);
    return exponent < cutoff * cutoff ? weight : 0.0f;
}

template <class Table>
WARPDIFF_INLINE RingLevel ring_level(const Table& table, int level, int octave)
{
    const int at = level * (int)table.azimuths.shape[1] + octave, azimuths = numbers<const int>(table.azimuths)[at];
    const float blur = numbers<const float>(table.blurs)[at], spacing = 2.0f * PI / (float)azimuths;
    return {octave, level, azimuths, numbers<const int>(table.first_rows)[at], spacing,
        blur * blur - 0.25f * spacing * spacing, 1.0e30f};
}

// The widest level of one octave that serves a variance along the ring. In the next octave inwards levels may be twice
// as wide, and the one before serves.
template <class Table>
inline void widen(const Table& table, RingLevel& widest, int octave, float variance)
{
    if (octave != widest.octave) widest = ring_level(table, wp::max(widest.level - 1, 0), octave);
    for (widest.until = 1.0e30f; widest.level + 1 < table.azimuths.shape[0];) {
        const RingLevel wider = ring_level(table, widest.level + 1, octave);
        const float least = larger(wider.blur2 * (1.0f / MOST_BLUR2),
            wider.spacing * wider.spacing * (1.0f / (AZIMUTHS_APART * AZIMUTHS_APART)));
        if (least > variance) {
            widest.until = least;
            return;
        }
        widest = wider;
    }
}

// Add the rows of a ring from one azimuth up to another, which is excluded: arcs may touch.
template <int WIDTH>
WARPDIFF_INLINE void add_arc(WeighedRows<WIDTH>& sum, const Gaussian2& gaussian, float radius, float blur2,
    float cutoff, float size, float first, float end, int count, const float* rows, long long stride)
{
    const int arc_count = wp::min((int)(wp::ceil(end) - wp::ceil(first)), count);
    int azimuth = cyclic((int)wp::ceil(first), count);
    for (int from = 0; from < arc_count; from += ARC) {
        Batch<ARC> weights;
        for (int j = 0; j < ARC; ++j) {
            float x, y;
            on_circle((float)(azimuth + j) / (float)count, x, y);
            const float weight = size * weight_on_ring(gaussian, x, y, radius, blur2, cutoff);
            weights[j] = from + j < arc_count ? weight : 0.0f;
        }
        for (int j = 0; j < ARC; ++j, ++azimuth) {
            if (azimuth == count) azimuth = 0;
            if (!(weights[j] > 0.0f)) continue;
            sum.rows.add(weights[j], rows + azimuth * stride);
            sum.weights += weights[j];
        }
    }
}

// The sum of rows over a Gaussian around (u, v), from the outermost ring inwards.
template <int WIDTH, class Table>
inline WeighedRows<WIDTH> sum_over_rings(const Table& table, float u, float v, float xx, float xy, float yy)
{
    // Coefficients of the spline between rings have a quarter of their distance, squared, less of variance than values.
    const float apart2 = 0.25f / (table.rings_per_log * table.rings_per_log);
    const float a = xx + apart2 * u * u, b = xy + apart2 * u * v, d = yy + apart2 * v * v, mean2 = 0.5f * (a + d);
    const float widest2 = mean2 + wp::sqrt(0.25f * (a - d) * (a - d) + b * b), least = NARROWEST * table.lobe_uv;
    const float narrow2 = larger((a * d - b * b) / widest2, least * least);
    const float widest = wp::sqrt(widest2), narrow = wp::sqrt(narrow2), middle = wp::sqrt(u * u + v * v);
    const float turns = log_polar(u, v, table.least_uv).turns;
    // The direction across the axis of a streak, and how far away that axis is.
    const float across = 0.5f * log_polar(a - d, 2.0f * b, 0.0f).turns + 0.25f;
    float x, y;
    on_circle(across, x, y);
    const float aside = u * x + v * y, along = v * x - u * y;
    const Gaussian2 gaussian = {u, v, x * x / narrow2 + y * y / widest2, x * y * (1.0f / narrow2 - 1.0f / widest2),
        y * y / narrow2 + x * x / widest2};
    // Rings lie on the rings of the table, closer than the Gaussian is wide along (u, v).
    const float steepness = wp::sqrt(aside * aside / narrow2 + along * along / widest2);
    const float distance = smaller(RINGS_APART, RINGS_PER_DEVIATION / larger(steepness, 1.0e-20f));
    const int octaves = table.azimuths.shape[1], apart = wp::max((int)(distance * table.rings_per_log), 1);
    const float outermost = log_polar(middle + OUTWARDS * widest, 0.0f, table.least_uv).log2;
    const float nearest = smaller(INNERMOST * narrow, INNERMOST_OF_LOBE * table.lobe_uv);
    const float innermost = larger(larger(middle - INWARDS * widest, nearest), table.least_uv);
    int ring = wp::min(
        (int)(outermost * (float)table.rings_per_octave + table.ring_of_one), octaves * table.rings_per_octave - 1);
    float radius = wp::exp(((float)ring - table.ring_of_one) / table.rings_per_log);
    const float nearer = wp::exp(-(float)apart / table.rings_per_log);
    WeighedRows<WIDTH> sum;
    sum.clear();
    // No octave is cached yet.
    RingLevel level = {-1};
    while (ring >= 0 && radius > innermost) {
        // Further in the Gaussian takes up more of a ring.
        const int octave = (int)((float)ring * table.octaves_per_ring);
        const float variance = narrow2 / (radius * larger(radius, middle));
        if (octave != level.octave || variance >= level.until) widen(table, level, octave, variance);
        const float blur2 = smaller(level.blur2, MOST_BLUR2 * variance);
        const float* const rows = numbers<const float>(table.rows)
            + (long long)(level.first_row + ring - octave * table.rings_per_octave) * WIDTH;
        const long long stride = (long long)table.rings_per_octave * WIDTH;
        // The arc within reach around (u, v), or for a streak those within reach of its axis, if they are shorter.
        const float cutoff = radius < middle ? INWARDS : OUTWARDS, furthest = cutoff * widest, beside = cutoff * narrow;
        const float around = turns_of_cosine(
            (radius * radius + middle * middle - furthest * furthest) / larger(2.0f * radius * middle, 1.0e-20f));
        float from = 0.0f, to = 1.0f;
        if (widest > 1.5f * narrow) {
            from = turns_of_cosine((aside + beside) / radius);
            to = turns_of_cosine((aside - beside) / radius);
        }
        const bool is_coarse = radius < WITHIN * narrow, is_streak = to - from < around;
        const float size = (is_coarse ? 2.0f : 1.0f) * radius * radius * level.spacing, all = (float)level.azimuths;
        // Rounded, so that arcs that touch have each azimuth once.
        const float place = wp::rint(64.0f * all * (is_streak ? across : turns)) * (1.0f / 64.0f);
        for (int side = 0; side < (is_streak ? 2 : 1); ++side) {
            const float first = !is_streak ? -around : side == 0 ? from : -to;
            const float end = !is_streak ? around : side == 0 ? to : -from;
            add_arc(sum, gaussian, radius, blur2, cutoff, size, place + first * all, place + end * all, level.azimuths,
                rows, stride);
        }
        ring -= is_coarse ? 2 * apart : apart;
        radius *= is_coarse ? nearer * nearer : nearer;
    }
    return sum;
}

} // namespace warpdiff
