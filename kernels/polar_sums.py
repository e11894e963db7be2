"""Power spectrum on a polar grid in float64, colours as sums over its rings, and the transposes of both, for adjoints.

A ring has equally spaced azimuth samples. The value at a ring is the integral of the spectrum under a quadratic
B-spline in ln t, where t is the frequency. Each value is a series of Chebyshev polynomials in κ. One thread computes
one azimuth, one coefficient, one direction or a few rings. No two threads write to the same element, so that results do
not depend on the number of threads.
"""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.lobe_sums import LobeTable

OPTIONS = compile_options.options("polar_sums.h", max_unroll=1)
# Number of rings of a block, whose rings have equally many azimuth samples. If doubled, inner rings of a block have up
# to twice as many samples as they require.
BLOCK_RINGS = 16
# Number of rings that one thread of the transposed sum over rings processes. Limit: each ring is read by one thread.
TOGETHER = 4
# Largest number of terms of a series on a polar grid. Limit: polynomials of six rings are on the stack.
MOST_TERMS = 256


@wp.struct
class RingBlocks:
    """Polar grid of the frequency plane, in blocks of ``BLOCK_RINGS`` rings."""

    azimuths: wp.array(dtype=wp.int32)  # number of azimuth samples per ring, by block
    starts: wp.array(dtype=wp.int32)  # index of the first row, by block; rows are ordered by ring, then azimuth
    first_directions: wp.array(dtype=wp.int32)  # index into ``directions``, by block
    divisions: wp.array(dtype=wp.int32)  # samples of the spectrum per ring, by block
    first_radii: wp.array(dtype=wp.int32)  # index into ``radii``, by block
    block_of: wp.array(dtype=wp.int32)  # block, by direction
    is_used: wp.array(dtype=wp.bool)  # whether the spectrum is sampled at all, by direction
    directions: wp.array(dtype=wp.vec2d)  # cosine and sine of the azimuths
    radii: wp.array(dtype=wp.float64)  # frequencies of the samples of the spectrum [1/µm]
    log_first: wp.float64  # ln t of ring 0
    step: wp.float64  # distance of rings in ln t
    falloff: wp.float64  # a of the weights exp(−a d²) of coefficients [µm²]
    excluded: wp.int32  # cell of the block of coefficients that is not summed; −1 if there is none


@wp.struct
class PolarPixels:
    """Directions whose colours are sums over rings, in ascending order of their places."""

    places: wp.array(dtype=wp.float64)  # position of the longest wavelength among the rings
    turns: wp.array(dtype=wp.float64)  # azimuth [turns], 0 to 1
    slopes: wp.array(dtype=wp.float64)  # |w|/|(u, v)|, the ratio of κ to the frequency t
    gains: wp.array(dtype=wp.float64)
    curves: wp.array3d(dtype=wp.float64)  # weights of rings, by the fraction of a place, ring, and X, Y or Z
    factors: wp.array2d(dtype=wp.float64)  # further factor of each ring of a direction; empty is 1
    adjoints: wp.array2d(dtype=wp.float64)  # adjoints of XYZ, for the transposed sum
    begins: wp.array(dtype=wp.int32)  # for groups of ``TOGETHER`` rings: first direction that uses one of them
    ends: wp.array(dtype=wp.int32)  # one more than the last such direction
    least_kappa: wp.float64  # range of κ of the series [1/µm]
    places_per_kappa: wp.float64


@wp.func_native("warpdiff::sample_azimuth_rings(table, grid, direction, values_out);")
def sample_azimuth_rings(
    table: LobeTable, grid: RingBlocks, direction: wp.int32, values_out: wp.array2d(dtype=wp.float64)
):
    """Compute the spectrum along one azimuth of a block of rings."""


@wp.func_native("warpdiff::spread_rings(table, grid, values, cell, rows_out);")
def spread_rings(
    table: LobeTable, grid: RingBlocks, values: wp.array2d(dtype=wp.float64), cell: wp.int32,
    rows_out: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """Add the contributions of all rings to the row of one coefficient."""


@wp.func_native("warpdiff::sum_rings(grid, values, pixels, pixel, xyz_out);")
def sum_rings(
    grid: RingBlocks, values: wp.array2d(dtype=wp.float64), pixels: PolarPixels, pixel: wp.int32,
    xyz_out: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """Compute the colour of one direction."""


@wp.func_native("warpdiff::spread_pixels(grid, pixels, group, values_out);")
def spread_pixels(grid: RingBlocks, pixels: PolarPixels, group: wp.int32, values_out: wp.array2d(dtype=wp.float64)):
    """Add the contributions of all directions to a few rings."""


@wp.kernel(module="unique", module_options=OPTIONS)
def sample_spectrum_rings(
    table: LobeTable, grid: RingBlocks, first: wp.int32, values_out: wp.array2d(dtype=wp.float64)
):
    """Compute the spectrum on all rings, one azimuth of a block per thread."""
    sample_azimuth_rings(table, grid, first + wp.tid(), values_out)


@wp.kernel(module="unique", module_options=OPTIONS)
def spread_spectrum_rings(
    table: LobeTable, grid: RingBlocks, values: wp.array2d(dtype=wp.float64), first: wp.int32,
    rows_out: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """Add the adjoints of the spectrum on all rings to the rows of coefficients, one cell of the block per thread."""
    spread_rings(table, grid, values, first + wp.tid(), rows_out)


@wp.kernel(module="unique", module_options=OPTIONS)
def sum_rings_of_pixels(
    grid: RingBlocks, values: wp.array2d(dtype=wp.float64), pixels: PolarPixels, first: wp.int32,
    xyz_out: wp.array2d(dtype=wp.float64),
):  # fmt: skip
    """Compute the colours of directions."""
    sum_rings(grid, values, pixels, first + wp.tid(), xyz_out)


@wp.kernel(module="unique", module_options=OPTIONS)
def spread_pixels_to_rings(
    grid: RingBlocks, pixels: PolarPixels, first: wp.int32, values_out: wp.array2d(dtype=wp.float64)
):
    """Add the adjoints of the colours of directions to the rings that they sum, a few rings per thread."""
    spread_pixels(grid, pixels, first + wp.tid(), values_out)
