"""Estimated errors of pixels with one ray each, from the contrast to their neighbours; marks of pixels to subdivide."""

import warp as wp

from warpdiff.kernels import compile_options, refinement_levels

wp.set_module_options(compile_options.options())

# Marks of pixels. ``ACTIVE`` pixels are selected for subdivision into subpixel cells with one ray each; their
# neighbours are subdivided, too. A ``SHARED`` pixel is not selected, but it uses the cells that it and its eight
# neighbours have. A pixel with the mark 0 keeps the colour of its one ray.
ACTIVE = wp.constant(wp.uint8(1))
SHARED = wp.constant(wp.uint8(2))
CONTRAST_BASE = wp.constant(wp.float32(refinement_levels.CONTRAST_BASE))
CONTRAST_PER_UNEVENNESS = wp.constant(wp.float32(refinement_levels.CONTRAST_PER_UNEVENNESS))
CONTRAST_PER_CHANGE = wp.constant(wp.float32(refinement_levels.CONTRAST_PER_CHANGE))
CONTRAST_OF_TEXTURE = wp.constant(wp.float32(refinement_levels.CONTRAST_OF_TEXTURE))
# The difference of roughness between two pixels is divided by the roughness, or by this number if it is larger. The
# value was chosen because surfaces with smaller roughnesses look alike in a picture.
LEAST_ROUGHNESS = wp.constant(wp.float32(0.05))
# Largest relative change of colour that textures cause. The value is limited by float32: its square times the square of
# a colour must be finite.
MOST_CHANGE = wp.constant(wp.float32(1.0e6))
TINY = wp.constant(wp.float32(1.0e-30))
ASLANT = wp.constant(wp.float32(refinement_levels.FILTER_SHARES[0] / refinement_levels.FILTER_SHARES[1]))


@wp.func
def signal_difference(scattering_vectors: wp.array(dtype=wp.vec3d), own: wp.int32, other: wp.int32) -> wp.vec2f:
    """Return the difference of (u, v) between the hits of two pixels."""
    moved = scattering_vectors[other] - scattering_vectors[own]
    return wp.vec2f(wp.float32(moved[0]), wp.float32(moved[1]))


@wp.func
def contrast_weight(scattering_vectors: wp.array(dtype=wp.vec3d), pixel: wp.int32, width: wp.int32) -> wp.float32:
    """Return the expected ratio of a pixel's error to its contrast, the largest colour difference to a neighbour.

    The ratio is predicted from the changes of (u, v) between the pixel and its neighbours.
    """
    left = signal_difference(scattering_vectors, pixel, pixel - 1)
    right = signal_difference(scattering_vectors, pixel, pixel + 1)
    above = signal_difference(scattering_vectors, pixel, pixel - width)
    below = signal_difference(scattering_vectors, pixel, pixel + width)
    along = wp.max(wp.length_sq(left), wp.length_sq(right)) + TINY
    down = wp.max(wp.length_sq(above), wp.length_sq(below)) + TINY
    # Unevenness is the second difference of (u, v) from pixel to pixel, along rows, columns and diagonals. It is
    # relative to the larger of the two first differences. (u, v) is the tangential part of the scattering vector.
    aslant2 = wp.max(
        wp.max(
            wp.length_sq(signal_difference(scattering_vectors, pixel, pixel - width - 1) - left - above),
            wp.length_sq(signal_difference(scattering_vectors, pixel, pixel - width + 1) - right - above),
        ),
        wp.max(
            wp.length_sq(signal_difference(scattering_vectors, pixel, pixel + width - 1) - left - below),
            wp.length_sq(signal_difference(scattering_vectors, pixel, pixel + width + 1) - right - below),
        ),
    )
    most = wp.max(along, down)
    uneven2 = wp.max(wp.max(wp.length_sq(left + right) / along, wp.length_sq(above + below) / down), aslant2 / most)
    own = scattering_vectors[pixel]
    uv2 = wp.max(wp.float32(own[0] * own[0] + own[1] * own[1]), 1.0e-6)
    return wp.min(
        CONTRAST_BASE + CONTRAST_PER_UNEVENNESS * wp.sqrt(uneven2) + CONTRAST_PER_CHANGE * wp.sqrt(most / uv2), 1.0
    )


@wp.func
def base_colour_change(
    base_colours: wp.array(dtype=wp.vec3f), hit: wp.array(dtype=wp.int32), row: wp.int32, column: wp.int32,
    width: wp.int32, height: wp.int32,
) -> wp.float32:  # fmt: skip
    """Return the largest difference of base colour between a pixel and its neighbours, relative to its base colour."""
    own = base_colours[row * width + column]
    change2 = wp.float32(0.0)
    for y in range(wp.max(row - 1, 0), wp.min(row + 2, height)):
        for x in range(wp.max(column - 1, 0), wp.min(column + 2, width)):
            if hit[y * width + x] != 0:
                change2 = wp.max(change2, wp.length_sq(base_colours[y * width + x] - own))
    return wp.sqrt(change2 / wp.max(wp.length_sq(own), TINY))


@wp.func
def map_change(
    metallic_roughness: wp.array(dtype=wp.vec4f), emission: wp.array(dtype=wp.vec3f), hit: wp.array(dtype=wp.int32),
    row: wp.int32, column: wp.int32, width: wp.int32, height: wp.int32,
) -> wp.float32:  # fmt: skip
    """Return the largest relative change of colour to a neighbouring pixel that textures of plain surfaces may cause.

    The peak of a highlight is proportional to roughness⁻⁴. Its relative change is four times that of the roughness.
    """
    own = metallic_roughness[row * width + column]
    emitted = emission[row * width + column]
    change = wp.float32(0.0)
    for y in range(wp.max(row - 1, 0), wp.min(row + 2, height)):
        for x in range(wp.max(column - 1, 0), wp.min(column + 2, width)):
            if hit[y * width + x] != 0:
                other = metallic_roughness[y * width + x]
                of_roughness = 4.0 * wp.abs(other[1] - own[1]) / wp.max(own[1], LEAST_ROUGHNESS)
                of_emission = wp.length(emission[y * width + x] - emitted) / wp.max(wp.length(emitted), TINY)
                change = wp.max(change, of_roughness + wp.abs(other[0] - own[0]) + of_emission)
    return change


@wp.kernel
def estimate_errors(
    colours: wp.array(dtype=wp.vec3f), scattering_vectors: wp.array(dtype=wp.vec3d), hit: wp.array(dtype=wp.int32),
    base_colours: wp.array(dtype=wp.vec3f), metallic_roughness: wp.array(dtype=wp.vec4f),
    emission: wp.array(dtype=wp.vec3f), width: wp.int32, floor: wp.array(dtype=wp.float32), bound: wp.float32,
    all_pixels: wp.bool, subdivides_silhouettes: wp.bool, first: wp.int32, run: wp.int32,
    errors_out: wp.array(dtype=wp.float32), marks_out: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Estimate the errors ‖ΔXYZ‖ of pixels with one ray each, and mark the pixels to subdivide.

    The contrast of a pixel is the largest difference of its colour from the colour of a neighbouring pixel. Pixels that
    do not hit the mesh do not count as neighbours.

    Args:
        colours: Colours of the pixels of the picture, row by row.
        scattering_vectors: Scattering vectors of the pixels, (u, v, w).
        hit: Whether the pixels hit the mesh.
        base_colours: Base colours of the pixels, linear RGB; empty without textures.
        metallic_roughness: Metallic and roughness of textures at the pixels; empty without such textures.
        emission: Emission of textures at the pixels, linear RGB; empty without such textures.
        width: Number of pixels per row.
        floor: Lower limit of ‖XYZ‖ in the denominator of relative errors.
        bound: Relative error above which pixels are subdivided. With a negative bound, all pixels that hit the mesh are
            subdivided, and all pixels next to them.
        all_pixels: Whether all pixels of the picture are subdivided, because a cell may hit the mesh although the ray
            of the pixel does not.
        subdivides_silhouettes: Whether pixels are subdivided if the ray of only one of two neighbours hits the mesh.
        first: Index of the first pixel of the first thread.
        run: Number of pixels per thread.
        errors_out: Estimated errors; 0 where a pixel does not hit the mesh.
        marks_out: ``ACTIVE`` for pixels to subdivide, otherwise 0.
    """
    thread, _ = wp.tid()
    height = hit.shape[0] // width
    for pixel in range(first + thread * run, first + (thread + 1) * run):
        if hit[pixel] == 0 and not subdivides_silhouettes and not all_pixels:
            errors_out[pixel] = 0.0
            marks_out[pixel] = wp.uint8(0)
            continue
        row = pixel // width
        column = pixel - row * width
        own = wp.where(hit[pixel] != 0, colours[pixel], wp.vec3f())
        around = wp.int32(0)
        met = wp.int32(0)
        beside = wp.int32(0)
        contrast2 = wp.float32(0.0)
        for line in range(-1, 2):
            for side in range(-1, 2):
                y = row + line
                x = column + side
                if y >= 0 and y < height and x >= 0 and x < width:
                    other = y * width + x
                    around += 1
                    if hit[other] != 0:
                        met += 1
                        if line * side == 0 and line != side:
                            beside += 1
                        # Diagonal neighbours are included: the weight of a diagonal neighbour in the pixel filter is
                        # small, but the neighbour may be far brighter.
                        share = wp.where(line * side == 0, 1.0, ASLANT)
                        contrast2 = wp.max(contrast2, share * share * wp.length_sq(colours[other] - own))
        if beside == 0:
            # If none of the neighbours to the left, right, top and bottom hits the mesh, the pixel's own colour
            # replaces the contrast.
            contrast2 = wp.length_sq(own)
        weight = wp.float32(1.0)
        if met == 9:
            weight = contrast_weight(scattering_vectors, pixel, width)
        error = weight * wp.sqrt(contrast2)
        if hit[pixel] != 0 and met > 1 and (base_colours.shape[0] > 0 or emission.shape[0] > 0):
            change = wp.float32(0.0)
            if base_colours.shape[0] > 0:
                change = base_colour_change(base_colours, hit, row, column, width, height)
            if emission.shape[0] > 0:
                of_maps = map_change(metallic_roughness, emission, hit, row, column, width, height)
                change = wp.min(change + of_maps, MOST_CHANGE)
            error = wp.max(error, CONTRAST_OF_TEXTURE * wp.sqrt(wp.min(contrast2, change * change * wp.length_sq(own))))
        errors_out[pixel] = wp.where(hit[pixel] != 0, error, 0.0)
        is_silhouette = met < around and subdivides_silhouettes
        is_active = met > 0 and (is_silhouette or error > bound * wp.max(wp.length(own), floor[0]))
        marks_out[pixel] = wp.where(is_active or all_pixels, ACTIVE, wp.uint8(0))
