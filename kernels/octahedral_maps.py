"""Octahedral maps: radiances of a sky by direction, at increasing blur."""

import warp as wp


@wp.struct
class SkyMap:
    """Light from all directions, on octahedral maps that are blurred more and more, with a texel more on each side."""

    texels: wp.array(dtype=wp.vec4f)  # by spectrum, and the deviation of their sum; level after level, row after row
    firsts: wp.array(dtype=wp.int32)  # where each level begins
    sides: wp.array(dtype=wp.int32)  # texels along a side of each level, without those beyond it
    variance: wp.float32  # that the first level is blurred by [rad²]; the next ones by four times as much each
    turn: wp.vec2f  # cosine and sine of the angle that the sky is turned by about +y
    whites: wp.mat33f  # of what the pigment sends back under each spectrum, linear RGB in rows


@wp.func
def on_octahedron(along: wp.vec3f) -> wp.vec2f:
    """Where a direction lies on the map, from 0 to 1 both ways; +y is in the middle."""
    per_size = 1.0 / (wp.abs(along[0]) + wp.abs(along[1]) + wp.abs(along[2]))
    x = along[0] * per_size
    z = along[2] * per_size
    if along[1] < 0.0:
        folded = (1.0 - wp.abs(z)) * wp.sign(x)
        z = (1.0 - wp.abs(x)) * wp.sign(z)
        x = folded
    return wp.vec2f(0.5 * x + 0.5, 0.5 * z + 0.5)


@wp.func
def direction_at(x: wp.float32, z: wp.float32) -> wp.vec3f:
    """The unit vector that lies there."""
    p = 2.0 * x - 1.0
    q = 2.0 * z - 1.0
    up = 1.0 - wp.abs(p) - wp.abs(q)
    if up < 0.0:
        folded = (1.0 - wp.abs(q)) * wp.sign(p)
        q = (1.0 - wp.abs(p)) * wp.sign(q)
        p = folded
    return wp.normalize(wp.vec3f(p, up, q))


@wp.func
def on_level(sky: SkyMap, level: wp.int32, place: wp.vec2f) -> wp.vec4f:
    """Radiance on one level, linear between texels."""
    side = sky.sides[level]
    x = place[0] * wp.float32(side) + 0.5
    z = place[1] * wp.float32(side) + 0.5
    column = wp.clamp(wp.int32(x), 0, side)
    row = wp.clamp(wp.int32(z), 0, side)
    s = x - wp.float32(column)
    t = z - wp.float32(row)
    at = sky.firsts[level] + row * (side + 2) + column
    below = at + side + 2
    upper = (1.0 - s) * sky.texels[at] + s * sky.texels[at + 1]
    return (1.0 - t) * upper + t * ((1.0 - s) * sky.texels[below] + s * sky.texels[below + 1])


@wp.func
def light_along(sky: SkyMap, along: wp.vec3f, variance: wp.float32) -> wp.vec4f:
    """What comes from there, blurred by a variance."""
    in_sky = wp.vec3f(
        sky.turn[0] * along[0] - sky.turn[1] * along[2], along[1], sky.turn[1] * along[0] + sky.turn[0] * along[2]
    )
    place = on_octahedron(in_sky)
    last = sky.sides.shape[0] - 1
    level = wp.clamp(0.5 * wp.log2(wp.max(variance, 1.0e-12) / sky.variance), 0.0, wp.float32(last))
    first = wp.min(wp.int32(level), last - 1)
    t = level - wp.float32(first)
    return (1.0 - t) * on_level(sky, first, place) + t * on_level(sky, first + 1, place)
