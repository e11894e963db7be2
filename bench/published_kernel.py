"""The published algorithm as a kernel, and what this machine can do at most: parts of ``published``.

Single 2014, eqs. 3.8, 3.20 and 3.24: at each wavelength the Taylor sum of a square of coefficients around (u, v)/λ,
found with floor(), weighted by a Gaussian. What a careful implementation would do here is done: a wavelength's factors
come from a table, powers of w are taken once a pixel, Gaussians go by recurrence, loops have fixed lengths, a
coefficient's terms lie side by side in whole SIMD registers, and amplitudes are summed before they meet the basis.
"""

import functools
import types

import warp as wp

from warpdiff.kernels.spectral import OPTIONS


@functools.cache
def kernels(lanes: int, reach: int, powers: bool, rounded: bool) -> types.SimpleNamespace:  # noqa: PLR0915
    """The struct and the kernel for one shape of the sum.

    Args:
        lanes: Terms of the series, padded to whole registers.
        reach: Neighbours on either side of the one that is found: 1 is 3 × 3.
        powers: Whether coefficients add as powers (the averaged form) or as amplitudes (the published one).
        rounded: Whether that one is found by rounding in place of floor().

    Returns:
        A namespace with the vector type ``row``, the struct ``Series`` and the kernel ``shade``.
    """
    row_t = wp.types.vector(length=lanes, dtype=wp.float32)

    @wp.struct
    class Series:
        rows: wp.array(dtype=row_t)  # (my·mx·2) real and imaginary parts of iⁿ DFT{gⁿ}
        factors: wp.array(dtype=row_t)  # (2πa/λ)ⁿ/n! of each wavelength
        wavenumbers: wp.array(dtype=wp.float32)  # 1/λ [1/µm]
        weights: wp.array(dtype=wp.vec3f)
        side: wp.int32  # 2 reach + 1, known at run time so that rows of neighbours are a loop and not its copies
        count_x: wp.int32
        origin_y: wp.int32
        origin_x: wp.int32
        length_y: wp.float32
        length_x: wp.float32
        across: wp.float32  # the Gaussian is exp(−across dy² − along dx²) in coefficients
        along: wp.float32
        shrink_y: wp.float32  # exp(−2 across)
        shrink_x: wp.float32

    @wp.kernel(module="unique", module_options=OPTIONS)
    def shade(  # noqa: PLR0915
        # In:
        series: Series,
        deflections: wp.array(dtype=wp.vec3d),
        gains: wp.array(dtype=wp.float32),
        first: wp.int32,
        # Out:
        xyz_out: wp.array(dtype=wp.vec3f),
    ):
        i = first + wp.tid()
        u = wp.float32(deflections[i][0]) * series.length_x
        v = wp.float32(deflections[i][1]) * series.length_y
        w = wp.float32(deflections[i][2])
        w_powers = row_t()
        power = wp.float32(1.0)
        for n in range(wp.static(lanes)):
            w_powers[n] = power
            power = power * w
        across = series.across
        along = series.along
        shrink_y = series.shrink_y
        shrink_x = series.shrink_x
        colour = wp.vec3f()
        for k in range(series.wavenumbers.shape[0]):
            tau = series.wavenumbers[k]
            qy = v * tau
            qx = u * tau
            if wp.static(rounded):
                near_y = wp.rint(qy)
                near_x = wp.rint(qx)
            else:
                near_y = wp.floor(qy)
                near_x = wp.floor(qx)
            dy = near_y - qy - wp.static(float(reach))
            dx = near_x - qx - wp.static(float(reach))
            gy = wp.exp(-across * dy * dy - along * dx * dx)
            step_y = wp.exp(-across * (2.0 * dy + 1.0))
            start_x = wp.exp(-along * (2.0 * dx + 1.0))
            basis = wp.cw_mul(w_powers, series.factors[k])
            row = (wp.int32(near_y) + series.origin_y - wp.static(reach)) * series.count_x
            row = row + wp.int32(near_x) + series.origin_x - wp.static(reach)
            total = wp.float32(0.0)
            total_re = row_t()
            total_im = row_t()
            for _j in range(series.side):
                g = gy
                step_x = start_x
                for m in range(wp.static(2 * reach + 1)):
                    at = 2 * (row + m)
                    if wp.static(powers):
                        re = wp.dot(series.rows[at], basis)
                        im = wp.dot(series.rows[at + 1], basis)
                        total += g * (re * re + im * im)
                    else:
                        total_re += g * series.rows[at]
                        total_im += g * series.rows[at + 1]
                    g = g * step_x
                    step_x = step_x * shrink_x
                gy = gy * step_y
                step_y = step_y * shrink_y
                row = row + series.count_x
            if wp.static(not powers):
                re = wp.dot(total_re, basis)
                im = wp.dot(total_im, basis)
                total = re * re + im * im
            colour += total * series.weights[k]
        xyz_out[i] = gains[i] * colour

    return types.SimpleNamespace(row=row_t, Series=Series, shade=shade)


_MULTIPLY_ADDS = """
    typedef float lanes16 __attribute__((vector_size(64)));
    lanes16 sums[12];
    lanes16 factor, addend;
    for (int k = 0; k < 16; ++k) { factor[k] = seed; addend[k] = seed * 1e-3f; }
    for (int m = 0; m < 12; ++m) sums[m] = addend * (float)m;
    for (int i = 0; i < rounds; ++i) {
        #pragma clang loop unroll(full)
        for (int m = 0; m < 12; ++m) sums[m] = sums[m] * factor + addend;
    }
    lanes16 total = sums[0];
    for (int m = 1; m < 12; ++m) total += sums[m];
    float result = 0.0f;
    for (int k = 0; k < 16; ++k) result += total[k];
    return result;
"""
SUMS = 12


@wp.func_native(_MULTIPLY_ADDS)
def multiply_adds(seed: wp.float32, rounds: wp.int32) -> wp.float32:  # noqa: D103
    ...


@wp.kernel(module="unique", module_options=OPTIONS)
def multiply_add_rate(rounds: wp.int32, first: wp.int32, sums_out: wp.array(dtype=wp.float32)):
    """Twelve independent sums of 16 floats, ``rounds`` multiply-adds each."""
    i = first + wp.tid()
    sums_out[i] = multiply_adds(0.999 + 1e-6 * wp.float32(i), rounds)
