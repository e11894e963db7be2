"""The published algorithm in Numba, the baseline of comparisons. Importing this module requires Numba.

The sum is that of the published algorithm (Single 2014, eqs. 3.8, 3.20 and 3.24), over equally spaced wavelengths from
380 to 780 nm. At each wavelength the Taylor series is evaluated for a square block of Fourier coefficients around the
frequency (u, v)/λ. A Gaussian weights these coefficients. The integral over λ is a rectangle rule.

The implementation is fast for these reasons. A coefficient is stored as two vectors with the terms of its series (real
and imaginary parts), padded to whole cache lines, so that sums over terms are SIMD loops of fixed length. The basis
functions (2πaw/λ)ⁿ/n! at a wavelength, for heights of the scale a, are a row of tabulated factors times powers of w,
and these powers are computed once per direction. The positions of the square blocks and the first Gaussian weight of
each block are computed for all wavelengths at once. The other weights of a block are computed by recurrence. For a
centred window, coefficients are weighted and summed before multiplication by the basis. Coefficients are prefetched
four wavelengths before their use. Without prefetching, half of the time would be spent on waiting for memory.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, Any

import numba
import numba.extending
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils

from bench.peers import series
from bench.peers.series import PUBLISHED

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    import warpdiff as wd

__all__ = ["PUBLISHED", "SETTINGS", "available", "prepare"]

# Number of float32 numbers per cache line (64 bytes), and per AVX-512 register.
LANES = 16
# Smallest exponent whose exponential is a normal float32. The number was derived from ln(1.2e-38) = −87.3.
LEAST_EXPONENT = -87.0
# Number of directions that one thread computes in succession with the same temporary memory. The value was chosen
# because with larger numbers, threads finish at different times.
SLICE = 16
# Number of wavelengths between the prefetch of Fourier coefficients and their use. The value was chosen for the latency
# of the memory.
AHEAD = 4
# Settings of this program. Settings without neighbouring coefficients, which use one Fourier coefficient per direction
# and wavelength, are excluded. The kernel processes coefficients in groups of three, so that two of three would be
# wasted.
SETTINGS = [setting for setting in series.SETTINGS if setting["neighbour_extent"] > 0]


def available() -> str | None:
    """Return None, which means that the program can run: without Numba, this module cannot be imported."""
    return None


def prepare(heightfield: wd.HeightField, coherence: wd.Coherence, **setting: Any) -> Callable[..., NDArray[np.float32]]:
    """Return a function ``shade(scattering_vectors, gains, threads)`` that computes XYZ (n, 3) of directions."""
    made = series.series(heightfield, coherence, **setting)
    across, along = map(np.float32, made.falloff)
    if -max(across, along) * (made.neighbour_extent + 1) ** 2 < LEAST_EXPONENT:
        raise ValueError(f"the window's Gaussian ends in float32 before {made.neighbour_extent} neighbours")
    rows = _lines(heightfield, setting["terms"], setting["centred"])
    factors = _aligned((len(made.factors), rows.shape[2]))
    factors[:, : setting["terms"]] = made.factors
    kernel = _kernel(rows.shape[2], made.neighbour_extent, made.powers)

    def shade(scattering_vectors: NDArray[np.float64], gains: NDArray[np.float64], threads: int) -> NDArray[np.float32]:
        numba.set_num_threads(threads)
        xyz = np.empty((len(scattering_vectors), 3), dtype=np.float32)
        kernel(
            rows, made.columns, *made.origin, *np.float32(made.lengths_um), across, along, factors, made.wavenumbers,
            made.colours, np.float32(made.shift), np.float64(scattering_vectors), np.float32(gains), xyz,
        )  # fmt: skip
        return xyz

    return shade


@functools.lru_cache(maxsize=4)
def _lines(heightfield: wd.HeightField, terms: int, centred: bool) -> NDArray[np.float32]:
    """Return the terms of the Taylor series of each Fourier coefficient, shape (n, 2, padded number of terms).

    The second axis has the real and the imaginary part. Zeros pad the terms to whole cache lines.
    """
    rows = series.rows_of(heightfield, terms, centred)[0]
    lines = _aligned((len(rows), 2, LANES * math.ceil(terms / LANES)))
    lines[:, :, :terms] = rows
    return lines


def _aligned(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return an array of zeros that starts at a cache line, so that each register is loaded from only one line."""
    count = math.prod(shape)
    memory = np.zeros(count + LANES, dtype=np.float32)
    first = -memory.ctypes.data // 4 % LANES
    return memory[first : first + count].reshape(shape)


@numba.extending.intrinsic
def _prefetch(_context, rows, row, part, lane):
    """Prefetch the cache line that contains ``rows[row, part, lane]``, a term of a Fourier coefficient's series."""

    def generate(context, builder, signature, arguments):
        kind = signature.args[0]
        place = [
            context.cast(builder, argument, passed, types.intp)
            for argument, passed in zip(arguments[1:], signature.args[1:], strict=True)
        ]
        array = context.make_array(kind)(context, builder, arguments[0])
        address = cgutils.get_item_pointer(context, builder, kind, array, place)
        integer, pointer = ir.IntType(32), ir.IntType(8).as_pointer()
        function = ir.FunctionType(ir.VoidType(), [pointer, integer, integer, integer])
        fetch = cgutils.get_or_insert_function(builder.module, function, "llvm.prefetch.p0")
        read, keep, data = integer(0), integer(3), integer(1)
        builder.call(fetch, [builder.bitcast(address, pointer), read, keep, data])
        return context.get_dummy_value()

    return types.void(rows, row, part, lane), generate


@numba.njit(fastmath=True)
def _exp(x):
    """Return e^x for |x| < 87 with a relative error of 1e-7 · (1 + |x|). NumPy's exp would prevent SIMD loops."""
    turns = x * np.float32(1.4426950408889634)
    integer = np.floor(turns + np.float32(0.5))
    part = (turns - integer) * np.float32(0.6931471805599453)
    value = np.float32(1.0 / 5040.0)
    for factor in (1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0):
        value = value * part + np.float32(factor)
    return value * np.int32((np.int32(integer) + np.int32(127)) << np.int32(23)).view(np.float32)


@functools.cache
def _kernel(lanes: int, neighbour_extent: int, powers: bool) -> Any:  # noqa: PLR0915
    """Return the compiled kernel for fixed numbers of Taylor terms and of neighbouring Fourier coefficients."""
    side = 2 * neighbour_extent + 1
    # Three neighbouring coefficients are processed at a time. A loop with a shorter body would be unrolled before it
    # could be vectorised. If their number is no multiple of three, coefficients with weight 0 complete the last group.
    triples = math.ceil(side * side / 3)
    zero, one, two, reach_f = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(neighbour_extent)

    @numba.njit(fastmath=True, forceinline=True)
    def sum_of_powers(rows, at, weights, factors, w_powers):
        """Return Σ weight · |coefficient|² over the Fourier coefficients ``at``."""
        total = zero
        for t in range(0, 3 * triples, 3):
            re_0 = im_0 = re_1 = im_1 = re_2 = im_2 = zero
            for n in range(lanes):
                basis = factors[n] * w_powers[n]
                re_0 += rows[at[t], 0, n] * basis
                im_0 += rows[at[t], 1, n] * basis
                re_1 += rows[at[t + 1], 0, n] * basis
                im_1 += rows[at[t + 1], 1, n] * basis
                re_2 += rows[at[t + 2], 0, n] * basis
                im_2 += rows[at[t + 2], 1, n] * basis
            total += weights[t] * (re_0 * re_0 + im_0 * im_0)
            total += weights[t + 1] * (re_1 * re_1 + im_1 * im_1)
            total += weights[t + 2] * (re_2 * re_2 + im_2 * im_2)
        return total

    @numba.njit(fastmath=True, forceinline=True)
    def power_of_sum(rows, at, weights, factors, w_powers):
        """Return |Σ weight · coefficient|² over the Fourier coefficients ``at``."""
        re = im = zero
        for t in range(0, 3 * triples, 3):
            for n in range(lanes):
                row_re = row_im = zero
                for m in range(t, t + 3):
                    row_re += weights[m] * rows[at[m], 0, n]
                    row_im += weights[m] * rows[at[m], 1, n]
                basis = factors[n] * w_powers[n]
                re += row_re * basis
                im += row_im * basis
        return re * re + im * im

    combined = sum_of_powers if powers else power_of_sum

    @numba.njit(parallel=True, fastmath=True, error_model="numpy")
    def kernel(
        # Arrays that this kernel reads: Fourier coefficients, wavelengths with their weights, and directions.
        rows, count_x, origin_y, origin_x, length_y, length_x, across, along, factors, wavenumbers, colours, shift,
        scattering_vectors, gains,
        # Array with XYZ of the directions, shape (n, 3), which this kernel writes.
        xyz_out,
    ):  # fmt: skip
        shrink_y = math.exp(-two * across)
        shrink_x = math.exp(-two * along)
        count, wavelengths = len(scattering_vectors), len(wavenumbers)
        for part in numba.prange((count + SLICE - 1) // SLICE):
            w_powers = np.empty(lanes, dtype=np.float32)
            corners = np.zeros(wavelengths + AHEAD, dtype=np.int32)
            gaussians = np.empty((4, wavelengths), dtype=np.float32)
            at = np.zeros(3 * triples, dtype=np.uintp)
            weights = np.zeros(3 * triples, dtype=np.float32)
            for i in range(part * SLICE, min(count, (part + 1) * SLICE)):
                u = np.float32(scattering_vectors[i, 0]) * length_x
                v = np.float32(scattering_vectors[i, 1]) * length_y
                w = np.float32(scattering_vectors[i, 2])
                power = one
                for n in range(lanes):
                    w_powers[n] = power
                    power *= w
                # This SIMD loop over wavelengths computes the positions of the neighbouring coefficients, and the
                # weight of the first coefficient along each axis. The other weights are computed from it by recurrence.
                for k in range(wavelengths):
                    qy = v * wavenumbers[k]
                    qx = u * wavenumbers[k]
                    near_y = np.floor(qy + shift)
                    near_x = np.floor(qx + shift)
                    dy = near_y - qy - reach_f
                    dx = near_x - qx - reach_f
                    gaussians[0, k] = _exp(-across * dy * dy)
                    gaussians[1, k] = _exp(-across * (two * dy + one))
                    gaussians[2, k] = _exp(-along * dx * dx)
                    gaussians[3, k] = _exp(-along * (two * dx + one))
                    row = np.int32(near_y) + origin_y - neighbour_extent
                    corners[k] = row * count_x + np.int32(near_x) + origin_x - neighbour_extent
                x = y = z = zero
                for k in range(wavelengths):
                    for j in range(side):
                        for m in range(side):
                            for n in range(0, lanes, LANES):
                                _prefetch(rows, corners[k + AHEAD] + j * count_x + m, 0, n)
                                _prefetch(rows, corners[k + AHEAD] + j * count_x + m, 1, n)
                    corner = np.intp(corners[k])
                    weight_y, step_y = gaussians[0, k], gaussians[1, k]
                    for j in range(side):
                        weight, step_x = weight_y * gaussians[2, k], gaussians[3, k]
                        for m in range(side):
                            at[j * side + m] = corner + j * count_x + m
                            weights[j * side + m] = weight
                            weight *= step_x
                            step_x *= shrink_x
                        weight_y *= step_y
                        step_y *= shrink_y
                    total = combined(rows, at, weights, factors[k], w_powers)
                    x += total * colours[k, 0]
                    y += total * colours[k, 1]
                    z += total * colours[k, 2]
                xyz_out[i, 0] = gains[i] * x
                xyz_out[i, 1] = gains[i] * y
                xyz_out[i, 2] = gains[i] * z

    return kernel
