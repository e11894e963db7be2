"""Spectral integration: windowed Fourier coefficients near (u, v)/λ, summed over a set of wavelengths.

One thread is one direction. At each wavelength the coefficient nearest to q = (u, v)/λ is found by rounding, and with
its neighbours weighted by the Gaussian of the coherence window: powers in the averaged form, amplitudes in the centred
one. A coefficient is the scalar product of a basis in κ = w/λ, the same for all coefficients, with its row of a table;
the basis is interpolated from a table of its own, so that the kernels serve any series.
"""

import functools
import types

import warp as wp

# The vectors below are as long as the table's rows: the first two flags let their sums be reordered into SIMD lanes.
# They are the parts of fast-math that do so and leave NaN and infinity defined.
OPTIONS = {
    "enable_backward": False,
    "cpu_compiler_flags": "-O3 -march=native -mreassociate -fno-signed-zeros -ffp-contract=fast",
}


@wp.struct
class Quadrature:
    """Wavelengths and their colour weights, in sets of which each has 1/√2 of the samples of the one before.

    A direction takes the set for its bandwidth, as a share of the largest one: per_uv |(u, v)| + per_w |w| + constant.
    """

    wavenumbers: wp.array(dtype=wp.float64)  # 1/λ [1/µm], set after set
    weights: wp.array(dtype=wp.vec3f)
    firsts: wp.array(dtype=wp.int32)  # where each set begins, and where the last one ends
    per_uv: wp.float32
    per_w: wp.float32
    constant: wp.float32


@functools.cache
def kernels(lanes: int, centred: bool) -> types.SimpleNamespace:
    """The struct and the kernels for rows of ``lanes`` terms, in the averaged or the centred form.

    Returns:
        A namespace with the vector type ``row``, the struct ``Table`` and the kernels ``integrate`` and ``sample``.
    """
    row_t = wp.types.vector(length=lanes, dtype=wp.float32)

    @wp.struct
    class Table:
        rows: wp.array(dtype=row_t)  # (my·mx·2): real and imaginary part of each coefficient's terms
        basis: wp.array(dtype=row_t)  # the series' basis at x = 0, −1, −2, … steps, one step before and two behind
        basis_steps: wp.float64  # steps per unit of wavenumber and |w|
        count_y: wp.int32
        count_x: wp.int32
        origin_y: wp.int32
        origin_x: wp.int32
        reach_y: wp.int32
        reach_x: wp.int32
        length_y: wp.float64  # the patch's size [µm]
        length_x: wp.float64
        falloff_y: wp.float32  # exponent per squared distance in coefficients
        falloff_x: wp.float32
        shrink_y: wp.float32  # exp(−2 falloff)
        shrink_x: wp.float32

    @wp.func
    def power(table: Table, deflection: wp.vec3d, wavenumber: wp.float64) -> wp.float32:
        """⟨|P|²⟩ at one wavelength; the wavenumber is 1/λ [1/µm]."""
        # Positions reach hundreds of coefficients and Gaussians are narrow: the integer part is taken off in float64.
        qy = deflection[1] * wavenumber * table.length_y
        qx = deflection[0] * wavenumber * table.length_x
        iy = wp.int32(wp.rint(qy))
        ix = wp.int32(wp.rint(qx))
        fy = wp.float32(qy - wp.float64(iy))
        fx = wp.float32(qx - wp.float64(ix))

        # The cubic through four entries of the basis' table, the first of which lies one step before x = 0.
        steps = -deflection[2] * wavenumber * table.basis_steps
        entry = wp.min(wp.int32(steps), table.basis.shape[0] - 4)
        t = wp.float32(steps - wp.float64(entry))
        before = t + 1.0
        after = 1.0 - t
        beyond = 2.0 - t
        basis = (
            (-t * after * beyond / 6.0) * table.basis[entry]
            + (0.5 * before * after * beyond) * table.basis[entry + 1]
            + (0.5 * before * t * beyond) * table.basis[entry + 2]
            - (before * t * after / 6.0) * table.basis[entry + 3]
        )

        # The Gaussian along an axis, by two multiplications a step outwards from the nearest coefficient.
        start_y = wp.exp(-table.falloff_y * fy * fy)
        start_x = wp.exp(-table.falloff_x * fx * fx)
        up_x = wp.float32(0.0)
        down_x = wp.float32(0.0)
        up_y = wp.float32(0.0)
        down_y = wp.float32(0.0)
        if table.reach_x > 0:
            up_x = wp.exp(-table.falloff_x * (1.0 - 2.0 * fx))
            down_x = wp.exp(-table.falloff_x * (1.0 + 2.0 * fx))
        if table.reach_y > 0:
            up_y = wp.exp(-table.falloff_y * (1.0 - 2.0 * fy))
            down_y = wp.exp(-table.falloff_y * (1.0 + 2.0 * fy))

        total = wp.float32(0.0)
        total_re = wp.float32(0.0)
        total_im = wp.float32(0.0)
        gy = start_y
        step_y = up_y
        dy = wp.int32(0)
        sign_y = wp.int32(1)
        for j in range(2 * table.reach_y + 1):
            if j == table.reach_y + 1:
                gy = start_y
                step_y = down_y
                dy = wp.int32(0)
                sign_y = wp.int32(-1)
            if j > 0:
                gy = gy * step_y
                step_y = step_y * table.shrink_y
                dy = dy + sign_y
            y = (iy + dy + table.origin_y) % table.count_y
            if y < 0:
                y = y + table.count_y
            gx = start_x
            step_x = up_x
            dx = wp.int32(0)
            sign_x = wp.int32(1)
            for i in range(2 * table.reach_x + 1):
                if i == table.reach_x + 1:
                    gx = start_x
                    step_x = down_x
                    dx = wp.int32(0)
                    sign_x = wp.int32(-1)
                if i > 0:
                    gx = gx * step_x
                    step_x = step_x * table.shrink_x
                    dx = dx + sign_x
                column = (ix + dx + table.origin_x) % table.count_x
                if column < 0:
                    column = column + table.count_x
                at = 2 * (y * table.count_x + column)
                re = wp.dot(table.rows[at], basis)
                im = wp.dot(table.rows[at + 1], basis)
                if wp.static(centred):
                    total_re += gy * gx * re
                    total_im += gy * gx * im
                else:
                    total += gy * gx * (re * re + im * im)
        if wp.static(centred):
            total = total_re * total_re + total_im * total_im
        # A mean of phases is at most 1. A series far beyond its range, which is computed on request only, may overflow
        # to infinity or NaN; wp.min then returns its second argument.
        return wp.min(total, wp.float32(1.0))

    @wp.kernel(module="unique", module_options=OPTIONS)
    def integrate(
        # In:
        table: Table,
        deflections: wp.array(dtype=wp.vec3d),
        gains: wp.array(dtype=wp.float32),
        quadrature: Quadrature,
        first: wp.int32,
        # Out:
        xyz_out: wp.array(dtype=wp.vec3f),
    ):
        """Add the XYZ of each direction to ``xyz_out``."""
        i = first + wp.tid()
        gain = gains[i]
        if gain > 0.0:
            deflection = deflections[i]
            uv = wp.float32(wp.sqrt(deflection[0] * deflection[0] + deflection[1] * deflection[1]))
            share = quadrature.per_uv * uv + quadrature.per_w * wp.float32(-deflection[2]) + quadrature.constant
            fewest = quadrature.firsts.shape[0] - 2
            chosen = wp.clamp(wp.int32(wp.floor(-2.0 * wp.log2(share))), 0, fewest)
            colour = wp.vec3f()
            for k in range(quadrature.firsts[chosen], quadrature.firsts[chosen + 1]):
                colour += quadrature.weights[k] * power(table, deflection, quadrature.wavenumbers[k])
            xyz_out[i] = xyz_out[i] + gain * colour

    @wp.kernel(module="unique", module_options=OPTIONS)
    def sample(
        # In:
        table: Table,
        deflections: wp.array(dtype=wp.vec3d),
        gains: wp.array(dtype=wp.float32),
        wavenumbers: wp.array(dtype=wp.float64),
        first: wp.int32,
        # Out:
        reflectance_out: wp.array2d(dtype=wp.float32),
    ):
        """ρ of each direction at each of the given wavelengths."""
        i = first + wp.tid()
        gain = gains[i]
        for k in range(wavenumbers.shape[0]):
            reflectance = wp.float32(0.0)
            if gain > 0.0:
                reflectance = gain * power(table, deflections[i], wavenumbers[k])
            reflectance_out[i, k] = reflectance

    return types.SimpleNamespace(row=row_t, Table=Table, integrate=integrate, sample=sample)
