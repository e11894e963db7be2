"""Reflectance spectra of many directions by one plan: sums over Fourier coefficients on a device, or the direct sum.

A plan holds the method and the numbers of a computation, such as the number of terms of a series. The direct sum adds
all height samples in float64.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core.threads import subprogress
from warpdiff.device.kernel_calls import launch
from warpdiff.diffraction import direct_sum
from warpdiff.optics.materials import reflectances
from warpdiff.tables.coefficient_table import table_for

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.materials import Material
    from warpdiff.request.directions import DirectionRange
    from warpdiff.request.plan import Plan

# Number of reflectances that are computed together: the number of directions (or pixels) times the number of
# wavelengths. It is limited by memory: a value requires at most 32 bytes.
_VALUES_TOGETHER = 1 << 20


class SpectralSum:
    """Reflectance spectra as sums over Fourier coefficients, or over the samples, of a height field.

    Attributes:
        wavelengths_nm: Wavelengths [nm], shape (m,).
        dtype: Type of the results: float64 for the direct sum over samples, else float32.
    """

    def __init__(
        self, heightfield: HeightField, plan: Plan, direction_range: DirectionRange,
        wavelengths_nm: NDArray[np.float64], *, device: wp.Device, threads: int,
    ) -> None:  # fmt: skip
        """Compute the Fourier coefficients that a range of directions requires, with the method and terms of a plan."""
        self._heightfield, self._plan = heightfield, plan
        self.wavelengths_nm = wavelengths_nm
        self._where: dict[str, Any] = {"device": device, "threads": threads}
        is_direct = plan.method == "direct"
        self.dtype: type = np.float64 if is_direct else np.float32
        self._table = None if is_direct else table_for(heightfield, plan, direction_range, **self._where)
        self._wavenumbers = wp.array(1e3 / wavelengths_nm, dtype=wp.float64, device=device)

    def spectra(
        self, scattering_vectors: NDArray[np.float64], to_lights: NDArray[np.floating], gains: NDArray[np.floating],
        material: Material | None, *, progress: Callable[[float], None] | None = None,
    ) -> NDArray[Any]:  # fmt: skip
        """Return the relative reflectance ρ of n directions at m wavelengths, shape (n, m).

        Args:
            scattering_vectors: Scattering vectors (u, v, w), shape (n, 3).
            to_lights: Unit vectors to the light in the local frame, shape (n, 3).
            gains: Geometry factors by which the powers are multiplied, shape (n,); 0 for dark directions, where ρ is 0.
            material: Material of the surface; None if the gains include its reflectance.
            progress: Callable that gets the finished share of the work, 0 to 1; None reports nothing.
        """
        if self._table is None:
            return self._direct_spectra(scattering_vectors, to_lights.astype(np.float64), gains, material, progress)
        device = self._where["device"]
        inputs = [
            self._table.arguments, wp.array(scattering_vectors, dtype=wp.vec3d, device=device),
            wp.array(to_lights.astype(np.float32), dtype=wp.vec3f, device=device),
            wp.array(gains.astype(np.float32), dtype=wp.float32, device=device), self._wavenumbers,
        ]  # fmt: skip
        values = wp.empty((len(gains), len(self.wavelengths_nm)), dtype=wp.float32, device=device)
        launch(self._table.sample, len(gains), inputs, [values], progress=progress, **self._where)
        spectra: NDArray[np.float32] = values.numpy()
        if material is not None:
            spectra *= reflectances(material, scattering_vectors, self.wavelengths_nm).astype(np.float32)
        return spectra

    def _direct_spectra(
        self, scattering_vectors: NDArray[np.float64], to_lights: NDArray[np.float64], gains: NDArray[np.floating],
        material: Material | None, progress: Callable[[float], None] | None,
    ) -> NDArray[np.float64]:  # fmt: skip
        """Return the result of :meth:`spectra` by the sum over all height samples in float64."""
        result = np.zeros((len(gains), len(self.wavelengths_nm)))
        illuminated = gains > 0.0
        power = direct_sum.window_power(
            self._heightfield, self._plan.coherence, scattering_vectors[illuminated], self.wavelengths_nm * 1e-3,
            to_lights=to_lights[illuminated], progress=progress,
        )  # fmt: skip
        factors = reflectances(material, scattering_vectors[illuminated], self.wavelengths_nm)
        result[illuminated] = gains[illuminated, None] * power * factors
        return result

    def add_to(
        self, spectra: NDArray[np.float32], scattering_vectors: NDArray[np.float64], to_lights: NDArray[np.floating],
        gains: NDArray[np.floating], material: Material | None, powers: NDArray[np.float64], *,
        progress: Callable[[float], None] | None = None,
    ) -> None:  # fmt: skip
        """Add the reflectance ρ times the powers of a light to the spectra of n pixels.

        The pixels are processed in groups, which limits the memory.

        Args:
            spectra: Spectra that are increased, shape (n, m).
            scattering_vectors: Scattering vectors (u, v, w), shape (n, 3).
            to_lights: Unit vectors to the light in the local frame, shape (n, 3).
            gains: Geometry factors, shape (n,).
            material: Material of the surface; None if the gains include its reflectance.
            powers: Relative powers of the light at the wavelengths, shape (m,).
            progress: Callable that gets the finished share of the work, 0 to 1; None reports nothing.
        """
        illuminated = np.flatnonzero(gains > 0.0)
        size = max(_VALUES_TOGETHER // len(self.wavelengths_nm), 1)
        for first in range(0, len(illuminated), size):
            places = illuminated[first : first + size]
            share = subprogress(progress, first / len(illuminated), min((first + size) / len(illuminated), 1.0))
            values = self.spectra(
                scattering_vectors[places], to_lights[places], gains[places], material, progress=share
            )
            spectra[places] += (values * powers).astype(np.float32)
