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

from warpdiff.kernels import spectral

# Loops that stay loops compile faster.
OPTIONS = {**spectral.OPTIONS, "max_unroll": 1}
# Rays or nodes on either side of one that a look-up takes from the tables of weights; as many rays are repeated beyond
# a turn.
REACH = 6
# Directions that a thread looks up one after the other on the CPU, at most.
RUN = 32
# Of those, how many before its turn one's rows are asked for.
_AHEAD = 3
# Taps on either side of the filter that turns samples into spline coefficients: the factor −0.17 to the sixth is 3e-5.
FILTER_REACH = 6
# A footprint is split where its direction turns by so much: its parts are straight.
_MOST_TURN = wp.constant(wp.float32(0.06))
# Parts of a footprint along its angle.
MOST_PARTS = 12
# In variances of the mirror's lobe: exp(−24) is 4e-11.
_FAR_IN_LOBES = wp.constant(wp.float32(48.0))
# Beyond these a footprint surrounds the mirror direction and is no range of angles.
_WIDEST_ANGLE, _WIDEST_RATIO = wp.constant(wp.float32(0.5)), wp.constant(wp.float32(0.35))


@wp.struct
class Blending:
    """Weights of the rays, or nodes, around a place: the spline between them, blurred by a part of the footprint."""

    weights: wp.array3d(dtype=wp.float32)  # (variances, fractions, 2 REACH + 1)
    reaches: wp.array(dtype=wp.int32)  # rays on either side that count
    per_variance: wp.float32  # entries per unit of the variance, in distances of rays squared
    parts: wp.array3d(dtype=wp.float32)  # for 1, 2, … of them: the variance within, then places and weights


# Sums of rows are written as sums of the compiler's own vectors, as it makes none of plain loops over registers.
CHUNKS_OF_ROWS = """
#if defined(__CUDA_ARCH__)
    typedef float chunk;
    constexpr int SIZE = 1;
#else
    constexpr int SIZE = WIDTH % 8 == 0 ? 8 : 4;
    typedef float chunk __attribute__((vector_size(SIZE * sizeof(float)), aligned(sizeof(float))));
#endif
    constexpr int CHUNKS = WIDTH / SIZE;
"""

# Sums of rows times the functions at w: cubics through four entries.
_WEIGH = """
    auto weigh = [](const chunk* sum, const chunk* functions, int entry, float t) {
        constexpr int EACH = CHUNKS / 3;
        const chunk* entries = functions + (long long)entry * EACH;
        const float before = t + 1.0f, after = 1.0f - t, beyond = 2.0f - t;
        const float w0 = -t * after * beyond / 6.0f, w1 = 0.5f * before * after * beyond;
        const float w2 = 0.5f * before * t * beyond, w3 = -before * t * after / 6.0f;
        chunk colour[3] = {chunk{}, chunk{}, chunk{}};
        for (int k = 0; k < EACH; ++k) {
            const chunk at_w = w0 * entries[k] + w1 * entries[k + EACH] + w2 * entries[k + 2 * EACH]
                + w3 * entries[k + 3 * EACH];
            for (int c = 0; c < 3; ++c) colour[c] += sum[c * EACH + k] * at_w;
        }
        wp::vec_t<3, float> result;
        for (int c = 0; c < 3; ++c) {
            float total = 0.0f;
            for (int l = 0; l < SIZE; ++l) total += ((const float*)&colour[c])[l];
            result[c] = total;
        }
        return result;
    };
"""

# One octave's share of a colour.
_RUN_SUM = """
    const float* const table = (const float*)rows.data + (long long)offset * WIDTH;
    const float* const taps = (const float*)weights.data;
    const int across = 2 * around + 1, all = weights.shape[2], fractions = weights.shape[1];
    chunk sum[CHUNKS];
    for (int l = 0; l < CHUNKS; ++l) sum[l] = chunk{};
    const float* tap = taps;
    const float* row = table;
    for (int m = 0; m < count; ++m) {
        const float distance = away + (float)m;
        if (m == 0 || slope != 0.0f) {
            // Rays around the direction that goes with this node.
            const float position = place + slope * distance;
            const float nearest = wp::rint(position);
            int fraction = (int)((position - nearest + 0.5f) * (float)fractions);
            fraction = wp::clamp(fraction, 0, fractions - 1);
            int ray = (int)nearest;
            ray = wp::clamp(ray < 0 ? ray + rays : ray >= rays ? ray - rays : ray, 0, rays);
            tap = taps + (step * fractions + fraction) * all + all / 2 - around;
            row = table + (long long)(ray - around) * stride * WIDTH;
        }
        const float weight = falloff > 0.0f ? scale * wp::exp(-falloff * distance * distance) : taps[ratio + m];
        const float* from = row + m * WIDTH;
        for (int j = 0; j < across; ++j) {
            const float factor = weight * tap[j];
#pragma unroll
            for (int l = 0; l < CHUNKS; ++l) sum[l] += factor * ((const chunk*)from)[l];
            from += (long long)stride * WIDTH;
        }
    }
    return weigh(sum, (const chunk*)functions.data, entry, t);
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

_POLAR = """
    wp::vec_t<2, float> result;
    place_of(u, v, least, result[0], result[1]);
    return result;
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
    float u[MOST] = {}, v[MOST] = {}, turns[MOST], places[MOST];
    for (int i = 0; i < count; ++i) {
        u[i] = (float)given[3 * i];
        v[i] = (float)given[3 * i + 1];
    }
    const float least = table.least_uv, nodes = (float)size, last = (float)(octaves * size - 2);
    for (int i = 0; i < MOST; ++i) {
        float log2;
        place_of(u[i], v[i], least, log2, turns[i]);
        places[i] = wp::min(log2 * nodes + table.node_of_one, last);
    }
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
        const float steps = wp::max(((float)-given[3 * i + 2] - table.least_w) * table.per_w, 0.0f);
        const int entry = wp::clamp((int)steps - 1, 0, table.functions.shape[0] - 4);
        const auto colour = weigh(sum, (const chunk*)table.functions.data, entry, steps - (float)entry - 1.0f);
        float* const out = (float*)xyz_out.data + 3LL * (begin + i);
        // Projected colour curves have shallow negative lobes.
        for (int c = 0; c < 3; ++c) out[c] += factors[i] * wp::max(colour[c], 0.0f);
    }
"""


@wp.func
def cyclic(index: wp.int32, count: wp.int32) -> wp.int32:
    """An index modulo the number of rays."""
    result = index % count
    if result < 0:
        result = result + count
    return result


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

    def native(code: str) -> str:
        return (CHUNKS_OF_ROWS + _WEIGH + code).replace("WIDTH", str(width))

    @wp.kernel(module="unique", module_options=OPTIONS)
    def interpolate(
        # In:
        values: wp.array(dtype=row_t),
        table: Colours,
        level: wp.int32,
        octave: wp.int32,
        first: wp.int32,
        # Out:
        rows_out: wp.array(dtype=row_t),
    ):
        """Coefficients of the quadratic spline that passes through an octave's values, and those beyond a turn."""
        ray = first + wp.tid() - wp.static(REACH)
        count = table.rays[level, octave]
        begin = table.firsts[level, octave] + ray * table.nodes
        for k in range(table.nodes):
            rows_out[begin + k] = row_t()
        for away in range(-wp.static(FILTER_REACH), wp.static(FILTER_REACH + 1)):
            factor = wp.static(2.0**0.5) * wp.pow(wp.static(2.0 * 2.0**0.5 - 3.0), wp.float32(wp.abs(away)))
            row = cyclic(ray + away, count) * table.nodes
            for k in range(table.nodes):
                rows_out[begin + k] += factor * values[row + k]

    @wp.kernel(module="unique", module_options=OPTIONS)
    def blur(
        # In:
        table: Colours,
        source: wp.int32,
        level: wp.int32,
        octave: wp.int32,
        first: wp.int32,
        # Out:
        values_out: wp.array(dtype=row_t),
    ):
        """Values on the rays of a level: those of another, blurred by what it lacks."""
        ray = first + wp.tid()
        count = table.rays[source, octave]
        start = table.firsts[source, octave]
        spacing = wp.float32(2.0 * wp.PI) / wp.float32(count)
        # The variance of the spline itself is a quarter of the distance of rays, squared.
        width_of = table.widths[level, octave]
        given = table.widths[source, octave]
        variance = (width_of * width_of - given * given) / (spacing * spacing) + 0.25
        reach = wp.min(wp.int32(wp.ceil(4.5 * wp.sqrt(variance))), count // 2)
        place = wp.float32(ray) / wp.float32(table.rays[level, octave]) * wp.float32(count)
        nearest = wp.int32(wp.rint(place))
        total_weight = wp.float32(0.0)
        for k in range(table.nodes):
            values_out[ray * table.nodes + k] = row_t()
        for away in range(-reach, reach + 1):
            distance = wp.float32(nearest + away) - place
            weight = wp.exp(-0.5 * distance * distance / variance)
            total_weight += weight
            row = start + cyclic(nearest + away, count) * table.nodes
            for k in range(table.nodes):
                values_out[ray * table.nodes + k] += weight * table.rows[row + k]
        for k in range(table.nodes):
            values_out[ray * table.nodes + k] = (1.0 / total_weight) * values_out[ray * table.nodes + k]

    @wp.func_native(native(_PLACE_OF + _POINTS).replace("RUN", str(RUN)).replace("AHEAD", str(_AHEAD)))
    def add_points(
        table: Colours,
        deflections: wp.array(dtype=wp.vec3d),
        gains: wp.array(dtype=wp.float32),
        begin: wp.int32,
        end: wp.int32,
        xyz_out: wp.array(dtype=wp.vec3f),
    ):
        """Add the XYZ of a run of deflections times their gains."""

    @wp.func_native(native(_RUN_SUM))
    def run_sum(
        rows: wp.array(dtype=row_t),
        weights: wp.array3d(dtype=wp.float32),
        offset: wp.int32,
        stride: wp.int32,
        count: wp.int32,
        rays: wp.int32,
        place: wp.float32,
        slope: wp.float32,
        step: wp.int32,
        around: wp.int32,
        ratio: wp.int32,
        scale: wp.float32,
        falloff: wp.float32,
        away: wp.float32,
        functions: wp.array(dtype=functions_t),
        entry: wp.int32,
        t: wp.float32,
    ) -> wp.vec3f:
        """Rows of one octave times the weights of their rays and nodes, and times the functions at w.

        Args:
            rows: Those of the table.
            weights: Those of ``Blending``.
            offset: The row of ray 0 at the first node.
            stride: Rows from one ray to the next.
            count: Nodes.
            rays: Of the octave and level.
            place: The direction in rays, where the distance to a node is 0.
            slope: Rays that it shifts by from one node to the next, and by less than a turn at the last.
            step: The entry of ``weights`` for the variance across rays.
            around: Rays on either side that count.
            ratio: Where ``weights`` hold the first node's weight, if ``falloff`` is 0.
            scale: Else the weight at distance 0.
            falloff: And its Gaussian's exponent over the squared distance.
            away: The first node's distance.
            functions: At equal steps in |w|.
            entry: The first of the four of them around w.
            t: How far w is behind the second.
        """

    @wp.func_native(_PLACE_OF + _POLAR)
    def polar(u: wp.float32, v: wp.float32, least: wp.float32) -> wp.vec2f:
        """The logarithm of |(u, v)| to the base of 2, and the angle in turns."""

    @wp.func
    def colour_at(
        table: Colours,
        blending: Blending,
        w: wp.float32,
        at: wp.vec2f,
        angle2: wp.float32,
        ratio2: wp.float32,
        both: wp.float32,
    ) -> wp.vec3f:
        """XYZ of a deflection that spreads by variances in angle and in ln |(u, v)|, and by their covariance."""
        # The means of ln |(u, v)| and of the angle, to second order: what lies aside is further away.
        log_uv = at[0] + wp.static(0.5 / math.log(2.0)) * (angle2 - ratio2)
        turns = at[1] - both * wp.float32(0.5 / wp.PI)
        entries = blending.weights.shape[0]
        fractions = blending.weights.shape[1]
        all_taps = blending.weights.shape[2]

        # Nodes around the place, by a table of weights or, of a wide blur, by the Gaussian itself.
        place = log_uv * wp.float32(table.nodes) + table.node_of_one
        nearest = wp.int32(wp.rint(place))
        variance = ratio2 * table.per_log * table.per_log
        step = wp.int32(variance * blending.per_variance + 0.5)
        reach = wp.int32(0)
        ratio = wp.int32(0)
        falloff = wp.float32(0.0)
        scale = wp.float32(1.0)
        if step < entries:
            reach = blending.reaches[step]
            f = wp.int32((place - wp.float32(nearest) + 0.5) * wp.float32(fractions))
            f = wp.clamp(f, 0, fractions - 1)
            ratio = (step * fractions + f) * all_taps + wp.static(REACH) - reach
        else:
            variance = variance + 0.25
            reach = wp.int32(wp.ceil(3.2 * wp.sqrt(variance)))
            falloff = 0.5 / variance
            scale = wp.sqrt(falloff / wp.PI)
        # What goes with the ratio shifts the rays from node to node; the rest of the angle blurs each of them. The
        # spline between nodes has a variance of a quarter.
        turn = both * table.per_log / (ratio2 * table.per_log * table.per_log + 0.25)
        aside2 = wp.max(angle2 - turn * both * table.per_log, 0.0)
        octaves = table.rays.shape[1]
        node = wp.max(nearest - reach, 0)
        end = wp.min(nearest + reach + 1, octaves * table.nodes)
        ratio = ratio + node - (nearest - reach)

        steps = wp.max((w - table.least_w) * table.per_w, 0.0)
        entry = wp.clamp(wp.int32(steps) - 1, 0, table.functions.shape[0] - 4)
        between = steps - wp.float32(entry) - 1.0

        colour = wp.vec3f()
        while node < end:
            octave = wp.int32(wp.float32(node) * table.per_octave)
            # The level that is blurred by as much or less, and what is left of it.
            level = wp.int32(0)
            blur2 = aside2
            if wp.static(source):
                blur2 = wp.max(aside2 - table.blurs2[octave], 0.0)
            if blur2 > 0.0:
                relative = blur2 / (table.widths[1, octave] * table.widths[1, octave])
                while relative >= 1.0 and level + 1 < table.rays.shape[0]:
                    level = level + 1
                    relative = 0.25 * relative
            rays = table.rays[level, octave]
            spacing = wp.float32(2.0 * wp.PI) / wp.float32(rays)
            left = wp.max(blur2 - table.widths[level, octave] * table.widths[level, octave], 0.0)
            step = wp.int32(left / (spacing * spacing) * blending.per_variance + 0.5)
            step = wp.min(step, entries - 1)
            offset = node - octave * table.nodes
            count = wp.min(end - node, table.nodes - offset)
            colour += run_sum(
                table.rows,
                blending.weights,
                table.firsts[level, octave] + offset,
                table.nodes,
                count,
                rays,
                turns * wp.float32(rays),
                turn / spacing,
                step,
                blending.reaches[step],
                ratio,
                scale,
                falloff,
                wp.float32(node) - place,
                table.functions,
                entry,
                between,
            )
            node = node + count
            ratio = ratio + count
        # Projected colour curves have shallow negative lobes.
        return wp.max(colour, wp.vec3f())

    @wp.func
    def sees_mirror(table: Colours, u: wp.float32, v: wp.float32, spread2: wp.float32) -> bool:
        """Whether ``mirror_at`` is not 0: to hand the struct on takes longer than this."""
        if table.mirror.shape[0] == 0:
            return False
        tau = table.wavenumbers[0]
        return u * u + v * v < _FAR_IN_LOBES * (table.lobe2 / (tau * tau) + spread2)

    @wp.func
    def mirror_at(
        table: Colours,
        u: wp.float32,
        v: wp.float32,
        w: wp.float32,
        xx: wp.float32,
        xy: wp.float32,
        yy: wp.float32,
        size2: wp.float32,
    ) -> wp.vec3f:
        """XYZ of what the mean plane reflects, over a covariance of (u, v): a Gaussian at each wavelength.

        ``size2`` is the part of a source, the root of its covariance's determinant.
        """
        colour = wp.vec3f()
        for k in range(table.wavenumbers.shape[0]):
            tau = table.wavenumbers[k]
            lobe2 = table.lobe2 / (tau * tau)
            a = lobe2 + xx
            d = lobe2 + yy
            determinant = a * d - xy * xy
            exponent = (d * u * u - 2.0 * xy * u * v + a * v * v) / determinant
            if exponent < _FAR_IN_LOBES:
                steps = wp.max((w * tau - table.least_kappa) * table.per_kappa, 0.0)
                entry = wp.min(wp.int32(steps), table.mirror.shape[0] - 2)
                t = steps - wp.float32(entry)
                power = (1.0 - t) * table.mirror[entry] + t * table.mirror[entry + 1]
                colour += (power * (lobe2 + size2) / wp.sqrt(determinant) * wp.exp(-0.5 * exponent)) * table.weights[k]
        return colour

    @wp.func
    def add_mirror(
        table: Colours,
        deflections: wp.array(dtype=wp.vec3d),
        gains: wp.array(dtype=wp.float32),
        begin: wp.int32,
        end: wp.int32,
        xyz_out: wp.array(dtype=wp.vec3f),
    ):
        """Add what the mean plane reflects of a run of deflections times their gains."""
        for i in range(begin, end):
            if gains[i] > 0.0:
                u = wp.float32(deflections[i][0])
                v = wp.float32(deflections[i][1])
                if sees_mirror(table, u, v, 0.0):
                    w = wp.float32(-deflections[i][2])
                    xyz_out[i] = xyz_out[i] + gains[i] * mirror_at(table, u, v, w, 0.0, 0.0, 0.0, 0.0)

    @wp.func
    def add_means(
        table: Colours,
        deflections: wp.array(dtype=wp.vec3d),
        to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32),
        footprints: wp.array(dtype=wp.vec4f),
        blending: Blending,
        begin: wp.int32,
        end: wp.int32,
        left_out: wp.array(dtype=wp.float32),
        xyz_out: wp.array(dtype=wp.vec3f),
    ):
        """Add the mean XYZ over footprints and the source of a run of deflections times their gains."""
        for i in range(begin, end):
            gain = gains[i]
            if wp.static(source):
                left_out[i] = wp.float32(0.0)
            if gain > 0.0:
                deflection = deflections[i]
                u = wp.float32(deflection[0])
                v = wp.float32(deflection[1])
                w = wp.float32(-deflection[2])
                colour = wp.vec3f()
                count = wp.int32(1)
                along = wp.vec2f()
                xx = wp.float32(0.0)
                xy = wp.float32(0.0)
                yy = wp.float32(0.0)
                size2 = wp.float32(0.0)
                if wp.static(source):
                    # Σs = s² (I − t tᵀ), t the part of the direction to the light that lies in the surface.
                    t = to_lights[i]
                    size2 = table.spread2 * t[2]
                    xx = table.spread2 * (1.0 - t[0] * t[0])
                    xy = -table.spread2 * t[0] * t[1]
                    yy = table.spread2 * (1.0 - t[1] * t[1])
                if footprints.shape[0] > 0:
                    f = footprints[i]
                    xx += f[0] * f[0] + f[2] * f[2]
                    xy += f[0] * f[1] + f[2] * f[3]
                    yy += f[1] * f[1] + f[3] * f[3]
                # Covariance along (u, v) and across, relative to |(u, v)|, within the narrowest lobe to its size.
                uv2 = wp.max(u * u + v * v + table.spread * table.spread, table.least_uv * table.least_uv)
                x = u / uv2
                y = v / uv2
                with_angle = wp.vec2f(x * xy - y * xx, x * yy - y * xy)
                angle2 = wp.max(x * with_angle[1] - y * with_angle[0], 0.0)
                both = x * with_angle[0] + y * with_angle[1]
                ratio2 = wp.max(x * x * xx + 2.0 * x * y * xy + y * y * yy, 0.0)
                if angle2 > 0.0:
                    count = wp.clamp(wp.int32(wp.ceil(wp.sqrt(angle2) / _MOST_TURN)), 1, wp.static(MOST_PARTS))
                    # Parts lie along what goes with the angle.
                    along = with_angle / wp.sqrt(angle2)
                    within = blending.parts[count - 1, 0, 0]
                    ratio2 = ratio2 - (1.0 - within) * both * both / angle2
                    angle2 = within * angle2
                    both = within * both
                if wp.static(source):
                    # What the source blurs less than the rows are, or so much that it is no range of angles. Nodes are
                    # further apart than what goes with the ratio spreads.
                    over2 = ratio2 + 0.25 / (table.per_log * table.per_log)
                    node = polar(u, v, table.least_uv)[0] * wp.float32(table.nodes) + table.node_of_one
                    octave = wp.clamp(wp.int32(node * table.per_octave), 0, table.blurs2.shape[0] - 1)
                    if u * u + v * v < table.near2 or (angle2 - table.blurs2[octave]) * over2 < both * both:
                        left_out[i] = gain
                        count = 0
                for k in range(count):
                    away = blending.parts[count - 1, 1, k]
                    at_u = u + away * along[0]
                    at_v = v + away * along[1]
                    part_angle2 = angle2
                    part_ratio2 = ratio2
                    part_both = both
                    if count > 1:
                        # Relative to the part's own |(u, v)|.
                        change = uv2 / (at_u * at_u + at_v * at_v + table.spread * table.spread)
                        part_angle2 = angle2 * change
                        part_ratio2 = ratio2 * change
                        part_both = both * change
                    turn_share = wp.min(_WIDEST_ANGLE / wp.sqrt(wp.max(part_angle2, 1.0e-12)), 1.0)
                    ratio_share = wp.min(_WIDEST_RATIO / wp.sqrt(wp.max(part_ratio2, 1.0e-12)), 1.0)
                    part_angle2 = part_angle2 * turn_share * turn_share
                    part_ratio2 = part_ratio2 * ratio_share * ratio_share
                    part_both = part_both * turn_share * ratio_share
                    place = polar(at_u, at_v, table.least_uv)
                    part = colour_at(table, blending, w, place, part_angle2, part_ratio2, part_both)
                    colour += blending.parts[count - 1, 2, k] * part
                if wp.static(source):
                    colour = (wp.float32(2.0 * wp.PI) * size2) * colour
                if count > 0:
                    if sees_mirror(table, u, v, xx + yy):
                        colour += mirror_at(table, u, v, w, xx, xy, yy, size2)
                    xyz_out[i] = xyz_out[i] + gain * colour

    @wp.kernel(module="unique", module_options=OPTIONS)
    def integrate(
        # In:
        table: Colours,
        deflections: wp.array(dtype=wp.vec3d),
        to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32),
        footprints: wp.array(dtype=wp.vec4f),
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
            if table.mirror.shape[0] > 0:
                add_mirror(table, deflections, gains, begin, end, xyz_out)

    return types.SimpleNamespace(
        row=row_t, functions=functions_t, Colours=Colours, interpolate=interpolate, blur=blur, integrate=integrate
    )
