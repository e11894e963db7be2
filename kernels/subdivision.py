"""Adaptive subdivision: errors of pixels, splatting of cells, and selection of pixels for the next level."""

import warp as wp

from warpdiff.kernels import compile_options, refinement_levels

wp.set_module_options(compile_options.options("cell_splats.h"))

# Marks of pixels that are to be split, and of those that need not be but have cells, their own and all around; 0 is for
# all others.
ACTIVE = wp.constant(wp.uint8(1))
CONVERGED = wp.constant(wp.uint8(2))
CONTRAST_BASE = wp.constant(wp.float32(refinement_levels.CONTRAST_BASE))
CONTRAST_PER_UNEVENNESS = wp.constant(wp.float32(refinement_levels.CONTRAST_PER_UNEVENNESS))
CONTRAST_PER_CHANGE = wp.constant(wp.float32(refinement_levels.CONTRAST_PER_CHANGE))
TINY = wp.constant(wp.float32(1.0e-30))
FILTER_SHARES = wp.constant(wp.vec3f(*refinement_levels.FILTER_SHARES))
ASLANT = wp.constant(wp.float32(refinement_levels.FILTER_SHARES[0] / refinement_levels.FILTER_SHARES[1]))
# What penumbrae err by, of the root sum of squares of lobes that are hidden one after the other.
ERROR_PER_LOBE = wp.constant(wp.float32(0.2))


@wp.struct
class Unevenness:
    """What rays see."""

    scattering_vectors: wp.array(dtype=wp.vec3d)
    mirrored: wp.array(dtype=wp.vec3f)  # under a sky, directions to the light by way of a mirror
    estimates: wp.array(dtype=wp.vec2f)  # under a sky, what colours err by as they change over footprints; or empty


@wp.func
def signal_difference(hits: Unevenness, own: wp.int32, other: wp.int32) -> wp.vec3f:
    """By how much (u, v), or under a sky the light's direction, differs from one pixel to another."""
    if hits.estimates.shape[0] > 0:
        return hits.mirrored[other] - hits.mirrored[own]
    moved = hits.scattering_vectors[other] - hits.scattering_vectors[own]
    return wp.vec3f(wp.float32(moved[0]), wp.float32(moved[1]), 0.0)


@wp.func
def contrast_weight(hits: Unevenness, pixel: wp.int32, width: wp.int32) -> wp.float32:
    """What a pixel's error is taken to be of its contrast, by how (u, v) changes from it to the eight around."""
    left = signal_difference(hits, pixel, pixel - 1)
    right = signal_difference(hits, pixel, pixel + 1)
    above = signal_difference(hits, pixel, pixel - width)
    below = signal_difference(hits, pixel, pixel + width)
    along = wp.max(wp.length_sq(left), wp.length_sq(right)) + TINY
    down = wp.max(wp.length_sq(above), wp.length_sq(below)) + TINY
    # By how much changes along rows, columns and aslant are not those before, relative to the larger one.
    aslant2 = wp.max(
        wp.max(
            wp.length_sq(signal_difference(hits, pixel, pixel - width - 1) - left - above),
            wp.length_sq(signal_difference(hits, pixel, pixel - width + 1) - right - above),
        ),
        wp.max(
            wp.length_sq(signal_difference(hits, pixel, pixel + width - 1) - left - below),
            wp.length_sq(signal_difference(hits, pixel, pixel + width + 1) - right - below),
        ),
    )
    most = wp.max(along, down)
    uneven2 = wp.max(wp.max(wp.length_sq(left + right) / along, wp.length_sq(above + below) / down), aslant2 / most)
    if hits.estimates.shape[0] > 0:
        return wp.min(CONTRAST_BASE + CONTRAST_PER_UNEVENNESS * wp.sqrt(uneven2), 1.0)
    own = hits.scattering_vectors[pixel]
    uv2 = wp.max(wp.float32(own[0] * own[0] + own[1] * own[1]), 1.0e-6)
    return wp.min(
        CONTRAST_BASE + CONTRAST_PER_UNEVENNESS * wp.sqrt(uneven2) + CONTRAST_PER_CHANGE * wp.sqrt(most / uv2), 1.0
    )


@wp.kernel
def estimate_errors(
    # In:
    colours: wp.array(dtype=wp.vec3f), hits: Unevenness, hit: wp.array(dtype=wp.int32), width: wp.int32,
    floor: wp.array(dtype=wp.float32), bound: wp.float32, all_pixels: wp.bool, subdivides_silhouettes: wp.bool,
    first: wp.int32, run: wp.int32,
    # Out:
    errors_out: wp.array(dtype=wp.float32), marks_out: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Estimated errors of pixels of one ray each, ‖ΔXYZ‖, and which of them are to be split.

    What does not meet the mesh differs in nothing from the pixel beside it, and is black.

    Args:
        colours: Theirs, of whole rows.
        hits: What their rays see.
        hit: Whether they meet the mesh.
        width: Pixels in a row.
        floor: What errors are relative to at least.
        bound: Of errors relative to the colour, or to the floor, from which pixels are split.
        all_pixels: Whether all are split, also where only cells may meet the mesh.
        subdivides_silhouettes: Whether those are beside which the mesh ends.
        first: The first thread's pixel.
        run: How many a thread takes.
        errors_out: 0 where nothing is met.
        marks_out: 1 for those to be split, otherwise 0.
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
                        # What is aslant has less of the filter than what is beside, and may be far brighter.
                        share = wp.where(line * side == 0, 1.0, ASLANT)
                        contrast2 = wp.max(contrast2, share * share * wp.length_sq(colours[other] - own))
        if beside == 0:
            # Nothing tells of a pixel by itself.
            contrast2 = wp.length_sq(own)
        weight = wp.float32(1.0)
        if met == 9:
            weight = contrast_weight(hits, pixel, width)
        error = weight * wp.sqrt(contrast2)
        if hits.estimates.shape[0] > 0:
            error = wp.max(error, hits.estimates[pixel][0])
        errors_out[pixel] = wp.where(hit[pixel] != 0, error, 0.0)
        is_silhouette = met < around and subdivides_silhouettes
        is_active = met > 0 and (is_silhouette or error > bound * wp.max(wp.length(own), floor[0]))
        marks_out[pixel] = wp.uint8(wp.where(is_active or all_pixels, 1, 0))


@wp.kernel
def add_occluded_power(
    # In:
    occluded: wp.array(dtype=wp.bool), strengths: wp.array(dtype=wp.vec2d), lobe: wp.int32, begins: wp.bool,
    first: wp.int32, run: wp.int32,
    # Out:
    shadow_out: wp.array(dtype=wp.float32),
):  # fmt: skip
    """Add a lobe's strength to what is hidden from pixels, which ``begins`` with the first."""
    strength = wp.float32(strengths[lobe][0])
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        shadow = wp.where(begins, 0.0, shadow_out[i])
        shadow_out[i] = wp.where(occluded[i], shadow + strength, shadow)


@wp.kernel
def add_penumbra_error(
    # In:
    colours: wp.array(dtype=wp.vec3f), shadow: wp.array(dtype=wp.float32), strengths: wp.array(dtype=wp.vec2d),
    lobe: wp.int32, end: wp.int32, first: wp.int32, run: wp.int32,
    # Out:
    errors_out: wp.array(dtype=wp.float32),
):  # fmt: skip
    """Add what pixels err by from which some of a light's lobes are hidden, one after the other: so large a step."""
    total = wp.float32(0.0)
    square = wp.float32(0.0)
    for k in range(lobe, end):
        strength = wp.float32(strengths[k][0])
        total += strength
        square += strength * strength
    step = ERROR_PER_LOBE * wp.sqrt(square)
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        if shadow[i] > 0.0:
            # What is lit by less than a step is all wrong.
            errors_out[i] = errors_out[i] + step / wp.max(total - shadow[i], step) * wp.length(colours[i])


@wp.func_native(
    "warpdiff::splat_cells(colours, hit, gains, pixels, colours_before, errors_before, ranks, weights, level, "
    f"{refinement_levels.MIN_CONTRACTION}f, begin, end, filtered_sums_out, means_out, level_difference_out, "
    "levels_out, has_edge_out);"
)
def splat_cells_run(
    colours: wp.array(dtype=wp.vec3f), hit: wp.array(dtype=wp.int32), gains: wp.array(dtype=wp.float32),
    pixels: wp.array(dtype=wp.int32), colours_before: wp.array(dtype=wp.vec3f),
    errors_before: wp.array(dtype=wp.float32), ranks: wp.array(dtype=wp.int32), weights: wp.array(dtype=wp.float32),
    level: wp.int32, begin: wp.int32, end: wp.int32, filtered_sums_out: wp.array2d(dtype=wp.vec4f),
    means_out: wp.array(dtype=wp.vec3f), level_difference_out: wp.array(dtype=wp.float32),
    levels_out: wp.array(dtype=wp.uint8), has_edge_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Filtered sums of pixels one after the other."""


@wp.kernel
def splat_cells(
    # In:
    colours: wp.array(dtype=wp.vec3f), hit: wp.array(dtype=wp.int32), gains: wp.array(dtype=wp.float32),
    pixels: wp.array(dtype=wp.int32), colours_before: wp.array(dtype=wp.vec3f),
    errors_before: wp.array(dtype=wp.float32), ranks: wp.array(dtype=wp.int32), weights: wp.array(dtype=wp.float32),
    level: wp.int32, first: wp.int32, run: wp.int32,
    # Out:
    filtered_sums_out: wp.array2d(dtype=wp.vec4f), means_out: wp.array(dtype=wp.vec3f),
    level_difference_out: wp.array(dtype=wp.float32), levels_out: wp.array(dtype=wp.uint8),
    has_edge_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Splat a pixel's cells through the filter: what they add to that pixel and to the eight around it.

    Args:
        colours: Those of the cells, pixel after pixel and row by row.
        hit: Whether they meet the mesh.
        gains: 0 where they are not lit, by the last of several lobes.
        pixels: Whose they are; −1 is none.
        colours_before: Of the picture's pixels by one ray each.
        errors_before: Theirs.
        ranks: Where in what is found each pixel of the picture comes; empty is its own number.
        weights: By how far, along one axis, a cell is from the middle pixel of three, (3 · 2ⁿ,).
        level: Which this one is.
        first: The first thread's place among ``pixels``.
        run: How many a thread takes.
        filtered_sums_out: Sums of colours times weights, and of the weights, (n, 9): entry 3 i + j is for the pixel
            that lies 1 − i rows below and 1 − j columns to the right.
        means_out: Means over the cells, those of the level before.
        level_difference_out: How far these are apart; at first, from the pixel's one ray.
        levels_out: Set to ``level``.
        has_edge_out: Whether any cell meets nothing or is not lit.
    """
    thread, _ = wp.tid()
    begin = first + thread * run
    splat_cells_run(
        colours, hit, gains, pixels, colours_before, errors_before, ranks, weights, level, begin, begin + run,
        filtered_sums_out, means_out, level_difference_out, levels_out, has_edge_out,
    )  # fmt: skip


@wp.struct
class FilteredSums:
    """Filtered sums of split pixels for themselves and for those around them, as ``splat_cells`` finds them."""

    filtered_sums: wp.array2d(dtype=wp.vec4f)
    means: wp.array(dtype=wp.vec3f)
    level_difference: wp.array(dtype=wp.float32)
    levels: wp.array(dtype=wp.uint8)
    has_edge: wp.array(dtype=wp.bool)
    ranks: wp.array(dtype=wp.int32)
    # By level, what the filter has in each of three pixels over the weights'.
    filter_normalisation: wp.array2d(dtype=wp.float32)


@wp.func
def compact_index(ranks: wp.array(dtype=wp.int32), pixel: wp.int32) -> wp.int32:
    """Where a pixel of the picture comes."""
    result = pixel
    if ranks.shape[0] > 0:
        result = ranks[pixel]
    return result


@wp.func
def levels_around(sums: FilteredSums, row: wp.int32, column: wp.int32, width: wp.int32, height: wp.int32) -> wp.vec2i:
    """The least and the largest level of a pixel's nine parts, its own and those of the pixels around."""
    least = wp.int32(refinement_levels.MOST_LEVEL)
    most = wp.int32(0)
    for line in range(wp.max(1 - row, 0), wp.min(height + 1 - row, 3)):
        for side in range(wp.max(1 - column, 0), wp.min(width + 1 - column, 3)):
            level = wp.int32(sums.levels[compact_index(sums.ranks, (row + line - 1) * width + column + side - 1)])
            least = wp.min(least, level)
            most = wp.max(most, level)
    return wp.vec2i(least, most)


@wp.kernel
def resolve_pixels(
    # In:
    sums: FilteredSums, pixels: wp.array(dtype=wp.int32), width: wp.int32, height: wp.int32,
    floor: wp.array(dtype=wp.float32), bound: wp.float32, converged_bound: wp.float32, level: wp.int32,
    must_subdivide: wp.bool, silhouette_level: wp.int32, first: wp.int32, run: wp.int32,
    # Out:
    colours_out: wp.array(dtype=wp.vec3f), errors_out: wp.array(dtype=wp.float32),
    coverage_out: wp.array(dtype=wp.float64), coverage_levels_out: wp.array(dtype=wp.uint8),
    illuminated_out: wp.array(dtype=wp.bool), edges_out: wp.array(dtype=wp.bool), marks_out: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Set pixels to what cells give them; by how much that changed with the last levels is what they may err by.

    Args:
        sums: What the cells give.
        pixels: Those that are marked; empty is all of the picture.
        width: Pixels in a row.
        height: Rows.
        floor: What errors are relative to at least.
        bound: As ``estimate_errors`` has it.
        converged_bound: The same of those that had converged.
        level: The last one.
        must_subdivide: Whether all of them are split again.
        silhouette_level: To which those that are covered in part are split at least.
        first: The first thread's place among ``pixels``.
        run: How many a thread takes.
        colours_out: Colours before, and now, times coverage.
        errors_out: ‖ΔXYZ‖, before and now.
        coverage_out: Shares of cells that meet the mesh, of the last level under any light.
        coverage_levels_out: That level.
        illuminated_out: Set where any cell has a colour.
        edges_out: Set where an edge of the mesh or of what is lit passes through what has a colour.
        marks_out: ``ACTIVE`` for those to be split again, ``CONVERGED`` for others that are marked.
    """
    thread, _ = wp.tid()
    for k in range(first + thread * run, first + (thread + 1) * run):
        pixel = k
        if pixels.shape[0] > 0:
            pixel = pixels[k]
        mark = marks_out[pixel]
        # What has settled takes the cells that are there for the sake of those beside it, if its own are among them.
        if mark == wp.uint8(0) or (
            mark == CONVERGED and wp.int32(sums.levels[compact_index(sums.ranks, pixel)]) < level
        ):
            continue
        row = pixel // width
        column = pixel % width
        # Pixels that are split unequally leave edges between them as they are if each counts for what the filter has
        # there; alike, they are the filter together, and closer to it by themselves.
        levels = levels_around(sums, row, column, width, height)
        if levels[1] < level:
            # None of its parts still changes by much.
            marks_out[pixel] = CONVERGED
            continue
        total = wp.vec4f()
        weight = wp.float32(0.0)
        rest = wp.float32(0.0)
        square = wp.float32(0.0)
        for line in range(wp.max(1 - row, 0), wp.min(height + 1 - row, 3)):
            for side in range(wp.max(1 - column, 0), wp.min(width + 1 - column, 3)):
                there = compact_index(sums.ranks, (row + line - 1) * width + column + side - 1)
                cell_level = wp.int32(sums.levels[there])
                share = FILTER_SHARES[line] * FILTER_SHARES[side]
                per_weight = sums.filter_normalisation[cell_level, line] * sums.filter_normalisation[cell_level, side]
                change = share * sums.level_difference[there]
                square += change * change
                if cell_level < level:
                    rest += change
                if levels[0] == levels[1]:
                    weight += share / per_weight
                    total += sums.filtered_sums[there, 3 * line + side]
                else:
                    weight += share
                    total += per_weight * sums.filtered_sums[there, 3 * line + side]
        # Of what there is of the picture.
        total = total / weight
        colour = wp.vec3f(total[0], total[1], total[2])
        # What was not split again is still wrong by a part of what it changed by last.
        error = wp.max(
            wp.static(wp.float32(refinement_levels.ERROR_PER_DIFFERENCE))
            * (wp.length(colour - colours_out[pixel]) + rest),
            wp.max(
                wp.static(wp.float32(refinement_levels.ERROR_PER_CHANGES)) * wp.sqrt(square),
                wp.static(wp.float32(refinement_levels.LEAST_ERROR_PER_LAST)) * errors_out[pixel],
            ),
        )
        limit = bound
        if mark == CONVERGED:
            limit = converged_bound
            if levels[0] < level:
                # Parts of it are as they were.
                error = wp.max(wp.max(error, wp.length(colour - colours_out[pixel]) + rest), errors_out[pixel])
        colours_out[pixel] = colour
        errors_out[pixel] = error
        if level >= wp.int32(coverage_levels_out[pixel]):
            coverage_out[pixel] = wp.float64(wp.min(total[3], wp.float32(1.0)))
            coverage_levels_out[pixel] = wp.uint8(level)
        if wp.length_sq(colour) > wp.float32(0.0):
            illuminated_out[pixel] = True
            edges_out[pixel] = edges_out[pixel] or sums.has_edge[compact_index(sums.ranks, pixel)]
        silhouette = (
            level < silhouette_level and total[3] > wp.float32(0.0) and total[3] < wp.float32(1.0) - wp.float32(1.0e-4)
        )
        # What has settled may be told to err by more when it takes such cells, and goes on then.
        if error > limit * wp.max(wp.length(colour), floor[0]):
            marks_out[pixel] = ACTIVE
        elif not must_subdivide and not silhouette:
            marks_out[pixel] = CONVERGED


@wp.kernel
def select_cells(
    # In:
    sums: FilteredSums, tiles: wp.array(dtype=wp.int32), marks: wp.array(dtype=wp.uint8),
    colours: wp.array(dtype=wp.vec3f), coverage: wp.array(dtype=wp.float64), width: wp.int32, height: wp.int32,
    floor: wp.array(dtype=wp.float32), bound: wp.float32, level: wp.int32, must_subdivide: wp.bool,
    silhouette_level: wp.int32, first: wp.int32, run: wp.int32,
    # Out:
    chosen_out: wp.array(dtype=wp.uint8),
):  # fmt: skip
    """Whether pixels are split again: those by whose cells any pixel around that is wanted changes much.

    Args:
        sums: What the cells give.
        tiles: Pixels that were split last; empty is all of the picture that are chosen.
        marks: Which pixels are yet to be told better.
        colours: Of the picture.
        coverage: Of the picture.
        width: Pixels in a row.
        height: Rows.
        floor: What errors are relative to at least.
        bound: As ``estimate_errors`` has it.
        level: The last one.
        must_subdivide: Whether all of them are.
        silhouette_level: As ``resolve_pixels`` has it.
        first: The first thread's place among ``tiles``.
        run: How many a thread takes.
        chosen_out: By pixel of the picture, whether it was and is.
    """
    thread, _ = wp.tid()
    for k in range(first + thread * run, first + (thread + 1) * run):
        pixel = k
        if tiles.shape[0] > 0:
            pixel = tiles[k]
        if chosen_out[pixel] == wp.uint8(0):
            continue
        rank = compact_index(sums.ranks, pixel)
        row = pixel // width
        column = pixel % width
        chosen = wp.uint8(0)
        for line in range(3):
            for side in range(3):
                y = row + 1 - line
                x = column + 1 - side
                if y >= 0 and y < height and x >= 0 and x < width:
                    there = y * width + x
                    if marks[there] == ACTIVE:
                        share = FILTER_SHARES[line] * FILTER_SHARES[side]
                        change = share * sums.level_difference[rank]
                        least = (
                            wp.static(
                                wp.float32(refinement_levels.SPLIT_AGAIN_SHARE / refinement_levels.ERROR_PER_DIFFERENCE)
                            )
                            * bound
                            * wp.max(wp.length(colours[there]), floor[0])
                        )
                        covered = coverage[there]
                        silhouette = (
                            level < silhouette_level
                            and covered > wp.float64(0.0)
                            and covered < wp.float64(1.0 - 1.0e-4)
                        )
                        if must_subdivide or silhouette or change > least:
                            chosen = wp.uint8(1)
        chosen_out[pixel] = chosen


@wp.kernel
def accumulate(
    # In:
    colours: wp.array(dtype=wp.vec3f), errors: wp.array(dtype=wp.float32), illuminated: wp.array(dtype=wp.bool),
    first: wp.int32, run: wp.int32,
    # Out:
    xyz_out: wp.array(dtype=wp.vec3f), errors_out: wp.array(dtype=wp.float32), illuminated_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Add a light's colours, what they err by, and what it reaches, to those of others."""
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        xyz_out[i] = xyz_out[i] + colours[i]
        errors_out[i] = errors_out[i] + errors[i]
        illuminated_out[i] = illuminated_out[i] or illuminated[i]
