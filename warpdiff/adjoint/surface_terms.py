"""``SurfaceTerms``: protocol of a surface whose Fourier coefficients can be differentiated.

H(κ) is a Fourier coefficient of exp(2πiκh), for heights h and κ = w/λ, where w is the normal component of the
scattering vector and λ the wavelength. A site is a frequency in half of the frequency plane, and its opposite is the
negative frequency.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterable

    import numpy as np
    from numpy.typing import NDArray

    from warpdiff.adjoint.coefficient_rows import Amplitudes

    Complex = NDArray[np.complex128]


class SurfaceTerms(Protocol):
    """Fourier coefficients of a surface at p sites (frequencies) and k values of |κ|, with adjoint and tangent."""

    def at(self, part: slice) -> tuple[Complex, Complex]:
        """Return coefficients H at p frequencies, and the conjugates of H at the negative frequencies, (k, p) each.

        k is the number of values of |κ|. ``part`` selects the frequencies.
        """
        ...

    def tangent(self, change: NDArray[np.float64]) -> Amplitudes:
        """Return the change of the Fourier coefficients, to first order, for a change of the surface."""
        ...

    def adjoint(self, parts: Iterable[tuple[slice, Complex, Complex]]) -> NDArray[np.float64]:
        """Return the adjoint of the surface: the derivative of a scalar loss with respect to heights or vertices.

        ``parts`` has slices of the sites (frequencies), each with the adjoints of the two results of ``at`` for this
        slice.
        """
        ...
