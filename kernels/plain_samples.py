"""Samples of lights for plain surfaces with a roughness: of skies, of disc lights, and of many directional lights.

Normals of microfacets are drawn from the distribution of visible normals (Heitz 2018), by spherical caps (Dupuy and
Benyoub 2023). Directions may be drawn from several distributions. The weight of a direction is one over the sum of the
densities of all these distributions (balance heuristic, Veach 1997). Random numbers are those of ``sample_sequence``. α
is the parameter of the GGX distribution of microfacets, and (u, v, w) the scattering vector.
"""

import math

import warp as wp

from warpdiff.kernels import compile_options, thresholds
from warpdiff.kernels.bvh import FAR
from warpdiff.kernels.disc_samples import disc_edge, light_axis, on_disc, towards_on_disc
from warpdiff.kernels.light_samples import Lights, covariance_of
from warpdiff.kernels.plain_reflection import (
    Gloss,
    PlainMaterials,
    blurred,
    facet_density,
    gloss_at,
    has_spread,
    reflected,
    stretched,
)
from warpdiff.kernels.primary_hits import scramble
from warpdiff.kernels.sample_frames import filtered_frame, frame_at, in_frame, in_world
from warpdiff.kernels.sample_sequence import filter_point, light_point, sample_index
from warpdiff.kernels.sky_samples import (
    Sky,
    SkyDistribution,
    density_of_direction,
    draw_direction,
    place_in_sky,
    power_at,
)
from warpdiff.kernels.structs import Footprint, Pixels, SurfaceArrays, Textures, Transparency
from warpdiff.kernels.transparency import is_occluded

wp.set_module_options(compile_options.options("transparency.h"))

HORIZON = wp.constant(wp.float32(thresholds.HORIZON))
# Directions to the light are drawn from several distributions. Other fractions would change the noise, not the mean.
# Under a sky, the fraction `SKY_SHARE` is drawn by the brightness of the sky if the surface is diffuse or rough, and
# `SKY_SHARE_OF_MIRROR` if it is a mirror; the others are drawn by the reflectance. At least the fraction
# `LEAST_OF_FACETS` of these others is a reflection at random microfacets. For a disc light, `DISC_SHARE` is the
# fraction drawn from microfacets, if their reflection lobe is narrower than the disc and near it. `REACH` is the
# largest distance from the disc that counts as near, in units of the roughness parameter α.
LEAST_OF_FACETS, SKY_SHARE, SKY_SHARE_OF_MIRROR = (wp.constant(wp.float32(share)) for share in (0.2, 0.5, 0.1))
DISC_SHARE, REACH = wp.constant(wp.float32(0.5)), wp.constant(wp.float32(8.0))
# To choose one of many lights, the expected brightness under each light is computed. It is divided by the cosine of the
# view direction, or by this number if the cosine is smaller. Other values would change the noise, not the mean.
LEAST_VIEW = wp.constant(wp.float32(0.1))


@wp.func
def draw_facet(gloss: Gloss, point: wp.vec2f) -> wp.vec3f:
    """Draw a direction to the light by reflecting the view at a random microfacet; it may be below the horizon."""
    alpha = wp.sqrt(gloss.spread)
    view = gloss.view
    onto = wp.normalize(wp.vec3f(alpha * view[0], alpha * view[1], view[2]))
    height = (1.0 - point[1]) * (1.0 + onto[2]) - onto[2]
    level = wp.sqrt(wp.max(1.0 - height * height, 0.0))
    angle = wp.static(2.0 * math.pi) * point[0]
    x = level * wp.cos(angle) + onto[0]
    y = level * wp.sin(angle) + onto[1]
    half = wp.normalize(wp.vec3f(alpha * x, alpha * y, height + onto[2]))
    return 2.0 * wp.dot(half, view) * half - view


@wp.func
def density_of_facet(gloss: Gloss, light: wp.vec3f) -> wp.float32:
    """Return the probability density of :func:`draw_facet` at a direction above the horizon, per solid angle."""
    view = gloss.view
    per_w = 1.0 / (light[2] + view[2])
    density = facet_density(gloss.spread, per_w * (light[0] + view[0]), per_w * (light[1] + view[1]))
    return density / (2.0 * (view[2] + stretched(gloss.spread, view[2])))


@wp.func
def scattering_vector_of(gloss: Gloss, light: wp.vec3f) -> wp.vec3d:
    """Return the scattering vector (u, v, w) for light from a direction."""
    return -(wp.vec3d(light) + wp.vec3d(gloss.view))


@wp.func
def mean_of(values: wp.vec3f) -> wp.float32:
    """Return the mean of the three components of a vector."""
    return (values[0] + values[1] + values[2]) / 3.0


@wp.func
def specular_reflectance(gloss: Gloss) -> wp.float32:
    """Return Schlick's reflectance of a flat surface for the view direction, as the mean of red, green and blue."""
    rest = 1.0 - gloss.view[2]
    normal = mean_of(gloss.normal_reflectance)
    return normal + (1.0 - normal) * rest * rest * rest * rest * rest


@wp.func
def share_of_facets(gloss: Gloss) -> wp.float32:
    """Return the fraction of a surface's samples that are drawn from microfacets.

    The density of the other samples is proportional to the cosine of the angle from the normal.
    """
    specular = specular_reflectance(gloss)
    diffuse = (1.0 - specular) * mean_of(gloss.diffuse)
    if diffuse <= 0.0:
        return 1.0
    return wp.max(specular / (specular + diffuse), LEAST_OF_FACETS)


@wp.kernel
def sample_plain_sky(
    sky: Sky, table: SkyDistribution, pixels: Pixels, materials: PlainMaterials, footprints: wp.array(dtype=Footprint),
    rgb_to_xyz: wp.mat33d, mesh: SurfaceArrays, textures: Textures, transparency: Transparency, mesh_id: wp.uint64,
    shadows: wp.bool, tiles: wp.array(dtype=wp.int32), width: wp.int32, across: wp.int32, sample: wp.int32,
    samples: wp.int32, first: wp.int32, run: wp.int32,
    xyz_out: wp.array(dtype=wp.vec3f), illuminated_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Draw one direction of the sky for each ray on a plain surface with a roughness, and add the reflected light.

    Args:
        sky: Power per solid angle of the sky by direction, for three spectra.
        table: Distribution of bright directions of the sky.
        pixels: Hits of the rays.
        materials: Materials of the plain surfaces.
        footprints: Footprints of the rays' filters for light from the mirror direction.
        rgb_to_xyz: Matrix from linear sRGB to XYZ.
        mesh: Mesh, for shadow rays through transparent faces.
        textures: Textures of the materials, which have the alpha of transparent faces.
        transparency: Cut-offs of the materials.
        mesh_id: Id of the mesh with the hierarchy for shadow rays.
        shadows: Whether shadow rays are traced.
        tiles: Pixels that are divided into cells with one ray each; −1 is no pixel. If empty, each pixel of the picture
            has one ray.
        width: Number of pixels per row.
        across: Number of cells along a side of a pixel.
        sample: Index of the sample among the ``samples`` of each ray.
        samples: Number of samples per ray.
        first: Index of the first thread's first ray.
        run: Number of rays per thread.
        xyz_out: Sums of colours.
        illuminated_out: True is written where light arrives; an empty array is not written.
    """
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        if pixels.hit[i] == 0:
            continue
        index = sample_index(tiles, width, across, i, sample, samples)
        frame = filtered_frame(pixels, i, footprints[i], filter_point(index))
        # The roughness varies within the footprint. One of two roughnesses is drawn; they have the same mean and
        # variance as the roughness in the footprint.
        deviations = wp.float32(0.0)
        if has_spread(pixels, i):
            deviations = wp.where((scramble(index) & wp.uint32(1)) != wp.uint32(0), 1.0, -1.0)
        gloss = gloss_at(materials, pixels, i, frame.view, deviations)
        if gloss.alpha2 == 0.0:
            continue
        of_facets = share_of_facets(gloss)
        of_rough = (1.0 - of_facets) + of_facets * wp.sqrt(gloss.alpha2)
        of_sky = SKY_SHARE_OF_MIRROR + of_rough * (SKY_SHARE - SKY_SHARE_OF_MIRROR)
        point = light_point(index)
        light = wp.vec3f()
        along = wp.vec3f()
        if point[0] < of_sky:
            along = draw_direction(table, sky, wp.vec2f(point[0] / of_sky, point[1]))
            light = in_frame(frame, along)
        else:
            rest = (point[0] - of_sky) / (1.0 - of_sky)
            if rest < of_facets:
                light = draw_facet(gloss, wp.vec2f(rest / of_facets, point[1]))
            else:
                on = on_disc(wp.vec2f((rest - of_facets) / (1.0 - of_facets), point[1]))
                light = wp.vec3f(on[0], on[1], wp.sqrt(wp.max(1.0 - wp.length_sq(on), 0.0)))
            along = in_world(frame, light)
        if light[2] < HORIZON:
            continue
        place = place_in_sky(sky, along)
        of_surface = of_facets * density_of_facet(gloss, light)
        of_surface += (1.0 - of_facets) * wp.static(1.0 / math.pi) * light[2]
        density = of_sky * density_of_direction(table, place) + (1.0 - of_sky) * of_surface
        if density <= 0.0:
            continue
        if shadows:
            if is_occluded(mesh, textures, transparency, mesh_id, pixels.shadow_origin[i], along, FAR):
                continue
        power = power_at(sky, place)
        white = wp.transpose(sky.whites) * power
        rgb = wp.cw_mul(reflected(gloss, light, scattering_vector_of(gloss, light)), white)
        rgb *= light[2] / (density * wp.float32(samples))
        xyz_out[i] = xyz_out[i] + wp.vec3f(rgb_to_xyz * wp.vec3d(rgb))
        if illuminated_out.shape[0] > 0 and power[0] + power[1] + power[2] > 0.0:
            illuminated_out[i] = True


@wp.kernel
def draw_plain_disc(
    lights: Lights, light_index: wp.int32, extent: wp.float32, materials: PlainMaterials, pixels: Pixels,
    tiles: wp.array(dtype=wp.int32), width: wp.int32, across: wp.int32, sample: wp.int32, samples: wp.int32,
    first: wp.int32, run: wp.int32,
    towards_out: wp.array(dtype=wp.vec4f),
):  # fmt: skip
    """Draw a direction to a disc light for each ray on a plain surface with a roughness.

    A fraction of the directions is drawn from microfacets if their reflection lobe is narrower than the disc. The
    arguments are those of ``disc_samples.draw_disc``, whose directions this kernel replaces.
    """
    axis = light_axis(lights, light_index)
    tangent = wp.normalize(lights.deviations[light_index, 0])
    bitangent = wp.normalize(lights.deviations[light_index, 1])
    radius = 2.0 * wp.length(lights.deviations[light_index, 0])
    edge = disc_edge(radius, extent)
    of_disc = 1.0 / (wp.static(math.pi) * wp.max(edge * edge, 1.0e-12))
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        if pixels.hit[i] == 0:
            continue
        frame = frame_at(pixels, i)
        gloss = gloss_at(materials, pixels, i, frame.view, 0.0)
        if gloss.alpha2 == 0.0:
            continue
        # A sample counts as a small Gaussian source, which widens the reflection lobe of the microfacets, as in
        # ``light_samples.add_light_extent``.
        own = extent * extent * radius * radius
        gloss = blurred(gloss, wp.vec3f(own, 0.0, own), 2.0 * gloss.view[2])
        reach = 2.0 * wp.sqrt(gloss.spread)
        view = pixels.to_view[i]
        mirrored = 2.0 * wp.dot(pixels.normal[i], view) * pixels.normal[i] - view
        share = wp.float32(0.0)
        if reach < edge and wp.length(mirrored - axis) < edge + REACH * reach:
            share = DISC_SHARE * share_of_facets(gloss)
        point = light_point(sample_index(tiles, width, across, i, sample, samples))
        towards = wp.vec3f()
        light = wp.vec3f()
        if point[0] < share:
            light = draw_facet(gloss, wp.vec2f(point[0] / share, point[1]))
            towards = in_world(frame, light)
        else:
            place = edge * on_disc(wp.vec2f((point[0] - share) / (1.0 - share), point[1]))
            towards = towards_on_disc(axis, tangent, bitangent, place)
            light = in_frame(frame, towards)
        weight = wp.float32(0.0)
        if light[2] > HORIZON and wp.length(towards - axis) <= edge:
            weight = of_disc / ((1.0 - share) * of_disc + share * density_of_facet(gloss, light))
        towards_out[i] = wp.vec4f(towards[0], towards[1], towards[2], weight)


@wp.struct
class ChoicePoint:
    """Values at a hit from which the expected brightness under many lights is computed: frame, view and BRDF."""

    tangent: wp.vec3f
    bitangent: wp.vec3f
    normal: wp.vec3f
    view: wp.vec3f
    spread: wp.float32  # α² of the GGX distribution after the blur by the footprint
    specular: wp.float32  # factor of the specular reflection, which includes the cosine of the light's angle
    diffuse: wp.float32  # brightness of the diffuse reflection for light along the normal


@wp.func
def choice_point(gloss: Gloss, pixels: Pixels, ray: wp.int32) -> ChoicePoint:
    """Return the values at a hit from which the expected brightness under many lights is computed.

    Two approximations save time: the Fresnel term is that of the view direction, and masking is omitted.
    """
    result = ChoicePoint()
    result.tangent = pixels.tangent[ray]
    result.bitangent = pixels.bitangent[ray]
    result.normal = pixels.normal[ray]
    result.view = pixels.to_view[ray]
    result.spread = gloss.spread
    specular = specular_reflectance(gloss)
    result.specular = 0.25 * specular * gloss.spread / wp.max(gloss.view[2], LEAST_VIEW)
    result.diffuse = (1.0 - specular) * mean_of(gloss.diffuse)
    return result


@wp.func
def expected_brightness(lights: Lights, index: wp.int32, at: ChoicePoint) -> wp.float32:
    """Return the light that a hit is expected to reflect from one of many directional lights; 0 below the horizon."""
    towards = light_axis(lights, index)
    cosine = wp.dot(towards, at.normal)
    if cosine < HORIZON:
        return 0.0
    between = towards + at.view
    per_w = 1.0 / wp.dot(between, at.normal)
    x = per_w * wp.dot(between, at.tangent)
    y = per_w * wp.dot(between, at.bitangent)
    square = x * x + y * y
    ratio = (1.0 + square) / (at.spread + square)
    return wp.float32(lights.strengths[index]) * (cosine * at.diffuse + at.specular * ratio * ratio)


@wp.kernel
def choose_plain_lights(
    lights: Lights, materials: PlainMaterials, pixels: Pixels, footprints: wp.array(dtype=Footprint),
    tiles: wp.array(dtype=wp.int32), width: wp.int32, across: wp.int32, sample: wp.int32, samples: wp.int32,
    first: wp.int32, run: wp.int32,
    towards_out: wp.array(dtype=wp.vec4f),
):  # fmt: skip
    """Choose one of many directional lights for each ray on a plain surface with a roughness.

    The probability is proportional to the light that the surface is expected to reflect without shadows. The arguments
    are those of ``light_choice.choose_lights``.
    """
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        if pixels.hit[i] == 0:
            continue
        frame = frame_at(pixels, i)
        gloss = gloss_at(materials, pixels, i, frame.view, 0.0)
        if gloss.alpha2 == 0.0:
            continue
        gloss = blurred(gloss, covariance_of(footprints[i]), 2.0 * gloss.view[2])
        at = choice_point(gloss, pixels, i)
        total = wp.float32(0.0)
        for index in range(lights.places.shape[0]):
            total += expected_brightness(lights, index, at)
        towards_out[i] = wp.vec4f(0.0, 1.0, 0.0, 0.0)
        rest = total * light_point(sample_index(tiles, width, across, i, sample, samples))[0]
        for index in range(lights.places.shape[0]):
            brightness = expected_brightness(lights, index, at)
            if brightness > 0.0 and rest >= 0.0:
                # Rounding errors may make the sum of all probabilities too small. The last light above the horizon is
                # then chosen.
                towards = light_axis(lights, index)
                weight = wp.float32(lights.strengths[index] / lights.strengths[0]) * total / brightness
                towards_out[i] = wp.vec4f(towards[0], towards[1], towards[2], weight)
                rest -= brightness
