"""Fourier coefficients of exp(2πiκh) as a series in κ, computed once per height field with NumPy.

H_rs(κ) = (1/N) Σ exp(2πiκh) exp(2πi(rx/Lx + sy/Ly)), which is ``numpy.fft.ifft2``. A series of the exponential in κ
(``phase_series``; Single 2014, eq. 3.24) needs the transforms of polynomials of the heights only:

    H_rs(κ) = e^{2πiκc} Σ_n b_n(x) F_n[s, r],   F_n = iⁿ · ifft2(p_n((h − c)/a)),   x = 2πκa.

The factor in front is a phase common to all coefficients, which no power depends on.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from warpdiff.diffraction.phase_series import Expansion
    from warpdiff.heightfield.field import HeightField


_CONSTANT_AXIS_UM = 0.01


@dataclass(frozen=True)
class Grid:
    """The frequencies that coefficients are computed at.

    Attributes:
        shape: Number of distinct ones (ny, nx).
        lengths_um: Their number per unit of frequency (y, x) [µm]: the patch's size, or a multiple of it.
        taper: Weights of the samples' rows and columns, shapes (hy,) and (hx,), from the middle sample on; None is 1,
            with the origin in the first sample.
    """

    shape: tuple[int, int]
    lengths_um: tuple[float, float]
    taper: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None


def patch_grid(heightfield: HeightField) -> Grid:
    """The frequencies of the patch repeated without end: whole orders r/Lx and s/Ly.

    An axis of one sample is constant and has the order 0 alone: a length far below the wavelength keeps it the nearest
    one, and the Gaussian over it what it is, for every direction.
    """
    lengths = [
        _CONSTANT_AXIS_UM if n == 1 else length
        for n, length in zip(heightfield.shape, heightfield.size_um, strict=True)
    ]
    return Grid(heightfield.shape, (lengths[0], lengths[1]))


def fine_grid(heightfield: HeightField, kernel_transform: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Grid:
    """Half orders, with the samples divided by the transform of the kernel that interpolates between them.

    One copy of a height field has a spectrum between its orders too. The transform takes frequencies in −1/4 … 1/4.
    """
    shape = [1 if n == 1 else 2 * n for n in heightfield.shape]
    # An axis of one sample has the same value at every frequency: nothing is interpolated along it.
    taper = [
        1.0 / kernel_transform((np.arange(n) - n // 2) / m) if n > 1 else np.ones(1)
        for n, m in zip(heightfield.shape, shape, strict=True)
    ]
    lengths = [length * m / n for length, n, m in zip(heightfield.size_um, heightfield.shape, shape, strict=True)]
    return Grid((shape[0], shape[1]), (lengths[0], lengths[1]), (taper[0], taper[1]))


@dataclass(frozen=True)
class Block:
    """The coefficients that are kept: a rectangle around r = s = 0, or all of them.

    Attributes:
        count: Number of coefficients kept along (y, x).
        origin: Where r = s = 0 is stored, along (y, x); index j holds s = j − origin, modulo ``shape``.
        shape: Number of distinct coefficients, those of the grid.
    """

    count: tuple[int, int]
    origin: tuple[int, int]
    shape: tuple[int, int]

    @classmethod
    def covering(cls, grid: Grid, frequency: float, neighbour_extent: tuple[int, int]) -> Block:
        """The block that holds every coefficient within ``neighbour_extent`` of a frequency up to ``frequency`` [1/µm].

        Where that takes more coefficients than there are, all are kept and looked up periodically, as the sum over
        samples is periodic.
        """
        count, origin = [], []
        for samples, length, extra in zip(grid.shape, grid.lengths_um, neighbour_extent, strict=True):
            half = math.ceil(frequency * length) + extra
            is_complete = 2 * half + 1 >= samples
            count.append(samples if is_complete else 2 * half + 1)
            origin.append(0 if is_complete else half)
        return cls((count[0], count[1]), (origin[0], origin[1]), grid.shape)

    def orders(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The integers s and r of the rows and columns, each in −n/2 … (n−1)/2 [shapes (my,), (mx,)]."""
        orders = []
        for count, origin, samples in zip(self.count, self.origin, self.shape, strict=True):
            order = np.arange(count, dtype=np.int64) - origin
            orders.append((order + samples // 2) % samples - samples // 2)
        return orders[0], orders[1]


def series_coefficients(
    heightfield: HeightField, expansion: Expansion, terms: int, block: Block, *,
    taper: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None, threads: int = 1, dtype: Any = np.complex128,
) -> NDArray[np.complexfloating]:  # fmt: skip
    """The F_n[s, r] of the module's formula, transformed in float64.

    Args:
        heightfield: The height field.
        expansion: The series.
        terms: Number of terms, n = 0 … terms − 1.
        block: Which coefficients to keep.
        taper: Weights of the samples' rows and columns; the origin is then the middle sample, not the first.
        threads: NumPy transforms to run side by side.
        dtype: What to store the result as.

    Returns:
        Array of shape (my, mx, terms); Σ_n b_n(x) F_n are the H_rs without their common phase.
    """
    offset, scale = expansion.offset_and_scale(heightfield)
    scaled = (heightfield.heights_um - offset) / (scale or 1.0)
    s, r = block.orders()
    # h is real, so that column −r is the conjugate of column r with the rows reversed: one half is transformed, and
    # of it only the columns that are kept.
    columns = int(np.abs(r).max()) + 1
    keep = np.where(r >= 0, r, -r)
    rows = np.where(r[None, :] >= 0, s[:, None], -s[:, None]) % block.shape[0]
    result = np.empty((*block.count, terms), dtype=dtype)
    phase: Any = 1.0
    if taper is not None:
        turns = [order * (n // 2) / m for order, n, m in zip((s, r), heightfield.shape, block.shape, strict=True)]
        phase = np.exp(-2j * math.pi * (turns[0][:, None] + turns[1]))
    polynomials = expansion.polynomials(scaled)

    def transform(n: int, values: NDArray[np.float64]) -> None:
        if taper is not None:
            values = values * taper[0][:, None] * taper[1]
        partial = np.fft.rfft(values, n=block.shape[1], axis=1)[:, :columns] / heightfield.shape[1]
        half = np.fft.fft(partial, n=block.shape[0], axis=0)[rows, keep[None, :]] / heightfield.shape[0]
        # rfft has the kernel exp(−2πi…), ifft2 the conjugate one.
        result[:, :, n] = (1j**n) * np.where(r[None, :] >= 0, half.conj(), half) * phase

    with ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        # A few at a time, so that the polynomials of a large field do not lie in memory all at once.
        for first in range(0, terms, max(1, threads)):
            batch = [(n, next(polynomials)) for n in range(first, min(terms, first + max(1, threads)))]
            list(pool.map(lambda task: transform(*task), batch))
    return result
