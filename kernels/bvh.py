"""Rays through a hierarchy of faces' boxes: on a GPU all of them, on the CPU some shadow rays."""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.ray_hits import paint, pixel_offset
from warpdiff.kernels.structs import Camera, Pixels, Sampling, SurfaceArrays

# Infinities stay defined, by which the hierarchy decides whether a ray hits.
wp.set_module_options(compile_options.options())

# Beyond any distance between two points of the unit sphere.
FAR = wp.constant(wp.float32(4.0))


@wp.func
def occluded(mesh_id: wp.uint64, origin: wp.vec3f, direction: wp.vec3f, far: wp.float32) -> wp.bool:
    """Whether the mesh is met on the way from ``origin`` along the unit vector ``direction``; ``FAR`` is infinity."""
    return wp.mesh_query_ray_anyhit(mesh_id, origin, direction, far)


@wp.func
def trace(camera: Camera, surface: SurfaceArrays, sampling: Sampling, pixels: Pixels, ray: wp.int32):
    """Send a ray through the hierarchy."""
    pixels.hit[ray] = 0
    pixels.face[ray] = -1
    pixel = ray
    offset = pixel_offset(sampling.sample, sampling.samples, sampling.seed, pixel)
    rays = sampling.places.shape[0]
    if sampling.tiles.shape[0] > 0:
        pixel = sampling.tiles[ray // rays]
        if pixel < 0:
            return
        offset = sampling.places[ray % rays]

    # In float64 up to where it comes near the mesh: the eye may be thousands of radii away.
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    half = wp.float64(0.5)
    column = wp.float64(pixel % camera.width) + half + offset[0]
    row = wp.float64(pixel // camera.width) + half + offset[1]
    x = camera.axes[4][0] * (two * column / wp.float64(camera.width) - one)
    y = camera.axes[4][1] * (one - two * row / wp.float64(camera.height))
    across = x * camera.axes[1] + y * camera.axes[2]
    origin = camera.axes[0]
    along = across - camera.axes[3]
    if camera.orthographic:
        origin = camera.axes[0] + across
        along = -camera.axes[3]
    along = wp.normalize(along)
    direction = wp.vec3f(along)
    # The mesh lies in the unit sphere: most rays beside it end here.
    ahead = -wp.dot(origin, along)
    closest = origin + ahead * along
    if wp.dot(closest, closest) > wp.float64(1.0 + 1.0e-5):
        return
    near = wp.max(ahead - two, wp.float64(0.0))
    start = wp.vec3f(origin + near * along)
    query = wp.mesh_query_ray(surface.mesh_id, start, direction, FAR)
    if not query.result:
        return
    # Warp's barycentric coordinates: u belongs to the first vertex, v to the second.
    b0 = query.u
    b1 = query.v
    # The place is found again in float64: on a thin body in a large scene, that of a float32 ray turns the normal by
    # 1e-5, which a window of many wavelengths sees in what lies between its orders.
    p0 = wp.vec3d(surface.positions[surface.faces[query.face, 0]])
    edge1 = wp.vec3d(surface.positions[surface.faces[query.face, 1]]) - p0
    edge2 = wp.vec3d(surface.positions[surface.faces[query.face, 2]]) - p0
    across_edge2 = wp.cross(along, edge2)
    determinant = wp.dot(edge1, across_edge2)
    if determinant != wp.float64(0.0):
        from_corner = origin - p0
        share1 = wp.clamp(wp.dot(from_corner, across_edge2) / determinant, wp.float64(0.0), one)
        share2 = wp.dot(along, wp.cross(from_corner, edge1)) / determinant
        share2 = wp.clamp(share2, wp.float64(0.0), one - share1)
        b0 = wp.float32(one - share1 - share2)
        b1 = wp.float32(share1)
    pixels.hit[ray] = 1
    pixels.face[ray] = query.face
    pixels.place[ray] = wp.vec2f(b0, b1)
    pixels.to_view[ray] = -direction


@wp.kernel
def trace_bvh(
    # In:
    camera: Camera,
    surface: SurfaceArrays,
    sampling: Sampling,
    pixels: Pixels,
    first: wp.int32,
    run: wp.int32,
):
    """Trace a ray through the pixel ``first`` + thread, counted along rows from the top left, or through one of a tile.

    Args:
        camera: The view.
        surface: The mesh.
        sampling: Where in the pixel.
        pixels: What is found.
        first: The first thread's pixel, or ray of a tile.
        run: How many a thread takes.
    """
    for ray in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        trace(camera, surface, sampling, pixels, ray)
        if pixels.base_colour.shape[0] > 0 and pixels.hit[ray] != 0:
            paint(surface, pixels, ray)
