"""Sums of coefficients under the Gaussian lobes of pairs of a direction and a wavelength, on the CPU in float64."""

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

# Additional exponent of e up to which lobes are summed, beyond that of the truncation error. Derived: the second
# derivatives of a lobe at its edge are larger than the lobe by about the square of the exponent.
_FURTHER = 5.0
# Number of cells of the transposed sum per launch on a thread. Limit: most cells have few pairs, and a launch costs as
# much as hundreds of them.
_CELLS_OF_SLICE = 16_384
# Largest distance of a centre from the middle of its cell, in cells, with a margin for rounding errors.
_HALF_CELL = 0.5 + 1e-9
# Column of the derivative by x, the place of κ.
X = 5


def exponent_of(truncation: float) -> float:
    """Return the exponent x for which coefficients with weights below e^−x are negligible."""
    return -math.log(truncation) + _FURTHER


@dataclass(frozen=True)
class Pairs:
    """Pairs of a direction and a wavelength.

    Attributes:
        centres: q = (u, v)/λ [1/µm], shape (p, 2).
        forms: M_xx, M_xy and M_yy of the weights exp(−dᵀMd) [µm²], shape (p, 3).
        kappas: |κ| [1/µm], shape (p,).
    """

    centres: NDArray[np.float64]
    forms: NDArray[np.float64]
    kappas: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.kappas)

    def reaches(self, exponent: float) -> NDArray[np.float64]:
        """Return the largest distances of coefficients from the centres along (x, y) [1/µm], shape (p, 2)."""
        xx, xy, yy = self.forms.T
        scale = exponent / (xx * yy - xy * xy)
        return np.asarray(np.sqrt(np.stack([scale * yy, scale * xx], axis=1)))


def block_of(pairs: Pairs, exponent: float, shape: tuple[int, int], size_um: tuple[float, float]) -> Block:
    """Return the block of all coefficients that pairs sum. An axis of a single sample has order 0 only."""
    first, counts = [], []
    for axis, samples, length in ((1, shape[0], size_um[0]), (0, shape[1], size_um[1])):
        reach = pairs.reaches(exponent)[:, axis]
        low = math.floor(float(np.min((pairs.centres[:, axis] - reach) * length)))
        high = math.ceil(float(np.max((pairs.centres[:, axis] + reach) * length)))
        first.append(low if samples > 1 else 0)
        counts.append(high - low + 1 if samples > 1 else 1)
    return Block((first[0], first[1]), (counts[0], counts[1]))


class GaussianLobes:
    """Weighted sums of the coefficients of a block, and their transpose."""

    def __init__(
        self, rows: CoefficientRows, block: Block, places: NDArray[np.int32], size_um: tuple[float, float],
        exponent: float,
    ) -> None:  # fmt: skip
        """Describe the sums.

        Args:
            rows: Chebyshev series of the coefficients.
            block: Orders of the coefficients.
            places: Row of each order of the block.
            size_um: Size of the patch (y, x) [µm].
            exponent: Coefficients with weights below e^−exponent are truncated.
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
        """Chebyshev series of the coefficients."""
        return self._rows

    def table(self, coefficients: NDArray[np.float64]) -> lobe_sums.LobeTable:
        """Return the struct of the kernels, for coefficients whose series are rows of ``coefficients``.

        The struct shares the memory of the coefficients.
        """
        self._table.coefficients = wp.array(coefficients.ravel(), dtype=wp.float64, device="cpu", copy=False)
        return self._table

    def sums(self, pairs: Pairs, coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sum of each pair, shape (p,), of coefficients whose series are rows of ``coefficients``."""
        result = np.empty(len(pairs))
        self._launch(lobe_sums.sum_lobes, len(pairs), coefficients, self._of(pairs), result)
        return result

    def derivatives(self, pairs: Pairs, coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the ``lobe_sums.DERIVATIVES`` of the sums, with κ instead of x, shape (p, 11)."""
        result = np.empty((len(pairs), lobe_sums.DERIVATIVES))
        self._launch(lobe_sums.differentiate_lobes, len(pairs), coefficients, self._of(pairs), result)
        result[:, X] *= self._rows.places_per_kappa
        return result

    def spread(self, pairs: Pairs, adjoints: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
        """Add to the rows of the block, shape (size, k), what the adjoints of the sums of pairs contribute."""
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
        """Return the arrays of the pairs for kernels; they share the memory of their NumPy arrays."""
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
