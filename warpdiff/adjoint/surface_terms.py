"""``SurfaceTerms``: protocol of a surface whose Fourier coefficients can be differentiated."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterable

    import numpy as np
    from numpy.typing import NDArray

    from warpdiff.adjoint.coefficient_rows import Amplitudes

    Complex = NDArray[np.complex128]


class SurfaceTerms(Protocol):
    """Coefficients of a surface at sites and at nodes of |κ|, with adjoint and tangent."""

    def at(self, part: slice) -> tuple[Complex, Complex]:
        """Return H at some sites and the conjugates of H at their opposites, at all nodes, shapes (k, p) both."""
        ...

    def tangent(self, change: NDArray[np.float64]) -> Amplitudes:
        """Return the change of the coefficients for a change of the surface."""
        ...

    def adjoint(self, parts: Iterable[tuple[slice, Complex, Complex]]) -> NDArray[np.float64]:
        """Return the adjoint of the surface from those of the two values that ``at`` returns, which come in parts."""
        ...
