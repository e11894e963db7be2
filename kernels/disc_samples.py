"""Disc samples: directions to a disc light, a Gaussian of directions each, which together are the disc."""

import math

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.light_samples import Lights
from warpdiff.kernels.sample_sequence import light_point, sample_index

wp.set_module_options(compile_options.options())


@wp.func
def on_disc(point: wp.vec2f) -> wp.vec2f:
    """Map the unit square to the unit disc, which keeps areas (Shirley and Chiu 1997)."""
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


@wp.kernel
def draw_disc(
    # In:
    lights: Lights, light_index: wp.int32, radius: wp.float32, tiles: wp.array(dtype=wp.int32), width: wp.int32,
    across: wp.int32, sample: wp.int32, samples: wp.int32, first: wp.int32, run: wp.int32,
    # Out:
    towards_out: wp.array(dtype=wp.vec3f),
):  # fmt: skip
    """Draw a direction to a disc light for each ray, even in solid angle.

    Args:
        lights: The lights; deviations are two vectors orthogonal to the direction to the disc's centre.
        light_index: The light.
        radius: Angular radius that directions lie within [rad].
        tiles: As for ``sample_index``, like the next ones.
        width: Pixels in a row.
        across: Cells along a side of a pixel.
        sample: Index of the sample among those of the ray.
        samples: Number of samples of each ray.
        first: The first thread's ray.
        run: Number of rays per thread.
        towards_out: Unit vectors towards the light, world frame.
    """
    place = lights.places[light_index]
    axis = wp.vec3f(wp.float32(place[0]), wp.float32(place[1]), wp.float32(place[2]))
    tangent = wp.normalize(lights.deviations[light_index, 0])
    bitangent = wp.normalize(lights.deviations[light_index, 1])
    # Of equal areas in the plane are equal solid angles: 1 − cos θ is half the square of the distance.
    edge = 2.0 * wp.sin(0.5 * radius)
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        place_on_disc = edge * on_disc(light_point(sample_index(tiles, width, across, i, sample, samples)))
        square = wp.length_sq(place_on_disc)
        aside = wp.sqrt(1.0 - 0.25 * square)
        towards = (1.0 - 0.5 * square) * axis
        towards += aside * (place_on_disc[0] * tangent + place_on_disc[1] * bitangent)
        towards_out[i] = wp.normalize(towards)
