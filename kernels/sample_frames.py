"""Sample frames: shading frames at the hits of rays, and at random points of their pixel filters.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer. θ is the angle of ωr from the normal.
"""

import math

import warp as wp

from warpdiff.kernels.shading_frames import LEAST_COSINE
from warpdiff.kernels.structs import Footprint, Pixels


@wp.struct
class Frame:
    """Shading frame at the hit of a ray (tangent, bitangent, normal), and the direction to the viewer in this frame."""

    tangent: wp.vec3f
    bitangent: wp.vec3f
    normal: wp.vec3f
    view: wp.vec3f


@wp.func
def frame_at(pixels: Pixels, ray: wp.int32) -> Frame:
    """Return the shading frame at the hit of a ray."""
    result = Frame()
    result.tangent = pixels.tangent[ray]
    result.bitangent = pixels.bitangent[ray]
    result.normal = pixels.normal[ray]
    result.view = wp.normalize(in_frame(result, pixels.to_view[ray]))
    return result


@wp.func
def filtered_frame(pixels: Pixels, ray: wp.int32, footprint: Footprint, random: wp.vec2f) -> Frame:
    """Return the shading frame at a random point of a ray's pixel filter.

    The normal is rotated until (u, v) has changed as much as between the centre of the footprint and this point. If the
    normal rotates by an angle, (u, v) of light from the mirror direction changes by 2 cos θ times the angle.

    Args:
        pixels: Hits of the rays.
        ray: Index of the ray.
        footprint: Footprint of the ray's filter for light from the mirror direction.
        random: Two random numbers in [0, 1), from which the method of Box and Muller makes the point.
    """
    size = wp.sqrt(-2.0 * wp.log(1.0 - random[0]))
    angle = wp.static(2.0 * math.pi) * random[1]
    right = size * wp.cos(angle)
    down = size * wp.sin(angle)
    tangent = pixels.tangent[ray]
    bitangent = pixels.bitangent[ray]
    view = pixels.to_view[ray]
    per_move = 0.5 / wp.max(wp.dot(pixels.normal[ray], view), LEAST_COSINE)
    normal = pixels.normal[ray] + per_move * (right * footprint[0] + down * footprint[2]) * tangent
    normal += per_move * (right * footprint[1] + down * footprint[3]) * bitangent
    result = Frame()
    result.normal = wp.normalize(normal)
    result.tangent = wp.normalize(tangent - wp.dot(tangent, result.normal) * result.normal)
    result.bitangent = wp.cross(result.normal, result.tangent)
    if wp.dot(result.bitangent, bitangent) < 0.0:
        result.bitangent = -result.bitangent
    local = in_frame(result, view)
    local[2] = wp.max(local[2], LEAST_COSINE)
    result.view = wp.normalize(local)
    return result


@wp.func
def in_frame(frame: Frame, along: wp.vec3f) -> wp.vec3f:
    """Convert a direction from the world frame to a shading frame."""
    return wp.vec3f(wp.dot(frame.tangent, along), wp.dot(frame.bitangent, along), wp.dot(frame.normal, along))


@wp.func
def in_world(frame: Frame, direction: wp.vec3f) -> wp.vec3f:
    """Convert a direction from a shading frame to the world frame."""
    return wp.normalize(direction[0] * frame.tangent + direction[1] * frame.bitangent + direction[2] * frame.normal)
