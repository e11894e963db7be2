"""Efficiencies of the orders of one light and wavelength, with their derivatives with respect to every variable.

Order m has the efficiency η = R K |H|². R is the reflectance of the flat surface, K the geometry factor of
``energy_normalisation.stam``, and H the Fourier coefficient of exp(2πiκh) of the heights h. Here κ = w/λ for the
wavelength λ and the normal component w of the scattering vector.

A normalised efficiency is R times an element of the matrix P = diag(x) (K |H|²) diag(y). The rows of the matrix are
directions to the light, and its columns are orders. The vectors x and y are such that the sums over rows and columns
have prescribed values, which conserve energy. Derivatives are computed from the derivatives of the prescribed sums, by
the linear equations of ``balance_response``. The adjoint of a quantity is the derivative of a scalar loss with respect
to it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.adjoint import reflection
from warpdiff.adjoint.jets import Jet
from warpdiff.diffraction import energy_normalisation
from warpdiff.kernels.thresholds import HORIZON

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.adjoint.linearised import Derivatives
    from warpdiff.optics.materials import Material

# Names of the variables of the geometry: tangential components of the direction to the light, size of the period along
# x and y [µm], wavelength [µm], and a factor that scales the heights.
GEOMETRY = ("light_x", "light_y", "length_x", "length_y", "wavelength_um", "height_scale")


class OrderModel:
    """Diffraction orders of one light at one wavelength; their efficiencies are one row of a matrix.

    The matrix has a row per direction to the light and a column per order. Without energy normalisation, it has only
    the row of this light.

    Attributes:
        indices: Frequency (s, r) of the Fourier coefficient of each matrix element [cycles per period], shape
            (rows · columns, 2).
        kappas: |κ| = |w|/λ of each matrix element [1/µm], shape (rows · columns,).
    """

    def __init__(
        self, light: NDArray[np.float64], orders: NDArray[np.int64], wavelength_nm: float,
        size_um: tuple[float, float], is_constant: tuple[bool, bool], *, normalised: bool, ior: float,
        material: Material | None,
    ) -> None:  # fmt: skip
        """Set the diffraction orders, and compute their geometry factors and |κ|.

        Args:
            light: Unit vector to the light, shape (3,).
            orders: Numbers (m_y, m_x) of the diffraction orders that propagate, shape (n, 2).
            wavelength_nm: Wavelength [nm].
            size_um: Size (y, x) of one period [µm].
            is_constant: Whether the surface is constant along (y, x).
            normalised: Whether the energy is normalised.
            ior: Index of refraction, which is used if there is no material.
            material: Material of the surface, or None.
        """
        self._normalised, self._ior, self._material, self._wavelength_nm = normalised, ior, material, wavelength_nm
        shifts = np.zeros((1, 2), dtype=np.int64)
        if normalised:
            steps = 1e-3 * wavelength_nm / np.array(size_um)
            ranges = [
                np.zeros(1, dtype=np.int64)
                if constant
                else np.arange(-math.ceil(2.0 / step) - 1, math.ceil(2.0 / step) + 2)
                for step, constant in zip(steps, is_constant, strict=True)
            ]
            shifts = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 2)
            shifts = shifts[1.0 - np.sum((light[1::-1] + shifts * steps) ** 2, axis=1) > HORIZON**2]
        self._own = int(np.flatnonzero(~shifts.any(axis=1))[0])
        self._is_mirror = ~orders.any(axis=1)
        # Stored result of the method `slopes`, because adjoint and tangent use it several times.
        self._derivatives: Derivatives | None = None
        self.indices = -(shifts[:, None] + orders[None]).reshape(-1, 2)
        self._set_geometry(light, orders, shifts, size_um)
        self.kappas = self._kappa.value.ravel()

    def _set_geometry(
        self, light: NDArray[np.float64], orders: NDArray[np.int64], shifts: NDArray[np.int64],
        size_um: tuple[float, float],
    ) -> None:  # fmt: skip
        """Compute geometry factors, |κ| and the sums of the efficiency matrix, with derivatives by ``GEOMETRY``.

        The sums are those that the rows (lights) and columns (orders) must have to conserve energy.
        """
        values = (light[0], light[1], size_um[1], size_um[0], 1e-3 * self._wavelength_nm, 1.0)
        x, y, length_x, length_y, wavelength, scale = Jet.variables(*(np.full((1, 1), value) for value in values))
        per_x, per_y = wavelength / length_x, wavelength / length_y
        entering = x + per_x * shifts[:, 1:].astype(float), y + per_y * shifts[:, :1].astype(float)
        leaving = per_x * orders[None, :, 1].astype(float) - x, per_y * orders[None, :, 0].astype(float) - y
        cos_i, cos_r = ((1.0 - a * a - b * b).power(0.5) for a, b in (entering, leaving))
        overlap = 1.0 + entering[0] * leaving[0] + entering[1] * leaving[1] + cos_i * cos_r
        w = cos_i + cos_r
        self._factor = overlap * overlap / (cos_i * cos_r * w * w)
        self._kappa = w / wavelength * scale
        self._cosine = Jet(overlap.value[self._own], overlap.partials[:, self._own]) * 0.5
        self._cosine = self._cosine.power(0.5)
        self._rows, self._columns = (_rise(cosine) for cosine in (cos_i, cos_r))

    def value(self, powers: NDArray[np.float64], slopes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the efficiencies of the n orders, shape (n,).

        Args:
            powers: Power |H|² of each element of the matrix (directions to the light × orders), shape (rows ·
                columns,).
            slopes: Derivatives of these powers with respect to |κ| [µm].
        """
        self._derivatives = None
        self._powers, self._slopes = (array.reshape(self._kappa.value.shape) for array in (powers, slopes))
        matrix = self._factor.value * self._powers
        self._weights, self._shares = np.ones_like(matrix), matrix
        self._mirrors = matrix[self._own].copy()
        if self._normalised:
            rows, columns = self._rows.value[:, 0], self._columns.value[0]
            first, second = energy_normalisation.balanced(matrix, rows, columns)
            self._weights = first[:, None] * second
            self._shares = self._weights * matrix
            self._mirrors = self._shares[self._own] + self._is_mirror * (1.0 - rows[self._own])
        self._reflected = self._reflectance()
        return np.asarray(self._mirrors * self._reflected.value)

    def power_adjoints(self, adjoints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the adjoints of the powers |H|² from the adjoints of the efficiencies.

        The adjoint of a quantity is the derivative of a scalar loss with respect to this quantity. The powers form a
        matrix, which has one row per incident and one column per reflected order. The result has the adjoints of its
        elements, row by row, shape (rows · columns,).
        """
        mirrors = adjoints * self._reflected.value
        result = np.zeros_like(self._shares)
        result[self._own] = mirrors
        if self._normalised:
            along = mirrors * self._shares[self._own]
            rows = np.zeros(len(result))
            rows[self._own] = along.sum()
            of_rows, of_columns = energy_normalisation.balance_response(self._shares, rows, along)
            result -= of_rows[:, None] + of_columns
        return np.asarray(result * self._weights * self._factor.value).ravel()

    def power_tangent(self, changes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the changes of the efficiencies for changes of |H|² of all matrix elements, (rows · columns,)."""
        of_matrix = self._factor.value * changes.reshape(self._shares.shape)
        zero = np.zeros((1, *self._rows.value.shape)), np.zeros((1, *self._columns.value.shape))
        return np.asarray(self._mirror_changes(of_matrix[None], *zero)[0] * self._reflected.value)

    def slopes(self) -> Derivatives:
        """Return the derivatives of the n efficiencies, shape (n,) each, by the name of the variable.

        The variables are those of ``GEOMETRY``, and those of the reflectance.
        """
        if self._derivatives is not None:
            return self._derivatives
        of_matrix = self._powers * self._factor.partials + self._factor.value * self._slopes * self._kappa.partials
        mirrors = self._mirror_changes(of_matrix, self._rows.partials, self._columns.partials)
        names = reflection.IOR_VARIABLES if self._material is None else reflection.MATERIAL_VARIABLES
        optics = dict(zip(names, self._reflected.partials, strict=True))
        through_angle = mirrors * self._reflected.value + self._mirrors * optics["cosine"] * self._cosine.partials
        result = dict(zip(GEOMETRY, through_angle, strict=True))
        result |= {name: self._mirrors * slope for name, slope in optics.items() if name != "cosine"}
        if "wavelengths_nm" in result:
            result["wavelength_um"] = result["wavelength_um"] + 1e3 * result.pop("wavelengths_nm")
        self._derivatives = result
        return result

    def _mirror_changes(
        self, of_matrix: NDArray[np.float64], of_rows: NDArray[np.float64], of_columns: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the changes of the n efficiencies of a perfect mirror (R = 1), shape (p, n), for p changes.

        Args:
            of_matrix: Changes of the elements K |H|² of the efficiency matrix, shape (p, rows, columns).
            of_rows: Changes of the prescribed sums of rows (lights), shape (p, rows, 1).
            of_columns: Changes of the prescribed sums of columns (orders), shape (p, 1, columns).
        """
        direct = self._weights * of_matrix
        if not self._normalised:
            return np.asarray(direct[:, self._own])
        off_rows, off_columns = of_rows[..., 0] - direct.sum(axis=2), of_columns[:, 0] - direct.sum(axis=1)
        log_rows, log_columns = energy_normalisation.balance_response(self._shares, off_rows.T, off_columns.T)
        own = self._shares[self._own]
        result = own * (log_rows[self._own][:, None] + log_columns.T) + direct[:, self._own]
        return np.asarray(result - self._is_mirror * of_rows[:, self._own])

    def _reflectance(self) -> Jet:
        cosines = np.minimum(self._cosine.value, 1.0)
        if self._material is None:
            return reflection.schlick(cosines, self._ior, relative=False)
        return reflection.fresnel(cosines, self._material, np.full_like(cosines, self._wavelength_nm))


def _rise(cosine: Jet) -> Jet:
    """Return the sum that a row or column of the matrix of efficiencies must have, as a jet (value and derivatives).

    The sum is the function ``energy_normalisation.rise`` of the cosine of the angle from the normal.
    """
    share = np.minimum(cosine.value / energy_normalisation.RISEN, 1.0)
    slope = 6.0 * share * (1.0 - share) / energy_normalisation.RISEN
    return Jet(energy_normalisation.rise(cosine.value), slope * cosine.partials)
