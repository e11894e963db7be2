"""Camera rays that find faces through a hierarchy of bounding boxes, on GPUs and for recorded CUDA graphs."""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.primary_hits import UNSEEN
from warpdiff.kernels.structs import Camera, Sampling, SurfaceArrays

# Warp's intersection of rays and boxes divides by 0 and computes with infinities. The compiler flags of this project
# allow this: they keep infinities correct.
wp.set_module_options(compile_options.options())

# Length up to which a camera ray is followed from its start [radii of the mesh]. A ray starts at most 2 radii before
# the point where it is nearest to the mesh's centre. It leaves the sphere around the mesh at most 1 radius after that
# point. The value must therefore exceed 3; a larger value changes nothing.
FAR = wp.constant(wp.float32(4.0))


@wp.func
def position_of(camera: Camera, sampling: Sampling, ray: wp.int32) -> wp.vec2d:
    """Return the position of a ray in the picture: right and down from its upper left corner [pixels].

    Both numbers are negative if the ray belongs to no pixel.
    """
    pixel = ray
    offset = wp.vec2d()
    if sampling.offsets.shape[0] > 0:
        offset = sampling.offsets[pixel]
    rays = sampling.places.shape[0]
    if sampling.tiles.shape[0] > 0:
        pixel = sampling.tiles[ray // rays]
        if pixel < 0:
            return wp.vec2d(wp.float64(-10.0), wp.float64(-10.0))
        offset = sampling.places[ray % rays]
    column = wp.float64(pixel % camera.width) + wp.float64(0.5) + offset[0]
    row = wp.float64(pixel // camera.width) + wp.float64(0.5) + offset[1]
    return wp.vec2d(column, row)


@wp.func
def camera_ray(camera: Camera, position: wp.vec2d) -> tuple[wp.vec3f, wp.vec3f]:
    """Return the start and the direction of the ray through a position in the picture.

    The start is close to the mesh. The direction is zero if the ray misses the sphere around the mesh.
    """
    # The start of the ray is moved close to the mesh in float64, because the eye may be thousands of radii away from
    # the mesh.
    two = wp.float64(2.0)
    x = camera.axes[4][0] * (two * position[0] / wp.float64(camera.width) - wp.float64(1.0))
    y = camera.axes[4][1] * (wp.float64(1.0) - two * position[1] / wp.float64(camera.height))
    across = x * camera.axes[1] + y * camera.axes[2]
    origin = camera.axes[0]
    along = across - camera.axes[3]
    if camera.orthographic:
        origin = camera.axes[0] + across
        along = -camera.axes[3]
    along = wp.normalize(along)
    # The mesh is within the unit sphere. Rays that miss this sphere end here. Most rays that miss the mesh also miss
    # the sphere.
    ahead = -wp.dot(origin, along)
    closest = origin + ahead * along
    direction = wp.vec3f()
    if wp.dot(closest, closest) <= wp.float64(1.0 + 1.0e-5):
        direction = wp.vec3f(along)
    return wp.vec3f(origin + wp.max(ahead - two, wp.float64(0.0)) * along), direction


@wp.func
def trace(camera: Camera, surface: SurfaceArrays, sampling: Sampling, ray: wp.int32) -> wp.uint64:
    """Return the index of the first face that a ray hits, or ``UNSEEN`` if it hits none."""
    position = position_of(camera, sampling, ray)
    if position[0] < wp.float64(-5.0):
        return UNSEEN
    start, along = camera_ray(camera, position)
    if wp.length_sq(along) == 0.0:
        return UNSEEN
    query = wp.mesh_query_ray(surface.mesh_id, start, along, FAR)
    face = UNSEEN
    if query.result:
        face = wp.uint64(query.face)
    return face


@wp.kernel
def trace_bvh(
    camera: Camera, surface: SurfaceArrays, sampling: Sampling, first: wp.int32, run: wp.int32,
    nearest_out: wp.array(dtype=wp.uint64),
):  # fmt: skip
    """Find the first face that each ray hits, by a hierarchy of bounding boxes around the faces.

    Args:
        camera: Camera in the units of the mesh.
        surface: Mesh with its hierarchy of bounding boxes.
        sampling: Positions of the rays in their pixels.
        first: Index of the first ray of the first thread.
        run: Number of rays per thread.
        nearest_out: Index of the face that each ray hits, in the lower 32 bits; ``UNSEEN`` if the ray hits no face.
    """
    for ray in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        nearest_out[ray] = trace(camera, surface, sampling, ray)
