"""Reflection and emission of plain surfaces, by the metallic-roughness model of glTF 2.0 (specification, appendix B).

A plain surface has no height field. Its BRDF is f = (1 − F) c/π + F D V. Here c is the diffuse colour, F is Schlick's
Fresnel term, and D is the GGX distribution of microfacets with the parameter α. V is Smith's height-correlated masking
and shadowing, divided by 4 cos θi cos θr for the angles θi and θr of light and view from the normal. Matte materials
have f = c/π; kernels of ``light_samples`` compute their light as that of a pigment.

A footprint is the range of directions over the pixel filter and over the extent of the light. It blurs D by a Gaussian
whose covariance C is that of the slopes of half vectors within the footprint. The blurred D is approximated by a sum of
a GGX distribution and a Gaussian. The GGX distribution has b = α² + tr C instead of α² (as in Tokuyoshi and Kaplanyan,
Improved geometric specular antialiasing, 2019), and the weight α²/b. With this weight its tail is the tail of D, which
a blur does not change. The Gaussian has the covariance C + α² I and the remaining weight.
"""

import math

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.light_samples import Lights, away_from, covariance_of
from warpdiff.kernels.structs import Footprint, Pixels

wp.set_module_options(compile_options.options())

# Reflectance of a dielectric at normal incidence. It follows from an index of refraction of 1.5 (glTF 2.0, appendix B).
DIELECTRIC = wp.constant(wp.float32(0.04))
# Smallest standard deviation of the roughness within a footprint that is taken into account. The value was chosen
# because a smaller standard deviation changes colours by less than 4 %.
LEAST_SPREAD = wp.constant(wp.float32(0.01))
# Largest trace of the covariance of microfacet slopes by which the footprint of a pixel blurs a highlight. The trace is
# limited because footprints at silhouettes cover many normals, and would make any surface look rough.
MOST_ADDED = wp.constant(wp.float32(0.18))


@wp.struct
class PlainMaterials:
    """Materials of plain surfaces, which have no height field.

    The last element of ``metallic_roughness`` and ``emission`` is for faces with a height field, and for faces without
    a material.
    """

    rows: wp.array(dtype=wp.int32)  # row of each face's material in the two arrays below
    metallic_roughness: wp.array(dtype=wp.vec2f)  # metallic and perceptual roughness, which is negative if matte
    emission: wp.array(dtype=wp.vec3f)  # emitted light in linear RGB; 1 is the luminance that the emission pass states
    least_alpha: wp.float32  # smallest α, at which the highlight is as bright as a mirror in the unit of the picture


@wp.struct
class Gloss:
    """Parameters of a plain surface's BRDF at one hit, in the shading frame."""

    view: wp.vec3f  # unit vector to the viewer
    diffuse: wp.vec3f  # diffuse colour c in linear RGB
    normal_reflectance: wp.vec3f  # Fresnel term F at normal incidence, linear RGB
    alpha2: wp.float32  # α² of the GGX distribution; 0 if the material is matte
    spread: wp.float32  # parameter b = α² + tr C of the blurred GGX distribution
    gaussian: wp.vec3f  # elements xx, xy and yy of the Gaussian's covariance C + α² I
    core: wp.float32  # weight of the Gaussian in the blurred distribution; 0 without a footprint


@wp.func
def metallic_roughness_at(materials: PlainMaterials, pixels: Pixels, ray: wp.int32, deviations: wp.float32) -> wp.vec2f:
    """Return metallic and perceptual roughness at the hit of a ray; a matte material has a negative roughness.

    The roughness is the mean of the texture over the area of the pixel in the texture, plus ``deviations`` standard
    deviations. Metallic is the value of its linear regression on roughness at this roughness.
    """
    result = materials.metallic_roughness[materials.rows[pixels.face[ray]]]
    # A matte material is marked by a negative roughness, which must not be multiplied by a texture.
    if result[1] >= 0.0 and pixels.metallic_roughness.shape[0] > 0:
        factors = pixels.metallic_roughness[ray]
        result[0] = result[0] * wp.clamp(factors[0] + deviations * factors[3], 0.0, 1.0)
        result[1] = result[1] * wp.clamp(factors[1] + deviations * factors[2], 0.0, 1.0)
    return result


@wp.func
def has_spread(pixels: Pixels, ray: wp.int32) -> wp.bool:
    """Return whether the roughness of the texture varies within the footprint at the hit of a ray."""
    result = wp.bool(False)
    if pixels.metallic_roughness.shape[0] > 0:
        result = pixels.metallic_roughness[ray][2] > LEAST_SPREAD
    return result


@wp.func
def blurred(gloss: Gloss, covariance: wp.vec3f, w: wp.float32) -> Gloss:
    """Return the parameters of the BRDF, blurred by a footprint with a given covariance of (u, v).

    The slope of the half vector is (u, v)/w for the scattering vector (u, v, w). The covariance of the slope is
    therefore the covariance of (u, v), divided by w².
    """
    result = gloss
    added = covariance / (w * w)
    added *= wp.min(1.0, MOST_ADDED / wp.max(added[0] + added[2], 1.0e-30))
    alpha2 = gloss.alpha2
    result.spread = alpha2 + added[0] + added[2]
    result.gaussian = wp.vec3f(alpha2 + added[0], added[1], alpha2 + added[2])
    result.core = 1.0 - alpha2 / result.spread
    return result


@wp.func
def gloss_at(materials: PlainMaterials, pixels: Pixels, ray: wp.int32, view: wp.vec3f, deviations: wp.float32) -> Gloss:
    """Return the parameters of the BRDF at the hit of a ray, without the blur by the range of (u, v) in the pixel.

    The roughness is its mean over the pixel plus ``deviations`` standard deviations.
    """
    result = Gloss()
    result.view = view
    values = metallic_roughness_at(materials, pixels, ray, deviations)
    if values[1] < 0.0:
        return result
    base = pixels.base_colour[ray]
    metallic = values[0]
    alpha = wp.max(values[1] * values[1], materials.least_alpha)
    result.diffuse = (1.0 - metallic) * base
    result.normal_reflectance = (1.0 - metallic) * wp.vec3f(DIELECTRIC, DIELECTRIC, DIELECTRIC) + metallic * base
    result.alpha2 = alpha * alpha
    result.spread = result.alpha2
    return result


@wp.func
def stretched(alpha2: wp.float32, cosine: wp.float32) -> wp.float32:
    """Return √(cos²θ + α² sin²θ), with α of GGX, for a direction at the angle θ from the normal."""
    return wp.sqrt(alpha2 + (1.0 - alpha2) * cosine * cosine)


@wp.func
def facet_density(alpha2: wp.float32, x: wp.float32, y: wp.float32) -> wp.float32:
    """Return the GGX distribution D at the microfacet whose normal has the slopes x and y."""
    square = x * x + y * y
    ratio = (1.0 + square) / (alpha2 + square)
    return wp.static(1.0 / math.pi) * alpha2 * ratio * ratio


@wp.func
def blurred_density(gloss: Gloss, x: wp.float32, y: wp.float32) -> wp.float32:
    """Return the GGX distribution D at the slopes x and y of a microfacet, blurred by the pixel's footprint."""
    result = facet_density(gloss.spread, x, y)
    if gloss.core > 1.0e-4:
        # The Gaussian is a density of slopes. Division by cos⁴ of the microfacet's angle converts it to the form of D.
        per_cosine2 = 1.0 + x * x + y * y
        matrix = gloss.gaussian
        determinant = matrix[0] * matrix[2] - matrix[1] * matrix[1]
        away = (matrix[2] * x * x - 2.0 * matrix[1] * x * y + matrix[0] * y * y) / determinant
        core = wp.static(0.5 / math.pi) * per_cosine2 * per_cosine2 * wp.exp(-0.5 * away) / wp.sqrt(determinant)
        result += gloss.core * (core - result)
    return result


@wp.func
def reflected(gloss: Gloss, light: wp.vec3f, scattering_vector: wp.vec3d) -> wp.vec3f:
    """Return π f for light from the direction ``light``, in linear RGB, where f is the BRDF.

    The scattering vector of light and view is in double precision. Near the mirror direction, slopes are differences of
    nearly equal numbers, which would lose digits in float32.
    """
    w = -scattering_vector[2]
    x = wp.float32(scattering_vector[0] / w)
    y = wp.float32(scattering_vector[1] / w)
    cosine = 0.5 * wp.float32(wp.length(scattering_vector))
    rest = 1.0 - wp.min(cosine, 1.0)
    beyond = rest * rest * rest * rest * rest
    fresnel = gloss.normal_reflectance + beyond * (wp.vec3f(1.0, 1.0, 1.0) - gloss.normal_reflectance)
    visible = light[2] * stretched(gloss.alpha2, gloss.view[2]) + gloss.view[2] * stretched(gloss.alpha2, light[2])
    specular = blurred_density(gloss, x, y) * wp.static(0.5 * math.pi) / wp.max(visible, 1.0e-12)
    return wp.cw_mul(wp.vec3f(1.0, 1.0, 1.0) - fresnel, gloss.diffuse) + specular * fresnel


@wp.kernel
def add_plain_reflection(
    pixels: Pixels, lights: Lights, light_index: wp.int32, towards: wp.array(dtype=wp.vec4f), weight: wp.float64,
    materials: PlainMaterials, footprints: wp.array(dtype=Footprint), scattering_vectors: wp.array(dtype=wp.vec3d),
    to_lights: wp.array(dtype=wp.vec3f), gains: wp.array(dtype=wp.float32), first: wp.int32, run: wp.int32,
    xyz_out: wp.array(dtype=wp.vec3f),
):  # fmt: skip
    """Add the light that plain surfaces with a roughness reflect from one of the lights.

    Args:
        pixels: Hits of the rays.
        lights: The lights.
        light_index: Index of the light.
        towards: Direction to the light and weight for each ray; if empty, all rays use the direction of the light.
        weight: Weight of the light's colours.
        materials: Materials of the plain surfaces.
        footprints: Footprints of the rays; empty for rays that show points.
        scattering_vectors: (u, v, w).
        to_lights: Directions to the light in the shading frame.
        gains: Geometry factors. They are only compared with 0, because no light arrives where they are 0.
        first: Index of the first thread's first ray.
        run: Number of rays per thread.
        xyz_out: Sums of colours.
    """
    place = lights.places[light_index]
    scale = weight * lights.strengths[light_index]
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        if not gains[i] > 0.0:
            continue
        light = to_lights[i]
        scattering_vector = scattering_vectors[i]
        view = -wp.vec3f(scattering_vector) - light
        # The roughness varies within the footprint of the pixel. It is represented by two roughnesses with the same
        # mean and variance.
        spreads = has_spread(pixels, i)
        gloss = gloss_at(materials, pixels, i, view, wp.where(spreads, -1.0, 0.0))
        if gloss.alpha2 == 0.0:
            continue
        if footprints.shape[0] > 0:
            gloss = blurred(gloss, covariance_of(footprints[i]), -wp.float32(scattering_vector[2]))
        factor = reflected(gloss, light, scattering_vector)
        if spreads:
            gloss = gloss_at(materials, pixels, i, view, 1.0)
            if footprints.shape[0] > 0:
                gloss = blurred(gloss, covariance_of(footprints[i]), -wp.float32(scattering_vector[2]))
            factor = 0.5 * (factor + reflected(gloss, light, scattering_vector))
        strength = scale * wp.float64(light[2])
        if towards.shape[0] > 0:
            strength *= wp.float64(towards[i][3])
        if place[3] != wp.float64(0.0):
            strength = strength / (wp.length_sq(away_from(place, pixels.shadow_origin[i])) + wp.float64(1.0e-8))
        rgb = wp.cw_mul(wp.vec3d(factor), lights.white_rgb[light_index])
        xyz_out[i] = xyz_out[i] + wp.vec3f(strength * (lights.rgb_to_xyz * rgb))


@wp.kernel
def add_emission(
    pixels: Pixels, materials: PlainMaterials, brightness: wp.array(dtype=wp.float32), rgb_to_xyz: wp.mat33d,
    weight: wp.float32, resets: wp.bool, first: wp.int32, run: wp.int32,
    scattering_vectors_out: wp.array(dtype=wp.vec3d), gains_out: wp.array(dtype=wp.float32),
    xyz_out: wp.array(dtype=wp.vec3f), illuminated_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Add the light that plain surfaces emit.

    The scattering vectors that are written are those of light from the mirror direction. The gains that are written are
    0, because no height field scatters the emitted light.

    Args:
        pixels: Hits of the rays.
        materials: Materials of the plain surfaces.
        brightness: Luminance of an emission of 1, shape (1,).
        rgb_to_xyz: Matrix from linear sRGB to XYZ.
        weight: Weight of the colours.
        resets: Whether sums of colours are set to 0 first.
        first: Index of the first thread's first ray.
        run: Number of rays per thread.
        scattering_vectors_out: (u, v, w).
        gains_out: Geometry factors.
        xyz_out: Sums of colours.
        illuminated_out: True is written where light is emitted; an empty array is not written.
    """
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        gains_out[i] = 0.0
        scattering_vectors_out[i] = wp.vec3d()
        if resets:
            xyz_out[i] = wp.vec3f()
        if pixels.hit[i] == 0:
            continue
        cosine = wp.float64(wp.dot(pixels.normal[i], pixels.to_view[i]))
        scattering_vectors_out[i] = wp.vec3d(wp.float64(0.0), wp.float64(0.0), -wp.float64(2.0) * cosine)
        emission = materials.emission[materials.rows[pixels.face[i]]]
        if pixels.emission.shape[0] > 0:
            emission = wp.cw_mul(emission, pixels.emission[i])
        if emission[0] + emission[1] + emission[2] > 0.0:
            xyz_out[i] = xyz_out[i] + weight * brightness[0] * wp.vec3f(rgb_to_xyz * wp.vec3d(emission))
            if illuminated_out.shape[0] > 0 and brightness[0] > 0.0:
                illuminated_out[i] = True
