"""Primary hits: intersections of camera rays with the mesh, shading frames and base colours."""

import warp as wp

from warpdiff.kernels import compile_options, refinement_levels
from warpdiff.kernels.refinement_levels import FILTER_CUT, FILTER_SIGMA
from warpdiff.kernels.shading_frames import LEAST_TANGENT, face_the_viewer, perpendicular, shading_frames_run
from warpdiff.kernels.structs import SPECIAL, Camera, Cells, Pixels, Sampling, SurfaceArrays

wp.set_module_options(compile_options.options("rasterize.h", "primary_hits.h", "shading_frames.h"))

# Standard deviation σ of the pixel filter [pixels], and exponent −r² / (2 σ²) of the Gaussian at the radius r at which
# the filter is truncated. Both are derived from constants in ``refinement_levels``.
SIGMA = wp.constant(wp.float64(FILTER_SIGMA))
CUT_EXPONENT = wp.constant(wp.float64(-0.5 * (FILTER_CUT / FILTER_SIGMA) ** 2))
# Value in the array ``nearest`` for a ray that hits no face.
UNSEEN = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))

# Constants of two algorithms. The first two are the multipliers of the hash function "lowbias32" (Wellons 2018). The
# third, 2^32 divided by the golden ratio, makes a second seed for this hash function. The last two are the increments
# of the R2 sequence (Roberts 2018) along x and y, times 2^32.
HASH_1 = wp.constant(wp.uint32(0x7FEB352D))
HASH_2 = wp.constant(wp.uint32(0x846CA68B))
GOLDEN = wp.constant(wp.uint32(0x9E3779B9))
R2_X = wp.constant(wp.uint32(3242174889))
R2_Y = wp.constant(wp.uint32(2447445414))


@wp.func
def scramble(value: wp.uint32) -> wp.uint32:
    """Return a 32-bit hash of a 32-bit number."""
    x = value
    x = x ^ (x >> wp.uint32(16))
    x = x * HASH_1
    x = x ^ (x >> wp.uint32(15))
    x = x * HASH_2
    return x ^ (x >> wp.uint32(16))


@wp.func
def to_unit(bits: wp.uint32) -> wp.float64:
    """Map 32 bits to a number strictly between 0 and 1."""
    return (wp.float64(bits) + wp.float64(0.5)) / wp.float64(4294967296.0)


@wp.func
def pixel_offset(sample: wp.int32, seed: wp.int32, pixel: wp.int32) -> wp.vec2d:
    """Return the position of one of several rays in a pixel, (right, down) of the centre [pixels].

    Offsets have the distribution of the pixel filter, a truncated Gaussian, so that all samples have equal weights.
    Samples follow the R2 sequence, shifted for each pixel by a hash (Cranley-Patterson rotation). The sequence is
    computed in 32-bit integers, which are exact at any index.
    """
    index = wp.uint32(sample)
    rotation_x = scramble(wp.uint32(pixel) ^ scramble(wp.uint32(seed)))
    rotation_y = scramble(rotation_x + GOLDEN)
    radial = to_unit(index * R2_X + rotation_x)
    angular = to_unit(index * R2_Y + rotation_y)
    # A Gaussian with the standard deviation σ has the share 1 − exp(−r² / (2 σ²)) of its weight within the radius r, at
    # which it is truncated. Only this share of its cumulative distribution is used.
    inside = wp.float64(1.0) - wp.exp(CUT_EXPONENT)
    radius = SIGMA * wp.sqrt(-wp.float64(2.0) * wp.log(wp.float64(1.0) - radial * inside))
    angle = wp.float64(2.0) * wp.float64(wp.pi) * angular
    return wp.vec2d(radius * wp.cos(angle), radius * wp.sin(angle))


# Number of subpixel cells of a pixel at the finest level of refinement.
_MOST_CELLS = max(refinement_levels.rays_at(level) for level in refinement_levels.LEVELS)


@wp.func_native(
    f"warpdiff::rasterize_faces<{_MOST_CELLS}>(camera, surface, sampling, cells, max_offset, begin, end, nearest_out);"
)
def rasterize_run(
    camera: Camera, surface: SurfaceArrays, sampling: Sampling, cells: Cells, max_offset: wp.float64, begin: wp.int32,
    end: wp.int32, nearest_out: wp.array(dtype=wp.uint64),
):  # fmt: skip
    """Rasterize the faces from ``begin`` to ``end``, and store the nearest face of each ray."""


@wp.kernel
def rasterize(
    camera: Camera, surface: SurfaceArrays, sampling: Sampling, cells: Cells, max_offset: wp.float64, first: wp.int32,
    run: wp.int32,
    nearest_out: wp.array(dtype=wp.uint64),
):  # fmt: skip
    """Find the first face that the ray of each pixel or cell hits, by rasterization. Used on the CPU only.

    On the CPU, rasterization is faster than rays through a hierarchy of bounding boxes.

    Args:
        camera: Camera in the units of the mesh.
        surface: Mesh whose faces are rasterized.
        sampling: Positions of the rays in their pixels.
        cells: Pixels that are subdivided; if empty, there is one ray per pixel.
        max_offset: Largest distance of a ray from its pixel's centre, along an axis [pixels].
        first: Index of the first thread's first face.
        run: Number of faces per thread.
        nearest_out: For each ray, the depth of the hit along the camera's optical axis, and the index of the face. The
            upper 32 bits are those of the depth as a float32, so that the smallest value is the nearest face. All bits
            are set if the ray hits no face.
    """
    begin = first + wp.tid() * run
    rasterize_run(camera, surface, sampling, cells, max_offset, begin, begin + run, nearest_out)


@wp.func
def paint(surface: SurfaceArrays, pixels: Pixels, ray: wp.int32):
    """Write the base colour at a hit into ``pixels.base_colour``.

    The written colour is negative if a texture determines the base colour.
    """
    colour = surface.plain_colour
    if surface.vertex_colours.shape[0] > 0:
        b0 = pixels.place[ray][0]
        b1 = pixels.place[ray][1]
        b2 = wp.max(wp.float32(0.0), 1.0 - b0 - b1)
        c0 = surface.vertex_colours[surface.faces[pixels.face[ray], 0]]
        c1 = surface.vertex_colours[surface.faces[pixels.face[ray], 1]]
        c2 = surface.vertex_colours[surface.faces[pixels.face[ray], 2]]
        colour = b0 * c0 + b1 * c1 + b2 * c2
    pixels.base_colour[ray] = colour


@wp.func_native(
    f"warpdiff::intersect_known_faces<32, {int(UNSEEN)}ULL>(camera, surface, sampling, pixels, begin, end);"
)
def intersect_known_faces_run(
    camera: Camera, surface: SurfaceArrays, sampling: Sampling, pixels: Pixels, begin: wp.int32, end: wp.int32
):
    """Intersect the rays from ``begin`` to ``end`` with their nearest faces."""


@wp.kernel
def intersect_known_faces(
    camera: Camera, surface: SurfaceArrays, sampling: Sampling, pixels: Pixels, first: wp.int32, run: wp.int32,
):  # fmt: skip
    """Compute the hits of rays on their nearest faces, which ``rasterize`` or ``trace_bvh`` has found.

    Args:
        camera: Camera in the units of the mesh.
        surface: Mesh with its base colours.
        sampling: Positions of the rays in their pixels.
        pixels: Arrays of hits. ``nearest`` is read; face, position on the face, direction to the viewer and base colour
            are written. Base colours are negative where a texture has the colour.
        first: Index of the first thread's first ray.
        run: Number of rays per thread.
    """
    begin = first + wp.tid() * run
    intersect_known_faces_run(camera, surface, sampling, pixels, begin, begin + run)
    if pixels.base_colour.shape[0] > 0:
        for ray in range(begin, begin + run):
            if pixels.hit[ray] != 0:
                paint(surface, pixels, ray)


@wp.kernel
def place_samples(
    sample: wp.int32, seed: wp.int32, first: wp.int32, run: wp.int32,
    offsets_out: wp.array(dtype=wp.vec2d),
):  # fmt: skip
    """Compute the position of one of several rays within each pixel, by ``pixel_offset``."""
    for pixel in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        offsets_out[pixel] = pixel_offset(sample, seed, pixel)


@wp.kernel
def make_shading_frames(
    surface: SurfaceArrays, pixels: Pixels, first: wp.int32, run: wp.int32,
):  # fmt: skip
    """Compute the shading frames at hits, and the origins of shadow rays.

    If the camera sees the back of a face, the normal n is reversed, and the tangent t does not change. The bitangent is
    b = (n × t) · handedness with the reversed normal; ``handedness`` is −1 where the texture coordinates are mirrored.
    The x direction of the height field, t, is therefore the same vector on the front and on the back.

    Args:
        surface: Mesh with vertex normals and tangents.
        pixels: Arrays of hits: hits are read, frames and origins are written.
        first: Index of the first thread's first ray.
        run: Number of rays per thread.
    """
    begin = first + wp.tid() * run
    if shading_frames_run(surface, pixels, begin, begin + run) == 0:
        return
    for ray in range(begin, begin + run):
        if pixels.hit[ray] == SPECIAL:
            pixels.hit[ray] = 1
            i0 = surface.faces[pixels.face[ray], 0]
            i1 = surface.faces[pixels.face[ray], 1]
            i2 = surface.faces[pixels.face[ray], 2]
            p0 = surface.positions[i0]
            geometric = wp.normalize(wp.cross(surface.positions[i1] - p0, surface.positions[i2] - p0))
            to_view = pixels.to_view[ray]
            if wp.dot(geometric, to_view) < 0.0:
                geometric = -geometric
            normal = face_the_viewer(pixels.normal[ray], geometric, to_view)
            place = pixels.place[ray]
            share = wp.max(wp.float32(0.0), 1.0 - place[0] - place[1])
            tangent = place[0] * surface.tangents[i0] + place[1] * surface.tangents[i1] + share * surface.tangents[i2]
            tangent = tangent - wp.dot(tangent, normal) * normal
            if wp.length_sq(tangent) > LEAST_TANGENT:
                # The component of the tangent perpendicular to the normal is computed twice. The second projection
                # removes the rounding errors of the first one, as in ``face_the_viewer``.
                tangent = wp.normalize(tangent - wp.dot(tangent, normal) * normal)
            else:
                tangent = perpendicular(normal)
            pixels.normal[ray] = normal
            pixels.tangent[ray] = tangent
            pixels.bitangent[ray] = surface.handedness[i0] * wp.cross(normal, tangent)
