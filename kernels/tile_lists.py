"""Tile lists: the pixels to subdivide are listed and counted on the device, without the host."""

import warp as wp

from warpdiff.kernels import compile_options, refinement_levels, thresholds
from warpdiff.kernels.atomics import atomic_increment
from warpdiff.kernels.pixel_contrast import SHARED

wp.set_module_options(compile_options.options("atomics.h"))

# The histogram of luminances has GROUPS groups of BINS bins each. The index of a bin is the upper half of the bits of a
# luminance in float32: sign, exponent and seven bits of the fraction. The BELOW lower bits are ignored. Counts of
# groups are also stored, so that one thread finds a percentile in few steps.
BELOW = wp.constant(wp.uint32(16))
GROUPS = wp.constant(512)
BINS = wp.constant(64)
FLOOR = wp.constant(wp.float32(thresholds.FLOOR))
BRIGHTEST_SHARE = wp.constant(wp.float32(refinement_levels.BRIGHTEST_SHARE))
TINY = wp.constant(wp.float32(thresholds.TINY))


@wp.kernel
def luminance_histogram(
    colours: wp.array(dtype=wp.vec3f), illuminated: wp.array(dtype=wp.bool), first: wp.int32, run: wp.int32,
    histogram_out: wp.array(dtype=wp.int32),
):  # fmt: skip
    """Count illuminated pixels by luminance, in the bins of a histogram and in groups of bins."""
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        if illuminated[i]:
            luminance = wp.max(colours[i][1], wp.float32(0.0))
            place = wp.int32(wp.cast(luminance, wp.uint32) >> BELOW)
            atomic_increment(histogram_out, place // BINS)
            atomic_increment(histogram_out, GROUPS + place)


@wp.kernel
def luminance_floor(
    histogram: wp.array(dtype=wp.int32),
    floor_out: wp.array(dtype=wp.float32),
):
    """Compute the floor of relative errors from the histogram of luminances. The kernel runs on one thread.

    The error of a pixel is divided by ‖XYZ‖, or by the floor if the floor is larger.
    """
    total = wp.int32(0)
    for k in range(GROUPS):
        total += histogram[k]
    left = BRIGHTEST_SHARE * wp.float32(total)
    group = wp.int32(GROUPS - 1)
    while group > 0 and wp.float32(histogram[group]) <= left:
        left -= wp.float32(histogram[group])
        group -= 1
    place = wp.int32((group + 1) * BINS - 1)
    while place > group * BINS and wp.float32(histogram[GROUPS + place]) <= left:
        left -= wp.float32(histogram[GROUPS + place])
        place -= 1
    # The percentile of the luminance is estimated as the middle of the histogram's bin in which the percentile lies.
    bright = wp.cast((wp.uint32(2 * place + 1)) << (BELOW - wp.uint32(1)), wp.float32)
    floor_out[0] = wp.max(FLOOR * bright, TINY)


@wp.kernel
def count_marks(
    marks: wp.array(dtype=wp.uint8),
    first: wp.int32,
    run: wp.int32,
    counts_out: wp.array(dtype=wp.int32),
):
    """Count the pixels that are selected for subdivision into cells: those with a mark other than 0."""
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        if marks[i] != wp.uint8(0):
            atomic_increment(counts_out, 0)


@wp.kernel
def running_max(
    counts: wp.array(dtype=wp.int32),
    begins: wp.bool,
    most_out: wp.array(dtype=wp.int32),
):
    """Replace the output by a count of pixels if the count is larger, or in any case if ``begins`` is true."""
    most_out[0] = wp.where(begins, counts[0], wp.max(counts[0], most_out[0]))


@wp.func
def marks_around(marks: wp.array(dtype=wp.uint8), pixel: wp.int32, width: wp.int32, height: wp.int32) -> wp.vec2ub:
    """Return the least and the largest mark of a pixel and its eight neighbours."""
    column = pixel % width
    row = pixel // width
    least = marks[pixel]
    most = marks[pixel]
    for y in range(wp.max(row - 1, 0), wp.min(row + 2, height)):
        for x in range(wp.max(column - 1, 0), wp.min(column + 2, width)):
            least = wp.min(least, marks[y * width + x])
            most = wp.max(most, marks[y * width + x])
    return wp.vec2ub(least, most)


@wp.kernel
def dilate_marks(
    marks: wp.array(dtype=wp.uint8), width: wp.int32, height: wp.int32, level: wp.uint8, first: wp.int32,
    run: wp.int32,
    levels_out: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Set the refinement level of marked pixels and of their neighbours to ``level``, and of all other pixels to 0."""
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        is_near = marks_around(marks, i, width, height)[1] != wp.uint8(0)
        levels_out[i] = wp.where(is_near, level, wp.uint8(0))


@wp.kernel
def mark_shared(
    levels: wp.array(dtype=wp.uint8), width: wp.int32, height: wp.int32, first: wp.int32, run: wp.int32,
    marks_out: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Mark a pixel as ``SHARED`` if it has no mark, but it and its eight neighbours have refinement levels above 0."""
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        if marks_out[i] == wp.uint8(0) and marks_around(levels, i, width, height)[0] != wp.uint8(0):
            marks_out[i] = SHARED


@wp.kernel
def compact_level(
    levels: wp.array(dtype=wp.uint8), level: wp.uint8, first: wp.int32, run: wp.int32,
    pixels_out: wp.array(dtype=wp.int32), counts_out: wp.array(dtype=wp.int32),
):  # fmt: skip
    """List the pixels whose refinement level is ``level``.

    The order of the pixels is arbitrary, because tiles (subdivided pixels) do not depend on each other.
    """
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        if levels[i] == level:
            pixels_out[atomic_increment(counts_out, 0)] = i


@wp.kernel
def copy_batch(
    pixels: wp.array(dtype=wp.int32), counts: wp.array(dtype=wp.int32), copied: wp.array(dtype=wp.int32),
    first: wp.int32, run: wp.int32,
    pixels_out: wp.array(dtype=wp.int32),
):  # fmt: skip
    """Copy the next pixels of a list to the batch of pixels whose subpixel cells are computed next.

    If the list is too short, the remaining entries of the batch are −1.
    """
    for k in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        place = copied[0] + k
        pixels_out[k] = -1
        if place < counts[0]:
            pixels_out[k] = pixels[place]


@wp.kernel
def advance_batch(
    counts: wp.array(dtype=wp.int32),
    count: wp.int32,
    copied_out: wp.array(dtype=wp.int32),
    has_more_out: wp.array(dtype=wp.int32),
):
    """Add ``count`` to the number of pixels of a list that were copied, and store whether pixels of the list remain."""
    copied_out[0] += count
    has_more_out[0] = wp.int32(0)
    if copied_out[0] < counts[0]:
        has_more_out[0] = wp.int32(1)
