"""Sums of coefficients under Gaussian lobes in float64, their derivatives, and the transposed sum, for adjoints.

One thread computes one pair of a direction and a wavelength, or one coefficient of the transposed sum. No two threads
write to the same element, so that results do not depend on the number of threads.
"""

import warp as wp

from warpdiff.kernels import compile_options

OPTIONS = compile_options.options("lobe_sums.h", max_unroll=1)
# Number of derivatives of a sum: by q_x, q_y, M_xx, M_xy, M_yy, x, L_x and L_y, the sums of r and of s times each term,
# and the sum itself. Derived: the header ``lobe_sums.h`` writes as many.
DERIVATIVES = 11


@wp.struct
class LobeTable:
    """Rectangular block of coefficients, each a series of Chebyshev polynomials in κ."""

    coefficients: wp.array(dtype=wp.float64)  # rows of ``terms`` numbers
    places: wp.array(dtype=wp.int32)  # row of ``coefficients`` for each cell of the block
    terms: wp.int32
    rows: wp.int32  # number of rows and columns of the block
    columns: wp.int32
    first_row: wp.int32  # order s of the first row, and order r of the first column
    first_column: wp.int32
    step_y: wp.float64  # distance of neighbouring coefficients [1/µm]
    step_x: wp.float64
    exponent: wp.float64  # coefficients with a weight below exp(−exponent) are truncated


@wp.struct
class LobePairs:
    """Pairs of a direction and a wavelength."""

    centres: wp.array(dtype=wp.vec2d)  # q = (u, v)/λ [1/µm]
    forms: wp.array(dtype=wp.vec3d)  # M_xx, M_xy and M_yy [µm²]
    places: wp.array(dtype=wp.float64)  # x, the place of κ in the range of the series, −1 to 1
    # The remaining arrays are empty except for the transposed sum.
    polynomials: wp.array(dtype=wp.float64)  # values of the Chebyshev polynomials at x, ``terms`` per pair
    adjoints: wp.array(dtype=wp.float64)  # adjoints of the sums
    begins: wp.array(dtype=wp.int32)  # for each cell, and for the end: its first pair; pairs are sorted by their cell
    reach_y: wp.int32  # largest distance, in cells, of a coefficient from the cell of a pair that sums it
    reach_x: wp.int32


@wp.func_native("return warpdiff::sum_lobe(table, pairs, pair);")
def sum_lobe(table: LobeTable, pairs: LobePairs, pair: wp.int32) -> wp.float64:
    """Return the sum of the coefficients under the lobe of a pair."""


@wp.func_native("warpdiff::differentiate_lobe(table, pairs, pair, derivatives_out);")
def differentiate_lobe(
    table: LobeTable, pairs: LobePairs, pair: wp.int32, derivatives_out: wp.array2d(dtype=wp.float64)
):
    """Compute the derivatives of the sum of a pair."""


@wp.func_native("warpdiff::write_polynomials(table, pairs, pair);")
def write_polynomials(table: LobeTable, pairs: LobePairs, pair: wp.int32):
    """Write the polynomials of a pair for the transposed sum."""


@wp.func_native("warpdiff::spread_lobes(table, pairs, cell, rows_out);")
def spread_lobes(table: LobeTable, pairs: LobePairs, cell: wp.int32, rows_out: wp.array2d(dtype=wp.float64)):
    """Add the contributions of all pairs to the row of one coefficient."""


@wp.kernel(module="unique", module_options=OPTIONS)
def sum_lobes(table: LobeTable, pairs: LobePairs, first: wp.int32, sums_out: wp.array(dtype=wp.float64)):
    """Compute the sum of the coefficients under the lobe of each pair."""
    pair = first + wp.tid()
    sums_out[pair] = sum_lobe(table, pairs, pair)


@wp.kernel(module="unique", module_options=OPTIONS)
def differentiate_lobes(
    table: LobeTable, pairs: LobePairs, first: wp.int32, derivatives_out: wp.array2d(dtype=wp.float64)
):
    """Compute the derivatives of the sum of each pair, in the order of ``DERIVATIVES``."""
    differentiate_lobe(table, pairs, first + wp.tid(), derivatives_out)


@wp.kernel(module="unique", module_options=OPTIONS)
def evaluate_polynomials(table: LobeTable, pairs: LobePairs, first: wp.int32):
    """Write the polynomials of each pair to ``LobePairs.polynomials``."""
    write_polynomials(table, pairs, first + wp.tid())


@wp.kernel(module="unique", module_options=OPTIONS)
def spread_pairs(table: LobeTable, pairs: LobePairs, first: wp.int32, rows_out: wp.array2d(dtype=wp.float64)):
    """Add the adjoints of all pairs to the rows of the coefficients that they sum, one cell of the block per thread."""
    spread_lobes(table, pairs, first + wp.tid(), rows_out)
