"""Adaptive subdivision: kernels that add subpixel cells to pixels, estimate errors, and select levels of tiles.

A tile is a pixel that is divided into subpixel cells. At level n, a tile has 2ⁿ × 2ⁿ cells. The base level is the level
of the first cells of a tile.
"""

import warp as wp

from warpdiff.kernels import compile_options, refinement_levels

wp.set_module_options(compile_options.options("cell_splats.h"))

# Bits that describe the cells of a tile (a subdivided pixel), as in kernels/native/cell_splats.h. LIT is set if at
# least one cell is illuminated. UNLIT is set if at least one cell hits the mesh but is dark. MISSED is set if at least
# one cell does not hit the mesh.
LIT = wp.constant(wp.uint8(1))
UNLIT = wp.constant(wp.uint8(2))
MISSED = wp.constant(wp.uint8(4))
CAUTION = wp.constant(wp.float32(refinement_levels.CAUTION))
EDGE_FACTOR = wp.constant(wp.float32(refinement_levels.EDGE_FACTOR))
# Level from which on a tile (a subdivided pixel) has enough samples to estimate the random scatter of its colour. The
# few samples of a tile at a lower level rarely include the brightest directions. Such tiles therefore use the mean
# scatter of nine tiles.
LEVEL_OF_OWN_SCATTER = wp.constant(wp.int32(3))
SCATTER_CAUTION = wp.constant(wp.float32(refinement_levels.SCATTER_CAUTION))
SCATTER_FACTOR = wp.constant(wp.float32(refinement_levels.SCATTER_FACTOR))
FILTER_SHARES = wp.constant(wp.vec3f(*refinement_levels.FILTER_SHARES))


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
    """Add the colours of the cells of subdivided pixels from ``begin`` to ``end`` to these pixels and neighbours."""


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
        colours_before: Present colours of the picture: by one ray per pixel, or by cells that were computed earlier.
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
        levels_out: The level of each pixel of ``pixels``, set to ``level``.
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

    The colours of quadrants and the changes of colour are computed at the base level, from the first cells of a tile.
    """

    filtered_sums: wp.array2d(dtype=wp.vec4f)
    quadrants: wp.array2d(dtype=wp.vec3f)
    levels: wp.array(dtype=wp.uint8)
    lighting: wp.array(dtype=wp.uint8)
    # For each subdivided pixel (tile), ``splat_cells`` writes the difference between the mean colour of its cells and
    # the colour by one ray. ``select_levels`` replaces this difference by the estimated error of 2 × 2 cells. For
    # lights with random directions, the array has the standard deviation of the mean instead.
    changes: wp.array(dtype=wp.float32)
    ranks: wp.array(dtype=wp.int32)
    # Factors that normalise sums over cells, for each level n (2ⁿ × 2ⁿ cells per pixel) and each of three pixels in a
    # row. A factor is the integral of the pixel filter over one pixel, divided by the sum of the weights of the cells
    # of that pixel.
    filter_normalisation: wp.array2d(dtype=wp.float32)


@wp.func
def compact_index(ranks: wp.array(dtype=wp.int32), pixel: wp.int32) -> wp.int32:
    """Return the index of a pixel of the picture in the arrays of ``FilteredSums``."""
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
    """Return the squared second difference of the colours of three neighbouring quadrants; 0 if one does not exist."""
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
        # Other threads may have changed the refinement level of a neighbouring pixel already. This has no effect here:
        # levels are only compared with 0, and a level of 0 does not change.
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
        # To select a level, errors are assumed to be proportional to n⁻², where n is the number of subpixel cells along
        # an axis. For reported errors, a proportionality to n^−ERROR_ORDER is assumed, which predicts larger errors.
        # The level is rounded to a whole number.
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

    The scatter of a tile is the standard deviation of its mean colour. The squares are weighted by the pixel filter.
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
                    # More cells of this tile (subdivided pixel) cannot reduce the part of the error that the eight
                    # tiles around it cause.
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
        coverage_out: Share of each pixel that the mesh covers. Each light has separate cells; the share by the smallest
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
    """Add colours, errors and marks of illuminated pixels under one light, or a part of it, to sums over all lights."""
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        xyz_out[i] = xyz_out[i] + colours[i]
        errors_out[i] = errors_out[i] + errors[i]
        illuminated_out[i] = illuminated_out[i] or illuminated[i]
