"""Textures of plain surfaces at hits: metallic and roughness, and emission.

Plain surfaces have no height field. The kernels are launched only for scenes in which they have such textures.
"""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.footprints import LEAST_FACING
from warpdiff.kernels.structs import Camera, Pixels, SurfaceArrays, Textures

wp.set_module_options(compile_options.options("plain_textures.h"))


@wp.func_native(
    f"warpdiff::look_up_plain_textures(camera, surface, textures, pixels, deviation, {LEAST_FACING}f, begin, end);"
)
def look_up_plain_textures(
    camera: Camera, surface: SurfaceArrays, textures: Textures, pixels: Pixels, deviation: wp.float32,
    begin: wp.int32, end: wp.int32,
):  # fmt: skip
    """Look up the textures of plain surfaces at the hits with indices from ``begin`` to ``end``."""


@wp.kernel
def sample_plain_textures(
    camera: Camera, surface: SurfaceArrays, textures: Textures, pixels: Pixels, deviation: wp.float32,
    first: wp.int32, run: wp.int32,
):  # fmt: skip
    """Write metallic, roughness and emission of textures at hits; the values are 1 where there is no texture.

    Args:
        camera: Camera in the units of the mesh.
        surface: Mesh.
        textures: Textures of the materials, and their texture coordinates.
        pixels: Arrays of hits: hits are read, metallic, roughness and emission are written.
        deviation: Standard deviation of the Gaussian filter of each ray [pixels]. With 0, textures are sampled at
            points.
        first: Index of the first thread's first ray.
        run: Number of rays per thread.
    """
    thread, _ = wp.tid()
    begin = first + thread * run
    look_up_plain_textures(camera, surface, textures, pixels, deviation, begin, begin + run)
