"""Fourier coefficients H(κ) of exp(2πiκh) at a list of frequencies, as a series in κ, with adjoint and tangent.

Here h are heights and κ = w/λ, where w is the normal component of the scattering vector and λ the wavelength. c is the
middle of the range of the heights, and a is half of this range. With g = (h − c)/a and x = 2πκa, the Jacobi-Anger
expansion is

    H(κ) = Σ_n b_n(x) iⁿ X_n,   X_n = ifft2(T_n(g)),   b_0 = J_0(x), b_n = 2 J_n(x) for n > 0.

J_n are Bessel functions, T_n are Chebyshev polynomials, and U_n those of the second kind. The arrays T_n(g) are real,
so that their transforms are computed for half of the frequency plane. All numbers are in float64.

The sum is H(κ) of the heights h − c. The phase factor e^{2πiκc} is left out, because it does not change any power |H|².
Derivatives treat c and a as constants. They are still exact: the powers do not depend on c, and the sum does not depend
on a. The tangent is the change of a result to first order. The adjoint of a quantity is the derivative of a scalar loss
with respect to this quantity.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.diffraction.phase_series import bessel_j

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from warpdiff.adjoint.sites import Sites

    Complex = NDArray[np.complex128]

# Smallest value of half of the height range [µm]. A flat surface counts as having this value, so that heights can be
# divided by it. The value changes no result, because the series of exp(2πiκh) has the same sum for any scale that is
# large enough.
_LEAST_SCALE_UM = 1e-6


def offset_and_scale(heights_um: NDArray[np.float64]) -> tuple[float, float]:
    """Return the middle c of the range of heights [µm], and half of the range, a [µm]."""
    low, high = float(heights_um.min()), float(heights_um.max())
    return (low + high) / 2.0, max((high - low) / 2.0, _LEAST_SCALE_UM)


class HeightTerms:
    """Fourier coefficients of exp(2πiκh), as transforms X_n at the sites (frequencies) and factors b_n at nodes of |κ|.

    A coefficient is the sum of b_n iⁿ X_n over n. The nodes are the values of |κ| = |w|/λ at which it is computed.

    Attributes:
        terms: X_n for n = 0 to t − 1 at p sites, shape (t, p).
    """

    def __init__(self, heights_um: NDArray[np.float64], sites: Sites, kappas: NDArray[np.float64], count: int) -> None:
        """Compute the transforms X_n of the Chebyshev polynomials of the heights.

        Args:
            heights_um: Heights [µm], shape (ny, nx).
            sites: Frequencies of the Fourier coefficients.
            kappas: Values of |κ| [1/µm] at which coefficients are computed, shape (k,); κ itself is negative.
            count: Number t of terms of the series.
        """
        offset, self._scale = offset_and_scale(heights_um)
        self._g, self._sites = (heights_um - offset) / self._scale, sites
        basis = 2.0 * bessel_j(-2.0 * math.pi * self._scale * kappas, count)
        basis[:, 0] /= 2.0
        # The terms of the series of a Fourier coefficient have the factor iⁿ: ±1 for even n and ±i for odd n. The sign
        # is included in the factors b_n here. The factor i of odd terms is included when the terms are summed.
        signs = np.where(np.arange(count) // 2 % 2 == 0, 1.0, -1.0)
        self._even, self._odd = (np.ascontiguousarray((signs * basis)[:, first::2]) for first in (0, 1))
        self.terms = np.empty((count, sites.count), dtype=np.complex128)
        for n, values in zip(range(count), _polynomials(self._g), strict=False):
            self.terms[n] = sites.transform(values)

    def at(self, part: slice) -> tuple[Complex, Complex]:
        """Return coefficients H at p frequencies, and the conjugates of H at the negative frequencies, (k, p) each.

        k is the number of values of |κ|. ``part`` selects the frequencies.
        """
        return self._sums(self.terms, part)

    def tangent(self, change_um: NDArray[np.float64]) -> HeightTangent:
        """Return the change of the Fourier coefficients, to first order, for a change of the heights [µm], (ny, nx)."""
        terms = np.zeros_like(self.terms)
        for n, slopes in zip(range(1, len(terms)), _slopes(self._g), strict=False):
            terms[n] = self._sites.transform(slopes * change_um) * (n / self._scale)
        return HeightTangent(self, terms)

    def adjoint(self, parts: Iterable[tuple[slice, Complex, Complex]]) -> NDArray[np.float64]:
        """Return the adjoint of the heights (the derivative of a loss with respect to them) [1/µm], shape (ny, nx).

        ``parts`` has slices of the sites (frequencies), each with the adjoints of the two results of ``at`` for this
        slice.
        """
        terms = np.empty_like(self.terms)
        for part, plus, minus in parts:
            terms[0::2, part] = _product(self._even.T, plus + minus)
            terms[1::2, part] = _product(self._odd.T, -1j * (plus - minus))
        result = np.zeros_like(self._g)
        for n, slopes in zip(range(1, len(terms)), _slopes(self._g), strict=False):
            change = self._sites.transposed(n * terms[n])
            change *= slopes
            result += change
        return result / self._scale

    def _sums(self, terms: Complex, part: slice) -> tuple[Complex, Complex]:
        even, odd = _product(self._even, terms[0::2, part]), 1j * _product(self._odd, terms[1::2, part])
        return even + odd, even - odd


class HeightTangent:
    """Change of the Fourier coefficients of ``HeightTerms`` for one change of the heights."""

    def __init__(self, origin: HeightTerms, terms: Complex) -> None:
        self._origin, self._terms = origin, terms

    def at(self, part: slice) -> tuple[Complex, Complex]:
        """Return the changes, to first order, of the Fourier coefficients that ``HeightTerms.at`` returns."""
        return self._origin._sums(self._terms, part)


def _product(weights: NDArray[np.float64], terms: Complex) -> Complex:
    """Return the product of a real matrix and a complex matrix, computed as one product of real matrices."""
    contiguous = np.ascontiguousarray(terms)
    return np.asarray((weights @ contiguous.view(np.float64)).view(np.complex128))


def _polynomials(g: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Yield the Chebyshev polynomials T_0(g), T_1(g), … without end; ``_sequence`` reuses the yielded arrays."""
    return _sequence(g, np.ones_like(g), g.copy())


def _slopes(g: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Yield the Chebyshev polynomials of the second kind U_0(g), U_1(g), … without end.

    The derivative of T_n is n U_{n−1}. ``_sequence`` reuses the yielded arrays.
    """
    return _sequence(g, np.ones_like(g), 2.0 * g)


def _sequence(
    g: NDArray[np.float64], now: NDArray[np.float64], after: NDArray[np.float64]
) -> Iterator[NDArray[np.float64]]:
    """Yield the terms of the recurrence y_{n+1} = 2 g y_n − y_{n−1}; each array is overwritten two terms later."""
    twice, buffer = 2.0 * g, np.empty_like(g)
    while True:
        yield now
        np.multiply(twice, after, out=buffer)
        buffer -= now
        now, after, buffer = after, buffer, now
