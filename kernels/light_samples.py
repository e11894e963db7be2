"""Light samples: scattering vectors, gains and footprints at hits under one light.

A gain is a geometry factor times Schlick's ratio of reflectances. A footprint is the Gaussian over (u, v) that a pixel
covers. The pigment is the base colour of the mesh below its height field.

ωi and ωr are the unit vectors to the light and to the viewer, in the frame of the surface.
"""

import warp as wp

from warpdiff.kernels import compile_options, thresholds
from warpdiff.kernels.footprints import LEAST_FACING, pixel_footprints_run
from warpdiff.kernels.structs import Camera, Footprint, Pixels, SurfaceArrays

wp.set_module_options(compile_options.options("light_samples.h", "footprints.h"))

# Warp compiles every kernel with one thread index twice. The second variant, for contiguous arrays, is hardly faster. A
# kernel with two thread indices is compiled only once. Therefore the kernels here have a second index, which is always
# 0. This saves a third of the compilation time.


@wp.struct
class Lights:
    """Lights, and the colour of their reflection by the pigment (the base colour of the mesh below its height field).

    The fields are arrays, so that a recorded CUDA graph can be replayed with other lights.
    """

    # Homogeneous coordinates of each light: the direction to a distant light and 0, or the position of a light and 1.
    places: wp.array(dtype=wp.vec4d)
    strengths: wp.array(dtype=wp.float64)  # power of each light; for a light at a position, at a distance of 1
    deviations: wp.array2d(
        dtype=wp.vec3f
    )  # two perpendicular vectors, as long as the standard deviations of directions [rad], or of a light's positions
    white_rgb: wp.array(dtype=wp.vec3d)  # colour of a white pigment under each light, in linear sRGB
    rgb_to_xyz: wp.mat33d  # matrix from linear sRGB to XYZ


@wp.struct
class Reflection:
    """Parameters of the reflectance that are the same for all directions.

    A finish is a surface with one of its materials.
    """

    finishes: wp.array(dtype=wp.int32)  # finish (surface and material) of each face; empty if all have the finish 0
    surfaces: wp.array(dtype=wp.int32)  # surface of each finish
    normal_reflectances: wp.array(
        dtype=wp.float64
    )  # R(0) of Schlick's approximation, by finish; 1 if the integral over λ already includes R
    units: wp.array(dtype=wp.float64)  # factor from the colours of each finish to the unit of the picture
    pigments: wp.array(dtype=wp.float64)  # strength of the pigment (base colour) divided by R(0), by finish; or empty
    per_light_cosine: wp.array(
        dtype=wp.bool
    )  # by finish: whether gains are divided by the light's cosine, for coherence of kind "source"
    masking: wp.bool
    transmittances: wp.array2d(dtype=wp.vec3f)  # 1 − R in linear RGB, by finish and cosine of the angle from the normal
    # Factors a of the energy normalisation for each surface. With them, the powers of all diffraction orders of a
    # perfect mirror sum to 1. They are tabulated by the angle of a direction from the normal and by its azimuth. If the
    # array is empty, they are not used.
    energy: wp.array3d(dtype=wp.float32)


@wp.func_native(
    f"warpdiff::find_scattering_vectors<32>(pixels, place, towards, reflection, scale, {thresholds.HORIZON}, counted, "
    "begins, resets, occluded, begin, end, scattering_vectors_out, to_lights_out, gains_out, xyz_out, coverage_out, "
    "illuminated_out);"
)
def scattering_vectors_run(
    pixels: Pixels, place: wp.vec4d, towards: wp.array(dtype=wp.vec4f), reflection: Reflection, scale: wp.float64,
    counted: wp.float64, begins: wp.bool, resets: wp.bool, occluded: wp.array(dtype=wp.bool), begin: wp.int32,
    end: wp.int32,
    scattering_vectors_out: wp.array(dtype=wp.vec3d), to_lights_out: wp.array(dtype=wp.vec3f),
    gains_out: wp.array(dtype=wp.float32), xyz_out: wp.array(dtype=wp.vec3f), coverage_out: wp.array(dtype=wp.float64),
    illuminated_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Compute scattering vectors, directions to the light and gains (geometry factors) of pixels, and count hits."""


@wp.func
def away_from(place: wp.vec4d, point: wp.vec3f) -> wp.vec3d:
    """Return the vector from a point to a point light, or the direction to a distant light."""
    return wp.vec3d(place[0], place[1], place[2]) - place[3] * wp.vec3d(point)


@wp.func
def finish_of(reflection: Reflection, face: wp.int32) -> wp.int32:
    """Return the index of the finish of a face. A finish is a surface with one of its materials."""
    if reflection.finishes.shape[0] == 0:
        return 0
    return reflection.finishes[face]


@wp.func
def transmittance(reflection: Reflection, finish: wp.int32, cosine: wp.float32) -> wp.vec3f:
    """Return the transmittance (1 − R) of a surface in linear RGB, for the cosine of an angle from the normal.

    It is the share of the light that reaches the pigment (base colour) below the surface. A finish is a surface with
    one of its materials.
    """
    last = reflection.transmittances.shape[1] - 1
    place = wp.clamp(cosine, 0.0, 1.0) * wp.float32(last)
    entry = wp.min(wp.int32(place), last - 1)
    t = place - wp.float32(entry)
    before = reflection.transmittances[finish, entry]
    return (1.0 - t) * before + t * reflection.transmittances[finish, entry + 1]


@wp.kernel
def scattering_vectors(
    pixels: Pixels, lights: Lights, light_index: wp.int32, towards: wp.array(dtype=wp.vec4f), reflection: Reflection,
    weight: wp.float64, counted: wp.float64, begins: wp.bool, resets: wp.bool, occluded: wp.array(dtype=wp.bool),
    first: wp.int32, run: wp.int32,
    scattering_vectors_out: wp.array(dtype=wp.vec3d), to_lights_out: wp.array(dtype=wp.vec3f),
    gains_out: wp.array(dtype=wp.float32), xyz_out: wp.array(dtype=wp.vec3f), coverage_out: wp.array(dtype=wp.float64),
    illuminated_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Compute scattering vectors, directions to the light and gains (geometry factors) of pixels under one light.

    All pixels that hit the mesh get a scattering vector; pixels that the light does not reach have a gain of 0. The
    kernel also adds the light that the pigment (base colour) reflects to ``xyz_out``, adds the number ``counted`` to
    ``coverage_out`` where a ray hits the mesh, and marks illuminated pixels in ``illuminated_out``. Empty arrays are
    not written. If ``begins`` is true, ``coverage_out`` and ``illuminated_out`` are set to 0 first. If ``resets`` is
    true, ``xyz_out`` is set to 0 first. ``occluded`` marks pixels in shadow; an empty array marks none. ``towards`` has
    a direction to the light and a weight per pixel; an empty array stands for the direction of the light.
    """
    place = lights.places[light_index]
    scale = weight * lights.strengths[light_index]
    thread, _ = wp.tid()
    begin = first + thread * run
    scattering_vectors_run(
        pixels, place, towards, reflection, scale, counted, begins, resets, occluded, begin, begin + run,
        scattering_vectors_out, to_lights_out, gains_out, xyz_out, coverage_out, illuminated_out,
    )  # fmt: skip
    if reflection.pigments.shape[0] == 0 or xyz_out.shape[0] == 0:
        return
    for i in range(begin, begin + run):
        if gains_out[i] > 0.0:
            cos_i = to_lights_out[i][2]
            cos_r = -wp.float32(scattering_vectors_out[i][2]) - cos_i
            finish = finish_of(reflection, pixels.face[i])
            under = transmittance(reflection, finish, cos_i)
            under = wp.cw_mul(under, transmittance(reflection, finish, cos_r))
            base = wp.vec3d(wp.cw_mul(pixels.base_colour[i], under))
            colour = lights.rgb_to_xyz * wp.cw_mul(base, lights.white_rgb[light_index])
            falloff = wp.float64(cos_i)
            if towards.shape[0] > 0:
                falloff *= wp.float64(towards[i][3])
            if place[3] != wp.float64(0.0):
                falloff = falloff / (wp.length_sq(away_from(place, pixels.shadow_origin[i])) + wp.float64(1.0e-8))
            strength = scale * reflection.units[finish] * reflection.pigments[finish]
            xyz_out[i] = xyz_out[i] + wp.vec3f(strength * falloff * colour)


@wp.func
def energy_factor(reflection: Reflection, surface: wp.int32, direction: wp.vec3f) -> wp.float32:
    """Return the energy normalisation of a surface for a direction in its frame: a factor from a table.

    With these factors, the powers of all diffraction orders of a perfect mirror sum to 1.
    """
    rows = reflection.energy.shape[1]
    columns = reflection.energy.shape[2]
    if rows == 0:
        return 1.0
    # The rows of the table of factors are equally spaced in √(1 − cos θ), nearly equally in θ. Its columns are equally
    # spaced in y/(|x| + |y|) within each quadrant. The row and the column of a direction are thus computed without
    # trigonometric functions.
    from_normal = wp.clamp((1.0 - direction[2]) * wp.static(1.0 / (1.0 - thresholds.LOWEST)), 0.0, 1.0)
    place = wp.sqrt(from_normal) * wp.float32(rows - 1)
    share = direction[1] / wp.max(wp.abs(direction[0]) + wp.abs(direction[1]), thresholds.TINY)
    turn = wp.where(direction[0] < 0.0, 2.0 - share, wp.where(share < 0.0, 4.0 + share, share))
    around = 0.25 * turn * wp.float32(columns)
    row = wp.clamp(wp.int32(place), 0, rows - 2)
    column = wp.clamp(wp.int32(around), 0, columns - 1)
    after = (column + 1) % columns
    s = place - wp.float32(row)
    t = around - wp.float32(column)
    upper = (1.0 - t) * reflection.energy[surface, row, column] + t * reflection.energy[surface, row, after]
    lower = (1.0 - t) * reflection.energy[surface, row + 1, column] + t * reflection.energy[surface, row + 1, after]
    return (1.0 - s) * upper + s * lower


@wp.kernel
def balance_energy(
    pixels: Pixels, scattering_vectors: wp.array(dtype=wp.vec3d), to_lights: wp.array(dtype=wp.vec3f),
    reflection: Reflection, first: wp.int32, run: wp.int32,
    gains_out: wp.array(dtype=wp.float32),
):  # fmt: skip
    """Multiply gains (geometry factors) by a(ωi) a(ωr): the powers of all orders of a perfect mirror then sum to 1."""
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        if gains_out[i] > 0.0:
            light = to_lights[i]
            surface = reflection.surfaces[finish_of(reflection, pixels.face[i])]
            both = energy_factor(reflection, surface, light) * energy_factor(
                reflection, surface, -wp.vec3f(scattering_vectors[i]) - light
            )
            gains_out[i] = both * gains_out[i]


@wp.kernel
def add_light_rotation(
    camera: Camera, surface: SurfaceArrays, pixels: Pixels, lights: Lights, light_index: wp.int32,
    deviation: wp.float32, first: wp.int32, run: wp.int32,
    footprints_out: wp.array(dtype=Footprint),
):  # fmt: skip
    """Add to footprints the change of (u, v) that the varying direction to a point light causes within a pixel."""
    place = lights.places[light_index]
    eye = wp.vec3f(camera.axes[0])
    back = wp.vec3f(camera.axes[3])
    steps = wp.vec2f(
        2.0 * deviation * wp.float32(camera.axes[4][0]) / wp.float32(camera.width),
        -2.0 * deviation * wp.float32(camera.axes[4][1]) / wp.float32(camera.height),
    )
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        if pixels.hit[i] == 0:
            continue
        face = pixels.face[i]
        corner = surface.positions[surface.faces[face, 0]]
        edge1 = surface.positions[surface.faces[face, 1]] - corner
        edge2 = surface.positions[surface.faces[face, 2]] - corner
        plane = wp.normalize(wp.cross(edge1, edge2))
        view = pixels.to_view[i]
        facing = wp.dot(plane, view)
        if facing < 0.0:
            plane = -plane
        facing = wp.max(wp.abs(facing), wp.static(LEAST_FACING))
        point = pixels.shadow_origin[i]
        scale = wp.float32(1.0)
        if not camera.orthographic:
            scale = wp.length(eye - point) * wp.dot(view, back)
        away = wp.vec3f(away_from(place, point))
        per_distance = 1.0 / wp.sqrt(wp.length_sq(away) + 1.0e-12)
        towards = per_distance * away
        footprint = footprints_out[i]
        for axis in range(2):
            step = steps[axis] * wp.vec3f(camera.axes[1 + axis])
            moved = scale * (step - (wp.dot(step, plane) / facing) * view)
            # Within the footprint, the surface point shifts by ``moved``. The unit vector to the light then changes by
            # −``rotated``. Because (u, v) contains this vector with a negative sign, (u, v) changes by +``rotated``.
            rotated = per_distance * (moved - wp.dot(towards, moved) * towards)
            footprint[2 * axis] = footprint[2 * axis] + wp.dot(pixels.tangent[i], rotated)
            footprint[2 * axis + 1] = footprint[2 * axis + 1] + wp.dot(pixels.bitangent[i], rotated)
        footprints_out[i] = footprint


@wp.func
def covariance_of(footprint: Footprint) -> wp.vec3f:
    """Return the entries uu, uv and vv of the covariance matrix of a footprint (range of (u, v) in a pixel)."""
    return wp.vec3f(
        footprint[0] * footprint[0] + footprint[2] * footprint[2],
        footprint[0] * footprint[1] + footprint[2] * footprint[3],
        footprint[1] * footprint[1] + footprint[3] * footprint[3],
    )


@wp.func
def footprint_from(covariance: wp.vec3f) -> Footprint:
    """Return a footprint that has the covariance matrix with the entries uu, uv and vv.

    A footprint is stored as two changes of (u, v), along rows and columns. A Cholesky factor of the covariance yields
    these two.
    """
    along = wp.sqrt(wp.max(covariance[0], 1.0e-20))
    beside = covariance[1] / along
    return Footprint(along, beside, 0.0, wp.sqrt(wp.max(covariance[2] - beside * beside, 0.0)))


@wp.kernel
def add_light_extent(
    lights: Lights, light_index: wp.int32, towards: wp.array(dtype=wp.vec4f), extent: wp.float32, pixels: Pixels,
    first: wp.int32, run: wp.int32,
    footprints_out: wp.array(dtype=Footprint),
):  # fmt: skip
    """Widen footprints in (u, v) by the extent of a light: the covariances of footprint and light are added.

    If ``towards`` is empty, the covariance is that of the whole light. Otherwise the light is a disc with sampled
    directions, which are in ``towards``. The covariance is then that of the Gaussian of one sample, with a standard
    deviation of ``extent`` radii of the disc.
    """
    own = 2.0 * extent * wp.length(lights.deviations[light_index, 0])
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        covariance = covariance_of(footprints_out[i])
        xx = covariance[0]
        xy = covariance[1]
        yy = covariance[2]
        for axis in range(2):
            deviation = lights.deviations[light_index, axis]
            x = wp.dot(deviation, pixels.tangent[i])
            y = wp.dot(deviation, pixels.bitangent[i])
            if towards.shape[0] > 0:
                # The Gaussian of a sample extends only perpendicularly to the sampled direction. The same covariance
                # along all axes is added here, and its part along the sampled direction is subtracted below.
                x = wp.where(axis == 0, own, 0.0)
                y = wp.where(axis == 1, own, 0.0)
            xx += x * x
            xy += x * y
            yy += y * y
        if towards.shape[0] > 0:
            direction = wp.vec3f(towards[i][0], towards[i][1], towards[i][2])
            x = own * wp.dot(direction, pixels.tangent[i])
            y = own * wp.dot(direction, pixels.bitangent[i])
            xx -= x * x
            xy -= x * y
            yy -= y * y
        footprints_out[i] = footprint_from(wp.vec3f(xx, xy, yy))


@wp.kernel
def add_source_extent(
    lights: Lights, light_index: wp.int32, pixels: Pixels, first: wp.int32, run: wp.int32,
    footprints_out: wp.array(dtype=Footprint),
):  # fmt: skip
    """Widen footprints in (u, v) by the extent of a light at a position, such as a disc.

    The two vectors in ``lights.deviations`` are standard deviations of the light's position along two axes.
    """
    place = lights.places[light_index]
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        away = wp.vec3f(away_from(place, pixels.shadow_origin[i]))
        per_distance = 1.0 / wp.sqrt(wp.length_sq(away) + 1.0e-12)
        towards = per_distance * away
        covariance = covariance_of(footprints_out[i])
        for axis in range(2):
            # If the position of the light changes, the direction to it changes by the perpendicular part of the
            # displacement, divided by the distance of the light.
            deviation = lights.deviations[light_index, axis]
            across = per_distance * (deviation - wp.dot(towards, deviation) * towards)
            x = wp.dot(across, pixels.tangent[i])
            y = wp.dot(across, pixels.bitangent[i])
            covariance += wp.vec3f(x * x, x * y, y * y)
        footprints_out[i] = footprint_from(covariance)


@wp.kernel
def select_finish(
    gains: wp.array(dtype=wp.float32), faces: wp.array(dtype=wp.int32), finishes: wp.array(dtype=wp.int32),
    finish: wp.int32, first: wp.int32, run: wp.int32,
    gains_out: wp.array(dtype=wp.float32),
):  # fmt: skip
    """Copy the gains of pixels with a given finish, and set the gains of all other pixels to 0.

    A gain is a geometry factor. A finish is a surface with one of its materials.
    """
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        gain = gains[i]
        if gain > 0.0 and finishes[faces[i]] != finish:
            gain = 0.0
        gains_out[i] = gain


@wp.kernel
def pixel_footprints(
    camera: Camera, surface: SurfaceArrays, pixels: Pixels, scattering_vectors: wp.array(dtype=wp.vec3d),
    deviation: wp.float32, first: wp.int32, run: wp.int32,
    footprints_out: wp.array(dtype=Footprint),
):  # fmt: skip
    """Compute the changes of (u, v) over one standard deviation of each ray's filter, which is ``deviation`` pixels."""
    thread, _ = wp.tid()
    begin = first + thread * run
    pixel_footprints_run(camera, surface, pixels, scattering_vectors, deviation, begin, begin + run, footprints_out)
