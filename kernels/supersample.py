"""Which pixels differ so much from those beside them that their footprint wants more rays, and what these see."""

import warp as wp

from warpdiff.kernels import spectral

wp.set_module_options(spectral.OPTIONS)


@wp.kernel
def contrast(
    # In:
    colours: wp.array(dtype=wp.vec3f),
    gains: wp.array(dtype=wp.float32),
    width: wp.int32,
    floor: wp.float32,
    first: wp.int32,
    # Out:
    contrast_out: wp.array(dtype=wp.float32),
    surrounded_out: wp.array(dtype=wp.bool),
):
    """Largest difference of a lit pixel from those beside it, and whether they are all lit.

    It is relative to the pixel itself, or to ``floor``, if that is more.
    """
    i = first + wp.tid()
    largest = wp.float32(0.0)
    surrounded = bool(True)
    if gains[i] > 0.0:
        for side in range(4):
            beside = i + 1
            inside = (i + 1) % width > 0
            if side == 1:
                beside = i - 1
                inside = i % width > 0
            if side == 2:
                beside = i + width
                inside = beside < gains.shape[0]
            if side == 3:
                beside = i - width
                inside = beside >= 0
            if inside:
                if gains[beside] > 0.0:
                    largest = wp.max(largest, wp.length(colours[beside] - colours[i]))
                else:
                    surrounded = False
    contrast_out[i] = largest / wp.max(wp.length(colours[i]), floor)
    surrounded_out[i] = surrounded


@wp.kernel
def gather(
    # In:
    colours: wp.array(dtype=wp.vec3f),
    hit: wp.array(dtype=wp.int32),
    tiles: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.float32),
    first: wp.int32,
    # Out:
    colours_out: wp.array(dtype=wp.vec3f),
):
    """Set the colours of pixels to the means over the rays of their tiles that meet the mesh."""
    tile = first + wp.tid()
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
    # Out:
    xyz_out: wp.array(dtype=wp.vec3f),
):
    """Add colours to others."""
    i = first + wp.tid()
    xyz_out[i] = xyz_out[i] + colours[i]
