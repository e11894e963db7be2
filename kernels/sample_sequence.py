"""Sample sequence: random numbers for the samples of a light, stratified over neighbouring cells and pixels.

Samples of neighbouring cells (subpixels) and pixels are consecutive in one (0, 2) sequence along a Morton curve. Errors
then look like fine grain (Ahmed and Wonka, Screen-space blue-noise diffusion of Monte Carlo sampling error via
hierarchical ordering of pixels, 2020). The sequence is scrambled by the method of Burley (Practical hash-based Owen
scrambling, 2020).
"""

import warp as wp

# Seeds of the hashes that scramble the sequence. ``ORDER_SEED`` and ``ORDER_SEED_OF_FILTER`` shuffle the order of the
# samples; the other seeds scramble the coordinates of the samples. Seeds whose names contain FILTER are for points of
# the pixel filter; the other seeds are for directions to the light.
ORDER_SEED, ORDER_SEED_OF_FILTER = wp.constant(wp.uint32(0x9E3779B9)), wp.constant(wp.uint32(0x7F4A7C15))
SEED_X, SEED_Y = wp.constant(wp.uint32(0x85EBCA6B)), wp.constant(wp.uint32(0xC2B2AE35))
SEED_FILTER_X, SEED_FILTER_Y = wp.constant(wp.uint32(0x27D4EB2F)), wp.constant(wp.uint32(0x165667B1))
# Multipliers of the hash of Laine and Karras. The multipliers are even, so that a bit is flipped depending on lower
# bits only.
MIX_1, MIX_2 = wp.constant(wp.uint32(0x6C50B47C)), wp.constant(wp.uint32(0xB82F1E52))
MIX_3, MIX_4 = wp.constant(wp.uint32(0xC7AFE638)), wp.constant(wp.uint32(0x8D22F6E6))
PER_UNIT = wp.constant(wp.float32(2.0**-24))


@wp.func
def reverse_bits(value: wp.uint32) -> wp.uint32:
    """Return the bits of an integer in reverse order."""
    x = value
    x = ((x >> wp.uint32(1)) & wp.uint32(0x55555555)) | ((x & wp.uint32(0x55555555)) << wp.uint32(1))
    x = ((x >> wp.uint32(2)) & wp.uint32(0x33333333)) | ((x & wp.uint32(0x33333333)) << wp.uint32(2))
    x = ((x >> wp.uint32(4)) & wp.uint32(0x0F0F0F0F)) | ((x & wp.uint32(0x0F0F0F0F)) << wp.uint32(4))
    x = ((x >> wp.uint32(8)) & wp.uint32(0x00FF00FF)) | ((x & wp.uint32(0x00FF00FF)) << wp.uint32(8))
    return (x >> wp.uint32(16)) | (x << wp.uint32(16))


@wp.func
def owen_scramble(value: wp.uint32, seed: wp.uint32) -> wp.uint32:
    """Flip each bit or not, depending on a hash of the higher bits: the hash of Laine and Karras, on reversed bits."""
    x = reverse_bits(value)
    x += seed
    x ^= x * MIX_1
    x ^= x * MIX_2
    x ^= x * MIX_3
    x ^= x * MIX_4
    return reverse_bits(x)


@wp.func
def second_sobol(index: wp.uint32) -> wp.uint32:
    """Return the second coordinate of Sobol's sequence: Pascal's matrix modulo 2 times the bits of the index."""
    x = index
    x ^= x >> wp.uint32(16)
    x ^= (x >> wp.uint32(8)) & wp.uint32(0x00FF00FF)
    x ^= (x >> wp.uint32(4)) & wp.uint32(0x0F0F0F0F)
    x ^= (x >> wp.uint32(2)) & wp.uint32(0x33333333)
    x ^= (x >> wp.uint32(1)) & wp.uint32(0x55555555)
    return reverse_bits(x)


@wp.func
def spread_bits(value: wp.uint32) -> wp.uint32:
    """Move the lower 16 bits of an integer to the even bit positions."""
    x = value & wp.uint32(0x0000FFFF)
    x = (x | (x << wp.uint32(8))) & wp.uint32(0x00FF00FF)
    x = (x | (x << wp.uint32(4))) & wp.uint32(0x0F0F0F0F)
    x = (x | (x << wp.uint32(2))) & wp.uint32(0x33333333)
    return (x | (x << wp.uint32(1))) & wp.uint32(0x55555555)


@wp.func
def morton_index(column: wp.int32, row: wp.int32) -> wp.uint32:
    """Return the position of a subpixel cell of the picture on a Morton curve, from its column and row."""
    return spread_bits(wp.uint32(column)) | (spread_bits(wp.uint32(row)) << wp.uint32(1))


@wp.func
def sample_point(index: wp.uint32, order_seed: wp.uint32, seed_x: wp.uint32, seed_y: wp.uint32) -> wp.vec2f:
    """Return the point with the index ``index`` in a shuffled and scrambled (0, 2) sequence, in [0, 1)²."""
    shuffled = owen_scramble(index, order_seed)
    x = owen_scramble(reverse_bits(shuffled), seed_x)
    y = owen_scramble(second_sobol(shuffled), seed_y)
    return wp.vec2f(
        PER_UNIT * wp.float32(x >> wp.uint32(8)),
        PER_UNIT * wp.float32(y >> wp.uint32(8)),
    )


@wp.func
def sample_index(
    tiles: wp.array(dtype=wp.int32), width: wp.int32, across: wp.int32, ray: wp.int32, sample: wp.int32,
    samples: wp.int32,
) -> wp.uint32:  # fmt: skip
    """Return the index in the (0, 2) sequence for one of the samples of a ray.

    Args:
        tiles: Pixels that are divided into subpixel cells with one ray each; if empty, each pixel of the picture has
            one ray.
        width: Number of pixels per row.
        across: Number of subpixel cells along a side of a pixel.
        ray: Index of the ray.
        sample: Index of the sample among the ``samples`` of each ray.
        samples: Number of samples per ray.
    """
    pixel = ray
    row = wp.int32(0)
    column = wp.int32(0)
    if tiles.shape[0] > 0:
        cells = across * across
        pixel = tiles[ray // cells]
        row = (ray % cells) // across
        column = ray % across
    row += pixel // width * across
    column += pixel % width * across
    return morton_index(column, row) * wp.uint32(samples) + wp.uint32(sample)


@wp.func
def light_point(index: wp.uint32) -> wp.vec2f:
    """Return the two random numbers that select a direction of the light."""
    return sample_point(index, ORDER_SEED, SEED_X, SEED_Y)


@wp.func
def filter_point(index: wp.uint32) -> wp.vec2f:
    """Return the two random numbers that select a point of the pixel filter."""
    return sample_point(index, ORDER_SEED_OF_FILTER, SEED_FILTER_X, SEED_FILTER_Y)
