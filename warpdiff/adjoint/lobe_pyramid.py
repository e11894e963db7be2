"""Sums of Fourier coefficients under wide lobes (Gaussian weights), for which neighbouring orders are added first.

A lobe that is several orders wide changes little from one order to the next. A pyramid therefore has levels of nodes
(sums of the coefficients of several orders): level n has one node for 2ⁿ × 2ⁿ orders, and level 0 has the orders
themselves. The nodes of the next level are every second node of a level, to which half of each neighbouring node is
added. This does not change the mean position of a coefficient. It adds a variance of (4ⁿ − 1)/6 orders², on average, to
the position. This variance is subtracted from that of the lobe. All steps are linear. The adjoint of a quantity is the
derivative of a scalar loss with respect to this quantity.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.adjoint.gaussian_lobes import GaussianLobes, Pairs
from warpdiff.adjoint.sites import Block

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from warpdiff.adjoint.coefficient_series import CoefficientSeries

# Smallest standard deviation of a lobe (Gaussian weight of Fourier coefficients) for which a level of the pyramid is
# used. The unit is the distance between neighbouring nodes of the level, which are sums of several coefficients. With
# 2, the weight of a coefficient has an error of up to 1/(12 · 2²) = 2 %, because the variance of its position differs
# by up to 1/6 from the mean variance. Errors of single coefficients cancel in the sum.
_LEAST_DEVIATION = 2.0
# Highest level of the pyramid, in which a node of level n is the sum of 2ⁿ × 2ⁿ orders. A lobe (Gaussian weight) at
# this level has a standard deviation of at least 2 · 2¹⁰ orders, so that it covers a block of thousands of orders along
# each axis.
_MOST_LEVEL = 10


class LobePyramid:
    """Sums of powers |H|² of Fourier coefficients with Gaussian weights of any width, and their transpose."""

    def __init__(self, series: CoefficientSeries, size_um: tuple[float, float], exponent: float) -> None:
        """Set the diffraction orders, and the levels of a pyramid of sums over 2ⁿ × 2ⁿ neighbouring orders.

        Args:
            series: Chebyshev series in κ of the powers |H|² of Fourier coefficients, and the rectangle (block) of the
                orders (r, s) of these coefficients.
            size_um: Size of the patch (y, x) [µm].
            exponent: Coefficients with weights below e^−exponent are neglected.
        """
        self._block, self._places, self._size_um = series.block, series.sites.places, size_um
        self._own = series.lobes(exponent)
        self._is_axis = [count > 1 for count in series.block.shape]
        self._levels: list[GaussianLobes] = []
        for level in range(1, _MOST_LEVEL + 1):
            rows, columns = self._shape(level)
            places = np.arange(rows * columns, dtype=np.int32)
            size = tuple(
                length / 2**level if axis else length for length, axis in zip(size_um, self._is_axis, strict=True)
            )
            self._levels.append(
                GaussianLobes(series.rows, Block((0, 0), (rows, columns)), places, (size[0], size[1]), exponent)
            )

    def _shape(self, level: int) -> tuple[int, int]:
        """Return the number of nodes (sums of 2ⁿ × 2ⁿ neighbouring coefficients) of the level n along (y, x)."""
        rows, columns = self._block.shape
        for _ in range(level):
            rows, columns = (rows // 2 + 1 if rows > 1 else 1), (columns // 2 + 1 if columns > 1 else 1)
        return rows, columns

    def sums_of(self, coefficients: NDArray[np.float64]) -> Callable[[Pairs], NDArray[np.float64]]:
        """Return a function that sums |H|² with Gaussian weights for p pairs (direction, wavelength), shape (p,).

        ``coefficients`` has the Chebyshev series of the powers |H|² of Fourier coefficients.
        """

        @functools.cache
        def joined(level: int) -> NDArray[np.float64]:
            if level == 0:
                return coefficients[self._places].reshape(*self._block.shape, -1)
            return self._joined(joined(level - 1))

        def sums(pairs: Pairs) -> NDArray[np.float64]:
            result = np.empty(len(pairs))
            for level, chosen, own, factors in self._split(pairs):
                if level == 0:
                    result[chosen] = self._own.sums(own, coefficients)
                else:
                    result[chosen] = factors * self._levels[level - 1].sums(
                        own, joined(level).reshape(-1, coefficients.shape[1])
                    )
            return result

        return sums

    def spread(self, parts: Iterable[tuple[Pairs, NDArray[np.float64]]], rows: NDArray[np.float64]) -> None:
        """Add the adjoints (derivatives of a loss) of the powers |H|² to ``rows``, one row of k terms per order.

        ``parts`` has groups of pairs (a direction and a wavelength), each with the adjoints of its weighted sums.
        ``rows`` has the shape (size, k), with a row for each order of the block.
        """
        nodes = [rows]
        for pairs, adjoints in parts:
            for level, chosen, own, factors in self._split(pairs):
                while len(nodes) <= level:
                    nodes.append(np.zeros((math.prod(self._shape(len(nodes))), rows.shape[1])))
                lobes = self._levels[level - 1] if level else self._own
                lobes.spread(own, factors * adjoints[chosen], nodes[level])
        for level in range(len(nodes) - 1, 0, -1):
            coarse = nodes[level].reshape(*self._shape(level), -1)
            self._add_divided(coarse, nodes[level - 1].reshape(*self._shape(level - 1), -1))

    def _split(self, pairs: Pairs) -> Iterator[tuple[int, NDArray[np.int64], Pairs, NDArray[np.float64]]]:
        """Group the pairs of a direction and a wavelength by the level of the pyramid that computes their sums.

        A node of level n is the sum of 2ⁿ × 2ⁿ orders. Each item is the level, the indices of its pairs, these pairs
        with Gaussians for the nodes of the level, and factors by which their sums are multiplied.
        """
        xx, xy, yy = pairs.forms.T
        scale = 0.5 / (xx * yy - xy * xy)
        variances = np.stack([scale * yy, -scale * xy, scale * xx], axis=1)
        least, largest = self._deviations(variances)
        levels = np.clip(np.floor(np.log2(np.maximum(least, 1.0) / _LEAST_DEVIATION)), 0, _MOST_LEVEL).astype(np.int64)
        # Long lobes (Gaussian weights) are processed separately from short lobes. The transposed sum searches for pairs
        # (a direction and a wavelength) around each node up to the length of the longest lobe, which would take too
        # long for short lobes.
        lengths = np.floor(np.log2(np.maximum(largest, 1.0))).astype(np.int64)
        for level, length in np.unique(np.stack([levels, lengths], axis=1), axis=0).tolist():
            chosen = np.flatnonzero((levels == level) & (lengths == length))
            own = Pairs(pairs.centres[chosen], pairs.forms[chosen], pairs.kappas[chosen])
            yield level, chosen, *(self._at_level(own, variances[chosen], level) if level else (own, np.ones(len(own))))

    def _deviations(self, variances: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the least and the largest standard deviation of each lobe (Gaussian weight) along any line [orders].

        Only axes with several orders count.
        """
        length_y, length_x = (
            length if axis else 0.0 for length, axis in zip(self._size_um, self._is_axis, strict=True)
        )
        xx, xy, yy = (variances * [length_x**2, length_x * length_y, length_y**2]).T
        middle, half = (xx + yy) / 2.0, np.hypot((xx - yy) / 2.0, xy)
        largest = np.sqrt(middle + half)
        return np.sqrt(np.maximum(middle - half, 0.0)) if all(self._is_axis) else largest, largest

    def _at_level(self, pairs: Pairs, variances: NDArray[np.float64], level: int) -> tuple[Pairs, NDArray[np.float64]]:
        """Return pairs (direction, wavelength) that sum the nodes of a level, and factors of these sums.

        The nodes of level n are sums of 2ⁿ × 2ⁿ neighbouring orders. The centres of the new pairs are relative to the
        first order of the block. Their lobes have a smaller variance, because the nodes already spread each
        coefficient. The factors correct the sums for it.
        """
        centres, reduced = pairs.centres.copy(), variances.copy()
        for axis, column, entry in ((0, 1, 2), (1, 0, 0)):
            if self._is_axis[axis]:
                step = 1.0 / self._size_um[axis]
                centres[:, column] -= self._block.first[axis] * step
                reduced[:, entry] -= (4**level - 1) / 6.0 * step**2
        xx, xy, yy = reduced.T
        determinants = xx * yy - xy * xy
        forms = 0.5 * np.stack([yy, -xy, xx], axis=1) / determinants[:, None]
        wide = variances[:, 0] * variances[:, 2] - variances[:, 1] ** 2
        return Pairs(centres, forms, pairs.kappas), np.sqrt(wide / determinants)

    def _joined(self, fine: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the next level's nodes (sums of several orders), shape (rows, columns, k), from those of a level."""
        for axis in (0, 1):
            if fine.shape[axis] > 1:
                nodes = np.moveaxis(fine, axis, 0)
                coarse = np.zeros((len(nodes) // 2 + 1, *nodes.shape[1:]))
                even, odd = nodes[0::2], 0.5 * nodes[1::2]
                coarse[: len(even)] += even
                coarse[: len(odd)] += odd
                coarse[1 : len(odd) + 1] += odd
                fine = np.moveaxis(coarse, 0, axis)
        return np.ascontiguousarray(fine)

    def _add_divided(self, coarse: NDArray[np.float64], fine: NDArray[np.float64]) -> None:
        """Add values of nodes (sums of orders) to the nodes of the finer level: the transpose of ``_joined``."""
        for axis in (1, 0):
            if fine.shape[axis] > 1:
                nodes = np.moveaxis(coarse, axis, 0)
                divided = np.empty((fine.shape[axis], *nodes.shape[1:]))
                even, odd = divided[0::2], divided[1::2]
                even[:] = nodes[: len(even)]
                odd[:] = 0.5 * (nodes[: len(odd)] + nodes[1 : len(odd) + 1])
                coarse = np.moveaxis(divided, 0, axis)
        fine += coarse
