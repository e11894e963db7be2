"""``CoefficientSeries``: powers or amplitudes of the coefficients of a block, with the adjoint and the tangent."""

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
    """Range and numbers of terms of the series of coefficients.

    Attributes:
        kappas: Least and largest |κ| [1/µm].
        terms: Number of terms by which coefficients are expanded in the heights.
        count: Number of terms of the series of a coefficient in |κ|.
    """

    kappas: tuple[float, float]
    terms: int
    count: int

    @classmethod
    def of(cls, relief: Relief, kappas: tuple[float, float], truncation: float, *, powers: bool) -> SeriesSize:
        """Return the size for a relative size of truncated terms."""
        low, high = kappa_range(*kappas, relief.scale_um)
        terms = term_count(2.0 * math.pi * high * relief.scale_um, truncation)
        # A power oscillates over κ as fast as the phase of the whole height range, an amplitude half as fast.
        count = term_count(math.pi * (high - low) * relief.scale_um * (2.0 if powers else 1.0), truncation)
        return cls((low, high), terms, count)


class CoefficientSeries:
    """Series of the coefficients of a block, with their surface.

    Attributes:
        rows: Series in |κ|, not filled yet.
        terms: Coefficients of the surface.
        sites: Rows of the orders of the block.
        block: Orders of the coefficients.
    """

    def __init__(self, relief: Relief, block: Block, size: SeriesSize, *, powers: bool) -> None:
        self.block, self.sites = block, Sites(relief.shape, *block.orders())
        self.rows = CoefficientRows(
            self.sites.count, size.kappas, size.count, powers=powers, together=relief.sites_together
        )
        self.terms: SurfaceTerms = relief.terms(self.sites, self.rows.nodes, size.terms)
        self._size_um = relief.size_um

    def lobes(self, exponent: float) -> GaussianLobes:
        """Return sums of the powers; coefficients with weights below e^−exponent are truncated."""
        return GaussianLobes(self.rows, self.block, self.sites.places, self._size_um, exponent)

    @single_threaded_blas()
    def powers(self) -> NDArray[np.float64]:
        """Return the series of the powers, shape (2 p, k)."""
        self.rows.fill(self.terms)
        return self.rows.rows[0]

    @single_threaded_blas()
    def tangent(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the change of the series of the powers for a change of the surface."""
        return self.rows.tangent(self.terms, self.terms.tangent(change))[0]

    @single_threaded_blas()
    def adjoint(self, of_block: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the adjoint of the surface from that of the powers of the block, shape (size, k)."""
        rows: Rows = self.rows.empty(zero=True)
        add_rows(self.sites.places, of_block, rows[0], are_distinct=self.sites.are_distinct)
        return self.terms.adjoint(self.rows.adjoint(self.terms, rows))
