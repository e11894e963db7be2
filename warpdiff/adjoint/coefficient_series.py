"""``CoefficientSeries``: powers or amplitudes of the Fourier coefficients of a block, with adjoint and tangent.

A block is a rectangle of diffraction orders. κ = w/λ, where w is the normal component of the scattering vector and λ
the wavelength. The tangent is the change of a result to first order. The adjoint of a quantity is the derivative of a
scalar loss with respect to this quantity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from warpdiff.adjoint.coefficient_rows import CoefficientRows, add_rows
from warpdiff.adjoint.gaussian_lobes import GaussianLobes
from warpdiff.adjoint.series_length import kappa_range, term_count
from warpdiff.adjoint.sites import Sites
from warpdiff.core.threads import single_threaded_blas

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from warpdiff.adjoint.coefficient_rows import Rows
    from warpdiff.adjoint.sites import Block
    from warpdiff.adjoint.surface_terms import SurfaceTerms
    from warpdiff.adjoint.surfaces import Relief


@dataclass(frozen=True)
class SeriesSize:
    """Range of |κ| = |w|/λ, and numbers of terms of the series of Fourier coefficients.

    Attributes:
        kappas: Smallest and largest |κ| [1/µm].
        terms: Number of terms of the expansion of a Fourier coefficient in polynomials of the heights.
        count: Number of terms of the Chebyshev series of a Fourier coefficient in |κ|.
    """

    kappas: tuple[float, float]
    terms: int
    count: int

    @classmethod
    def of(cls, relief: Relief, kappas: tuple[float, float], truncation: float, *, powers: bool) -> SeriesSize:
        """Return the size of series of Fourier coefficients with a relative error of at most ``truncation``."""
        low, high = kappa_range(*kappas, relief.scale_um)
        terms = term_count(2.0 * math.pi * high * relief.scale_um, truncation)
        # The series of a Fourier coefficient in κ needs more terms if its largest phase is larger. An amplitude H is a
        # sum of phases of heights from the middle of the range, so that the largest phase is that of half of the range.
        # A power |H|² has phases of differences of two heights, up to the whole range.
        count = term_count(math.pi * (high - low) * relief.scale_um * (2.0 if powers else 1.0), truncation)
        return cls((low, high), terms, count)


class CoefficientSeries:
    """Chebyshev series of the Fourier coefficients of a block of orders, with the surface to which they belong.

    Attributes:
        rows: Chebyshev series in |κ| of powers |H|²; they are empty until :meth:`powers` computes them.
        terms: Fourier coefficients of the surface at nodes (selected values) of |κ|.
        sites: Frequencies that have a series, and for each order of the block the index of its series.
        block: Rectangle of diffraction orders whose Fourier coefficients are computed.
    """

    def __init__(self, relief: Relief, block: Block, size: SeriesSize, *, powers: bool) -> None:
        self.block, self.sites = block, Sites(relief.shape, *block.orders())
        self.rows = CoefficientRows(
            self.sites.count, size.kappas, size.count, powers=powers, together=relief.sites_together
        )
        self.terms: SurfaceTerms = relief.terms(self.sites, self.rows.nodes, size.terms)
        self._size_um = relief.size_um

    def lobes(self, exponent: float) -> GaussianLobes:
        """Return an object that sums squared magnitudes |H|² of Fourier coefficients with Gaussian weights.

        Each sum is around one frequency q. Coefficients with weights below e^−``exponent`` are neglected.
        """
        return GaussianLobes(self.rows, self.block, self.sites.places, self._size_um, exponent)

    @single_threaded_blas()
    def powers(self) -> NDArray[np.float64]:
        """Compute and return Chebyshev series of |H|² at p frequencies and the opposite frequencies, shape (2 p, k)."""
        self.rows.fill(self.terms)
        return self.rows.rows[0]

    @single_threaded_blas()
    def tangent(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the first-order change of the Chebyshev series of |H|² for a change of the heights or vertices."""
        return self.rows.tangent(self.terms, self.terms.tangent(change))[0]

    @single_threaded_blas()
    def adjoint(self, of_block: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the adjoint of the surface (the derivative of a loss by its heights or vertices).

        ``of_block`` has the adjoints of the Chebyshev series of |H|². Its shape (size, k) is that of k terms for each
        diffraction order of the block.
        """
        rows: Rows = self.rows.empty(zero=True)
        add_rows(self.sites.places, of_block, rows[0], are_distinct=self.sites.are_distinct)
        return self.terms.adjoint(self.rows.adjoint(self.terms, rows))
