"""Dots of grating maps: scattering vectors, directions to the light and footprints in the frame of each dot's cell.

A grating map divides a surface into rectangles of its texture coordinates (dots). Each dot shows a copy of one height
field (the cell of the map) with another direction, depth and pitch. A dot with its cell turned by φ, with heights times
d and lengths times p, has the power spectrum of the cell at (p R(−φ) (u, v), d w). Here (u, v, w) is the scattering
vector, and R is a rotation. Gains (geometry factors) are computed from the directions at the surface before this
transformation.
"""

import warp as wp

from warpdiff.kernels import compile_options, refinement_levels
from warpdiff.kernels.footprints import LEAST_FACING
from warpdiff.kernels.pixel_contrast import ACTIVE
from warpdiff.kernels.structs import Camera, Footprint, Pixels, SurfaceArrays

wp.set_module_options(compile_options.options("dot_transforms.h"))

# Offset that is added to (u, v) from one dot of a grating map to the next. Refinement estimates errors of pixels from
# changes of (u, v) between them. The value was chosen far above the largest |(u, v)|, which is 2. With any such value,
# the estimated error between two neighbouring dots is the full difference of their colours.
SIGNAL_OF_DOT = wp.constant(wp.float64(64.0))
# Share of the pixel filter that lies beyond the neighbouring pixels on one side, more than 1 pixel from the centre. It
# was derived from the filter: a Gaussian with a standard deviation of 0.5 pixel that is truncated at 1.5 pixels.
SHARE_BEYOND_NEIGHBOURS = wp.constant(wp.float32(refinement_levels.share_beyond(1.0)))


@wp.func_native(
    f"warpdiff::find_dots(camera, mesh, pixels, rows, columns, repeats, across, {LEAST_FACING}f, begin, end, dots_out, "
    "shares_out);"
)
def find_dots_run(
    camera: Camera, mesh: SurfaceArrays, pixels: Pixels, rows: wp.int32, columns: wp.int32, repeats: wp.bool,
    across: wp.int32, begin: wp.int32, end: wp.int32, dots_out: wp.array(dtype=wp.int32),
    shares_out: wp.array(dtype=wp.vec4f),
):  # fmt: skip
    """Find the dots of a grating map at the hits from ``begin`` to ``end``."""


@wp.kernel
def find_dots(
    camera: Camera, mesh: SurfaceArrays, pixels: Pixels, rows: wp.int32, columns: wp.int32, repeats: wp.bool,
    across: wp.int32, first: wp.int32, run: wp.int32,
    dots_out: wp.array(dtype=wp.int32), shares_out: wp.array(dtype=wp.vec4f),
):  # fmt: skip
    """Find the first dot of the subpixel cell of each ray, the dot with the smallest u and v, and the cell's shares.

    A dot is a rectangle of a grating map. Its index is its row times ``columns`` plus its column; −1 without a hit. The
    map ``repeats`` if its surface has texture coordinates beyond 0 to 1. A pixel has ``across`` subpixel cells per
    side.

    ``shares_out`` are the shares of the subpixel cell in the first dot, in the next dot along u, in the next dot along
    v, and in the next dot along both. A subpixel cell that overlaps more dots has a single one, with the share 1.
    """
    thread, _ = wp.tid()
    begin = first + thread * run
    find_dots_run(camera, mesh, pixels, rows, columns, repeats, across, begin, begin + run, dots_out, shares_out)


@wp.func
def is_on_surface(
    faces: wp.array(dtype=wp.int32), ray: wp.int32, surfaces: wp.array(dtype=wp.int32), surface: wp.int32
):
    """Return whether a ray hits a face of a surface. ``surfaces`` is empty if all faces have the same surface."""
    if surfaces.shape[0] == 0:
        return True
    return surfaces[faces[ray]] == surface


@wp.kernel
def transform_samples(
    transforms: wp.array2d(dtype=wp.vec4f), dots: wp.array(dtype=wp.int32), shares: wp.array(dtype=wp.vec4f),
    part: wp.int32, faces: wp.array(dtype=wp.int32), surfaces: wp.array(dtype=wp.int32), surface: wp.int32,
    scattering_vectors: wp.array(dtype=wp.vec3d),
    to_lights: wp.array(dtype=wp.vec3f), footprints: wp.array(dtype=Footprint), first: wp.int32, run: wp.int32,
    scattering_vectors_out: wp.array(dtype=wp.vec3d), to_lights_out: wp.array(dtype=wp.vec3f),
    footprints_out: wp.array(dtype=Footprint),
):  # fmt: skip
    """Transform the scattering vectors at hits on a surface with a grating map to the frames of its dots.

    Directions to the light and footprints are transformed, too. A dot is a rectangle of the map with its own pitch p,
    turn φ and depth d, relative to one height field. A subpixel cell overlaps up to four dots, and a launch transforms
    the samples for one of them. For the first dot, results are 0 where nothing is transformed. For the second to fourth
    dot, results are written only for subpixel cells that overlap this dot. These are few. All other rays have the gain
    0 later, and are not looked up.

    Args:
        transforms: Transform of each dot, shape (rows, columns): p cos φ, p sin φ, d, and p relative to the smallest p
            of the map.
        dots: Index of the first dot of each ray; −1 without a hit.
        shares: Shares of the ray's subpixel cell in up to four dots, see :func:`find_dots`.
        part: Index of the dot in ``shares``, from 0 to 3.
        faces: Face that each ray hits.
        surfaces: Surface of each face; empty if all faces have the same surface.
        surface: Index of the surface with the map.
        scattering_vectors: (u, v, w) of the rays.
        to_lights: Unit vectors to the light in the surface's frame.
        footprints: Changes of (u, v) over one standard deviation of the filter, along rows and columns; or empty.
        first: Index of the first thread's first ray.
        run: Number of rays per thread.
        scattering_vectors_out: (p R(−φ) (u, v), d w).
        to_lights_out: Directions to the light, turned by −φ. Their length is the pitch scale relative to the smallest
            one of the map.
        footprints_out: Changes of p R(−φ) (u, v); not written if ``footprints`` is empty.
    """
    thread, _ = wp.tid()
    rows = transforms.shape[0]
    columns = transforms.shape[1]
    for i in range(first + thread * run, first + (thread + 1) * run):
        if part > 0 and shares[i][part] == 0.0:
            continue
        dot = wp.vec4f()
        per_pitch = wp.float32(0.0)
        if dots[i] >= 0 and shares[i][part] > 0.0:
            if is_on_surface(faces, i, surfaces, surface):
                dot = transforms[
                    (dots[i] // columns + rows - part // 2) % rows, (dots[i] % columns + part % 2) % columns
                ]
                per_pitch = dot[3] / wp.sqrt(dot[0] * dot[0] + dot[1] * dot[1])
        vector = scattering_vectors[i]
        x = wp.float64(dot[0])
        y = wp.float64(dot[1])
        scattering_vectors_out[i] = wp.vec3d(
            x * vector[0] + y * vector[1], x * vector[1] - y * vector[0], wp.float64(dot[2]) * vector[2]
        )
        light = to_lights[i]
        cosine = per_pitch * dot[0]
        sine = per_pitch * dot[1]
        to_lights_out[i] = wp.vec3f(
            cosine * light[0] + sine * light[1], cosine * light[1] - sine * light[0], dot[3] * light[2]
        )
        if footprints.shape[0] > 0:
            change = footprints[i]
            footprints_out[i] = Footprint(
                dot[0] * change[0] + dot[1] * change[1], dot[0] * change[1] - dot[1] * change[0],
                dot[0] * change[2] + dot[1] * change[3], dot[0] * change[3] - dot[1] * change[2],
            )  # fmt: skip


@wp.kernel
def scale_gains(
    ratios: wp.array(dtype=wp.float32), scattering_vectors: wp.array(dtype=wp.vec3d),
    gains: wp.array(dtype=wp.float32), shares: wp.array(dtype=wp.vec4f), part: wp.int32, first: wp.int32,
    run: wp.int32,
    gains_out: wp.array(dtype=wp.float32),
):  # fmt: skip
    """Multiply gains (geometry factors) by the share of a dot in a subpixel cell, and by a ratio of reflectances.

    The ratio is the luminance of a reflectance at the angle θd, relative to normal incidence. θd is half the angle
    between light and viewer, so that cos θd = |(u, v, w)|/2. ``ratios`` has the values at equidistant cos θd from 0 to
    1; if the array is empty, there is no such factor. ``part`` is the index of the dot in ``shares``, see
    :func:`find_dots`.
    """
    thread, _ = wp.tid()
    last = ratios.shape[0] - 1
    for i in range(first + thread * run, first + (thread + 1) * run):
        gain = gains[i] * shares[i][part]
        if last > 0 and gain > 0.0:
            place = wp.min(0.5 * wp.float32(wp.length(scattering_vectors[i])), 1.0) * wp.float32(last)
            entry = wp.min(wp.int32(place), last - 1)
            t = place - wp.float32(entry)
            gain *= (1.0 - t) * ratios[entry] + t * ratios[entry + 1]
        gains_out[i] = gain


@wp.kernel
def weigh_gains(
    to_lights: wp.array(dtype=wp.vec3f), gains: wp.array(dtype=wp.float32), octaves: wp.float32, per_octave: wp.float32,
    first: wp.int32, run: wp.int32,
    gains_out: wp.array(dtype=wp.float32),
):  # fmt: skip
    """Multiply gains by the weight of one colour table in a cubic interpolation over the pitch scale of dots.

    A dot is a rectangle of a grating map with a scaled copy of one height field (the cell). The length of a direction
    to the light is the pitch scale of the dot, relative to the smallest one of the map. Tables are equidistant in the
    logarithm of the pitch scale. The weight is Lagrange's: at most four tables have a weight for a dot, and some
    weights are negative.

    Args:
        to_lights: Directions to the light in the frames of the cells.
        gains: Geometry factors of the samples.
        octaves: Binary logarithm of the pitch scale of which the table has the exact colours.
        per_octave: Number of interpolation steps per factor of two of the pitch scale. The weight is 1 at the pitch
            scale of the table, and 0 at all other whole numbers of steps from it.
        first: Index of the first thread's first sample.
        run: Number of samples per thread.
        gains_out: Geometry factors multiplied by the weight.
    """
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        # Few subpixel cells overlap more than one dot. For the second to fourth dot, most gains are therefore 0. These
        # are not weighed, because the logarithm would take most of the time.
        if gains[i] == 0.0:
            gains_out[i] = 0.0
            continue
        place = wp.log2(wp.max(wp.length(to_lights[i]), 1.0))
        t = wp.abs(place - octaves) * per_octave
        weight = wp.float32(0.0)
        if t < 1.0:
            weight = 0.5 * (1.0 - t * t) * (2.0 - t)
        elif t < 2.0:
            weight = (1.0 - t) * (2.0 - t) * (3.0 - t) / 6.0
        gains_out[i] = gains[i] * weight


@wp.kernel
def signals_of_dots(
    dots: wp.array(dtype=wp.int32), columns: wp.int32, faces: wp.array(dtype=wp.int32),
    surfaces: wp.array(dtype=wp.int32), surface: wp.int32, scattering_vectors: wp.array(dtype=wp.vec3d),
    begins: wp.bool, first: wp.int32, run: wp.int32,
    signals_out: wp.array(dtype=wp.vec3d),
):  # fmt: skip
    """Copy scattering vectors, with an offset on a grating map that differs between neighbouring dots.

    A dot is a rectangle of the map. Refinement compares the written vectors of neighbouring pixels. A large difference
    indicates that colours may change unevenly from one pixel to the next. The arguments are those of
    :func:`transform_samples`. If ``begins`` is false, only the results of hits on the surface with the map are written.
    """
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        has_dot = wp.bool(False)
        if dots[i] >= 0:
            has_dot = is_on_surface(faces, i, surfaces, surface)
        if has_dot:
            row = wp.float64(dots[i] // columns)
            column = wp.float64(dots[i] % columns)
            signals_out[i] = scattering_vectors[i] + SIGNAL_OF_DOT * wp.vec3d(column, row, wp.float64(0.0))
        elif begins:
            signals_out[i] = scattering_vectors[i]


@wp.kernel
def mark_edges_of_dots(
    signals: wp.array(dtype=wp.vec3d), colours: wp.array(dtype=wp.vec3f), hit: wp.array(dtype=wp.int32),
    width: wp.int32, floor: wp.array(dtype=wp.float32), bound: wp.float32, first: wp.int32, run: wp.int32,
    errors_out: wp.array(dtype=wp.float32), marks_out: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Mark pixels for subdivision because of dots that ``pixel_contrast.estimate_errors`` does not find.

    A dot is a rectangle of a grating map. ``estimate_errors`` compares the colours of a pixel and of the eight pixels
    around it. The filter of a pixel extends half a pixel further, so that a bright dot two pixels away contributes to
    the pixel. If dots are smaller than pixels, some dots are between the rays of neighbouring pixels. All pixels with
    such small dots are subdivided.

    Args:
        signals: Results of :func:`signals_of_dots`.
        colours: Colours of the pixels of the picture, row by row.
        hit: Whether the pixels hit the mesh.
        width: Number of pixels per row.
        floor: Lower limit of ‖XYZ‖ in the denominator of relative errors.
        bound: Relative error above which pixels are subdivided.
        first: Index of the first pixel of the first thread.
        run: Number of pixels per thread.
        errors_out: Estimated errors. They are increased to at least the error that dots two pixels away may cause.
        marks_out: ``ACTIVE`` is written for pixels to subdivide.
    """
    thread, _ = wp.tid()
    height = hit.shape[0] // width
    for pixel in range(first + thread * run, first + (thread + 1) * run):
        if hit[pixel] == 0 or marks_out[pixel] != wp.uint8(0):
            continue
        row = pixel // width
        column = pixel - row * width
        contrast2 = wp.float32(0.0)
        skips_dots = wp.bool(False)
        for y in range(wp.max(row - 2, 0), wp.min(row + 3, height)):
            for x in range(wp.max(column - 2, 0), wp.min(column + 3, width)):
                other = y * width + x
                if hit[other] != 0:
                    moved = signals[other] - signals[pixel]
                    if wp.length(moved) > wp.float64(0.5) * SIGNAL_OF_DOT:
                        if wp.abs(y - row) + wp.abs(x - column) == 1:
                            most = wp.max(wp.abs(moved[0]), wp.abs(moved[1]))
                            skips_dots = skips_dots or most > wp.float64(1.5) * SIGNAL_OF_DOT
                        contrast2 = wp.max(contrast2, wp.length_sq(colours[other] - colours[pixel]))
        error = SHARE_BEYOND_NEIGHBOURS * wp.sqrt(contrast2)
        errors_out[pixel] = wp.max(errors_out[pixel], error)
        if skips_dots or error > bound * wp.max(wp.length(colours[pixel]), floor[0]):
            marks_out[pixel] = ACTIVE
