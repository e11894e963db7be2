"""Colours from a polar table of the power spectrum: the integral over λ is a correlation along a ray.

As λ goes from red to blue, (u, v)/λ runs along a ray of the frequency plane, over one octave. The table holds the power
spectrum on rays, at nodes of equal ratios along them, each the integral of the spectrum under a quadratic B-spline in
ln t, t = |(u, v)|/λ. A colour is then a sum over an octave's nodes, with colour weights that are the projection of the
colour curves on the same splines, however many orders the ray passes. Between rays the table is a quadratic spline,
too; there are as many rays as the top of an octave needs.

A pixel sees a range of (u, v). Powers add, so that its mean is a spectrum blurred by the same angle and the same ratio
at all wavelengths: levels of the table are blurred in angle, with fewer rays, and sets of colour weights in ratio.
"""

import functools
import math
import types
from typing import Any

import warp as wp

from warpdiff.kernels import spectral

# Loops that stay loops compile faster.
OPTIONS = {**spectral.OPTIONS, "max_unroll": 1}
# Rays on either side of one that a look-up may need; as many are repeated beyond a turn.
REACH = 4
# Taps on either side of the filter that turns samples into spline coefficients: the factor −0.17 to the sixth is 3e-5.
_FILTER_REACH = 6
# A footprint is split where its direction turns by so much, or where its parts differ in ln |(u, v)| by so much.
_MOST_TURN, _MOST_DRIFT = wp.constant(wp.float32(0.06)), wp.constant(wp.float32(0.005))
# Parts of a footprint along its angle.
MOST_PARTS = 12
# Beyond these a footprint surrounds the mirror direction and is no range of angles.
_WIDEST_ANGLE, _WIDEST_RATIO = wp.constant(wp.float32(0.5)), wp.constant(wp.float32(0.35))


@wp.struct
class ColourWeights:
    """Projections of the colour curves on the splines, blurred in ln λ, for positions between two nodes.

    The variance of set 0 is 0, that of the next ``first`` and of every other one twice that of the one before.
    """

    weights: wp.array3d(dtype=wp.vec3f)  # (sets, fractions, nodes)
    margins: wp.array(dtype=wp.int32)  # nodes of a set on either side of those of set 0
    first: wp.float32


@wp.struct
class Blending:
    """Weights of the rays around an angle: the spline between rays, blurred by a remainder of the footprint."""

    weights: wp.array3d(dtype=wp.float32)  # (variances, fractions, 2 REACH + 1)
    reaches: wp.array(dtype=wp.int32)  # rays on either side that count
    per_variance: wp.float32  # entries per unit of the variance, in distances of rays squared
    parts: wp.array3d(dtype=wp.float32)  # for 1, 2, … of them: the variance within, then places and weights


# One octave's share of a colour: plain loops of a fixed length, which compilers make SIMD of; as Warp's vectors they
# take half as long again. Terms are added up lane by lane, and the lanes once at the end.
_NODE_SUM = """
    const float* row = (const float*)rows.data + (long long)start * LANES;
    const long long blend = (long long)step * taps.shape[1] + position;
    const float* tap = taps.data + blend * taps.shape[2] + taps.shape[2] / 2 - reach;
    const long long sets = (long long)weights.shape[1] * weights.shape[2];
    const float* weight = (const float*)weights.data
        + 3 * ((long long)chosen * sets + (long long)fraction * weights.shape[2] + first);
    const float* beyond = weight + (share > 0.0f ? 3 * sets : 0);
    float x[LANES], y[LANES], z[LANES];
    for (int l = 0; l < LANES; ++l) x[l] = y[l] = z[l] = 0.0f;
    for (int m = 0; m < count; ++m) {
        float sum[LANES];
        for (int l = 0; l < LANES; ++l) sum[l] = 0.0f;
        const float* from = row;
        for (int j = 0; j <= 2 * reach; ++j) {
            for (int l = 0; l < LANES; ++l) sum[l] += tap[j] * from[l];
            from += stride * LANES;
        }
        int here = entry < 0 ? 0 : entry;
        here = here > last ? last : here;
        const float* base = (const float*)basis.data + (long long)here * LANES;
        const float wx = weight[0] + share * (beyond[0] - weight[0]);
        const float wy = weight[1] + share * (beyond[1] - weight[1]);
        const float wz = weight[2] + share * (beyond[2] - weight[2]);
        for (int l = 0; l < LANES; ++l) {
            const float power = sum[l] * (base[l] + between * (base[l + LANES] - base[l]));
            x[l] += wx * power;
            y[l] += wy * power;
            z[l] += wz * power;
        }
        row += LANES;
        weight += 3;
        beyond += 3;
        entry += entries;
    }
    float total_x = 0.0f, total_y = 0.0f, total_z = 0.0f;
    for (int l = 0; l < LANES; ++l) { total_x += x[l]; total_y += y[l]; total_z += z[l]; }
    return wp::vec_t<3, float>(total_x, total_y, total_z);
"""


@functools.cache
def lookup(lanes: int) -> types.SimpleNamespace:
    """The struct of a table whose rows have ``lanes`` terms, and the kernels that do not depend on where it comes from.

    Returns:
        A namespace with the type ``row``, the struct ``Polar`` and the kernels ``interpolate``, ``blur`` and
        ``integrate``.
    """
    row_t = wp.types.vector(length=lanes, dtype=wp.float32)

    @wp.struct
    class Polar:
        rows: wp.array(dtype=row_t)  # level after level, octave after octave, ray after ray, node after node
        basis: wp.array(dtype=row_t)  # at equal ratios of |κ|
        firsts: wp.array2d(dtype=wp.int32)  # (levels, octaves), the row of ray 0
        rays: wp.array2d(dtype=wp.int32)  # (levels, octaves), their number
        widths: wp.array2d(dtype=wp.float32)  # (levels, octaves), what they are blurred by [rad]
        nodes: wp.int32  # nodes an octave
        per_log: wp.float32  # nodes per unit of ln t
        log_low: wp.float64  # ln t of the first node
        first_red: wp.float32  # the node of the red end where |(u, v)| is 1
        least_uv: wp.float32  # below this |(u, v)| the spectrum is flat
        first_entry: wp.float32  # the basis' entry at the first node where w is |(u, v)|
        entries: wp.int32  # entries of the basis from one node to the next

    @wp.func
    def cyclic(index: wp.int32, count: wp.int32) -> wp.int32:
        """An index modulo the number of rays."""
        result = index % count
        if result < 0:
            result = result + count
        return result

    @wp.kernel(module="unique", module_options=OPTIONS)
    def interpolate(
        # In:
        values: wp.array(dtype=row_t),
        polar: Polar,
        level: wp.int32,
        octave: wp.int32,
        first: wp.int32,
        # Out:
        rows_out: wp.array(dtype=row_t),
    ):
        """Coefficients of the quadratic spline that passes through an octave's values, and those beyond a turn."""
        ray = first + wp.tid() - wp.static(REACH)
        count = polar.rays[level, octave]
        begin = polar.firsts[level, octave] + ray * polar.nodes
        for k in range(polar.nodes):
            rows_out[begin + k] = row_t()
        for away in range(-wp.static(_FILTER_REACH), wp.static(_FILTER_REACH + 1)):
            factor = wp.static(2.0**0.5) * wp.pow(wp.static(2.0 * 2.0**0.5 - 3.0), wp.float32(wp.abs(away)))
            row = cyclic(ray + away, count) * polar.nodes
            for k in range(polar.nodes):
                rows_out[begin + k] += factor * values[row + k]

    @wp.kernel(module="unique", module_options=OPTIONS)
    def blur(
        # In:
        polar: Polar,
        source: wp.int32,
        level: wp.int32,
        octave: wp.int32,
        first: wp.int32,
        # Out:
        values_out: wp.array(dtype=row_t),
    ):
        """Values on the rays of a level: those of another, blurred by what it lacks."""
        ray = first + wp.tid()
        count = polar.rays[source, octave]
        start = polar.firsts[source, octave]
        spacing = wp.float32(2.0 * wp.PI) / wp.float32(count)
        # The variance of the spline itself is a quarter of the distance of rays, squared.
        width = polar.widths[level, octave]
        given = polar.widths[source, octave]
        variance = (width * width - given * given) / (spacing * spacing) + 0.25
        reach = wp.min(wp.int32(wp.ceil(4.5 * wp.sqrt(variance))), count // 2)
        place = wp.float32(ray) / wp.float32(polar.rays[level, octave]) * wp.float32(count)
        nearest = wp.int32(wp.rint(place))
        total_weight = wp.float32(0.0)
        for k in range(polar.nodes):
            values_out[ray * polar.nodes + k] = row_t()
        for away in range(-reach, reach + 1):
            distance = wp.float32(nearest + away) - place
            weight = wp.exp(-0.5 * distance * distance / variance)
            total_weight += weight
            row = start + cyclic(nearest + away, count) * polar.nodes
            for k in range(polar.nodes):
                values_out[ray * polar.nodes + k] += weight * polar.rows[row + k]
        for k in range(polar.nodes):
            values_out[ray * polar.nodes + k] = (1.0 / total_weight) * values_out[ray * polar.nodes + k]

    @wp.func_native(_NODE_SUM.replace("LANES", str(lanes)))
    def node_sum(
        rows: wp.array(dtype=row_t),
        basis: wp.array(dtype=row_t),
        taps: wp.array3d(dtype=wp.float32),
        weights: wp.array3d(dtype=wp.vec3f),
        start: wp.int32,
        stride: wp.int32,
        step: wp.int32,
        position: wp.int32,
        reach: wp.int32,
        chosen: wp.int32,
        share: wp.float32,
        fraction: wp.int32,
        first: wp.int32,
        count: wp.int32,
        entry: wp.int32,
        entries: wp.int32,
        last: wp.int32,
        between: wp.float32,
    ) -> wp.vec3f: ...

    @wp.func
    def colour_at(
        polar: Polar,
        colours: ColourWeights,
        blending: Blending,
        u: wp.float32,
        v: wp.float32,
        log_w: wp.float32,
        angle2: wp.float32,
        ratio2: wp.float32,
    ) -> wp.vec3f:
        """XYZ of a deflection that spreads by variances in angle and in ln |(u, v)|."""
        log_uv = wp.log(wp.max(wp.sqrt(u * u + v * v), polar.least_uv))
        # The mean of ln |(u, v)|, to second order: what lies aside is further away.
        log_uv = log_uv + 0.5 * (angle2 - ratio2)
        turns = wp.atan2(v, u) * wp.float32(0.5 / wp.PI)
        if turns < 0.0:
            turns = turns + 1.0
        # Which sets of colour weights, and how much of the second.
        chosen = wp.int32(0)
        share = wp.float32(0.0)
        margin = wp.int32(0)
        if ratio2 > 0.0:
            share = ratio2 / colours.first
            if share >= 1.0:
                chosen = wp.min(wp.int32(wp.log2(share)) + 1, colours.weights.shape[0] - 2)
                below = wp.pow(2.0, wp.float32(chosen - 1))
                share = wp.min((share - below) / below, 1.0)
            margin = colours.margins[chosen + 1]
        widest = colours.margins[colours.margins.shape[0] - 1]

        place = log_uv * polar.per_log + polar.first_red
        nearest = wp.int32(wp.rint(place))
        fractions = colours.weights.shape[1]
        fraction = wp.int32((place - wp.float32(nearest) + 0.5) * wp.float32(fractions))
        fraction = wp.clamp(fraction, 0, fractions - 1)
        octaves = polar.rays.shape[1]
        # The second of set 0 is the nearest to the red end; there are none outside the table.
        k = wp.max(widest - margin, widest - nearest + 1)
        node = nearest - 1 - widest + k
        end_of_all = wp.min(colours.weights.shape[2] - widest + margin, octaves * polar.nodes - nearest + 1 + widest)
        # Nodes and the basis' entries are at equal ratios: the distance to an entry is the same at all of them.
        entry = ((log_w - log_uv) * polar.per_log + wp.float32(node)) * wp.float32(polar.entries) + polar.first_entry
        floor_of_entry = wp.floor(entry)
        at = wp.int32(floor_of_entry)
        t = entry - floor_of_entry
        last = polar.basis.shape[0] - 2
        colour = wp.vec3f()
        octave = node // polar.nodes
        while k < end_of_all:
            # The level that is blurred by as much or less, and what is left of it.
            level = wp.int32(0)
            if angle2 > 0.0:
                relative = angle2 / (polar.widths[1, octave] * polar.widths[1, octave])
                if relative >= 1.0:
                    level = wp.min(wp.int32(wp.log2(relative)) + 1, polar.rays.shape[0] - 1)
            rays = polar.rays[level, octave]
            spacing = wp.float32(2.0 * wp.PI) / wp.float32(rays)
            left = wp.max(angle2 - polar.widths[level, octave] * polar.widths[level, octave], 0.0)
            step = wp.int32(left / (spacing * spacing) * blending.per_variance + 0.5)
            step = wp.min(step, blending.weights.shape[0] - 1)
            reach = blending.reaches[step]
            position = turns * wp.float32(rays)
            ray = wp.int32(wp.rint(position))
            if ray >= rays:
                # Half a distance before a full turn; rays are repeated to REACH − 1 beyond.
                ray = ray - rays
                position = position - wp.float32(rays)
            steps = blending.weights.shape[1]
            f = wp.min(wp.int32((position - wp.float32(ray) + 0.5) * wp.float32(steps)), steps - 1)
            offset = node - octave * polar.nodes
            start = polar.firsts[level, octave] + (ray - reach) * polar.nodes + offset
            end = wp.min(end_of_all - k, polar.nodes - offset)
            colour += node_sum(
                polar.rows,
                polar.basis,
                blending.weights,
                colours.weights,
                start,
                polar.nodes,
                step,
                f,
                reach,
                chosen,
                share,
                fraction,
                k,
                end,
                at,
                polar.entries,
                last,
                t,
            )
            at = at + end * polar.entries
            k = k + end
            node = node + end
            octave = octave + 1
        # Projected colour curves have shallow negative lobes.
        return wp.max(colour, wp.vec3f())

    @wp.kernel(module="unique", module_options=OPTIONS)
    def integrate(
        # In:
        polar: Polar,
        deflections: wp.array(dtype=wp.vec3d),
        gains: wp.array(dtype=wp.float32),
        footprints: wp.array(dtype=wp.vec4f),
        colours: ColourWeights,
        blending: Blending,
        first: wp.int32,
        # Out:
        xyz_out: wp.array(dtype=wp.vec3f),
    ):
        """Add the XYZ of each direction to ``xyz_out``; an empty array of footprints is none."""
        i = first + wp.tid()
        gain = gains[i]
        if gain > 0.0:
            deflection = deflections[i]
            u = wp.float32(deflection[0])
            v = wp.float32(deflection[1])
            log_w = wp.log(wp.float32(-deflection[2]))
            colour = wp.vec3f()
            count = wp.int32(1)
            angle2 = wp.float32(0.0)
            ratio2 = wp.float32(0.0)
            along = wp.vec2f()
            if footprints.shape[0] > 0:
                # Covariance along (u, v) and across, relative to |(u, v)|.
                uv2 = wp.max(u * u + v * v, polar.least_uv * polar.least_uv)
                x = u / uv2
                y = v / uv2
                f = footprints[i]
                radial = wp.vec2f(f[0] * x + f[1] * y, f[2] * x + f[3] * y)
                tangential = wp.vec2f(f[1] * x - f[0] * y, f[3] * x - f[2] * y)
                angle2 = wp.dot(tangential, tangential)
                ratio2 = wp.dot(radial, radial)
                if angle2 > 0.0:
                    drift = wp.dot(radial, tangential) / wp.sqrt(angle2)
                    needed = wp.max(wp.sqrt(angle2) / _MOST_TURN, wp.abs(drift) / _MOST_DRIFT)
                    count = wp.clamp(wp.int32(wp.ceil(needed)), 1, wp.static(MOST_PARTS))
                    # Parts lie along what goes with the angle.
                    scale = 1.0 / wp.sqrt(angle2)
                    along = scale * wp.vec2f(
                        f[0] * tangential[0] + f[2] * tangential[1], f[1] * tangential[0] + f[3] * tangential[1]
                    )
                    within = blending.parts[count - 1, 0, 0]
                    ratio2 = ratio2 - (1.0 - within) * drift * drift
                    angle2 = within * angle2
            for k in range(count):
                away = blending.parts[count - 1, 1, k]
                at_u = u + away * along[0]
                at_v = v + away * along[1]
                part_angle2 = angle2
                part_ratio2 = ratio2
                if count > 1:
                    # Relative to the part's own |(u, v)|.
                    change = (u * u + v * v) / wp.max(at_u * at_u + at_v * at_v, polar.least_uv * polar.least_uv)
                    part_angle2 = angle2 * change
                    part_ratio2 = ratio2 * change
                # What is seen around the mirror direction spreads over more than a ratio can say.
                dilution = wp.min(_WIDEST_RATIO / wp.sqrt(wp.max(part_ratio2, 1.0e-12)), 1.0)
                part_angle2 = wp.min(part_angle2, _WIDEST_ANGLE * _WIDEST_ANGLE)
                part_ratio2 = wp.min(part_ratio2, _WIDEST_RATIO * _WIDEST_RATIO)
                part = colour_at(polar, colours, blending, at_u, at_v, log_w, part_angle2, part_ratio2)
                colour += blending.parts[count - 1, 2, k] * dilution * part
            xyz_out[i] = xyz_out[i] + gain * colour

    return types.SimpleNamespace(row=row_t, Polar=Polar, interpolate=interpolate, blur=blur, integrate=integrate)


@functools.cache
def resampler(lanes: int, powers: bool, nodes: int) -> Any:
    """The kernel that fills a table from the coefficients of a height field.

    Args:
        lanes: Terms of a row of coefficients.
        powers: Whether these are powers, of the averaged form; a row of the table is then a sum of theirs. Otherwise
            they are amplitudes, of the centred form, and a row of the table holds the power of their sum at some κ.
        nodes: Terms of a row of the table.
    """
    base = spectral.kernels(lanes, "averaged" if powers else "centred", powers)
    coefficients_t = base.Table
    row_t = base.row
    wrapped = base.wrapped
    target = lookup(nodes)
    polar_t = target.Polar
    out_t = target.row

    @wp.func
    def power_row(table: coefficients_t, qy: wp.float64, qx: wp.float64, bases: wp.array(dtype=row_t)) -> out_t:
        """⟨|P|²⟩ at a frequency in coefficients, as a row."""
        iy = wp.int32(wp.rint(qy))
        ix = wp.int32(wp.rint(qx))
        fy = wp.float32(qy - wp.float64(iy))
        fx = wp.float32(qx - wp.float64(ix))
        radius_y = wp.sqrt(table.exponent / table.across)
        first_y = wp.int32(wp.ceil(fy - radius_y))
        last_y = wp.int32(wp.floor(fy + radius_y))
        total = out_t()
        total_re = row_t()
        total_im = row_t()
        shrink = wp.exp(-2.0 * table.along)
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
        polar: polar_t,
        octave: wp.int32,
        divisions: wp.int32,
        highest: wp.float64,
        first: wp.int32,
        # Out:
        values_out: wp.array(dtype=out_t),
    ):
        """Integrals of the power spectrum along a ray of an octave under the splines of its nodes.

        The spectrum is sampled ``divisions`` times from node to node, up to the frequency ``highest``.
        """
        ray = first + wp.tid()
        angle = wp.float64(2.0 * wp.PI) * wp.float64(ray) / wp.float64(polar.rays[0, octave])
        cosine = wp.cos(angle) * table.length_x
        sine = wp.sin(angle) * table.length_y
        share = wp.float32(1.0) / wp.float32(divisions)
        scale = share / polar.per_log
        begin = ray * polar.nodes
        for k in range(polar.nodes):
            values_out[begin + k] = out_t()
        # A node's spline begins one and a half nodes before it.
        for k in range((polar.nodes + 2) * divisions):
            node = k // divisions - 1
            f = (wp.float32(k - (node + 1) * divisions) + 0.5) * share - 0.5
            place = wp.float64(octave * polar.nodes + node) + wp.float64(f)
            t = wp.exp(polar.log_low + place / wp.float64(polar.nodes) * wp.float64(wp.static(math.log(2.0))))
            if t <= highest:
                value = scale * power_row(table, t * sine, t * cosine, bases)
                if node > 0:
                    values_out[begin + node - 1] += (0.5 * (0.5 - f) * (0.5 - f)) * value
                if node >= 0 and node < polar.nodes:
                    values_out[begin + node] += (0.75 - f * f) * value
                if node + 1 < polar.nodes:
                    values_out[begin + node + 1] += (0.5 * (0.5 + f) * (0.5 + f)) * value

    return resample
