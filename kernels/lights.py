"""What a light is to the kernels."""

import warp as wp


@wp.struct
class Light:
    """One light, and what of it the pigment sends back."""

    to_light: wp.vec3d
    power: wp.float64
    pigment: wp.float64  # strength over R(0); 0 leaves the pigment out
    white_rgb: wp.vec3d  # ∫ G S x̄ȳz̄ dλ / ∫ S ȳ dλ in linear sRGB
    rgb_to_xyz: wp.mat33d
