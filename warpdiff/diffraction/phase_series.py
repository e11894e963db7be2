"""Series of exp(2πiκh) that separate κ from the heights: Taylor, centred Taylor and Jacobi-Anger.

With g = (h − c)/a and x = 2πκa each is e^{ixg} ≈ Σ_n b_n(x) iⁿ p_n(g): the polynomials p_n of the heights are
transformed once, the basis b_n(x) is evaluated at each wavelength. What follows need not know which series it is.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField

MAX_TERMS = 128
# 128 terms serve some 30 cycles of phase.
_MOST_CYCLES = 100.0
# Where the bounds of a Taylor series would overflow.
_LARGEST_EXPONENT = 700.0


def check_cycles(heightfield: HeightField, kappa: float) -> None:
    """Refuse a height range that no series of ``MAX_TERMS`` comes near, for |κ| up to ``kappa`` [1/µm].

    It is some other unit's, and would ask for tables and quadratures without end.
    """
    cycles = kappa * heightfield.height_range_um
    if cycles > _MOST_CYCLES:
        raise ArgumentValueError(
            f"{ref('heightfield')} has a height range of {heightfield.height_range_um:.3g} µm, which is {cycles:.2g} "
            f"wavelengths of path, and at most {_MOST_CYCLES:g} are supported: heights are in µm, check "
            f"{ref('height_range_um')} or the unit of the heights"
        )


@dataclass(frozen=True)
class Expansion:
    """A series of exp(2πiκh) in κ: its basis, its remainder, and how many terms keep an error.

    Attributes:
        label: Its name in a sentence.
        centred: Whether c is the middle of the height range and a half of it; otherwise c is the lowest height and a
            the whole range. The phase e^{2πiκc} that this leaves out is common to all coefficients.
        polynomials: p_0(g), p_1(g), … without end: takes an array g, in −1 … 1 or 0 … 1.
        basis: b_n(x): takes an array x and the number of terms, returns shape (..., terms), float64.
        remainder: Bound of the series' error for |x| up to the first argument with the second's number of terms.
        growth: Bound of Σ |b_n(x)| for |x| up to the argument: what float32 rounding is multiplied with.
    """

    label: str
    centred: bool
    polynomials: Callable[[NDArray[np.float64]], Iterator[NDArray[np.float64]]]
    basis: Callable[[ArrayLike, int], NDArray[np.float64]]
    remainder: Callable[[float, int], float]
    growth: Callable[[float], float]

    def offset_and_scale(self, heightfield: HeightField) -> tuple[float, float]:
        """The c and a [µm] of a height field; a flat one has a = 0."""
        low, high = float(heightfield.heights_um.min()), float(heightfield.heights_um.max())
        return ((low + high) / 2.0, (high - low) / 2.0) if self.centred else (low, high - low)

    @functools.lru_cache(maxsize=256)  # noqa: B019 (there are a few expansions, made once)
    def term_count(self, argument: float, tolerance: float) -> int:
        """The fewest terms whose remainder is within ``tolerance`` for |x| <= ``argument``, at most ``MAX_TERMS``."""
        terms = 1
        while terms < MAX_TERMS and self.remainder(argument, terms) > tolerance:
            terms += 1
        return terms


def _taylor_basis(argument: ArrayLike, terms: int) -> NDArray[np.float64]:
    """xⁿ/n! (Single 2014, eq. 3.24)."""
    x = np.asarray(argument, dtype=np.float64)[..., None]
    steps = np.concatenate([np.ones_like(x), x / np.arange(1, terms)], axis=-1)
    return np.asarray(np.cumprod(steps, axis=-1))


def _taylor_remainder(argument: float, terms: int) -> float:
    """x^N/N!: Single 2014, eq. 3.28, with M = 1, for the derivatives of e^{ix} have modulus one."""
    if argument == 0.0:
        return 0.0
    return math.exp(min(terms * math.log(argument) - math.lgamma(terms + 1.0), argument, _LARGEST_EXPONENT))


def _taylor_growth(argument: float) -> float:
    return math.exp(min(argument, _LARGEST_EXPONENT))


def bessel_j(argument: ArrayLike, count: int) -> NDArray[np.float64]:
    """J_0 … J_{count−1} of real arguments, shape (..., count), to some 1e-15 absolute.

    They are the Fourier coefficients of e^{ix sin θ}, an entire function: beyond |x| they fall faster than
    exponentially, and a transform of a few more points than the sum of both is exact.
    """
    x = np.asarray(argument, dtype=np.float64)
    largest = float(np.max(np.abs(x), initial=0.0))
    points = 2 ** math.ceil(math.log2(count + largest + 12.0 * largest ** (1.0 / 3.0) + 40.0))
    theta = 2.0 * math.pi * np.arange(points) / points
    transform = np.fft.fft(np.exp(1j * x[..., None] * np.sin(theta)), axis=-1, norm="forward")
    return np.asarray(transform[..., :count].real)


def _jacobi_anger_basis(argument: ArrayLike, terms: int) -> NDArray[np.float64]:
    """J_0(x), 2 J_n(x): e^{ixg} = J_0(x) + 2 Σ iⁿ J_n(x) T_n(g) (Dhillon and Ghosh 2016 for this use)."""
    values = 2.0 * bessel_j(argument, terms)
    values[..., 0] /= 2.0
    return values


def _jacobi_anger_remainder(argument: float, terms: int) -> float:
    """2 Σ_{n>=N} |J_n|, at the largest argument: |J_n(x)| grows with x as long as x <= n."""
    if terms < argument:
        return 2.0
    beyond = math.ceil(12.0 * argument ** (1.0 / 3.0)) + 40
    return float(2.0 * np.sum(np.abs(bessel_j(argument, terms + beyond)[terms:])))


def _jacobi_anger_growth(argument: float) -> float:
    """|J_0| + 2 Σ |J_n| <= √(1 + 2N) for N significant terms, by Cauchy-Schwarz from J_0² + 2 Σ J_n² = 1."""
    return math.sqrt(1.0 + 2.0 * (argument + 4.0 * argument ** (1.0 / 3.0) + 4.0))


def _powers(g: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """1, g, g², … without end."""
    value = np.ones_like(g)
    while True:
        yield value
        value = value * g


def _chebyshev(g: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """T_0(g), T_1(g), … without end; within −1 … 1 the recurrence loses nothing."""
    now, after = np.ones_like(g), g
    while True:
        yield now
        now, after = after, 2.0 * g * after - now


EXPANSIONS: dict[str, Expansion] = {
    "taylor": Expansion("Taylor", True, _powers, _taylor_basis, _taylor_remainder, _taylor_growth),
    "taylor-uncentred": Expansion("uncentred Taylor", False, _powers, _taylor_basis, _taylor_remainder, _taylor_growth),
    "jacobi-anger": Expansion(
        "Jacobi-Anger", True, _chebyshev, _jacobi_anger_basis, _jacobi_anger_remainder, _jacobi_anger_growth
    ),
}
