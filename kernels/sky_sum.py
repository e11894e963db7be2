"""Sky sum: colours under a sky, summed over cells of (u, v), each times the radiance in its direction.

A table holds what a surface's colours are on average over a cell, by w. A cell's light comes from a direction that each
pixel has for itself, and the sky there is taken from maps that are blurred as much as the cell and the pixel's
footprint are wide. Cells are leaves of a tree: ``sum_cells`` walks it, parents first, and opens a node only where the
sky, the gain or the row may vary below it by more than a share of the colour, which ``add_sky`` guesses beforehand.
Where a footprint is long, ``add_sky`` sums for several rays along it, their frames turned; how these differ tells what
the pixel errs by. See "footprints that are streaks, and a tree of cells" in docs/decisions/environments.md.
"""

import math

import warp as wp

from warpdiff.kernels import compile_options, thresholds
from warpdiff.kernels.bvh import FAR
from warpdiff.kernels.light_samples import Lights, Reflection, energy_factor, transmittance
from warpdiff.kernels.octahedral_maps import SkyMap, direction_at, light_along, on_octahedron
from warpdiff.kernels.shading_frames import LEAST_COSINE
from warpdiff.kernels.structs import Footprint, Pixels

wp.set_module_options(compile_options.options())

# Whether light comes is asked in the directions of an octahedral map of so many texels a side, a bit each, and is
# linear between them.
_SIDE = 16
_WORDS = _SIDE * _SIDE // 32
# Deviations from the horizon within which it cuts cells.
HORIZON_SIGMAS = wp.constant(2.5)
# Places along a footprint: how far they reach, in deviations, how many for each time that it is longer than what the
# sky is blurred by, and at most.
SPAN = wp.constant(2.0)
TAPS_A_RATIO = wp.constant(2.0)
MOST_TAPS = wp.constant(8)
# A ray's colour is guessed by nodes of a part of the cells at most. Nodes are opened that may err by more than a share
# of that, which is so much over the number of cells, or of a part of them at most where there is pigment.
GUESSED_PARTS = wp.constant(16)
PIGMENTED_PARTS = wp.constant(128)
OPENED_SHARE = wp.constant(33.0)
# From this deviation on a node may hide an edge of what the mesh leaves open.
LEAST_HIDING = wp.constant(0.1)
# The zeroth order is summed over places from the normal to the horizon where that is nearer than so many deviations of
# its lobe; how wide that is in X, Y and Z, over what it is at the middle wavelength.
NEAR_HORIZON = wp.constant(8.0)
PLACES = wp.constant(5)
WIDTHS = wp.constant(wp.vec3f(1.03, 1.01, 0.83))
# By how much phases change, of an entry of w over half the range of w: half of the root of what the table allows
# (``sky_cells._MOST_PHASE2``).
PHASE_AN_ENTRY = 0.08
# What errors count that all nodes have alike, of those that are as if by chance.
ALIKE = wp.constant(5.0)
# ‖XYZ‖ over the luminance.
PER_LUMINANCE = wp.constant(1.7)
# What colours err by under any sky, an even one too, as cells together leave ripples.
RIPPLE = wp.constant(0.02)
open_t = wp.types.vector(length=_WORDS, dtype=wp.uint32)


@wp.struct
class SkyTable:
    """What a surface sends from cells of (u, v), as Gaussians, by material, node and w: a tree, parents first."""

    nodes: wp.array(dtype=wp.vec4f)  # u, v, deviation, area; the first one is the zeroth order
    ends: wp.array(dtype=wp.int32)  # where what is below a node ends
    rows: wp.array(dtype=wp.mat33f)  # XYZ in rows, by spectrum
    entries: wp.int32  # of w, from 0 to 2


@wp.struct
class HitFrame:
    """What a ray has met."""

    tangent: wp.vec3f
    bitangent: wp.vec3f
    normal: wp.vec3f
    view: wp.vec3f  # the direction to it, in this frame
    blur: wp.float32  # variance of (u, v) for light by way of a mirror
    energy: wp.float32  # of the directions to it, 1 as Stam has it
    material: wp.int32
    hides: wp.bool  # whether the mesh hides any of the sky
    visibility: open_t  # where it does not


@wp.struct
class SkySum:
    """Colours under a sky, summed over nodes."""

    colour: wp.vec3f
    below: wp.mat33f  # what the pigment gets, by spectrum and linear RGB
    blurred2: wp.float32  # squares of what the luminance may err by, as footprints are blurred evenly
    coarse2: wp.float32  # and as nodes are no smaller, nor the sky's maps finer


@wp.func
def is_open(visibility: open_t, column: wp.int32, row: wp.int32) -> wp.float32:
    """1 where light comes from a texel, which may lie one beyond the map: it is folded back there."""
    x = column
    z = row
    if x < 0 or x >= wp.static(_SIDE):
        x = wp.clamp(x, 0, wp.static(_SIDE - 1))
        z = wp.static(_SIDE - 1) - z
    if z < 0 or z >= wp.static(_SIDE):
        z = wp.clamp(z, 0, wp.static(_SIDE - 1))
        x = wp.static(_SIDE - 1) - x
    texel = z * wp.static(_SIDE) + x
    bit = (visibility[texel // 32] >> wp.uint32(texel % 32)) & wp.uint32(1)
    return wp.float32(bit)


@wp.func
def share_open(visibility: open_t, place: wp.vec2f) -> wp.float32:
    """The share of light that comes from there."""
    x = place[0] * wp.static(float(_SIDE)) - 0.5
    z = place[1] * wp.static(float(_SIDE)) - 0.5
    column = wp.int32(wp.floor(x))
    row = wp.int32(wp.floor(z))
    s = x - wp.float32(column)
    t = z - wp.float32(row)
    upper = (1.0 - s) * is_open(visibility, column, row) + s * is_open(visibility, column + 1, row)
    lower = (1.0 - s) * is_open(visibility, column, row + 1) + s * is_open(visibility, column + 1, row + 1)
    return (1.0 - t) * upper + t * lower


@wp.func
def share_above(radius: wp.float32, deviation: wp.float32) -> wp.vec3f:
    """What the horizon leaves of a Gaussian so far from the normal, and what comes from there.

    The share that lies above, by what that moves the middle of it (a normal distribution that is cut off), as a factor
    of the radius, and what the mean of 1/cos θ there is over the middle's (a fit, within 0.03).
    """
    inside = (1.0 - radius) / deviation
    if inside > HORIZON_SIGMAS:
        return wp.vec3f(1.0, 1.0, 1.0)
    if inside < -HORIZON_SIGMAS:
        return wp.vec3f(0.0, 1.0, 1.0)
    share = 0.5 * wp.erfc(wp.static(-math.sqrt(0.5)) * inside)
    moved = deviation * wp.static(1.0 / math.sqrt(2.0 * math.pi)) * wp.exp(-0.5 * inside * inside) / share
    per_cosine = 1.0 + 0.75 / (1.0 + 0.4 * wp.exp(1.08 * inside))
    return wp.vec3f(share, wp.max(radius - moved, 0.0) / wp.max(radius, 1.0e-6), per_cosine)


@wp.func
def gain_of(
    frame: HitFrame, reflection: Reflection, u: wp.float32, v: wp.float32, light: wp.vec3f, beyond: wp.float32
) -> wp.float32:
    """The gain of ``light_samples.h``, over the cosine that dω has: dω cos θi is du dv."""
    z = light[2]
    w = z + frame.view[2]
    overlap = 0.5 * (u * u + v * v + w * w)
    cosine = wp.sqrt(0.5 * overlap)
    gain = overlap * overlap / (w * w * frame.view[2] * z)
    if reflection.masking:
        gain *= wp.min(wp.min(z, frame.view[2]) * w * wp.sqrt(2.0 / overlap) / cosine, 1.0)
    else:
        gain *= beyond
    gain *= frame.energy * energy_factor(reflection, light)
    rest = 1.0 - wp.min(cosine, 1.0)
    beyond_normal = 1.0 / wp.float32(reflection.normal_reflectance) - 1.0
    return gain * (1.0 + beyond_normal * rest * rest * rest * rest * rest)


@wp.func
def towards_world(frame: HitFrame, x: wp.float32, y: wp.float32, z: wp.float32) -> wp.vec3f:
    """A direction of the frame in the world."""
    return x * frame.tangent + y * frame.bitangent + z * frame.normal


@wp.func
def row_of(table: SkyTable, material: wp.int32, node: wp.int32, w: wp.float32) -> wp.mat33f:
    """What a surface sends from a node, linear between entries of w."""
    entry = 0.5 * w * wp.float32(table.entries - 1)
    before = wp.min(wp.int32(entry), table.entries - 2)
    t = entry - wp.float32(before)
    at = (material * table.nodes.shape[0] + node) * table.entries + before
    return (1.0 - t) * table.rows[at] + t * table.rows[at + 1]


@wp.func
def mirrored_near_horizon(
    sky: SkyMap, table: SkyTable, frame: HitFrame, reflection: Reflection, lobe: wp.float32, blur: wp.float32
) -> SkySum:
    """What the zeroth order sends where the horizon cuts its lobe, of such a deviation, or is near.

    At several places that are even by the angle to the normal, by which 1/cos θ is smooth.
    """
    result = SkySum()
    radius = wp.sqrt(frame.view[0] * frame.view[0] + frame.view[1] * frame.view[1])
    lowest = wp.asin(radius - HORIZON_SIGMAS * lobe)
    step = (wp.asin(wp.min(radius + HORIZON_SIGMAS * lobe, 1.0)) - lowest) / wp.float32(PLACES)
    variance = 0.5 * lobe * lobe + blur
    total = wp.vec3f()
    error = wp.float32(0.0)
    for index in range(PLACES):
        angle = lowest + (wp.float32(index) + 0.5) * step
        z = wp.max(wp.cos(angle), wp.static(math.sqrt(thresholds.HORIZON + 1.0e-6)))
        moved = wp.sin(angle) / radius
        along = towards_world(frame, -moved * frame.view[0], -moved * frame.view[1], z)
        light = light_along(sky, along, variance / wp.max(z, 0.1))
        u = (moved - 1.0) * frame.view[0]
        v = (moved - 1.0) * frame.view[1]
        sent = gain_of(frame, reflection, u, v, wp.vec3f(-moved * frame.view[0], -moved * frame.view[1], z), 1.0)
        if frame.hides:
            sent *= share_open(frame.visibility, on_octahedron(along))
        row = sent * row_of(table, frame.material, 0, z + frame.view[2])
        colour = row * wp.vec3f(light[0], light[1], light[2])
        for channel in range(3):
            off = (moved - 1.0) * radius / (WIDTHS[channel] * lobe)
            share = z * wp.exp(-0.5 * off * off)
            total[channel] = total[channel] + share
            result.colour[channel] = result.colour[channel] + share * colour[channel]
            if channel == 1:
                error += share * (row[1, 0] + row[1, 1] + row[1, 2]) * wp.static(1.0 / 3.0) * light[3]
    for channel in range(3):
        above = 0.5 * wp.erfc(wp.static(-math.sqrt(0.5)) * (1.0 - radius) / (WIDTHS[channel] * lobe))
        result.colour[channel] = result.colour[channel] * above / total[channel]
    error /= total[1]
    result.blurred2 = error * error * blur / wp.max(variance, sky.variance)
    result.coarse2 = error * error * wp.max(sky.variance - variance, 0.0) / wp.max(variance, sky.variance)
    return result


@wp.func
def sum_cells(
    sky: SkyMap, table: SkyTable, frame: HitFrame, reflection: Reflection, limit: wp.float32, size: wp.int32,
    pigment: wp.bool,
) -> SkySum:  # fmt: skip
    """A sum over nodes, which are opened where they may err by more than a limit, or have more nodes than a size."""
    result = SkySum()
    count = table.nodes.shape[0]
    node = wp.int32(0)
    while node < count:
        end = table.ends[node]
        place = table.nodes[node]
        x = -(place[0] + frame.view[0])
        y = -(place[1] + frame.view[1])
        # A footprint is that of light by way of a mirror: where the normal turns, it grows as w.
        rotated = 0.5 + 0.5 * wp.sqrt(wp.max(1.0 - x * x - y * y, 0.0)) / frame.view[2]
        blur = wp.min(rotated * rotated, 4.0) * frame.blur
        variance = place[2] * place[2] + blur
        radius = wp.sqrt(x * x + y * y)
        above = share_above(radius, wp.sqrt(variance))
        if above[0] == 0.0:
            node = end
            continue
        if end - node > 1 and end - node > size:
            node += 1
            continue
        if node == 0 and 1.0 - radius < NEAR_HORIZON * place[2]:
            mirrored = mirrored_near_horizon(sky, table, frame, reflection, place[2], blur)
            result.colour += mirrored.colour
            result.blurred2 += mirrored.blurred2
            result.coarse2 += mirrored.coarse2
            node = end
            continue
        x *= above[1]
        y *= above[1]
        z = wp.sqrt(wp.max(1.0 - x * x - y * y, wp.static(float(thresholds.HORIZON) + 1.0e-6)))
        weight = above[0] * place[3]
        along = towards_world(frame, x, y, z)
        if frame.hides:
            weight *= share_open(frame.visibility, on_octahedron(along))
        light = light_along(sky, along, variance / wp.max(z, 0.1))
        gain = gain_of(frame, reflection, place[0], place[1], wp.vec3f(x, y, z), above[2])
        row = (gain * weight) * row_of(table, frame.material, node, z + frame.view[2])
        rgb = wp.vec3f(light[0], light[1], light[2])
        # Below a node gains bend, and rows as phases change with w: alike for many, so that it adds up.
        curvature_error = place[2] / z
        turns = wp.static(PHASE_AN_ENTRY) * wp.float32(table.entries) * radius
        curvature_error = wp.min(curvature_error * curvature_error * (2.0 + turns * turns), 0.5)
        if above[0] < 1.0 or (frame.hides and place[2] > LEAST_HIDING):
            curvature_error = 0.5
        per_light = (row[1, 0] + row[1, 1] + row[1, 2]) * wp.static(1.0 / 3.0)
        opens_for = wp.max(light[3], ALIKE * curvature_error * (rgb[0] + rgb[1] + rgb[2]))
        if end - node > 1 and limit >= 0.0 and per_light * opens_for > limit:
            node += 1
            continue
        result.colour += row * rgb
        error = per_light * light[3]
        per_variance = error * error / wp.max(variance, sky.variance)
        result.blurred2 += per_variance * blur
        result.coarse2 += per_variance * (
            wp.max(sky.variance - variance, 0.0) + wp.where(node > 0, place[2] * place[2], 0.0)
        )
        if pigment and node > 0:
            result.below += wp.outer(weight * rgb, transmittance(reflection, frame.material, z))
        node = end
    return result


@wp.func
def rotated_by(frame: HitFrame, reflection: Reflection, x: wp.float32, y: wp.float32) -> HitFrame:
    """What a ray beside it has met, where the normal has turned by (x, y) in the frame."""
    result = frame
    towards = frame.view[0] * frame.tangent + frame.view[1] * frame.bitangent + frame.view[2] * frame.normal
    normal = wp.normalize(frame.normal + x * frame.tangent + y * frame.bitangent)
    tangent = wp.normalize(frame.tangent - wp.dot(frame.tangent, normal) * normal)
    bitangent = wp.cross(normal, tangent)
    result.bitangent = wp.where(wp.dot(bitangent, frame.bitangent) < 0.0, -bitangent, bitangent)
    result.tangent = tangent
    result.normal = normal
    result.view = wp.normalize(
        wp.vec3f(
            wp.dot(tangent, towards),
            wp.dot(result.bitangent, towards),
            wp.max(wp.dot(normal, towards), wp.static(LEAST_COSINE)),
        )
    )
    result.energy = energy_factor(reflection, result.view)
    return result


@wp.kernel
def mirror_directions(
    # In:
    pixels: Pixels, counted: wp.float64, begins: wp.bool, resets: wp.bool, first: wp.int32, run: wp.int32,
    # Out:
    scattering_vectors_out: wp.array(dtype=wp.vec3d), to_lights_out: wp.array(dtype=wp.vec3f),
    gains_out: wp.array(dtype=wp.float32), xyz_out: wp.array(dtype=wp.vec3f), coverage_out: wp.array(dtype=wp.float64),
    illuminated_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """What ``scattering_vectors`` finds of pixels, for light that comes by way of a mirror, and gains of 1.

    Directions to the light are those of the world, which tell how even footprints are.
    """
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        scattering_vector = wp.vec3d()
        to_light = wp.vec3f()
        gain = wp.float32(0.0)
        if pixels.hit[i] != 0:
            view = pixels.to_view[i]
            cosine = wp.dot(pixels.normal[i], view)
            scattering_vector[2] = -wp.float64(2.0) * wp.float64(cosine)
            to_light = 2.0 * cosine * pixels.normal[i] - view
            gain = wp.float32(1.0)
        scattering_vectors_out[i] = scattering_vector
        to_lights_out[i] = to_light
        gains_out[i] = gain
        if coverage_out.shape[0] > 0:
            if resets:
                xyz_out[i] = wp.vec3f()
            if begins:
                coverage_out[i] = wp.float64(0.0)
                illuminated_out[i] = False
            coverage_out[i] = coverage_out[i] + wp.where(gain > 0.0, counted, wp.float64(0.0))
            illuminated_out[i] = illuminated_out[i] or gain > 0.0


@wp.func
def principal_axes(footprint: Footprint) -> wp.vec4f:
    """Variances of a footprint along its longer and its shorter axis, and one deviation along the longer one."""
    xx = footprint[0] * footprint[0] + footprint[2] * footprint[2]
    xy = footprint[0] * footprint[1] + footprint[2] * footprint[3]
    yy = footprint[1] * footprint[1] + footprint[3] * footprint[3]
    half = wp.sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy)
    major = 0.5 * (xx + yy) + half
    angle = 0.5 * wp.atan2(2.0 * xy, xx - yy)
    along = wp.sqrt(major)
    return wp.vec4f(major, wp.max(0.5 * (xx + yy) - half, 0.0), along * wp.cos(angle), along * wp.sin(angle))


@wp.func
def sky_visibility(mesh_id: wp.uint64, origin: wp.vec3f, normal: wp.vec3f, of_four: wp.bool, turn: wp.int32) -> open_t:
    """In which directions, texels of an octahedral map, the mesh does not hide the sky.

    ``of_four`` texels one is asked for, which they take turns to be.
    """
    visibility = open_t()
    step = wp.where(of_four, 2, 1)
    for row in range(0, wp.static(_SIDE), step):
        for column in range(0, wp.static(_SIDE), step):
            x = column
            z = row
            if of_four:
                x += turn % 2
                z += turn / 2 % 2
            along = direction_at(
                (wp.float32(x) + 0.5) * wp.static(1.0 / _SIDE), (wp.float32(z) + 0.5) * wp.static(1.0 / _SIDE)
            )
            # Below the horizon, where no light comes from, texels are beside others that count.
            if wp.dot(along, normal) > 0.0 and wp.mesh_query_ray_anyhit(mesh_id, origin, along, FAR):
                continue
            for down in range(step):
                texel = (row + down) * wp.static(_SIDE) + column
                visibility[texel // 32] = visibility[texel // 32] | (wp.uint32(2 * step - 1) << wp.uint32(texel % 32))
    return visibility


@wp.func
def frame_of(
    pixels: Pixels, reflection: Reflection, mesh_id: wp.uint64, shadows: wp.bool, is_cell: wp.bool, i: wp.int32
) -> HitFrame:
    """What a pixel's ray has met, or that of one of its cells, which together ask for all of the sky."""
    result = HitFrame()
    result.tangent = pixels.tangent[i]
    result.bitangent = pixels.bitangent[i]
    result.normal = pixels.normal[i]
    view = pixels.to_view[i]
    result.view = wp.normalize(
        wp.vec3f(wp.dot(result.tangent, view), wp.dot(result.bitangent, view), wp.dot(result.normal, view))
    )
    result.energy = energy_factor(reflection, result.view)
    if reflection.materials.shape[0] > 0:
        result.material = reflection.materials[pixels.face[i]]
    if shadows:
        result.visibility = sky_visibility(mesh_id, pixels.shadow_origin[i], result.normal, is_cell, i)
        for word in range(wp.static(_WORDS)):
            result.hides = result.hides or ~result.visibility[word] != wp.uint32(0)
    return result


@wp.kernel
def add_sky(
    # In:
    sky: SkyMap, table: SkyTable, pixels: Pixels, gains: wp.array(dtype=wp.float32),
    footprints: wp.array(dtype=Footprint), lights: Lights, light_index: wp.int32, reflection: Reflection,
    mesh_id: wp.uint64, cells: wp.int32, first: wp.int32, run: wp.int32,
    # Out:
    occluded_out: wp.array(dtype=wp.bool), estimates_out: wp.array(dtype=wp.vec2f), xyz_out: wp.array(dtype=wp.vec3f),
):  # fmt: skip
    """Add the sky's colours to those of pixels whose gain is not 0.

    ``occluded_out`` is set where the mesh hides any part of the sky; empty is that it hides none. ``estimates_out`` are
    what colours may err by, ‖ΔXYZ‖: as they change over the footprint, and, added up over skies, otherwise; empty is
    that nobody asks.
    """
    thread, _ = wp.tid()
    shadows = occluded_out.shape[0] > 0
    pigment = wp.float32(lights.strengths[light_index][1])
    for i in range(first + thread * run, first + (thread + 1) * run):
        if shadows:
            occluded_out[i] = False
        if gains[i] == 0.0:
            continue
        frame = frame_of(pixels, reflection, mesh_id, shadows, estimates_out.shape[0] == 0, i)
        if shadows:
            occluded_out[i] = frame.hides
        axes = principal_axes(footprints[i])
        # Along its longer axis there are rays at several places, unless the sky is blurred as much anyway. They are
        # ``apart`` deviations from each other, and blurred by half of that.
        narrow = axes[1] + sky.variance
        taps = wp.min(wp.int32(TAPS_A_RATIO * wp.sqrt(axes[0] / narrow)) + 1, MOST_TAPS)
        taps = wp.where(taps == 2, 3, taps)
        apart = 2.0 * SPAN / wp.float32(taps)
        frame.blur = axes[1] + wp.where(taps > 1, 0.25 * apart * apart * axes[0], 0.5 * (axes[0] - axes[1]))
        size = wp.max(table.nodes.shape[0] / GUESSED_PARTS, 1)
        guess = sum_cells(sky, table, frame, reflection, -1.0, size, False)
        # The pigment sends light from everywhere, wherever the surface sends none.
        size = table.nodes.shape[0]
        if pigment > 0.0:
            size = wp.max(size / PIGMENTED_PARTS, 1)
        limit = OPENED_SHARE / wp.float32(cells) * guess.colour[1]
        total = wp.float32(0.0)
        mean = SkySum()
        square = wp.float32(0.0)
        for tap in range(taps):
            off = (wp.float32(tap) + 0.5) * apart - SPAN
            share = wp.exp(-0.5 * off * off / wp.max(1.0 - 0.25 * apart * apart, 0.1))
            per_normal = 0.5 * off / frame.view[2]
            beside = rotated_by(frame, reflection, per_normal * axes[2], per_normal * axes[3])
            sky_sum = sum_cells(sky, table, beside, reflection, limit, size, pigment > 0.0)
            total += share
            mean.colour += share * sky_sum.colour
            mean.below += share * sky_sum.below
            mean.blurred2 += share * sky_sum.blurred2
            mean.coarse2 += share * sky_sum.coarse2
            square += share * wp.length_sq(sky_sum.colour)
        colour = mean.colour / total
        if estimates_out.shape[0] > 0:
            scattered2 = wp.max(square / total - wp.length_sq(colour), 0.0)
            blurred2 = PER_LUMINANCE * PER_LUMINANCE * mean.blurred2 / total
            before = estimates_out[i][1]
            ripple2 = RIPPLE * RIPPLE * wp.length_sq(colour)
            coarse = wp.sqrt(PER_LUMINANCE * PER_LUMINANCE * mean.coarse2 / total + ripple2)
            estimates_out[i] = wp.vec2f(wp.sqrt(wp.max(scattered2, blurred2)), before + coarse)
        if pigment > 0.0:
            below = mean.below / total
            base = wp.cw_mul(pixels.base_colour[i], transmittance(reflection, frame.material, frame.view[2]))
            rgb = wp.vec3f()
            for spectrum in range(3):
                for channel in range(3):
                    rgb[channel] = rgb[channel] + below[spectrum, channel] * sky.whites[spectrum, channel]
            colour += wp.vec3f(lights.rgb_to_xyz * wp.vec3d(pigment * wp.cw_mul(base, rgb)))
        xyz_out[i] = xyz_out[i] + colour
