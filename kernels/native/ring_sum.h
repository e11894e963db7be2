// Mean colours over footprints that are wide beside their distance from the mirror direction, or reach around it.
//
// Such a footprint is no range of angles and ratios. Its rows are weighed by the Gaussian of (u, v) itself, at the
// nodes and spokes that it covers: the spokes of a node lie on a ring. Rows of a mip level are means over arcs of the
// ring, so that the Gaussian along the ring is made narrower by as much.

#pragma once

#include "fast_math.h"
#include "simd.h"

namespace warpdiff {

// Spokes that are weighed side by side.
constexpr int ARC = batch_of(8);
// How far a Gaussian counts, in deviations: outwards, and towards the mirror direction, where surfaces are brightest.
constexpr float OUTWARDS = 3.5f, INWARDS = 5.0f;
// How far rings are apart in ln |(u, v)|, and twice as far within so many of the narrow deviations.
constexpr float RINGS_APART = 0.15f, WITHIN = 0.5f;
// Innermost ring, in the narrow deviations or in deviations of the narrowest lobe, whichever is less, and the least
// deviation in those of that lobe.
constexpr float INNERMOST = 0.1f, INNERMOST_OF_LOBE = 0.3f, NARROWEST = 0.3f;
// What of the variance along a ring a level has at most, and how far its spokes are apart, in deviations.
constexpr float MOST_BLUR2 = 0.7f, SPOKES_APART = 1.0f;

// A Gaussian of (u, v): its middle, and the inverse of its covariance.
struct Gaussian2 {
    float u, v, uu, uv, vv;
};

// Spokes of a ring: how far they are apart [rad], and the variance of what lies on them and of their spline [rad²].
struct RingLevel {
    float spacing, blur2;
};

// The weight of a Gaussian at a place (x, y) of the unit circle times the radius, once it is narrower by a variance
// along the ring, if it is within so many deviations. There it is one whose exponent has the same slope and bend.
WARPDIFF_INLINE float weight_on_ring(
    const Gaussian2& gaussian, float x, float y, float radius, float blur2, float reach)
{
    const float u = radius * x - gaussian.u, v = radius * y - gaussian.v;
    const float pu = gaussian.uu * u + gaussian.uv * v, pv = gaussian.uv * u + gaussian.vv * v;
    const float slope = radius * (x * pv - y * pu);
    const float across = gaussian.uu * y * y - 2.0f * gaussian.uv * x * y + gaussian.vv * x * x;
    const float bend = radius * (radius * across - (x * pu + y * pv));
    const float left = larger(1.0f - blur2 * bend, 1.0f - 1.2f * MOST_BLUR2);
    const float exponent = u * pu + v * pv + slope * slope * blur2 / left;
    return exponent < reach * reach ? exp_of_negative(-0.5f * exponent) / wp::sqrt(left) : 0.0f;
}

template <class Table>
WARPDIFF_INLINE RingLevel ring_level(const Table& table, int level, int octave)
{
    const int at = level * (int)table.spokes.shape[1] + octave;
    const float blur = numbers<const float>(table.blurs)[at];
    const float spacing = 2.0f * PI / (float)numbers<const int>(table.spokes)[at];
    return {spacing, blur * blur + 0.25f * spacing * spacing};
}

// The widest level that serves a variance along the ring, from one on, and its spokes.
template <class Table>
WARPDIFF_INLINE RingLevel widest_level(const Table& table, float variance, int octave, int& level)
{
    RingLevel found = ring_level(table, level, octave);
    while (level + 1 < table.spokes.shape[0]) {
        const RingLevel wider = ring_level(table, level + 1, octave);
        if (wider.blur2 > MOST_BLUR2 * variance) break;
        if (wider.spacing * wider.spacing > SPOKES_APART * SPOKES_APART * variance) break;
        found = wider;
        ++level;
    }
    found.blur2 = smaller(found.blur2, MOST_BLUR2 * variance);
    return found;
}

// A sum of rows so far, and of their weights.
template <int WIDTH>
struct RingSum {
    Row<WIDTH> rows;
    float weights;
};

// Add the rows of a ring from one spoke up to another, which is left out: arcs may touch.
template <int WIDTH>
WARPDIFF_INLINE void add_arc(RingSum<WIDTH>& sum, const Gaussian2& gaussian, RingLevel level, float radius, float reach,
    float size, float first, float end, int count, const float* rows, long long stride)
{
    const int taken = wp::min((int)(wp::ceil(end) - wp::ceil(first)), count);
    int spoke = cyclic((int)wp::ceil(first), count);
    for (int from = 0; from < taken; from += ARC) {
        Batch<ARC> weights;
        for (int j = 0; j < ARC; ++j) {
            float x, y;
            on_circle((float)(spoke + j) / (float)count, x, y);
            const float weight = size * weight_on_ring(gaussian, x, y, radius, level.blur2, reach);
            weights[j] = from + j < taken ? weight : 0.0f;
        }
        for (int j = 0; j < ARC; ++j, ++spoke) {
            if (spoke == count) spoke = 0;
            if (!(weights[j] > 0.0f)) continue;
            sum.rows.add(weights[j], rows + spoke * stride);
            sum.weights += weights[j];
        }
    }
}

// The mean of rows over a Gaussian around (u, v), from the outermost ring inwards.
template <int WIDTH, class Table>
inline Row<WIDTH> mean_over_rings(const Table& table, float u, float v, float xx, float xy, float yy)
{
    const float least = NARROWEST * table.lobe_uv, a = xx + least * least, d = yy + least * least;
    const float determinant = larger(a * d - xy * xy, 1.0e-5f * a * d), mean2 = 0.5f * (a + d);
    const float widest2 = mean2 + wp::sqrt(larger(mean2 * mean2 - determinant, 0.0f)), narrow2 = determinant / widest2;
    const float widest = wp::sqrt(widest2), narrow = wp::sqrt(narrow2), middle = wp::sqrt(u * u + v * v);
    const Gaussian2 gaussian = {u, v, d / determinant, -xy / determinant, a / determinant};
    const float turns = log_polar(u, v, table.least_uv).turns;
    // The direction across the axis of a streak, and how far away that axis is.
    const float across = 0.5f * log_polar(a - d, 2.0f * xy, 0.0f).turns + 0.25f;
    float x, y;
    on_circle(across, x, y);
    const float aside = u * x + v * y;
    // Rings lie on the nodes of the table.
    const int octaves = table.spokes.shape[1], apart = wp::max((int)(RINGS_APART * table.per_log), 1);
    const float outermost = log_polar(middle + OUTWARDS * widest, 0.0f, table.least_uv).log2;
    const float nearest = smaller(INNERMOST * narrow, INNERMOST_OF_LOBE * table.lobe_uv);
    const float innermost = larger(larger(middle - INWARDS * widest, nearest), table.least_uv);
    int node = wp::min((int)(outermost * (float)table.nodes + table.node_of_one), octaves * table.nodes - 1);
    float radius = wp::exp(((float)node - table.node_of_one) / table.per_log);
    const float nearer = wp::exp(-(float)apart / table.per_log);
    RingSum<WIDTH> sum;
    sum.rows.clear();
    sum.weights = 0.0f;
    for (int level = 0; node >= 0 && radius > innermost;) {
        // Further in the Gaussian takes up more of a ring.
        const int octave = (int)((float)node * table.per_octave);
        const float variance = narrow2 / (radius * larger(radius, middle));
        const RingLevel spokes = widest_level(table, variance, octave, level);
        const int at = level * octaves + octave, count = numbers<const int>(table.spokes)[at];
        const float* const rows = numbers<const float>(table.rows)
            + (long long)(numbers<const int>(table.first_rows)[at] + node - octave * table.nodes) * WIDTH;
        const long long stride = (long long)table.nodes * WIDTH;
        // The arc within reach around (u, v), or for a streak those within reach of its axis, if they are shorter.
        const float reach = radius < middle ? INWARDS : OUTWARDS, furthest = reach * widest, beside = reach * narrow;
        const float around = arc_cosine(
            (radius * radius + middle * middle - furthest * furthest) / larger(2.0f * radius * middle, 1.0e-20f));
        const float from = arc_cosine((aside + beside) / radius), to = arc_cosine((aside - beside) / radius);
        const bool is_coarse = radius < WITHIN * narrow, is_streak = to - from < around;
        const float size = (is_coarse ? 2.0f : 1.0f) * radius * radius * spokes.spacing;
        const float middle_spoke = (is_streak ? across : turns) * (float)count, per_radian = 1.0f / spokes.spacing;
        for (int side = 0; side < (is_streak ? 2 : 1); ++side) {
            const float first = !is_streak ? -around : side == 0 ? from : -to;
            const float end = !is_streak ? around : side == 0 ? to : -from;
            add_arc(sum, gaussian, spokes, radius, reach, size, middle_spoke + first * per_radian,
                middle_spoke + end * per_radian, count, rows, stride);
        }
        node -= is_coarse ? 2 * apart : apart;
        radius *= is_coarse ? nearer * nearer : nearer;
    }
    Row<WIDTH> mean;
    mean.clear();
    mean.add(1.0f / larger(sum.weights, 1.0e-30f), sum.rows);
    return mean;
}

} // namespace warpdiff
