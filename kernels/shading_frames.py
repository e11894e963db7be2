"""Shading frames at hits, and the origins of shadow rays."""

import warp as wp

from warpdiff.kernels.structs import SPECIAL, Pixels, SurfaceArrays

# Height of a shadow ray's origin above the surface [radii of the mesh]. Derived: about a hundred times the rounding of
# a position. Occluders closer than the height cast no shadow.
LIFT = wp.constant(wp.float32(1.0e-5))
# Least cosine between the shading normal and the view; normals that face away are turned to it.
LEAST_COSINE = wp.constant(wp.float32(0.01))
# The least square of a tangent's part at right angles to the normal.
LEAST_TANGENT = wp.constant(wp.float32(1.0e-10))


@wp.func
def perpendicular(v: wp.vec3f) -> wp.vec3f:
    """A unit vector at right angles to the unit vector ``v``: the axis that is furthest from it, projected."""
    axis = wp.vec3f(1.0, 0.0, 0.0)
    size = wp.abs(v[0])
    if wp.abs(v[1]) < size:
        axis = wp.vec3f(0.0, 1.0, 0.0)
        size = wp.abs(v[1])
    if wp.abs(v[2]) < size:
        axis = wp.vec3f(0.0, 0.0, 1.0)
    return wp.normalize(axis - wp.dot(axis, v) * v)


@wp.func
def face_the_viewer(normal: wp.vec3f, geometric: wp.vec3f, to_view: wp.vec3f) -> wp.vec3f:
    """Tilt a unit normal towards the viewer until their cosine is at least ``LEAST_COSINE``.

    A normal that points straight away from the viewer leaves open which way to turn; then the geometric one says it.
    """
    result = normal
    if wp.dot(normal, to_view) < LEAST_COSINE:
        aside = normal - wp.dot(normal, to_view) * to_view
        if wp.length_sq(aside) < 1.0e-12:
            aside = geometric - wp.dot(geometric, to_view) * to_view
        if wp.length_sq(aside) < 1.0e-12:
            aside = perpendicular(to_view)
        # The vector is projected twice: the short remainder of two nearly parallel vectors carries their rounding.
        aside = wp.normalize(aside)
        aside = wp.normalize(aside - wp.dot(aside, to_view) * to_view)
        result = LEAST_COSINE * to_view + wp.sqrt(1.0 - LEAST_COSINE * LEAST_COSINE) * aside
    return result


@wp.func_native(
    f"return warpdiff::make_shading_frames<32, {int(SPECIAL)}>(surface, pixels, begin, end, "
    f"{{{float(LEAST_COSINE)}f, {float(LEAST_TANGENT)}f, {float(LIFT)}f}});"
)
def shading_frames_run(surface: SurfaceArrays, pixels: Pixels, begin: wp.int32, end: wp.int32) -> wp.int32:
    """Shading frames of pixels one after the other, and where their shadow rays start; returns how many are left."""
