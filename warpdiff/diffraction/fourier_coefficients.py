"""Fourier coefficients of exp(2πiκh) as a series in κ = w/λ, computed once per height field with NumPy.

H_rs(κ) = (1/N) Σ exp(2πiκh) exp(2πi(rx/Lx + sy/Ly)), which is ``numpy.fft.ifft2``. A series of the exponential in κ
(``phase_series``; Single 2014, eq. 3.24) requires only transforms of polynomials of the heights:

    H_rs(κ) = e^{2πiκc} Σ_n b_n(x) F_n[s, r],   F_n = iⁿ · ifft2(p_n((h − c)/a)),   x = 2πκa.

Here N is the number of samples, and g = (h − c)/a are the heights after an offset c and a scale a (``Expansion``). The
polynomials p_n(g) and the functions b_n(x) belong to the series: gⁿ and xⁿ/n! to the Taylor series, Chebyshev
polynomials and Bessel functions to the Jacobi-Anger series. The first factor is a phase that is common to all
coefficients and does not change a power.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer. w is its component along the normal.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import DTypeLike, NDArray

    from warpdiff.diffraction.phase_series import Expansion
    from warpdiff.heightfield.field import HeightField


# Size that is assumed for an axis with a single sample [µm]. In (u, v), the distance between neighbouring diffraction
# orders is λ divided by the size. With a size far below a wavelength, order 0 is the only order near any direction.
_CONSTANT_AXIS_UM = 0.01


@dataclass(frozen=True)
class Grid:
    """Grid of the spatial frequencies at which Fourier coefficients are computed.

    Attributes:
        shape: Number of distinct frequencies (ny, nx).
        lengths_um: Inverse of the distance of neighbouring frequencies along (y, x) [µm]. This is the size of the
            patch, or twice the size if the grid includes frequencies halfway between the orders.
        taper: Factors by which the rows and columns of the samples of exp(2πiκh), with κ = w/λ, are multiplied before
            the Fourier transform, shapes (hy,) and (hx,). The origin of x and y is then the middle sample. None means
            no factors; the origin is then the first sample.
    """

    shape: tuple[int, int]
    lengths_um: tuple[float, float]
    taper: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None


def patch_grid(heightfield: HeightField) -> Grid:
    """Return the frequencies of an infinite periodic surface: r/Lx and s/Ly for integers r and s.

    Along an axis with a single sample the surface is constant and has order 0 only. ``_CONSTANT_AXIS_UM`` replaces the
    length of the axis, so that order 0 is the nearest order for every direction.
    """
    lengths = [
        _CONSTANT_AXIS_UM if n == 1 else length
        for n, length in zip(heightfield.shape, heightfield.size_um, strict=True)
    ]
    return Grid(heightfield.shape, (lengths[0], lengths[1]))


def fine_grid(heightfield: HeightField, kernel_transform: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Grid:
    """Return the frequencies r/(2Lx) and s/(2Ly), from which the spectrum of a single period is interpolated.

    An interpolation convolves the spectrum with a kernel. This is undone if the samples of exp(2πiκh) are first divided
    by the Fourier transform of the kernel, ``kernel_transform``, a function of arguments from −1/4 to 1/4. The taper of
    the grid has the factors of this division.
    """
    shape = [1 if n == 1 else 2 * n for n in heightfield.shape]
    # The spectrum of the patch is constant along an axis with a single sample, and needs no interpolation there.
    taper = [
        1.0 / kernel_transform((np.arange(n) - n // 2) / m) if n > 1 else np.ones(1)
        for n, m in zip(heightfield.shape, shape, strict=True)
    ]
    lengths = [length * m / n for length, n, m in zip(heightfield.size_um, heightfield.shape, shape, strict=True)]
    return Grid((shape[0], shape[1]), (lengths[0], lengths[1]), (taper[0], taper[1]))


@dataclass(frozen=True)
class Block:
    """Block of Fourier coefficients (r, s) to store: a rectangle around r = s = 0, or all of them.

    Attributes:
        count: Number of stored coefficients along (y, x).
        origin: Index of r = s = 0 along (y, x); the row with the index j has the order s = j − origin, modulo
            ``shape``.
        shape: Number of distinct coefficients of the grid of frequencies along (y, x).
    """

    count: tuple[int, int]
    origin: tuple[int, int]
    shape: tuple[int, int]

    @classmethod
    def covering(cls, grid: Grid, frequency: float, neighbour_extent: tuple[int, int]) -> Block:
        """Return the block of all frequencies up to ``frequency`` [1/µm], and ``neighbour_extent`` more on each side.

        If the grid has fewer frequencies, the block contains all of them, and look-ups repeat the coefficients
        periodically.
        """
        count, origin = [], []
        for samples, length, extra in zip(grid.shape, grid.lengths_um, neighbour_extent, strict=True):
            half = math.ceil(frequency * length) + extra
            is_complete = 2 * half + 1 >= samples
            count.append(samples if is_complete else 2 * half + 1)
            origin.append(0 if is_complete else half)
        return cls((count[0], count[1]), (origin[0], origin[1]), grid.shape)

    def orders(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the diffraction orders s of the rows and r of the columns of the block, shapes (my,) and (mx,)."""
        orders = []
        for count, origin, samples in zip(self.count, self.origin, self.shape, strict=True):
            order = np.arange(count, dtype=np.int64) - origin
            orders.append((order + samples // 2) % samples - samples // 2)
        return orders[0], orders[1]


def series_coefficients(
    heightfield: HeightField, expansion: Expansion, terms: int, block: Block, *,
    taper: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None, threads: int = 1,
    dtype: DTypeLike = np.complex128,
) -> NDArray[np.complexfloating]:  # fmt: skip
    """Return the coefficients F_n[s, r] of the series in κ = w/λ of Fourier coefficients, transformed in float64.

    Args:
        heightfield: Height field to transform.
        expansion: Series of the exponential, which defines the polynomials p_n, the offset c and the scale a.
        terms: Number of terms, n = 0 … terms − 1.
        block: Block of the coefficients to compute.
        taper: Factors of the rows and columns of samples, as in :class:`Grid`.
        threads: Number of Fourier transforms that run in parallel.
        dtype: Type of the result, complex.

    Returns:
        F_n, shape (my, mx, terms). The sum Σ_n b_n(x) F_n is H_rs without the common phase.
    """
    offset, scale = expansion.offset_and_scale(heightfield)
    scaled = (heightfield.heights_um - offset) / (scale or 1.0)
    s, r = block.orders()
    # The polynomials of the heights are real. The Fourier coefficients of column −r are therefore complex conjugates of
    # those of column r, with the rows in reverse order, and only the columns r >= 0 are transformed.
    columns = int(np.abs(r).max()) + 1
    keep = np.where(r >= 0, r, -r)
    rows = np.where(r[None, :] >= 0, s[:, None], -s[:, None]) % block.shape[0]
    result = np.empty((*block.count, terms), dtype=dtype)
    phase: NDArray[np.complex128] | float = 1.0
    if taper is not None:
        turns = [order * (n // 2) / m for order, n, m in zip((s, r), heightfield.shape, block.shape, strict=True)]
        phase = np.exp(-2j * math.pi * (turns[0][:, None] + turns[1]))
    polynomials = expansion.polynomials(scaled)

    def transform(n: int, values: NDArray[np.float64]) -> None:
        if taper is not None:
            values = values * taper[0][:, None] * taper[1]
        partial = np.fft.rfft(values, n=block.shape[1], axis=1)[:, :columns] / heightfield.shape[1]
        half = np.fft.fft(partial, n=block.shape[0], axis=0)[rows, keep[None, :]] / heightfield.shape[0]
        # NumPy's rfft multiplies the samples by exp(−2πi…), but the definition of the Fourier coefficients requires
        # exp(+2πi…). The complex conjugate of the sum converts one to the other, because the polynomials are real.
        result[:, :, n] = (1j**n) * np.where(r[None, :] >= 0, half.conj(), half) * phase

    with ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        # A polynomial is an array as large as the heights. To save memory, only as many polynomials are computed at a
        # time as the threads can transform at a time.
        for first in range(0, terms, max(1, threads)):
            batch = [(n, next(polynomials)) for n in range(first, min(terms, first + max(1, threads)))]
            list(pool.map(lambda task: transform(*task), batch))
    return result
