"""Power spectrum on a polar grid in float64, colours as sums over its rings, and the transposes of both, for adjoints.

The grid is in the frequency plane: t is the frequency [1/µm] along a radius, and a ring has equally spaced azimuth
samples. The value at a ring is the integral of the spectrum under a quadratic B-spline in ln t. Each value is a series
of Chebyshev polynomials in κ = w/λ, for the wavelength λ and the scattering vector (u, v, w). The adjoint of a quantity
is the derivative of a scalar loss with respect to this quantity.

One thread computes one azimuth, one Fourier coefficient, one direction or a few rings. A block of rings is a group of
consecutive rings. A cell is the place of one coefficient in the block (rectangle) of Fourier coefficients. No two
threads write to the same element, so that results do not depend on the number of threads.
"""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.lobe_sums import LobeTable

OPTIONS = compile_options.options("polar_sums.h", max_unroll=1)
# Number of rings of a block. Rings are circles of a polar grid; a block is a group of consecutive rings with equally
# many azimuth samples. If the number is doubled, inner rings of a block have up to twice as many samples as they need.
BLOCK_RINGS = 16
# Number of consecutive rings (circles of a polar grid of the spectrum) for which one thread computes adjoints, the
# derivatives of a loss. Each ring is processed by a single thread.
TOGETHER = 4
# Largest number of terms of a Chebyshev series on a polar grid, which callers must check. The number is limited by the
# stack, on which a thread stores the polynomials of six rings (circles of the grid): 8 bytes × 6 × 256 = 12 kB.
MOST_TERMS = 256


@wp.struct
class RingBlocks:
    """Polar grid of the frequency plane, in blocks of ``BLOCK_RINGS`` rings with equally many azimuth samples.

    A ring is a circle of constant frequency t [1/µm].
    """

    azimuths: wp.array(dtype=wp.int32)  # number of azimuth samples of a ring, for each block of rings
    starts: wp.array(dtype=wp.int32)  # first sample of each block of rings; samples are sorted by ring, then by azimuth
    first_directions: wp.array(dtype=wp.int32)  # index of the first azimuth of each block of rings in ``directions``
    divisions: wp.array(dtype=wp.int32)  # number of samples of the spectrum from one ring to the next, for each block
    first_radii: wp.array(dtype=wp.int32)  # index of the first sample of each block of rings in ``radii``
    block_of: wp.array(dtype=wp.int32)  # index of the block of rings of each azimuth in ``directions``
    is_used: wp.array(dtype=wp.bool)  # whether the spectrum is sampled at each azimuth in ``directions``
    directions: wp.array(dtype=wp.vec2d)  # cosine and sine of each azimuth sample of each block of rings
    radii: wp.array(dtype=wp.float64)  # frequencies t at which the spectrum is sampled [1/µm], block by block
    log_first: wp.float64  # ln t of the innermost ring
    step: wp.float64  # difference of ln t between neighbouring rings
    falloff: wp.float64  # factor a [µm²] of the weight exp(−a d²) of a Fourier coefficient at the distance d
    excluded: wp.int32  # index of the Fourier coefficient that is omitted from the sums; −1 if there is none


@wp.struct
class PolarPixels:
    """Scattering vectors whose colours are sums over rings of the power spectrum, sorted by ``places``.

    A ring is a circle of constant frequency |(u, v)|/λ.
    """

    places: wp.array(dtype=wp.float64)  # ring index (a fraction) of the longest visible wavelength, for each direction
    turns: wp.array(dtype=wp.float64)  # azimuth of (u, v) of each direction [turns], 0 to 1
    slopes: wp.array(dtype=wp.float64)  # |w|/|(u, v)| of each direction: the ratio of κ to the frequency t
    gains: wp.array(dtype=wp.float64)
    curves: wp.array3d(dtype=wp.float64)  # weights of rings: by the fractional part of ``places``, ring, and X, Y or Z
    reflectances: wp.array2d(dtype=wp.float64)  # reflectance of each direction at its rings; if empty, it is 1
    adjoints: wp.array2d(dtype=wp.float64)  # derivatives of a loss by XYZ of each direction, for the transposed sum
    begins: wp.array(dtype=wp.int32)  # first direction that uses a ring of each group of ``TOGETHER`` rings
    ends: wp.array(dtype=wp.int32)  # last direction that uses a ring of each group, plus one
    least_kappa: wp.float64  # smallest κ of the Chebyshev series [1/µm]; ``places_per_kappa`` is 2 over their range
    places_per_kappa: wp.float64


@wp.func_native(f"warpdiff::sample_azimuth_rings<{BLOCK_RINGS}, {MOST_TERMS}>(table, grid, direction, values_out);")
def sample_azimuth_rings(
    table: LobeTable, grid: RingBlocks, direction: wp.int32, values_out: wp.array2d(dtype=wp.float64)
):
    """Compute the power spectrum along one azimuth (polar angle of the frequency), at a group of consecutive rings.

    A ring is a circle of constant frequency.
    """


@wp.func_native(f"warpdiff::spread_rings<{BLOCK_RINGS}>(table, grid, values, cell, rows_out);")
def spread_rings(
    table: LobeTable, grid: RingBlocks, values: wp.array2d(dtype=wp.float64), cell: wp.int32,
    rows_out: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """Add the contributions of the spectrum on all rings of a polar grid to the adjoint of one Fourier coefficient.

    A ring is a circle of constant frequency. An adjoint is the derivative of a loss. The coefficient is a series, and
    its adjoint has one number per term.
    """


@wp.func_native(f"warpdiff::sum_rings<{BLOCK_RINGS}, {MOST_TERMS}>(grid, values, pixels, pixel, xyz_out);")
def sum_rings(
    grid: RingBlocks, values: wp.array2d(dtype=wp.float64), pixels: PolarPixels, pixel: wp.int32,
    xyz_out: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """Compute the colour of one direction: a weighted sum of the power spectrum over rings (circles of the grid)."""


@wp.func_native(f"warpdiff::spread_pixels<{BLOCK_RINGS}, {TOGETHER}, {MOST_TERMS}>(grid, pixels, group, values_out);")
def spread_pixels(grid: RingBlocks, pixels: PolarPixels, group: wp.int32, values_out: wp.array2d(dtype=wp.float64)):
    """Add the contributions of the colours of all directions to the adjoints of the power spectrum on a few rings.

    An adjoint is the derivative of a loss. A ring is a circle of the polar grid of the spectrum.
    """


@wp.kernel(module="unique", module_options=OPTIONS)
def sample_spectrum_rings(
    table: LobeTable, grid: RingBlocks, first: wp.int32, values_out: wp.array2d(dtype=wp.float64)
):
    """Compute the power spectrum on all rings (circles) of a polar grid.

    Each thread computes the samples at one azimuth of a block, which is a group of consecutive rings.
    """
    sample_azimuth_rings(table, grid, first + wp.tid(), values_out)


@wp.kernel(module="unique", module_options=OPTIONS)
def spread_spectrum_rings(
    table: LobeTable, grid: RingBlocks, values: wp.array2d(dtype=wp.float64), first: wp.int32,
    rows_out: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """Compute the adjoints of Fourier coefficients from the adjoints of the power spectrum on a polar grid.

    An adjoint is the derivative of a loss. Each thread processes one coefficient.
    """
    spread_rings(table, grid, values, first + wp.tid(), rows_out)


@wp.kernel(module="unique", module_options=OPTIONS)
def sum_rings_of_pixels(
    grid: RingBlocks, values: wp.array2d(dtype=wp.float64), pixels: PolarPixels, first: wp.int32,
    xyz_out: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """Compute the colours of all directions: weighted sums of the power spectrum over rings (circles of the grid)."""
    sum_rings(grid, values, pixels, first + wp.tid(), xyz_out)


@wp.kernel(module="unique", module_options=OPTIONS)
def spread_pixels_to_rings(
    grid: RingBlocks, pixels: PolarPixels, first: wp.int32, values_out: wp.array2d(dtype=wp.float64)
):
    """Compute the adjoints of the power spectrum on a polar grid from the adjoints of the colours.

    An adjoint is the derivative of a loss. Each thread processes a few rings (circles of the grid).
    """
    spread_pixels(grid, pixels, first + wp.tid(), values_out)
