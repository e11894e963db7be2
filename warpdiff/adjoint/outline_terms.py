"""Exact Fourier coefficients of exp(2πiκh) of an outline, with adjoint and tangent.

On a segment, the phase φ = 2π(κh + ru) is linear in the position u [periods]. Its integral is therefore exact:
H_r(κ) = Σ Δu e^{i(φ₀ + φ₁)/2} sinc((φ₁ − φ₀)/2), with the phases φ₀ and φ₁ of the ends of each segment.
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
    """Coefficients of an outline at the orders of ``sites`` and at nodes of |κ|."""

    def __init__(self, outline: Outline, sites: Sites, kappas: NDArray[np.float64]) -> None:
        self._positions = np.append(outline.positions, outline.positions[0] + 1.0)
        heights = outline.heights_um - (outline.heights_um.max() + outline.heights_um.min()) / 2.0
        self._heights = np.append(heights, heights[0])
        # κ is negative, and the nodes are |κ|.
        self._kappas, self._orders = -kappas, sites.columns.astype(np.float64)

    def at(self, part: slice) -> tuple[Complex, Complex]:
        """Return H at some orders and the conjugates of H at their opposites, at all nodes, shapes (k, p) both."""
        plus, minus = (self._segments(sign * self._orders[part])[0].sum(axis=2) for sign in (1.0, -1.0))
        return plus, np.conj(minus)

    def tangent(self, change: NDArray[np.float64]) -> OutlineTangent:
        """Return the change of the coefficients for a change of positions and heights, shape (k, 2)."""
        return OutlineTangent(self, np.concatenate([change, change[:1]]))

    def adjoint(self, parts: Iterable[tuple[slice, Complex, Complex]]) -> NDArray[np.float64]:
        """Return the adjoint of positions and heights, shape (k, 2), from those of the two values of ``at``."""
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
        """Return the change of the coefficients of orders (p,) for a change of the vertices, (k + 1, 2), as (k, p)."""
        _, of_first, of_second, of_width = self._segments(orders)
        of_phase = 2.0 * math.pi * (
            self._kappas[:, None, None] * change[:, 1] + orders[:, None] * change[:, 0]
        )  # fmt: skip
        result = of_first * of_phase[..., :-1] + of_second * of_phase[..., 1:] + of_width * np.diff(change[:, 0])
        return np.asarray(result.sum(axis=2))

    def changes(self, part: slice, change: NDArray[np.float64]) -> tuple[Complex, Complex]:
        """Return the changes of the two values of ``at``."""
        plus, minus = (self.change(sign * self._orders[part], change) for sign in (1.0, -1.0))
        return plus, np.conj(minus)

    def _segments(self, orders: NDArray[np.float64]) -> tuple[Complex, Complex, Complex, Complex]:
        """Return the integrals over segments, and their derivatives by both phases and by the width, (k, p, s) each."""
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
    """Change of the coefficients of ``OutlineTerms`` for one change of the vertices."""

    def __init__(self, origin: OutlineTerms, change: NDArray[np.float64]) -> None:
        self._origin, self._change = origin, change

    def at(self, part: slice) -> tuple[Complex, Complex]:
        """Return the changes of the two values that ``OutlineTerms.at`` returns."""
        return self._origin.changes(part, self._change)
