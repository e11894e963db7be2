"""Adaptive subdivision: kernels that estimate errors, add subpixel cells to pixels, and select levels of tiles.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

import warp as wp

from warpdiff.kernels import compile_options, refinement_levels

wp.set_module_options(compile_options.options("cell_splats.h"))

# Marks of pixels. A pixel marked ``ACTIVE`` is subdivided into cells. A pixel marked ``SHARED`` is not subdivided, but
# is a weighted sum over the cells of neighbouring pixels. A pixel with the mark 0 keeps the colour of its single ray.
ACTIVE = wp.constant(wp.uint8(1))
SHARED = wp.constant(wp.uint8(2))
# Bits that describe the cells of a tile (a subdivided pixel), as in kernels/native/cell_splats.h. LIT is set if at
# least one cell is illuminated. UNLIT is set if at least one cell hits the mesh but is dark. MISSED is set if at least
# one cell does not hit the mesh.
LIT = wp.constant(wp.uint8(1))
UNLIT = wp.constant(wp.uint8(2))
MISSED = wp.constant(wp.uint8(4))
CAUTION = wp.constant(wp.float32(refinement_levels.CAUTION))
EDGE_FACTOR = wp.constant(wp.float32(refinement_levels.EDGE_FACTOR))
# Level from which on a tile (a subdivided pixel) has enough samples to estimate the random scatter of its colour. The
# few samples of coarser tiles rarely include the brightest directions. Coarser tiles therefore use the mean scatter of
# nine tiles.
LEVEL_OF_OWN_SCATTER = wp.constant(wp.int32(3))
SCATTER_CAUTION = wp.constant(wp.float32(refinement_levels.SCATTER_CAUTION))
SCATTER_FACTOR = wp.constant(wp.float32(refinement_levels.SCATTER_FACTOR))
CONTRAST_BASE = wp.constant(wp.float32(refinement_levels.CONTRAST_BASE))
CONTRAST_PER_UNEVENNESS = wp.constant(wp.float32(refinement_levels.CONTRAST_PER_UNEVENNESS))
CONTRAST_PER_CHANGE = wp.constant(wp.float32(refinement_levels.CONTRAST_PER_CHANGE))
CONTRAST_OF_TEXTURE = wp.constant(wp.float32(refinement_levels.CONTRAST_OF_TEXTURE))
TINY = wp.constant(wp.float32(1.0e-30))
FILTER_SHARES = wp.constant(wp.vec3f(*refinement_levels.FILTER_SHARES))
ASLANT = wp.constant(wp.float32(refinement_levels.FILTER_SHARES[0] / refinement_levels.FILTER_SHARES[1]))


@wp.func
def signal_difference(scattering_vectors: wp.array(dtype=wp.vec3d), own: wp.int32, other: wp.int32) -> wp.vec2f:
    """Return the difference of (u, v) between the hits of two pixels."""
    moved = scattering_vectors[other] - scattering_vectors[own]
    return wp.vec2f(wp.float32(moved[0]), wp.float32(moved[1]))


@wp.func
def contrast_weight(scattering_vectors: wp.array(dtype=wp.vec3d), pixel: wp.int32, width: wp.int32) -> wp.float32:
    """Return the expected error of a pixel, divided by the contrast to its neighbours, from the changes of (u, v)."""
    left = signal_difference(scattering_vectors, pixel, pixel - 1)
    right = signal_difference(scattering_vectors, pixel, pixel + 1)
    above = signal_difference(scattering_vectors, pixel, pixel - width)
    below = signal_difference(scattering_vectors, pixel, pixel + width)
    along = wp.max(wp.length_sq(left), wp.length_sq(right)) + TINY
    down = wp.max(wp.length_sq(above), wp.length_sq(below)) + TINY
    # Unevenness is the second difference of (u, v) along rows, columns and diagonals, relative to the larger of the two
    # first differences.
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


@wp.kernel
def estimate_errors(
    colours: wp.array(dtype=wp.vec3f), scattering_vectors: wp.array(dtype=wp.vec3d), hit: wp.array(dtype=wp.int32),
    base_colours: wp.array(dtype=wp.vec3f), width: wp.int32, floor: wp.array(dtype=wp.float32), bound: wp.float32,
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
                        # Diagonal neighbours are included with a smaller weight: their weight in the pixel filter is
                        # small, but they may be far brighter than the pixel.
                        share = wp.where(line * side == 0, 1.0, ASLANT)
                        contrast2 = wp.max(contrast2, share * share * wp.length_sq(colours[other] - own))
        if beside == 0:
            # If no neighbour hits the mesh, the pixel's own colour replaces the contrast.
            contrast2 = wp.length_sq(own)
        weight = wp.float32(1.0)
        if met == 9:
            weight = contrast_weight(scattering_vectors, pixel, width)
        error = weight * wp.sqrt(contrast2)
        if base_colours.shape[0] > 0 and met > 1:
            change = base_colour_change(base_colours, hit, row, column, width, height)
            error = wp.max(error, CONTRAST_OF_TEXTURE * wp.sqrt(wp.min(contrast2, change * change * wp.length_sq(own))))
        errors_out[pixel] = wp.where(hit[pixel] != 0, error, 0.0)
        is_silhouette = met < around and subdivides_silhouettes
        is_active = met > 0 and (is_silhouette or error > bound * wp.max(wp.length(own), floor[0]))
        marks_out[pixel] = wp.where(is_active or all_pixels, ACTIVE, wp.uint8(0))


@wp.func_native(
    "warpdiff::splat_cells(colours, hit, pixels, colours_before, ranks, weights, level, is_base, is_sampled, "
    "begin, end, filtered_sums_out, quadrants_out, changes_out, levels_out, lighting_out);"
)
def splat_cells_run(
    colours: wp.array(dtype=wp.vec3f), hit: wp.array(dtype=wp.int32), pixels: wp.array(dtype=wp.int32),
    colours_before: wp.array(dtype=wp.vec3f), ranks: wp.array(dtype=wp.int32), weights: wp.array(dtype=wp.float32),
    level: wp.int32, is_base: wp.bool, is_sampled: wp.bool, begin: wp.int32, end: wp.int32,
    filtered_sums_out: wp.array2d(dtype=wp.vec4f), quadrants_out: wp.array2d(dtype=wp.vec3f),
    changes_out: wp.array(dtype=wp.float32), levels_out: wp.array(dtype=wp.uint8),
    lighting_out: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Add the cells of each pixel from ``begin`` to ``end`` to the sums for nine pixels: itself and its neighbours."""


@wp.kernel
def splat_cells(
    colours: wp.array(dtype=wp.vec3f), hit: wp.array(dtype=wp.int32), pixels: wp.array(dtype=wp.int32),
    colours_before: wp.array(dtype=wp.vec3f), ranks: wp.array(dtype=wp.int32), weights: wp.array(dtype=wp.float32),
    level: wp.int32, is_base: wp.bool, is_sampled: wp.bool, first: wp.int32, run: wp.int32,
    filtered_sums_out: wp.array2d(dtype=wp.vec4f), quadrants_out: wp.array2d(dtype=wp.vec3f),
    changes_out: wp.array(dtype=wp.float32), levels_out: wp.array(dtype=wp.uint8),
    lighting_out: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Sum the cells of pixels with the weights of the pixel filter, for each pixel and for the eight pixels around it.

    Args:
        colours: Colours of the cells, pixel after pixel and row by row.
        hit: Whether the cells hit the mesh.
        pixels: Indices of the pixels; −1 is no pixel.
        colours_before: Present colours of the picture: by one ray per pixel, or already from cells of an earlier group.
        ranks: For each pixel of the picture, its index in the outputs; empty if the pixel itself is the index.
        weights: Filter of one pixel along one axis, shape (3 · 2ⁿ,): values at the cells of the pixel before, of the
            pixel itself, and of the pixel after it.
        level: Level n of the cells, of which a pixel has 2ⁿ × 2ⁿ.
        is_base: Whether this is the base level, from whose cells the final level is selected.
        is_sampled: Whether each cell draws a random direction to the light. The final level then depends on the scatter
            of the colours.
        first: Index in ``pixels`` of the first entry of the first thread.
        run: Number of pixels per thread.
        filtered_sums_out: Sums of colours times weights, and sums of the weights, shape (n, 9): entry 3 i + j is for
            the pixel that is 1 − i rows below and 1 − j columns to the right.
        quadrants_out: Mean colours of the quadrants of each pixel, row by row, shape (n, 4), at the base level; cells
            that hit nothing count as black.
        changes_out: Differences ‖ΔXYZ‖ between the mean colours and ``colours_before``, at the base level. If
            ``is_sampled``, standard deviations of the mean colours, at any level.
        levels_out: The level of each tile, set to ``level``.
        lighting_out: Bits ``LIT``, ``UNLIT`` and ``MISSED`` of the cells.
    """
    thread, _ = wp.tid()
    begin = first + thread * run
    splat_cells_run(
        colours, hit, pixels, colours_before, ranks, weights, level, is_base, is_sampled, begin, begin + run,
        filtered_sums_out, quadrants_out, changes_out, levels_out, lighting_out,
    )  # fmt: skip


@wp.struct
class FilteredSums:
    """Sums over the cells of tiles (subdivided pixels), which ``splat_cells`` writes.

    The colours of quadrants and the changes of colour are computed at the base level.
    """

    filtered_sums: wp.array2d(dtype=wp.vec4f)
    quadrants: wp.array2d(dtype=wp.vec3f)
    levels: wp.array(dtype=wp.uint8)
    lighting: wp.array(dtype=wp.uint8)
    # For each subdivided pixel (tile), ``splat_cells`` writes the difference between the mean colour of its cells and
    # the colour by one ray. ``select_levels`` replaces this difference by the estimated error of 2 × 2 cells. For
    # sampled lights the array has the standard deviation of the mean instead.
    changes: wp.array(dtype=wp.float32)
    ranks: wp.array(dtype=wp.int32)
    # Factors that normalise sums over cells, for each level and each of three pixels in a row. A factor is the integral
    # of the pixel filter over one pixel, divided by the sum of the weights of the cells of that pixel.
    filter_normalisation: wp.array2d(dtype=wp.float32)


@wp.func
def compact_index(ranks: wp.array(dtype=wp.int32), pixel: wp.int32) -> wp.int32:
    """Return the index in the arrays of ``FilteredSums`` for a pixel of the picture."""
    result = pixel
    if ranks.shape[0] > 0:
        result = ranks[pixel]
    return result


@wp.func
def quadrant_at(
    sums: FilteredSums, levels: wp.array(dtype=wp.uint8), row: wp.int32, column: wp.int32, width: wp.int32,
    height: wp.int32,
) -> wp.vec4f:  # fmt: skip
    """Return the colour of a quadrant of a subdivided pixel, and 1 as a fourth number; four zeros for other pixels.

    ``row`` and ``column`` count quadrants of the picture, two per pixel.
    """
    result = wp.vec4f()
    if row >= 0 and row < 2 * height and column >= 0 and column < 2 * width:
        pixel = (row // 2) * width + column // 2
        if levels[pixel] != wp.uint8(0):
            colour = sums.quadrants[compact_index(sums.ranks, pixel), 2 * (row % 2) + column % 2]
            result = wp.vec4f(colour[0], colour[1], colour[2], 1.0)
    return result


@wp.func
def second_difference2(before: wp.vec4f, own: wp.vec3f, after: wp.vec4f) -> wp.float32:
    """Return the squared second difference of the colours of three quadrants; 0 without ``before`` or ``after``."""
    second = wp.vec3f(before[0], before[1], before[2]) - 2.0 * own + wp.vec3f(after[0], after[1], after[2])
    return wp.where(before[3] * after[3] > 0.0, wp.length_sq(second), 0.0)


@wp.kernel
def select_levels(
    sums: FilteredSums, tiles: wp.array(dtype=wp.int32), marks: wp.array(dtype=wp.uint8),
    colours: wp.array(dtype=wp.vec3f), width: wp.int32, height: wp.int32, floor: wp.array(dtype=wp.float32),
    tolerance: wp.float32, base: wp.int32, most: wp.int32, silhouette_level: wp.int32, first: wp.int32, run: wp.int32,
    changes_out: wp.array(dtype=wp.float32), levels_out: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Select the level of each subdivided pixel (tile), from a predicted change of its colour with finer cells.

    Args:
        sums: Sums over the cells of the base level. The prediction uses second differences of the colours of quadrants.
        tiles: Indices of the pixels that are tiles. If empty, they are all pixels of the picture with a level above 0.
        marks: Marks of the pixels of the picture; 0 for pixels that use no cells.
        colours: Colours of the picture, resolved from the cells of the base level.
        width: Number of pixels per row.
        height: Number of rows.
        floor: Lower limit of ‖XYZ‖ in the denominator of relative errors.
        tolerance: Largest relative error that pixels may have.
        base: Base level, whose cells have been shaded.
        most: Finest level that may be selected.
        silhouette_level: Least level of tiles at silhouettes of the mesh.
        first: Index in ``tiles`` of the first entry of the first thread.
        run: Number of tiles per thread.
        changes_out: Before the launch, differences of the mean colours of tiles from the colours by one ray.
            Afterwards, estimated errors ‖ΔXYZ‖ of 2 × 2 cells.
        levels_out: For each pixel of the picture, the level of its tile. The level 0 means that the pixel is no tile;
            it remains 0.
    """
    thread, _ = wp.tid()
    for k in range(first + thread * run, first + (thread + 1) * run):
        pixel = k
        if tiles.shape[0] > 0:
            pixel = tiles[k]
        # Other threads may have changed a neighbour's level already. This has no effect here: levels are only compared
        # with 0, and a level of 0 does not change.
        if levels_out[pixel] == wp.uint8(0):
            continue
        rank = compact_index(sums.ranks, pixel)
        row = pixel // width
        column = pixel % width
        square = wp.float32(0.0)
        for quadrant in range(4):
            own = sums.quadrants[rank, quadrant]
            y = 2 * row + quadrant // 2
            x = 2 * column + quadrant % 2
            square += second_difference2(
                quadrant_at(sums, levels_out, y - 1, x, width, height), own,
                quadrant_at(sums, levels_out, y + 1, x, width, height),
            )  # fmt: skip
            square += second_difference2(
                quadrant_at(sums, levels_out, y, x - 1, width, height), own,
                quadrant_at(sums, levels_out, y, x + 1, width, height),
            )  # fmt: skip
        # The variable ``second`` is half the root mean square of the second differences of colour at the four
        # quadrants. The difference from the colour by one ray may be small by chance. It is therefore limited to the
        # range from half of ``second`` to ``second``.
        second = 0.5 * wp.sqrt(0.25 * square)
        change = wp.clamp(changes_out[rank], 0.5 * second, second)
        need = wp.float32(0.0)
        lighting = wp.uint8(0)
        for line in range(3):
            for side in range(3):
                y = row + 1 - line
                x = column + 1 - side
                if y >= 0 and y < height and x >= 0 and x < width:
                    there = y * width + x
                    if levels_out[there] != wp.uint8(0):
                        lighting = lighting | sums.lighting[compact_index(sums.ranks, there)]
                    if marks[there] != wp.uint8(0):
                        share = FILTER_SHARES[line] * FILTER_SHARES[side]
                        need = wp.max(need, share / wp.max(wp.length(colours[there]), floor[0]))
        is_dark_in_part = (lighting & (UNLIT | MISSED)) != wp.uint8(0)
        if is_dark_in_part and (lighting & LIT) != wp.uint8(0):
            change = change * EDGE_FACTOR
        changes_out[rank] = change
        # To select a level, errors are assumed to be proportional to n⁻², where n is the number of cells along an axis.
        # For reported errors, a proportionality to n^−ERROR_ORDER is assumed, which predicts larger errors. The level
        # is rounded to a whole number.
        cells = 2.0 * wp.sqrt(CAUTION * need * change / tolerance)
        level = wp.clamp(wp.int32(wp.floor(wp.log2(wp.max(cells, 1.0)) + 0.5)), base, most)
        if (lighting & MISSED) != wp.uint8(0) and (lighting & (LIT | UNLIT)) != wp.uint8(0):
            level = wp.max(level, wp.min(silhouette_level, most))
        levels_out[pixel] = wp.uint8(level)


@wp.func
def mean_scatter(
    sums: FilteredSums, levels: wp.array(dtype=wp.uint8), row: wp.int32, column: wp.int32, width: wp.int32,
    height: wp.int32,
) -> wp.float32:  # fmt: skip
    """Return the root mean square of the random scatter of a tile (subdivided pixel) and its neighbours.

    The squares are weighted by the pixel filter.
    """
    square = wp.float32(0.0)
    weight = wp.float32(0.0)
    for line in range(wp.max(1 - row, 0), wp.min(height + 1 - row, 3)):
        for side in range(wp.max(1 - column, 0), wp.min(width + 1 - column, 3)):
            there = (row + line - 1) * width + column + side - 1
            if levels[there] != wp.uint8(0):
                share = FILTER_SHARES[line] * FILTER_SHARES[side]
                change = sums.changes[compact_index(sums.ranks, there)]
                square += share * change * change
                weight += share
    return wp.sqrt(square / weight)


@wp.kernel
def raise_levels(
    sums: FilteredSums, tiles: wp.array(dtype=wp.int32), marks: wp.array(dtype=wp.uint8),
    colours: wp.array(dtype=wp.vec3f), errors: wp.array(dtype=wp.float32), width: wp.int32, height: wp.int32,
    floor: wp.array(dtype=wp.float32), tolerance: wp.float32, level: wp.int32, most: wp.int32, first: wp.int32,
    run: wp.int32,
    levels_out: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Raise the levels of tiles (subdivided pixels) at ``level`` that cause errors of pixels above the tolerance.

    The new levels follow from a prediction of how fast the random scatter decreases with more cells. ``errors`` has the
    estimated errors of pixels. The other arguments are those of :func:`select_levels`. ``colours`` and ``errors`` are
    resolved from the cells of tiles at levels up to ``level``.
    """
    thread, _ = wp.tid()
    for k in range(first + thread * run, first + (thread + 1) * run):
        pixel = k
        if tiles.shape[0] > 0:
            pixel = tiles[k]
        if levels_out[pixel] != wp.uint8(level):
            continue
        row = pixel // width
        column = pixel % width
        scatter = sums.changes[compact_index(sums.ranks, pixel)]
        if level < LEVEL_OF_OWN_SCATTER:
            scatter = mean_scatter(sums, levels_out, row, column, width, height)
        excess = wp.float32(1.0)
        for line in range(wp.max(1 - row, 0), wp.min(height + 1 - row, 3)):
            for side in range(wp.max(1 - column, 0), wp.min(width + 1 - column, 3)):
                there = (row + line - 1) * width + column + side - 1
                if marks[there] != wp.uint8(0):
                    # More cells of this tile (subdivided pixel) cannot reduce the error that the other eight tiles
                    # cause.
                    share = FILTER_SHARES[line] * FILTER_SHARES[side]
                    error = wp.min(errors[there], SCATTER_CAUTION * SCATTER_FACTOR * share * scatter)
                    excess = wp.max(excess, error / (tolerance * wp.max(wp.length(colours[there]), floor[0])))
        steps = wp.int32(wp.floor(wp.log2(excess) + 0.5))
        levels_out[pixel] = wp.uint8(wp.clamp(level + steps, level, most))


@wp.kernel
def resolve_pixels(
    sums: FilteredSums, pixels: wp.array(dtype=wp.int32), marks: wp.array(dtype=wp.uint8), width: wp.int32,
    height: wp.int32, error_order: wp.float32, error_factor: wp.float32, first: wp.int32, run: wp.int32,
    colours_out: wp.array(dtype=wp.vec3f), errors_out: wp.array(dtype=wp.float32),
    coverage_out: wp.array(dtype=wp.float64), coverage_levels_out: wp.array(dtype=wp.uint8),
    illuminated_out: wp.array(dtype=wp.bool), edges_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Set pixels to weighted sums over the cells of nine tiles, which are at the pixel and around it; estimate errors.

    Args:
        sums: Sums over the cells of the tiles (subdivided pixels).
        pixels: Indices of the pixels that use cells. If empty, they are all pixels of the picture with a mark.
        marks: Marks of the pixels of the picture; 0 for pixels that use no cells.
        width: Number of pixels per row.
        height: Number of rows.
        error_order: Exponent p of the assumption that errors are proportional to n^−p, with n cells along an axis.
        error_factor: Factor from the root sum of squares of the nine tiles' errors to the estimated error of the pixel.
        first: Index in ``pixels`` of the first entry of the first thread.
        run: Number of pixels per thread.
        colours_out: Colours; where the mesh covers a part of the pixel, the rest counts as black.
        errors_out: Estimated errors, ‖ΔXYZ‖.
        coverage_out: Share of each pixel that the mesh covers. Each light has cells of its own; the share of the finest
            cells among all lights is stored.
        coverage_levels_out: Sum of the levels of the nine tiles of the light whose cells determined ``coverage_out``. A
            light with a larger sum has finer cells and replaces the share.
        illuminated_out: True is written where light reaches at least one cell.
        edges_out: True is written where an edge of the mesh or of a shadow passes through an illuminated pixel.
    """
    thread, _ = wp.tid()
    for k in range(first + thread * run, first + (thread + 1) * run):
        pixel = k
        if pixels.shape[0] > 0:
            pixel = pixels[k]
        if marks[pixel] == wp.uint8(0):
            continue
        row = pixel // width
        column = pixel % width
        # If the nine tiles (subdivided pixels) have the same level, the sum over all cells is divided by the sum of all
        # weights (``together``). This result is closest to the pixel filter. Otherwise the sum over each tile is scaled
        # to the tile's share of the filter (``apart``). Without this scaling, steps between levels would be visible.
        least = wp.int32(refinement_levels.MOST_LEVEL)
        most = wp.int32(0)
        all_levels = wp.int32(0)
        together = wp.vec4f()
        apart = wp.vec4f()
        weight_together = wp.float32(0.0)
        weight_apart = wp.float32(0.0)
        square = wp.float32(0.0)
        for line in range(wp.max(1 - row, 0), wp.min(height + 1 - row, 3)):
            for side in range(wp.max(1 - column, 0), wp.min(width + 1 - column, 3)):
                there = compact_index(sums.ranks, (row + line - 1) * width + column + side - 1)
                level = wp.int32(sums.levels[there])
                least = wp.min(least, level)
                most = wp.max(most, level)
                all_levels += level
                share = FILTER_SHARES[line] * FILTER_SHARES[side]
                per_weight = sums.filter_normalisation[level, line] * sums.filter_normalisation[level, side]
                part = sums.filtered_sums[there, 3 * line + side]
                together += part
                weight_together += share / per_weight
                apart += per_weight * part
                weight_apart += share
                error = share * sums.changes[there] * wp.pow(0.5, error_order * wp.float32(level - 1))
                square += error * error
        # Near the edge of the picture, fewer than nine tiles exist. The sum of colours is divided by the sum of the
        # weights of the existing tiles.
        total = together / weight_together
        if least != most:
            total = apart / weight_apart
        colour = wp.vec3f(total[0], total[1], total[2])
        colours_out[pixel] = colour
        errors_out[pixel] = error_factor * wp.sqrt(square)
        own = compact_index(sums.ranks, pixel)
        # Lights have cells of different levels. The coverage of a pixel must not depend on the order of lights. It is
        # computed from the finest cells. If two lights have equally fine cells, the larger coverage is used.
        coverage = wp.float64(wp.min(total[3], wp.float32(1.0)))
        before = wp.int32(coverage_levels_out[pixel])
        if all_levels > before or (all_levels == before and coverage > coverage_out[pixel]):
            coverage_out[pixel] = coverage
            coverage_levels_out[pixel] = wp.uint8(all_levels)
        if wp.length_sq(colour) > wp.float32(0.0):
            illuminated_out[pixel] = True
            edges_out[pixel] = edges_out[pixel] or (sums.lighting[own] & (UNLIT | MISSED)) != wp.uint8(0)


@wp.kernel
def accumulate(
    colours: wp.array(dtype=wp.vec3f), errors: wp.array(dtype=wp.float32), illuminated: wp.array(dtype=wp.bool),
    first: wp.int32, run: wp.int32,
    xyz_out: wp.array(dtype=wp.vec3f), errors_out: wp.array(dtype=wp.float32), illuminated_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Add the colours, errors and illuminated pixels of one part of the lights to the sums over all parts."""
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        xyz_out[i] = xyz_out[i] + colours[i]
        errors_out[i] = errors_out[i] + errors[i]
        illuminated_out[i] = illuminated_out[i] or illuminated[i]
