"""Fourier coefficients of exp(2πiκh) as a series in κ: what is computed once a height field, with NumPy alone.

H_rs(κ) = (1/N) Σ exp(2πiκh) exp(2πi(rx/Lx + sy/Ly)), which is ``numpy.fft.ifft2``. A series of the exponential in κ
(``expansions``; Single 2014, eq. 3.24) needs the transforms of polynomials of the heights only:

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
    from numpy.typing import NDArray

    from warpdiff.expansions import Expansion
    from warpdiff.heightfield import HeightField


_CONSTANT_AXIS_UM = 0.01


@dataclass(frozen=True)
class Block:
    """The coefficients that are kept: a rectangle around r = s = 0, or all of them.

    Attributes:
        count: Number of coefficients kept along (y, x).
        origin: Where r = s = 0 is stored, along (y, x); index j holds s = j − origin, modulo ``shape``.
        shape: Number of distinct coefficients, the samples (ny, nx) of the height field.
    """

    count: tuple[int, int]
    origin: tuple[int, int]
    shape: tuple[int, int]

    @classmethod
    def covering(cls, hf: HeightField, frequency: float, reach: tuple[int, int]) -> Block:
        """The smallest block with every coefficient within ``reach`` of a frequency up to ``frequency`` [1/µm].

        Where that takes more coefficients than there are samples, all are kept and looked up periodically, as the
        sum over samples is periodic.
        """
        count, origin = [], []
        for samples, length, extra in zip(hf.shape, hf.size_um, reach, strict=True):
            half = math.ceil(frequency * length) + extra
            whole = 2 * half + 1 >= samples
            count.append(samples if whole else 2 * half + 1)
            origin.append(0 if whole else half)
        return cls((count[0], count[1]), (origin[0], origin[1]), hf.shape)

    def orders(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The integers s and r of the rows and columns, each in −n/2 … (n−1)/2 [shapes (my,), (mx,)]."""
        found = []
        for count, origin, samples in zip(self.count, self.origin, self.shape, strict=True):
            order = np.arange(count, dtype=np.int64) - origin
            found.append((order + samples // 2) % samples - samples // 2)
        return found[0], found[1]


def axis_lengths_um(hf: HeightField) -> tuple[float, float]:
    """The patch's (Ly, Lx) [µm] as the look-up of coefficients takes them.

    An axis of one sample is constant and has the order 0 alone: a length far below the wavelength keeps it the nearest
    one, and the Gaussian over it what it is, for every direction.
    """
    return tuple(_CONSTANT_AXIS_UM if n == 1 else length for n, length in zip(hf.shape, hf.size_um, strict=True))  # type: ignore[return-value]


def series_coefficients(
    hf: HeightField,
    expansion: Expansion,
    terms: int,
    block: Block,
    *,
    threads: int = 1,
    dtype: Any = np.complex128,
) -> NDArray[np.complexfloating]:
    """The F_n[s, r] of the module's formula, transformed in float64.

    Args:
        hf: The height field.
        expansion: The series.
        terms: Number of terms, n = 0 … terms − 1.
        block: Which coefficients to keep.
        threads: NumPy transforms to run side by side.
        dtype: What to store the result as.

    Returns:
        Array of shape (my, mx, terms); Σ_n b_n(x) F_n are the H_rs without their common phase.
    """
    offset, scale = expansion.offset_and_scale(hf)
    scaled = (hf.heights_um - offset) / (scale or 1.0)
    s, r = block.orders()
    # h is real, so that column −r is the conjugate of column r with the rows reversed: one half is transformed, and
    # of it only the columns that are kept.
    columns = int(np.abs(r).max()) + 1
    keep = np.where(r >= 0, r, -r)
    rows = np.where(r[None, :] >= 0, s[:, None], -s[:, None]) % hf.shape[0]
    result = np.empty((*block.count, terms), dtype=dtype)

    def transform(n: int) -> None:
        partial = np.fft.rfft(expansion.polynomial(n, scaled), axis=1, norm="forward")[:, :columns]
        half = np.fft.fft(partial, axis=0, norm="forward")[rows, keep[None, :]]
        # rfft has the kernel exp(−2πi…), ifft2 the conjugate one.
        result[:, :, n] = (1j**n) * np.where(r[None, :] >= 0, half.conj(), half)

    with ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        list(pool.map(transform, range(terms)))
    return result
