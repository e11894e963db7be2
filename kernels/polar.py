"""Colours from a polar table of the power spectrum: the integral over λ is a correlation along a ray.

As λ goes from red to blue, (u, v)/λ runs along a ray of the frequency plane, over one octave. The table holds the power
spectrum on rays, at nodes of equal ratios along them, each the integral of the spectrum under a quadratic B-spline in
ln t, t = |(u, v)|/λ. A colour is then a sum over an octave's nodes, with colour weights that are the projection of the
colour curves on the same splines, however many orders the ray passes. Between rays the table is a quadratic spline,
too; there are as many rays as the top of an octave needs.
"""

import functools
import types
from typing import Any

import warp as wp

from warpdiff.kernels import spectral

OPTIONS = spectral.OPTIONS
# Taps on either side of the filter that turns samples into spline coefficients: the factor −0.17 to the sixth is 3e-5.
_FILTER_REACH = 6


@wp.struct
class ColourWeights:
    """Projections of the colour curves on the splines, for positions between two nodes."""

    weights: wp.array2d(dtype=wp.vec3f)  # (fractions, nodes)


@functools.cache
def lookup(lanes: int) -> types.SimpleNamespace:
    """The struct of a table whose rows have ``lanes`` terms, and the kernels that do not depend on where it comes from.

    Returns:
        A namespace with the type ``row``, the struct ``Polar`` and the kernels ``interpolate`` and ``integrate``.
    """
    row_t = wp.types.vector(length=lanes, dtype=wp.float32)

    @wp.struct
    class Polar:
        rows: wp.array(dtype=row_t)  # octave after octave, ray after ray, node after node
        basis: wp.array(dtype=row_t)  # at equal ratios of |κ|
        firsts: wp.array(dtype=wp.int32)  # the first ray of each octave, and the number of all
        rays: wp.array(dtype=wp.int32)  # rays of each octave
        nodes: wp.int32  # nodes an octave
        per_log: wp.float64  # nodes per unit of ln t
        log_low: wp.float64  # ln t of the first node
        log_red: wp.float64  # ln(1/λ) of the red end
        least_uv: wp.float64  # below this |(u, v)| the spectrum is flat
        log_kappa: wp.float64  # ln |κ| of the basis' first entry
        entries: wp.int32  # entries of the basis from one node to the next

    @wp.func
    def cyclic(index: wp.int32, count: wp.int32) -> wp.int32:
        """An index at most one turn off."""
        if index < 0:
            return index + count
        if index >= count:
            return index - count
        return index

    @wp.kernel(module="unique", module_options=OPTIONS)
    def interpolate(
        # In:
        polar: Polar,
        octave: wp.int32,
        first: wp.int32,
        # Out:
        rows_out: wp.array(dtype=row_t),
    ):
        """Coefficients of the quadratic spline between an octave's rays that passes through their values."""
        ray = first + wp.tid()
        start = polar.firsts[octave]
        count = polar.rays[octave]
        for k in range(polar.nodes):
            factor = wp.float32(wp.static(2.0**0.5))
            total = factor * polar.rows[(start + ray) * polar.nodes + k]
            for away in range(1, wp.static(_FILTER_REACH + 1)):
                factor = factor * wp.static(2.0 * 2.0**0.5 - 3.0)
                after = start + cyclic(ray + away, count)
                before = start + cyclic(ray - away, count)
                total += factor * (polar.rows[after * polar.nodes + k] + polar.rows[before * polar.nodes + k])
            rows_out[(start + ray) * polar.nodes + k] = total

    @wp.kernel(module="unique", module_options=OPTIONS)
    def integrate(
        # In:
        polar: Polar,
        deflections: wp.array(dtype=wp.vec3d),
        gains: wp.array(dtype=wp.float32),
        colours: ColourWeights,
        first: wp.int32,
        # Out:
        xyz_out: wp.array(dtype=wp.vec3f),
    ):
        """Add the XYZ of each direction to ``xyz_out``."""
        i = first + wp.tid()
        gain = gains[i]
        if gain > 0.0:
            deflection = deflections[i]
            u = deflection[0]
            v = deflection[1]
            log_uv = wp.log(wp.max(wp.sqrt(u * u + v * v), polar.least_uv))
            turns = wp.float32(wp.atan2(v, u)) * wp.float32(0.5 / wp.PI)
            if turns < 0.0:
                turns = turns + 1.0
            place = (log_uv + polar.log_red - polar.log_low) * polar.per_log
            nearest = wp.int32(wp.rint(place))
            node = nearest - 1
            fractions = colours.weights.shape[0]
            fraction = wp.int32((wp.float32(place - wp.float64(nearest)) + 0.5) * wp.float32(fractions))
            fraction = wp.clamp(fraction, 0, fractions - 1)
            # Nodes and the basis' entries are at equal ratios: the distance to an entry is the same at all of them.
            log_kappa = wp.log(-deflection[2]) - log_uv + polar.log_low - polar.log_kappa
            entry = (log_kappa * polar.per_log + wp.float64(node)) * wp.float64(polar.entries)
            entry = wp.max(entry, wp.float64(0.0))
            at = wp.int32(entry)
            t = wp.float32(entry - wp.float64(at))
            last = polar.basis.shape[0] - 2
            colour = wp.vec3f()
            k = wp.int32(0)
            count = colours.weights.shape[1]
            octave = node // polar.nodes
            while k < count:
                rays = polar.rays[octave]
                position = turns * wp.float32(rays)
                ray = wp.int32(wp.rint(position))
                f = position - wp.float32(ray)
                w0 = 0.5 * (0.5 - f) * (0.5 - f)
                w1 = 0.75 - f * f
                w2 = 0.5 * (0.5 + f) * (0.5 + f)
                offset = node - octave * polar.nodes
                start = polar.firsts[octave]
                r0 = (start + cyclic(ray - 1, rays)) * polar.nodes + offset
                r1 = (start + cyclic(ray, rays)) * polar.nodes + offset
                r2 = (start + cyclic(ray + 1, rays)) * polar.nodes + offset
                end = wp.min(count - k, polar.nodes - offset)
                for m in range(end):
                    row = w0 * polar.rows[r0 + m] + w1 * polar.rows[r1 + m] + w2 * polar.rows[r2 + m]
                    here = wp.min(at, last)
                    power = wp.dot(row, (1.0 - t) * polar.basis[here] + t * polar.basis[here + 1])
                    colour += wp.max(power, 0.0) * colours.weights[fraction, k + m]
                    at = at + polar.entries
                k = k + end
                node = node + end
                octave = octave + 1
            # Projected colour curves have shallow negative lobes.
            xyz_out[i] = xyz_out[i] + gain * wp.max(colour, wp.vec3f())

    return types.SimpleNamespace(row=row_t, Polar=Polar, interpolate=interpolate, integrate=integrate)


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
        rows_out: wp.array(dtype=out_t),
    ):
        """Integrals of the power spectrum along a ray of an octave under the splines of its nodes.

        The spectrum is sampled ``divisions`` times from node to node, up to the frequency ``highest``.
        """
        ray = first + wp.tid()
        angle = wp.float64(2.0 * wp.PI) * wp.float64(ray) / wp.float64(polar.rays[octave])
        cosine = wp.cos(angle) * table.length_x
        sine = wp.sin(angle) * table.length_y
        share = wp.float32(1.0) / wp.float32(divisions)
        scale = share / wp.float32(polar.per_log)
        begin = (polar.firsts[octave] + ray) * polar.nodes
        for k in range(polar.nodes):
            rows_out[begin + k] = out_t()
        # A node's spline begins one and a half nodes before it.
        for k in range((polar.nodes + 2) * divisions):
            node = k // divisions - 1
            f = (wp.float32(k - (node + 1) * divisions) + 0.5) * share - 0.5
            place = wp.float64(octave * polar.nodes + node) + wp.float64(f)
            t = wp.exp(polar.log_low + place / polar.per_log)
            if t <= highest:
                value = scale * power_row(table, t * sine, t * cosine, bases)
                if node > 0:
                    rows_out[begin + node - 1] += (0.5 * (0.5 - f) * (0.5 - f)) * value
                if node >= 0 and node < polar.nodes:
                    rows_out[begin + node] += (0.75 - f * f) * value
                if node + 1 < polar.nodes:
                    rows_out[begin + node + 1] += (0.5 * (0.5 + f) * (0.5 + f)) * value

    return resample
