"""Shading frames (normal, tangent, bitangent) at the hits of camera rays, and the origins of shadow rays."""

import warp as wp

from warpdiff.kernels.structs import SPECIAL, Pixels, SurfaceArrays

# Height of a shadow ray's origin above the surface [radii of the mesh]. The value was derived as about a hundred times
# the rounding error of positions. Occluders closer than this height cast no shadow.
LIFT = wp.constant(wp.float32(1.0e-5))
# Least cosine of the angle between the shading normal and the direction to the viewer. Normals with a smaller cosine
# are tilted towards the viewer.
LEAST_COSINE = wp.constant(wp.float32(0.01))
# If the squared length of a tangent's component perpendicular to the normal is smaller than this, an arbitrary
# perpendicular direction replaces the tangent.
LEAST_TANGENT = wp.constant(wp.float32(1.0e-10))


@wp.func
def perpendicular(v: wp.vec3f) -> wp.vec3f:
    """Return a unit vector perpendicular to ``v``, from the coordinate axis that is least parallel to ``v``."""
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
    """Return a unit normal tilted towards the viewer until the cosine of the angle between both is ``LEAST_COSINE``.

    A normal with a larger cosine is not tilted. If the normal points exactly away from the viewer, the geometric normal
    determines the direction of the tilt.
    """
    result = normal
    if wp.dot(normal, to_view) < LEAST_COSINE:
        aside = normal - wp.dot(normal, to_view) * to_view
        if wp.length_sq(aside) < 1.0e-12:
            aside = geometric - wp.dot(geometric, to_view) * to_view
        if wp.length_sq(aside) < 1.0e-12:
            aside = perpendicular(to_view)
        # If two vectors are nearly parallel, the component of one perpendicular to the other is short, and has a large
        # relative rounding error. A second projection of this component removes its error along the other vector.
        aside = wp.normalize(aside)
        aside = wp.normalize(aside - wp.dot(aside, to_view) * to_view)
        result = LEAST_COSINE * to_view + wp.sqrt(1.0 - LEAST_COSINE * LEAST_COSINE) * aside
    return result


@wp.func_native(
    f"return warpdiff::make_shading_frames<32, {int(SPECIAL)}>(surface, pixels, begin, end, "
    f"{{{float(LEAST_COSINE)}f, {float(LEAST_TANGENT)}f, {float(LIFT)}f}});"
)
def shading_frames_run(surface: SurfaceArrays, pixels: Pixels, begin: wp.int32, end: wp.int32) -> wp.int32:
    """Compute the shading frames and the origins of shadow rays of consecutive pixels.

    Return the number of pixels that are computed later by ``face_the_viewer``, because their normals must be tilted or
    their tangents replaced.
    """
