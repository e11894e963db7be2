"""Powers |H|² or amplitudes H of Fourier coefficients as Chebyshev series in |κ|, with adjoint and tangent.

H(κ) is a Fourier coefficient of exp(2πiκh), for heights h and κ = w/λ, where w is the normal component of the
scattering vector and λ the wavelength. A site is a frequency in half of the frequency plane, and its opposite is the
negative frequency. U_n are Chebyshev polynomials of the second kind.

The tangent is the change of a result to first order for a change of an input. The adjoint of a quantity is the
derivative of a scalar loss with respect to this quantity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from warpdiff.diffraction import chebyshev

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Complex = NDArray[np.complex128]
    Rows = list[NDArray[np.float64]]


class Amplitudes(Protocol):
    """Object that computes Fourier coefficients of a height field or outline (polygon), or of a change of it."""

    def at(self, part: slice) -> tuple[Complex, Complex]:
        """Return coefficients H at p frequencies, and the conjugates of H at the negative frequencies, (k, p) each.

        k is the number of values of |κ| = |w|/λ at which the coefficients are computed.
        """
        ...


class CoefficientRows:
    """Chebyshev series in |κ| of the Fourier coefficients at sites (frequencies) and at the opposite frequencies.

    Attributes:
        rows: Coefficients of the Chebyshev series, one row per frequency. Powers |H|² have one array of shape (2 p, k),
            for p sites and k terms. Amplitudes H have two arrays of this shape: the real and the imaginary parts. The
            first p rows of an array belong to the p sites, and the other rows to the opposite frequencies.
    """

    def __init__(self, count: int, kappas: tuple[float, float], terms: int, *, powers: bool, together: int) -> None:
        """Set the size of the Chebyshev series of Fourier coefficients in |κ|; ``fill`` computes their terms.

        Args:
            count: Number of sites p. Each site has two series: that of its frequency and that of the opposite one.
            kappas: Smallest and largest |κ| = |w|/λ [1/µm].
            terms: Number k of terms of a series.
            powers: Whether the series are those of powers |H|²; otherwise they are those of amplitudes H.
            together: Number of sites that are computed at once; a smaller number requires less memory.
        """
        self._together = together
        self._count, self.kappas, self.terms, self.powers = count, kappas, terms, powers
        self._to_series = chebyshev.to_series(terms)
        self.rows: Rows = []

    @property
    def nodes(self) -> NDArray[np.float64]:
        """Nodes of the Chebyshev polynomials: values of |κ| [1/µm] at which coefficients are computed, shape (k,)."""
        return chebyshev.nodes(*self.kappas, self.terms)

    def fill(self, amplitudes: Amplitudes) -> None:
        """Compute the Chebyshev series from the Fourier coefficients at the nodes of |κ|."""
        self.rows = self.empty()
        for part in self._parts():
            plus, minus = amplitudes.at(part)
            if self.powers:
                self._put(self.rows, part, [np.abs(plus) ** 2, np.abs(minus) ** 2])
            else:
                self._put(self.rows, part, [plus, np.conj(minus)])

    def tangent(self, amplitudes: Amplitudes, change: Amplitudes) -> Rows:
        """Return the first-order change of the Chebyshev series if the Fourier coefficients change by ``change``."""
        result = self.empty()
        for part in self._parts():
            plus, minus = change.at(part)
            if self.powers:
                base = amplitudes.at(part)
                powers = [2.0 * (np.conj(a) * b).real for a, b in zip(base, (plus, minus), strict=True)]
                self._put(result, part, powers)
            else:
                self._put(result, part, [plus, np.conj(minus)])
        return result

    def adjoint(self, amplitudes: Amplitudes, rows: Rows) -> Iterator[tuple[slice, Complex, Complex]]:
        """Yield the adjoints (derivatives of a loss) of the two results of ``amplitudes.at``, slice by slice.

        ``rows`` has the adjoints of the Chebyshev series in |κ| = |w|/λ. Each item is a slice of the sites
        (frequencies), and the adjoints of the Fourier coefficients at these sites and at the opposite frequencies.
        """
        for part in self._parts():
            opposite = slice(part.start + self._count, part.stop + self._count)
            values = [np.ascontiguousarray((sum_of(rows, place) @ self._to_series.T).T) for place in (part, opposite)]
            if self.powers:
                base = amplitudes.at(part)
                yield part, 2.0 * values[0] * base[0], 2.0 * values[1] * base[1]
            else:
                yield part, np.asarray(values[0]), np.conj(values[1])

    def polynomials(self, kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values at n |κ| = |w|/λ [1/µm] of all Chebyshev polynomials of the series, shape (n, k)."""
        return _recurrence(self.places(kappas), self.terms, np.ones(len(kappas)), self.places(kappas))

    def slopes(self, kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives of the Chebyshev polynomials with respect to |κ| [µm], shape (n, k).

        The derivative of the polynomial T_n with respect to its argument is n U_{n−1}. U_n are Chebyshev polynomials of
        the second kind.
        """
        values = _recurrence(self.places(kappas), self.terms, np.zeros(len(kappas)), np.ones(len(kappas)))
        return values * (self.places_per_kappa * np.arange(self.terms))

    @property
    def places_per_kappa(self) -> float:
        """Derivative of the argument of the Chebyshev polynomials with respect to |κ| [µm]."""
        return 2.0 / (self.kappas[1] - self.kappas[0])

    def places(self, kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the arguments of the Chebyshev polynomials, from −1 to 1, for values of |κ| [1/µm]."""
        low, high = self.kappas
        return np.asarray((2.0 * kappas - low - high) / (high - low))

    def _parts(self) -> Iterator[slice]:
        for first in range(0, self._count, self._together):
            yield slice(first, min(first + self._together, self._count))

    def empty(self, *, zero: bool = False) -> Rows:
        """Return new arrays for Chebyshev series, of the shape of ``self.rows``: uninitialised, or 0 with ``zero``."""
        make = np.zeros if zero else np.empty
        return [make((2 * self._count, self.terms)) for _ in range(1 if self.powers else 2)]

    def _put(self, rows: Rows, part: slice, values: list[NDArray[np.float64]] | list[Complex]) -> None:
        for first, value in zip((0, self._count), values, strict=True):
            place = slice(part.start + first, part.stop + first)
            for row, numbers in zip(rows, [value] if self.powers else [value.real, value.imag], strict=True):
                row[place] = numbers.T @ self._to_series


def sum_of(rows: Rows, place: slice) -> NDArray[np.float64] | Complex:
    """Return the Chebyshev series of some Fourier coefficients: real for powers, complex for amplitudes.

    ``rows`` has one array for powers |H|². For amplitudes H it has two: the real and the imaginary parts, which are
    combined. ``place`` selects the coefficients, one per row of an array.
    """
    return rows[0][place] if len(rows) == 1 else rows[0][place] + 1j * rows[1][place]


def _recurrence(
    x: NDArray[np.float64], count: int, first: NDArray[np.float64], second: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the terms of the recurrence y_{k+1} = 2 x y_k − y_{k−1} of Chebyshev polynomials, shape (n, count).

    ``first`` and ``second`` are the first two terms at the n arguments ``x``.
    """
    result = np.empty((count, len(x)))
    result[0], result[1] = first, second
    for k in range(2, count):
        result[k] = 2.0 * x * result[k - 1] - result[k - 2]
    return np.ascontiguousarray(result.T)


def add_rows(
    places: NDArray[np.int32], rows: NDArray[np.float64], rows_out: NDArray[np.float64], *, are_distinct: bool = False
) -> None:
    """Add row i of ``rows`` (the series of one Fourier coefficient) to row ``places[i]`` of ``rows_out``, for every i.

    An index may occur several times in ``places``; all rows with this index are then added. ``are_distinct`` states
    that no index occurs twice, which permits a faster addition.
    """
    if are_distinct:
        rows_out[places] += rows
        return
    order = np.argsort(places, kind="stable")
    begins = np.flatnonzero(np.diff(places[order], prepend=-1))
    rows_out[places[order][begins]] += np.add.reduceat(rows[order], begins, axis=0)
