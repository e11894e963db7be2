"""Diffracted power ⟨|P|²⟩ of pairs of a direction and a wavelength under Gaussian lobes, with its derivatives.

⟨|P|²⟩ is a sum of powers of Fourier coefficients with Gaussian weights, or the squared magnitude of a sum of their
amplitudes. The weights exp(−dᵀMd) depend on the distance d of a coefficient's frequency from q = (u, v)/λ. L_x and L_y
are the lengths of the patch, and κ = w/λ, for the scattering vector (u, v, w) and the wavelength λ.

The number of pairs is p. The tangent is the change of a result to first order. The adjoint of a quantity is the
derivative of a scalar loss with respect to this quantity.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from warpdiff.adjoint.coefficient_rows import add_rows
from warpdiff.adjoint.gaussian_lobes import GaussianLobes
from warpdiff.core.threads import single_threaded_blas
from warpdiff.kernels import lobe_sums

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from warpdiff.adjoint.coefficient_rows import CoefficientRows, Rows
    from warpdiff.adjoint.gaussian_lobes import Pairs
    from warpdiff.adjoint.sites import Block, Sites
    from warpdiff.adjoint.surface_terms import SurfaceTerms

# Columns of the results of ``derivatives``: derivatives of ⟨|P|²⟩ with respect to the components of the frequency
# q = (u, v)/λ, the elements of the matrix M of the Gaussian weights, |κ| = |w|/λ, and the lengths of the patch. The
# last column is ⟨|P|²⟩ itself.
Q_X, Q_Y, M_XX, M_XY, M_YY, KAPPA, L_X, L_Y, VALUE = range(9)

# Index of the column with the weighted sum of Fourier coefficients itself in the result of
# ``GaussianLobes.derivatives``.
_SUM = lobe_sums.DERIVATIVES - 1


class TangentSums(Protocol):
    """Function that computes the changes of ⟨|P|²⟩ of pairs (direction, wavelength), for one change of the surface."""

    def __call__(self, pairs: Pairs) -> NDArray[np.float64]:
        """Return the change of the power ⟨|P|²⟩ of each of the p pairs (a direction and a wavelength), shape (p,)."""
        ...


class PowerSums(Protocol):
    """Object that computes the diffracted power ⟨|P|²⟩ of a surface, for one coherence of the light."""

    def sums(self, pairs: Pairs) -> NDArray[np.float64]:
        """Return the diffracted power ⟨|P|²⟩ of each of the p pairs (a direction and a wavelength), shape (p,)."""
        ...

    def derivatives(self, pairs: Pairs) -> NDArray[np.float64]:
        """Return the power ⟨|P|²⟩ and its derivatives for each of p pairs (direction, wavelength), shape (p, 9).

        The columns are ``Q_X`` to ``VALUE``.
        """
        ...

    def adjoint(self, parts: Iterable[tuple[Pairs, NDArray[np.float64]]]) -> NDArray[np.float64]:
        """Return the adjoint of the surface (the derivative of a loss with respect to its heights or vertices).

        ``parts`` has groups of pairs (a direction and a wavelength), each with the adjoints of their powers ⟨|P|²⟩.
        """
        ...

    def tangent(self, change: NDArray[np.float64]) -> TangentSums:
        """Return a function of pairs (direction, wavelength): changes of ⟨|P|²⟩ for one change of the surface."""
        ...


class LobeSums:
    """Diffracted power ⟨|P|²⟩ from Fourier coefficients H with Gaussian weights, for one coherence of the light.

    For averaged coherence windows and light sources, powers |H|² are summed. For centred windows, amplitudes H are
    summed, and the magnitude of the sum is squared.
    """

    def __init__(
        self, terms: SurfaceTerms, rows: CoefficientRows, block: Block, sites: Sites,
        size_um: tuple[float, float], exponent: float, centre: tuple[float, float] = (0.0, 0.0),
        moving_um: tuple[float, float] = (0.0, 0.0),
    ) -> None:  # fmt: skip
        """Compute the Chebyshev series of the Fourier coefficients H in |κ| = |w|/λ.

        Args:
            terms: Fourier coefficients of the surface.
            rows: Chebyshev series of powers |H|² or of amplitudes H, which are computed here.
            block: Rectangle of orders whose Fourier coefficients are summed.
            sites: Frequencies that have a series, and for each order of the block the index of its series.
            size_um: Size of the patch (y, x) [µm].
            exponent: Coefficients with Gaussian weights below e^−exponent are neglected.
            centre: Centre of the coherence window (y, x), relative to the size of the patch; only for amplitudes.
            moving_um: Coordinates (y, x) of the centre [µm] if the caller has fixed them. (0, 0) states that the centre
                moves in proportion to the size of the patch.
        """
        self._terms, self._rows, self._block, self._sites = terms, rows, block, sites
        self._size_um, self._moving_um = size_um, moving_um
        with single_threaded_blas():
            rows.fill(terms)
        s, r = block.orders()
        self._phases = np.exp(-2j * np.pi * ((s * centre[0]) % 1.0 + (r * centre[1]) % 1.0))[:, None]
        # Different orders may alias onto the same Fourier coefficient, but have different phases if the centre of a
        # coherence window is not at the origin. Amplitudes are therefore stored per order, with these phases. Powers
        # |H|² have no phases and are stored per coefficient.
        cells = sites.places if rows.powers else np.arange(block.size, dtype=np.int32)
        self._coefficients = rows.rows if rows.powers else self._shifted(rows.rows)
        self._lobes = GaussianLobes(rows, block, cells, size_um, exponent)

    def sums(self, pairs: Pairs) -> NDArray[np.float64]:
        """Return the diffracted power ⟨|P|²⟩ of each of the p pairs (a direction and a wavelength), shape (p,)."""
        parts = self._parts(pairs, self._coefficients)
        return parts[0] if self._rows.powers else parts[0] ** 2 + parts[1] ** 2

    def derivatives(self, pairs: Pairs) -> NDArray[np.float64]:
        """Return the power ⟨|P|²⟩ and its derivatives for each of p pairs (direction, wavelength), shape (p, 9).

        The columns are ``Q_X`` to ``VALUE``.
        """
        slopes = [self._lobes.derivatives(pairs, row) for row in self._coefficients]
        if self._rows.powers:
            return slopes[0][:, [*range(VALUE), _SUM]]
        slope = slopes[0] + 1j * slopes[1]
        # The centre c of the coherence window adds the phase −2πrc/L to the coefficient of order r, for a patch of the
        # length L. If c is fixed, this phase changes with L, and the derivative by L has a further term.
        for column, along, axis in ((L_X, 8, 1), (L_Y, 9, 0)):
            slope[:, column] += 2j * np.pi * self._moving_um[axis] / self._size_um[axis] ** 2 * slope[:, along]
        amplitude = slope[:, _SUM]
        powers = 2.0 * (np.conj(amplitude)[:, None] * slope[:, :VALUE]).real
        return np.column_stack([powers, np.abs(amplitude) ** 2])

    @single_threaded_blas()
    def adjoint(self, parts: Iterable[tuple[Pairs, NDArray[np.float64]]]) -> NDArray[np.float64]:
        """Return the adjoint of the surface (the derivative of a loss with respect to its heights or vertices).

        ``parts`` has groups of pairs (a direction and a wavelength), each with the adjoints of their powers ⟨|P|²⟩.
        """
        blocks = [np.zeros((self._block.size, self._rows.terms)) for _ in self._rows.rows]
        for pairs, adjoints in parts:
            factors = [adjoints]
            if not self._rows.powers:
                factors = [2.0 * adjoints * part for part in self._parts(pairs, self._coefficients)]
            for factor, block in zip(factors, blocks, strict=True):
                self._lobes.spread(pairs, factor, block)
        if not self._rows.powers:
            blocks = _parts_of((blocks[0] + 1j * blocks[1]) * np.conj(self._phases))
        rows = self._rows.empty(zero=True)
        for block, row in zip(blocks, rows, strict=True):
            add_rows(self._sites.places, block, row, are_distinct=self._sites.are_distinct)
        return self._terms.adjoint(self._rows.adjoint(self._terms, rows))

    @single_threaded_blas()
    def tangent(self, change: NDArray[np.float64]) -> TangentSums:
        """Return a function of pairs (direction, wavelength): changes of ⟨|P|²⟩ for one change of the surface."""
        rows = self._rows.tangent(self._terms, self._terms.tangent(change))
        if not self._rows.powers:
            rows = self._shifted(rows)

        def changes(pairs: Pairs) -> NDArray[np.float64]:
            parts = self._parts(pairs, rows)
            if self._rows.powers:
                return parts[0]
            real, imaginary = self._parts(pairs, self._coefficients)
            return 2.0 * (real * parts[0] + imaginary * parts[1])

        return changes

    def _parts(self, pairs: Pairs, rows: Rows) -> list[NDArray[np.float64]]:
        return [self._lobes.sums(pairs, row) for row in rows]

    def _shifted(self, rows: Rows) -> Rows:
        """Return the amplitudes of all diffraction orders, with the phases due to the coherence window's centre."""
        return _parts_of((rows[0][self._sites.places] + 1j * rows[1][self._sites.places]) * self._phases)


def _parts_of(values: NDArray[np.complex128]) -> Rows:
    return [np.ascontiguousarray(values.real), np.ascontiguousarray(values.imag)]
