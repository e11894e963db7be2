"""Coefficient sum: windowed Fourier coefficients near (u, v)/λ, integrated over a set of wavelengths.

One thread computes one direction. At each wavelength, Fourier coefficients near q = (u, v)/λ are added, weighted by the
Gaussian of the coherence. Powers or amplitudes are added, depending on the coherence. For finitely many periods of the
patch, the amplitude at q is interpolated between coefficients instead, and the power of the patch is multiplied by the
interference factor of the periods. A coefficient is the scalar product of two vectors: its row in a table, and the
values of the basis functions at κ = w/λ. All coefficients share the same basis functions. Their values are interpolated
from a second table, so that the kernels serve any series.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal. θd is half of the angle between the directions to the
light and to the viewer, so that cos θd = |(u, v, w)|/2.
"""

import functools
import types

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.indices import cyclic
from warpdiff.kernels.structs import Footprint

OPTIONS = compile_options.options()
FORMS = ("averaged", "centred", "source", "replicas")
# Number of Fourier coefficients along an axis from which the amplitude at a frequency is interpolated. The value is
# limited by computing time, which is proportional to the square of this number.
TAPS = 8
# Under a light source of finite size, the Fourier coefficients around a direction are added with Gaussian weights. The
# footprint (range of directions in a pixel) widens the Gaussian, to at most this multiple of its area. Computing time
# is proportional to the area. Pixels with wider footprints are reported as inaccurate, or are refined.
MOST_WIDENED = 16.0
# The interference factor of N periods, [sin(πNt) / (N sin(πt))]², is 0/0 at its maximum, t = 0. Here t is the distance
# from the nearest Fourier coefficient of the patch, in spacings of the coefficients. If |N t| is below this number, a
# parabola replaces the factor. The number was derived from the error of the parabola, which is of fourth order in N t.
NEAR_RESONANCE = wp.constant(wp.float32(1e-2))


@wp.struct
class Quadrature:
    """Sets of wavelengths for integrals over λ, from the largest to the smallest set, with weights in X, Y and Z.

    The bandwidth of a direction is the number of wavelengths that it requires per unit of 1/λ. The first set is for the
    largest bandwidth. Each further set has 2^(−1/4) times as many wavelengths. A direction uses the smallest set that
    suffices for its bandwidth.
    """

    wavenumbers: wp.array(dtype=wp.float64)  # 1/λ of the wavelengths of all sets [1/µm], one set after the other
    weights: wp.array(dtype=wp.vec3f)
    # Reflectance R of a material. The first index is for cos θd from 0 to 1, where θd is half of the angle between the
    # directions to light and viewer. The second index is for the wavelength, in steps of 1 nm from ``least_nm`` on.
    reflectances: wp.array2d(dtype=wp.float32)
    least_nm: wp.float64  # first wavelength of ``reflectances`` [nm]
    firsts: wp.array(dtype=wp.int32)  # index of the first wavelength of each set, and of the end of the last set
    # For a repeated patch: number of wavelengths at which the interference factor is computed, per wavelength at which
    # the power of one patch is computed.
    subdivisions: wp.int32
    per_u: wp.float32
    per_v: wp.float32
    per_w: wp.float32
    constant: wp.float32


@wp.func
def reflectance_of(quadrature: Quadrature, scattering_vector: wp.vec3d, wavenumber: wp.float64) -> wp.float32:
    """Return a material's reflectance at half the angle between light and view, and at 1/λ; 1 without a material."""
    if quadrature.reflectances.shape[0] == 0:
        return wp.float32(1.0)
    place = wp.min(wp.length(scattering_vector) * wp.float64(0.5), wp.float64(1.0)) * wp.float64(
        quadrature.reflectances.shape[0] - 1
    )
    row = wp.min(wp.int32(place), quadrature.reflectances.shape[0] - 2)
    steps = wp.max(wp.float64(1.0e3) / wavenumber - quadrature.least_nm, wp.float64(0.0))
    column = wp.min(wp.int32(steps), quadrature.reflectances.shape[1] - 2)
    s = wp.float32(place - wp.float64(row))
    t = wp.min(wp.float32(steps - wp.float64(column)), 1.0)
    first = (1.0 - t) * quadrature.reflectances[row, column] + t * quadrature.reflectances[row, column + 1]
    second = (1.0 - t) * quadrature.reflectances[row + 1, column] + t * quadrature.reflectances[row + 1, column + 1]
    return (1.0 - s) * first + s * second


@wp.struct
class Window:
    """Gaussian weights exp(−across dy² − along (dx + slant dy)²) of the Fourier coefficients around a frequency q.

    q = (u, v)/λ is the frequency of one direction. The distances (dx, dy) of a coefficient from q are in spacings of
    coefficients.
    """

    across: wp.float32
    along: wp.float32
    slant: wp.float32
    # Largest distances from the frequency q at which Fourier coefficients are added, along y and x [their spacings].
    radius_y: wp.float32
    radius_x: wp.float32
    # Constants exp(−2 across) and exp(−2 along): the ratio of the Gaussian weights of two successive coefficients is
    # the previous ratio times this constant. Used only if the Gaussian is the same at all wavelengths.
    shrink_y: wp.float32
    shrink_x: wp.float32
    # Area of the Gaussian weights for the light source alone, divided by their area after the footprint of the pixel
    # has widened them; 1 without a footprint. Sums are multiplied by this ratio to obtain means over the footprint.
    share: wp.float32


@wp.func
def interference_factor(position: wp.float64, periods: wp.float64) -> wp.float32:
    """Return the interference factor [sin(πNt)/(N sin(πt))]² of N periods, where ``position`` is t.

    t is the frequency of a direction in spacings of the patch's Fourier coefficients.
    """
    # N t may exceed 1,000. Float32 is too coarse for such numbers. The nearest integers are therefore subtracted from t
    # and from N t in float64, which does not change the squared sines.
    t = position - wp.rint(position)
    turns = t * periods
    small = wp.float32(turns)
    pi = wp.float32(wp.PI)
    n = wp.float32(periods)
    if wp.abs(small) < NEAR_RESONANCE:
        return 1.0 - (1.0 - 1.0 / (n * n)) * pi * pi * small * small / 3.0
    ratio = wp.sin(pi * wp.float32(turns - wp.rint(turns))) / (n * wp.sin(pi * wp.float32(t)))
    return ratio * ratio


@functools.cache
def kernels(lanes: int, form: str, powers: bool) -> types.SimpleNamespace:
    """Return the struct ``Table`` and the kernels for coefficient tables whose rows have ``lanes`` terms.

    Args:
        lanes: Number of terms (weights of basis functions) in a row of the table.
        form: Kind of the coherence, one of ``FORMS``.
        powers: Whether the scalar product of a row and the basis functions is the power |H|² of a coefficient H.
            Otherwise a coefficient has two rows, for the real and the imaginary part of H.

    Returns:
        A namespace with the vector type ``row``, the struct ``Table`` and the kernels ``integrate`` and ``sample``.
    """
    row_t = wp.types.vector(length=lanes, dtype=wp.float32)
    taps_t = wp.types.vector(length=TAPS, dtype=wp.float32)
    adds_powers = form in ("averaged", "source")

    @wp.struct
    class Table:
        rows: wp.array(dtype=row_t)  # for each coefficient: a row for its power, or two for its real and imaginary part
        # Basis functions at equal steps in |κ| = |w|/λ: one step below the range of |κ| in use, two steps above it.
        basis: wp.array(dtype=row_t)
        kappa_low: wp.float64  # |κ| of the second entry of ``basis`` [1/µm]
        steps: wp.float64  # number of entries of ``basis`` per unit of |κ|
        count_y: wp.int32
        count_x: wp.int32
        origin_y: wp.int32
        origin_x: wp.int32
        length_y: wp.float64  # number of Fourier coefficients along y per unit of frequency [µm]
        length_x: wp.float64
        exponent: wp.float32  # Fourier coefficients with a Gaussian weight below exp(−exponent) are excluded
        # Factors of the squared distances in the exponent of the coefficients' Gaussian weights, along y and x, at
        # λ = 1 µm. For a light source of finite size, they apply to normal incidence.
        across: wp.float32
        along: wp.float32
        # For a repeated patch, the amplitude at a frequency is interpolated between Fourier coefficients. The weight of
        # each neighbouring coefficient is a polynomial of the position. `taps_y` has one row per coefficient and one
        # column per power of the position; `taps_x` has one vector per power and one element per coefficient.
        taps_y: wp.array2d(dtype=wp.float32)
        taps_x: wp.array(dtype=taps_t)
        periods_y: wp.float64
        periods_x: wp.float64
        patch_y: wp.float64  # length of the patch along y [µm]
        patch_x: wp.float64
        has_pitch_scales: wp.bool  # for a source: whether the length of a direction to the light is a pitch scale
        spread: wp.float32  # for a light source of finite size: standard deviation of (u, v) at normal incidence

    @wp.func
    def window_for(table: Table, to_light: wp.vec3f, footprint: Footprint) -> Window:
        """Return the Gaussian weights of Fourier coefficients for one direction to the light.

        For a light source of finite size (coherence of kind "source"), the width of the Gaussian depends on the
        wavelength; the result is for λ = 1 µm. A footprint (range of (u, v) in a pixel) widens this Gaussian. Other
        kinds of coherence ignore footprints.
        """
        window = Window()
        window.share = 1.0
        if wp.static(form == "source"):
            # Let s be the standard deviation of the directions of a source. The covariance of (u, v) over the source is
            # s² (p² I − t tᵀ), where I is the unit matrix. The vector t is the tangential part of the vector to the
            # light, and p is the length of the whole vector to the light: 1, or the factor by which a grating map
            # scales the pitch. Let f and g be the changes of (u, v) over one standard deviation of the pixel filter,
            # along rows and columns of the picture, divided by s. The sum p² I − t tᵀ + f fᵀ + g gᵀ is the covariance
            # of source and footprint together, divided by s². Its determinant is computed as a sum of positive terms,
            # in which z2 is p² − |t|².
            p2 = wp.float32(1.0)
            if table.has_pitch_scales:
                p2 = wp.length_sq(to_light)
            z2 = to_light[2] * to_light[2]
            f = wp.vec2f(footprint[0], footprint[1]) / table.spread
            g = wp.vec2f(footprint[2], footprint[3]) / table.spread
            along_f = to_light[0] * f[0] + to_light[1] * f[1]
            along_g = to_light[0] * g[0] + to_light[1] * g[1]
            area = f[0] * g[1] - f[1] * g[0]
            of_footprint = area * area
            of_source = p2 * z2
            of_both = z2 * (wp.length_sq(f) + wp.length_sq(g)) + along_f * along_f + along_g * along_g
            # ``k`` reduces the squared lengths of the footprint's changes of (u, v), f and g. The determinant of the
            # covariance is then at most MOST_WIDENED² times that of the source.
            most = of_source * wp.static(MOST_WIDENED * MOST_WIDENED - 1.0)
            k = wp.float32(1.0)
            if of_both + of_footprint > most:
                k = 2.0 * most / (of_both + wp.sqrt(of_both * of_both + 4.0 * of_footprint * most))
            determinant = of_source + k * (of_both + k * of_footprint)
            yy = z2 + to_light[0] * to_light[0] + k * (f[1] * f[1] + g[1] * g[1])
            xy = k * (f[0] * f[1] + g[0] * g[1]) - to_light[0] * to_light[1]
            window.along = table.along * (yy / determinant)
            window.across = table.across / yy
            window.slant = -xy / yy * wp.sqrt(table.across / table.along)
            window.share = wp.sqrt(of_source / determinant)
        else:
            window.along = table.along
            window.across = table.across
            window.shrink_y = wp.exp(-2.0 * table.across)
            window.shrink_x = wp.exp(-2.0 * table.along)
        window.radius_y = wp.sqrt(table.exponent / window.across)
        window.radius_x = wp.sqrt(table.exponent / window.along)
        return window

    @wp.func
    def basis_at(table: Table, kappa: wp.float64) -> row_t:
        """Return the basis functions of the coefficients at |κ| = |w|/λ, by cubics through four tabulated values."""
        steps = wp.max((kappa - table.kappa_low) * table.steps, wp.float64(0.0))
        entry = wp.min(wp.int32(steps), table.basis.shape[0] - 4)
        t = wp.float32(steps - wp.float64(entry))
        before = t + 1.0
        after = 1.0 - t
        beyond = 2.0 - t
        return (
            (-t * after * beyond / 6.0) * table.basis[entry]
            + (0.5 * before * after * beyond) * table.basis[entry + 1]
            + (0.5 * before * t * beyond) * table.basis[entry + 2]
            - (before * t * after / 6.0) * table.basis[entry + 3]
        )

    @wp.func
    def gaussian_sum(table: Table, window: Window, scattering_vector: wp.vec3d, wavenumber: wp.float64) -> wp.float32:
        """Return the diffracted power at 1/λ = ``wavenumber``, from Fourier coefficients with Gaussian weights."""
        # The frequency q may be hundreds of coefficients away from the zeroth order, but the Gaussian weights extend
        # over a few coefficients only. Therefore the integer part of the position of q is removed in float64, and the
        # weights are computed in float32.
        qy = scattering_vector[1] * wavenumber * table.length_y
        qx = scattering_vector[0] * wavenumber * table.length_x
        iy = wp.int32(wp.rint(qy))
        ix = wp.int32(wp.rint(qx))
        fy = wp.float32(qy - wp.float64(iy))
        fx = wp.float32(qx - wp.float64(ix))
        across = window.across
        along = window.along
        radius_y = window.radius_y
        radius_x = window.radius_x
        if wp.static(form == "source"):
            tau = wp.float32(wavenumber)
            across = across / (tau * tau)
            along = along / (tau * tau)
            radius_y = radius_y * tau
            radius_x = radius_x * tau

        first_y = wp.int32(wp.ceil(fy - radius_y))
        last_y = wp.int32(wp.floor(fy + radius_y))
        if wp.static(form == "source"):
            # The widened Gaussian may extend beyond the stored Fourier coefficients; rows (orders s) outside are
            # skipped. A table with the origin 0 has all coefficients and is periodic, so that no row is outside.
            if table.origin_y > 0:
                first_y = wp.max(first_y, -table.origin_y - iy)
                last_y = wp.min(last_y, table.origin_y - iy)
        total = wp.float32(0.0)
        if first_y > last_y:
            return total
        dy = wp.float32(first_y) - fy
        centre = fx
        first_x = wp.int32(wp.ceil(centre - radius_x))
        last_x = wp.int32(wp.floor(centre + radius_x))
        if wp.static(form != "source"):
            if first_x > last_x:
                return total
        total_re = wp.float32(0.0)
        total_im = wp.float32(0.0)
        basis = basis_at(table, -scattering_vector[2] * wavenumber)

        # The Gaussian weights along a row of Fourier coefficients are computed by recurrence: each weight is the weight
        # before times a factor, and each factor is the factor before times a constant. The first factor cannot
        # overflow: it is at most the inverse of the smallest weight, because no weight exceeds 1.
        dx = wp.float32(first_x) - centre
        gy = wp.float32(0.0)
        if wp.static(form == "source"):
            gy = wp.exp(-across * dy * dy)
        else:
            gy = wp.exp(-across * dy * dy - along * dx * dx)
        step_y = wp.float32(0.0)
        shrink_y = window.shrink_y
        if last_y > first_y:
            step_y = wp.exp(-across * (2.0 * dy + 1.0))
            if wp.static(form == "source"):
                shrink_y = wp.exp(-2.0 * across)
        start_step_x = wp.float32(0.0)
        shrink_x = window.shrink_x
        if wp.static(form == "source"):
            shrink_x = wp.exp(-2.0 * along)
        elif last_x > first_x:
            start_step_x = wp.exp(-along * (2.0 * dx + 1.0))
        y = cyclic(iy + first_y + table.origin_y, table.count_y)
        for j in range(first_y, last_y + 1):
            g = gy
            if wp.static(form == "source"):
                # The Fourier coefficients that contribute for a light source of finite size lie within a slanted
                # ellipse. Each row of coefficients therefore begins at another column.
                centre = fx - window.slant * (wp.float32(j) - fy)
                first_x = wp.int32(wp.ceil(centre - radius_x))
                last_x = wp.int32(wp.floor(centre + radius_x))
                if table.origin_x > 0:
                    first_x = wp.max(first_x, -table.origin_x - ix)
                    last_x = wp.min(last_x, table.origin_x - ix)
                dx = wp.float32(first_x) - centre
                g = gy * wp.exp(-along * dx * dx)
                start_step_x = wp.exp(-along * (2.0 * dx + 1.0))
            step_x = start_step_x
            x = cyclic(ix + first_x + table.origin_x, table.count_x)
            row = y * table.count_x
            for _i in range(first_x, last_x + 1):
                if wp.static(powers):
                    total += g * wp.max(wp.dot(table.rows[row + x], basis), 0.0)
                else:
                    at = 2 * (row + x)
                    re = wp.dot(table.rows[at], basis)
                    im = wp.dot(table.rows[at + 1], basis)
                    if wp.static(adds_powers):
                        total += g * (re * re + im * im)
                    else:
                        total_re += g * re
                        total_im += g * im
                g = g * step_x
                step_x = step_x * shrink_x
                x = x + 1
                if x == table.count_x:
                    x = 0
            gy = gy * step_y
            step_y = step_y * shrink_y
            y = y + 1
            if y == table.count_y:
                y = 0
        if wp.static(not adds_powers):
            total = total_re * total_re + total_im * total_im
        # The power relative to a flat mirror is at most 1. Each Fourier coefficient is a series in κ = w/λ, which may
        # overflow to infinity or NaN far beyond the range of κ for which it is made. wp.min then returns 1.
        return window.share * wp.min(total, wp.float32(1.0))

    @wp.func
    def patch_power(table: Table, scattering_vector: wp.vec3d, wavenumber: wp.float64) -> wp.float32:
        """Return the power that one patch diffracts, by interpolation of amplitudes between Fourier coefficients."""
        qy = scattering_vector[1] * wavenumber * table.length_y
        qx = scattering_vector[0] * wavenumber * table.length_x
        iy = wp.int32(wp.floor(qy))
        ix = wp.int32(wp.floor(qx))
        fy = wp.float32(qy - wp.float64(iy)) - 0.5
        fx = wp.float32(qx - wp.float64(ix)) - 0.5
        basis = basis_at(table, -scattering_vector[2] * wavenumber)
        weights = table.taps_x[0]
        for k in range(1, table.taps_x.shape[0]):
            weights = weights * fx + table.taps_x[k]
        rows = table.taps_y.shape[0]
        y = cyclic(iy - (rows - 1) // 2 + table.origin_y, table.count_y)
        first_x = cyclic(ix - wp.static(TAPS // 2 - 1) + table.origin_x, table.count_x)
        total_re = wp.float32(0.0)
        total_im = wp.float32(0.0)
        for j in range(rows):
            weight = table.taps_y[j, 0]
            for k in range(1, table.taps_y.shape[1]):
                weight = weight * fy + table.taps_y[j, k]
            x = first_x
            row = y * table.count_x
            row_re = wp.float32(0.0)
            row_im = wp.float32(0.0)
            for i in range(wp.static(TAPS)):
                at = 2 * (row + x)
                row_re += weights[i] * wp.dot(table.rows[at], basis)
                row_im += weights[i] * wp.dot(table.rows[at + 1], basis)
                x = x + 1
                if x == table.count_x:
                    x = 0
            total_re += weight * row_re
            total_im += weight * row_im
            y = y + 1
            if y == table.count_y:
                y = 0
        return wp.min(total_re * total_re + total_im * total_im, wp.float32(1.0))

    @wp.func
    def interference_at(table: Table, scattering_vector: wp.vec3d, wavenumber: wp.float64) -> wp.float32:
        """Return the interference factor of the repeated patches: the product of the factors along y and x."""
        y = interference_factor(scattering_vector[1] * wavenumber * table.patch_y, table.periods_y)
        x = interference_factor(scattering_vector[0] * wavenumber * table.patch_x, table.periods_x)
        return y * x

    @wp.func
    def set_for(quadrature: Quadrature, scattering_vector: wp.vec3d, to_light: wp.vec3f) -> wp.int32:
        """Return the index of the smallest set of wavelengths that suffices for a direction."""
        u = wp.float32(scattering_vector[0])
        v = wp.float32(scattering_vector[1])
        if wp.static(form == "source"):
            # For light at the angle θ from the normal, the range of (u, v) over the source, in the direction of the
            # light's projection onto the surface, is cos θ times the range at normal incidence. The coherence length is
            # then larger in this direction, so that more wavelengths are required.
            stretch = (u * to_light[0] + v * to_light[1]) / to_light[2]
            uv = wp.sqrt(u * u + v * v + stretch * stretch) * quadrature.per_u
        else:
            uv = wp.sqrt(u * u * quadrature.per_u * quadrature.per_u + v * v * quadrature.per_v * quadrature.per_v)
        share = uv + quadrature.per_w * wp.float32(-scattering_vector[2]) + quadrature.constant
        last = quadrature.firsts.shape[0] - 2
        return wp.clamp(wp.int32(wp.floor(-4.0 * wp.log2(share))), 0, last)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def integrate(
        table: Table, scattering_vectors: wp.array(dtype=wp.vec3d), to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32), footprints: wp.array(dtype=Footprint), quadrature: Quadrature,
        first: wp.int32, xyz_out: wp.array(dtype=wp.vec3f),
    ):  # fmt: skip
        """Add the XYZ of each direction, times its geometry factor (gain), to ``xyz_out``.

        Under a light source of finite size, each XYZ is a mean over the footprint of a pixel, if footprints are given.
        """
        i = first + wp.tid()
        gain = gains[i]
        if gain != 0.0:
            scattering_vector = scattering_vectors[i]
            chosen = set_for(quadrature, scattering_vector, to_lights[i])
            start = quadrature.firsts[chosen]
            end = quadrature.firsts[chosen + 1]
            # The sum over thousands of wavelengths is computed in float64. In float32, the rounding errors of the sum
            # would exceed the smallest tolerances.
            colour = wp.vec3d()
            if wp.static(form == "replicas"):
                # The interference factor of the periods changes fast with the wavelength but requires little time. This
                # factor is computed at all wavelengths. The power of the patch changes slowly: it is computed at every
                # wavelength whose index is a multiple of ``divisions``, and interpolated by cubic polynomials.
                divisions = quadrature.subdivisions
                intervals = (end - start - 1) // divisions
                g0 = patch_power(table, scattering_vector, quadrature.wavenumbers[start])
                g1 = patch_power(table, scattering_vector, quadrature.wavenumbers[start + divisions])
                g2 = patch_power(table, scattering_vector, quadrature.wavenumbers[start + 2 * divisions])
                g3 = patch_power(table, scattering_vector, quadrature.wavenumbers[start + 3 * divisions])
                base = wp.int32(0)
                for k in range(start, end):
                    interval = (k - start) // divisions
                    if interval - 1 > base and base < intervals - 3:
                        base = base + 1
                        g0 = g1
                        g1 = g2
                        g2 = g3
                        g3 = patch_power(
                            table, scattering_vector, quadrature.wavenumbers[start + (base + 3) * divisions]
                        )
                    s = wp.float32(k - start - base * divisions) / wp.float32(divisions)
                    power = (
                        (s * (s - 1.0) * (s - 2.0) / 6.0) * g3
                        - (s * (s - 1.0) * (s - 3.0) / 2.0) * g2
                        + (s * (s - 2.0) * (s - 3.0) / 2.0) * g1
                        - ((s - 1.0) * (s - 2.0) * (s - 3.0) / 6.0) * g0
                    )
                    factor = interference_at(table, scattering_vector, quadrature.wavenumbers[k])
                    factor = factor * reflectance_of(quadrature, scattering_vector, quadrature.wavenumbers[k])
                    colour += wp.vec3d(quadrature.weights[k] * (wp.max(power, 0.0) * factor))
            else:
                footprint = Footprint()
                if footprints.shape[0] > 0:
                    footprint = footprints[i]
                window = window_for(table, to_lights[i], footprint)
                for k in range(start, end):
                    power = gaussian_sum(table, window, scattering_vector, quadrature.wavenumbers[k])
                    power = power * reflectance_of(quadrature, scattering_vector, quadrature.wavenumbers[k])
                    colour += wp.vec3d(quadrature.weights[k] * power)
            xyz_out[i] = xyz_out[i] + gain * wp.vec3f(colour)

    @wp.kernel(module="unique", module_options=OPTIONS)
    def sample(
        table: Table, scattering_vectors: wp.array(dtype=wp.vec3d), to_lights: wp.array(dtype=wp.vec3f),
        gains: wp.array(dtype=wp.float32), wavenumbers: wp.array(dtype=wp.float64), first: wp.int32,
        reflectance_out: wp.array2d(dtype=wp.float32),
    ):  # fmt: skip
        """Compute the reflectance ρ of each direction at each wavelength of ``wavenumbers``."""
        i = first + wp.tid()
        gain = gains[i]
        window = Window()
        if gain > 0.0:
            window = window_for(table, to_lights[i], Footprint())
        for k in range(wavenumbers.shape[0]):
            reflectance = wp.float32(0.0)
            if gain > 0.0:
                if wp.static(form == "replicas"):
                    power = patch_power(table, scattering_vectors[i], wavenumbers[k])
                    power = power * interference_at(table, scattering_vectors[i], wavenumbers[k])
                else:
                    power = gaussian_sum(table, window, scattering_vectors[i], wavenumbers[k])
                reflectance = gain * power
            reflectance_out[i, k] = reflectance

    return types.SimpleNamespace(row=row_t, taps=taps_t, Table=Table, integrate=integrate, sample=sample)
