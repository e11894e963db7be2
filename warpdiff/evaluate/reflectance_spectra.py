"""``ReflectanceSpectra``: reflectance spectra with their wavelengths and directions, as a table and as a file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core.angles import angles_deg
from warpdiff.core.table import Table, save_table

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class ReflectanceSpectra:
    """Reflectance spectra of pairs of light and view directions, the result of :func:`warpdiff.reflectance_spectra`.

    Attributes:
        wavelengths_nm: Wavelengths [nm], shape (m,).
        to_light: Unit vectors to the light in the local frame, shape (n, 3).
        to_view: Unit vectors to the viewer in the local frame, shape (n, 3).
        values: Relative reflectance ρ as of :func:`warpdiff.spectral_reflectance`, shape (n, m).

    Examples:
        >>> import warpdiff as wd
        >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
        >>> spectra = wd.reflectance_spectra(grating, (0, 0, 1), [(0, 0, 1), (0.3, 0, 1)], [450.0, 550.0, 650.0])
        >>> spectra
        ReflectanceSpectra(2 spectra, 3 wavelengths, 450 to 650 nm)
        >>> spectra.values.shape
        (2, 3)
    """

    wavelengths_nm: NDArray[np.float64]
    to_light: NDArray[np.float64]
    to_view: NDArray[np.float64]
    values: NDArray[Any]

    def __repr__(self) -> str:
        low, high = self.wavelengths_nm.min(), self.wavelengths_nm.max()
        spectra = f"{len(self.values)} spectr{'um' if len(self.values) == 1 else 'a'}"
        return f"ReflectanceSpectra({spectra}, {len(self.wavelengths_nm)} wavelengths, {low:g} to {high:g} nm)"

    def table(self) -> Table:
        """Return a table with a row per pair of directions and wavelength.

        Columns with ``theta`` are angles of light or view from the normal (0 to 90°). Columns with ``phi`` are angles
        around the normal from the x axis (−180 to 180°). Further columns are the wavelength, and the reflectance
        relative to a flat surface.

        Examples:
            >>> grating = wd.gratings.sinusoidal(2.0, 0.1)
            >>> print(wd.reflectance_spectra(grating, (0, 0, 1), (0, 0, 1), [450.0, 650.0]).table())
            light_theta_deg  light_phi_deg  view_theta_deg  view_phi_deg  wavelength_nm  relative_reflectance
                          0              0               0             0            450               0.32...
                          0              0               0             0            650               0.60...
        """
        count = len(self.wavelengths_nm)
        angles = {
            f"{name}_{angle}_deg": np.repeat(values, count)
            for name, directions in (("light", self.to_light), ("view", self.to_view))
            for angle, values in zip(("theta", "phi"), angles_deg(directions), strict=True)
        }
        return Table(
            angles
            | {
                "wavelength_nm": np.tile(self.wavelengths_nm, len(self.values)),
                "relative_reflectance": self.values.ravel(),
            }
        )

    save = save_table
