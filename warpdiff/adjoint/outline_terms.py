"""Exact Fourier coefficients of exp(2πiκh) of an outline (polygon), with adjoint and tangent.

h are heights and κ = w/λ, where w is the normal component of the scattering vector and λ the wavelength. On a segment
of the outline, the phase φ = 2π(κh + ru) of order r is linear in the position u [periods]. The integral over the
segment is therefore known exactly. With the phases φ₀ and φ₁ at the ends of a segment of width Δu, the sum over all
segments is

    H_r(κ) = Σ Δu e^{i(φ₀ + φ₁)/2} sinc((φ₁ − φ₀)/2),   sinc(y) = sin(y)/y.

The tangent is the change of a result to first order. The adjoint of a quantity is the derivative of a scalar loss with
respect to this quantity.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.adjoint.sinc import sinc_slope

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from warpdiff.adjoint.sites import Sites
    from warpdiff.profiles.outline import Outline

    Complex = NDArray[np.complex128]


class OutlineTerms:
    """Fourier coefficients of an outline (polygon) at the orders of ``sites``, for selected values (nodes) of |κ|."""

    def __init__(self, outline: Outline, sites: Sites, kappas: NDArray[np.float64]) -> None:
        self._positions = np.append(outline.positions, outline.positions[0] + 1.0)
        heights = outline.heights_um - (outline.heights_um.max() + outline.heights_um.min()) / 2.0
        self._heights = np.append(heights, heights[0])
        # κ = w/λ is negative, and `kappas` has its magnitude.
        self._kappas, self._orders = -kappas, sites.columns.astype(np.float64)

    def at(self, part: slice) -> tuple[Complex, Complex]:
        """Return coefficients H at p orders r, and the conjugates of H at the orders −r, for k values of κ.

        Both arrays have the shape (k, p). ``part`` selects the orders.
        """
        plus, minus = (self._segments(sign * self._orders[part])[0].sum(axis=2) for sign in (1.0, -1.0))
        return plus, np.conj(minus)

    def tangent(self, change: NDArray[np.float64]) -> OutlineTangent:
        """Return the change of the Fourier coefficients for a change of the position and height of each vertex."""
        return OutlineTangent(self, np.concatenate([change, change[:1]]))

    def adjoint(self, parts: Iterable[tuple[slice, Complex, Complex]]) -> NDArray[np.float64]:
        """Return the adjoint (derivative of a loss) of the position and height of each vertex, shape (vertices, 2).

        ``parts`` has slices of the orders, each with the adjoints of the two results of ``at`` for this slice.
        """
        result = np.zeros((len(self._heights), 2))
        for part, plus, minus in parts:
            for sign, adjoints in ((1.0, plus), (-1.0, np.conj(minus))):
                orders = sign * self._orders[part]
                _, of_first, of_second, of_width = self._segments(orders)
                for ends, slope, width in ((slice(0, -1), of_first, -of_width), (slice(1, None), of_second, of_width)):
                    of_phase = (np.conj(adjoints)[..., None] * slope).real
                    direct = (np.conj(adjoints)[..., None] * width).real.sum(axis=(0, 1))
                    result[ends, 0] += direct + 2.0 * math.pi * np.einsum("kps,p->s", of_phase, orders)
                    result[ends, 1] += 2.0 * math.pi * np.einsum("kps,k->s", of_phase, self._kappas)
        result[0] += result[-1]
        return result[:-1]

    def change(self, orders: NDArray[np.float64], change: NDArray[np.float64]) -> Complex:
        """Return the change of the Fourier coefficients of p orders for a change of the vertices, shape (k, p).

        ``change`` has the changes of the position and height of each vertex, with the first vertex repeated at the end.
        """
        _, of_first, of_second, of_width = self._segments(orders)
        of_phase = 2.0 * math.pi * (
            self._kappas[:, None, None] * change[:, 1] + orders[:, None] * change[:, 0]
        )  # fmt: skip
        result = of_first * of_phase[..., :-1] + of_second * of_phase[..., 1:] + of_width * np.diff(change[:, 0])
        return np.asarray(result.sum(axis=2))

    def changes(self, part: slice, change: NDArray[np.float64]) -> tuple[Complex, Complex]:
        """Return the first-order changes of the Fourier coefficients that ``at`` returns, for a change of vertices."""
        plus, minus = (self.change(sign * self._orders[part], change) for sign in (1.0, -1.0))
        return plus, np.conj(minus)

    def _segments(self, orders: NDArray[np.float64]) -> tuple[Complex, Complex, Complex, Complex]:
        """Return the integrals of exp(iφ) over the s segments of the outline, with derivatives, for p orders and k κ.

        φ is the phase. The derivatives are with respect to the phase at the first end of a segment, the phase at its
        second end, and its width. All four arrays have the shape (k, p, s).
        """
        phases = 2.0 * math.pi * (
            self._kappas[:, None, None] * self._heights + orders[:, None] * self._positions
        )  # fmt: skip
        half = np.diff(phases, axis=2) / 2.0
        middle = np.exp(0.5j * (phases[..., 1:] + phases[..., :-1]))
        width = np.diff(self._positions)
        mean = middle * np.sinc(half / math.pi)
        value, along = width * mean, width * middle * sinc_slope(half)
        return value, 0.5 * (1j * value - along), 0.5 * (1j * value + along), mean


class OutlineTangent:
    """Change of the Fourier coefficients of ``OutlineTerms`` for one change of the vertices."""

    def __init__(self, origin: OutlineTerms, change: NDArray[np.float64]) -> None:
        self._origin, self._change = origin, change

    def at(self, part: slice) -> tuple[Complex, Complex]:
        """Return the changes, to first order, of the Fourier coefficients that ``OutlineTerms.at`` returns."""
        return self._origin.changes(part, self._change)
