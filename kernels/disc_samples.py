"""Disc samples: random directions to a disc light.

Each sample represents a small Gaussian of directions. All samples of a ray together cover the disc of the light.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer. θi is the angle of ωi from the normal.
"""

import math

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.light_samples import Lights
from warpdiff.kernels.sample_sequence import light_point, sample_index
from warpdiff.kernels.structs import Pixels

wp.set_module_options(compile_options.options())

# If the mirror direction is near the disc of the light, the fraction ``MIRROR_SHARE`` of the samples is drawn around
# the mirror direction, because surfaces are brightest there. ``REACH`` is the largest distance from the disc that
# counts as near [standard deviations of the peak of the zeroth order in (u, v)]. Both values were chosen freely: other
# values change the noise, not the mean.
MIRROR_SHARE, REACH = wp.constant(wp.float32(0.3)), wp.constant(wp.float32(4.0))


@wp.func
def on_disc(point: wp.vec2f) -> wp.vec2f:
    """Map the unit square to the unit disc such that areas are preserved (Shirley and Chiu 1997)."""
    x = 2.0 * point[0] - 1.0
    y = 2.0 * point[1] - 1.0
    if x == 0.0 and y == 0.0:
        return wp.vec2f()
    radius = x
    angle = wp.static(0.25 * math.pi) * (y / x)
    if wp.abs(x) < wp.abs(y):
        radius = y
        angle = wp.static(0.5 * math.pi) - wp.static(0.25 * math.pi) * (x / y)
    return wp.vec2f(radius * wp.cos(angle), radius * wp.sin(angle))


@wp.func
def light_axis(lights: Lights, index: wp.int32) -> wp.vec3f:
    """Return the direction to a distant light."""
    place = lights.places[index]
    return wp.vec3f(wp.float32(place[0]), wp.float32(place[1]), wp.float32(place[2]))


@wp.func
def disc_edge(radius: wp.float32, extent: wp.float32) -> wp.float32:
    """Return the radius of the disc on which directions are drawn, in the plane of :func:`towards_on_disc`.

    Args:
        radius: Radius of the light [rad].
        extent: Standard deviation of the Gaussian of directions that a sample represents, in radii of the light, at
            most 0.5.
    """
    return 2.0 * wp.sin(0.5 * radius * wp.sqrt(wp.max(1.0 - 4.0 * extent * extent, 0.0)))


@wp.func
def towards_on_disc(axis: wp.vec3f, tangent: wp.vec3f, bitangent: wp.vec3f, place: wp.vec2f) -> wp.vec3f:
    """Return the direction at a position in a plane around the axis of a disc light.

    Directions at the angle θ from the axis are at the distance √(2 (1 − cos θ)) from the origin of the plane. The map
    preserves areas.
    """
    square = wp.length_sq(place)
    towards = (1.0 - 0.5 * square) * axis
    towards += wp.sqrt(1.0 - 0.25 * square) * (place[0] * tangent + place[1] * bitangent)
    return wp.normalize(towards)


@wp.kernel
def draw_disc(
    lights: Lights, light_index: wp.int32, extent: wp.float32, lobe: wp.float32, pixels: Pixels,
    tiles: wp.array(dtype=wp.int32), width: wp.int32, across: wp.int32, sample: wp.int32, samples: wp.int32,
    first: wp.int32, run: wp.int32,
    towards_out: wp.array(dtype=wp.vec4f),
):  # fmt: skip
    """Draw a direction to a disc light for each ray: uniform in solid angle, or around the mirror direction.

    Args:
        lights: All lights. The two vectors in ``deviations`` of a disc light are half as long as its radius [rad].
        light_index: Index of the disc light.
        extent: Standard deviation of the Gaussian of directions that a sample represents, in radii of the disc, at most
            0.5. Directions are drawn on a smaller disc; the Gaussian adds the variance that the smaller disc lacks.
        lobe: Standard deviation of the peak (lobe) of the zeroth order in (u, v).
        pixels: Hits of the rays.
        tiles: Pixels that are divided into subpixel cells with one ray each; if empty, each pixel of the picture has
            one ray.
        width: Number of pixels per row.
        across: Number of subpixel cells along a side of a pixel.
        sample: Index of the sample among the ``samples`` of each ray.
        samples: Number of samples per ray.
        first: Index of the first ray of the first thread.
        run: Number of rays per thread.
        towards_out: Unit vectors towards the light, world frame, and weights with a mean of 1. The weight is 0 for
            directions beyond the disc.
    """
    axis = light_axis(lights, light_index)
    tangent = wp.normalize(lights.deviations[light_index, 0])
    bitangent = wp.normalize(lights.deviations[light_index, 1])
    radius = 2.0 * wp.length(lights.deviations[light_index, 0])
    spread = wp.sqrt(lobe * lobe + extent * extent * radius * radius)
    edge = disc_edge(radius, extent)
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        if pixels.hit[i] == 0:
            towards_out[i] = wp.vec4f(axis[0], axis[1], axis[2], 0.0)
            continue
        point = light_point(sample_index(tiles, width, across, i, sample, samples))
        normal = pixels.normal[i]
        view = pixels.to_view[i]
        mirrored = 2.0 * wp.dot(normal, view) * normal - view
        share = wp.where(wp.length(mirrored - axis) < edge + REACH * spread, MIRROR_SHARE, 0.0)
        towards = wp.vec3f()
        if point[0] < share:
            # Draw (u, v) from a Gaussian around the mirror direction, where (u, v) is 0.
            size = spread * wp.sqrt(-2.0 * wp.log(1.0 - point[0] / share))
            angle = wp.static(2.0 * math.pi) * point[1]
            across_normal = mirrored - wp.dot(mirrored, normal) * normal
            across_normal += size * (wp.cos(angle) * pixels.tangent[i] + wp.sin(angle) * pixels.bitangent[i])
            up = wp.sqrt(wp.max(1.0 - wp.length_sq(across_normal), 0.0))
            towards = wp.normalize(across_normal + up * normal)
        else:
            place = edge * on_disc(wp.vec2f((point[0] - share) / (1.0 - share), point[1]))
            towards = towards_on_disc(axis, tangent, bitangent, place)
        weight = wp.float32(1.0)
        if share > 0.0:
            away = towards - mirrored
            away -= wp.dot(away, normal) * normal
            # The probability density of the direction is the density of the Gaussian around the mirror direction times
            # `share`, plus the density on the disc times (1 − `share`). Both densities are per solid angle ω. The
            # density of the Gaussian per area of (u, v) is therefore multiplied by cos θi, because du dv = dω cos θi.
            of_mirror = wp.exp(-0.5 * wp.length_sq(away) / (spread * spread)) * wp.dot(towards, normal)
            of_mirror *= wp.static(0.5 / math.pi) / (spread * spread)
            even = wp.static(1.0 / math.pi) / (edge * edge)
            weight = even / (share * of_mirror + (1.0 - share) * even)
            if wp.length_sq(towards - axis) > edge * edge:
                weight = wp.float32(0.0)
        towards_out[i] = wp.vec4f(towards[0], towards[1], towards[2], weight)
