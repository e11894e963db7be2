"""Reference implementation of the native table look-ups in plain Warp: one pixel at a time, slow but readable.

The native look-ups in ``native/point_lookup.h`` and ``native/footprint_lookup.h`` compute the same results for several
pixels at once, with series instead of logarithms, exponentials and arc tangents.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer. w is its component along the normal.

A footprint is the range of (u, v) that a pixel covers, as a Gaussian. A colour table has rings of constant |(u, v)|,
and equally spaced azimuth samples on each ring. A row of the table has the coefficients of one azimuth sample: XYZ is
their sum, weighted by basis functions of w. Rows of higher mip levels are blurred along the rings, and have fewer
azimuth samples.
"""

import functools
import math
from typing import Any

import warp as wp

from warpdiff.kernels import colour_lookup
from warpdiff.kernels.compile_options import options
from warpdiff.kernels.indices import cyclic
from warpdiff.kernels.structs import Footprint

# Constants of the approximations for footprints, which are the ranges of (u, v) that pixels cover.
# ``kernels/native/footprint_lookup.h`` has equal constants and explains them.
WIDE = wp.constant(wp.float32(0.25))
MOST_TURN = wp.constant(wp.float32(0.1))
WIDEST_ANGLE = wp.constant(wp.float32(0.5))
WIDEST_RATIO = wp.constant(wp.float32(0.35))
MOST_TABULATED = wp.constant(wp.float32(1.5))
MOST_APART = wp.constant(wp.float32(1.5))
CURVES = wp.constant(wp.float32(0.047))
DEVIATIONS = wp.constant(wp.float32(colour_lookup.DEVIATIONS))
CUT_PER_VARIANCE = wp.constant(wp.float32(1.0 / colour_lookup.variance_before(colour_lookup.DEVIATIONS)))
# Constants that choose the rings to sum over. A ring is a circle of constant |(u, v)| in a table of colours.
# ``kernels/native/ring_sum.h`` has equal constants and explains them.
OUTWARDS, INWARDS = wp.constant(wp.float32(3.2)), wp.constant(wp.float32(4.5))
RINGS_APART, RINGS_PER_DEVIATION = wp.constant(wp.float32(0.1)), wp.constant(wp.float32(1.2))
WITHIN = wp.constant(wp.float32(0.5))
INNERMOST, INNERMOST_OF_LOBE = wp.constant(wp.float32(0.1)), wp.constant(wp.float32(0.3))
NARROWEST = wp.constant(wp.float32(0.3))
MOST_BLUR2, AZIMUTHS_APART = wp.constant(wp.float32(0.7)), wp.constant(wp.float32(1.0))
LEAST_LEFT = wp.constant(wp.float32(1.0 - 1.2 * 0.7))
LOG_2 = wp.constant(wp.float32(math.log(2.0)))


@wp.func
def turns_of(u: wp.float32, v: wp.float32) -> wp.float32:
    """Return the azimuth of (u, v) in turns, from 0 to 1."""
    turns = wp.atan2(v, u) / (2.0 * wp.PI)
    if turns < 0.0:
        turns += 1.0
    return turns


@functools.cache
def lookup(w_basis_size: int, source: bool = False) -> Any:
    """Return a kernel with the same arguments as ``colour_lookup.lookup(w_basis_size, source).integrate``."""
    fast = colour_lookup.lookup(w_basis_size, source)
    Colours, FootprintTaps, row_t, w_basis_t = fast.Colours, colour_lookup.FootprintTaps, fast.row, fast.w_basis  # noqa: N806
    # Vector type for weighted sums of rows of the colour table, with the sum of the weights as its last element.
    row_w_t = wp.types.vector(length=3 * w_basis_size + 1, dtype=wp.float32)

    @wp.func
    def row_at(table: Colours, level: wp.int32, azimuth: wp.int32, ring: wp.int32) -> row_t:
        """Return the coefficients (row) of the table at one mip level, azimuth index and ring index."""
        octave = ring // table.rings_per_octave
        first = table.first_rows[level, octave] + azimuth * table.rings_per_octave
        return table.rows[first + ring - octave * table.rings_per_octave]

    @wp.func
    def ring_of(table: Colours, u: wp.float32, v: wp.float32) -> wp.float32:
        """Return the fractional ring index of (u, v); rings are spaced evenly in ln |(u, v)|."""
        size = wp.max(wp.sqrt(u * u + v * v), table.least_uv)
        return wp.log(size) * table.rings_per_log + table.ring_of_one

    @wp.func
    def w_basis_at(table: Colours, w: wp.float32) -> w_basis_t:
        """Return the basis functions of w at |w|, by cubic interpolation between four of their tabulated values."""
        steps = wp.max((w - table.least_w) * table.per_w, 0.0)
        entry = wp.clamp(wp.int32(steps) - 1, 0, table.w_basis.shape[0] - 4)
        t = steps - wp.float32(entry) - 1.0
        return (
            -t * (1.0 - t) * (2.0 - t) / 6.0 * table.w_basis[entry]
            + (t + 1.0) * (1.0 - t) * (2.0 - t) / 2.0 * table.w_basis[entry + 1]
            + (t + 1.0) * t * (2.0 - t) / 2.0 * table.w_basis[entry + 2]
            - (t + 1.0) * t * (1.0 - t) / 6.0 * table.w_basis[entry + 3]
        )

    @wp.func
    def colour_of(table: Colours, row_sum: row_t, w: wp.float32) -> wp.vec3f:
        """Return XYZ from a sum of table rows (coefficients) at the component w of the scattering vector.

        Splines can give slightly negative results, which become 0.
        """
        at_w = w_basis_at(table, w)
        result = wp.vec3f()
        for c in range(3):
            for k in range(wp.static(w_basis_size)):
                result[c] += row_sum[c * wp.static(w_basis_size) + k] * at_w[k]
            result[c] = wp.max(result[c], 0.0)
        return result

    @wp.func
    def zeroth_order(
        table: Colours, u: wp.float32, v: wp.float32, w: wp.float32, covariance: wp.mat22f, source2: wp.float32
    ) -> wp.vec3f:
        """Return the mean XYZ of the zeroth order over a Gaussian of (u, v): a sum of one Gaussian per wavelength."""
        result = wp.vec3f()
        entries = table.zeroth_order.shape[0]
        if entries == 0:
            return result
        for k in range(table.wavenumbers.shape[0]):
            tau = table.wavenumbers[k]
            lobe2 = table.lobe2 / (tau * tau)
            whole = covariance + lobe2 * wp.identity(2, dtype=wp.float32)
            determinant = wp.determinant(whole)
            exponent = (whole[1, 1] * u * u - 2.0 * whole[0, 1] * u * v + whole[0, 0] * v * v) / determinant
            if determinant > 0.0 and exponent < 48.0:
                steps = wp.max((w * tau - table.least_kappa) * table.per_kappa, 0.0)
                entry = wp.clamp(wp.int32(steps), 0, entries - 2)
                t = steps - wp.float32(entry)
                power = (1.0 - t) * table.zeroth_order[entry] + t * table.zeroth_order[entry + 1]
                size = power * (lobe2 + source2) / wp.sqrt(determinant) * wp.exp(-0.5 * exponent)
                result += size * table.weights[k]
        return result

    @wp.func
    def point(table: Colours, u: wp.float32, v: wp.float32, w: wp.float32) -> wp.vec3f:
        """Return the colour of one direction, by splines over three rings and over three azimuth samples per ring."""
        octaves = table.azimuths.shape[1]
        place = wp.min(ring_of(table, u, v), wp.float32(octaves * table.rings_per_octave - 2))
        middle = wp.int32(wp.rint(place))
        ring_weights = colour_lookup.spline(place - wp.float32(middle))
        row_sum = row_t()
        for m in range(3):
            ring = middle - 1 + m
            octave = ring // table.rings_per_octave
            position = turns_of(u, v) * wp.float32(table.azimuths[0, octave])
            azimuth = wp.int32(wp.rint(position))
            azimuth_weights = colour_lookup.spline(position - wp.float32(azimuth))
            for j in range(3):
                row_sum += ring_weights[m] * azimuth_weights[j] * row_at(table, 0, azimuth - 1 + j, ring)
        return colour_of(table, row_sum, w)

    @wp.func
    def to_polar(table: Colours, u: wp.float32, v: wp.float32, covariance: wp.mat22f) -> wp.mat22f:
        """Return the covariance of the azimuth and of ln |(u, v)|, to first order in the covariance of (u, v)."""
        uv2 = wp.max(u * u + v * v + table.lobe_uv * table.lobe_uv, table.least_uv * table.least_uv)
        across = wp.vec2f(-v, u) / uv2
        along = wp.vec2f(u, v) / uv2
        both = wp.dot(across, covariance * along)
        angle2 = wp.max(wp.dot(across, covariance * across), 0.0)
        ratio2 = wp.max(wp.dot(along, covariance * along), 0.0)
        return wp.mat22f(angle2, both, both, ratio2)

    @wp.func
    def sum_of_azimuths(
        table: Colours, taps: FootprintTaps, ring: wp.int32, turns: wp.float32, angle2: wp.float32, level_of: wp.float32
    ) -> row_t:
        """Return the mean of the table rows of one ring over a Gaussian of azimuths with the variance ``angle2``.

        The rows are those of the last mip level whose blur has at most the variance ``level_of``.
        """
        octave = ring // table.rings_per_octave
        line2 = wp.float32(0.0)
        if wp.static(source):
            line2 = table.line_blurs2[octave]
        # The standard deviation of the blur doubles from each mip level to the next.
        first = table.blurs[1, octave]
        level = wp.int32(wp.floor(0.5 * wp.log2(wp.max(level_of - line2, 1.0e-30) / (first * first)))) + 1
        level = wp.clamp(level, 0, table.azimuths.shape[0] - 1)
        azimuths = table.azimuths[level, octave]
        spacing = 2.0 * wp.PI / wp.float32(azimuths)
        left2 = (angle2 - table.blurs[level, octave] * table.blurs[level, octave] - line2) / (spacing * spacing)
        step = wp.int32(wp.max(left2 * taps.per_variance + 0.5, 0.0))
        step = wp.min(step, taps.weights.shape[0] - 1)
        count = taps.lengths[step]
        start = turns * wp.float32(azimuths) - 0.5 * wp.float32(count - 1)
        azimuth = wp.int32(wp.rint(start))
        fractions = taps.weights.shape[1]
        fraction = wp.int32((start - wp.float32(azimuth) + 0.5) * wp.float32(fractions))
        fraction = wp.clamp(fraction, 0, fractions - 1)
        result = row_t()
        for j in range(count):
            at = cyclic(azimuth + j, azimuths)
            result += taps.weights[step, fraction, j] * row_at(table, level, at, ring)
        return result

    @wp.func
    def part(
        table: Colours, taps: FootprintTaps, u: wp.float32, v: wp.float32, w: wp.float32, polar: wp.mat22f
    ) -> wp.vec3f:
        """Return the mean colour over a Gaussian in ln |(u, v)| and azimuth, which may be correlated."""
        # For wide footprints, the approximation by a Gaussian in ln |(u, v)| and azimuth is inaccurate. The two
        # standard deviations of this Gaussian are therefore limited.
        turn_share = wp.min(WIDEST_ANGLE / wp.sqrt(wp.max(polar[0, 0], 1.0e-12)), 1.0)
        ratio_share = wp.min(WIDEST_RATIO / wp.sqrt(wp.max(polar[1, 1], 1.0e-12)), 1.0)
        angle2 = polar[0, 0] * turn_share * turn_share
        ratio2 = polar[1, 1] * ratio_share * ratio_share
        both = polar[0, 1] * turn_share * ratio_share
        # The centre of the footprint is the mean of ln |(u, v)|, correct to second order in the standard deviations of
        # the footprint.
        place = ring_of(table, u, v) + 0.5 * (angle2 - ratio2) * table.rings_per_log
        variance = ratio2 * table.rings_per_log * table.rings_per_log + 0.25
        deviation = wp.sqrt(variance)
        turn_per_ring = both * table.rings_per_log / variance
        aside2 = wp.max(angle2 - turn_per_ring * both * table.rings_per_log, 0.0)
        per_log = table.rings_per_log
        skew = -0.5 * ratio2 * ratio2 * per_log * per_log * per_log / (variance * deviation)

        octaves = table.azimuths.shape[1]
        spacing = table.blurs[1, wp.clamp(wp.int32(place * table.octaves_per_ring), 0, octaves - 1)]
        across2 = aside2 + spacing * spacing
        if wp.static(source):
            across2 = aside2 + 1.0e-12
        curves = CURVES * table.rings_per_log
        sharp = wp.sqrt(1.0 / (curves * curves) + turn_per_ring * turn_per_ring / across2 + 1.0 / variance)
        most = MOST_APART / (sharp + table.decimation_scale)
        apart = wp.int32(1)
        while apart < 8 and wp.float32(2 * apart) <= most:
            apart = 2 * apart

        # Narrow footprints use tabulated ring weights. Wide footprints use a truncated Gaussian.
        tabulated = variance < MOST_TABULATED + 0.25
        step = wp.int32(0)
        half = DEVIATIONS * deviation
        first = wp.int32(wp.ceil(place - half))
        end = wp.int32(wp.floor(place + half)) + 1
        fraction = wp.int32(0)
        if tabulated:
            step = wp.int32((variance - 0.25) * taps.per_variance + 0.5)
            start = place - 0.5 * wp.float32(taps.lengths[step] - 1)
            first = wp.int32(wp.rint(start))
            end = first + taps.lengths[step]
            fractions = taps.weights.shape[1]
            fraction = wp.clamp(wp.int32((start - wp.float32(first) + 0.5) * wp.float32(fractions)), 0, fractions - 1)
        row_sum = row_t()
        total = wp.float32(0.0)
        begin = (wp.max(first, 0) + apart - 1) // apart * apart
        for ring in range(begin, wp.min(end, octaves * table.rings_per_octave), apart):
            t = (wp.float32(ring) - place) / deviation
            weight = wp.exp(-0.5 * CUT_PER_VARIANCE * t * t) * wp.max(1.0 + skew * t * (t * t - 3.0), 0.0)
            if tabulated:
                weight = taps.weights[step, fraction, ring - first]
            # A footprint of constant width in (u, v) covers a smaller angle at a larger radius, and therefore fewer
            # azimuth samples.
            nearer = wp.exp(-(wp.float32(ring) - place) / table.rings_per_log + 0.5 * ratio2)
            turns = turns_of(u, v) + turn_per_ring * table.rings_per_log * (1.0 - nearer) / (2.0 * wp.PI)
            row_sum += weight * sum_of_azimuths(table, taps, ring, turns, aside2 * nearer * nearer, aside2)
            total += weight
        if tabulated:
            total = wp.float32(1.0)
        return colour_of(table, row_sum, w) / wp.max(total, 1.0e-6)

    @wp.func
    def on_ring(
        table: Colours, ring: wp.int32, level: wp.int32, from_middle: wp.vec2f, inverse: wp.mat22f,
        most_blur2: wp.float32,
    ) -> row_w_t:  # fmt: skip
        """Return the sum of the table rows of one ring, weighted by a Gaussian of (u, v).

        The rows are blurred along the ring already. The variance of this blur is subtracted from the variance of the
        Gaussian along the ring. The last element of the result is the sum of the weights.
        """
        octave = ring // table.rings_per_octave
        radius = wp.exp((wp.float32(ring) - table.ring_of_one) / table.rings_per_log)
        cutoff = wp.where(radius < wp.length(from_middle), INWARDS, OUTWARDS)
        azimuths = table.azimuths[level, octave]
        spacing = 2.0 * wp.PI / wp.float32(azimuths)
        blur = table.blurs[level, octave]
        # Table rows are spline coefficients, which are sharper than the values of the spline. Their blur therefore has
        # a smaller variance than that of the values.
        blur2 = wp.min(blur * blur - 0.25 * spacing * spacing, most_blur2)
        result = row_w_t()
        for azimuth in range(azimuths):
            angle = wp.float32(azimuth) * spacing
            along = wp.vec2f(wp.cos(angle), wp.sin(angle))
            across = wp.vec2f(-along[1], along[0])
            away = radius * along - from_middle
            slope = radius * wp.dot(across, inverse * away)
            curvature = radius * radius * wp.dot(across, inverse * across) - radius * wp.dot(along, inverse * away)
            left = wp.max(1.0 - blur2 * curvature, LEAST_LEFT)
            exponent = wp.dot(away, inverse * away)
            if exponent < cutoff * cutoff:
                weight = wp.exp(-0.5 * (exponent + slope * slope * blur2 / left)) / wp.sqrt(left)
                weight *= radius * radius * spacing
                row = row_at(table, level, azimuth, ring)
                for k in range(wp.static(3 * w_basis_size)):
                    result[k] += weight * row[k]
                result[wp.static(3 * w_basis_size)] += weight
        return result

    @wp.func
    def over_rings(table: Colours, u: wp.float32, v: wp.float32, w: wp.float32, footprint: wp.mat22f) -> wp.vec3f:
        """Return the mean colour over a wide Gaussian of (u, v): a sum of table rows, weighted by the Gaussian."""
        middle = wp.vec2f(u, v)
        away = wp.length(middle)
        covariance = footprint + 0.25 / (table.rings_per_log * table.rings_per_log) * wp.outer(middle, middle)
        difference = covariance[0, 0] - covariance[1, 1]
        root = wp.sqrt(0.25 * difference * difference + covariance[0, 1] * covariance[0, 1])
        widest2 = 0.5 * wp.trace(covariance) + root
        least = NARROWEST * table.lobe_uv
        narrow2 = wp.max(wp.determinant(covariance) / widest2, least * least)
        axis = 0.5 * wp.atan2(2.0 * covariance[0, 1], difference)
        long = wp.vec2f(wp.cos(axis), wp.sin(axis))
        across = wp.vec2f(-long[1], long[0])
        inverse = wp.outer(long, long) / widest2 + wp.outer(across, across) / narrow2
        outermost = ring_of(table, away + OUTWARDS * wp.sqrt(widest2), 0.0)
        ring = wp.min(wp.int32(outermost), table.azimuths.shape[1] * table.rings_per_octave - 1)
        nearest = wp.min(INNERMOST * wp.sqrt(narrow2), INNERMOST_OF_LOBE * table.lobe_uv)
        innermost = wp.max(wp.max(away - INWARDS * wp.sqrt(widest2), nearest), table.least_uv)
        steepness = wp.sqrt(wp.dot(middle, inverse * middle))
        distance = wp.min(RINGS_APART, RINGS_PER_DEVIATION / wp.max(steepness, 1.0e-20))
        apart = wp.max(wp.int32(distance * table.rings_per_log), 1)
        total = row_w_t()
        level = wp.int32(0)
        radius = wp.exp((wp.float32(ring) - table.ring_of_one) / table.rings_per_log)
        while ring >= 0 and radius > innermost:
            octave = ring // table.rings_per_octave
            variance = narrow2 / (radius * wp.max(radius, away))
            level = wp.max(level - 1, 0)
            serves = wp.bool(True)
            while serves and level + 1 < table.azimuths.shape[0]:
                spacing = 2.0 * wp.PI / wp.float32(table.azimuths[level + 1, octave])
                blur = table.blurs[level + 1, octave]
                serves = (
                    blur * blur - 0.25 * spacing * spacing <= MOST_BLUR2 * variance
                    and spacing * spacing <= AZIMUTHS_APART * AZIMUTHS_APART * variance
                )
                if serves:
                    level += 1
            steps = wp.int32(1)
            if radius < WITHIN * wp.sqrt(narrow2):
                steps = wp.int32(2)
            total += wp.float32(steps) * on_ring(table, ring, level, middle, inverse, MOST_BLUR2 * variance)
            ring -= steps * apart
            radius = wp.exp((wp.float32(ring) - table.ring_of_one) / table.rings_per_log)
        rows = row_t()
        for k in range(wp.static(3 * w_basis_size)):
            rows[k] = total[k] / wp.max(total[wp.static(3 * w_basis_size)], 1.0e-30)
        return colour_of(table, rows, w)

    @wp.func
    def is_unserved(
        table: Colours, u: wp.float32, v: wp.float32, polar: wp.mat22f, within: wp.float32, parts: wp.int32
    ) -> wp.bool:
        """Return whether the colour table cannot give the colour of a direction.

        It cannot if the direction is within the inner radius of the table, or if the footprint is narrower than the
        blur that the rows of the table already have. A footprint may be split along the azimuth into ``parts`` parts.
        Each part has the share ``within`` of the footprint's variance along the azimuth.
        """
        octave = wp.int32(ring_of(table, u, v) * table.octaves_per_ring)
        octave = wp.clamp(octave, 0, table.azimuths.shape[1] - 1)
        over2 = polar[1, 1] + 0.25 / (table.rings_per_log * table.rings_per_log)
        if parts > 1:
            over2 -= (1.0 - within) * polar[0, 1] * polar[0, 1] / polar[0, 0]
        blurred = (within * polar[0, 0] - table.line_blurs2[octave]) * over2
        return u * u + v * v < table.inner_radius2 or blurred < within * within * polar[0, 1] * polar[0, 1]

    @wp.kernel(module="unique", module_options=options(max_unroll=1))
    def integrate(
        # Colour table, directions and footprints, which this kernel reads. A thread processes ``run`` directions.
        table: Colours,
        scattering_vectors: wp.array(dtype=wp.vec3d),
        to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32),
        footprints: wp.array(dtype=Footprint),
        taps: FootprintTaps,
        run: wp.int32,
        first: wp.int32,
        # Results for each direction, written by this kernel: the gain (geometry factor and masking) if the table cannot
        # give the colour, and XYZ.
        unserved_gain: wp.array(dtype=wp.float32),
        xyz_out: wp.array(dtype=wp.vec3f),
    ):
        """Add the XYZ of ``run`` directions per thread to ``xyz_out``.

        If no footprints are used, their array is empty.
        """
        begin = (first + wp.tid()) * run
        for i in range(begin, wp.min(begin + run, gains.shape[0])):
            u = wp.float32(scattering_vectors[i][0])
            v = wp.float32(scattering_vectors[i][1])
            w = wp.float32(-scattering_vectors[i][2])
            covariance = wp.mat22f()
            source2 = wp.float32(0.0)
            if footprints.shape[0] > 0:
                row = wp.vec2f(footprints[i][0], footprints[i][1])
                column = wp.vec2f(footprints[i][2], footprints[i][3])
                covariance += wp.outer(row, row) + wp.outer(column, column)
            if wp.static(source):
                aside = wp.vec2f(to_lights[i][0], to_lights[i][1])
                covariance += table.spread2 * (wp.identity(2, dtype=wp.float32) - wp.outer(aside, aside))
                source2 = table.spread2 * to_lights[i][2]
                unserved_gain[i] = wp.float32(0.0)
            elif footprints.shape[0] == 0:
                if gains[i] > 0.0:
                    colour = point(table, u, v, w)
                    xyz_out[i] += gains[i] * (colour + zeroth_order(table, u, v, w, covariance, 0.0))
                continue
            if not gains[i] > 0.0:
                continue
            uv2 = u * u + v * v + table.lobe_uv * table.lobe_uv
            if not wp.static(source) and wp.trace(covariance) > WIDE * WIDE * uv2:
                xyz_out[i] += gains[i] * zeroth_order(table, u, v, w, covariance, source2)
                xyz_out[i] += gains[i] * over_rings(table, u, v, w, covariance)
                continue
            polar = to_polar(table, u, v, covariance)
            # A footprint that spans a wide range of azimuths is split along the azimuth into narrow parts, whose
            # curvature is negligible.
            whole = wp.sqrt(polar[0, 0])
            count = wp.clamp(wp.int32(wp.ceil(whole / MOST_TURN)), 1, wp.static(colour_lookup.MOST_PARTS))
            uv2 = wp.max(uv2, table.least_uv * table.least_uv)
            along = wp.vec2f()
            if whole > 0.0:
                along = covariance * wp.vec2f(-v, u) / (uv2 * whole)
            within = taps.parts[count - 1, 0, 0]
            if wp.static(source):
                if is_unserved(table, u, v, polar, within, count):
                    unserved_gain[i] = gains[i]
                    continue
            xyz_out[i] += gains[i] * zeroth_order(table, u, v, w, covariance, source2)
            for k in range(count):
                at = wp.vec2f(u, v) + taps.parts[count - 1, 1, k] * along
                share = gains[i] * taps.parts[count - 1, 2, k]
                if wp.static(source):
                    share *= 2.0 * wp.PI * source2
                left = polar
                if count > 1:
                    left = to_polar(table, at[0], at[1], covariance - (1.0 - within) * wp.outer(along, along))
                xyz_out[i] += share * part(table, taps, at[0], at[1], w, left)

    return integrate
