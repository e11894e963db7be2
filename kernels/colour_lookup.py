"""Colours from a table: the integral over λ is done once, for every (u, v) and every function of w.

As λ goes from red to blue, (u, v)/λ runs along a ray of the frequency plane, over one octave. The power spectrum is
taken on rays, at nodes of equal ratios along them, each the integral of the spectrum under a quadratic B-spline in
ln t, t = |(u, v)|/λ. A colour is then a sum over an octave's nodes, with weights that are the projection of the colour
curves on the same splines, however many orders the ray passes. Where |(u, v)| takes the same ratios, these weights are
the same at every node, and w comes in through a few functions that all share: the sum is done beforehand, and what is
left of a colour is a spline between nodes and rays, and a scalar product with the functions at w.

A pixel sees a range of (u, v). Powers add, so that its mean is a spectrum blurred by the same angle and the same ratio
at all wavelengths: levels of the table are blurred in angle, with fewer rays, and in ratio look-ups take more nodes.
A source does the same to the lines of an endless surface.
"""

import functools
import math
import types

import warp as wp

from warpdiff.kernels import spectral_sum
from warpdiff.kernels.snippets import CHUNKS_OF_ROWS, CYCLIC, filled
from warpdiff.kernels.structs import Footprint

# Loops that stay loops compile faster.
OPTIONS = {**spectral_sum.OPTIONS, "max_unroll": 1}
# Half of the rays or nodes that a look-up takes at most by the tables of weights; as many rays are repeated on either
# side of a turn.
REACH = 7
# Directions that a thread looks up one after the other on the CPU, at most.
RUN = 256
# Of those, or of their segments, how many before its turn one's rows are asked for.
_AHEAD = 3
# Taps on either side of the filter that turns samples into spline coefficients: the factor −0.17 to the sixth is 3e-5.
FILTER_REACH = 6
# Parts of a footprint along its angle.
MOST_PARTS = 12
# Of a wide blur nodes count so many deviations out.
_DEVIATIONS = 3.0


@wp.struct
class Blending:
    """Weights of the rays, or nodes, around a place: the spline between them, blurred by a part of the footprint."""

    weights: wp.array3d(dtype=wp.float32)  # (variances, fractions, 2 REACH)
    lengths: wp.array(dtype=wp.int32)  # how many of them count, from the first one on
    per_variance: wp.float32  # entries per unit of the variance, in distances of rays squared
    parts: wp.array3d(dtype=wp.float32)  # for 1, 2, … of them: the variance within, then places and weights


# Sums of rows times the functions at w: the first of four entries, and the cubic through them.
_WEIGH = """
    auto find_w = [&](float w, int& entry, float& w0, float& w1, float& w2, float& w3) {
        const float steps = wp::max((w - table.least_w) * table.per_w, 0.0f);
        const int last = table.functions.shape[0] - 4, before = (int)steps - 1;
        entry = before < 0 ? 0 : before < last ? before : last;
        const float t = steps - (float)entry - 1.0f, prior = t + 1.0f, after = 1.0f - t, beyond = 2.0f - t;
        w0 = (-1.0f / 6.0f) * t * after * beyond;
        w1 = 0.5f * prior * after * beyond;
        w2 = 0.5f * prior * t * beyond;
        w3 = (-1.0f / 6.0f) * prior * t * after;
    };
    auto weigh = [&](const chunk* sum, int entry, float w0, float w1, float w2, float w3) {
        constexpr int EACH = CHUNKS / 3;
        const chunk* const entries = (const chunk*)table.functions.data + (long long)entry * EACH;
        chunk colour[3] = {chunk{}, chunk{}, chunk{}};
        for (int k = 0; k < EACH; ++k) {
            const chunk at_w = w0 * entries[k] + w1 * entries[k + EACH] + w2 * entries[k + 2 * EACH]
                + w3 * entries[k + 3 * EACH];
            for (int c = 0; c < 3; ++c) colour[c] += sum[c * EACH + k] * at_w;
        }
        wp::vec_t<3, float> result;
        for (int c = 0; c < 3; ++c) {
            result[c] = 0.0f;
            for (int l = 0; l < SIZE; ++l) result[c] += ((const float*)&colour[c])[l];
        }
        return result;
    };
"""

# The logarithm of |(u, v)| to the base of 2, at least that of ``least``, and the angle in turns from 0 to 1: faster
# than by the library's functions, and in loops for many abreast.
_PLACE_OF = """
    auto place_of = [](float u, float v, float least, float& log2, float& turns) {
        // The logarithm of a power of two times m, and of m between √½ and √2 by the series in (m − 1)/(m + 1).
        const float uv2 = u * u + v * v, least2 = least * least;
        const float square = uv2 > least2 ? uv2 : least2;
        int bits;
        memcpy(&bits, &square, sizeof(bits));
        const int above = bits - 0x3f3504f3;
        const int of_m = (above & 0x7fffff) + 0x3f3504f3;
        float m;
        memcpy(&m, &of_m, sizeof(m));
        const float s = (m - 1.0f) / (m + 1.0f), s2 = s * s;
        const float series_of_m = 1.0f + s2 * (1.0f / 3.0f + s2 * (0.2f + s2 * (1.0f / 7.0f)));
        log2 = 0.5f * (float)(above >> 23) + 1.442695041f * s * series_of_m;
        // The angle, by the series of the arc tangent within a sixteenth of a turn.
        const float x = u < 0.0f ? -u : u, y = v < 0.0f ? -v : v;
        const float more = x > y ? x : y, less = x > y ? y : x;
        const bool beyond = less > 0.41421356f * more;
        const float t = (beyond ? less - more : less) / ((beyond ? less + more : more) + 1.0e-30f), t2 = t * t;
        const float series_of_t = 1.0f + t2 * (-1.0f / 3.0f + t2 * (0.2f + t2 * (-1.0f / 7.0f + t2 * (1.0f / 9.0f
            + t2 * (-1.0f / 11.0f + t2 * (1.0f / 13.0f))))));
        float turn = 0.159154943f * t * series_of_t + (beyond ? 0.125f : 0.0f);
        turn = x > y ? turn : 0.25f - turn;
        turn = u < 0.0f ? 0.5f - turn : turn;
        turns = wp::min(v < 0.0f ? 1.0f - turn : turn, 1.0f);
    };
"""

# What the mean plane reflects, over a covariance of (u, v): a Gaussian at each wavelength. ``size2`` is the part of a
# source, the root of its covariance's determinant.
_MIRROR = """
    auto add_mirror = [&](float u, float v, float w, float xx, float xy, float yy, float size2, float gain,
                          float* out) {
        if (table.mirror.shape[0] == 0) return;
        const float* const wavenumbers = (const float*)table.wavenumbers.data;
        const float* const weights = (const float*)table.weights.data;
        const float* const powers = (const float*)table.mirror.data;
        const float least = wavenumbers[0];
        // Not so far out at any wavelength that exp(-24) = 4e-11 is left.
        if (u * u + v * v >= 48.0f * (table.lobe2 / (least * least) + xx + yy)) return;
        for (int k = 0; k < table.wavenumbers.shape[0]; ++k) {
            const float tau = wavenumbers[k], lobe2 = table.lobe2 / (tau * tau), a = lobe2 + xx, d = lobe2 + yy;
            const float determinant = a * d - xy * xy;
            const float exponent = (d * u * u - 2.0f * xy * u * v + a * v * v) / determinant;
            if (!(determinant > 0.0f && exponent < 48.0f)) continue;
            const float steps = wp::max((w * tau - table.least_kappa) * table.per_kappa, 0.0f);
            const int entry = wp::clamp((int)steps, 0, table.mirror.shape[0] - 2);
            const float t = steps - (float)entry, power = (1.0f - t) * powers[entry] + t * powers[entry + 1];
            const float factor = gain * power * (lobe2 + size2) / wp::sqrt(determinant) * wp::exp(-0.5f * exponent);
            for (int c = 0; c < 3; ++c) out[c] += factor * weights[3 * k + c];
        }
    };
"""

# Look-ups of points: where they lie, which the compiler finds for many abreast, and then the sums, while what the next
# ones read is asked for: of too many, rows that lie a page apart drive each other out of the first cache. A GPU has
# other threads to run while one waits.
_POINTS = """
#if defined(__CUDA_ARCH__)
    constexpr int MOST = 1;
#else
    constexpr int MOST = RUN;
#endif
    const int size = table.nodes, octaves = table.rays.shape[1], count = end - begin;
    const double* const given = (const double*)deflections.data + 3LL * begin;
    const float* const factors = (const float*)gains.data + begin;
    const int* const all_rays = (const int*)table.rays.data;
    const int* const firsts = (const int*)table.firsts.data;
    float u[MOST] = {}, v[MOST] = {}, w[MOST] = {}, turns[MOST], places[MOST];
    for (int i = 0; i < count; ++i) {
        u[i] = (float)given[3 * i];
        v[i] = (float)given[3 * i + 1];
        w[i] = (float)-given[3 * i + 2];
    }
    const float least = table.least_uv, nodes = (float)size, last = (float)(octaves * size - 2);
    for (int i = 0; i < MOST; ++i) {
        float log2;
        place_of(u[i], v[i], least, log2, turns[i]);
        places[i] = wp::min(log2 * nodes + table.node_of_one, last);
    }
    int entries[MOST];
    float w0[MOST], w1[MOST], w2[MOST], w3[MOST];
    for (int i = 0; i < MOST; ++i) find_w(w[i], entries[i], w0[i], w1[i], w2[i], w3[i]);
    auto locate = [&](int i, int node, int octave, float& away) {
        const float position = turns[i] * (float)all_rays[octave], nearest = wp::rint(position);
        away = position - nearest;
        const long long row = firsts[octave] + ((int)nearest - 1 - octave) * size + node;
        return (const float*)table.rows.data + row * WIDTH;
    };
    auto spline = [](float away, float* weights) {
        weights[0] = 0.5f * (0.5f - away) * (0.5f - away);
        weights[1] = 0.75f - away * away;
        weights[2] = 0.5f * (0.5f + away) * (0.5f + away);
    };
    const long long stride = (long long)size * WIDTH;
    const float* from[MOST];
    float aside[MOST];
    int nodes_of[MOST], octaves_of[MOST];
    auto ask = [&](int i) {
        nodes_of[i] = (int)wp::rint(places[i]) - 1;
        octaves_of[i] = (int)((float)nodes_of[i] * table.per_octave);
        from[i] = locate(i, nodes_of[i], octaves_of[i], aside[i]);
#if !defined(__CUDA_ARCH__)
        if (factors[i] > 0.0f)
            for (int j = 0; j < 3; ++j) {
                const float* const row = from[i] + j * stride;
                for (int l = 0; l < 3 * WIDTH; l += 16) __builtin_prefetch(row + l);
                __builtin_prefetch(row + 3 * WIDTH - 1);
            }
#endif
    };
    for (int i = 0; i < count && i < AHEAD; ++i) ask(i);
    for (int i = 0; i < count; ++i) {
        if (i + AHEAD < count) ask(i + AHEAD);
        if (!(factors[i] > 0.0f)) continue;
        float of_nodes[3], of_rays[3];
        spline(places[i] - (float)(nodes_of[i] + 1), of_nodes);
        chunk sum[CHUNKS];
        for (int l = 0; l < CHUNKS; ++l) sum[l] = chunk{};
        const int left = (octaves_of[i] + 1) * size - nodes_of[i];
        const float* first = from[i];
        float away = aside[i];
        spline(away, of_rays);
#pragma unroll
        for (int m = 0; m < 3; ++m) {
            if (m == left) {
                // The next octave has rays of its own.
                first = locate(i, nodes_of[i], octaves_of[i] + 1, away);
                spline(away, of_rays);
            }
            const float* row = first + m * WIDTH;
#pragma unroll
            for (int j = 0; j < 3; ++j) {
                const float factor = of_nodes[m] * of_rays[j];
#pragma unroll
                for (int l = 0; l < CHUNKS; ++l) sum[l] += factor * ((const chunk*)row)[l];
                row += stride;
            }
        }
        const auto colour = weigh(sum, entries[i], w0[i], w1[i], w2[i], w3[i]);
        float* const out = (float*)xyz_out.data + 3LL * (begin + i);
        // Projected colour curves have shallow negative lobes.
        for (int c = 0; c < 3; ++c) out[c] += factors[i] * wp::max(colour[c], 0.0f);
        add_mirror(u[i], v[i], w[i], 0.0f, 0.0f, 0.0f, 0.0f, factors[i], out);
    }
"""

# Look-ups of means, step after step for a run of them: each is of one part, mostly, a part of segments that lie in one
# octave, mostly one, and a segment of nodes, which sum rays around them. What a step finds is kept in arrays for the
# next one, so that the compiler makes vectors of it and no pixel waits for another's branches. A GPU takes one pixel,
# part and segment at a time.
_MEANS = """
#if defined(__CUDA_ARCH__)
    // Nodes of a segment: any number, as they are not kept.
    constexpr int MOST = 1, SEGMENTS = 1, AT_ONCE = 1 << 20, ABREAST = 1;
#else
    // Loops are of so many ABREAST, whole ones, as compilers round otherwise in what is left over by vectors.
    constexpr int MOST = RUN, SEGMENTS = RUN, AT_ONCE = 4, ABREAST = 8;
#endif
    constexpr float PI = 3.14159265f;
    // A footprint is split where its direction turns by so much: its parts are straight. Beyond the widest it surrounds
    // the mirror direction and is no range of angles.
    constexpr float MOST_TURN = 0.1f, WIDEST_ANGLE = 0.5f, WIDEST_RATIO = 0.35f;
    // Beyond a variance of NARROW nodes have the Gaussian itself for weights, out to so many DEVIATIONS, and lie as far
    // apart as what they sum is smooth: the blur, the narrowest of the curves of colours (its deviation in ln λ) and
    // what else is in them, and rays where these turn from node to node.
    constexpr float NARROW = 1.5f, MOST_APART = 1.5f, CURVES = 0.047f;
    const float per_log = table.per_log, per_node = 1.0f / per_log;
    const float per_curves2 = 1.0f / (CURVES * CURVES * per_log * per_log);
    const int size = table.nodes, octaves = table.rays.shape[1], levels = table.rays.shape[0], count = end - begin;
    const int entries = blending.weights.shape[0], fractions = blending.weights.shape[1];
    const int all_taps = blending.weights.shape[2];
    const long long stride = (long long)size * WIDTH;
    const float* const all_rows = (const float*)table.rows.data;
    const double* const given = (const double*)deflections.data + 3LL * begin;
    const float* const lights = (const float*)to_lights.data + 3LL * begin;
    const float* const factors = (const float*)gains.data + begin;
    const float* const seen = (const float*)footprints.data + 4LL * begin;
    const float* const taps = (const float*)blending.weights.data;
    const float* const splits = (const float*)blending.parts.data;
    const int* const lengths = (const int*)blending.lengths.data;
    const int* const all_rays = (const int*)table.rays.data;
    const int* const firsts = (const int*)table.firsts.data;
    const float* const widths = (const float*)table.widths.data;
    const float* const blurs2 = (const float*)table.blurs2.data;
    float* const out = (float*)xyz_out.data + 3LL * begin;
    const bool with_footprints = footprints.shape[0] > 0;
    auto larger = [](float a, float b) { return a > b ? a : b; };
    auto smaller = [](float a, float b) { return a < b ? a : b; };
    // exp(−t), for |t| up to 1 or little more.
    auto falling = [](float t) {
        return 1.0f - t * (1.0f - t * (0.5f - t * (1.0f / 6.0f - t * (1.0f / 24.0f))));
    };

    // What of a covariance of (u, v) goes across it and along it, relative to |(u, v)|; within the narrowest lobe, to
    // its size.
    auto relate = [&](float u, float v, float xx, float xy, float yy, float& x, float& y, float& angle_u,
                      float& angle_v, float& angle2, float& ratio2, float& both) {
        const float uv2 = larger(u * u + v * v + table.spread * table.spread, table.least_uv * table.least_uv);
        x = u / uv2;
        y = v / uv2;
        angle_u = x * xy - y * xx;
        angle_v = x * yy - y * xy;
        angle2 = larger(x * angle_v - y * angle_u, 0.0f);
        ratio2 = larger(x * x * xx + 2.0f * x * y * xy + y * y * yy, 0.0f);
        both = x * angle_u + y * angle_v;
    };
    // Of each pixel.
    float u[MOST], v[MOST], w[MOST], xx[MOST], xy[MOST], yy[MOST], size2[MOST], angle2[MOST], both[MOST];
    float ratio2[MOST], along_u[MOST], along_v[MOST], parts[MOST], w0[MOST], w1[MOST], w2[MOST], w3[MOST];
    float light_x[MOST], light_y[MOST], light_z[MOST], along_x[MOST], along_y[MOST], across_x[MOST], across_y[MOST];
    int entries_at_w[MOST];
    for (int i = 0; i < count; ++i) {
        u[i] = (float)given[3 * i];
        v[i] = (float)given[3 * i + 1];
        w[i] = (float)-given[3 * i + 2];
        light_x[i] = SOURCE ? lights[3 * i] : 0.0f;
        light_y[i] = SOURCE ? lights[3 * i + 1] : 0.0f;
        light_z[i] = SOURCE ? lights[3 * i + 2] : 0.0f;
        along_x[i] = with_footprints ? seen[4 * i] : 0.0f;
        along_y[i] = with_footprints ? seen[4 * i + 1] : 0.0f;
        across_x[i] = with_footprints ? seen[4 * i + 2] : 0.0f;
        across_y[i] = with_footprints ? seen[4 * i + 3] : 0.0f;
    }
    for (int i = wp::max(count, 0); i % ABREAST != 0; ++i)
        u[i] = v[i] = w[i] = light_x[i] = light_y[i] = light_z[i] = along_x[i] = along_y[i] = across_x[i]
            = across_y[i] = 0.0f;
    for (int from = 0; from < count; from += ABREAST) for (int i = from; i < from + ABREAST; ++i) {
        // A source's is Σs = s² (I − t tᵀ), t the part of the direction to the light that lies in the surface.
        const float source2 = SOURCE ? table.spread2 : 0.0f, t0 = light_x[i], t1 = light_y[i];
        size2[i] = source2 * light_z[i];
        xx[i] = source2 * (1.0f - t0 * t0) + (along_x[i] * along_x[i] + across_x[i] * across_x[i]);
        xy[i] = -source2 * t0 * t1 + (along_x[i] * along_y[i] + across_x[i] * across_y[i]);
        yy[i] = source2 * (1.0f - t1 * t1) + (along_y[i] * along_y[i] + across_y[i] * across_y[i]);
        find_w(w[i], entries_at_w[i], w0[i], w1[i], w2[i], w3[i]);
        float x, y, angle_u, angle_v;
        relate(u[i], v[i], xx[i], xy[i], yy[i], x, y, angle_u, angle_v, angle2[i], ratio2[i], both[i]);
        // Parts lie along what goes with the angle.
        const float whole = wp::sqrt(angle2[i]), per_whole = whole > 0.0f ? 1.0f / whole : 0.0f;
        along_u[i] = angle_u * per_whole;
        along_v[i] = angle_v * per_whole;
        const float turns = whole * (1.0f / MOST_TURN);
        parts[i] = turns > 1.0f ? smaller(-wp::floor(-turns), (float)PARTS) : 1.0f;
    }

    chunk sum[CHUNKS];
    for (int l = 0; l < CHUNKS; ++l) sum[l] = chunk{};
    float whole = 0.0f;
    int pixel = 0, part = 0;
    for (;;) {
        // The next parts: where they lie, and their variances in angle and in ln |(u, v)|, and their covariance.
        int pixels[MOST], filled = 0;
        int begins[MOST], ends[MOST], ratios[MOST], steps[MOST], aparts[MOST], counted[MOST];
        float shares[MOST], turns[MOST], places[MOST], deviations[MOST], skews[MOST], turn_of[MOST], aside2[MOST];
        float at_u[MOST], at_v[MOST], of_angle2[MOST], of_ratio2[MOST], of_both[MOST], spacings[MOST];
        float half_ratio2[MOST];
        while (filled < MOST && pixel < count) {
            const int i = pixel, all = (int)parts[i];
            const float gain = factors[i];
            bool served = gain > 0.0f;
            const float* const split = splits + (all - 1) * 3 * PARTS;
            const float within = split[0];
            const float cut = 1.0f - within, away = split[PARTS + part];
            float share = gain * split[2 * PARTS + part];
            if (SOURCE) {
                // What the source blurs less than the rows are, or so much that it is no range of angles. Nodes are
                // further apart than what goes with the ratio spreads.
                float log2, unused;
                place_of(u[i], v[i], table.least_uv, log2, unused);
                const float over2 = ratio2[i] - (all > 1 ? cut * both[i] * both[i] / angle2[i] : 0.0f)
                    + 0.25f / (per_log * per_log);
                const int octave = wp::clamp((int)((log2 * (float)size + table.node_of_one) * table.per_octave), 0,
                    octaves - 1);
                const bool left = u[i] * u[i] + v[i] * v[i] < table.near2
                    || (within * angle2[i] - blurs2[octave]) * over2 < within * within * both[i] * both[i];
                ((float*)left_out.data)[begin + i] = served && left ? gain : 0.0f;
                served = served && !left;
                share *= 2.0f * PI * size2[i];
            }
            if (!served) {
                ++pixel;
                continue;
            }
            if (part == 0)
                add_mirror(u[i], v[i], w[i], xx[i], xy[i], yy[i], size2[i], gain, out + 3 * i);
            at_u[filled] = u[i] + away * along_u[i];
            at_v[filled] = v[i] + away * along_v[i];
            of_angle2[filled] = angle2[i];
            of_ratio2[filled] = ratio2[i];
            of_both[filled] = both[i];
            if (all > 1) {
                // Of what is left of the covariance, along the part's own (u, v) and across.
                const float part_xx = xx[i] - cut * along_u[i] * along_u[i];
                const float part_xy = xy[i] - cut * along_u[i] * along_v[i];
                const float part_yy = yy[i] - cut * along_v[i] * along_v[i];
                float x, y, angle_u, angle_v;
                relate(at_u[filled], at_v[filled], part_xx, part_xy, part_yy, x, y, angle_u, angle_v,
                    of_angle2[filled], of_ratio2[filled], of_both[filled]);
            }
            shares[filled] = share;
            pixels[filled++] = i;
            if (++part == all) {
                part = 0;
                ++pixel;
            }
        }
        if (filled == 0) break;
        for (int k = filled; k % ABREAST != 0; ++k) {
            at_u[k] = at_u[k - 1];
            at_v[k] = at_v[k - 1];
            of_angle2[k] = of_angle2[k - 1];
            of_ratio2[k] = of_ratio2[k - 1];
            of_both[k] = of_both[k - 1];
        }
        for (int from = 0; from < filled; from += ABREAST) for (int k = from; k < from + ABREAST; ++k) {
            const float turn_share = smaller(WIDEST_ANGLE / wp::sqrt(larger(of_angle2[k], 1.0e-12f)), 1.0f);
            const float ratio_share = smaller(WIDEST_RATIO / wp::sqrt(larger(of_ratio2[k], 1.0e-12f)), 1.0f);
            const float a2 = of_angle2[k] * turn_share * turn_share, r2 = of_ratio2[k] * ratio_share * ratio_share;
            const float b = of_both[k] * turn_share * ratio_share;
            // The mean of ln |(u, v)| to second order: what lies aside is further away.
            float log2;
            place_of(at_u[k], at_v[k], table.least_uv, log2, turns[k]);
            log2 += 0.721347520f * (a2 - r2);
            places[k] = log2 * (float)size + table.node_of_one;
            // What goes with the ratio turns the rays from node to node; the rest of the angle blurs each of them. The
            // spline between nodes has a variance of a quarter.
            const float variance = r2 * per_log * per_log + 0.25f, deviation = wp::sqrt(variance);
            turn_of[k] = b * per_log / variance;
            half_ratio2[k] = 0.5f * r2;
            aside2[k] = larger(a2 - turn_of[k] * b * per_log, 0.0f);
            deviations[k] = deviation;
            // A sixth of the third moment of ln |(u, v)| in deviations, of what goes along it: the lower half reaches
            // further. What an angle that goes with it adds is not that of rays that lie on a line.
            skews[k] = -0.5f * r2 * r2 * per_log * per_log * per_log / (variance * deviation);
        }
        // Apart from the rest, as the compiler makes no vectors of loops that read from any place and write to several.
        for (int from = 0; from < filled; from += ABREAST) for (int k = from; k < from + ABREAST; ++k)
            spacings[k] = widths[octaves + wp::clamp((int)(places[k] * table.per_octave), 0, octaves - 1)];
        for (int from = 0; from < filled; from += ABREAST) for (int k = from; k < from + ABREAST; ++k) {
            // A source's lines are narrower than the rays are apart, and what blurs them has that in it.
            const float across2 = aside2[k] + (SOURCE ? 1.0e-12f : spacings[k] * spacings[k]);
            const float variance = deviations[k] * deviations[k];
            const float sharp = wp::sqrt(per_curves2 + turn_of[k] * turn_of[k] / across2 + 1.0f / variance);
            const float most = MOST_APART / (sharp + table.wiggles);
            aparts[k] = most < 2.0f ? 1 : most < 4.0f ? 2 : most < 8.0f ? 4 : 8;
            steps[k] = variance < NARROW + 0.25f ? (int)((variance - 0.25f) * blending.per_variance + 0.5f) : -1;
        }
        for (int from = 0; from < filled; from += ABREAST) for (int k = from; k < from + ABREAST; ++k)
            counted[k] = lengths[steps[k] < 0 ? 0 : steps[k]];
        for (int from = 0; from < filled; from += ABREAST) for (int k = from; k < from + ABREAST; ++k) {
            const bool narrow = steps[k] >= 0;
            const float half = narrow ? 0.5f * (float)(counted[k] - 1) : DEVIATIONS * deviations[k];
            const float start = places[k] - half, first = narrow ? wp::rint(start) : -wp::floor(-start);
            const int fraction = wp::clamp((int)((start - first + 0.5f) * (float)fractions), 0, fractions - 1);
            const int end_of = narrow ? (int)first + counted[k] : (int)wp::floor(places[k] + half) + 1;
            // Whole multiples, so that pixels beside each other take the same nodes.
            const int begin_of = (wp::max((int)first, 0) + aparts[k] - 1) & -aparts[k], all = octaves * size;
            ratios[k] = (steps[k] * fractions + fraction) * all_taps - (int)first;
            begins[k] = wp::min(begin_of, all - 1);
            ends[k] = begin_of < all ? wp::clamp(end_of, begins[k], all) : begins[k];
        }
        for (int k = 0, node = begins[0]; k < filled;) {
            // Segments: nodes of a part that lie in one octave.
            int part_of[SEGMENTS], firsts_of[SEGMENTS], apart_of[SEGMENTS], counts[SEGMENTS], segments = 0;
            while (segments < SEGMENTS && k < filled) {
                const int octave = (int)((float)node * table.per_octave);
                const int apart = aparts[k], end = wp::min(ends[k], (octave + 1) * size);
                part_of[segments] = k;
                firsts_of[segments] = node;
                apart_of[segments] = apart;
                counts[segments] = wp::min((end - node + apart - 1) / apart, AT_ONCE);
                node += counts[segments++] * apart;
                if (node >= ends[k] && ++k < filled) node = begins[k];
            }
            for (int s = segments; s % ABREAST != 0; ++s) {
                part_of[s] = part_of[s - 1];
                firsts_of[s] = firsts_of[s - 1];
                apart_of[s] = apart_of[s - 1];
            }
            // Which ray the middle of the part lies on, and by how many rays it turns, times 1 − 1/ρ, for a node that
            // lies ρ times as far out; how far the first node lies from the mean of ln |(u, v)| [nodes], and that from
            // the middle; the blur at the middle and what the level has of it, in steps of the taps' variances.
            float positions[SEGMENTS], turnings[SEGMENTS], aways[SEGMENTS], behind[SEGMENTS], blurs_of[SEGMENTS];
            float given_of[SEGMENTS], skew_of[SEGMENTS], per_deviation[SEGMENTS];
            int rays_of[SEGMENTS], row_of[SEGMENTS];
            for (int from = 0; from < segments; from += ABREAST) for (int s = from; s < from + ABREAST; ++s) {
                const int of = part_of[s], octave = (int)((float)firsts_of[s] * table.per_octave);
                // The level that is blurred by as much or less, each twice as much as the one before, and what is left.
                const float own2 = SOURCE ? blurs2[octave] : 0.0f, blur2 = larger(aside2[of] - own2, 0.0f);
                const float width_of_first = widths[octaves + octave];
                const float relative = blur2 / (width_of_first * width_of_first);
                int bits;
                memcpy(&bits, &relative, sizeof(bits));
                const int level = wp::clamp(((bits >> 23) - 125) >> 1, 0, levels - 1), at = level * octaves + octave;
                const float width = widths[at], per_radian = (float)all_rays[at] * (0.5f / PI);
                const float steps_of_blur = per_radian * per_radian * blending.per_variance;
                rays_of[s] = all_rays[at];
                blurs_of[s] = aside2[of] * steps_of_blur;
                given_of[s] = (width * width + own2) * steps_of_blur - 0.5f;
                turnings[s] = turn_of[of] * per_log * per_radian;
                positions[s] = turns[of] * (float)all_rays[at];
                aways[s] = (float)firsts_of[s] - places[of];
                behind[s] = half_ratio2[of];
                skew_of[s] = skews[of];
                per_deviation[s] = 1.0f / deviations[of];
                row_of[s] = firsts[at] + firsts_of[s] - octave * size;
            }
            // A Gaussian up to a factor, as the 16th power of a series up to the fourth.
            auto weight_at = [&](int s, int m) {
                const float t = (aways[s] + (float)(m * apart_of[s])) * per_deviation[s], t2 = t * t;
                const float x = (-0.5f * PER_VARIANCE / 16.0f) * t2;
                float falloff = 1.0f + x * (1.0f + x * (0.5f + x * (1.0f / 6.0f + x * (1.0f / 24.0f))));
                falloff *= falloff;
                falloff *= falloff;
                falloff *= falloff;
                falloff *= falloff;
                return falloff * larger(1.0f + skew_of[s] * t * (t2 - 3.0f), 0.0f);
            };
            // Rays around the direction that goes with this node, and what is left of their blur: across (u, v) a
            // straight footprint is as wide at all nodes, and its middle lies aside in proportion to how far out they
            // are, which further out is less of an angle.
            auto place_at = [&](int s, int m, float& position, int& step) {
                const float nearer = falling((aways[s] + (float)(m * apart_of[s])) * per_node - behind[s]);
                position = positions[s] + turnings[s] * (1.0f - nearer);
                step = (int)smaller(larger(blurs_of[s] * nearer * nearer - given_of[s], 0.0f), (float)(entries - 1));
            };
            auto node_at = [&](int s, int m, float position, int step, int taken, int& row, int& tap) {
                const int rays = rays_of[s], least = -(taken / 2);
                const float start = position - 0.5f * (float)(taken - 1), first = wp::rint(start);
                const int fraction = (int)((start - first + 0.5f) * (float)fractions), ray = (int)first;
                const int turned = ray < least ? ray + rays : ray >= rays + least ? ray - rays : ray;
                row = row_of[s] + wp::clamp(turned, least, rays + least) * size + m * apart_of[s];
                tap = (step * fractions + wp::clamp(fraction, 0, fractions - 1)) * all_taps;
            };
#if !defined(__CUDA_ARCH__)
            int rows[SEGMENTS][AT_ONCE], taps_of[SEGMENTS][AT_ONCE], taken_of[SEGMENTS][AT_ONCE];
            float weights[SEGMENTS][AT_ONCE];
            for (int s = 0; s < segments; ++s) {
                float position[AT_ONCE];
                int step[AT_ONCE];
                for (int m = 0; m < AT_ONCE; ++m) {
                    place_at(s, m, position[m], step[m]);
                    weights[s][m] = weight_at(s, m);
                }
                for (int m = 0; m < AT_ONCE; ++m) taken_of[s][m] = lengths[step[m]];
                for (int m = 0; m < AT_ONCE; ++m)
                    node_at(s, m, position[m], step[m], taken_of[s][m], rows[s][m], taps_of[s][m]);
            }
            // Most rows are those of the part before; at either end new ones come in.
            auto ask = [&](int s) {
                for (int m = 0; m < counts[s]; ++m) {
                    const long long across = (taken_of[s][m] - 1) * stride;
                    const float* const row = all_rows + (long long)rows[s][m] * WIDTH;
                    for (int l = 0; l < WIDTH; l += WIDTH - 1) {
                        __builtin_prefetch(row + l);
                        __builtin_prefetch(row + across + l);
                    }
                    __builtin_prefetch(row + stride);
                    __builtin_prefetch(row + across - stride);
                }
            };
            for (int s = 0; s < segments && s < AHEAD; ++s) ask(s);
#endif
            for (int s = 0; s < segments; ++s) {
#if !defined(__CUDA_ARCH__)
                if (s + AHEAD < segments) ask(s + AHEAD);
#endif
                const int of = part_of[s];
                const bool wide = steps[of] < 0;
                const float* const narrow = taps + (wide ? 0 : ratios[of] + firsts_of[s]);
                for (int m = 0; m < counts[s]; ++m) {
#if defined(__CUDA_ARCH__)
                    float position;
                    int step, row_at, tap_at;
                    place_at(s, m, position, step);
                    const int taken = lengths[step];
                    node_at(s, m, position, step, taken, row_at, tap_at);
                    const float weight = wide ? weight_at(s, m) : narrow[m];
#else
                    const int row_at = rows[s][m], tap_at = taps_of[s][m], taken = taken_of[s][m];
                    const float weight = (wide ? weights[s] : narrow)[m];
#endif
                    const float* row = all_rows + (long long)row_at * WIDTH;
                    chunk of_rays[CHUNKS];
                    for (int l = 0; l < CHUNKS; ++l) of_rays[l] = chunk{};
#pragma clang loop unroll_count(4)
                    for (int j = 0; j < taken; ++j) {
#pragma unroll
                        for (int l = 0; l < CHUNKS; ++l) of_rays[l] += taps[tap_at + j] * ((const chunk*)row)[l];
                        row += stride;
                    }
                    for (int l = 0; l < CHUNKS; ++l) sum[l] += weight * of_rays[l];
                    whole += weight;
                }
                if (firsts_of[s] + counts[s] * apart_of[s] < ends[of]) continue;
                const int i = pixels[of];
                const auto colour = weigh(sum, entries_at_w[i], w0[i], w1[i], w2[i], w3[i]);
                // Projected colour curves have shallow negative lobes.
                const float share = wide ? shares[of] / larger(whole, 1.0e-6f) : shares[of];
                for (int c = 0; c < 3; ++c) out[3 * i + c] += share * larger(colour[c], 0.0f);
                for (int l = 0; l < CHUNKS; ++l) sum[l] = chunk{};
                whole = 0.0f;
            }
        }
    }
"""
# All that means take.
MEANS = _WEIGH + _PLACE_OF + _MIRROR + _MEANS


# Coefficients of the quadratic spline around a turn, for a ray: sums over as many on either side as count.
_COEFFICIENTS = """
    constexpr float POLE = -0.171572875f;
    const int size = table.nodes, count = rays[level * octaves + octave];
    const chunk* from[2 * REACH + 1];
    float factors[REACH + 1];
    factors[0] = 1.41421356f;
#pragma unroll
    for (int j = 0; j < REACH; ++j) factors[j + 1] = POLE * factors[j];
#pragma unroll
    for (int j = -REACH; j <= REACH; ++j)
        from[REACH + j] = (const chunk*)values.data + (long long)cyclic(ray + j, count) * size * CHUNKS;
    chunk* const out = (chunk*)rows_out.data + ((long long)firsts[level * octaves + octave] + ray * size) * CHUNKS;
    for (int l = 0; l < size * CHUNKS; ++l) {
        chunk sum = factors[0] * from[REACH][l];
#pragma unroll
        for (int j = 1; j <= REACH; ++j) sum += factors[j] * (from[REACH - j][l] + from[REACH + j][l]);
        out[l] = sum;
    }
"""

# Values on a ray of a level: a Gaussian around it of another's coefficients, whose spline itself has a variance of a
# quarter of the distance of rays, squared.
_BLUR = """
#if defined(__CUDA_ARCH__)
    constexpr int MOST = 1;
#else
    constexpr int MOST = 32;
#endif
    const int size = table.nodes, count = rays[source * octaves + octave];
    const float* const widths = (const float*)table.widths.data;
    const float spacing = 6.28318531f / (float)count;
    const float width = widths[level * octaves + octave], given = widths[source * octaves + octave];
    const float variance = (width * width - given * given) / (spacing * spacing) + 0.25f;
    const int reach = wp::min(-(int)wp::floor(-4.5f * wp::sqrt(variance)), count / 2);
    const float place = (float)ray / (float)rays[level * octaves + octave] * (float)count;
    const int nearest = (int)wp::rint(place);
    auto weight_of = [&](int away) {
        const float distance = (float)(nearest + away) - place;
        return wp::exp(-0.5f * distance * distance / variance);
    };
    float total = 0.0f;
#pragma clang loop vectorize(disable) unroll(disable)
    for (int away = -reach; away <= reach; ++away) total += weight_of(away);
    const chunk* const rows = (const chunk*)table.rows.data + (long long)firsts[source * octaves + octave] * CHUNKS;
    chunk* const out = (chunk*)values_out.data + (long long)ray * size * CHUNKS;
    for (int begin = -reach; begin <= reach; begin += MOST) {
        const int taps = wp::min(MOST, reach + 1 - begin);
        const chunk* from[MOST];
        float weights[MOST];
#pragma clang loop vectorize(disable) unroll(disable)
        for (int j = 0; j < taps; ++j) {
            from[j] = rows + (long long)cyclic(nearest + begin + j, count) * size * CHUNKS;
            weights[j] = weight_of(begin + j) / total;
        }
        for (int l = 0; l < size * CHUNKS; l += CHUNKS) {
            chunk sum[CHUNKS];
            for (int c = 0; c < CHUNKS; ++c) sum[c] = begin > -reach ? out[l + c] : chunk{};
            for (int j = 0; j < taps; ++j)
                for (int c = 0; c < CHUNKS; ++c) sum[c] += weights[j] * from[j][l + c];
            for (int c = 0; c < CHUNKS; ++c) out[l + c] = sum[c];
        }
    }
"""

# Numbers of rays, and where they begin.
_RAYS = """
    const int octaves = table.rays.shape[1];
    const int* const rays = (const int*)table.rays.data;
    const int* const firsts = (const int*)table.firsts.data;
"""


def _variance_before(deviations: float) -> float:
    """Variance of a normal distribution that has one of 1 once it is cut so far out."""
    variance = 1.0
    for _ in range(20):
        end = deviations / math.sqrt(variance)
        within = math.erf(end / math.sqrt(2.0))
        variance = 1.0 / (1.0 - math.sqrt(2.0 / math.pi) * end * math.exp(-0.5 * end * end) / within)
    return variance


def native_code(code: str, *, functions: int, source: bool = False, reach: int = REACH) -> str:
    """Code for a table with so many functions of w."""
    return filled(
        CHUNKS_OF_ROWS + code, WIDTH=3 * functions, SOURCE=int(source), RUN=RUN, AHEAD=_AHEAD, REACH=reach,
        PARTS=MOST_PARTS, DEVIATIONS=f"{_DEVIATIONS}f",
        PER_VARIANCE=f"{1.0 / _variance_before(_DEVIATIONS):.8f}f",
    )  # fmt: skip


@functools.cache
def lookup(functions: int, source: bool = False) -> types.SimpleNamespace:
    """The struct of a table of colours with so many functions of w, and the kernels that do not depend on its making.

    Args:
        functions: Their number.
        source: Whether rows are lines under a source; otherwise a spectrum under a window.

    Returns:
        A namespace with the type ``row``, the struct ``Colours`` and the kernels ``interpolate``, ``blur`` and
        ``integrate``.
    """
    width = 3 * functions
    row_t = wp.types.vector(length=width, dtype=wp.float32)
    functions_t = wp.types.vector(length=functions, dtype=wp.float32)

    @wp.struct
    class Colours:
        rows: wp.array(dtype=row_t)  # X, Y and Z: level after level, octave after octave, ray after ray, node by node
        functions: wp.array(dtype=functions_t)  # at equal steps in |w|
        least_w: wp.float32  # |w| of the first of them
        per_w: wp.float32  # entries per unit of |w|
        firsts: wp.array2d(dtype=wp.int32)  # (levels, octaves), the row of ray 0
        rays: wp.array2d(dtype=wp.int32)  # (levels, octaves), their number
        widths: wp.array2d(dtype=wp.float32)  # (levels, octaves), what they are blurred by [rad]
        nodes: wp.int32  # nodes an octave
        per_log: wp.float32  # nodes per unit of ln |(u, v)|
        per_octave: wp.float32  # octaves a node
        wiggles: wp.float32  # what of colours is sharper than the curves, from node to node; see ``colour_table``
        node_of_one: wp.float32  # the node where |(u, v)| is 1
        least_uv: wp.float32  # below this |(u, v)| the spectrum is flat
        spread: wp.float32  # of a single coefficient's lobe in |(u, v)|, at a middle wavelength
        mirror: wp.array(dtype=wp.float32)  # the power of the mean plane's coefficient, which rows leave out, by |κ|
        least_kappa: wp.float32  # |κ| of the first of them
        per_kappa: wp.float32  # entries per unit of |κ|
        lobe2: wp.float32  # variance of its lobe in frequency; 0 for a source
        wavenumbers: wp.array(dtype=wp.float32)  # for its integral over λ
        weights: wp.array(dtype=wp.vec3f)
        blurs2: wp.array(dtype=wp.float32)  # of a source's lines, by octave: variance of their own blur [rad²]
        spread2: wp.float32  # of a source: the variance s² of (u, v) across its direction
        near2: wp.float32  # of a source: below this |(u, v)|² directions are left out

    native = functools.partial(native_code, functions=functions, source=source)

    @wp.func_native(native(CYCLIC + _RAYS + _COEFFICIENTS, reach=FILTER_REACH))
    def put_coefficients(
        values: wp.array(dtype=row_t),
        table: Colours,
        level: wp.int32,
        octave: wp.int32,
        ray: wp.int32,
        rows_out: wp.array(dtype=row_t),
    ):
        """Coefficients of the spline on one ray."""

    @wp.func_native(native(CYCLIC + _RAYS + _BLUR))
    def put_blurred(
        table: Colours,
        source: wp.int32,
        level: wp.int32,
        octave: wp.int32,
        ray: wp.int32,
        values_out: wp.array(dtype=row_t),
    ):
        """Blurred values on one ray."""

    # Compiled once, by a second index: see ``directions``.
    @wp.kernel(module="unique", module_options=OPTIONS)
    def interpolate(
        # In:
        values: wp.array(dtype=row_t),
        table: Colours,
        level: wp.int32,
        octave: wp.int32,
        first: wp.int32,
        run: wp.int32,
        # Out:
        rows_out: wp.array(dtype=row_t),
    ):
        """Coefficients of the quadratic spline that passes through an octave's values, and those beyond a turn."""
        thread, _ = wp.tid()
        for k in range(run):
            put_coefficients(values, table, level, octave, first + thread * run + k - wp.static(REACH), rows_out)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def blur(
        # In:
        table: Colours,
        source: wp.int32,
        level: wp.int32,
        octave: wp.int32,
        first: wp.int32,
        run: wp.int32,
        # Out:
        values_out: wp.array(dtype=row_t),
    ):
        """Values on the rays of a level: those of another, blurred by what it lacks."""
        thread, _ = wp.tid()
        for k in range(run):
            put_blurred(table, source, level, octave, first + thread * run + k, values_out)

    @wp.func_native(native(_WEIGH + _PLACE_OF + _MIRROR + _POINTS))
    def add_points(
        table: Colours,
        deflections: wp.array(dtype=wp.vec3d),
        gains: wp.array(dtype=wp.float32),
        begin: wp.int32,
        end: wp.int32,
        xyz_out: wp.array(dtype=wp.vec3f),
    ):
        """Add the XYZ of a run of deflections times their gains."""

    @wp.func_native(native(MEANS))
    def add_means(
        table: Colours,
        deflections: wp.array(dtype=wp.vec3d),
        to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32),
        footprints: wp.array(dtype=Footprint),
        blending: Blending,
        begin: wp.int32,
        end: wp.int32,
        left_out: wp.array(dtype=wp.float32),
        xyz_out: wp.array(dtype=wp.vec3f),
    ):
        """Add the mean XYZ over footprints and the source of a run of deflections times their gains."""

    @wp.kernel(module="unique", module_options=OPTIONS)
    def integrate(
        # In:
        table: Colours,
        deflections: wp.array(dtype=wp.vec3d),
        to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32),
        footprints: wp.array(dtype=Footprint),
        blending: Blending,
        run: wp.int32,
        first: wp.int32,
        # Out:
        left_out: wp.array(dtype=wp.float32),
        xyz_out: wp.array(dtype=wp.vec3f),
    ):
        """Add the XYZ of ``run`` directions a thread to ``xyz_out``; an empty array of footprints is none.

        Of a source, directions that the table does not serve are skipped, and ``left_out`` holds their gains, others'
        are 0.
        """
        begin = (first + wp.tid()) * run
        end = wp.min(begin + run, gains.shape[0])
        if wp.static(source):
            add_means(table, deflections, to_lights, gains, footprints, blending, begin, end, left_out, xyz_out)
        elif footprints.shape[0] > 0:
            add_means(table, deflections, to_lights, gains, footprints, blending, begin, end, left_out, xyz_out)
        else:
            add_points(table, deflections, gains, begin, end, xyz_out)

    return types.SimpleNamespace(
        row=row_t, functions=functions_t, Colours=Colours, interpolate=interpolate, blur=blur, integrate=integrate
    )
