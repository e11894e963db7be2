"""Base colours of textured hits, filtered by the footprints of rays.

The kernels are launched only for scenes with texture images. Textures of other properties of a material can be sampled
in the same way: ``sample_footprint`` and ``sample_point`` of ``native/textures.h`` return RGBA of any texture of a
table.
"""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.footprints import LEAST_FACING
from warpdiff.kernels.structs import Camera, Pixels, SurfaceArrays, Textures

wp.set_module_options(compile_options.options("base_colours.h"))


@wp.func_native(
    f"warpdiff::look_up_base_colours(camera, surface, textures, pixels, deviation, {LEAST_FACING}f, begin, end);"
)
def look_up_base_colours(
    camera: Camera, surface: SurfaceArrays, textures: Textures, pixels: Pixels, deviation: wp.float32,
    begin: wp.int32, end: wp.int32,
):  # fmt: skip
    """Write the base colours from textures at the hits with the indices from ``begin`` to ``end``."""


@wp.kernel
def sample_base_colours(
    camera: Camera, surface: SurfaceArrays, textures: Textures, pixels: Pixels, deviation: wp.float32,
    first: wp.int32, run: wp.int32,
):  # fmt: skip
    """Replace negative base colours by the colours of textures.

    ``intersect_known_faces`` writes a negative base colour where a texture determines the colour.

    Args:
        camera: Camera in the units of the mesh.
        surface: Mesh with its texture coordinates.
        textures: Textures of the materials.
        pixels: Arrays of hits: hits and base colours are read, base colours are written.
        deviation: Standard deviation of the Gaussian filter of each ray [pixels]. With 0, textures are sampled at
            points.
        first: Index of the first thread's first ray.
        run: Number of rays per thread.
    """
    thread, _ = wp.tid()
    begin = first + thread * run
    look_up_base_colours(camera, surface, textures, pixels, deviation, begin, begin + run)
