"""The power spectrum on rays, and its integral over λ for every (u, v) and every function of w.

Rays are sampled at nodes of equal ratios, each the integral of the spectrum under a quadratic B-spline in ln t,
t = |(u, v)|/λ. A colour is a sum over an octave's nodes, whose weights are the same wherever |(u, v)| takes the same
ratios: ``lookup`` has the rest.
"""

import functools
import math
import re
import types
from typing import Any

import warp as wp

from warpdiff.kernels import spectral
from warpdiff.kernels.lookup import CHUNKS_OF_ROWS, OPTIONS, cyclic, lookup

# Samples halfway between others: Lagrange's polynomial through four on either side.
_HALFWAY = wp.constant(wp.vec4f(1225.0 / 2048.0, -245.0 / 2048.0, 49.0 / 2048.0, -5.0 / 2048.0))

# Samples of a spectrum on a ray, one after the other: Gaussian factors of the columns and of the rows around one, eight
# abreast, then a sum of rows times theirs, each times its own. The same neighbours of the nearest one are summed around
# all places that are nearest to it, so that no branch depends on the place. What a sample adds to the splines of three
# nodes stays in registers from node to node.
_SAMPLES = """
    constexpr int ABREAST = 8, ROWS = 64, ROW = CHUNKS * PARTS, OUT = NODES / SIZE;
    const chunk* const all_rows = (const chunk*)table.rows.data;
    const int count_y = table.count_y, count_x = table.count_x;
    const float across = table.across, along = table.along;
    // As far as from somewhere nearest to the middle a neighbour counts, and on each row.
    const int reach_y = (int)(wp::sqrt(table.exponent / across) + 0.5f);
    const int reach_x = (int)(wp::sqrt(table.exponent / along) + 0.5f);
    int reaches[ROWS];
    for (int j = 0; j < ROWS; ++j) {
        const float away = wp::max((float)j - 0.5f, 0.0f);
        reaches[j] = (int)(wp::sqrt(wp::max(table.exponent - across * away * away, 0.0f) / along) + 0.5f);
    }
    auto wrapped = [](int index, int count) {
        const int left = index % count;
        return left < 0 ? left + count : left;
    };
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
            int columns[ABREAST];
            const int column = nearest_x + table.origin_x + from_x;
            for (int i = 0; i < ABREAST; ++i) {
                const float away = (float)(from_x + i) - fx;
                of_columns[i] = exponential(-along * away * away);
                columns[i] = column + i;
            }
            if (column < 0 || column + ABREAST > count_x)
                for (int i = 0; i < ABREAST; ++i) columns[i] = wrapped(columns[i], count_x);
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
                    if (y < 0 || y >= count_y) y = wrapped(y, count_y);
                    y *= count_x;
                    chunk sum[ROW];
                    for (int c = 0; c < ROW; ++c) sum[c] = chunk{};
                    for (int i = begin; i < end; ++i) {
                        const int at = y + columns[i];
                        if (at == left_out) continue;
                        const chunk* const row = all_rows + (long long)at * ROW;
                        for (int c = 0; c < ROW; ++c) sum[c] += of_columns[i] * row[c];
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

# Nodes of a few rays side by side, which share the loads of the matrices: theirs of one octave, of the next and beyond.
_PROJECTION = """
    const chunk* factor = (const chunk*)matrices.data + (long long)skipped * terms * CHUNKS;
    chunk sum[ABREAST][CHUNKS];
    for (int b = 0; b < ABREAST; ++b)
        for (int c = 0; c < CHUNKS; ++c) sum[b][c] = chunk{};
    for (int part = 0; part < 3; ++part) {
        const float* row = part == 0 ? (const float*)refined.data + (long long)start0 * LANES
            : (const float*)values.data + (long long)(part == 1 ? start1 : start2) * LANES;
        const long long by = (long long)(part == 2 ? apart2 : apart) * LANES;
        const int count = part == 0 ? count0 : part == 1 ? count1 : count2;
        for (int m = 0; m < count; ++m) {
            for (int l = 0; l < terms; ++l) {
#pragma unroll
                for (int b = 0; b < ABREAST; ++b) {
#pragma unroll
                    for (int c = 0; c < CHUNKS; ++c) sum[b][c] += row[b * by + l] * factor[c];
                }
                factor += CHUNKS;
            }
            row += LANES;
        }
    }
    float* out = (float*)rows_out.data + (long long)at * WIDTH;
    for (int b = 0; b < ABREAST; ++b) {
        for (int c = 0; c < CHUNKS; ++c) ((chunk*)out)[c] = sum[b][c];
        out += (long long)apart * WIDTH;
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
    coefficients_t = spectral.kernels(lanes, "averaged" if powers else "centred", powers).Table
    out_t = wp.types.vector(length=nodes, dtype=wp.float32)
    names = {"WIDTH": lanes, "LANES": lanes, "PARTS": 1 if powers else 2, "NODES": nodes}

    @wp.func_native(re.sub("|".join(names), lambda found: str(names[found[0]]), CHUNKS_OF_ROWS + _SAMPLES))
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
    row_t = lookup(functions).row
    # As many as registers hold sums for.
    abreast = 4 if functions <= 8 else 2
    native = (CHUNKS_OF_ROWS + _PROJECTION).replace("ABREAST", str(abreast)).replace("WIDTH", str(3 * functions))

    @wp.func_native(native.replace("LANES", str(lanes)))
    def projected(
        refined: wp.array(dtype=values_t),
        values: wp.array(dtype=values_t),
        matrices: wp.array(dtype=row_t),
        terms: wp.int32,
        skipped: wp.int32,
        start0: wp.int32,
        count0: wp.int32,
        start1: wp.int32,
        count1: wp.int32,
        start2: wp.int32,
        count2: wp.int32,
        apart: wp.int32,
        apart2: wp.int32,
        rows_out: wp.array(dtype=row_t),
        at: wp.int32,
    ):
        """Rows one after the other times the matrices from the first on."""

    @wp.kernel(module="unique", module_options=OPTIONS)
    def project(
        # In:
        values: wp.array(dtype=values_t),
        starts: wp.array(dtype=wp.int32),
        rays: wp.array(dtype=wp.int32),
        matrices: wp.array(dtype=row_t),
        terms: wp.int32,
        before: wp.int32,
        nodes: wp.int32,
        octave: wp.int32,
        refined: wp.array(dtype=values_t),
        first: wp.int32,
        # Out:
        rows_out: wp.array(dtype=row_t),
    ):
        """Colours along a few rays at the nodes of an octave of |(u, v)|.

        Their red end lies in the same octave of frequencies, which has as many rays as the next or half of them, and
        their blue end in the next and a little beyond. ``before`` matrices are for nodes before the one itself.
        """
        first_ray = (first + wp.tid()) * wp.static(abreast)
        count = rays[octave + 1]
        coarse = rays[octave]
        for ray in range(first_ray, first_ray + wp.static(abreast)):
            begin = ray * nodes
            if coarse == count:
                for k in range(nodes):
                    refined[begin + k] = values[starts[octave] + begin + k]
            elif ray % 2 == 0:
                for k in range(nodes):
                    refined[begin + k] = values[starts[octave] + ray // 2 * nodes + k]
            else:
                for k in range(nodes):
                    refined[begin + k] = values_t()
                for away in range(4):
                    left = starts[octave] + cyclic(ray // 2 - away, coarse) * nodes
                    right = starts[octave] + cyclic(ray // 2 + 1 + away, coarse) * nodes
                    for k in range(nodes):
                        refined[begin + k] += _HALFWAY[away] * (values[left + k] + values[right + k])
        size = matrices.shape[0] // terms
        begin = first_ray * nodes
        more = wp.int32(0)
        beyond = wp.int32(0)
        if octave + 2 < rays.shape[0]:
            more = rays[octave + 2] // count
            beyond = starts[octave + 2] + first_ray * more * nodes
        for k in range(nodes):
            skipped = wp.max(before - k, 0)
            at = k - before + skipped
            here = wp.min(nodes - at, size - skipped)
            there = wp.min(size - skipped - here, nodes)
            # A spectrum of few nodes an octave ends before the filter's last taps.
            further = wp.int32(0)
            if more > 0:
                further = wp.min(size - skipped - here - there, nodes)
            projected(
                refined, values, matrices, terms, skipped, begin + at, here, starts[octave + 1] + begin, there, beyond,
                further, nodes, more * nodes, rows_out, begin + k,
            )  # fmt: skip

    @wp.kernel(module="unique", module_options=OPTIONS)
    def project_lines(
        # In:
        values: wp.array(dtype=values_t),
        matrices: wp.array(dtype=row_t),
        terms: wp.int32,
        nodes: wp.int32,
        given: wp.int32,
        first: wp.int32,
        # Out:
        rows_out: wp.array(dtype=row_t),
    ):
        """The same where each ray has all ``given`` nodes that its own ones take, from the first matrix's on."""
        first_ray = (first + wp.tid()) * wp.static(abreast)
        size = matrices.shape[0] // terms
        for k in range(nodes):
            projected(
                values, values, matrices, terms, 0, 0, 0, 0, 0, first_ray * given + k, size, nodes, given, rows_out,
                first_ray * nodes + k,
            )  # fmt: skip

    return types.SimpleNamespace(project=project, project_lines=project_lines, abreast=abreast)
