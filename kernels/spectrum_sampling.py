"""The power spectrum on rays, and its integral over λ for every (u, v) and every function of w.

Rays are sampled at nodes of equal ratios, each the integral of the spectrum under a quadratic B-spline in ln t,
t = |(u, v)|/λ. A colour is a sum over an octave's nodes, whose weights are the same wherever |(u, v)| takes the same
ratios: ``colour_lookup`` has the rest.
"""

import functools
import math
import types
from typing import Any

import warp as wp

from warpdiff.kernels import spectral_sum
from warpdiff.kernels.colour_lookup import FILTER_REACH, OPTIONS, lookup
from warpdiff.kernels.snippets import CHUNKS_OF_ROWS, CYCLIC, filled

# Samples of a spectrum on a ray, one after the other: Gaussian factors of the columns and of the rows around one, some
# abreast, then a sum of rows times theirs, each times its own. The same neighbours of the nearest one are summed around
# all places that are nearest to it, so that no branch depends on the place. What a sample adds to the splines of three
# nodes stays in registers from node to node.
_SAMPLES = """
    constexpr int ABREAST = 16, ROWS = 64, ROW = CHUNKS * PARTS, OUT = NODES / SIZE;
    const chunk* const all_rows = (const chunk*)table.rows.data;
    const int count_y = table.count_y, count_x = table.count_x;
    const int left_y = left_out < 0 ? -1 : left_out / count_x, left_x = left_out - left_y * count_x;
    const float across = table.across, along = table.along;
    // As far as from somewhere nearest to the middle a neighbour counts, and on each row.
    const int reach_y = (int)(wp::sqrt(table.exponent / across) + 0.5f);
    const int reach_x = (int)(wp::sqrt(table.exponent / along) + 0.5f);
    int reaches[ROWS];
    for (int j = 0; j < ROWS; ++j) {
        const float away = wp::max((float)j - 0.5f, 0.0f);
        reaches[j] = (int)(wp::sqrt(wp::max(table.exponent - across * away * away, 0.0f) / along) + 0.5f);
    }
    auto exponential = [](float x) {
        // 2 to the power of a whole number and of what is left of it, between -1/2 and 1/2: to 8e-8.
        const float y = wp::max(1.442695041f * x, -126.0f);
        const int whole = (int)(y - 0.5f), bits = (whole + 127) << 23;
        const float f = y - (float)whole;
        float power;
        memcpy(&power, &bits, sizeof(bits));
        return power * (1.00000007f + f * (0.693146967f + f * (0.240221197f + f * (0.0555071328f
            + f * (0.00967554132f + f * 0.00132764707f)))));
    };
    auto sample = [&](double t, chunk* total) {
        // Places reach hundreds of coefficients.
        const double qy = t * sine, qx = t * cosine;
        const int nearest_y = (int)(qy + (qy < 0.0 ? -0.5 : 0.5)), nearest_x = (int)(qx + (qx < 0.0 ? -0.5 : 0.5));
        const float fy = (float)(qy - (double)nearest_y), fx = (float)(qx - (double)nearest_x);
        for (int c = 0; c < ROW; ++c) total[c] = chunk{};
        for (int from_x = -reach_x; from_x <= reach_x; from_x += ABREAST) {
            float of_columns[ABREAST];
            for (int i = 0; i < ABREAST; ++i) {
                const float away = (float)(from_x + i) - fx;
                of_columns[i] = exponential(-along * away * away);
            }
            const int column = nearest_x + table.origin_x + from_x;
            const bool inside = column >= 0 && column + ABREAST <= count_x;
            for (int from_y = -reach_y; from_y <= reach_y; from_y += ABREAST) {
                float of_rows[ABREAST];
                for (int j = 0; j < ABREAST; ++j) {
                    const float away = (float)(from_y + j) - fy;
                    of_rows[j] = exponential(-across * away * away);
                }
                for (int j = 0; j < ABREAST && from_y + j <= reach_y; ++j) {
                    const int aside = from_y + j < 0 ? -from_y - j : from_y + j;
                    const int reach = aside < ROWS ? reaches[aside] : reach_x;
                    const int begin = wp::max(-reach - from_x, 0), end = wp::min(reach - from_x + 1, ABREAST);
                    int y = nearest_y + table.origin_y + from_y + j;
                    if (y < 0 || y >= count_y) y = cyclic(y, count_y);
                    chunk sum[ROW];
                    for (int c = 0; c < ROW; ++c) sum[c] = chunk{};
                    const chunk* const row = all_rows + (long long)y * count_x * ROW;
                    if (inside && y != left_y) {
                        const chunk* const from = row + (long long)column * ROW;
                        for (int i = begin; i < end; ++i)
                            for (int c = 0; c < ROW; ++c) sum[c] += of_columns[i] * from[i * ROW + c];
                    } else {
                        for (int i = begin; i < end; ++i) {
                            const int x = inside ? column + i : cyclic(column + i, count_x);
                            if (y == left_y && x == left_x) continue;
                            for (int c = 0; c < ROW; ++c) sum[c] += of_columns[i] * row[(long long)x * ROW + c];
                        }
                    }
                    for (int c = 0; c < ROW; ++c) total[c] += of_rows[j] * sum[c];
                }
            }
        }
    };
    chunk* const out = (chunk*)values_out.data + (long long)begin * OUT;
    for (int l = 0; l < nodes * OUT; ++l) out[l] = chunk{};
    // Of the node before, the one whose interval it is, and the one behind.
    chunk nodes_of[3][OUT];
    for (int l = 0; l < OUT; ++l) nodes_of[0][l] = nodes_of[1][l] = nodes_of[2][l] = chunk{};
    auto put = [&](int node, const chunk* sum) {
        if (node < 0 || node >= nodes) return;
        for (int l = 0; l < OUT; ++l) out[(long long)node * OUT + l] = sum[l];
    };
    int node = -1;
    double t = first_t;
    for (; node <= nodes && t <= highest; ++node) {
        for (int k = 0; k < divisions && t <= highest; ++k, t *= ratio) {
            chunk total[ROW];
            sample(t, total);
            chunk value[OUT];
            if (PARTS == 1) {
                for (int l = 0; l < OUT; ++l) value[l] = total[l];
            } else {
                chunk re[OUT], im[OUT];
                for (int l = 0; l < OUT; ++l) re[l] = im[l] = chunk{};
                const chunk* basis = (const chunk*)bases.data;
                for (int n = 0; n < LANES; ++n, basis += OUT) {
                    const float of_re = ((const float*)total)[n], of_im = ((const float*)total)[LANES + n];
                    for (int l = 0; l < OUT; ++l) re[l] += of_re * basis[l];
                    for (int l = 0; l < OUT; ++l) im[l] += of_im * basis[l];
                }
                for (int l = 0; l < OUT; ++l) value[l] = re[l] * re[l] + im[l] * im[l];
            }
            const float f = ((float)k + 0.5f) / (float)divisions - 0.5f;
            const float before = 0.5f * scale * (0.5f - f) * (0.5f - f), here = scale * (0.75f - f * f);
            const float behind = 0.5f * scale * (0.5f + f) * (0.5f + f);
            for (int l = 0; l < OUT; ++l) {
                nodes_of[0][l] += before * value[l];
                nodes_of[1][l] += here * value[l];
                nodes_of[2][l] += behind * value[l];
            }
        }
        put(node - 1, nodes_of[0]);
        for (int l = 0; l < OUT; ++l) {
            nodes_of[0][l] = nodes_of[1][l];
            nodes_of[1][l] = nodes_of[2][l];
            nodes_of[2][l] = chunk{};
        }
    }
    put(node - 1, nodes_of[0]);
    put(node, nodes_of[1]);
"""

# The nodes that colours along a few rays take, row after row: one before the first of their octave, which counts as
# dark, the octave, the next one, and of the one behind that what is left. Where an octave has half as many rays,
# Lagrange's polynomial through four on either side gives those halfway.
_JOINED = """
    constexpr float HALFWAY[4] = {1225.0f / 2048.0f, -245.0f / 2048.0f, 49.0f / 2048.0f, -5.0f / 2048.0f};
    constexpr int ROW = LANES / SIZE;
    const int* const begins = (const int*)starts.data;
    const int* const counts = (const int*)rays.data;
    const int coarse = counts[octave], count = counts[octave + 1];
    const int more = octave + 2 < rays.shape[0] ? counts[octave + 2] / count : 0;
    auto on_ray = [&](int of, int ray) {
        return (const chunk*)values.data + (begins[of] + (long long)ray * nodes) * ROW;
    };
    chunk* out = (chunk*)sequence.data + (long long)at * ROW;
    for (int ray = first_ray; ray < first_ray + ABREAST; ++ray, out += (long long)length * ROW) {
        const int size = nodes * ROW, before = ray / 2;
        for (int l = 0; l < ROW; ++l) out[l] = chunk{};
        chunk* const own = out + ROW;
        if (coarse == count || ray % 2 == 0) {
            const chunk* const row = on_ray(octave, coarse == count ? ray : before);
            memcpy(own, row, size * sizeof(chunk));
        } else {
            const chunk* rows[8];
            for (int k = 0; k < 8; ++k) rows[k] = on_ray(octave, (before + k - 3 + coarse) % coarse);
            for (int l = 0; l < size; ++l) {
                chunk sum = chunk{};
                for (int k = 0; k < 4; ++k) sum += HALFWAY[k] * (rows[3 - k][l] + rows[4 + k][l]);
                own[l] = sum;
            }
        }
        // A spectrum of few nodes an octave ends before the filter's last taps.
        const int left = (length - 1 - nodes) * ROW, next = wp::min(left, size);
        const int further = more > 0 ? wp::min(left - next, size) : 0;
        memcpy(own + size, on_ray(octave + 1, ray), next * sizeof(chunk));
        if (further > 0) memcpy(own + size + next, on_ray(octave + 2, ray * more), further * sizeof(chunk));
        for (int l = next + further; l < left; ++l) own[size + l] = chunk{};
    }
"""

# Sums over nodes of a few rays side by side: what a row's terms give for each function of w, by a matrix that the rays
# share, is then weighed with the colour curves. The rows first become coefficients of the quadratic spline that passes
# through them, by a filter that runs up and down.
_PROJECTION = """
    constexpr float POLE = -0.171572875f, GAIN = 1.41421356f * (1.0f - POLE * POLE);
    constexpr int ROW = LANES / SIZE, PARTS = (FUNCTIONS + SIZE - 1) / SIZE;
    chunk* const rows = (chunk*)sequence.data + (long long)at * ROW;
    for (int b = 0; b < ABREAST; ++b) {
        chunk* const row = rows + (long long)b * length * ROW;
        for (int l = 0; l < ROW; ++l) {
            chunk last = chunk{};
            for (int j = 0; j < length; ++j) row[j * ROW + l] = last = row[j * ROW + l] + POLE * last;
            last *= POLE / (1.0f - POLE * POLE);
            for (int j = length - 1; j >= 0; --j) {
                last = row[j * ROW + l] + POLE * last;
                row[j * ROW + l] = GAIN * last;
            }
        }
    }
    const int taps = weights.shape[0];
    float* out = (float*)rows_out.data + 3LL * first_ray * nodes * FUNCTIONS;
    for (int k = 0; k < nodes; ++k) {
        const float* factor = (const float*)matrices.data;
        const float* colour = (const float*)weights.data;
        const float* row = (const float*)(rows + (long long)(skipped + k) * ROW);
        chunk sum[ABREAST][3][PARTS];
        for (int b = 0; b < ABREAST; ++b)
            for (int c = 0; c < 3; ++c)
                for (int p = 0; p < PARTS; ++p) sum[b][c][p] = chunk{};
        for (int i = 0; i < taps; ++i) {
            chunk at_w[ABREAST][PARTS];
            for (int b = 0; b < ABREAST; ++b)
                for (int p = 0; p < PARTS; ++p) at_w[b][p] = chunk{};
            for (int l = 0; l < terms; ++l) {
#pragma unroll
                for (int b = 0; b < ABREAST; ++b) {
#pragma unroll
                    for (int p = 0; p < PARTS; ++p)
                        at_w[b][p] += row[(long long)b * length * LANES + l] * *(const chunk*)(factor + FIRST(p));
                }
                factor += FUNCTIONS;
            }
#pragma unroll
            for (int b = 0; b < ABREAST; ++b) {
#pragma unroll
                for (int c = 0; c < 3; ++c)
                    for (int p = 0; p < PARTS; ++p) sum[b][c][p] += colour[c] * at_w[b][p];
            }
            row += LANES;
            colour += 3;
        }
        for (int b = 0; b < ABREAST; ++b)
            for (int c = 0; c < 3; ++c)
                for (int p = 0; p < PARTS; ++p)
                    *(chunk*)(out + (3LL * (b * nodes + k) + c) * FUNCTIONS + FIRST(p)) = sum[b][c][p];
    }
"""


@functools.cache
def resampler(lanes: int, powers: bool, nodes: int) -> Any:
    """The kernel that samples the power spectrum of a height field's coefficients on rays, and the type of its rows.

    Args:
        lanes: Terms of a row of coefficients.
        powers: Whether these are powers, of the averaged form; a row of the table is then a sum of theirs. Otherwise
            they are amplitudes, of the centred form, and a row of the table holds the power of their sum at some κ.
        nodes: Terms of a row of the values.
    """
    coefficients_t = spectral_sum.kernels(lanes, "averaged" if powers else "centred", powers).Table
    out_t = wp.types.vector(length=nodes, dtype=wp.float32)
    parts = 1 if powers else 2

    @wp.func_native(
        filled(CHUNKS_OF_ROWS + CYCLIC + _SAMPLES, WIDTH=lanes, LANES=lanes, PARTS=parts, NODES=nodes)
    )  # fmt: skip
    def sampled(
        table: coefficients_t,
        bases: wp.array(dtype=out_t),
        sine: wp.float64,
        cosine: wp.float64,
        nodes: wp.int32,
        first_t: wp.float64,
        ratio: wp.float64,
        divisions: wp.int32,
        highest: wp.float64,
        scale: wp.float32,
        left_out: wp.int32,
        begin: wp.int32,
        values_out: wp.array(dtype=out_t),
    ):
        """Integrals along a ray in this direction, in coefficients, from the node ``begin`` on."""

    @wp.kernel(module="unique", module_options=OPTIONS)
    def resample(
        # In:
        table: coefficients_t,
        bases: wp.array(dtype=out_t),
        rays: wp.int32,
        nodes_an_octave: wp.int32,
        log_low: wp.float64,
        divisions: wp.int32,
        highest: wp.float64,
        left_out: wp.int32,
        start: wp.int32,
        first: wp.int32,
        # Out:
        values_out: wp.array(dtype=out_t),
    ):
        """Integrals of the power spectrum along a ray under the splines of an octave's nodes.

        The first node lies at the logarithm ``log_low`` of the frequency, and the row of ray 0 at ``start``. The
        spectrum is sampled ``divisions`` times from node to node, up to the frequency ``highest``, without the
        coefficient ``left_out``. Amplitudes are multiplied by ``bases``, term by term.
        """
        ray = first + wp.tid()
        angle = wp.float64(2.0 * wp.PI) * wp.float64(ray) / wp.float64(rays)
        per_sample = wp.float64(wp.static(math.log(2.0))) / wp.float64(nodes_an_octave * divisions)
        # A node's spline begins one and a half nodes before it.
        first_t = wp.exp(log_low + (wp.float64(0.5) - wp.float64(1.5) * wp.float64(divisions)) * per_sample)
        sampled(
            table, bases, wp.sin(angle) * table.length_y, wp.cos(angle) * table.length_x, nodes_an_octave, first_t,
            wp.exp(per_sample), divisions, highest, wp.float32(per_sample), left_out, start + ray * nodes_an_octave,
            values_out,
        )  # fmt: skip

    return types.SimpleNamespace(row=out_t, resample=resample)


@functools.cache
def gatherer(lanes: int) -> Any:
    """The kernel that gathers coefficients as lines of a spectrum on rays, and the type of its rows."""
    row_t = wp.types.vector(length=lanes, dtype=wp.float32)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def gather(
        # In:
        coefficients: wp.array(dtype=row_t),
        lines: wp.array(dtype=wp.int32),
        angles: wp.array(dtype=wp.float32),
        places: wp.array(dtype=wp.float32),
        weights: wp.array(dtype=wp.float32),
        begins: wp.array(dtype=wp.int32),
        ends: wp.array(dtype=wp.int32),
        nodes: wp.int32,
        blur: wp.float32,
        first: wp.int32,
        # Out:
        values_out: wp.array(dtype=row_t),
    ):
        """Integrals along a ray, under the splines of its nodes, of lines that are blurred in angle.

        Args:
            coefficients: Powers.
            lines: Which of them, in the order of their angles.
            angles: Theirs, from 0 to a turn and a little beyond either end.
            places: Where they lie among the nodes.
            weights: What they count.
            begins: For each ray the first line that reaches it.
            ends: And the one behind the last.
            nodes: Nodes of a ray.
            blur: Standard deviation of the angle.
            first: The first thread's ray.
            values_out: Ray after ray, node by node.
        """
        ray = first + wp.tid()
        start = ray * nodes
        for k in range(nodes):
            values_out[start + k] = row_t()
        angle = wp.float32(wp.float64(2.0 * wp.PI) * wp.float64(ray) / wp.float64(begins.shape[0]))
        scale = 1.0 / (wp.sqrt(2.0 * wp.PI) * blur)
        for j in range(begins[ray], ends[ray]):
            away = (angles[j] - angle) / blur
            node = wp.int32(wp.rint(places[j]))
            f = places[j] - wp.float32(node)
            value = (scale * weights[j] * wp.exp(-0.5 * away * away)) * coefficients[lines[j]]
            if node > 0:
                values_out[start + node - 1] += (0.5 * (0.5 - f) * (0.5 - f)) * value
            values_out[start + node] += (0.75 - f * f) * value
            if node + 1 < nodes:
                values_out[start + node + 1] += (0.5 * (0.5 + f) * (0.5 + f)) * value

    return types.SimpleNamespace(row=row_t, gather=gather)


@functools.cache
def projector(lanes: int, functions: int) -> Any:
    """The kernel that sums rows of ``lanes`` terms over an octave's nodes, to coefficients of so many functions."""
    values_t = wp.types.vector(length=lanes, dtype=wp.float32)
    functions_t = wp.types.vector(length=functions, dtype=wp.float32)
    row_t = lookup(functions).row
    # As many as registers hold sums for.
    abreast = 4 if functions <= 8 else 2

    def native(code: str) -> str:
        # Vectors as long as a row of functions allows: the last one may overlap the one before.
        code = code.replace("FIRST(p)", "(p * SIZE < FUNCTIONS - SIZE ? p * SIZE : FUNCTIONS - SIZE)")
        width = 8 if functions > 4 else 4
        return filled(CHUNKS_OF_ROWS + code, WIDTH=width, LANES=lanes, FUNCTIONS=functions, ABREAST=abreast)

    @wp.func_native(native(_JOINED))
    def joined(
        values: wp.array(dtype=values_t),
        starts: wp.array(dtype=wp.int32),
        rays: wp.array(dtype=wp.int32),
        nodes: wp.int32,
        octave: wp.int32,
        first_ray: wp.int32,
        sequence: wp.array(dtype=values_t),
        at: wp.int32,
        length: wp.int32,
    ):
        """Rows of a few rays from one before an octave on, ``length`` of them for each ray."""

    @wp.func_native(native(_PROJECTION))
    def projected(
        sequence: wp.array(dtype=values_t),
        at: wp.int32,
        length: wp.int32,
        skipped: wp.int32,
        matrices: wp.array(dtype=functions_t),
        weights: wp.array(dtype=wp.vec3f),
        terms: wp.int32,
        nodes: wp.int32,
        first_ray: wp.int32,
        rows_out: wp.array(dtype=row_t),
    ):
        """Colours along a few rays from their ``length`` rows; that of the first node begins behind those skipped."""

    @wp.kernel(module="unique", module_options=OPTIONS)
    def project(
        # In:
        values: wp.array(dtype=values_t),
        starts: wp.array(dtype=wp.int32),
        rays: wp.array(dtype=wp.int32),
        matrices: wp.array(dtype=functions_t),
        weights: wp.array(dtype=wp.vec3f),
        terms: wp.int32,
        nodes: wp.int32,
        octave: wp.int32,
        length: wp.int32,
        sequence: wp.array(dtype=values_t),
        first: wp.int32,
        run: wp.int32,
        # Out:
        rows_out: wp.array(dtype=row_t),
    ):
        """Colours along a few rays at a time, at the nodes of an octave of |(u, v)|.

        Their red end lies in the same octave of frequencies, which has as many rays as the next or half of them, and
        their blue end in the next and a little beyond. ``sequence`` has room for ``length`` rows of each ray.
        """
        at = (first + wp.tid()) * wp.static(abreast) * length
        for k in range(run):
            first_ray = (first + wp.tid() * run + k) * wp.static(abreast)
            joined(values, starts, rays, nodes, octave, first_ray, sequence, at, length)
            projected(sequence, at, length, 0, matrices, weights, terms, nodes, first_ray, rows_out)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def project_lines(
        # In:
        values: wp.array(dtype=values_t),
        matrices: wp.array(dtype=functions_t),
        weights: wp.array(dtype=wp.vec3f),
        terms: wp.int32,
        nodes: wp.int32,
        given: wp.int32,
        first: wp.int32,
        # Out:
        rows_out: wp.array(dtype=row_t),
    ):
        """The same where each ray has all ``given`` nodes that its own take, and those that the filter takes besides.

        The filter changes them.
        """
        first_ray = (first + wp.tid()) * wp.static(abreast)
        at = first_ray * given
        skipped = wp.static(FILTER_REACH)
        projected(values, at, given, skipped, matrices, weights, terms, nodes, first_ray, rows_out)

    return types.SimpleNamespace(functions=functions_t, project=project, project_lines=project_lines, abreast=abreast)
