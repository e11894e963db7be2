"""Choice of one of many distant lights for each ray, by the light that the surface is expected to scatter.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.light_samples import Lights, Reflection, finish_of
from warpdiff.kernels.sample_sequence import light_point, sample_index
from warpdiff.kernels.sky_samples import SkyDistribution
from warpdiff.kernels.structs import Footprint, Pixels

wp.set_module_options(compile_options.options("light_choice.h"))


@wp.func_native("warpdiff::choose_light<16>(lights, table, diffuse, pixels, footprints, ray, random, towards_out);")
def choose(
    lights: Lights, table: SkyDistribution, diffuse: wp.float32, pixels: Pixels, footprints: wp.array(dtype=Footprint),
    ray: wp.int32, random: wp.float32, towards_out: wp.array(dtype=wp.vec4f),
):  # fmt: skip
    """Choose a light for a ray that hits the mesh, by a random number from 0 to 1."""


@wp.kernel
def choose_lights(
    # Inputs of the kernel:
    lights: Lights, table: SkyDistribution, reflection: Reflection, surface: wp.int32, diffuse: wp.float32,
    pixels: Pixels, footprints: wp.array(dtype=Footprint), tiles: wp.array(dtype=wp.int32), width: wp.int32,
    across: wp.int32, sample: wp.int32, samples: wp.int32,
    first: wp.int32, run: wp.int32,
    # Outputs of the kernel:
    towards_out: wp.array(dtype=wp.vec4f),
):  # fmt: skip
    """Choose one of many distant lights for each ray, with a probability proportional to the expected brightness.

    The brightness is that of the light which the surface is expected to scatter to the viewer.

    Args:
        lights: The lights, which have the same spectrum.
        table: Distribution over (u, v) of the light that the surface scatters.
        reflection: Parameters of the reflectance. Only its list with the surface of each face is used here.
        surface: Surface for whose faces lights are chosen; the results of other rays are unchanged.
        diffuse: Brightness for light along the normal, which is multiplied by the cosine of the light's angle and added
            to the brightness from the table.
        pixels: Hits of the rays.
        footprints: Footprints in (u, v) of the rays' pixels or cells, for light from the mirror direction.
        tiles: Pixels that are divided into subpixel cells with one ray each; if empty, each pixel of the picture has
            one ray.
        width: Number of pixels per row.
        across: Number of subpixel cells along a side of a pixel.
        sample: Index of the sample among the ``samples`` of each ray.
        samples: Number of samples per ray.
        first: Index of the first ray of the first thread.
        run: Number of rays per thread.
        towards_out: Unit vectors towards the chosen lights, world frame, and weights. A weight is the power of the
            chosen light relative to the power of the first light, divided by the probability of the choice. The weight
            is 0 if no light was chosen.
    """
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        if pixels.hit[i] == 0:
            towards_out[i] = wp.vec4f(0.0, 1.0, 0.0, 0.0)
        elif reflection.surfaces[finish_of(reflection, pixels.face[i])] == surface:
            towards_out[i] = wp.vec4f(0.0, 1.0, 0.0, 0.0)
            point = light_point(sample_index(tiles, width, across, i, sample, samples))
            choose(lights, table, diffuse, pixels, footprints, i, point[0], towards_out)
