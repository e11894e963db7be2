"""Colour look-up: kernels of a table that holds the integral over λ for every (u, v) and function of w.

As λ goes from red to blue, (u, v)/λ runs over one octave of an azimuth of the frequency plane. The power spectrum is
taken on azimuths, at rings of equal ratios along them, each the integral of the spectrum under a quadratic B-spline in
ln t, t = |(u, v)|/λ. A colour is then a sum over one octave's rings, with weights that are the projection of the colour
curves on the same splines, however many orders the azimuth passes. Where |(u, v)| takes the same ratios, these weights
are the same at every ring, and w comes in through a few functions that all share: the sum is done beforehand, and what
is left of a colour is a spline between rings and azimuths, and a scalar product with the functions at w.

A pixel sees a range of (u, v). Powers add, so that its mean is a spectrum blurred by the same angle and the same ratio
at all wavelengths: levels of the table are blurred in angle, with fewer azimuths, and in ratio look-ups take more
rings. A source does the same to the lines of an endless surface.
"""

import functools
import math
import types

import warp as wp

from warpdiff.kernels import compile_options, quadratic_spline
from warpdiff.kernels.indices import cyclic
from warpdiff.kernels.structs import Footprint

# Loops are not unrolled, which shortens compilation.
OPTIONS = compile_options.options(max_unroll=1)
_LOOKUP_OPTIONS = compile_options.options("point_lookup.h", "footprint_lookup.h", max_unroll=1)
# Half of the largest number of azimuths, or rings, that a look-up sums by the tables of weights. As many azimuths are
# repeated at either end of a turn. Limit: twice as many double the size of the tables of weights.
HALF_TAPS = 7
# Largest number of directions that a thread of the CPU looks up in one call. Limit: size of local arrays.
BATCH = 256
# Number of directions ahead of the present one whose rows are requested from memory.
_AHEAD = 3
# Taps on either side of the filter that turns samples into spline coefficients: the factor −0.17 to the sixth is 3e-5.
FILTER_REACH = 6
_FILTER = wp.types.vector(length=FILTER_REACH + 1, dtype=wp.float32)(
    *quadratic_spline.prefilter(FILTER_REACH)[FILTER_REACH:]
)
# Number of rows that a blur adds at a time.
_TAPS = 8
_FILTER_OPTIONS = compile_options.options(max_unroll=2 * FILTER_REACH + 1)
# Largest number of parts of a footprint along its angle. Limit: each part takes time.
MOST_PARTS = 12
# Rings of the table within this number of standard deviations contribute to a wide blur.
DEVIATIONS = 3.0


@wp.struct
class FootprintTaps:
    """Weights of the azimuths, or rings, around a place: the spline between them, blurred by part of the footprint."""

    weights: wp.array3d(dtype=wp.float32)  # (variances, fractions, 2 HALF_TAPS)
    lengths: wp.array(dtype=wp.int32)  # how many of them count, from the first one on
    per_variance: wp.float32  # entries per unit of the variance, in distances of azimuths squared
    parts: wp.array3d(dtype=wp.float32)  # for 1, 2, … of them: the variance within, then places and weights


@wp.func
def spline(away: wp.float32) -> wp.vec3f:
    """Weights of three neighbours by the quadratic B-spline, a place away from the middle one."""
    return wp.vec3f(0.5 * (0.5 - away) * (0.5 - away), 0.75 - away * away, 0.5 * (0.5 + away) * (0.5 + away))


@wp.func
def gaussian(away: wp.float32, variance: wp.float32) -> wp.float32:
    """1 in the middle."""
    return wp.exp(-0.5 * away * away / variance)


def variance_before(deviations: float) -> float:
    """Variance of a normal distribution that has one of 1 once it is cut so far out."""
    variance = 1.0
    for _ in range(20):
        end = deviations / math.sqrt(variance)
        within = math.erf(end / math.sqrt(2.0))
        variance = 1.0 / (1.0 - math.sqrt(2.0 / math.pi) * end * math.exp(-0.5 * end * end) / within)
    return variance


@functools.cache
def lookup(w_basis_size: int, source: bool = False) -> types.SimpleNamespace:
    """The struct of a colour table with so many functions of w, and the kernels that do not depend on its making.

    Args:
        w_basis_size: Number of functions of w.
        source: Whether rows are lines under a source; otherwise a spectrum under a window.

    Returns:
        A namespace with the type ``row``, the struct ``Colours`` and the kernels ``interpolate``, ``blur`` and
        ``integrate``.
    """
    width = 3 * w_basis_size
    row_t = wp.types.vector(length=width, dtype=wp.float32)
    w_basis_t = wp.types.vector(length=w_basis_size, dtype=wp.float32)
    starts_t = wp.types.vector(length=max(2 * FILTER_REACH + 1, _TAPS), dtype=wp.int32)
    weights_t = wp.types.vector(length=_TAPS, dtype=wp.float32)

    @wp.struct
    class Colours:
        rows: wp.array(dtype=row_t)  # X, Y, Z: level, octave, azimuth and ring, slowest first
        w_basis: wp.array(dtype=w_basis_t)  # at equal steps in |w|
        least_w: wp.float32  # |w| of the first of them
        per_w: wp.float32  # entries per unit of |w|
        first_rows: wp.array2d(dtype=wp.int32)  # (levels, octaves), the row of azimuth 0
        azimuths: wp.array2d(dtype=wp.int32)  # (levels, octaves), number of azimuth samples
        blurs: wp.array2d(dtype=wp.float32)  # (levels, octaves), what they are blurred by [rad]
        rings_per_octave: wp.int32
        rings_per_log: wp.float32  # rings per unit of ln |(u, v)|
        octaves_per_ring: wp.float32  # octaves a ring
        decimation_scale: wp.float32  # what of colours is sharper than the curves, per ring; see ``colour_table``
        ring_of_one: wp.float32  # the ring where |(u, v)| is 1
        least_uv: wp.float32  # below this |(u, v)| the spectrum is flat
        lobe_uv: wp.float32  # of a single coefficient's lobe in |(u, v)|, at a middle wavelength
        zeroth_order: wp.array(dtype=wp.float32)  # the power of its coefficient, which rows leave out, by |κ|
        least_kappa: wp.float32  # |κ| of the first of them
        per_kappa: wp.float32  # entries per unit of |κ|
        lobe2: wp.float32  # variance of its lobe in frequency; 0 for a source
        wavenumbers: wp.array(dtype=wp.float32)  # for its integral over λ
        weights: wp.array(dtype=wp.vec3f)
        reflectances: wp.array2d(dtype=wp.float32)  # R of a material at these, by cos θd from 0 to 1; empty is 1
        line_blurs2: wp.array(dtype=wp.float32)  # of a source's lines, by octave: variance of their own blur [rad²]
        spread2: wp.float32  # of a source: the variance s² of (u, v) across its direction
        inner_radius2: wp.float32  # of a source: below this |(u, v)|² directions are unserved

    # The second index avoids a second compiled variant: see ``light_samples``.
    @wp.kernel(module="unique", module_options=_FILTER_OPTIONS)
    def interpolate(
        # In:
        values: wp.array(dtype=row_t), table: Colours, level: wp.int32, octave: wp.int32, first: wp.int32,
        run: wp.int32,
        # Out:
        rows_out: wp.array(dtype=row_t),
    ):  # fmt: skip
        """Coefficients of the quadratic spline that passes through one octave's values, and those beyond a turn.

        Sums over as many azimuths on either side as the powers of the spline's pole count.
        """
        thread, _ = wp.tid()
        rings = table.rings_per_octave
        azimuths = table.azimuths[level, octave]
        for k in range(run):
            azimuth = first + thread * run + k - wp.static(HALF_TAPS)
            at = table.first_rows[level, octave] + azimuth * rings
            starts = starts_t()
            for j in range(wp.static(2 * FILTER_REACH + 1)):
                starts[j] = cyclic(azimuth + j - wp.static(FILTER_REACH), azimuths) * rings
            for ring in range(rings):
                total = wp.static(_FILTER[0]) * values[starts[wp.static(FILTER_REACH)] + ring]
                for j in range(1, wp.static(FILTER_REACH + 1)):
                    before = values[starts[wp.static(FILTER_REACH) - j] + ring]
                    total += wp.static(_FILTER)[j] * (before + values[starts[wp.static(FILTER_REACH) + j] + ring])
                rows_out[at + ring] = total

    @wp.kernel(module="unique", module_options=_FILTER_OPTIONS)
    def blur(
        # In:
        table: Colours, source: wp.int32, level: wp.int32, octave: wp.int32, first: wp.int32, run: wp.int32,
        # Out:
        values_out: wp.array(dtype=row_t),
    ):  # fmt: skip
        """Values on the azimuths of a level: a Gaussian around each of another level's coefficients.

        Their spline itself has a variance of a quarter of the distance of azimuths, squared.
        """
        thread, _ = wp.tid()
        rings = table.rings_per_octave
        azimuths = table.azimuths[source, octave]
        spacing = wp.float32(2.0 * wp.PI) / wp.float32(azimuths)
        level_blur = table.blurs[level, octave]
        source_blur = table.blurs[source, octave]
        variance = (level_blur * level_blur - source_blur * source_blur) / (spacing * spacing) + 0.25
        half_taps = wp.min(wp.int32(wp.ceil(4.5 * wp.sqrt(variance))), azimuths // 2)
        for k in range(run):
            azimuth = first + thread * run + k
            place = wp.float32(azimuth) / wp.float32(table.azimuths[level, octave]) * wp.float32(azimuths)
            nearest = wp.int32(wp.rint(place))
            total = wp.float32(0.0)
            for j in range(-half_taps, half_taps + 1):
                total += gaussian(wp.float32(nearest + j) - place, variance)
            for ring in range(rings):
                values_out[azimuth * rings + ring] = row_t()
            # A few at a time, as what is written is read again.
            starts = starts_t()
            weights = weights_t()
            for begin in range(-half_taps, half_taps + 1, wp.static(_TAPS)):
                for i in range(wp.static(_TAPS)):
                    at = nearest + begin + i
                    starts[i] = table.first_rows[source, octave] + cyclic(at, azimuths) * rings
                    weights[i] = wp.where(
                        begin + i <= half_taps, gaussian(wp.float32(at) - place, variance) / total, wp.float32(0.0)
                    )
                for ring in range(rings):
                    total_of_ring = values_out[azimuth * rings + ring]
                    for i in range(wp.static(_TAPS)):
                        total_of_ring += weights[i] * table.rows[starts[i] + ring]
                    values_out[azimuth * rings + ring] = total_of_ring

    @wp.func_native(
        f"warpdiff::look_up_points<{w_basis_size}, {BATCH}, {_AHEAD}>(table, scattering_vectors, gains, begin, end, "
        "xyz_out);"
    )
    def look_up_points(
        table: Colours, scattering_vectors: wp.array(dtype=wp.vec3d), gains: wp.array(dtype=wp.float32),
        begin: wp.int32, end: wp.int32, xyz_out: wp.array(dtype=wp.vec3f),
    ):  # fmt: skip
        """Add the XYZ of a run of scattering vectors times their gains."""

    @wp.func_native(
        f"warpdiff::look_up_footprints<{w_basis_size}, {str(source).lower()}, {BATCH}, {MOST_PARTS}>(table, taps, "
        f"{{{DEVIATIONS}f, {1.0 / variance_before(DEVIATIONS):.8f}f}}, scattering_vectors, to_lights, gains, "
        "footprints, begin, end, unserved_gain, xyz_out);"
    )
    def look_up_footprints(
        table: Colours, scattering_vectors: wp.array(dtype=wp.vec3d), to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32), footprints: wp.array(dtype=Footprint), taps: FootprintTaps, begin: wp.int32,
        end: wp.int32, unserved_gain: wp.array(dtype=wp.float32), xyz_out: wp.array(dtype=wp.vec3f),
    ):  # fmt: skip
        """Add the mean XYZ over footprints and the source of a run of scattering vectors times their gains."""

    @wp.kernel(module="unique", module_options=_LOOKUP_OPTIONS)
    def integrate(
        # In:
        table: Colours, scattering_vectors: wp.array(dtype=wp.vec3d), to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32), footprints: wp.array(dtype=Footprint), taps: FootprintTaps, run: wp.int32,
        first: wp.int32,
        # Out:
        unserved_gain: wp.array(dtype=wp.float32), xyz_out: wp.array(dtype=wp.vec3f),
    ):  # fmt: skip
        """Add the XYZ of ``run`` directions per thread to ``xyz_out``; an empty array of footprints stands for none.

        Of a source, directions that the table does not serve are skipped, and ``unserved_gain`` holds their
        gains, others' are 0.
        """
        begin = (first + wp.tid()) * run
        end = wp.min(begin + run, gains.shape[0])
        if wp.static(source):
            look_up_footprints(
                table, scattering_vectors, to_lights, gains, footprints, taps, begin, end, unserved_gain, xyz_out
            )
        elif footprints.shape[0] > 0:
            look_up_footprints(
                table, scattering_vectors, to_lights, gains, footprints, taps, begin, end, unserved_gain, xyz_out
            )
        else:
            look_up_points(table, scattering_vectors, gains, begin, end, xyz_out)

    return types.SimpleNamespace(
        row=row_t, w_basis=w_basis_t, Colours=Colours, interpolate=interpolate, blur=blur, integrate=integrate
    )
