"""Colour look-up: kernels of a table that contains the integral over λ for every (u, v) and function of w.

(u, v, w) is the scattering vector. As λ decreases from red to blue, (u, v)/λ moves outwards along an azimuth (a line of
constant polar angle) of the frequency plane, over one octave. The power spectrum is sampled on azimuths, at rings
(circles) whose radii have equal ratios. The value of a ring is the integral of the spectrum under a quadratic B-spline
in ln t, where t = |(u, v)|/λ. A colour is a weighted sum over the rings of one octave, for any number of orders along
the azimuth. The weights are the coefficients of splines that are fitted to the colour curves: the products of
illuminant, colour-matching function and reflectance. The weights are the same at every radius at which a colour is
computed. The weights depend on w through a few functions, so that the sum is computed in advance for each function. A
look-up interpolates between rings and azimuths, and multiplies by the values of the functions at w.

A pixel covers a range of (u, v). As powers add, the mean colour of the pixel can be computed from a blurred spectrum.
The blur over the polar angle and over the logarithm of the radius is the same at all wavelengths. Mip levels of the
table are blurred over the angle, and have fewer azimuths. A look-up blurs over the radius by adding more rings. The
spectral lines of an endless surface under a light source are blurred by the source in the same way.

κ is w/λ. θd is half of the angle between the directions to the light and to the viewer, so that cos θd = |(u, v, w)|/2.
s is the standard deviation of the directions to a light source.
"""

import functools
import math
import types

import warp as wp

from warpdiff.kernels import compile_options, quadratic_spline
from warpdiff.kernels.indices import cyclic
from warpdiff.kernels.structs import Footprint

# Compile options of this module. Loops are not unrolled, because unrolling makes compilation slower.
OPTIONS = compile_options.options(max_unroll=1)
_LOOKUP_OPTIONS = compile_options.options("point_lookup.h", "footprint_lookup.h", max_unroll=1)
# A look-up adds rows of the colour table at neighbouring azimuths (polar angles of (u, v)), or at neighbouring rings
# (circles of constant |(u, v)|), with tabulated weights. The value is half of the largest number of such rows. Azimuths
# are periodic: this number of azimuths is therefore repeated before the first and after the last one. If it is doubled,
# tables of weights need twice the memory.
HALF_TAPS = 7
# Largest number of directions that a CPU thread looks up in one call. The value is limited by the stack, which has
# arrays of this size.
BATCH = 256
# While a direction is looked up, the table rows of the direction with an index larger by this number are fetched from
# memory. The value was chosen freely, because other numbers change only the computing time.
_AHEAD = 3
# A filter converts the azimuth samples of a ring (circle of constant |(u, v)| in the table) to coefficients of the
# spline through them. Each coefficient is a weighted sum of this number of samples on each side. A sample at a distance
# of n has the weight √2 · (−0.17)ⁿ. The value was chosen so that the weights of samples farther away, which are
# omitted, are at most 6e-6.
FILTER_REACH = 6
_FILTER = wp.types.vector(length=FILTER_REACH + 1, dtype=wp.float32)(
    *quadratic_spline.prefilter(FILTER_REACH)[FILTER_REACH:]
)
# Number of azimuth samples (polar angles of (u, v)) whose colours the kernel `blur` adds in one pass over the rings of
# one octave of |(u, v)|. A ring is a circle of constant |(u, v)|. The value is limited by the size of local vectors.
_TAPS = 8
_FILTER_OPTIONS = compile_options.options(max_unroll=2 * FILTER_REACH + 1)
# Largest number of parts into which the footprint of a pixel is divided if the polar angle of (u, v) changes within the
# footprint. The value is limited by time, which is proportional to the number of parts.
MOST_PARTS = 12
# A wide footprint blurs colours over rings (circles of constant |(u, v)|) by a Gaussian, which is truncated at this
# distance from its centre [standard deviations]. The value is limited by time, which is proportional to it.
DEVIATIONS = 3.0


@wp.struct
class FootprintTaps:
    """Tables of weights with which a look-up adds the colours at azimuths (polar angles), or at rings (radii).

    Each weight is the value of the spline that interpolates between azimuths (or rings), blurred by a Gaussian. Weights
    are tabulated by the variance of this Gaussian.
    """

    # Weights of neighbouring azimuths (polar angles) or rings (radii) in a Gaussian blur. They are tabulated by the
    # variance of the Gaussian, the fractional position between two azimuths or rings, and the azimuth or ring that is
    # added; shape (variances, fractions, 2 HALF_TAPS).
    weights: wp.array3d(dtype=wp.float32)
    lengths: wp.array(dtype=wp.int32)  # number of weights that differ from 0, for each variance
    # Number of tabulated variances per unit of variance. The unit is the squared spacing of the azimuth samples, or of
    # the rings (circles of constant |(u, v)|).
    per_variance: wp.float32
    # The footprint (range of (u, v)) of a pixel may be divided into parts, which are narrower Gaussians. For each
    # number of parts, the array has the variance of a part, and the positions and weights of all parts.
    parts: wp.array3d(dtype=wp.float32)


@wp.func
def spline(away: wp.float32) -> wp.vec3f:
    """Return the weights of three neighbouring samples in a quadratic B-spline, at a position near the middle sample.

    ``away`` is the distance of the position from the middle sample, in spacings of the samples.
    """
    return wp.vec3f(0.5 * (0.5 - away) * (0.5 - away), 0.75 - away * away, 0.5 * (0.5 + away) * (0.5 + away))


@wp.func
def gaussian(away: wp.float32, variance: wp.float32) -> wp.float32:
    """Return the value of a Gaussian at a distance from its centre; the value at the centre is 1."""
    return wp.exp(-0.5 * away * away / variance)


def variance_before(deviations: float) -> float:
    """Return the variance of a normal distribution whose variance is 1 after it is truncated at ±``deviations``."""
    variance = 1.0
    for _ in range(20):
        end = deviations / math.sqrt(variance)
        within = math.erf(end / math.sqrt(2.0))
        variance = 1.0 / (1.0 - math.sqrt(2.0 / math.pi) * end * math.exp(-0.5 * end * end) / within)
    return variance


@functools.cache
def lookup(w_basis_size: int, source: bool = False) -> types.SimpleNamespace:
    """Return the struct and the kernels of colour tables for a number of functions of w.

    Args:
        w_basis_size: Number of functions of w, the normal component of the scattering vector.
        source: Whether the table is for a light source, so that its rows contain line spectra. Otherwise rows contain
            the smooth spectrum under a coherence window.

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
        rows: wp.array(dtype=row_t)  # XYZ by mip level, octave of |(u, v)|, azimuth, ring; the ring changes fastest
        w_basis: wp.array(dtype=w_basis_t)  # functions of w at equal steps in |w|
        least_w: wp.float32  # |w| of the first entry of ``w_basis``
        per_w: wp.float32  # number of entries of ``w_basis`` per unit of |w|
        first_rows: wp.array2d(dtype=wp.int32)  # index of the row at azimuth 0, shape (mip levels, octaves)
        azimuths: wp.array2d(dtype=wp.int32)  # number of azimuth samples per ring, shape (mip levels, octaves)
        # Standard deviation of the blur in angle of the table rows [rad], by mip level and octave of |(u, v)|.
        blurs: wp.array2d(dtype=wp.float32)
        rings_per_octave: wp.int32
        rings_per_log: wp.float32  # number of rings per unit of ln |(u, v)|
        octaves_per_ring: wp.float32  # one over the number of rings per octave of |(u, v)|
        decimation_scale: wp.float32  # large values prevent look-ups from skipping rings, see ``colour_table``
        ring_of_one: wp.float32  # fractional index of the ring at which |(u, v)| would be 1
        least_uv: wp.float32  # the spectrum is constant below this |(u, v)|
        lobe_uv: wp.float32  # standard deviation in (u, v) of a diffraction order's peak, at a middle wavelength
        # Power of the zeroth order by |κ| = |w|/λ. The rows of the table do not contain this order.
        zeroth_order: wp.array(dtype=wp.float32)
        least_kappa: wp.float32  # |κ| of the first entry of ``zeroth_order``
        per_kappa: wp.float32  # number of entries of ``zeroth_order`` per unit of |κ|
        lobe2: wp.float32  # variance of the zeroth order's peak over frequency [1/µm²]; 0 for a source
        wavenumbers: wp.array(dtype=wp.float32)  # 1/λ for the zeroth order's integral over λ [1/µm]
        weights: wp.array(dtype=wp.vec3f)  # colour weights at ``wavenumbers``
        reflectances: wp.array2d(
            dtype=wp.float32
        )  # R of a material at ``wavenumbers``, by cos θd from 0 to 1; R is 1 if the array is empty
        # For a light source of finite size: variance of the angular blur that spectral lines already have in the table
        # [rad²], for each octave of |(u, v)|.
        line_blurs2: wp.array(dtype=wp.float32)
        spread2: wp.float32  # for a source: variance s² of (u, v) perpendicular to the direction of the light
        inner_radius2: wp.float32  # for a source: the table gives no colours for smaller |(u, v)|²
        has_pitch_scales: wp.bool  # for a source: whether the length of a direction to the light is a pitch scale

    # Kernels of this module have a second thread index, which is always 0. Warp then compiles one variant of a kernel
    # instead of two, as explained in ``light_samples``.
    @wp.kernel(module="unique", module_options=_FILTER_OPTIONS)
    def interpolate(
        values: wp.array(dtype=row_t), table: Colours, level: wp.int32, octave: wp.int32, first: wp.int32,
        run: wp.int32,
        rows_out: wp.array(dtype=row_t),
    ):  # fmt: skip
        """Compute the coefficients of the quadratic spline along azimuths, and repeat azimuths at both ends of a ring.

        A ring is a circle of constant |(u, v)|, with azimuth samples. The splines pass through the colours ``values``
        of one octave of |(u, v)|. Each coefficient is a weighted sum of the values at 2 ``FILTER_REACH`` + 1 azimuths
        of the same ring.
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
        table: Colours, source: wp.int32, level: wp.int32, octave: wp.int32, first: wp.int32, run: wp.int32,
        values_out: wp.array(dtype=row_t),
    ):  # fmt: skip
        """Compute the colours of a mip level at its azimuths (polar angles) by a Gaussian blur of a finer level.

        The spline that look-ups use between azimuths is itself a blur. Its variance is a quarter of the squared
        distance between azimuths.
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
            # Each ring (circle of constant |(u, v)|) has a sum over azimuth samples. A pass over the rings reads and
            # writes all these sums. Several samples are therefore added in one pass, which saves memory accesses.
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
        """Add the XYZ of scattering vectors, from ``begin`` to ``end``, times geometry factors (gains)."""

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
        """Add the XYZ of scattering vectors, from ``begin`` to ``end``, times geometry factors (gains).

        Each XYZ is the mean over the footprint of the pixel and over the light source.
        """

    @wp.kernel(module="unique", module_options=_LOOKUP_OPTIONS)
    def integrate(
        table: Colours, scattering_vectors: wp.array(dtype=wp.vec3d), to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32), footprints: wp.array(dtype=Footprint), taps: FootprintTaps, run: wp.int32,
        first: wp.int32,
        unserved_gain: wp.array(dtype=wp.float32), xyz_out: wp.array(dtype=wp.vec3f),
    ):  # fmt: skip
        """Add the XYZ of ``run`` directions per thread, times ``gains``, to ``xyz_out``; ``footprints`` may be empty.

        Gains are geometry factors, and footprints are ranges of (u, v) in a pixel. For a light source of finite size,
        directions that the table excludes are skipped. The gains of these directions are written to ``unserved_gain``,
        which is 0 for all other directions.
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
