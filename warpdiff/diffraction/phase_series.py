"""Series of exp(2πiκh) that separate κ = w/λ from the heights h: Taylor, centred Taylor and Jacobi-Anger.

With g = (h − c)/a, where c and a are a height and a length, and x = 2πκa, a series is e^{ixg} ≈ Σ_n b_n(x) iⁿ p_n(g).
The polynomials p_n of the heights are transformed once. The basis functions b_n(x) are evaluated at each wavelength.
Code that uses the resulting coefficients does not depend on which series was chosen.
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

# Largest number of terms of a series of exp(2πiκh). A series of 128 terms represents heights over which the phase
# changes by about 30 cycles. The value is limited by memory: the size of a table of coefficients is proportional to the
# number of terms.
MAX_TERMS = 128
# Largest accepted number of cycles by which the phase 2πκh changes over the height range. The value is limited by
# memory: tables of coefficients for more cycles are very large.
_MOST_CYCLES = 100.0
# Largest exponent of e in the error bound of a Taylor series. Larger exponents are replaced by it, because e^710 would
# overflow float64.
_LARGEST_EXPONENT = 700.0


def check_cycles(heightfield: HeightField, kappa: float) -> None:
    """Raise an error for a height range far beyond what ``MAX_TERMS`` terms can expand, for |κ| up to ``kappa``.

    κ is w/λ, and the unit of ``kappa`` is 1/µm. The direct sum (``method="direct"``) uses no series and has no such
    limit.
    """
    cycles = kappa * heightfield.height_range_um
    if cycles > _MOST_CYCLES:
        raise ArgumentValueError(
            f"{ref('heightfield')} has a height range of {heightfield.height_range_um:.3g} µm, which is {cycles:.2g} "
            f"wavelengths of path; series and energy factors support at most {_MOST_CYCLES:g}, a range of "
            f"{_MOST_CYCLES / kappa:.3g} µm: reduce the range with {ref('levelled()')} or {ref('cropped()')}, or use "
            f"{ref('method', 'direct')} with {ref('energy', 'stam')}, which has no such limit"
        )


@dataclass(frozen=True)
class Expansion:
    """Series e^{ixg} ≈ Σ_n b_n(x) iⁿ p_n(g) of exp(2πiκh) in κ = w/λ, with bounds of its error.

    Attributes:
        label: Name of the series in messages. In the formula, x is 2πκa, and g is (h − c)/a for the height h.
        centred: Whether c is the middle of the height range and a is half of the range. Otherwise c is the lowest
            height and a is the whole range. The omitted phase e^{2πiκc} is common to all coefficients.
        polynomials: Function of an array g, −1 to 1 or 0 to 1, that yields p_0(g), p_1(g), … without end.
        basis: Function of an array x and a number of terms that returns the functions b_n(x), float64, shape
            (..., terms).
        remainder: Function (x, terms) that returns a bound of the truncation error for arguments up to |x|.
        growth: Function of x that returns a bound of Σ |b_n| for arguments up to |x|. Rounding errors of float32 are
            multiplied by this sum.
    """

    label: str
    centred: bool
    polynomials: Callable[[NDArray[np.float64]], Iterator[NDArray[np.float64]]]
    basis: Callable[[ArrayLike, int], NDArray[np.float64]]
    remainder: Callable[[float, int], float]
    growth: Callable[[float], float]

    def offset_and_scale(self, heightfield: HeightField) -> tuple[float, float]:
        """Return the offset c and the scale a of heights [µm], of g = (h − c)/a; a is 0 for a flat height field."""
        low, high = float(heightfield.heights_um.min()), float(heightfield.heights_um.max())
        return ((low + high) / 2.0, (high - low) / 2.0) if self.centred else (low, high - low)

    @functools.lru_cache(maxsize=256)  # noqa: B019 (expansions are few and live as long as the module)
    def term_count(self, argument: float, tolerance: float) -> int:
        """Return the number of terms with which the series has a truncation error of at most ``tolerance``.

        If no number suffices, the result is ``MAX_TERMS``. ``argument`` is the largest |x| of the series.
        """
        terms = 1
        while terms < MAX_TERMS and self.remainder(argument, terms) > tolerance:
            terms += 1
        return terms


def _taylor_basis(argument: ArrayLike, terms: int) -> NDArray[np.float64]:
    """Return the basis functions xⁿ/n! of the Taylor series (Single 2014, eq. 3.24)."""
    x = np.asarray(argument, dtype=np.float64)[..., None]
    steps = np.concatenate([np.ones_like(x), x / np.arange(1, terms)], axis=-1)
    return np.asarray(np.cumprod(steps, axis=-1))


def _taylor_remainder(argument: float, terms: int) -> float:
    """Return the bound x^N/N! of the remainder of a Taylor series of e^{ix} with N terms (Single 2014, eq. 3.28).

    The bound of the derivatives in that equation, M, is 1, because |e^{ix}| is 1.
    """
    if argument == 0.0:
        return 0.0
    return math.exp(min(terms * math.log(argument) - math.lgamma(terms + 1.0), argument, _LARGEST_EXPONENT))


def _taylor_growth(argument: float) -> float:
    return math.exp(min(argument, _LARGEST_EXPONENT))


def bessel_j(argument: ArrayLike, count: int) -> NDArray[np.float64]:
    """Return the Bessel functions J_0 … J_{count−1} of real arguments, shape (..., count), with errors of about 1e-15.

    The Bessel functions J_n(x) are the Fourier coefficients of e^{ix sin θ}, which decrease faster than exponentially
    for n > |x|. A discrete transform with slightly more than count + |x| points is therefore exact up to rounding.
    """
    x = np.asarray(argument, dtype=np.float64)
    largest = float(np.max(np.abs(x), initial=0.0))
    points = 2 ** math.ceil(math.log2(count + largest + 12.0 * largest ** (1.0 / 3.0) + 40.0))
    theta = 2.0 * math.pi * np.arange(points) / points
    transform = np.fft.fft(np.exp(1j * x[..., None] * np.sin(theta)), axis=-1, norm="forward")
    return np.asarray(transform[..., :count].real)


def _jacobi_anger_basis(argument: ArrayLike, terms: int) -> NDArray[np.float64]:
    """Return the basis J_0(x), 2 J_n(x) of e^{ixg} = J_0(x) + 2 Σ iⁿ J_n(x) T_n(g) (Dhillon and Ghosh 2016)."""
    values = 2.0 * bessel_j(argument, terms)
    values[..., 0] /= 2.0
    return values


def _jacobi_anger_remainder(argument: float, terms: int) -> float:
    """Return the bound 2 Σ_{n>=N} |J_n(x)| of the remainder of a Jacobi-Anger series with N terms.

    The bound holds for all arguments up to x, because |J_n(x)| grows with x for x <= n.
    """
    if terms < argument:
        return 2.0
    beyond = math.ceil(12.0 * argument ** (1.0 / 3.0)) + 40
    return float(2.0 * np.sum(np.abs(bessel_j(argument, terms + beyond)[terms:])))


def _jacobi_anger_growth(argument: float) -> float:
    """Return the bound √(1 + 2N) of |J_0| + 2 Σ |J_n|, where N is the number of terms that are not negligible.

    The bound follows from J_0² + 2 Σ J_n² = 1 by the inequality of Cauchy and Schwarz.
    """
    return math.sqrt(1.0 + 2.0 * (argument + 4.0 * argument ** (1.0 / 3.0) + 4.0))


def _powers(g: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Yield the powers 1, g, g², … of the values ``g``, without end."""
    value = np.ones_like(g)
    while True:
        yield value
        value = value * g


def _chebyshev(g: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Yield Chebyshev polynomials T_0(g), T_1(g), … without end; the recurrence is stable for g from −1 to 1."""
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
