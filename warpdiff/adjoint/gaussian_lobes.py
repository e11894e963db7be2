"""Sums of Fourier coefficients with Gaussian weights (lobes), on the CPU in float64.

Each pair of a direction and a wavelength λ has one sum. The weight of a coefficient is exp(−dᵀMd), where d is the
distance of its frequency from q = (u, v)/λ, and M is a 2 × 2 matrix. Each coefficient is a Chebyshev series in |κ|,
with κ = w/λ. (u, v, w) is the scattering vector.

A block is a rectangle of orders; a cell is the place of one order in the block. The number of pairs is p, and the
number of terms of a series is k. The adjoint of a quantity is the derivative of a scalar loss with respect to this
quantity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.adjoint.sites import Block
from warpdiff.device.devices import resolve_device, resolve_threads
from warpdiff.device.kernel_calls import ELEMENTS_OF_SLICE, launch
from warpdiff.kernels import lobe_sums

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from warp import Kernel

    from warpdiff.adjoint.coefficient_rows import CoefficientRows

# Fourier coefficients with Gaussian weights (lobes) below e^−x are neglected. This number is added to the x that the
# truncation error requires, so that derivatives also meet this error. It was derived from the second derivatives of a
# lobe at its edge, which are larger than the lobe itself by a factor of about x².
_FURTHER = 5.0
# Number of cells (orders) for which a thread sums adjoints (derivatives of a loss) in one launch of the kernel. Smaller
# numbers would waste time: a launch takes as long as the sums of hundreds of cells, because most cells are near few
# pairs (a direction and a wavelength) only.
_CELLS_OF_SLICE = 16_384
# Largest distance of the centre of a lobe (Gaussian weight) from the middle of its cell (the place of one order), along
# an axis [cells]: one half, and a margin for rounding errors.
_HALF_CELL = 0.5 + 1e-9
# Index of the column, in the result of `derivatives`, with the derivative of a weighted sum of Fourier coefficients by
# the argument of the Chebyshev polynomials. `GaussianLobes.derivatives` converts it to that by |κ| = |w|/λ.
X = 5


def exponent_of(truncation: float) -> float:
    """Return the x for which Fourier coefficients with weights below e^−x are negligible at a truncation error."""
    return -math.log(truncation) + _FURTHER


@dataclass(frozen=True)
class Pairs:
    """Pairs of a direction and a wavelength, for sums of Fourier coefficients with Gaussian weights.

    Attributes:
        centres: Frequencies q = (u, v)/λ at which the Gaussian weights have their maxima [1/µm], shape (p, 2).
        forms: Elements M_xx, M_xy and M_yy of the matrix of the weights exp(−dᵀMd) [µm²], shape (p, 3).
        kappas: |κ| = |w|/λ of each pair [1/µm], shape (p,).
    """

    centres: NDArray[np.float64]
    forms: NDArray[np.float64]
    kappas: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.kappas)

    def reaches(self, exponent: float) -> NDArray[np.float64]:
        """Return how far the Gaussian weights of each pair exceed e^−exponent along x and y [1/µm], shape (p, 2)."""
        xx, xy, yy = self.forms.T
        scale = exponent / (xx * yy - xy * xy)
        return np.asarray(np.sqrt(np.stack([scale * yy, scale * xx], axis=1)))


def block_of(pairs: Pairs, exponent: float, shape: tuple[int, int], size_um: tuple[float, float]) -> Block:
    """Return the smallest rectangle of orders with all Fourier coefficients that the sums of the pairs require.

    A pair is a direction and a wavelength. Coefficients with weights below e^−exponent are neglected. Along an axis
    with a single height sample, the surface is constant, and the rectangle has only order 0.
    """
    first, counts = [], []
    for axis, samples, length in ((1, shape[0], size_um[0]), (0, shape[1], size_um[1])):
        reach = pairs.reaches(exponent)[:, axis]
        low = math.floor(float(np.min((pairs.centres[:, axis] - reach) * length)))
        high = math.ceil(float(np.max((pairs.centres[:, axis] + reach) * length)))
        first.append(low if samples > 1 else 0)
        counts.append(high - low + 1 if samples > 1 else 1)
    return Block((first[0], first[1]), (counts[0], counts[1]))


class GaussianLobes:
    """Sums of the Fourier coefficients of a block of orders with Gaussian weights, and the transpose of these sums."""

    def __init__(
        self, rows: CoefficientRows, block: Block, places: NDArray[np.int32], size_um: tuple[float, float],
        exponent: float,
    ) -> None:  # fmt: skip
        """Set the Fourier coefficients and the orders of the sums.

        Args:
            rows: Chebyshev series of the Fourier coefficients in |κ| = |w|/λ.
            block: Rectangle of orders whose Fourier coefficients are summed.
            places: Index of the series of each order of the block.
            size_um: Size of the patch (y, x) [µm].
            exponent: Coefficients with Gaussian weights below e^−exponent are neglected.
        """
        self._rows, self._block, self._size_um, self._exponent = rows, block, size_um, exponent
        self._where = {"device": resolve_device(None), "threads": resolve_threads(None)}
        self._table = table = lobe_sums.LobeTable()
        table.places = wp.array(places, dtype=wp.int32, device="cpu")
        table.terms, table.exponent = rows.terms, exponent
        table.rows, table.columns = block.shape
        table.first_row, table.first_column = block.first
        table.step_y, table.step_x = (1.0 / length for length in size_um)

    @property
    def series(self) -> CoefficientRows:
        """Chebyshev series in |κ| of the Fourier coefficients."""
        return self._rows

    def table(self, coefficients: NDArray[np.float64]) -> lobe_sums.LobeTable:
        """Return the struct that passes Fourier coefficients to the kernels; it shares the memory of ``coefficients``.

        Each row of ``coefficients`` is the Chebyshev series of one Fourier coefficient.
        """
        self._table.coefficients = wp.array(coefficients.ravel(), dtype=wp.float64, device="cpu", copy=False)
        return self._table

    def sums(self, pairs: Pairs, coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the weighted sum of coefficients for each of p pairs (a direction and a wavelength), shape (p,).

        Each row of ``coefficients`` is the Chebyshev series of one Fourier coefficient.
        """
        result = np.empty(len(pairs))
        self._launch(lobe_sums.sum_lobes, len(pairs), coefficients, self._of(pairs), result)
        return result

    def derivatives(self, pairs: Pairs, coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the weighted sums of p pairs (a direction and a wavelength) and their derivatives, shape (p, 11).

        The comment of ``lobe_sums.DERIVATIVES`` lists the columns. Column ``X`` is the derivative with respect to |κ|.
        """
        result = np.empty((len(pairs), lobe_sums.DERIVATIVES))
        self._launch(lobe_sums.differentiate_lobes, len(pairs), coefficients, self._of(pairs), result)
        result[:, X] *= self._rows.places_per_kappa
        return result

    def spread(self, pairs: Pairs, adjoints: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
        """Add the adjoints of a block's Fourier coefficients to ``rows``, shape (size, k): the transpose of ``sums``.

        ``adjoints`` has the derivatives of a loss with respect to the weighted sums of the p pairs (a direction and a
        wavelength), shape (p,). ``rows`` has a row of k series terms for each order of the block.
        """
        cells, reach = [], []
        for axis, first, count, length in zip((1, 0), self._block.first, self._block.shape, self._size_um, strict=True):
            position = np.rint(pairs.centres[:, axis] * length) - first
            cells.append(np.clip(position, 0, count - 1).astype(np.int64))
            reach.append(math.floor(float(pairs.reaches(self._exponent)[:, axis].max()) * length + _HALF_CELL))
        cell = cells[0] * self._block.shape[1] + cells[1]
        order = np.argsort(cell, kind="stable")
        arrays = self._of(Pairs(pairs.centres[order], pairs.forms[order], pairs.kappas[order]))
        arrays.adjoints = wp.array(adjoints[order], dtype=wp.float64, device="cpu", copy=False)
        begins = np.searchsorted(cell[order], np.arange(self._block.size + 1)).astype(np.int32)
        arrays.begins = wp.array(begins, dtype=wp.int32, device="cpu", copy=False)
        arrays.reach_y, arrays.reach_x = reach
        arrays.polynomials = wp.empty(len(pairs) * self._rows.terms, dtype=wp.float64, device="cpu")
        launch(lobe_sums.evaluate_polynomials, len(pairs), [self._table, arrays], [], **self._where)
        self._launch(lobe_sums.spread_pairs, self._block.size, self._rows.rows[0], arrays, rows)

    def _of(self, pairs: Pairs) -> lobe_sums.LobePairs:
        """Return the pairs (a direction and a wavelength) as the struct of the kernels, without copies of arrays."""
        result = lobe_sums.LobePairs()
        result.centres = wp.array(np.ascontiguousarray(pairs.centres), dtype=wp.vec2d, device="cpu", copy=False)
        result.forms = wp.array(np.ascontiguousarray(pairs.forms), dtype=wp.vec3d, device="cpu", copy=False)
        result.places = wp.array(self._rows.places(pairs.kappas), dtype=wp.float64, device="cpu", copy=False)
        return result

    def _launch(
        self, kernel: Kernel, size: int, coefficients: NDArray[np.float64], pairs: lobe_sums.LobePairs,
        result: NDArray[np.float64],
    ) -> None:  # fmt: skip
        table = self.table(coefficients)
        output = wp.array(result, dtype=wp.float64, device="cpu", copy=False)
        slice_size = _CELLS_OF_SLICE if kernel is lobe_sums.spread_pairs else ELEMENTS_OF_SLICE
        launch(kernel, size, [table, pairs], [output], slice_size=slice_size, **self._where)
