"""Factors of the reflectance that depend on directions, material and coherence, but not on the height field.

Directions are unit vectors in the local frame, away from the surface: x along the tangent, z along the normal.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal. |P|² is the power that the surface diffracts into a
direction, relative to a flat mirror in its mirror direction. ρ is the reflectance relative to a flat mirror, and C is
the geometry factor between ⟨|P|²⟩ and ρ without masking.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import validation
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.kernels.thresholds import HORIZON
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.optics.coherence import Coherence


def normal_reflectance(ior: object) -> float:
    """R(0) = ((n − 1)/(n + 1))² for an index of refraction n > 1; 1 for infinity, a perfect mirror."""
    if isinstance(ior, (int, float, np.integer, np.floating)) and not isinstance(ior, bool) and ior == math.inf:
        return 1.0
    try:
        index = validation.number(ior, "ior", above=1.0)
    except ValueError:
        raise ArgumentValueError(
            f"{ref('ior')} must be an index of refraction > 1, or math.inf for a perfect mirror, got {ior!r}"
        ) from None
    return ((index - 1.0) / (index + 1.0)) ** 2


def schlick(cosine: NDArray[np.float64], normal: float) -> NDArray[np.float64]:
    """Schlick's power reflectance R0 + (1 − R0)(1 − cos θ)⁵; R0 is ``normal``, the reflectance at normal incidence."""
    return np.asarray(normal + (1.0 - normal) * (1.0 - cosine) ** 5)


def gain(
    to_light: NDArray[np.float64], to_view: NDArray[np.float64], *, normal: float, masking: bool,
    per_light_cosine: bool = False,
) -> NDArray[np.float64]:  # fmt: skip
    """Factor C·M between the power ⟨|P|²⟩ and the relative reflectance ρ; 0 if a direction is not above the horizon.

    P is the windowed mean of exp(ik(wh + ux + vy)) over the heights h. The factor C is R(θd)/R(0) · (1 + ωi·ωr)² /
    ((cos θi + cos θr)² cos θr), which is eq. 3.15 of Single 2014, with a correction: Schlick's reflectance R is a ratio
    of powers and is therefore not squared. θd is half of the angle between ωi and ωr. M is the V-cavity masking and
    shadowing of Cook and Torrance (1982). For a source of finite size the factor is C·M/cos θi: a flat mirror then
    shows the radiance of the source, ρ = R(θi)/R(0).

    Args:
        to_light: Unit vectors ωi to the light, shape (n, 3).
        to_view: Unit vectors ωr to the viewer, shape (n, 3).
        normal: Reflectance R(0) at normal incidence.
        masking: Whether to include M.
        per_light_cosine: Whether to divide by cos θi, as for a coherence of kind ``"source"``.

    Returns:
        Factors, shape (n,).
    """
    cos_i, cos_r = to_light[:, 2], to_view[:, 2]
    above = (cos_i > HORIZON) & (cos_r > HORIZON)
    half = to_light + to_view
    # 1 + ωi·ωr is computed as |ωi + ωr|²/2, because the direct formula would subtract nearly equal numbers. The result
    # is 0 only if ωi and ωr are opposite directions. One of them is then below the horizon.
    overlap = np.sum(half * half, axis=1) / 2.0
    safe = np.where(above, overlap, 1.0)
    cos_d = np.sqrt(safe / 2.0)
    total = np.where(above, cos_i + cos_r, 1.0)
    cos_r = np.where(above, cos_r, 1.0)
    result = schlick(np.minimum(cos_d, 1.0), normal) / normal * (safe / total) ** 2 / cos_r
    if masking:
        cos_h = total / np.sqrt(2.0 * safe)
        result = result * np.minimum(1.0, 2.0 * cos_h * np.minimum(cos_r, cos_i) / cos_d)
    if per_light_cosine:
        result = result / np.where(above, cos_i, 1.0)
    return np.asarray(np.where(above, result, 0.0))


def light_solid_angle(
    wavelengths_um: NDArray[np.float64], coherence: Coherence, patch_area_um2: float
) -> NDArray[np.float64]:
    """Return Ω(λ) [sr], the solid angle of a light that is as coherent as the window, the source or the periods.

    Ω = λ² ∫g² / |∫g|², with g the window (Stam 1999). For a Gaussian window of the amplitude, averaged or centred, Ω is
    λ²/(4πσ²). For a source of angular radius α = √2 s, Ω is πα² = 2πs²; by the theorem of van Cittert and Zernike, the
    window of a source has σ(λ) = λ/(2√2 πs). For N1 × N2 periods of a patch of area A, Ω is λ²/(A N1 N2). The relative
    reflectance ρ is the reflected radiance divided by the radiance of this light, so that Ω converts ρ to absolute
    quantities.

    Args:
        wavelengths_um: Wavelengths [µm].
        coherence: The window, source or periods.
        patch_area_um2: Area of the patch, Lx·Ly [µm²]; used for periods only.

    Returns:
        Solid angles [sr], in the shape of the wavelengths.
    """
    if coherence.kind == "source":
        return np.full(np.shape(wavelengths_um), 2.0 * math.pi * coherence.spread**2)
    if coherence.periods is not None:
        area = patch_area_um2 * coherence.periods[0] * coherence.periods[1]
    else:
        area = 4.0 * math.pi * (coherence.sigma_um or 0.0) ** 2
    return np.asarray(wavelengths_um**2 / area)


def pigment_solid_angle(
    wavelengths_um: NDArray[np.float64], coherence: Coherence, patch_area_um2: float
) -> NDArray[np.float64]:
    """Return G = Ω/π, the factor from a Lambertian reflectance a, with the BRDF a/π, to a relative reflectance.

    G is λ²/(4π²σ²) for Gaussian windows, 2s² for a source, and λ²/(πA N1 N2) for periods of a patch of area A. The
    arguments are those of :func:`light_solid_angle`.
    """
    return light_solid_angle(wavelengths_um, coherence, patch_area_um2) / math.pi


def pigment_white(
    illuminant: colorimetry.Illuminant, coherence: Coherence, patch_area_um2: float, *, is_of_sky: bool = False
) -> NDArray[np.float64]:
    """Return the XYZ of a white pigment (a Lambertian reflectance of 1) under an illuminant S, shape (3,).

    The factor G(λ) of :func:`pigment_solid_angle` is replaced by its mean ∫ G S ȳ dλ / ∫ S ȳ dλ. The luminance is then
    exact, and the pigment has the chromaticity of the illuminant. With G(λ) itself, which is proportional to λ² for a
    window, a white pigment would look reddish. Under a sky, S is its spectral radiance divided by λ², so that G S has
    the chromaticity of the sky.

    Args:
        illuminant: Name or spectrum of the illuminant.
        coherence: The window, source or periods to which colours are relative.
        patch_area_um2: Area of the patch [µm²]; used for periods only.
        is_of_sky: Whether ``illuminant`` is the spectral radiance of a sky divided by λ².
    """
    products = colorimetry.colour_products(illuminant)
    solid_angle = pigment_solid_angle(1e-3 * colorimetry.VISIBLE_NM, coherence, patch_area_um2)
    return np.asarray(solid_angle @ products if is_of_sky else (solid_angle @ products[:, 1]) * products.sum(axis=0))


def brdf_scale(
    cos_light: NDArray[np.float64], wavelengths_um: NDArray[np.float64], coherence: Coherence, patch_area_um2: float
) -> NDArray[np.float64]:
    """Return 1/(Ω cos θi), the ratio of the absolute BRDF [1/sr] to R(0)·ρ (Stam 1999); ρ excludes masking.

    With ρ = C ⟨|P|²⟩, or C/cos θi ⟨|P|²⟩ for a source, the BRDF is R(θd) (1 + ωi·ωr)² / (cos θi cos θr w²) · ⟨|P|²⟩
    times a factor. Here θd is half of the angle between ωi and ωr. For Gaussian windows, the factor is 4πσ²/λ². For N1
    × N2 periods of a patch of area A, it is A N1 N2/λ². For a source of the spread s, the factor is 1/(2πs² cos θi),
    because the source is foreshortened in (u, v). Ω is the result of :func:`light_solid_angle`.

    Args:
        cos_light: cos θi > 0, shape (n,).
        wavelengths_um: Wavelengths [µm], shape (m,).
        coherence: The window, source or periods.
        patch_area_um2: Area of the patch [µm²].

    Returns:
        Ratios, shape (n, m).
    """
    return 1.0 / (cos_light[:, None] * light_solid_angle(wavelengths_um, coherence, patch_area_um2))
