"""Reflectance of flat materials in float64, by characteristic matrices (Abelès 1950; Born and Wolf, section 1.6).

The module shares no code with ``warpdiff.optics.materials``, which sums Fresnel amplitudes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


# Quotients of complex NaN set NumPy's flag for invalid operations. NumPy's warning about this flag is disabled.
@np.errstate(invalid="ignore")
def reflectance(material: Any, wavelengths_um: Any, cosines: Any, polarisations: str = "sp") -> NDArray[np.float64]:
    """Return the reflectance R of a material in air, as a mean over polarisations.

    Wavelengths [µm] and cosines of the angle of incidence are broadcast. A cosine of NaN gives NaN.
    """
    wavelengths, cosines = np.broadcast_arrays(np.asarray(wavelengths_um, float), np.asarray(cosines, float))
    along = np.sqrt(np.maximum(1.0 - cosines**2, 0.0))
    layers = [layer for layer in (material.film, material) if layer is not None]
    total = np.where(np.isfinite(cosines), 0.0, np.nan)
    cosines = np.nan_to_num(cosines, nan=1.0)
    for polarisation in polarisations:
        admittances, normals = [], []
        for layer in layers:
            index = np.interp(1e3 * wavelengths, layer.wavelengths_nm, layer.n) + 1j * np.interp(
                1e3 * wavelengths, layer.wavelengths_nm, layer.k
            )
            # `normal` is the component of the wave vector normal to the surface, relative to 2π/λ. The square root is
            # used for which the wave decays with depth.
            normal = np.sqrt(index**2 - along**2 + 0j)
            normal = np.where(normal.imag < 0.0, -normal, normal)
            normals.append(normal)
            admittances.append(normal if polarisation == "s" else index**2 / normal)
        load = admittances[-1]
        if len(layers) > 1:
            phase = 2.0 * np.pi * normals[0] * material.film_nm * 1e-3 / wavelengths
            # Electric and magnetic fields at the top of the film, both divided by the electric field at the bottom of
            # the film. The quotient, magnetic over electric field, is the admittance of film and substrate together.
            # This quotient becomes the new ``load``: the admittance of everything below the air.
            electric = np.cos(phase) - 1j * np.sin(phase) * load / admittances[0]
            load = (np.cos(phase) * load - 1j * np.sin(phase) * admittances[0]) / electric
        air = cosines if polarisation == "s" else 1.0 / np.maximum(cosines, 1e-300)
        total += np.abs((air - load) / (air + load)) ** 2 / len(polarisations)
    return total
