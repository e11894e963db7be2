"""The power spectrum on rays, and its integral over λ for every (u, v) and every function of w.

Rays are sampled at nodes of equal ratios, each the integral of the spectrum under a quadratic B-spline in ln t,
t = |(u, v)|/λ. A colour is a sum over an octave's nodes, whose weights are the same wherever |(u, v)| takes the same
ratios: ``lookup`` has the rest.
"""

import functools
import math
import types
from typing import Any

import warp as wp

from warpdiff.kernels import spectral
from warpdiff.kernels.lookup import CHUNKS_OF_ROWS, OPTIONS, cyclic, lookup

# Samples halfway between others: Lagrange's polynomial through four on either side.
_HALFWAY = wp.constant(wp.vec4f(1225.0 / 2048.0, -245.0 / 2048.0, 49.0 / 2048.0, -5.0 / 2048.0))

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
    base = spectral.kernels(lanes, "averaged" if powers else "centred", powers)
    coefficients_t = base.Table
    row_t = base.row
    wrapped = base.wrapped
    out_t = wp.types.vector(length=nodes, dtype=wp.float32)

    @wp.func
    def power_row(
        table: coefficients_t,
        qy: wp.float64,
        qx: wp.float64,
        bases: wp.array(dtype=row_t),
        left_out: wp.int32,
        radius_y: wp.float32,
        shrink: wp.float32,
    ) -> out_t:
        """⟨|P|²⟩ at a frequency in coefficients, as a row, but for the coefficient ``left_out``."""
        iy = wp.int32(wp.rint(qy))
        ix = wp.int32(wp.rint(qx))
        fy = wp.float32(qy - wp.float64(iy))
        fx = wp.float32(qx - wp.float64(ix))
        first_y = wp.int32(wp.ceil(fy - radius_y))
        last_y = wp.int32(wp.floor(fy + radius_y))
        total = out_t()
        total_re = row_t()
        total_im = row_t()
        for j in range(first_y, last_y + 1):
            dy = wp.float32(j) - fy
            # A circle of neighbours, row by row.
            left = wp.sqrt(wp.max(table.exponent - table.across * dy * dy, 0.0) / table.along)
            first_x = wp.int32(wp.ceil(fx - left))
            last_x = wp.int32(wp.floor(fx + left))
            dx = wp.float32(first_x) - fx
            g = wp.exp(-table.across * dy * dy - table.along * dx * dx)
            step = wp.exp(-table.along * (2.0 * dx + 1.0))
            row = wrapped(iy + j + table.origin_y, table.count_y) * table.count_x
            x = wrapped(ix + first_x + table.origin_x, table.count_x)
            for _i in range(first_x, last_x + 1):
                if wp.static(powers):
                    if row + x != left_out:
                        total += g * table.rows[row + x]
                else:
                    total_re += g * table.rows[2 * (row + x)]
                    total_im += g * table.rows[2 * (row + x) + 1]
                g = g * step
                step = step * shrink
                x = x + 1
                if x == table.count_x:
                    x = 0
        if wp.static(not powers):
            for n in range(wp.static(nodes)):
                re = wp.dot(total_re, bases[n])
                im = wp.dot(total_im, bases[n])
                total[n] = re * re + im * im
        return total

    @wp.kernel(module="unique", module_options=OPTIONS)
    def resample(
        # In:
        table: coefficients_t,
        bases: wp.array(dtype=row_t),
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
        spectrum is sampled ``divisions`` times from node to node, up to the frequency ``highest``.
        """
        ray = first + wp.tid()
        angle = wp.float64(2.0 * wp.PI) * wp.float64(ray) / wp.float64(rays)
        cosine = wp.cos(angle) * table.length_x
        sine = wp.sin(angle) * table.length_y
        share = wp.float32(1.0) / wp.float32(divisions)
        scale = share * wp.static(math.log(2.0)) / wp.float32(nodes_an_octave)
        begin = start + ray * nodes_an_octave
        for k in range(nodes_an_octave):
            values_out[begin + k] = out_t()
        radius_y = wp.sqrt(table.exponent / table.across)
        shrink = wp.exp(-2.0 * table.along)
        # A node's spline begins one and a half nodes before it.
        per_sample = wp.float64(wp.static(math.log(2.0))) / wp.float64(nodes_an_octave * divisions)
        t = wp.exp(log_low + (wp.float64(0.5) - wp.float64(1.5) * wp.float64(divisions)) * per_sample)
        ratio = wp.exp(per_sample)
        for k in range((nodes_an_octave + 2) * divisions):
            node = k // divisions - 1
            f = (wp.float32(k - (node + 1) * divisions) + 0.5) * share - 0.5
            if t <= highest:
                value = scale * power_row(table, t * sine, t * cosine, bases, left_out, radius_y, shrink)
                if node > 0:
                    values_out[begin + node - 1] += (0.5 * (0.5 - f) * (0.5 - f)) * value
                if node >= 0 and node < nodes_an_octave:
                    values_out[begin + node] += (0.75 - f * f) * value
                if node + 1 < nodes_an_octave:
                    values_out[begin + node + 1] += (0.5 * (0.5 + f) * (0.5 + f)) * value
            t = t * ratio

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
