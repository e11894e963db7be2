"""Powers |H|² or amplitudes H of Fourier coefficients as Chebyshev series in |κ|, with adjoint and tangent."""

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
    """Source of coefficients at nodes of |κ|: heights on a grid, an outline, or a change of one of them."""

    def at(self, part: slice) -> tuple[Complex, Complex]:
        """Return H at some sites and the conjugates of H at their opposites, at all nodes, shapes (k, p) both."""
        ...


class CoefficientRows:
    """Chebyshev series in |κ| of the coefficients at sites and at their opposites.

    Attributes:
        rows: Series of the powers, or of real and imaginary parts of amplitudes: one or two arrays of shape (2 p, k).
            The first p rows belong to the p sites, the others to their opposites.
    """

    def __init__(self, count: int, kappas: tuple[float, float], terms: int, *, powers: bool, together: int) -> None:
        """Describe the series of 2 · ``count`` coefficients; ``fill`` computes them.

        Args:
            count: Number of sites p.
            kappas: Least and largest |κ| [1/µm].
            terms: Number k of terms of a series.
            powers: Whether the rows are powers. Otherwise they are amplitudes.
            together: Number of sites that are computed together, which limits the memory.
        """
        self._together = together
        self._count, self.kappas, self.terms, self.powers = count, kappas, terms, powers
        self._to_series = chebyshev.to_series(terms)
        self.rows: Rows = []

    @property
    def nodes(self) -> NDArray[np.float64]:
        """Nodes of |κ| [1/µm] at which coefficients are evaluated, shape (k,)."""
        return chebyshev.nodes(*self.kappas, self.terms)

    def fill(self, amplitudes: Amplitudes) -> None:
        """Compute the rows from the coefficients at the nodes."""
        self.rows = self.empty()
        for part in self._parts():
            plus, minus = amplitudes.at(part)
            if self.powers:
                self._put(self.rows, part, [np.abs(plus) ** 2, np.abs(minus) ** 2])
            else:
                self._put(self.rows, part, [plus, np.conj(minus)])

    def tangent(self, amplitudes: Amplitudes, change: Amplitudes) -> Rows:
        """Return the change of the rows for a change of the coefficients."""
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
        """Yield parts of the sites with the adjoints of the two values of ``amplitudes.at``, from those of the rows."""
        for part in self._parts():
            opposite = slice(part.start + self._count, part.stop + self._count)
            values = [np.ascontiguousarray((sum_of(rows, place) @ self._to_series.T).T) for place in (part, opposite)]
            if self.powers:
                base = amplitudes.at(part)
                yield part, 2.0 * values[0] * base[0], 2.0 * values[1] * base[1]
            else:
                yield part, np.asarray(values[0]), np.conj(values[1])

    def polynomials(self, kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the Chebyshev polynomials at some |κ| [1/µm], shape (n, k)."""
        return _recurrence(self.places(kappas), self.terms, np.ones(len(kappas)), self.places(kappas))

    def slopes(self, kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the derivatives k U_{k−1} of the polynomials by |κ| [µm], shape (n, k)."""
        values = _recurrence(self.places(kappas), self.terms, np.zeros(len(kappas)), np.ones(len(kappas)))
        return values * (self.places_per_kappa * np.arange(self.terms))

    @property
    def places_per_kappa(self) -> float:
        """Change of the place in the series per change of |κ| [µm]."""
        return 2.0 / (self.kappas[1] - self.kappas[0])

    def places(self, kappas: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the places of |κ| [1/µm] in the range of the series, −1 to 1."""
        low, high = self.kappas
        return np.asarray((2.0 * kappas - low - high) / (high - low))

    def _parts(self) -> Iterator[slice]:
        for first in range(0, self._count, self._together):
            yield slice(first, min(first + self._together, self._count))

    def empty(self, *, zero: bool = False) -> Rows:
        """Return new arrays for rows; with ``zero`` all elements are 0."""
        make = np.zeros if zero else np.empty
        return [make((2 * self._count, self.terms)) for _ in range(1 if self.powers else 2)]

    def _put(self, rows: Rows, part: slice, values: list[NDArray[np.float64]] | list[Complex]) -> None:
        for first, value in zip((0, self._count), values, strict=True):
            place = slice(part.start + first, part.stop + first)
            for row, numbers in zip(rows, [value] if self.powers else [value.real, value.imag], strict=True):
                row[place] = numbers.T @ self._to_series


def sum_of(rows: Rows, place: slice) -> NDArray[np.float64] | Complex:
    """Return the powers of some rows, or their complex amplitudes."""
    return rows[0][place] if len(rows) == 1 else rows[0][place] + 1j * rows[1][place]


def _recurrence(
    x: NDArray[np.float64], count: int, first: NDArray[np.float64], second: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the sequence y_{k+1} = 2 x y_k − y_{k−1} of Chebyshev polynomials from its first two terms, (n, count)."""
    result = np.empty((count, len(x)))
    result[0], result[1] = first, second
    for k in range(2, count):
        result[k] = 2.0 * x * result[k - 1] - result[k - 2]
    return np.ascontiguousarray(result.T)


def add_rows(
    places: NDArray[np.int32], rows: NDArray[np.float64], rows_out: NDArray[np.float64], *, are_distinct: bool = False
) -> None:
    """Add rows to those of ``rows_out`` at their places, of which several may be the same, unless ``are_distinct``."""
    if are_distinct:
        rows_out[places] += rows
        return
    order = np.argsort(places, kind="stable")
    begins = np.flatnonzero(np.diff(places[order], prepend=-1))
    rows_out[places[order][begins]] += np.add.reduceat(rows[order], begins, axis=0)
