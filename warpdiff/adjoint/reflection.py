"""Geometry factor C·M and reflectance R of the relative reflectance ρ, with their derivatives.

ρ is the product of C, M, R and the diffracted power ⟨|P|²⟩. C is the geometry factor without masking, and M is the
V-cavity's masking and shadowing. θi and θr are the angles of light and viewer from the normal, and θd is half of the
angle between both directions. n + ik is the complex index of refraction. A kink is a point at which a function is
continuous and its derivative is not.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.adjoint.jets import Jet
from warpdiff.kernels.thresholds import TINY
from warpdiff.optics.materials import DEFAULT_IOR, index_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.optics.materials import Material

# Names of the variables of a material's reflectance, in the order of the partial derivatives; "cosine" is that of half
# of the angle between light and view.
MATERIAL_VARIABLES = ("cosine", "n", "k", "film_nm", "wavelengths_nm")
# Names of the variables of Schlick's reflectance, in the order of the partial derivatives; "cosine" is that of half of
# the angle between light and view.
IOR_VARIABLES = ("cosine", "ior")

# Difference between the cosines of light and viewer, or between the masking factor and 1, below which both numbers
# count as equal. The value is limited by rounding errors of directions.
_EQUAL_COSINES = 1e-9


def geometry(
    lights: NDArray[np.float64], views: NDArray[np.float64], *, masking: bool, per_light_cosine: bool
) -> tuple[Jet, Jet]:
    """Return the geometry factor C·M and cos θd for pairs of unit vectors; see ``reflectance_factors.gain``.

    M is the masking factor, and θd half of the angle between the vectors, which are above the horizon. Both results are
    jets: values with their derivatives by six variables. The variables are the components of the direction to the
    light, and then those of the direction to the viewer. The derivatives do not assume that the directions remain unit
    vectors. The caller must therefore project the derivatives onto the sphere.

    Args:
        lights: Directions to the light, shape (n, 3).
        views: Directions to the viewer, shape (n, 3).
        masking: Whether to include M; without it, the first result is C. At equal cosines of light and viewer, the
            derivative is the one-sided derivative towards a smaller cosine of the light.
        per_light_cosine: Whether to divide by cos θi, the cosine of the light's angle from the normal.
    """
    variables = Jet.variables(*lights.T, *views.T)
    light, view = variables[:3], variables[3:]
    half = [a + b for a, b in zip(light, view, strict=True)]
    overlap = (half[0] * half[0] + half[1] * half[1] + half[2] * half[2]) * 0.5
    total, cos_i, cos_r = half[2], light[2], view[2]
    gain = overlap * overlap / (total * total * cos_r)
    if masking:
        smaller = cos_i.where(cos_i.value <= cos_r.value, cos_r)
        shadowed = 2.0 * total * smaller / overlap
        gain = (gain * shadowed).where(shadowed.value < 1.0, gain)
    if per_light_cosine:
        gain = gain / cos_i
    return gain, (overlap * 0.5).power(0.5)


def kinks(lights: NDArray[np.float64], views: NDArray[np.float64]) -> int:
    """Return the number of pairs of light and view directions at which the derivative of the masking factor M jumps.

    This happens if the cosines of light and viewer are equal and M < 1, or if M reaches its limit of 1.
    """
    overlap = 0.5 * np.sum((lights + views) ** 2, axis=1)
    total, smaller = lights[:, 2] + views[:, 2], np.minimum(lights[:, 2], views[:, 2])
    masking = 2.0 * total * smaller / np.maximum(overlap, TINY)
    is_equal = (np.abs(lights[:, 2] - views[:, 2]) < _EQUAL_COSINES) & (masking < 1.0)
    return int(np.count_nonzero(is_equal | (np.abs(masking - 1.0) < _EQUAL_COSINES)))


def index_of(ior: float | None) -> float:
    """Return the index of refraction of a surface without a material; None is the default of 1.5."""
    return DEFAULT_IOR if ior is None else float(ior)


def schlick(cosines: NDArray[np.float64], ior: float, *, relative: bool) -> Jet:
    """Return Schlick's reflectance as a jet: values with their derivatives by the variables ``IOR_VARIABLES``.

    With ``relative``, the reflectance is divided by that at normal incidence.
    """
    if ior == math.inf:
        return Jet(np.ones_like(cosines), np.zeros((2, *cosines.shape)))
    cosine, index = Jet.variables(cosines, np.full_like(cosines, ior))
    normal = ((index - 1.0) / (index + 1.0)).power(2)
    result = normal + (1.0 - normal) * (1.0 - cosine).power(5)
    return result / normal if relative else result


def fresnel(cosines: NDArray[np.float64], material: Material, wavelengths_nm: NDArray[np.float64]) -> Jet:
    """Return the unpolarised reflectance of a material as a jet, with derivatives by ``MATERIAL_VARIABLES``.

    n and k are those of the material below the film, if there is a film. They change linearly between the wavelengths
    of the material's table.

    Args:
        cosines: cos θd, shape (...).
        material: Material, with a film or without.
        wavelengths_nm: Wavelengths [nm], in the shape of the cosines.
    """
    substrate = index_at(material, wavelengths_nm)
    cosine, n, k, thickness, wavelength = Jet.variables(
        np.minimum(cosines, 1.0), substrate.real, substrate.imag,
        np.full_like(cosines, material.film_nm), wavelengths_nm,
    )  # fmt: skip
    along2 = 1.0 - cosine * cosine
    below = n + 1j * k + _dispersion(material, wavelength)
    media = [Jet(np.ones(cosines.shape), 0.0 * cosine.partials)]
    if material.film is not None:
        film = _dispersion(material.film, wavelength)
        media.append(Jet(film.value + index_at(material.film, wavelengths_nm), film.partials))
    media.append(below)
    angles = [cosine, *((1.0 - along2 / (index * index)).power(0.5) for index in media[1:])]
    result = Jet(np.zeros(cosines.shape), 0.0 * cosine.partials)
    for polarisation in ("s", "p"):
        boundaries = []
        for first in range(len(media) - 1):
            a, b = (first, first + 1) if polarisation == "s" else (first + 1, first)
            one, other = media[a] * angles[first], media[b] * angles[first + 1]
            boundaries.append((one - other) / (one + other))
        amplitude = boundaries[0]
        if len(boundaries) > 1:
            # Airy's formula sums all reflections between the two boundaries of the film.
            behind = boundaries[1] * (4j * math.pi * (thickness / wavelength) * media[1] * angles[1]).exp()
            amplitude = (amplitude + behind) / (1.0 + amplitude * behind)
        result = result + amplitude.abs2() * 0.5
    return result


def _dispersion(material: Material, wavelength: Jet) -> Jet:
    """Return a jet of value 0 whose derivative is that of the index n + ik with respect to the wavelength.

    The caller adds it to n + ik.
    """
    table = np.asarray(material.wavelengths_nm)
    index = np.asarray(material.n) + 1j * np.asarray(material.k)
    if len(table) == 1:
        slope = np.zeros(wavelength.value.shape, dtype=np.complex128)
    else:
        # At the last entry of a table of refractive indices, the derivative is that towards shorter wavelengths,
        # because n + ik is not known at longer wavelengths.
        place = np.clip(np.searchsorted(table, wavelength.value, side="right") - 1, 0, len(table) - 2)
        inside = (wavelength.value >= table[0]) & (wavelength.value <= table[-1])
        slope = np.where(inside, (np.diff(index) / np.diff(table))[place], 0.0)
    return Jet(np.zeros_like(slope), slope * wavelength.partials)
