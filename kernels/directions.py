"""From pixels and a light to what the spectral kernels take: (u, v, w), gain and footprint.

And back from the colours of rays to those of pixels.
"""

import warp as wp

from warpdiff.kernels import spectral
from warpdiff.kernels.optics import Light, gain, schlick
from warpdiff.kernels.raycast import Pixels

wp.set_module_options(spectral.OPTIONS)


@wp.struct
class Reflection:
    """What the reflectance needs besides the directions."""

    normal_reflectance: wp.float64
    masking: wp.bool
    per_light_cosine: wp.bool  # for a light of a size


@wp.func
def reflected(to_light: wp.vec3d, to_view: wp.vec3d, reflection: Reflection) -> wp.float64:
    """The gain of one pair of directions."""
    result = gain(to_light, to_view, reflection.normal_reflectance, reflection.masking)
    if reflection.per_light_cosine and result > wp.float64(0.0):
        result = result / to_light[2]
    return result


@wp.kernel
def deflect_pixels(
    # In:
    pixels: Pixels,
    lights: wp.array(dtype=Light),
    which: wp.int32,
    reflection: Reflection,
    weight: wp.float64,
    counted: wp.float64,
    begins: wp.bool,
    hidden: wp.array(dtype=wp.bool),
    first: wp.int32,
    run: wp.int32,
    # Out:
    deflections_out: wp.array(dtype=wp.vec3d),
    to_lights_out: wp.array(dtype=wp.vec3f),
    gains_out: wp.array(dtype=wp.float32),
    xyz_out: wp.array(dtype=wp.vec3f),
    coverage_out: wp.array(dtype=wp.float64),
    lit_out: wp.array(dtype=wp.bool),
):
    """Deflection, direction to the light and gain of pixels under one of the lights.

    All that meet the mesh have a deflection, and where the light does not come their gain is 0. Its pigment is added to
    ``xyz_out``, ``counted`` to the coverage of those that meet the mesh, and those that it reaches are marked as lit,
    from nothing if the sum ``begins``; empty arrays are none of these. ``hidden`` says which pixels the light does not
    reach; empty is none.
    """
    light = lights[which]
    sums = xyz_out.shape[0] > 0
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        deflections_out[i] = wp.vec3d()
        to_lights_out[i] = wp.vec3f()
        gains_out[i] = wp.float32(0.0)
        if sums and begins:
            xyz_out[i] = wp.vec3f()
            coverage_out[i] = wp.float64(0.0)
            lit_out[i] = False
        if pixels.hit[i] == 0:
            continue
        if sums:
            coverage_out[i] += counted
        zero = wp.float64(0.0)
        one = wp.float64(1.0)
        t = wp.vec3d(pixels.tangent[i])
        b = wp.vec3d(pixels.bitangent[i])
        n = wp.vec3d(pixels.normal[i])
        away = wp.vec3d(pixels.to_view[i])
        # The frame comes from float32: unit lengths are restored, so that the mirror direction is met exactly.
        to_light = wp.normalize(
            wp.vec3d(wp.dot(light.to_light, t), wp.dot(light.to_light, b), wp.dot(light.to_light, n))
        )
        to_view = wp.normalize(wp.vec3d(wp.dot(away, t), wp.dot(away, b), wp.dot(away, n)))
        # Whether it is lit or not: those beside it ask how (u, v) changes.
        deflections_out[i] = -to_light - to_view
        if to_light[2] <= zero or to_view[2] <= zero:
            continue
        if hidden.shape[0] > 0 and hidden[i]:
            continue
        scale = weight * light.power
        normal = reflection.normal_reflectance
        to_lights_out[i] = wp.vec3f(to_light)
        gains_out[i] = wp.float32(scale * reflected(to_light, to_view, reflection))
        if sums and gains_out[i] > 0.0:
            lit_out[i] = True
        if sums and light.pigment > zero:
            under = (one - schlick(to_light[2], normal)) * (one - schlick(to_view[2], normal)) * to_light[2]
            base = wp.vec3d(pixels.base_colour[i])
            colour = light.rgb_to_xyz * wp.cw_mul(base, light.white_rgb)
            xyz_out[i] = xyz_out[i] + wp.vec3f(scale * light.pigment * under * colour)


@wp.kernel
def sum_up(
    # In:
    deflections: wp.array(dtype=wp.vec3d),
    to_lights: wp.array(dtype=wp.vec3f),
    gains: wp.array(dtype=wp.float32),
    per_uv: wp.vec2d,
    is_source: wp.bool,
    size: wp.int32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    counts_out: wp.array(dtype=wp.int32),
    ranges_out: wp.array(dtype=wp.vec4d),
):
    """How many of each ``size`` deflections are lit; their largest |(u, v)|² and lateral², least and largest |w|.

    Lateral is as ``warpdiff.scope.lateral`` has it, ``per_uv`` the lengths that u and v are multiplied by.
    """
    for block in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        count = wp.int32(0)
        uv = wp.float64(0.0)
        rate = wp.float64(0.0)
        least = wp.float64(2.0)
        most = wp.float64(0.0)
        for i in range(block * size, wp.min((block + 1) * size, gains.shape[0])):
            if gains[i] > 0.0:
                count += 1
                d = deflections[i]
                square = d[0] * d[0] + d[1] * d[1]
                uv = wp.max(uv, square)
                least = wp.min(least, -d[2])
                most = wp.max(most, -d[2])
                if is_source:
                    light = wp.vec3d(to_lights[i])
                    along = (d[0] * light[0] + d[1] * light[1]) / wp.max(light[2], wp.float64(1.0e-6))
                    square += along * along
                else:
                    square = d[0] * d[0] * per_uv[0] * per_uv[0] + d[1] * d[1] * per_uv[1] * per_uv[1]
                rate = wp.max(rate, square)
        counts_out[block] = count
        ranges_out[block] = wp.vec4d(uv, rate, least, most)


@wp.kernel
def pick(
    # In:
    deflections: wp.array(dtype=wp.vec3d),
    to_lights: wp.array(dtype=wp.vec3f),
    gains: wp.array(dtype=wp.float32),
    blocks: wp.array(dtype=wp.int32),
    ranks: wp.array(dtype=wp.int32),
    size: wp.int32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    deflections_out: wp.array(dtype=wp.vec3d),
    to_lights_out: wp.array(dtype=wp.vec3f),
    gains_out: wp.array(dtype=wp.float32),
):
    """The lit deflections of some ranks, from 0 on, within blocks of ``size``."""
    for k in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        left = ranks[k]
        i = blocks[k] * size - 1
        while left >= 0:
            i += 1
            if gains[i] > 0.0:
                left -= 1
        deflections_out[k] = deflections[i]
        to_lights_out[k] = to_lights[i]
        gains_out[k] = gains[i]


@wp.func
def slope(
    deflections: wp.array(dtype=wp.vec3d),
    hit: wp.array(dtype=wp.int32),
    before: wp.int32,
    here: wp.int32,
    after: wp.int32,
) -> wp.vec2f:
    """Change of (u, v) from one pixel to the next, from both neighbours, of which an index < 0 is none.

    Where the two disagree, an edge of the body or of a texture's chart lies between: the smaller change is the surface.
    """
    result = wp.vec2f()
    if after >= 0 and hit[after] != 0:
        result = between(deflections[here], deflections[after])
    if before >= 0 and hit[before] != 0:
        other = between(deflections[before], deflections[here])
        if after >= 0 and hit[after] != 0:
            if wp.length(result - other) < wp.min(wp.length(result), wp.length(other)):
                result = 0.5 * (result + other)
            elif wp.length(other) < wp.length(result):
                result = other
        else:
            result = other
    return result


@wp.func
def between(one: wp.vec3d, other: wp.vec3d) -> wp.vec2f:
    """The change of (u, v)."""
    return wp.vec2f(wp.float32(other[0] - one[0]), wp.float32(other[1] - one[1]))


@wp.kernel
def spread_pixels(
    # In:
    deflections: wp.array(dtype=wp.vec3d),
    hit: wp.array(dtype=wp.int32),
    width: wp.int32,
    height: wp.int32,
    deviation: wp.float32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    footprints_out: wp.array(dtype=wp.vec4f),
):
    """How (u, v) changes over a pixel's filter: by one standard deviation along rows, and along columns.

    Pixels are a picture of a width and height, or pictures one after the other.
    """
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        footprints_out[i] = wp.vec4f()
        if hit[i] == 0:
            continue
        row = i // width
        column = i - row * width
        row = row % height
        left = i - 1
        right = i + 1
        above = i - width
        below = i + width
        if column == 0:
            left = -1
        if column == width - 1:
            right = -1
        if row == 0:
            above = -1
        if row == height - 1:
            below = -1
        along_x = deviation * slope(deflections, hit, left, i, right)
        along_y = deviation * slope(deflections, hit, above, i, below)
        footprints_out[i] = wp.vec4f(along_x[0], along_x[1], along_y[0], along_y[1])


@wp.kernel
def classify(
    # In:
    colours: wp.array(dtype=wp.vec3f),
    gains: wp.array(dtype=wp.float32),
    width: wp.int32,
    floor: wp.array(dtype=wp.float32),
    bounds: wp.array(dtype=wp.float32),
    first: wp.int32,
    run: wp.int32,
    # Out:
    classes_out: wp.array(dtype=wp.uint8),
):
    """How many bounds a lit pixel's contrast exceeds, twice, and one more if a pixel beside such a one is not lit.

    Contrast is the largest difference from those beside it, relative to the pixel itself, or to ``floor``, if that is
    more.
    """
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        result = wp.int32(0)
        if gains[i] > 0.0:
            largest = wp.float32(0.0)
            beside_dark = wp.int32(0)
            column = i % width
            for side in range(4):
                beside = i + 1
                inside = column + 1 < width
                if side == 1:
                    beside = i - 1
                    inside = column > 0
                if side == 2:
                    beside = i + width
                    inside = beside < gains.shape[0]
                if side == 3:
                    beside = i - width
                    inside = beside >= 0
                if inside:
                    if gains[beside] > 0.0:
                        largest = wp.max(largest, wp.length_sq(colours[beside] - colours[i]))
                    else:
                        beside_dark = 1
            contrast = wp.sqrt(largest) / wp.max(wp.length(colours[i]), floor[0])
            for k in range(bounds.shape[0]):
                if contrast > bounds[k]:
                    result += 2
            if result > 0:
                result += beside_dark
        classes_out[i] = wp.uint8(result)


@wp.kernel
def gather(
    # In:
    colours: wp.array(dtype=wp.vec3f),
    hit: wp.array(dtype=wp.int32),
    tiles: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.float32),
    first: wp.int32,
    run: wp.int32,
    # Out:
    colours_out: wp.array(dtype=wp.vec3f),
):
    """Set the colours of pixels to the means over the rays of their tiles that meet the mesh; a pixel −1 is none."""
    for tile in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        if tiles[tile] < 0:
            continue
        rays = weights.shape[0]
        total = wp.vec3f()
        weight = wp.float32(0.0)
        for k in range(rays):
            i = tile * rays + k
            if hit[i] != 0:
                total += weights[k] * colours[i]
                weight += weights[k]
        if weight > 0.0:
            colours_out[tiles[tile]] = total / weight


@wp.kernel
def accumulate(
    # In:
    colours: wp.array(dtype=wp.vec3f),
    first: wp.int32,
    run: wp.int32,
    # Out:
    xyz_out: wp.array(dtype=wp.vec3f),
):
    """Add colours to others."""
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        xyz_out[i] = xyz_out[i] + colours[i]
