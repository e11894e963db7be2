"""Lights, and Fresnel reflectance, gain and masking of one pair of directions, in float64.

Grazing directions subtract nearly equal numbers; there are only a few operations a direction, none a wavelength.
"""

import warp as wp

from warpdiff import optics

HORIZON = wp.constant(wp.float64(optics.HORIZON))


@wp.struct
class Light:
    """One light, and what of it the pigment sends back."""

    to_light: wp.vec3d
    power: wp.float64
    pigment: wp.float64  # strength over R(0); 0 leaves the pigment out
    white_rgb: wp.vec3d  # ∫ G S x̄ȳz̄ dλ / ∫ S ȳ dλ in linear sRGB
    rgb_to_xyz: wp.mat33d


@wp.func
def schlick(cosine: wp.float64, normal: wp.float64) -> wp.float64:
    """Schlick's power reflectance; ``normal`` is R(0)."""
    one = wp.float64(1.0)
    m = one - wp.min(cosine, one)
    return normal + (one - normal) * m * m * m * m * m


@wp.func
def gain(to_light: wp.vec3d, to_view: wp.vec3d, normal: wp.float64, masking: wp.bool) -> wp.float64:
    """C·M, the factor between ⟨|P|²⟩ and ρ (Single 2014, eq. 3.15); 0 where a direction is not above the horizon."""
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    cos_i = to_light[2]
    cos_r = to_view[2]
    half = to_light + to_view
    # 1 + ωi·ωr without cancellation.
    overlap = wp.dot(half, half) / two
    result = wp.float64(0.0)
    if cos_i > HORIZON and cos_r > HORIZON:
        total = cos_i + cos_r
        cos_d = wp.sqrt(overlap / two)
        ratio = overlap / total
        result = schlick(cos_d, normal) / normal * ratio * ratio / cos_r
        if masking:
            cos_h = total / wp.sqrt(two * overlap)
            result = result * wp.min(one, two * cos_h * wp.min(cos_r, cos_i) / cos_d)
    return result
