// Mean colours over the footprints of pixels, from a colour table and its mip levels. A footprint is a Gaussian of
// (u, v).
//
// The table is a polar grid of (u, v): an azimuth is a line of constant polar angle, and a ring is a circle of constant
// |(u, v)|. An octave has the rings between one radius and twice this radius. A footprint is usually looked up as one
// part. It is split into several parts if the polar angle of (u, v) changes much within it. The colour of a part is a
// weighted sum over rings. Rings are processed in segments; a segment lies within one octave. The colour at a ring is a
// weighted sum over azimuths. It uses the widest mip level whose blur does not exceed the blur of the footprint. The
// CPU processes batches of pixels stage by stage, with arrays between the stages, so that compilers vectorise the
// loops. A GPU thread processes one pixel, part and segment at a time.
//
// (u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
// light and to the viewer.

#pragma once

#include "colour_of_w.h"
#include "fast_math.h"
#include "ring_sum.h"
#include "simd.h"

namespace warpdiff {

// Number of pixels, or of parts of footprints, that a vectorised loop processes at a time. The number of iterations is
// rounded up to a multiple of it, so that all vectors are full. Compiled code would round differently in a vector that
// is filled only in part.
constexpr int ABREAST = batch_of(8);
// Rings are circles of constant |(u, v)| in the colour table. A segment is a group of rings that are processed
// together. The value is its largest number of rings. On the CPU, it is limited by the local arrays with the weights
// and table rows of all rings of a segment. A GPU needs no such arrays.
constexpr int SEGMENT_RINGS = ON_GPU ? 1 << 20 : 4;
// A footprint counts as wide if its standard deviation exceeds this share of |(u, v)|. `ring_sum.h` computes the
// colours of wide footprints. Only tables for a coherence window distinguish wide footprints. The value was fitted to
// the computing time of pictures: with 0.15, pictures require 5 to 10 % more time than with 0.25.
constexpr float WIDE = 0.25f;
// If the standard deviation of the polar angle of (u, v) exceeds `MOST_TURN` [rad], a footprint is split into parts;
// within a part, the curvature of the rings (circles of constant |(u, v)|) is ignored. `WIDEST_ANGLE` [rad] and
// `WIDEST_RATIO` are upper limits for the standard deviations of the angle and of ln |(u, v)|. Footprints beyond these
// limits surround the mirror direction, and polar coordinates do not describe such footprints.
constexpr float MOST_TURN = 0.1f, WIDEST_ANGLE = 0.5f, WIDEST_RATIO = 0.35f;
// A look-up adds rings of the colour table (circles of constant |(u, v)|) with weights that blur over rings. Weights
// are tabulated for blurs with a variance of at most `MOST_TABULATED` [rings²]. For larger variances, they are values
// of a Gaussian, and not all rings are added. `MOST_APART` is the largest distance between added rings, in units of
// 1/√(1/σ₁² + 1/σ₂² + …). Each σ is the standard deviation of the blur, or of a feature of the colours over rings.
// `CURVES` is the standard deviation over ln λ of the narrowest colour curve: the product of illuminant,
// colour-matching function and reflectance.
constexpr float MOST_TABULATED = 1.5f, MOST_APART = 1.5f, CURVES = 0.047f;

// Gaussian with which rings (circles of the colour table) are weighted if the blur across rings is wide. It is
// truncated at `deviations` standard deviations from its centre, and has the variance 1 after the truncation. Its
// variance before the truncation is larger: 1/`per_variance`.
struct CutGaussian {
    float deviations, per_variance;
};

// Footprints of at most N rays in (u, v), with the covariance of each footprint. Each ray belongs to a pixel or to a
// subpixel cell. `ray` is the index of the footprint's ray in its batch. Rays with the gain 0 have no footprint;
// there are `count` footprints.
template <int N>
struct Footprints {
    int count;
    Batch<N, int> ray;
    Batch<N> u, v, w;
    Batch<N> light_x, light_y, light_z;        // direction to the light source, in the surface's frame
    Batch<N> row_u, row_v, column_u, column_v; // changes of (u, v) by one standard deviation of the pixel filter
    // `xx`, `xy` and `yy` are the covariance of (u, v). `source2` is the square root of the determinant of the
    // covariance of (u, v) over a light source. `angle2` and `ratio2` are the variances of the polar angle and of ln
    // |(u, v)|, and `both` is their covariance. (`along_u`, `along_v`) is the change of (u, v) by one standard
    // deviation of the polar angle. `parts` is the number of parts into which a footprint is divided.
    Batch<N> xx, xy, yy, source2;
    Batch<N> angle2, ratio2, both;
    Batch<N> along_u, along_v, parts;
    AtW<N> at_w;
};

// Parts of the footprints of several pixels. A footprint with a large range of polar angles is divided into parts,
// which are looked up separately. A part has a position in the table, and its colour is a weighted mean over rings
// (circles of constant |(u, v)|) and azimuths (polar angles).
template <int N>
struct Parts {
    int count;
    Batch<N, int> pixel;
    Batch<N> share, u, v, angle2, ratio2, both;
    // `turns` and `place` are the polar angle [turns] and the index of the ring (circle of constant |(u, v)|) at the
    // centre of a part. `deviation` is the standard deviation of a part across the rings, and `skew` a sixth of its
    // skewness.
    Batch<N> turns, place, deviation, skew;
    Batch<N> turn_per_ring, aside2, half_ratio2, spacing;
    Batch<N, int> apart, step, taps, begin, end, first_weight;
};

// Segments: groups of consecutive rings (circles of constant |(u, v)| in the colour table) that are added together. The
// rings of a segment lie within one octave (factor of 2) of |(u, v)|, and within one part of a pixel's footprint.
template <int N>
struct Segments {
    int count;
    Batch<N, int> part, first, apart, rings;
    // `position` is the azimuth (polar angle) of the centre of a footprint's part. At a ring (circle) with t times the
    // radius of the centre, the azimuth of the part is shifted by `turning` · (1 − 1/t). `away` is the distance [rings]
    // of the first ring of the segment from the mean of ln |(u, v)|. `behind` is the difference between the mean of ln
    // |(u, v)| and its value at the centre. `blur` is the variance of the footprint in angle at the centre, and
    // `level_blur` the variance that the rows of the mip level already have. Both variances are in steps of the table
    // of weights, so that their difference is an index into the table. A rounding offset of ½ is included in
    // `level_blur`.
    Batch<N> position, turning, away, behind, blur, level_blur, skew, per_deviation;
    Batch<N, int> azimuths, first_row;
};

// Rows of the colour table that are added for one ring (circle), one row per azimuth sample. `row` is the index of the
// first row, `count` the number of rows, and `taps` the index of the first weight in the table of weights.
struct RingRows {
    int row, count, taps;
};

struct PolarCovariance {
    float angle_u, angle_v, angle2, ratio2, both;
};

// Convert a covariance of (u, v) to the covariance of its polar angle and of ln |(u, v)|. Near the mirror direction,
// the radius |(u, v)| is increased to about the width of the peak (lobe) of a diffraction order.
template <class Table>
WARPDIFF_INLINE PolarCovariance to_polar(const Table& table, float u, float v, float xx, float xy, float yy)
{
    const float uv2 = larger(u * u + v * v + table.lobe_uv * table.lobe_uv, table.least_uv * table.least_uv);
    const float x = u / uv2, y = v / uv2;
    const float angle_u = x * xy - y * xx, angle_v = x * yy - y * xy;
    return {
        angle_u,
        angle_v,
        larger(x * angle_v - y * angle_u, 0.0f),
        larger(x * x * xx + 2.0f * x * y * xy + y * y * yy, 0.0f),
        x * angle_u + y * angle_v,
    };
}

// List the rays of a batch whose gain (geometry factor) is not 0, and load their footprints. The other rays contribute
// nothing, for example because they are in shadow or hit a material that has another table.
template <bool SOURCE, int N>
WARPDIFF_INLINE void load_footprints(Footprints<N>& pixels, const double* scattering_vectors, const float* to_lights,
    const float* footprints, const float* gains, int count)
{
    pixels.count = 0;
    for (int ray = 0; ray < count; ++ray) {
        pixels.ray[pixels.count] = ray;
        pixels.count += gains[ray] != 0.0f;
    }
    for (int i = 0; i < pixels.count; ++i) {
        const int ray = pixels.ray[i];
        pixels.u[i] = (float)scattering_vectors[3 * ray];
        pixels.v[i] = (float)scattering_vectors[3 * ray + 1];
        pixels.w[i] = (float)-scattering_vectors[3 * ray + 2];
        pixels.light_x[i] = SOURCE ? to_lights[3 * ray] : 0.0f;
        pixels.light_y[i] = SOURCE ? to_lights[3 * ray + 1] : 0.0f;
        pixels.light_z[i] = SOURCE ? to_lights[3 * ray + 2] : 0.0f;
        pixels.row_u[i] = footprints ? footprints[4 * ray] : 0.0f;
        pixels.row_v[i] = footprints ? footprints[4 * ray + 1] : 0.0f;
        pixels.column_u[i] = footprints ? footprints[4 * ray + 2] : 0.0f;
        pixels.column_v[i] = footprints ? footprints[4 * ray + 3] : 0.0f;
    }
    for (int i = pixels.count; i % ABREAST != 0; ++i)
        pixels.u[i] = pixels.v[i] = pixels.w[i] = pixels.light_x[i] = pixels.light_y[i] = pixels.light_z[i] =
            pixels.row_u[i] = pixels.row_v[i] = pixels.column_u[i] = pixels.column_v[i] = 0.0f;
}

// Return the squared length of a pixel's direction to the light. It is 1, unless the lengths are pitch scales: factors
// by which the gratings of a grating map are stretched.
template <int N, class Table>
WARPDIFF_INLINE float squared_length(const Table& table, const Footprints<N>& pixels, int i)
{
    const float x = pixels.light_x[i], y = pixels.light_y[i], z = pixels.light_z[i];
    return table.has_pitch_scales ? x * x + y * y + z * z : 1.0f;
}

// Compute the covariances of footprints, in (u, v) and in polar coordinates, and the number of parts of each footprint.
// `SCALED` states whether the lengths of directions to the light are pitch scales: factors by which the gratings of a
// grating map are stretched.
template <bool SOURCE, bool SCALED, int MOST_PARTS, int N, class Table>
WARPDIFF_INLINE void find_covariances(const Table& table, Footprints<N>& pixels)
{
    for (int from = 0; from < pixels.count; from += ABREAST)
        for (int i = from; i < from + ABREAST; ++i) {
            // The covariance of (u, v) over a light source of spread s is Σs = s² (I − t tᵀ). I is the unit matrix, and
            // the vector t is the projection of the direction to the light onto the surface. On a grating map, the
            // direction to the light may have the factor p as its length, by which the pitch is scaled. The covariance
            // is then p² Σs = s² (p² I − (p t) (p t)ᵀ).
            const float spread2 = SOURCE ? table.spread2 : 0.0f, t0 = pixels.light_x[i], t1 = pixels.light_y[i];
            const float length2 = SCALED ? squared_length(table, pixels, i) : 1.0f;
            const float row_u = pixels.row_u[i], row_v = pixels.row_v[i];
            const float column_u = pixels.column_u[i], column_v = pixels.column_v[i];
            pixels.source2[i] = spread2 * pixels.light_z[i] * (SCALED ? wp::sqrt(length2) : 1.0f);
            pixels.xx[i] = spread2 * (length2 - t0 * t0) + (row_u * row_u + column_u * column_u);
            pixels.xy[i] = -spread2 * t0 * t1 + (row_u * row_v + column_u * column_v);
            pixels.yy[i] = spread2 * (length2 - t1 * t1) + (row_v * row_v + column_v * column_v);
            pixels.at_w.set(i, table, pixels.w[i]);
            const PolarCovariance polar =
                to_polar(table, pixels.u[i], pixels.v[i], pixels.xx[i], pixels.xy[i], pixels.yy[i]);
            pixels.angle2[i] = polar.angle2;
            pixels.ratio2[i] = polar.ratio2;
            pixels.both[i] = polar.both;
            // The centres of a footprint's parts lie on a line through its centre, in the direction of the covariance
            // between (u, v) and the polar angle of (u, v).
            const float whole = wp::sqrt(pixels.angle2[i]), per_whole = whole > 0.0f ? 1.0f / whole : 0.0f;
            pixels.along_u[i] = polar.angle_u * per_whole;
            pixels.along_v[i] = polar.angle_v * per_whole;
            const float turns = whole * (1.0f / MOST_TURN);
            pixels.parts[i] = turns > 1.0f ? smaller(-wp::floor(-turns), (float)MOST_PARTS) : 1.0f;
        }
}

// Return whether the table of a light source of finite size excludes the colour of a pixel. It does so near the mirror
// direction. It also does so if the blur by the source is narrower than the blur that the rows of the table already
// have. If a footprint is split into parts, a share `cut` of its variance in angle is the variance between the parts.
// The remaining share, `within`, is the variance within each part. Only this variance is compared with the blur of the
// rows.
template <int N, class Table>
WARPDIFF_INLINE bool is_unserved(const Table& table, const Footprints<N>& pixels, int i, float within, float cut)
{
    const float u = pixels.u[i], v = pixels.v[i], both = pixels.both[i], per_log = table.rings_per_log;
    const LogPolar at = log_polar(u, v, table.least_uv);
    const float over2 = pixels.ratio2[i] - ((int)pixels.parts[i] > 1 ? cut * both * both / pixels.angle2[i] : 0.0f)
        + 0.25f / (per_log * per_log);
    const int octave =
        wp::clamp((int)((at.log2 * (float)table.rings_per_octave + table.ring_of_one) * table.octaves_per_ring), 0,
            (int)table.azimuths.shape[1] - 1);
    return u * u + v * v < table.inner_radius2 * squared_length(table, pixels, i)
        || (within * pixels.angle2[i] - numbers<const float>(table.line_blurs2)[octave]) * over2
        < within * within * both * both;
}

// Return whether a footprint is wide compared with |(u, v)|. `ring_sum.h` computes the colours of such footprints.
template <int N, class Table>
WARPDIFF_INLINE bool is_wide(const Table& table, const Footprints<N>& pixels, int i)
{
    const float uv2 = pixels.u[i] * pixels.u[i] + pixels.v[i] * pixels.v[i] + table.lobe_uv * table.lobe_uv;
    return pixels.xx[i] + pixels.yy[i] > WIDE * WIDE * uv2;
}

// Position in a list of footprints: the index of the next pixel, and the index of the next part of its footprint.
struct NextPart {
    int pixel, part;
};

// Divide footprints into parts, until all footprints are divided or the batch of parts is full. Store the (u, v) and
// the covariance of each part, and the fraction of the colour of its pixel that it contributes. Pixels with footprints
// that are wide compared with |(u, v)| get no parts: their colours are computed and added here. The zeroth order of all
// pixels is added, too.
template <bool SOURCE, int MOST_PARTS, int WIDTH, int N, class Table>
WARPDIFF_INLINE void next_parts(const Table& table, const float* splits, const float* gains,
    const Footprints<N>& pixels, NextPart& next, Parts<N>& parts, float* unserved_gain, float* xyz)
{
    parts.count = 0;
    while (parts.count < N && next.pixel < pixels.count) {
        const int i = next.pixel, ray = pixels.ray[i], all = (int)pixels.parts[i], k = parts.count;
        const float gain = gains[ray], u = pixels.u[i], v = pixels.v[i];
        const float* const split = splits + (all - 1) * 3 * MOST_PARTS;
        const float within = split[0], cut = 1.0f - within, away = split[MOST_PARTS + next.part];
        float share = gain * split[2 * MOST_PARTS + next.part];
        if (SOURCE) {
            if (is_unserved(table, pixels, i, within, cut)) {
                unserved_gain[ray] = gain;
                ++next.pixel;
                continue;
            }
            share *= 2.0f * PI * pixels.source2[i];
        }
        if (next.part == 0)
            add_zeroth_order(table, u, v, pixels.w[i], pixels.xx[i], pixels.xy[i], pixels.yy[i], pixels.source2[i],
                gain, xyz + 3 * ray);
        if (!SOURCE && is_wide(table, pixels, i)) {
            const WeighedRows<WIDTH> sum = sum_over_rings<WIDTH>(table, u, v, pixels.xx[i], pixels.xy[i], pixels.yy[i]);
            add_colour(table, sum.rows, pixels.at_w, i, gain / larger(sum.weights, 1.0e-30f), xyz + 3 * ray);
            next = {i + 1, 0};
            continue;
        }
        const float along_u = pixels.along_u[i], along_v = pixels.along_v[i];
        parts.u[k] = u + away * along_u;
        parts.v[k] = v + away * along_v;
        parts.angle2[k] = pixels.angle2[i];
        parts.ratio2[k] = pixels.ratio2[i];
        parts.both[k] = pixels.both[i];
        if (all > 1) {
            // The covariance within a part of a footprint is converted to polar coordinates at the (u, v) of the part.
            const PolarCovariance polar =
                to_polar(table, parts.u[k], parts.v[k], pixels.xx[i] - cut * along_u * along_u,
                    pixels.xy[i] - cut * along_u * along_v, pixels.yy[i] - cut * along_v * along_v);
            parts.angle2[k] = polar.angle2;
            parts.ratio2[k] = polar.ratio2;
            parts.both[k] = polar.both;
        }
        parts.share[k] = share;
        parts.pixel[k] = i;
        ++parts.count;
        if (++next.part == all) next = {i + 1, 0};
    }
    for (int k = parts.count; k > 0 && k % ABREAST != 0; ++k) {
        parts.u[k] = parts.u[k - 1];
        parts.v[k] = parts.v[k - 1];
        parts.angle2[k] = parts.angle2[k - 1];
        parts.ratio2[k] = parts.ratio2[k - 1];
        parts.both[k] = parts.both[k - 1];
    }
}

// Compute the position of each part of a footprint in the colour table. Compute also the two standard deviations of the
// part: across the rings (circles) of the table, and across the azimuths (polar angles).
template <int N, class Table>
WARPDIFF_INLINE void place_parts(const Table& table, Parts<N>& parts)
{
    const float per_log = table.rings_per_log;
    for (int from = 0; from < parts.count; from += ABREAST)
        for (int k = from; k < from + ABREAST; ++k) {
            const float of_angle2 = parts.angle2[k], of_ratio2 = parts.ratio2[k];
            const float turn_share = smaller(WIDEST_ANGLE / wp::sqrt(larger(of_angle2, 1.0e-12f)), 1.0f);
            const float ratio_share = smaller(WIDEST_RATIO / wp::sqrt(larger(of_ratio2, 1.0e-12f)), 1.0f);
            const float angle2 = of_angle2 * turn_share * turn_share, ratio2 = of_ratio2 * ratio_share * ratio_share;
            const float both = parts.both[k] * turn_share * ratio_share;
            // The mean of ln |(u, v)| over a Gaussian differs from the value of ln |(u, v)| at the centre. The mean is
            // computed to second order in the width of the Gaussian.
            LogPolar at = log_polar(parts.u[k], parts.v[k], table.least_uv);
            at.log2 += 0.721347520f * (angle2 - ratio2);
            parts.turns[k] = at.turns;
            parts.place[k] = at.log2 * (float)table.rings_per_octave + table.ring_of_one;
            // The polar angle of (u, v) may be correlated with ln |(u, v)|: the azimuth of the footprint then shifts
            // from ring to ring (circles of constant |(u, v)|). The remaining variance of the angle blurs each ring.
            // The quadratic spline between rings adds a variance of ¼ rings².
            const float variance = ratio2 * per_log * per_log + 0.25f, deviation = wp::sqrt(variance);
            parts.turn_per_ring[k] = both * per_log / variance;
            parts.half_ratio2[k] = 0.5f * ratio2;
            parts.aside2[k] = larger(angle2 - parts.turn_per_ring[k] * both * per_log, 0.0f);
            parts.deviation[k] = deviation;
            // The distribution of ln |(u, v)| is skewed: on a logarithmic scale, smaller radii are farther away. The
            // skew is a sixth of the third moment, in standard deviations. A correlation of the angle with ln |(u, v)|
            // would add a term to the third moment. This term is omitted, because it is derived for azimuths (polar
            // angles) that are linear in ln |(u, v)|. In contrast, `place_ring` places the azimuths of a part on a
            // straight line in (u, v).
            parts.skew[k] = -0.5f * ratio2 * ratio2 * per_log * per_log * per_log / (variance * deviation);
        }
}

// Select the rings (circles) of the table that are added for each part of a footprint: first and last ring, spacing and
// weights of the rings.
template <bool SOURCE, int N, class Table, class Taps>
WARPDIFF_INLINE void choose_rings(const Table& table, const Taps& taps, CutGaussian cut, Parts<N>& parts)
{
    const int octaves = table.azimuths.shape[1], fractions = taps.weights.shape[1], most_taps = taps.weights.shape[2];
    const int all_rings = octaves * table.rings_per_octave;
    const float per_log = table.rings_per_log, per_curves2 = 1.0f / (CURVES * CURVES * per_log * per_log);
    // This loop reads entries of the table of weights at computed indices. It is separate from the other loops, because
    // compilers do not vectorise a loop that contains such reads and has several outputs.
    for (int from = 0; from < parts.count; from += ABREAST)
        for (int k = from; k < from + ABREAST; ++k)
            parts.spacing[k] = numbers<const float>(
                table.blurs)[octaves + wp::clamp((int)(parts.place[k] * table.octaves_per_ring), 0, octaves - 1)];
    for (int from = 0; from < parts.count; from += ABREAST)
        for (int k = from; k < from + ABREAST; ++k) {
            // Over the angle √`across2` along a ring (circle), blurred colours are smooth. In tables for a coherence
            // window, `across2` is the variance of the footprint plus the squared distance between azimuth samples. In
            // tables of a light source, the distance is not added: such a table has colours only for footprints that
            // are wider than the blur of the spectral lines, which is proportional to this distance.
            const float across2 = parts.aside2[k] + (SOURCE ? 1.0e-12f : parts.spacing[k] * parts.spacing[k]);
            const float variance = parts.deviation[k] * parts.deviation[k], turn = parts.turn_per_ring[k];
            const float sharp = wp::sqrt(per_curves2 + turn * turn / across2 + 1.0f / variance);
            const float most = MOST_APART / (sharp + table.decimation_scale);
            parts.apart[k] = most < 2.0f ? 1 : most < 4.0f ? 2 : most < 8.0f ? 4 : 8;
            parts.step[k] =
                variance < MOST_TABULATED + 0.25f ? (int)((variance - 0.25f) * taps.per_variance + 0.5f) : -1;
        }
    for (int from = 0; from < parts.count; from += ABREAST)
        for (int k = from; k < from + ABREAST; ++k)
            parts.taps[k] = numbers<const int>(taps.lengths)[parts.step[k] < 0 ? 0 : parts.step[k]];
    for (int from = 0; from < parts.count; from += ABREAST)
        for (int k = from; k < from + ABREAST; ++k) {
            const bool tabulated = parts.step[k] >= 0;
            const float place = parts.place[k];
            const float half = tabulated ? 0.5f * (float)(parts.taps[k] - 1) : cut.deviations * parts.deviation[k];
            const float start = place - half, first = tabulated ? wp::rint(start) : -wp::floor(-start);
            const int fraction = wp::clamp((int)((start - first + 0.5f) * (float)fractions), 0, fractions - 1);
            const int end = tabulated ? (int)first + parts.taps[k] : (int)wp::floor(place + half) + 1;
            // If only every n-th ring (circle) of the table is added, the index of the first added ring is a multiple
            // of n, so that neighbouring pixels use the same rings.
            const int begin = (wp::max((int)first, 0) + parts.apart[k] - 1) & -parts.apart[k];
            parts.first_weight[k] = (parts.step[k] * fractions + fraction) * most_taps - (int)first;
            parts.begin[k] = wp::min(begin, all_rings - 1);
            parts.end[k] = begin < all_rings ? wp::clamp(end, parts.begin[k], all_rings) : parts.begin[k];
        }
}

// Position in a list of parts of footprints: the index of the next part, and of the next ring (circle of the table)
// within that part.
struct NextRing {
    int part, ring;
};

// Divide parts of footprints into segments, until all parts are divided or the batch of segments is full. A segment has
// consecutive rings of the colour table (circles of constant |(u, v)|) that one part of a footprint covers. All of them
// are in one octave (factor of 2) of |(u, v)|.
template <int N, class Table>
WARPDIFF_INLINE void next_segments(const Table& table, const Parts<N>& parts, NextRing& next, Segments<N>& segments)
{
    segments.count = 0;
    while (segments.count < N && next.part < parts.count) {
        const int s = segments.count++, k = next.part;
        const int octave = (int)((float)next.ring * table.octaves_per_ring), apart = parts.apart[k];
        const int end = wp::min(parts.end[k], (octave + 1) * table.rings_per_octave);
        segments.part[s] = k;
        segments.first[s] = next.ring;
        segments.apart[s] = apart;
        segments.rings[s] = wp::min((end - next.ring + apart - 1) / apart, SEGMENT_RINGS);
        next.ring += segments.rings[s] * apart;
        if (next.ring >= parts.end[k] && ++next.part < parts.count) next.ring = parts.begin[next.part];
    }
    for (int s = segments.count; s % ABREAST != 0; ++s) {
        segments.part[s] = segments.part[s - 1];
        segments.first[s] = segments.first[s - 1];
        segments.apart[s] = segments.apart[s - 1];
    }
}

// Select a mip level (a blurred copy of the table) for each segment. A segment is a group of rings of the table
// (circles of constant |(u, v)|) within one octave of |(u, v)|. For each segment, compute its azimuth (polar angle) in
// steps of the selected level, the blurs over the azimuth of the footprint and of the level, and the index in
// `table.rows` of its first row.
template <bool SOURCE, int N, class Table, class Taps>
WARPDIFF_INLINE void place_segments(const Table& table, const Taps& taps, const Parts<N>& parts, Segments<N>& segments)
{
    const int octaves = table.azimuths.shape[1], levels = table.azimuths.shape[0];
    const int* const azimuths = numbers<const int>(table.azimuths);
    const int* const first_rows = numbers<const int>(table.first_rows);
    const float* const blurs = numbers<const float>(table.blurs);
    for (int from = 0; from < segments.count; from += ABREAST)
        for (int s = from; s < from + ABREAST; ++s) {
            const int k = segments.part[s], octave = (int)((float)segments.first[s] * table.octaves_per_ring);
            // Select the most blurred mip level (copy of the table) whose blur does not exceed the blur of the
            // footprint; each level has twice the blur of the level before. The remaining blur is added by a weighted
            // sum over several azimuth samples.
            const float line2 = SOURCE ? numbers<const float>(table.line_blurs2)[octave] : 0.0f;
            const float blur2 = larger(parts.aside2[k] - line2, 0.0f);
            const float first_blur = blurs[octaves + octave], relative = blur2 / (first_blur * first_blur);
            const int level = wp::clamp(((bits_of(relative) >> 23) - 125) >> 1, 0, levels - 1);
            const int at = level * octaves + octave;
            const float blur = blurs[at], per_radian = (float)azimuths[at] * (0.5f / PI);
            const float steps_of_blur = per_radian * per_radian * taps.per_variance;
            segments.azimuths[s] = azimuths[at];
            segments.blur[s] = parts.aside2[k] * steps_of_blur;
            segments.level_blur[s] = (blur * blur + line2) * steps_of_blur - 0.5f;
            segments.turning[s] = parts.turn_per_ring[k] * table.rings_per_log * per_radian;
            segments.position[s] = parts.turns[k] * (float)azimuths[at];
            segments.away[s] = (float)segments.first[s] - parts.place[k];
            segments.behind[s] = parts.half_ratio2[k];
            segments.skew[s] = parts.skew[k];
            segments.per_deviation[s] = 1.0f / parts.deviation[k];
            segments.first_row[s] = first_rows[at] + segments.first[s] - octave * table.rings_per_octave;
        }
}

// Return the weight of the m-th ring of a segment (a group of rings of the colour table): the value of a skewed
// Gaussian around the centre of the part of the footprint, up to a constant factor.
template <int N>
WARPDIFF_INLINE float gaussian_weight(const Segments<N>& segments, CutGaussian cut, int s, int m)
{
    const float t = (segments.away[s] + (float)(m * segments.apart[s])) * segments.per_deviation[s], t2 = t * t;
    const float falloff = exp_of_sixteenfold((-0.5f * cut.per_variance / 16.0f) * t2);
    return falloff * larger(1.0f + segments.skew[s] * t * (t2 - 3.0f), 0.0f);
}

// Compute the azimuth (polar angle) of the footprint's centre at the m-th ring of a segment (a group of rings of the
// colour table). Compute also the blur that the mip level lacks, as an index of the table of weights. The width of a
// footprint in (u, v) is the same at all rings, so that its angular width is inversely proportional to the radius.
template <int N, class Table, class Taps>
WARPDIFF_INLINE void place_ring(
    const Table& table, const Taps& taps, const Segments<N>& segments, int s, int m, float& position, int& step)
{
    const float nearer = exp_of_minus_small(
        (segments.away[s] + (float)(m * segments.apart[s])) * (1.0f / table.rings_per_log) - segments.behind[s]);
    position = segments.position[s] + segments.turning[s] * (1.0f - nearer);
    step = (int)smaller(larger(segments.blur[s] * nearer * nearer - segments.level_blur[s], 0.0f),
        (float)((int)taps.weights.shape[0] - 1));
}

// Return the `count` table rows around an azimuth (polar angle) that are added for the m-th ring of a segment, a group
// of rings. Return also the index of the weights of these rows.
template <int N, class Table, class Taps>
WARPDIFF_INLINE RingRows rows_of_ring(const Table& table, const Taps& taps, const Segments<N>& segments, int s, int m,
    float position, int step, int count)
{
    const int fractions = taps.weights.shape[1], azimuths = segments.azimuths[s], least = -(count / 2);
    const float start = position - 0.5f * (float)(count - 1), first = wp::rint(start);
    const int fraction = (int)((start - first + 0.5f) * (float)fractions), azimuth = (int)first;
    const int rotated = azimuth < least ? azimuth + azimuths
        : azimuth >= azimuths + least   ? azimuth - azimuths
                                        : azimuth;
    return {
        segments.first_row[s] + wp::clamp(rotated, least, azimuths + least) * table.rings_per_octave
            + m * segments.apart[s],
        count,
        (step * fractions + wp::clamp(fraction, 0, fractions - 1)) * (int)taps.weights.shape[2],
    };
}

// Rows of the colour table, and their weights, for all rings of several segments. A segment is a group of consecutive
// rings (circles of constant |(u, v)|). On the CPU, rows and weights of a whole batch are stored before any row is
// added. A GPU computes the rows and weights of a ring when it adds the rows of this ring.
template <int N>
struct SegmentRings {
    static constexpr int RINGS = ON_GPU ? 1 : SEGMENT_RINGS;
    int row[N][RINGS], taps[N][RINGS], count[N][RINGS];
    float weight[N][RINGS];

    template <class Table, class Taps>
    WARPDIFF_INLINE void find(const Table& table, const Taps& taps, const Segments<N>& segments, CutGaussian cut)
    {
        if (ON_GPU) return;
        for (int s = 0; s < segments.count; ++s) {
            float position[RINGS];
            int step[RINGS];
            for (int m = 0; m < RINGS; ++m) {
                place_ring(table, taps, segments, s, m, position[m], step[m]);
                weight[s][m] = gaussian_weight(segments, cut, s, m);
            }
            for (int m = 0; m < RINGS; ++m) count[s][m] = numbers<const int>(taps.lengths)[step[m]];
            for (int m = 0; m < RINGS; ++m) {
                const RingRows rows = rows_of_ring(table, taps, segments, s, m, position[m], step[m], count[s][m]);
                row[s][m] = rows.row;
                taps_at(s, m) = rows.taps;
            }
        }
    }

    WARPDIFF_INLINE int& taps_at(int s, int m)
    {
        return taps[s][m];
    }

    template <class Table, class Taps>
    WARPDIFF_INLINE RingRows rows_at(
        const Table& table, const Taps& all_taps, const Segments<N>& segments, int s, int m)
    {
        if (!ON_GPU) return {row[s][m], count[s][m], taps[s][m]};
        float position;
        int step;
        place_ring(table, all_taps, segments, s, m, position, step);
        return rows_of_ring(
            table, all_taps, segments, s, m, position, step, numbers<const int>(all_taps.lengths)[step]);
    }

    WARPDIFF_INLINE float weight_at(const Segments<N>& segments, CutGaussian cut, int s, int m) const
    {
        return ON_GPU ? gaussian_weight(segments, cut, s, m) : weight[s][m];
    }
};

// Add the rows of the colour table that belong to segments (groups of rings). After the last segment of a part of a
// footprint, convert the sum to a colour and add this colour to the pixel.
template <int WIDTH, int N, class Table, class Taps>
WARPDIFF_INLINE void sum_segments(const Table& table, const Taps& taps, CutGaussian cut, const Footprints<N>& pixels,
    const Parts<N>& parts, const Segments<N>& segments, SegmentRings<N>& rings, WeighedRows<WIDTH>& sum, float* xyz)
{
    const float* const weights = numbers<const float>(taps.weights);
    for (int s = 0; s < segments.count; ++s) {
        const int k = segments.part[s];
        const bool tabulated = parts.step[k] >= 0;
        const float* const tabulated_weights = weights + (tabulated ? parts.first_weight[k] + segments.first[s] : 0);
        for (int m = 0; m < segments.rings[s]; ++m) {
            const RingRows rows = rings.rows_at(table, taps, segments, s, m);
            const float weight = tabulated ? tabulated_weights[m] : rings.weight_at(segments, cut, s, m);
            const float* row = numbers<const float>(table.rows) + (long long)rows.row * WIDTH;
            Row<WIDTH> ring_sum;
            ring_sum.clear();
#pragma clang loop unroll_count(4)
            for (int j = 0; j < rows.count; ++j) {
                ring_sum.add(weights[rows.taps + j], row);
                row += (long long)table.rings_per_octave * WIDTH;
            }
            sum.rows.add(weight, ring_sum);
            sum.weights += weight;
        }
        if (segments.first[s] + segments.rings[s] * segments.apart[s] < parts.end[k]) continue;
        const int i = parts.pixel[k];
        const float share = tabulated ? parts.share[k] : parts.share[k] / larger(sum.weights, 1.0e-6f);
        add_colour(table, sum.rows, pixels.at_w, i, share, xyz + 3 * pixels.ray[i]);
        sum.clear();
    }
}

// Add the XYZ of the scattering vectors from `begin` to `end`, at most BATCH, times geometry factors (gains). Each XYZ
// is a mean over the footprint, and with `SOURCE` also over the light source. A footprint is the range of (u, v) in a
// pixel.
//
// Directions that the table of a light source excludes are skipped. The gains of these directions are stored in
// `unserved_gain`, which is 0 for all other directions.
template <int W_BASIS_SIZE, bool SOURCE, int BATCH, int MOST_PARTS, class Table, class Taps, class ScatteringVectors,
    class Lights, class Gains, class FootprintArray, class Colours>
WARPDIFF_INLINE void look_up_footprints(const Table& table, const Taps& taps, CutGaussian cut,
    const ScatteringVectors& scattering_vectors, const Lights& to_lights, const Gains& gains,
    const FootprintArray& footprints, int begin, int end, Gains& unserved_gain, Colours& xyz_out)
{
    constexpr int N = batch_of(BATCH), WIDTH = 3 * W_BASIS_SIZE;
    const int count = end - begin;
    const float* const factors = numbers<const float>(gains) + begin;
    float* const xyz = numbers<float>(xyz_out) + 3LL * begin;
    Footprints<N> pixels;
    load_footprints<SOURCE>(pixels, numbers<const double>(scattering_vectors) + 3LL * begin,
        numbers<const float>(to_lights) + 3LL * begin,
        is_empty(footprints) ? nullptr : numbers<const float>(footprints) + 4LL * begin, factors, count);
    float* const unserved = SOURCE ? numbers<float>(unserved_gain) + begin : nullptr;
    for (int ray = 0; SOURCE && ray < count; ++ray) unserved[ray] = 0.0f;
    if (SOURCE && table.has_pitch_scales)
        find_covariances<SOURCE, SOURCE, MOST_PARTS>(table, pixels);
    else
        find_covariances<SOURCE, false, MOST_PARTS>(table, pixels);
    WeighedRows<WIDTH> sum;
    sum.clear();
    for (NextPart next_part = {0, 0};;) {
        Parts<N> parts;
        next_parts<SOURCE, MOST_PARTS, WIDTH>(
            table, numbers<const float>(taps.parts), factors, pixels, next_part, parts, unserved, xyz);
        if (parts.count == 0) break;
        place_parts(table, parts);
        choose_rings<SOURCE>(table, taps, cut, parts);
        for (NextRing next_ring = {0, parts.begin[0]}; next_ring.part < parts.count;) {
            Segments<N> segments;
            SegmentRings<N> rings;
            next_segments(table, parts, next_ring, segments);
            place_segments<SOURCE>(table, taps, parts, segments);
            rings.find(table, taps, segments, cut);
            sum_segments<WIDTH>(table, taps, cut, pixels, parts, segments, rings, sum, xyz);
        }
    }
}

} // namespace warpdiff
