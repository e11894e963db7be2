"""Diffracted power |P|² of finitely many periods of a patch, as explicit sums over all samples, with derivatives.

P(q, κ) = (1/N) Σ exp(2πi(κh + q·x)) is the sum over the N samples with heights h at positions x, times an interference
factor along each axis. A factor is sin(πnt)/(n sin(πt)) for n periods of length L, with t = qL. Here q = (u, v)/λ and
κ = w/λ, for the scattering vector (u, v, w) and the wavelength λ.

The sums have no expansion in κ. They require as much time per pair of a direction and a wavelength as
``method="direct"``. The adjoint of a quantity is the derivative of a scalar loss with respect to this quantity.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.adjoint.power_sums import KAPPA, L_X, L_Y, Q_X, Q_Y, VALUE
from warpdiff.adjoint.sinc import sinc_slope
from warpdiff.core.threads import single_threaded_blas

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from warpdiff.adjoint.gaussian_lobes import Pairs
    from warpdiff.adjoint.power_sums import TangentSums
    from warpdiff.heightfield.field import HeightField

    Complex = NDArray[np.complex128]


class PeriodSums:
    """Power |P|² of ``periods`` (y, x) periods of a height field, for pairs of a direction and a wavelength."""

    def __init__(self, heightfield: HeightField, periods: tuple[int, int]) -> None:
        self._heights, self._periods = heightfield.heights_um, periods
        self._pitch_um, self._size_um = heightfield.pitch_um, heightfield.size_um
        self._y, self._x = (pitch * np.arange(n) for pitch, n in zip(self._pitch_um, self._heights.shape, strict=True))

    @single_threaded_blas()
    def sums(self, pairs: Pairs) -> NDArray[np.float64]:
        """Return the diffracted power |P|² of each of the p pairs (a direction and a wavelength), shape (p,)."""
        factors = self._interference(pairs)
        result = np.empty(len(pairs))
        for k in range(len(pairs)):
            field, along_y, along_x = self._field(pairs, k)
            result[k] = abs(along_y @ field @ along_x / field.size) ** 2
        return np.asarray(result * factors[0][:, 0] * factors[1][:, 0])

    @single_threaded_blas()
    def derivatives(self, pairs: Pairs) -> NDArray[np.float64]:
        """Return the power |P|² and its derivatives for each of p pairs of a direction and a wavelength, (p, 9).

        The order of the columns is that of ``Q_X`` to ``VALUE`` in ``power_sums``. Whole periods have no Gaussian
        weights. The columns ``M_XX``, ``M_XY`` and ``M_YY``, the derivatives by the matrix of these weights, are 0.
        """
        of_y, of_x = self._interference(pairs)
        result = np.zeros((len(pairs), 9))
        for k in range(len(pairs)):
            field, along_y, along_x = self._field(pairs, k)
            rows, columns = along_y @ field, field @ along_x
            amplitude = rows @ along_x / field.size
            slopes = 2j * math.pi / field.size * np.array([
                rows @ (self._x * along_x), (self._y * along_y) @ columns,
                -(along_y @ (self._heights * field) @ along_x),
            ])  # fmt: skip
            slope_x, slope_y, slope_kappa = 2.0 * (np.conj(amplitude) * slopes).real * of_y[k, 0] * of_x[k, 0]
            power, (qx, qy) = abs(amplitude) ** 2, pairs.centres[k]
            # The interference factors depend on t = qL, which is the change of the phase over one period, in turns.
            by_turns_x, by_turns_y = power * of_y[k, 0] * of_x[k, 1], power * of_x[k, 0] * of_y[k, 1]
            result[k, KAPPA], result[k, VALUE] = slope_kappa, power * of_y[k, 0] * of_x[k, 0]
            result[k, Q_X] = slope_x + by_turns_x * self._size_um[1]
            result[k, Q_Y] = slope_y + by_turns_y * self._size_um[0]
            result[k, L_X] = slope_x * qx / self._size_um[1] + by_turns_x * qx
            result[k, L_Y] = slope_y * qy / self._size_um[0] + by_turns_y * qy
        return result

    @single_threaded_blas()
    def adjoint(self, parts: Iterable[tuple[Pairs, NDArray[np.float64]]]) -> NDArray[np.float64]:
        """Return the adjoint of the heights (the derivative of a loss with respect to them) [1/µm], shape (ny, nx).

        ``parts`` has pairs of a direction and a wavelength with the adjoints of their powers |P|².
        """
        result = np.zeros_like(self._heights)
        for pairs, adjoints in parts:
            factors = self._interference(pairs)
            for k in np.flatnonzero(adjoints).tolist():
                field, along_y, along_x = self._field(pairs, k)
                amplitude = along_y @ field @ along_x / field.size
                factor = 2.0 * adjoints[k] * factors[0][k, 0] * factors[1][k, 0] / field.size
                slope = factor * np.conj(amplitude) * -2j * math.pi * pairs.kappas[k]
                result += (slope * (field * along_x) * along_y[:, None]).real
        return result

    def tangent(self, change: NDArray[np.float64]) -> TangentSums:
        """Return a function that computes the changes of |P|² of pairs (direction, wavelength).

        ``change`` is the change of the heights [µm].
        """

        @single_threaded_blas()
        def changes(pairs: Pairs) -> NDArray[np.float64]:
            factors = self._interference(pairs)
            result = np.empty(len(pairs))
            for k in range(len(pairs)):
                field, along_y, along_x = self._field(pairs, k)
                amplitude = along_y @ field @ along_x / field.size
                slope = -2j * math.pi * pairs.kappas[k] * (along_y @ (field * change) @ along_x) / field.size
                result[k] = 2.0 * (np.conj(amplitude) * slope).real
            return np.asarray(result * factors[0][:, 0] * factors[1][:, 0])

        return changes

    def _field(self, pairs: Pairs, k: int) -> tuple[Complex, Complex, Complex]:
        """Return exp(2πiκh) for all heights h, and factors exp(2πi q·x) along y and x, for one frequency q."""
        qx, qy = pairs.centres[k]
        # κ = w/λ is negative, and `pairs.kappas` has its magnitude for each direction and wavelength.
        phases = -2.0 * math.pi * pairs.kappas[k] * self._heights
        return np.exp(1j * phases), np.exp(2j * math.pi * qy * self._y), np.exp(2j * math.pi * qx * self._x)

    def _interference(self, pairs: Pairs) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the squared interference factors along y and x with their derivatives by t = qL, shape (p, 2) each."""
        turns = pairs.centres[:, ::-1] * self._size_um
        return _interference(turns[:, 0], self._periods[0]), _interference(turns[:, 1], self._periods[1])


def _interference(turns: NDArray[np.float64], periods: int) -> NDArray[np.float64]:
    """Return the squared interference factor [sin(πNt)/(N sin(πt))]² of N periods, and its derivative, shape (p, 2).

    The derivative is with respect to t (``turns``), the change of the phase over one period in turns.
    """
    one = math.pi * (turns - np.rint(turns))
    all_turns = periods * one
    ratio = np.sinc(all_turns / math.pi) / np.sinc(one / math.pi)
    slope = (periods * sinc_slope(all_turns) - ratio * sinc_slope(one)) / np.sinc(one / math.pi)
    return np.stack([ratio**2, 2.0 * math.pi * ratio * slope], axis=1)
