"""Rays that pass through transparent points of faces: cut-outs, and faces that are blended with their background.

A ray passes a face at points whose alpha is below a threshold. For a cut-out, the threshold is the cut-off of its
material. For a blended face, the threshold differs from ray to ray. The fraction of rays that hit the face is then
equal to alpha (stochastic transparency, Enderton et al. 2011). The kernels are launched only for scenes with such
faces.
"""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.bvh import FAR, camera_ray, position_of
from warpdiff.kernels.primary_hits import UNSEEN, scramble, to_unit
from warpdiff.kernels.shadow_rays import FACING_AWAY
from warpdiff.kernels.structs import Camera, Pixels, Sampling, SurfaceArrays, Textures, Transparency

wp.set_module_options(compile_options.options("transparency.h"))

# Largest number of transparent faces that a ray passes; the next face counts as opaque. The value is limited by time,
# which is proportional to the number of faces.
MOST_LAYERS = wp.constant(64)
# Distance by which a ray continues behind a face before it is traced further [radii of the mesh]. It equals the
# distance from a surface at which shadow rays start. Faces that are closer together count as one face.
GAP = wp.constant(wp.float32(1.0e-5))
# Increments of the R3 sequence (Roberts 2018), one for each of the first three blended faces along a ray. With them,
# the thresholds of different faces are independent of each other, and are evenly distributed over the cells of a pixel.
R3 = wp.constant(wp.vec3f(0.8191725134, 0.6710436067, 0.5497004779))


@wp.func_native("return warpdiff::alpha_at(surface, textures, transparency, face, share0, share1);")
def alpha_at(
    surface: SurfaceArrays, textures: Textures, transparency: Transparency, face: wp.int32, share0: wp.float32,
    share1: wp.float32,
) -> wp.float32:  # fmt: skip
    """Return the alpha (opacity) at a point of a face."""


@wp.func
def cutoff_of(textures: Textures, transparency: Transparency, face: wp.int32) -> wp.float32:
    """Return the alpha below which rays pass a face (cut-off): 0 for opaque, negative for blended materials."""
    row = textures.rows[face]
    result = wp.float32(0.0)
    if row >= 0:
        result = transparency.cutoffs[row]
    return result


@wp.func
def threshold_of(seed: wp.uint32, index: wp.int32, layer: wp.int32) -> wp.float32:
    """Return the threshold of a blended face for one ray, 0 to 1: the ray passes the face where alpha is smaller.

    Args:
        seed: Hash of a pixel.
        index: Index of the ray in its pixel.
        layer: Number of blended faces that the ray has passed.
    """
    shift = wp.float32(to_unit(scramble(seed + wp.uint32(layer))))
    if layer > 2:
        return wp.float32(to_unit(scramble(scramble(seed + wp.uint32(layer)) + wp.uint32(index))))
    value = shift + R3[layer] * wp.float32(index)
    return value - wp.floor(value)


@wp.func
def first_opaque(
    surface: SurfaceArrays, textures: Textures, transparency: Transparency, mesh_id: wp.uint64, start: wp.vec3f,
    along: wp.vec3f, far: wp.float32, seed: wp.uint32, index: wp.int32,
) -> wp.int32:  # fmt: skip
    """Return the first face that a ray hits and does not pass within the distance ``far``; −1 if there is none."""
    travelled = wp.float32(0.0)
    layer = wp.int32(0)
    for step in range(MOST_LAYERS + 1):
        query = wp.mesh_query_ray(mesh_id, start + travelled * along, along, far - travelled)
        if not query.result:
            return -1
        threshold = cutoff_of(textures, transparency, query.face)
        if threshold < 0.0:
            threshold = threshold_of(seed, index, layer)
            layer += 1
        is_opaque = threshold == 0.0 or step == MOST_LAYERS
        if is_opaque or alpha_at(surface, textures, transparency, query.face, query.u, query.v) >= threshold:
            return query.face
        travelled += query.t + GAP
        if travelled >= far:
            return -1
    return -1


@wp.func
def is_occluded(
    surface: SurfaceArrays, textures: Textures, transparency: Transparency, mesh_id: wp.uint64, origin: wp.vec3f,
    along: wp.vec3f, far: wp.float32,
) -> wp.bool:  # fmt: skip
    """Return whether a shadow ray hits a face that it does not pass, so that the light is occluded."""
    result = wp.mesh_query_ray_anyhit(mesh_id, origin, along, far)
    if result and transparency.cutoffs.shape[0] > 0:
        # The thresholds are computed from the origin of the ray, so that pictures do not depend on the order of rays.
        seed = scramble(wp.cast(origin[0], wp.uint32))
        seed = scramble(seed ^ wp.cast(origin[1], wp.uint32))
        seed = scramble(seed ^ wp.cast(origin[2], wp.uint32))
        result = first_opaque(surface, textures, transparency, mesh_id, origin, along, far, seed, 0) >= 0
    return result


@wp.kernel
def pass_transparent(
    camera: Camera, surface: SurfaceArrays, textures: Textures, transparency: Transparency, sampling: Sampling,
    first: wp.int32, run: wp.int32,
    nearest_out: wp.array(dtype=wp.uint64),
):  # fmt: skip
    """Replace the nearest face of each ray by the first face that the ray does not pass, if the nearest is transparent.

    Args:
        camera: Camera in the units of the mesh.
        surface: Mesh with its hierarchy.
        textures: Textures of the materials, and the material of each face.
        transparency: Cut-offs of the materials.
        sampling: Positions of the rays in their pixels.
        first: Index of the first thread's first ray.
        run: Number of rays per thread.
        nearest_out: Index of each ray's nearest face, in the lower 32 bits; ``UNSEEN`` without a face.
    """
    for ray in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        nearest = nearest_out[ray]
        if nearest != UNSEEN:
            face = wp.int32(wp.uint32(nearest & wp.uint64(0xFFFFFFFF)))
            if cutoff_of(textures, transparency, face) != 0.0:
                place = position_of(camera, sampling, ray)
                start, along = camera_ray(camera, place)
                pixel = ray
                index = wp.int32(0)
                if sampling.tiles.shape[0] > 0:
                    pixel = sampling.tiles[ray // sampling.places.shape[0]]
                    index = ray % sampling.places.shape[0]
                hit = first_opaque(
                    surface, textures, transparency, surface.mesh_id, start, along, FAR, scramble(wp.uint32(pixel)),
                    index,
                )  # fmt: skip
                nearest = UNSEEN
                if hit >= 0:
                    nearest = wp.uint64(hit)
                nearest_out[ray] = nearest


@wp.kernel
def trace_shadow_rays_through(
    surface: SurfaceArrays, textures: Textures, transparency: Transparency, places: wp.array(dtype=wp.vec4d),
    light_index: wp.int32, directions: wp.array(dtype=wp.vec4f), pixels: Pixels, first: wp.int32, run: wp.int32,
    occluded_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Trace shadow rays through transparent faces, as :func:`~warpdiff.kernels.shadow_rays.trace_shadow_rays`."""
    place = places[light_index]
    towards = wp.vec3f(wp.float32(place[0]), wp.float32(place[1]), wp.float32(place[2]))
    thread, _ = wp.tid()
    for ray in range(first + thread * run, first + (thread + 1) * run):
        blocked = bool(False)
        origin = pixels.shadow_origin[ray]
        along = towards
        far = FAR
        if directions.shape[0] > 0:
            along = wp.vec3f(directions[ray][0], directions[ray][1], directions[ray][2])
        if place[3] != wp.float64(0.0):
            along = towards - origin
            far = wp.min(FAR, wp.length(along))
            along = wp.normalize(along)
        if pixels.hit[ray] != 0 and wp.dot(pixels.normal[ray], along) > FACING_AWAY:
            blocked = is_occluded(surface, textures, transparency, surface.mesh_id, origin, along, far)
        occluded_out[ray] = blocked
