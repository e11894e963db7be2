"""Lists of steep pixels, made and worked off where the picture is: no host has a part in it."""

import warp as wp

from warpdiff import supersample
from warpdiff.kernels import spectral
from warpdiff.kernels.native import take_number

wp.set_module_options(spectral.OPTIONS)

# Luminances are told apart by the bits of their float32 above so many: sign, exponent, and seven bits of the fraction,
# a 128th. Groups of these bins are counted, too, so that one thread finds a bin among them.
BELOW = wp.constant(wp.uint32(16))
GROUPS = wp.constant(512)
BINS = wp.constant(64)
FLOOR = wp.constant(wp.float32(supersample.FLOOR))
EXCEEDED_BY = wp.constant(wp.float32(supersample.EXCEEDED_BY))
TINY = wp.constant(wp.float32(supersample.TINY))


@wp.kernel
def tally(
    # In:
    colours: wp.array(dtype=wp.vec3f),
    gains: wp.array(dtype=wp.float32),
    apart: wp.int32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    tallies_out: wp.array(dtype=wp.int32),
):
    """How often luminances occur among every so many pixels that are lit: by groups, and then by bins."""
    for k in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        i = k * apart
        if gains[i] > 0.0:
            luminance = wp.max(colours[i][1], wp.float32(0.0))
            place = wp.int32(wp.cast(luminance, wp.uint32) >> BELOW)
            take_number(tallies_out, place // BINS)
            take_number(tallies_out, GROUPS + place)


@wp.kernel
def find_floor(
    # In:
    tallies: wp.array(dtype=wp.int32),
    # Out:
    floor_out: wp.array(dtype=wp.float32),
):
    """A picture's floor, by one thread."""
    total = wp.int32(0)
    for k in range(GROUPS):
        total += tallies[k]
    left = EXCEEDED_BY * wp.float32(total)
    group = wp.int32(GROUPS - 1)
    while group > 0 and wp.float32(tallies[group]) <= left:
        left -= wp.float32(tallies[group])
        group -= 1
    place = wp.int32((group + 1) * BINS - 1)
    while place > group * BINS and wp.float32(tallies[GROUPS + place]) <= left:
        left -= wp.float32(tallies[GROUPS + place])
        place -= 1
    # The middle of the bin.
    bright = wp.cast((wp.uint32(2 * place + 1)) << (BELOW - wp.uint32(1)), wp.float32)
    floor_out[0] = wp.max(FLOOR * bright, TINY)


@wp.kernel
def list_up(
    # In:
    classes: wp.array(dtype=wp.uint8),
    first: wp.int32,
    run: wp.int32,
    # Out:
    lists_out: wp.array2d(dtype=wp.int32),
    counts_out: wp.array(dtype=wp.int32),
):
    """The pixels of each class of ``classify`` from 2 on, in whatever order: colours do not depend on those beside.

    Their numbers are counted, and at the end that of all which are lit.
    """
    for i in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        kind = wp.int32(classes[i]) - 2
        if kind >= 0:
            lists_out[kind, take_number(counts_out, kind)] = i
        if kind >= -1:
            take_number(counts_out, lists_out.shape[0])


@wp.kernel
def take(
    # In:
    lists: wp.array2d(dtype=wp.int32),
    counts: wp.array(dtype=wp.int32),
    taken: wp.array(dtype=wp.int32),
    kind: wp.int32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    pixels_out: wp.array(dtype=wp.int32),
):
    """The next pixels of a list, and −1 where there are no more."""
    for k in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        place = taken[kind] + k
        pixels_out[k] = -1
        if place < counts[kind]:
            pixels_out[k] = lists[kind, place]


@wp.kernel
def go_on(
    # In:
    counts: wp.array(dtype=wp.int32),
    kind: wp.int32,
    count: wp.int32,
    # Out:
    taken_out: wp.array(dtype=wp.int32),
    left_out: wp.array(dtype=wp.int32),
):
    """Count those that were taken, and tell whether any are left."""
    taken_out[kind] += count
    left_out[0] = wp.int32(0)
    if taken_out[kind] < counts[kind]:
        left_out[0] = wp.int32(1)
