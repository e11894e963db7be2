"""Fourier coefficients of exp(2πiκh) as a series in κ: what is computed once a height field, with NumPy alone.

H_rs(κ) = (1/N) Σ exp(2πiκh) exp(2πi(rx/Lx + sy/Ly)), which is ``numpy.fft.ifft2``. Its Taylor series in κ (Single
2014, eq. 3.24) needs the transforms of the powers of h only:

    H_rs(κ) = e^{2πiκc} Σ_n xⁿ/n! · F_n[s, r],   F_n = iⁿ · ifft2(((h − c)/a)ⁿ),   x = 2πκa,

with c the middle of the height range and a half of it. The factor in front is a phase common to all coefficients;
centring halves the largest argument, and with it the number of terms and their cancellation.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield import HeightField

MAX_TERMS = 64
# Heights in nanometres given for micrometres must end in a message about their range, not in an overflow.
_LARGEST_EXPONENT = 700.0


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


def height_middle_and_half_range(hf: HeightField) -> tuple[float, float]:
    """The c and a [µm] of the module's formula; a flat field has a = 0."""
    low, high = float(hf.heights_um.min()), float(hf.heights_um.max())
    return (low + high) / 2.0, (high - low) / 2.0


def taylor_remainder(argument: float, terms: int) -> float:
    """Bound of the error of ``terms`` Taylor terms of e^{ix}, |x| <= ``argument``: x^N/N! with N = ``terms``.

    Single 2014, eq. 3.28, with M = 1: the derivatives of e^{ix} have modulus one.
    """
    if argument == 0.0:
        return 0.0
    return math.exp(min(terms * math.log(argument) - math.lgamma(terms + 1.0), argument, _LARGEST_EXPONENT))


def taylor_term_count(argument: float, tolerance: float, *, most: float = math.inf) -> int:
    """The fewest terms whose remainder is within ``tolerance`` for |x| <= ``argument``, or ``most``."""
    terms = 1
    while terms < most and taylor_remainder(argument, terms) > tolerance:
        terms += 1
    return terms


def taylor_basis(argument: ArrayLike, terms: int) -> NDArray[np.float64]:
    """xⁿ/n! for n = 0 … terms − 1, shape (..., terms), float64."""
    x = np.asarray(argument, dtype=np.float64)[..., None]
    steps = np.concatenate([np.ones_like(x), x / np.arange(1, terms)], axis=-1)
    return np.asarray(np.cumprod(steps, axis=-1))


def taylor_coefficients(
    hf: HeightField,
    terms: int,
    block: Block,
    *,
    threads: int = 1,
    dtype: Any = np.complex128,
) -> NDArray[np.complexfloating]:
    """The F_n[s, r] of the module's formula, transformed in float64.

    Args:
        hf: The height field.
        terms: Number of powers, n = 0 … terms − 1.
        block: Which coefficients to keep.
        threads: NumPy transforms to run side by side.
        dtype: What to store the result as.

    Returns:
        Array of shape (my, mx, terms); Σ_n xⁿ/n! F_n are the H_rs without their common phase.
    """
    middle, half_range = height_middle_and_half_range(hf)
    scaled = (hf.heights_um - middle) / (half_range or 1.0)
    s, r = block.orders()
    # h is real, so that column −r is the conjugate of column r with the rows reversed: one half is transformed, and
    # of it only the columns that are kept.
    columns = int(np.abs(r).max()) + 1
    keep = np.where(r >= 0, r, -r)
    rows = np.where(r[None, :] >= 0, s[:, None], -s[:, None]) % hf.shape[0]
    result = np.empty((*block.count, terms), dtype=dtype)

    def transform(n: int) -> None:
        partial = np.fft.rfft(scaled**n, axis=1, norm="forward")[:, :columns]
        half = np.fft.fft(partial, axis=0, norm="forward")[rows, keep[None, :]]
        # rfft has the kernel exp(−2πi…), ifft2 the conjugate one.
        result[:, :, n] = (1j**n) * np.where(r[None, :] >= 0, half.conj(), half)

    with ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        list(pool.map(transform, range(terms)))
    return result
