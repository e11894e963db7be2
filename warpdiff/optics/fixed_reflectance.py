"""Materials whose reflectance has the spectrum of normal incidence at all angles, for the tables of grating maps.

R(θd, λ) is the reflectance of the material, where λ is the wavelength and θd half of the angle between the directions
to light and viewer. (u, v, w) is the scattering vector, with cos θd = |(u, v, w)|/2. A table of colours contains R(θd,
λ) at the angle θd of each of its (u, v, w).

A grating map divides a surface into small areas (dots). Each dot has the same grating, turned and with its own scale of
depth and pitch. Colours of a scaled dot are looked up in the common table at another (u, v, w), which has another θd.
Tables of grating maps therefore contain R(0, λ). Look-ups multiply by the luminance of R(θd, λ) divided by that of
R(0, λ).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpdiff.optics import colorimetry
from warpdiff.optics.materials import Material, reflectance_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Number of cosines of θd from 0 to 1 at which the ratio of luminances is tabulated; θd is half of the angle between
# light and view. The number was chosen because linear interpolation then has an error below 1e-4 for metals.
_COSINES = 257
# Cosines of θd, half of the angle between light and view, at which the change of the reflectance spectrum is measured.
# The smallest value was chosen because θd exceeds 60° only if both light and view are near the horizon.
_JUDGED_COSINES = np.linspace(0.5, 1.0, 11)


class FixedReflectance(Material):
    """Material with the reflectance of normal incidence at all angles.

    Attributes:
        original: Material with the reflectance at all angles.
    """

    has_angles = False
    original: Material

    @classmethod
    def of(cls, material: Material) -> FixedReflectance:
        """Return a material that has, at all angles, the reflectance of ``material`` at normal incidence."""
        fixed = cls(
            material.wavelengths_nm, material.n, material.k, material.name, material.source, material.film,
            material.film_nm,
        )  # fmt: skip
        object.__setattr__(fixed, "_key", ("normal incidence", *material._key))
        object.__setattr__(fixed, "original", material)
        return fixed


def luminance_ratios(fixed: FixedReflectance) -> NDArray[np.float64]:
    """Return the luminance of R(θd, λ) under D65 over that of R(0, λ), at equally spaced cos θd from 0 to 1.

    R is the reflectance at the wavelength λ, and θd half of the angle between light and view.
    """
    reflectances = reflectance_at(fixed.original, colorimetry.VISIBLE_NM, np.linspace(0.0, 1.0, _COSINES)[:, None])
    luminances = reflectances @ colorimetry.colour_products("D65")[:, 1]
    return np.asarray(luminances / luminances[-1])


def spectral_change(material: Material) -> float:
    """Return by how much the shape of the reflectance spectrum R(θd, λ) changes for θd up to 60°, relative to R(0, λ).

    θd is half of the angle between light and view. A change by one factor at all wavelengths does not count. For each
    θd, the result is a root mean square over λ, weighted by luminous efficiency under D65. The largest value of all θd
    is returned.
    """
    reflectances = reflectance_at(material, colorimetry.VISIBLE_NM, _JUDGED_COSINES[:, None])
    weights = colorimetry.colour_products("D65")[:, 1]
    ratios = reflectances / reflectances[-1]
    change = ratios / ((ratios @ weights) / weights.sum())[:, None] - 1.0
    return float(np.sqrt((change**2 @ weights) / weights.sum()).max())
