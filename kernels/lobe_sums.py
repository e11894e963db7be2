"""Sums of Fourier coefficients with Gaussian weights (lobes) in float64, their derivatives, and the transposed sums.

A lobe belongs to a pair of a direction and a wavelength λ. The weight of a coefficient is exp(−dᵀMd), where d is the
distance of its frequency from q = (u, v)/λ, and M a 2 × 2 matrix. A coefficient of order (s, r) is a Chebyshev series
in x, which is κ = w/λ scaled to the range from −1 to 1. (u, v, w) is the scattering vector, and L_x and L_y are the
lengths of the patch. The adjoint of a quantity is the derivative of a scalar loss with respect to it.

One thread computes one pair, or one coefficient of the transposed sums. A cell is the place of one coefficient in the
block of coefficients. No two threads write to the same element, so that results do not depend on the number of threads.
"""

import warp as wp

from warpdiff.kernels import compile_options

OPTIONS = compile_options.options("lobe_sums.h", max_unroll=1)
# Number of values that ``differentiate_lobes`` writes for a weighted sum of Fourier coefficients: the derivatives with
# respect to the centre (q_x, q_y) of the weights, their matrix (M_xx, M_xy, M_yy), the argument x of the Chebyshev
# series, and the lengths L_x and L_y of the patch; two sums with the orders r and s as further factors; the sum itself.
DERIVATIVES = 11
# Largest number of terms of the Chebyshev series of a Fourier coefficient, which callers must check. The number is
# limited by the stack, on which a thread stores the polynomials and their derivatives: 8 bytes × 2 × 1024 = 16 kB.
MOST_TERMS = 1024


@wp.struct
class LobeTable:
    """Rectangular block of Fourier coefficients, each a Chebyshev series in x, which is κ = w/λ scaled to −1 to 1."""

    coefficients: wp.array(dtype=wp.float64)  # coefficients of the Chebyshev series, ``terms`` numbers per row
    places: wp.array(dtype=wp.int32)  # row of ``coefficients`` for each Fourier coefficient of the block
    terms: wp.int32
    rows: wp.int32  # number of orders s in the block; ``columns`` is the number of orders r
    columns: wp.int32
    first_row: wp.int32  # order s of the first row; ``first_column`` is the order r of the first column
    first_column: wp.int32
    step_y: wp.float64  # difference of frequency between neighbouring rows [1/µm]; ``step_x`` is that between columns
    step_x: wp.float64
    exponent: wp.float64  # Fourier coefficients with a weight below exp(−exponent) are neglected


@wp.struct
class LobePairs:
    """Pairs of a direction and a wavelength, at which Fourier coefficients are added with Gaussian weights.

    A cell is the place of one coefficient in the frequency plane.
    """

    centres: wp.array(dtype=wp.vec2d)  # frequency q = (u, v)/λ of the maximum of each pair's weights [1/µm]
    forms: wp.array(dtype=wp.vec3d)  # elements M_xx, M_xy and M_yy of the matrix of the weights exp(−dᵀMd) [µm²]
    places: wp.array(dtype=wp.float64)  # argument x of the Chebyshev series for each pair, −1 to 1
    # The following arrays are used only to compute adjoints (derivatives of a loss) of Fourier coefficients from those
    # of weighted sums of them; otherwise they are empty. A sum belongs to a pair of a direction and a wavelength.
    polynomials: wp.array(dtype=wp.float64)  # values of ``terms`` Chebyshev polynomials at the x of each pair
    adjoints: wp.array(dtype=wp.float64)  # derivative of a loss by the weighted sum of each pair
    begins: wp.array(dtype=wp.int32)  # index of the first pair of each cell, then the number of all pairs
    reach_y: wp.int32  # largest distance of coefficients from a pair's cell, in rows; ``reach_x``: in columns
    reach_x: wp.int32


@wp.func_native(f"return warpdiff::sum_lobe<{MOST_TERMS}>(table, pairs, pair);")
def sum_lobe(table: LobeTable, pairs: LobePairs, pair: wp.int32) -> wp.float64:
    """Return the sum of Fourier coefficients with Gaussian weights for one direction and wavelength (a pair)."""


@wp.func_native(f"warpdiff::differentiate_lobe<{MOST_TERMS}>(table, pairs, pair, derivatives_out);")
def differentiate_lobe(
    table: LobeTable, pairs: LobePairs, pair: wp.int32, derivatives_out: wp.array2d(dtype=wp.float64)
):
    """Compute the derivatives of a sum of Fourier coefficients with Gaussian weights, and write them to an output row.

    The sum belongs to a pair of a direction and a wavelength. The row has the index ``pair``.
    """


@wp.func_native("warpdiff::write_polynomials(table, pairs, pair);")
def write_polynomials(table: LobeTable, pairs: LobePairs, pair: wp.int32):
    """Write the values of the Chebyshev polynomials at the κ = w/λ of a pair of a direction and a wavelength.

    The adjoints (derivatives of a loss) of Fourier coefficients are computed from these values.
    """


@wp.func_native("warpdiff::spread_lobes(table, pairs, cell, rows_out);")
def spread_lobes(table: LobeTable, pairs: LobePairs, cell: wp.int32, rows_out: wp.array2d(dtype=wp.float64)):
    """Add the contributions of all pairs (a direction and a wavelength) to the adjoint of one Fourier coefficient.

    An adjoint is the derivative of a loss. The coefficient is a Chebyshev series; its adjoint has one number per term.
    """


@wp.kernel(module="unique", module_options=OPTIONS)
def sum_lobes(table: LobeTable, pairs: LobePairs, first: wp.int32, sums_out: wp.array(dtype=wp.float64)):
    """Compute the sum of Fourier coefficients with Gaussian weights for each pair of a direction and a wavelength."""
    pair = first + wp.tid()
    sums_out[pair] = sum_lobe(table, pairs, pair)


@wp.kernel(module="unique", module_options=OPTIONS)
def differentiate_lobes(
    table: LobeTable, pairs: LobePairs, first: wp.int32, derivatives_out: wp.array2d(dtype=wp.float64)
):
    """Compute the derivatives of weighted sums of Fourier coefficients, in the order in which `DERIVATIVES` has them.

    Each sum belongs to a pair of a direction and a wavelength.
    """
    differentiate_lobe(table, pairs, first + wp.tid(), derivatives_out)


@wp.kernel(module="unique", module_options=OPTIONS)
def evaluate_polynomials(table: LobeTable, pairs: LobePairs, first: wp.int32):
    """Write Chebyshev polynomials at the κ = w/λ of each direction and wavelength to ``LobePairs.polynomials``."""
    write_polynomials(table, pairs, first + wp.tid())


@wp.kernel(module="unique", module_options=OPTIONS)
def spread_pairs(table: LobeTable, pairs: LobePairs, first: wp.int32, rows_out: wp.array2d(dtype=wp.float64)):
    """Compute the adjoints of Fourier coefficients from the adjoints of weighted sums of these coefficients.

    An adjoint is the derivative of a loss. Each thread processes one coefficient.
    """
    spread_lobes(table, pairs, first + wp.tid(), rows_out)
