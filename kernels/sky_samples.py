"""Sky samples: random directions, some drawn where the surface scatters much light, others where the sky is bright.

The first kind of sample draws (u, v) from a table of the surface's colours over rings (circles of constant |(u, v)|)
and azimuth samples on the rings. The second kind draws a direction from blocks of the sky, with a probability
proportional to their brightness. The weight of a sample is one over the sum of its densities in the two kinds (balance
heuristic, Veach 1997).

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer. θi is the angle of ωi from the normal.
"""

import math

import warp as wp

from warpdiff.kernels import compile_options, thresholds
from warpdiff.kernels.bvh import FAR
from warpdiff.kernels.light_samples import Reflection, energy_factor, finish_of, transmittance
from warpdiff.kernels.sample_frames import filtered_frame
from warpdiff.kernels.sample_sequence import filter_point, light_point, sample_index
from warpdiff.kernels.structs import Footprint, Pixels, SurfaceArrays, Textures, Transparency
from warpdiff.kernels.transparency import is_occluded

wp.set_module_options(compile_options.options("transparency.h"))

LEAST_LIGHT2 = wp.constant(wp.float32(thresholds.HORIZON**2 + 1.0e-6))


@wp.struct
class Sky:
    """Sky on a latitude-longitude grid. The top row of the grid is around +y; its middle column is towards −z."""

    powers: wp.array2d(dtype=wp.vec3f)  # power per solid angle by direction, one component per spectrum of the sky
    turn: wp.float32  # rotation of the sky about +y, as a share of a whole turn
    whites: wp.mat33f  # colours of a white pigment under each spectrum, linear RGB in rows


@wp.struct
class SkyDistribution:
    """Two probability distributions of directions to a sky: over a polar grid of (u, v), and over blocks of the sky."""

    ring_cdf: wp.array(dtype=wp.float32)  # cumulative probabilities of the rings of (u, v)
    starts: wp.array(dtype=wp.int32)  # index of each ring's first azimuth sample; then the total number of samples
    spoke_cdf: wp.array(dtype=wp.float32)  # cumulative probabilities of the azimuth samples within their ring
    # Probability density of each azimuth sample of (u, v), per unit of ln|(u, v)| and per radian. The first ring of
    # constant |(u, v)| is replaced by a disc, and its densities are per area.
    densities: wp.array(dtype=wp.float32)
    least_log: wp.float32  # ln|(u, v)| at the edge of the disc of the first ring
    per_log: wp.float32  # number of rings per unit of ln|(u, v)|
    row_cdf: wp.array(dtype=wp.float32)  # cumulative probabilities of the rows of blocks of the sky
    column_cdf: wp.array2d(dtype=wp.float32)  # cumulative probabilities of the sky's blocks within their row
    block_densities: wp.array2d(dtype=wp.float32)  # probability densities of the sky's blocks per solid angle
    sky_share: wp.float32  # share of the directions that are drawn from the blocks of the sky


@wp.func
def find_step(cdf: wp.array(dtype=wp.float32), begin: wp.int32, end: wp.int32, value: wp.float32) -> wp.int32:
    """Return the first index at which a cumulative probability exceeds ``value``; the last index if none does."""
    low = begin
    high = end - 1
    while low < high:
        middle = (low + high) // 2
        if cdf[middle] > value:
            high = middle
        else:
            low = middle + 1
    return low


@wp.func
def within_step(cdf: wp.array(dtype=wp.float32), begin: wp.int32, index: wp.int32, value: wp.float32) -> wp.float32:
    """Return the position of ``value`` between the cumulative probabilities at ``index`` − 1 and ``index``, 0 to 1."""
    before = wp.float32(0.0)
    if index > begin:
        before = cdf[index - 1]
    return wp.clamp((value - before) / wp.max(cdf[index] - before, 1.0e-12), 0.0, 1.0)


@wp.func
def draw_uv(table: SkyDistribution, point: wp.vec2f) -> wp.vec2f:
    """Draw a point (u, v) with a density proportional to the light that the surface scatters there."""
    ring = find_step(table.ring_cdf, 0, table.ring_cdf.shape[0], point[0])
    t = within_step(table.ring_cdf, 0, ring, point[0])
    radius = wp.exp(table.least_log + (wp.float32(ring - 1) + t) / table.per_log)
    if ring == 0:
        radius = wp.exp(table.least_log) * wp.sqrt(t)
    begin = table.starts[ring]
    count = table.starts[ring + 1] - begin
    spoke = find_step(table.spoke_cdf, begin, begin + count, point[1])
    s = within_step(table.spoke_cdf, begin, spoke, point[1])
    angle = wp.static(2.0 * math.pi) * (wp.float32(spoke - begin) + s) / wp.float32(count)
    return wp.vec2f(radius * wp.cos(angle), radius * wp.sin(angle))


@wp.func
def density_of_uv(table: SkyDistribution, uv: wp.vec2f) -> wp.float32:
    """Return the probability density of :func:`draw_uv` at a point, per area of (u, v)."""
    radius2 = wp.max(wp.length_sq(uv), 1.0e-20)
    place = (0.5 * wp.log(radius2) - table.least_log) * table.per_log
    ring = wp.int32(0)
    if place >= 0.0:
        ring = wp.int32(place) + 1
    if ring >= table.ring_cdf.shape[0]:
        return 0.0
    begin = table.starts[ring]
    count = table.starts[ring + 1] - begin
    turn = wp.atan2(uv[1], uv[0]) * wp.static(0.5 / math.pi)
    if turn < 0.0:
        turn += 1.0
    density = table.densities[begin + wp.min(wp.int32(turn * wp.float32(count)), count - 1)]
    if ring > 0:
        density /= radius2
    return density


@wp.func
def place_in_sky(sky: Sky, along: wp.vec3f) -> wp.vec2f:
    """Return the position of a direction in the sky, from left to right and from top to bottom, 0 to 1."""
    azimuth = wp.static(0.5 / math.pi) * wp.atan2(along[0], -along[2]) + 0.5 + sky.turn
    polar = wp.atan2(wp.sqrt(along[0] * along[0] + along[2] * along[2]), along[1])
    return wp.vec2f(azimuth - wp.floor(azimuth), wp.static(1.0 / math.pi) * polar)


@wp.func
def power_at(sky: Sky, place: wp.vec2f) -> wp.vec3f:
    """Return the power per solid angle at a position in the sky, by bilinear interpolation between its pixels."""
    height = sky.powers.shape[0]
    width = sky.powers.shape[1]
    x = place[0] * wp.float32(width) - 0.5
    y = wp.clamp(place[1] * wp.float32(height) - 0.5, 0.0, wp.float32(height - 1))
    column = wp.int32(wp.floor(x))
    row = wp.min(wp.int32(y), height - 2)
    s = x - wp.float32(column)
    t = y - wp.float32(row)
    left = (column + width) % width
    right = (column + 1) % width
    upper = (1.0 - s) * sky.powers[row, left] + s * sky.powers[row, right]
    lower = (1.0 - s) * sky.powers[row + 1, left] + s * sky.powers[row + 1, right]
    return (1.0 - t) * upper + t * lower


@wp.func
def draw_direction(table: SkyDistribution, sky: Sky, point: wp.vec2f) -> wp.vec3f:
    """Draw a direction in the world frame from the sky's blocks, with a density proportional to their brightness."""
    rows = table.row_cdf.shape[0]
    row = find_step(table.row_cdf, 0, rows, point[0])
    columns = table.column_cdf[row]
    column = find_step(columns, 0, columns.shape[0], point[1])
    # Within the drawn block (square of cells of the sky's grid), directions are uniform in solid angle.
    per_row = wp.static(math.pi) / wp.float32(rows)
    top = wp.cos(per_row * wp.float32(row))
    bottom = wp.cos(per_row * wp.float32(row + 1))
    up = top + within_step(table.row_cdf, 0, row, point[0]) * (bottom - top)
    level = wp.sqrt(wp.max(1.0 - up * up, 0.0))
    place = (wp.float32(column) + within_step(columns, 0, column, point[1])) / wp.float32(columns.shape[0])
    azimuth = wp.static(2.0 * math.pi) * (place - 0.5 - sky.turn)
    return wp.vec3f(level * wp.sin(azimuth), up, -level * wp.cos(azimuth))


@wp.func
def density_of_direction(table: SkyDistribution, place: wp.vec2f) -> wp.float32:
    """Return the probability density of :func:`draw_direction` at a position in the sky, per solid angle."""
    rows = table.block_densities.shape[0]
    columns = table.block_densities.shape[1]
    row = wp.clamp(wp.int32(place[1] * wp.float32(rows)), 0, rows - 1)
    column = wp.clamp(wp.int32(place[0] * wp.float32(columns)), 0, columns - 1)
    return table.block_densities[row, column]


@wp.func
def gain_over_cosine(
    reflection: Reflection, finish: wp.int32, uv: wp.vec2f, light: wp.vec3f, view: wp.vec3f
) -> wp.float32:  # fmt: skip
    """Return the gain (geometry factor) of ``light_samples.h`` divided by cos θi, the cosine of light and normal.

    The integral over the sky is computed over (u, v) instead of solid angle ω, and du dv = dω cos θi.
    """
    w = light[2] + view[2]
    overlap = 0.5 * (wp.length_sq(uv) + w * w)
    cosine = wp.sqrt(0.5 * overlap)
    gain = overlap * overlap / (w * w * view[2] * light[2])
    if reflection.masking:
        gain *= wp.min(wp.min(light[2], view[2]) * w * wp.sqrt(2.0 / overlap) / cosine, 1.0)
    surface = reflection.surfaces[finish]
    gain *= energy_factor(reflection, surface, view) * energy_factor(reflection, surface, light)
    rest = 1.0 - wp.min(cosine, 1.0)
    beyond_normal = 1.0 / wp.float32(reflection.normal_reflectances[finish]) - 1.0
    return gain * (1.0 + beyond_normal * rest * rest * rest * rest * rest)


@wp.kernel
def mirror_deflections(
    pixels: Pixels, counted: wp.float64, begins: wp.bool, resets: wp.bool, first: wp.int32, run: wp.int32,
    scattering_vectors_out: wp.array(dtype=wp.vec3d), gains_out: wp.array(dtype=wp.float32),
    xyz_out: wp.array(dtype=wp.vec3f), coverage_out: wp.array(dtype=wp.float64),
    illuminated_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Compute scattering vectors for light from the mirror direction, and count hits.

    The footprints (ranges of (u, v) in a pixel) of a sky's samples are computed from these scattering vectors, before
    any direction of the sky is drawn. Gains (geometry factors) are 1 at all hits, because a sky illuminates every
    point.
    """
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        scattering_vector = wp.vec3d()
        if pixels.hit[i] != 0:
            scattering_vector[2] = -wp.float64(2.0) * wp.float64(wp.dot(pixels.normal[i], pixels.to_view[i]))
        scattering_vectors_out[i] = scattering_vector
        gains_out[i] = wp.where(pixels.hit[i] != 0, 1.0, 0.0)
        if coverage_out.shape[0] > 0:
            if resets:
                xyz_out[i] = wp.vec3f()
            if begins:
                coverage_out[i] = wp.float64(0.0)
                illuminated_out[i] = False
            coverage_out[i] = coverage_out[i] + wp.where(pixels.hit[i] != 0, counted, wp.float64(0.0))


@wp.kernel
def sample_sky(
    sky: Sky, table: SkyDistribution, pixels: Pixels, footprints: wp.array(dtype=Footprint), rgb_to_xyz: wp.mat33d,
    reflection: Reflection, surface: wp.int32, mesh: SurfaceArrays, textures: Textures, transparency: Transparency,
    mesh_id: wp.uint64, shadows: wp.bool, tiles: wp.array(dtype=wp.int32), width: wp.int32, across: wp.int32,
    sample: wp.int32, samples: wp.int32, first: wp.int32, run: wp.int32,
    scattering_vectors_out: wp.array(dtype=wp.vec3d), to_lights_out: wp.array(dtype=wp.vec3f),
    gains_out: wp.array2d(dtype=wp.float32), xyz_out: wp.array(dtype=wp.vec3f),
    illuminated_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Draw one direction of the sky for each ray. Compute its scattering vector and gains (geometry factors).

    The light that the pigment (base colour) reflects is added to ``xyz_out``.

    Args:
        sky: Power per solid angle of the sky by direction, for three spectra.
        table: The distributions from which directions are drawn.
        pixels: Hits of the rays.
        footprints: Footprints of the rays' filters for light from the mirror direction.
        rgb_to_xyz: Matrix from linear sRGB to XYZ.
        reflection: Parameters of the reflectance.
        surface: Surface for whose faces directions are drawn. Other rays get gains of 0; their directions are
            unchanged.
        mesh: Mesh, whose transparent faces shadow rays pass.
        textures: Textures of the materials.
        transparency: Cut-offs of the materials; empty if all faces are opaque.
        mesh_id: Id of the mesh with the hierarchy for shadow rays.
        shadows: Whether shadow rays are traced.
        tiles: Pixels that are divided into cells with one ray each; −1 is no pixel. If empty, each pixel of the picture
            has one ray.
        width: Number of pixels per row.
        across: Number of cells along a side of a pixel.
        sample: Index of the sample among the ``samples`` of each ray.
        samples: Number of samples per ray.
        first: Index of the first thread's first ray.
        run: Number of rays per thread.
        scattering_vectors_out: (u, v, w).
        to_lights_out: Directions in the local frame.
        gains_out: Geometry factors by spectrum of the sky, (3, n); 0 where no light arrives.
        xyz_out: Sums of colours, to which the pigment's light is added.
        illuminated_out: True is written where light arrives; an empty array is not written.
    """
    thread, _ = wp.tid()
    weight = 1.0 / wp.float32(samples)
    for i in range(first + thread * run, first + (thread + 1) * run):
        for spectrum in range(3):
            gains_out[spectrum, i] = 0.0
        if pixels.hit[i] == 0:
            scattering_vectors_out[i] = wp.vec3d()
            to_lights_out[i] = wp.vec3f()
            continue
        finish = finish_of(reflection, pixels.face[i])
        if reflection.surfaces[finish] != surface:
            continue
        index = sample_index(tiles, width, across, i, sample, samples)
        point = light_point(index)
        frame = filtered_frame(pixels, i, footprints[i], filter_point(index))
        view = frame.view
        uv = wp.vec2f()
        light = wp.vec3f()
        along = wp.vec3f()
        # Directions are converted between the world and the shading frame without the functions of ``sample_frames``.
        # With these functions, the compiler would fuse other multiplications and additions, and rounding would change.
        if point[0] < table.sky_share:
            along = draw_direction(table, sky, wp.vec2f(point[0] / table.sky_share, point[1]))
            light = wp.vec3f(wp.dot(frame.tangent, along), wp.dot(frame.bitangent, along), wp.dot(frame.normal, along))
            uv = wp.vec2f(-light[0] - view[0], -light[1] - view[1])
        else:
            uv = draw_uv(table, wp.vec2f((point[0] - table.sky_share) / (1.0 - table.sky_share), point[1]))
            x = -uv[0] - view[0]
            y = -uv[1] - view[1]
            light = wp.vec3f(x, y, wp.sqrt(wp.max(1.0 - x * x - y * y, 0.0)))
            along = wp.normalize(x * frame.tangent + y * frame.bitangent + light[2] * frame.normal)
        scattering_vectors_out[i] = wp.vec3d(wp.float64(uv[0]), wp.float64(uv[1]), -wp.float64(light[2] + view[2]))
        to_lights_out[i] = light
        if light[2] * light[2] < LEAST_LIGHT2 or light[2] < 0.0:
            continue
        # Both probability densities must be per area of (u, v). The density of directions is per solid angle, and is
        # divided by cos θi, because dω cos θi = du dv.
        place = place_in_sky(sky, along)
        density = (1.0 - table.sky_share) * density_of_uv(table, uv)
        density += table.sky_share * density_of_direction(table, place) / light[2]
        if density <= 0.0:
            continue
        if shadows:
            if is_occluded(mesh, textures, transparency, mesh_id, pixels.shadow_origin[i], along, FAR):
                continue
        rgb = (wp.float32(reflection.units[finish]) * (weight / density)) * power_at(sky, place)
        gain = gain_over_cosine(reflection, finish, uv, light, view)
        for spectrum in range(3):
            gains_out[spectrum, i] = gain * rgb[spectrum]
        if illuminated_out.shape[0] > 0 and rgb[0] + rgb[1] + rgb[2] > 0.0:
            illuminated_out[i] = True
        if reflection.pigments.shape[0] > 0:
            pigment = wp.float32(reflection.pigments[finish])
            into = transmittance(reflection, finish, light[2])
            base = wp.cw_mul(wp.cw_mul(pixels.base_colour[i], into), transmittance(reflection, finish, view[2]))
            white = wp.vec3f()
            for spectrum in range(3):
                for channel in range(3):
                    white[channel] = white[channel] + rgb[spectrum] * sky.whites[spectrum, channel]
            xyz_out[i] = xyz_out[i] + wp.vec3f(rgb_to_xyz * wp.vec3d(pigment * wp.cw_mul(base, white)))
