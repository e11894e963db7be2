"""Everything in the reflectance that does not depend on the height field, in NumPy float64.

Directions are unit vectors in the local frame, away from the surface: x along the tangent, z along the normal.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff import checks

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Directions closer to the horizon than this (0.00006°) count as below it: the gain grows without bound there.
HORIZON = 1e-6


def normal_reflectance(ior: Any) -> float:
    """R(0) = ((n − 1)/(n + 1))² of an index of refraction n > 1; infinity is a perfect mirror, 1."""
    if isinstance(ior, (int, float, np.integer, np.floating)) and not isinstance(ior, bool) and ior == math.inf:
        return 1.0
    try:
        index = checks.number(ior, "ior", above=1.0)
    except ValueError:
        raise ValueError(
            f"ior must be an index of refraction > 1, or math.inf for a perfect mirror, got {ior!r}"
        ) from None
    return ((index - 1.0) / (index + 1.0)) ** 2


def schlick(cosine: NDArray[np.float64], normal: float) -> NDArray[np.float64]:
    """Schlick's power reflectance R0 + (1 − R0)(1 − cos θ)⁵."""
    return np.asarray(normal + (1.0 - normal) * (1.0 - cosine) ** 5)


def gain(
    to_light: NDArray[np.float64], to_view: NDArray[np.float64], *, normal: float, masking: bool
) -> NDArray[np.float64]:
    """The factor C·M between ⟨|P|²⟩ and the relative reflectance ρ; 0 where a direction is at or below the horizon.

    C = R(θd)/R(0) · (1 + ωi·ωr)² / ((cos θi + cos θr)² cos θr) is Single 2014, eq. 3.15, with Schlick's power
    reflectance used once; M is the V-cavity masking and shadowing of Cook and Torrance (1982).

    Args:
        to_light: Unit vectors, shape (n, 3).
        to_view: Unit vectors, shape (n, 3).
        normal: R(0).
        masking: Whether to include M.

    Returns:
        Shape (n,).
    """
    cos_i, cos_r = to_light[:, 2], to_view[:, 2]
    above = (cos_i > HORIZON) & (cos_r > HORIZON)
    half = to_light + to_view
    # 1 + ωi·ωr = |ωi + ωr|²/2 without cancellation; it is 0 only for opposite directions, of which one lies below.
    overlap = np.sum(half * half, axis=1) / 2.0
    safe = np.where(above, overlap, 1.0)
    cos_d = np.sqrt(safe / 2.0)
    total = np.where(above, cos_i + cos_r, 1.0)
    cos_r = np.where(above, cos_r, 1.0)
    result = schlick(np.minimum(cos_d, 1.0), normal) / normal * (safe / total) ** 2 / cos_r
    if masking:
        cos_h = total / np.sqrt(2.0 * safe)
        result = result * np.minimum(1.0, 2.0 * cos_h * np.minimum(cos_r, cos_i) / cos_d)
    return np.asarray(np.where(above, result, 0.0))


def pigment_solid_angle(wavelengths_um: NDArray[np.float64], sigma_um: float) -> NDArray[np.float64]:
    """G = λ²/(4π²σ²): what relates a Lambertian reflectance to the relative one of a Gaussian window."""
    return np.asarray(wavelengths_um**2 / (2.0 * math.pi * sigma_um) ** 2)
