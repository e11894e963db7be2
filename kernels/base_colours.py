"""Base colours of textured hits, filtered by the footprints of rays. Only scenes with texture images use this module.

Textures of other properties of a material can be sampled in the same way: ``sample_footprint`` and ``sample_point`` of
``native/textures.h`` return RGBA of any texture of a table.
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
    """Look up the base colours of the textured hits with indices from ``begin`` to ``end``."""


@wp.func
def wrap(index: wp.int32, size: wp.int32) -> wp.int32:
    """Return ``index`` modulo ``size``, for an index in −``size`` to 2 ``size`` − 1.

    With :func:`~warpdiff.kernels.indices.cyclic` instead, the compiler would round texture look-ups differently, and
    pictures would change.
    """
    result = index
    if result < 0:
        result = result + size
    if result >= size:
        result = result - size
    return result


@wp.func
def texel(textures: Textures, index: wp.int32) -> wp.vec3f:
    """Return the linear RGB of a texel."""
    rgba = textures.texels[index]
    return wp.vec3f(rgba[0], rgba[1], rgba[2])


@wp.func
def sample_repeated(textures: Textures, number: wp.int32, uv: wp.vec2f) -> wp.vec3f:
    """Return the colour of a texture that is repeated, by bilinear interpolation between texel centres.

    Row 0 of the texture is at v = 1. Texel centres are half a texel from the edges.
    """
    level = textures.table[number, 0]
    start = textures.levels[level, 0]
    height = textures.levels[level, 2]
    width = textures.levels[level, 1]
    x = (uv[0] - wp.floor(uv[0])) * wp.float32(width) - 0.5
    y = (wp.float32(1.0) - (uv[1] - wp.floor(uv[1]))) * wp.float32(height) - 0.5
    fx = x - wp.floor(x)
    fy = y - wp.floor(y)
    x0 = wrap(wp.int32(wp.floor(x)), width)
    y0 = wrap(wp.int32(wp.floor(y)), height)
    x1 = wrap(x0 + 1, width)
    y1 = wrap(y0 + 1, height)
    upper = start + y0 * width
    lower = start + y1 * width
    top = (1.0 - fx) * texel(textures, upper + x0) + fx * texel(textures, upper + x1)
    bottom = (1.0 - fx) * texel(textures, lower + x0) + fx * texel(textures, lower + x1)
    return (1.0 - fy) * top + fy * bottom


@wp.func
def paint(surface: SurfaceArrays, textures: Textures, pixels: Pixels, ray: wp.int32):
    i0 = surface.faces[pixels.face[ray], 0]
    i1 = surface.faces[pixels.face[ray], 1]
    i2 = surface.faces[pixels.face[ray], 2]
    b0 = pixels.place[ray][0]
    b1 = pixels.place[ray][1]
    b2 = wp.max(wp.float32(0.0), 1.0 - b0 - b1)
    uv = b0 * surface.uvs[i0] + b1 * surface.uvs[i1] + b2 * surface.uvs[i2]
    pixels.base_colour[ray] = sample_repeated(textures, 0, uv)


@wp.kernel
def sample_base_colours(
    camera: Camera, surface: SurfaceArrays, textures: Textures, pixels: Pixels, deviation: wp.float32,
    first: wp.int32, run: wp.int32,
):  # fmt: skip
    """Replace negative base colours, which ``intersect_known_faces`` writes at textured hits, by those of textures.

    Args:
        camera: Camera in the units of the mesh.
        surface: Mesh with its texture coordinates.
        textures: Textures of the materials.
        pixels: Arrays of hits: hits and base colours are read, base colours are written.
        deviation: Standard deviation of the rays' filter [pixels]. With 0, textures are sampled at points.
        first: Index of the first thread's first ray.
        run: Number of rays per thread.
    """
    thread, _ = wp.tid()
    begin = first + thread * run
    if deviation > 0.0:
        look_up_base_colours(camera, surface, textures, pixels, deviation, begin, begin + run)
        return
    for ray in range(begin, begin + run):
        if pixels.hit[ray] != 0:
            paint(surface, textures, pixels, ray)
