// Mean colours over footprints of pixels that are wide compared with the distance |(u, v)| from the mirror direction.
// The table is a polar grid of (u, v): a ring is a circle of constant |(u, v)|, and an azimuth is a line of constant
// polar angle.
//
// The look-up for other footprints assumes that a footprint covers a small range of angles and radii. A wide footprint
// covers a large range. Its colour is therefore a weighted sum of the rows at all rings and azimuths within the
// footprint. The weight of a row is the value of the footprint's Gaussian in (u, v). Rows of a mip level are already
// blurred along a ring. To compensate for this blur, the Gaussian is made narrower along the ring.

#pragma once

#include "fast_math.h"
#include "simd.h"

namespace warpdiff {

// Number of azimuth samples on a ring (circle of constant |(u, v)|) of the colour table that are processed together.
// The value is limited by the number of elements of a SIMD vector.
constexpr int ARC = batch_of(8);
// Distance from its centre at which the Gaussian of a footprint (range of (u, v) in a pixel) is truncated [standard
// deviations]. `OUTWARDS` is for directions away from the mirror direction, and `INWARDS` for directions towards it,
// where surfaces are brightest. The values are limited by time: with a larger distance, more rows of the colour table
// are added.
constexpr float OUTWARDS = 3.2f, INWARDS = 4.5f;
// The colour of a footprint, a Gaussian over (u, v), is a sum over some rings (circles) of the colour table. Two limits
// apply to the distance between added rings: `RINGS_APART` in ln |(u, v)|, over which colours are smooth, and
// `RINGS_PER_DEVIATION` in standard deviations of the Gaussian in the direction of (u, v). The distance is doubled for
// rings whose radius is below `WITHIN` times the smaller standard deviation. If it was doubled everywhere, sums over
// narrow Gaussians would be inaccurate.
constexpr float RINGS_APART = 0.1f, RINGS_PER_DEVIATION = 1.2f, WITHIN = 0.5f;
// Rings (circles) of the colour table are added down to a smallest radius |(u, v)|. It is the smaller of two products:
// `INNERMOST` times the smaller standard deviation of the footprint's Gaussian, and `INNERMOST_OF_LOBE` times the
// standard deviation of the peak of a diffraction order in (u, v). `NARROWEST` is the least standard deviation of the
// Gaussian, relative to that of the peak. The values are limited by time: smaller values add more rings.
constexpr float INNERMOST = 0.1f, INNERMOST_OF_LOBE = 0.3f, NARROWEST = 0.3f;
// Rule for the mip level (a blurred copy of the colour table) from which rows are added. `MOST_BLUR2` is the maximum
// variance of the blur of the level, relative to the variance of the footprint's Gaussian along the ring (circle).
// `AZIMUTHS_APART` is the maximum distance of the level's azimuth samples, in standard deviations of the Gaussian.
constexpr float MOST_BLUR2 = 0.7f, AZIMUTHS_APART = 1.0f;

// A Gaussian over (u, v): its mean and the inverse of its covariance.
struct Gaussian2 {
    float u, v, uu, uv, vv;
};

// Mip level (a blurred copy of the table) from which the rings of one octave of |(u, v)| are added. `spacing` is the
// distance of its azimuth samples [rad]. `blur2` is the variance of the blur of its rows minus the variance of the
// spline between azimuths [rad²]. If the variance of the Gaussian along a ring is at least `until`, the next level is
// used.
struct RingLevel {
    int octave, level, azimuths, first_row;
    float spacing, blur2, until;
};

// Return the value of a Gaussian at a point of a ring (circle of constant |(u, v)|), or 0 beyond `cutoff` standard
// deviations. The direction of the point is (x, y). The rows of the table are blurred along the ring with the variance
// `blur2`. The variance of the Gaussian along the ring is therefore reduced by `blur2`. For this reduction, the
// logarithm of the Gaussian along the ring is approximated by a parabola.
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

// Replace `widest` by the most blurred mip level (copy of the table) in an octave of |(u, v)| that the variance of the
// Gaussian along the ring permits. Rings (circles of constant |(u, v)|) are processed from the outermost ring inwards.
// From one octave to the next inner octave, the blur of a level [rad] may double. The search therefore starts with the
// level that is one step less blurred than the present level.
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

// Add the table rows on an arc of a ring (circle of constant |(u, v)|), from the azimuth `first` to the azimuth `end`.
// The azimuth `end` is excluded, because it may be the first azimuth of the next arc.
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

// Gaussian by which the rows of the table are weighted, with the mean (u, v).
//
// `widest` and `narrow` are its standard deviations along its long and its short axis, with the squares `widest2` and
// `narrow2`. `across` is the polar angle of the short axis [turns]. The mirror direction, u = v = 0, has the distance
// `aside` from the long axis, and the distance `along` from the short axis.
struct FootprintAxes {
    float widest2, narrow2, widest, narrow, across, aside, along;
    Gaussian2 gaussian;

    template <class Table>
    WARPDIFF_INLINE FootprintAxes(const Table& table, float u, float v, float xx, float xy, float yy)
    {
        // Rows are coefficients of a quadratic spline between rings (circles of the table), which blurs the rows by a
        // variance of a quarter of the squared ring spacing. This variance is added to the covariance of the Gaussian.
        const float apart2 = 0.25f / (table.rings_per_log * table.rings_per_log);
        const float a = xx + apart2 * u * u, b = xy + apart2 * u * v, d = yy + apart2 * v * v, mean2 = 0.5f * (a + d);
        const float least = NARROWEST * table.lobe_uv;
        widest2 = mean2 + wp::sqrt(0.25f * (a - d) * (a - d) + b * b);
        narrow2 = larger((a * d - b * b) / widest2, least * least);
        widest = wp::sqrt(widest2), narrow = wp::sqrt(narrow2);
        across = 0.5f * log_polar(a - d, 2.0f * b, 0.0f).turns + 0.25f;
        float x, y;
        on_circle(across, x, y);
        aside = u * x + v * y, along = v * x - u * y;
        gaussian = {u, v, x * x / narrow2 + y * y / widest2, x * y * (1.0f / narrow2 - 1.0f / widest2),
            y * y / narrow2 + x * x / widest2};
    }
};

// Return the sum of all rows of the table, weighted by a Gaussian around (u, v). The rings (circles of constant
// |(u, v)|) are added from the outermost ring inwards.
template <int WIDTH, class Table>
inline WeighedRows<WIDTH> sum_over_rings(const Table& table, float u, float v, float xx, float xy, float yy)
{
    const FootprintAxes axes(table, u, v, xx, xy, yy);
    const float widest = axes.widest, narrow = axes.narrow, middle = wp::sqrt(u * u + v * v);
    const float turns = log_polar(u, v, table.least_uv).turns;
    // Distance between the rings (circles of constant |(u, v)|) that are added, a multiple of the distance between
    // rings in the table. It is limited by the width of the Gaussian in the direction of (u, v).
    const float steepness = wp::sqrt(axes.aside * axes.aside / axes.narrow2 + axes.along * axes.along / axes.widest2);
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
    // The index −1 of an octave of |(u, v)| means that no mip level has been selected yet.
    RingLevel level = {-1};
    while (ring >= 0 && radius > innermost) {
        // The smaller the radius of a ring (circle of the table) is, the larger is the angle that the Gaussian covers
        // on it. More blurred mip levels (copies of the table) then suffice.
        const int octave = (int)((float)ring * table.octaves_per_ring);
        const float variance = axes.narrow2 / (radius * larger(radius, middle));
        if (octave != level.octave || variance >= level.until) widen(table, level, octave, variance);
        const float blur2 = smaller(level.blur2, MOST_BLUR2 * variance);
        const float* const rows = numbers<const float>(table.rows)
            + (long long)(level.first_row + ring - octave * table.rings_per_octave) * WIDTH;
        const long long stride = (long long)table.rings_per_octave * WIDTH;
        // On a ring (circle of constant |(u, v)|), the Gaussian covers an arc around the direction of (u, v). The
        // points of a long and narrow Gaussian are also within two arcs around the directions of its long axis. These
        // two arcs are used instead if they are shorter.
        const float cutoff = radius < middle ? INWARDS : OUTWARDS, furthest = cutoff * widest, beside = cutoff * narrow;
        const float around = turns_of_cosine(
            (radius * radius + middle * middle - furthest * furthest) / larger(2.0f * radius * middle, 1.0e-20f));
        float from = 0.0f, to = 1.0f;
        if (widest > 1.5f * narrow) {
            from = turns_of_cosine((axes.aside + beside) / radius);
            to = turns_of_cosine((axes.aside - beside) / radius);
        }
        const bool is_coarse = radius < WITHIN * narrow, is_streak = to - from < around;
        const float size = (is_coarse ? 2.0f : 1.0f) * radius * radius * level.spacing, all = (float)level.azimuths;
        // The positions of arcs of a ring (circle) are rounded to 1/64 of the distance between azimuth samples. If two
        // arcs touch, each azimuth is therefore in exactly one of them, in spite of the rounding errors of float32.
        const float place = wp::rint(64.0f * all * (is_streak ? axes.across : turns)) * (1.0f / 64.0f);
        for (int side = 0; side < (is_streak ? 2 : 1); ++side) {
            const float first = !is_streak ? -around : side == 0 ? from : -to;
            const float end = !is_streak ? around : side == 0 ? to : -from;
            add_arc(sum, axes.gaussian, radius, blur2, cutoff, size, place + first * all, place + end * all,
                level.azimuths, rows, stride);
        }
        ring -= is_coarse ? 2 * apart : apart;
        radius *= is_coarse ? nearer * nearer : nearer;
    }
    return sum;
}

} // namespace warpdiff
