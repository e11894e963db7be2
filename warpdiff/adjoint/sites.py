"""Frequencies of Fourier coefficients, reduced to half of the frequency plane, and Fourier transforms at them.

An order (s, r) is a frequency of s cycles along y and r cycles along x over the array. Its opposite is (−s, −r). A site
is an order in half of the frequency plane, together with all orders that have the same Fourier coefficient.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Block:
    """Rectangular block of diffraction orders (s, r).

    Attributes:
        first: Lowest order along (y, x).
        shape: Number of orders along (y, x).
    """

    first: tuple[int, int]
    shape: tuple[int, int]

    @property
    def size(self) -> int:
        """Number of diffraction orders in the block."""
        return self.shape[0] * self.shape[1]

    def joined(self, other: Block) -> Block:
        """Return the smallest block that contains this block and another block."""
        first = np.minimum(self.first, other.first)
        beyond = np.maximum(np.add(self.first, self.shape), np.add(other.first, other.shape))
        return Block((int(first[0]), int(first[1])), (int(beyond[0] - first[0]), int(beyond[1] - first[1])))

    def orders(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return s and r of all diffraction orders (s, r) of the block, row by row, both of shape (size,)."""
        s, r = (np.arange(first, first + count) for first, count in zip(self.first, self.shape, strict=True))
        return np.repeat(s, len(r)), np.tile(r, len(s))


class Sites:
    """Frequencies of the distinct Fourier coefficients of real arrays; they lie in half of the frequency plane.

    The coefficient of a real array at (−s, −r) is the complex conjugate of the coefficient at (s, r), and coefficients
    are periodic in s and r. The coefficient of any order is therefore that of a site, or the complex conjugate of it.

    Attributes:
        count: Number of sites p.
        places: For each of n orders, the number of its site, or this number plus p if the order is the opposite of the
            site, shape (n,).
        are_distinct: Whether all elements of ``places`` are different.
    """

    def __init__(self, shape: tuple[int, int], s: NDArray[np.int64], r: NDArray[np.int64]) -> None:
        """Find the sites (distinct frequencies) of n orders (s, r) for arrays of the shape ``shape``, (ny, nx)."""
        self._shape = ny, nx = shape
        column = r % nx
        is_opposite = column > nx // 2
        row = np.where(is_opposite, -s, s) % ny
        column = np.where(is_opposite, nx - column, column)
        flat, index = np.unique(column * ny + row, return_inverse=True)
        self.count = len(flat)
        self.places = (index + self.count * is_opposite).astype(np.int32)
        self.are_distinct = bool(np.bincount(self.places, minlength=1).max() <= 1)
        # Only the columns of the transform from 0 to the largest column of a site (frequency) are transformed along y,
        # to save time.
        self._columns = int(column.max()) + 1
        self._flat = flat

    @property
    def columns(self) -> NDArray[np.int64]:
        """Orders r along x (column indices, at least 0) of the sites, shape (p,)."""
        return np.asarray(self._flat // self._shape[0])

    def transform(self, values: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Return the inverse Fourier transform (ifft2) of a real array (ny, nx) at the p sites (frequencies), (p,)."""
        half = np.ascontiguousarray(np.fft.rfft(values, axis=1)[:, : self._columns].T)
        return np.asarray(np.conj(np.fft.fft(half, axis=1).ravel()[self._flat]) / values.size)

    def transposed(self, values: NDArray[np.complex128]) -> NDArray[np.float64]:
        """Return the transpose of ``transform``: the real array a with Re Σ conj(v) transform(b) = Σ a b for every b.

        Args:
            values: Complex numbers v at the sites, shape (p,).
        """
        ny, nx = self._shape
        half = np.zeros(self._columns * ny, dtype=np.complex128)
        half[self._flat] = values
        half = np.conj(np.fft.fft(half.reshape(self._columns, ny), axis=1).T)
        # NumPy's irfft counts the columns 0 and nx/2 once and all other columns twice. The factor 0.5 cancels the 2.
        half[:, 1 : (nx + 1) // 2] *= 0.5
        return np.asarray(np.fft.irfft(half, n=nx, axis=1) / ny)
