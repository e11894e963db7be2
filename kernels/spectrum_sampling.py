"""Power spectrum at azimuth samples and rings, and integrals of the spectrum over λ for every function of w.

An azimuth is a line of constant polar angle in the frequency plane. A ring is a circle in this plane; the radii of
neighbouring rings have a constant ratio. w is the normal component of the scattering vector (u, v, w). The value of a
ring is the integral of the spectrum under a quadratic B-spline in ln t, where t = |(u, v)|/λ. A colour is a weighted
sum over the rings of one octave, with the same weights at every radius: see ``colour_lookup``.
"""

import functools
import math
import types

import warp as wp

from warpdiff.kernels import coefficient_sum, compile_options
from warpdiff.kernels.colour_lookup import FILTER_REACH, OPTIONS, lookup, spline

_SAMPLING_OPTIONS = compile_options.options("spectrum_sampling.h", max_unroll=1)
_PROJECTION_OPTIONS = compile_options.options("colour_projection.h", max_unroll=1)


@functools.cache
def resampler(lanes: int, powers: bool, width: int) -> types.SimpleNamespace:
    """Return the kernel that samples a power spectrum along azimuths (polar angles), and the type of sampled rows.

    Args:
        lanes: Number of terms (weights of basis functions) in a row of the table of Fourier coefficients.
        powers: Whether rows are powers |H|² of Fourier coefficients H, for averaged windows. A sampled row is then a
            weighted sum of rows. Otherwise rows are amplitudes H, for centred windows. A sampled row then has the power
            of the weighted sum of rows at several κ = w/λ.
        width: Number of terms in a sampled row.
    """
    coefficients_t = coefficient_sum.kernels(lanes, "averaged" if powers else "centred", powers).Table
    out_t = wp.types.vector(length=width, dtype=wp.float32)
    parts = 1 if powers else 2

    @wp.func_native(
        f"warpdiff::sample_azimuth<{lanes}, {parts}, {width}>(table, bases, sine, cosine, rings, first_t, ratio, "
        "divisions, highest, scale, excluded, begin, values_out);"
    )
    def sample_azimuth(
        table: coefficients_t, bases: wp.array(dtype=out_t), sine: wp.float64, cosine: wp.float64, rings: wp.int32,
        first_t: wp.float64, ratio: wp.float64, divisions: wp.int32, highest: wp.float64, scale: wp.float32,
        excluded: wp.int32, begin: wp.int32, values_out: wp.array(dtype=out_t),
    ):  # fmt: skip
        """Compute integrals of the power spectrum along one azimuth, each weighted by the spline of one ring.

        An azimuth is a polar angle of the frequency, and a ring is a circle of constant frequency. The rings belong to
        one octave (factor of 2) of the frequency. Integrals of consecutive rings are written to consecutive rows from
        ``begin`` on.
        """

    @wp.kernel(module="unique", module_options=_SAMPLING_OPTIONS)
    def resample(
        table: coefficients_t, bases: wp.array(dtype=out_t), azimuths: wp.int32, rings_per_octave: wp.int32,
        log_low: wp.float64, divisions: wp.int32, highest: wp.float64, excluded: wp.int32, start: wp.int32,
        first: wp.int32,
        values_out: wp.array(dtype=out_t),
    ):  # fmt: skip
        """Compute integrals of the power spectrum along azimuths, each weighted by the spline of one ring.

        An azimuth is a polar angle of the frequency; a ring is a circle of constant frequency. ``log_low`` is the
        natural logarithm of the first ring's frequency, and ``start`` is the index of the output row of azimuth 0. The
        spectrum is sampled ``divisions`` times from one ring to the next, up to the frequency ``highest``. The Fourier
        coefficient with the index ``excluded`` is omitted. If coefficients are stored as amplitudes, ``bases`` has the
        values of their basis functions at several κ = w/λ.
        """
        azimuth = first + wp.tid()
        angle = wp.float64(2.0 * wp.PI) * wp.float64(azimuth) / wp.float64(azimuths)
        per_sample = wp.float64(wp.static(math.log(2.0))) / wp.float64(rings_per_octave * divisions)
        # A ring is a circle of the frequency plane. The B-spline that weights the spectrum around a ring begins 1.5
        # ring spacings inside the ring, at a lower frequency.
        first_t = wp.exp(log_low + (wp.float64(0.5) - wp.float64(1.5) * wp.float64(divisions)) * per_sample)
        sample_azimuth(
            table, bases, wp.sin(angle) * table.length_y, wp.cos(angle) * table.length_x, rings_per_octave, first_t,
            wp.exp(per_sample), divisions, highest, wp.float32(per_sample), excluded,
            start + azimuth * rings_per_octave, values_out,
        )  # fmt: skip

    return types.SimpleNamespace(row=out_t, resample=resample)


@functools.cache
def gatherer(lanes: int) -> types.SimpleNamespace:
    """Return the kernel that sums spectral lines near each azimuth (polar angle), and the type of the sums."""
    row_t = wp.types.vector(length=lanes, dtype=wp.float32)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def gather(
        coefficients: wp.array(dtype=row_t), lines: wp.array(dtype=wp.int32), angles: wp.array(dtype=wp.float32),
        places: wp.array(dtype=wp.float32), weights: wp.array(dtype=wp.float32), begins: wp.array(dtype=wp.int32),
        ends: wp.array(dtype=wp.int32), rings: wp.int32, blur: wp.float32, first: wp.int32,
        values_out: wp.array(dtype=row_t),
    ):  # fmt: skip
        """Compute integrals of a line spectrum along azimuths (polar angles), each weighted by the spline of one ring.

        A ring is a circle of constant frequency.

        Args:
            coefficients: Powers of the spectral lines, one row of basis terms per Fourier coefficient. Lines are
                blurred in angle.
            lines: Indices into ``coefficients``, in the order of the lines' angles.
            angles: Angles of the lines [rad], from 0 to 2π, with copies of the lines near both ends, whose angles
                differ by 2π.
            places: Distances of the lines from the centre of the frequency plane, as fractional indices of rings.
            weights: Factors 1/|q|² of the lines at frequencies q, which convert powers per step of angle and ln |q| to
                powers per area of the frequency plane.
            begins: For each azimuth, the index of the first line whose blur extends to the azimuth.
            ends: For each azimuth, the index of the last line whose blur extends to the azimuth, plus one.
            rings: Number of rings for which integrals along an azimuth are computed.
            blur: Standard deviation of the blur in angle [rad].
            first: Index of the azimuth of the first thread.
            values_out: Integrals, one per ring and azimuth; the rings of one azimuth are consecutive.
        """
        azimuth = first + wp.tid()
        start = azimuth * rings
        for k in range(rings):
            values_out[start + k] = row_t()
        angle = wp.float32(wp.float64(2.0 * wp.PI) * wp.float64(azimuth) / wp.float64(begins.shape[0]))
        scale = 1.0 / (wp.sqrt(2.0 * wp.PI) * blur)
        for j in range(begins[azimuth], ends[azimuth]):
            away = (angles[j] - angle) / blur
            ring = wp.int32(wp.rint(places[j]))
            ring_weights = spline(places[j] - wp.float32(ring))
            value = (scale * weights[j] * wp.exp(-0.5 * away * away)) * coefficients[lines[j]]
            if ring > 0:
                values_out[start + ring - 1] += ring_weights[0] * value
            values_out[start + ring] += ring_weights[1] * value
            if ring + 1 < rings:
                values_out[start + ring + 1] += ring_weights[2] * value

    return types.SimpleNamespace(row=row_t, gather=gather)


@functools.cache
def projector(lanes: int, w_basis_size: int) -> types.SimpleNamespace:
    """Return the kernels that integrate rows of a power spectrum over λ to colours.

    A row has the weights of ``lanes`` basis functions of κ = w/λ for one frequency. A colour has coefficients of
    ``w_basis_size`` functions of w, for X, Y and Z. w is the normal component of the scattering vector.
    """
    values_t = wp.types.vector(length=lanes, dtype=wp.float32)
    w_basis_t = wp.types.vector(length=w_basis_size, dtype=wp.float32)
    row_t = lookup(w_basis_size).row
    # Number of azimuths (polar angles) whose colours a thread computes together. The value is limited by the CPU's
    # registers, into which the sums of all these azimuths must fit.
    abreast = 4 if w_basis_size <= 8 else 2

    @wp.func_native(
        f"warpdiff::join_octaves<{lanes}, {abreast}>(values, starts, azimuths, rings, octave, first_azimuth, sequence, "
        "at, length);"
    )
    def join_octaves(
        values: wp.array(dtype=values_t), starts: wp.array(dtype=wp.int32), azimuths: wp.array(dtype=wp.int32),
        rings: wp.int32, octave: wp.int32, first_azimuth: wp.int32, sequence: wp.array(dtype=values_t), at: wp.int32,
        length: wp.int32,
    ):  # fmt: skip
        """Copy the rows of the spectrum for the colours of one octave of |(u, v)| to working memory.

        A row has the spectrum at one ring (radius) and azimuth (polar angle) of the frequency plane. A few azimuths are
        copied.
        """

    @wp.func_native(
        f"warpdiff::project_azimuths<{lanes}, {w_basis_size}, {abreast}>(sequence, at, length, skipped, matrices, "
        "weights, terms, rings, first_azimuth, rows_out);"
    )
    def project_azimuths(
        sequence: wp.array(dtype=values_t), at: wp.int32, length: wp.int32, skipped: wp.int32,
        matrices: wp.array(dtype=w_basis_t), weights: wp.array(dtype=wp.vec3f), terms: wp.int32, rings: wp.int32,
        first_azimuth: wp.int32, rows_out: wp.array(dtype=row_t),
    ):  # fmt: skip
        """Compute colours along a few azimuths (polar angles) from ``length`` rows of the spectrum per azimuth.

        A row has the spectrum at one ring (circle of constant |(u, v)|/λ). ``skipped`` rows precede the row at the ring
        of the first colour.
        """

    @wp.kernel(module="unique", module_options=_PROJECTION_OPTIONS)
    def project(
        values: wp.array(dtype=values_t), starts: wp.array(dtype=wp.int32), azimuths: wp.array(dtype=wp.int32),
        matrices: wp.array(dtype=w_basis_t), weights: wp.array(dtype=wp.vec3f), terms: wp.int32, rings: wp.int32,
        octave: wp.int32, length: wp.int32, sequence: wp.array(dtype=values_t), first: wp.int32, run: wp.int32,
        rows_out: wp.array(dtype=row_t),
    ):  # fmt: skip
        """Compute colours along a few azimuths (polar angles) at a time, at the rings of one octave of |(u, v)|.

        A ring is a circle of constant |(u, v)|. Its colours depend on the spectrum at the frequencies |(u, v)|/λ. For
        red light, these are in the octave of frequency with the index ``octave``. For blue light, they are in the next
        octave of frequency, or just beyond it. The next octave has once or twice the number of azimuths of this one.
        ``sequence`` is working memory for ``length`` rows of the spectrum per azimuth.
        """
        at = (first + wp.tid()) * wp.static(abreast) * length
        for k in range(run):
            first_azimuth = (first + wp.tid() * run + k) * wp.static(abreast)
            join_octaves(values, starts, azimuths, rings, octave, first_azimuth, sequence, at, length)
            project_azimuths(sequence, at, length, 0, matrices, weights, terms, rings, first_azimuth, rows_out)

    @wp.kernel(module="unique", module_options=_PROJECTION_OPTIONS)
    def project_lines(
        values: wp.array(dtype=values_t), matrices: wp.array(dtype=w_basis_t), weights: wp.array(dtype=wp.vec3f),
        terms: wp.int32, rings: wp.int32, row_count: wp.int32, first: wp.int32,
        rows_out: wp.array(dtype=row_t),
    ):  # fmt: skip
        """Compute colours along a few azimuths (polar angles) of a line spectrum with ``row_count`` rings (circles).

        Some of these rings have smaller or larger radii than all octaves of |(u, v)| in the table. The filter that
        converts values to spline coefficients requires these rings.
        """
        first_azimuth = (first + wp.tid()) * wp.static(abreast)
        at = first_azimuth * row_count
        skipped = wp.static(FILTER_REACH)
        project_azimuths(values, at, row_count, skipped, matrices, weights, terms, rings, first_azimuth, rows_out)

    return types.SimpleNamespace(
        row=row_t, w_basis=w_basis_t, project=project, project_lines=project_lines, abreast=abreast,
    )  # fmt: skip


@functools.cache
def adder(w_basis_size: int) -> wp.Kernel:
    """Return the kernel that adds colours, times a factor per ring (circle of constant |(u, v)|), to a colour table."""
    row_t = lookup(w_basis_size).row

    @wp.kernel(module="unique", module_options=OPTIONS)
    def add_product(
        values: wp.array(dtype=row_t), factors: wp.array(dtype=wp.float32), begins: wp.bool, first: wp.int32,
        rows_out: wp.array(dtype=row_t),
    ):  # fmt: skip
        """Multiply colours of a table by the factors of their rings (circles of constant |(u, v)|).

        Add the products to ``rows_out``, or replace its values if ``begins`` is true.
        """
        rings = factors.shape[0]
        at = (first + wp.tid()) * rings
        for ring in range(rings):
            value = factors[ring] * values[at + ring]
            if begins:
                rows_out[at + ring] = value
            else:
                rows_out[at + ring] = rows_out[at + ring] + value

    return add_product
