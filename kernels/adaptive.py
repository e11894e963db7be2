"""Which pixels are split, what their cells give to the pixels around, and how far one level differs from the next."""

import warp as wp

from warpdiff.kernels import cell_levels, compile_options
from warpdiff.kernels.snippets import filled, simd_batch

wp.set_module_options(compile_options.options())

FILTER_SHARES = wp.constant(wp.vec3f(*cell_levels.FILTER_SHARES))

# Parts of rows, one after the other, with the rows above and below and what is beside their ends.
_ESTIMATE = """
    const int* const is_hit = (const int*)hit.data;
    const double* const uvw = (const double*)deflections.data;
    const float* const xyz = (const float*)colours.data;
    float* const errors = (float*)errors_out.data;
    unsigned char* const wanted = (unsigned char*)wanted_out.data;
    const float least = *(const float*)floor.data;
    auto larger = [](float a, float b) { return a > b ? a : b; };
    auto meets = [&](long long pixel) { return pixel >= low && pixel < high ? is_hit[pixel] : 0; };
    for (int from = begin, count; from < end; from += count) {
        const int column = from % width, row = from / width;
        count = wp::min(wp::min(end - from, ABREAST), width - column);
        // A silhouette passes between pixels that meet the mesh and others, on either side.
        int hits = 0;
        for (int line = -1; line < 2; ++line)
            for (int i = -1; i < count + 1; ++i) hits |= meets(from + (long long)line * width + i);
        if (hits == 0) {
            memset(errors + from, 0, count * sizeof(float));
            memset(wanted + from, all_of_them ? 1 : 0, count);
            continue;
        }
        // Above, here and below, from one pixel further to the left to one further to the right; what does not meet the
        // mesh differs in nothing from the pixel beside it.
        const float first_u = (float)uvw[3LL * from], first_v = (float)uvw[3LL * from + 1];
        float colour[3][3][ABREAST + 2] = {}, u[3][ABREAST + 2] = {}, v[3][ABREAST + 2] = {};
        bool there[3][ABREAST + 2] = {}, empty[3][ABREAST + 2] = {};
        for (int line = 0; line < 3; ++line) {
            if (row + line < 1 || row + line > height) continue;
            for (int j = 0; j < count + 2; ++j) {
                const long long k = from + (line - 1LL) * width + j - 1;
                if (column + j < 1 || column + j > width) continue;
                there[line][j] = meets(k) != 0;
                empty[line][j] = !there[line][j];
                if (!there[line][j]) continue;
                for (int c = 0; c < 3; ++c) colour[c][line][j] = xyz[3 * k + c];
                u[line][j] = (float)(uvw[3 * k] - uvw[3LL * from]);
                v[line][j] = (float)(uvw[3 * k + 1] - uvw[3LL * from + 1]);
            }
        }
        for (int i = 0; i < ABREAST; ++i) {
            const int j = i + 1;
            auto apart = [&](int line, int at) {
                const float x = colour[0][line][at] - colour[0][1][j], y = colour[1][line][at] - colour[1][1][j];
                const float z = colour[2][line][at] - colour[2][1][j];
                return there[line][at] ? x * x + y * y + z * z : 0.0f;
            };
            float contrast2 = larger(larger(apart(0, j), apart(2, j)), larger(apart(1, i), apart(1, i + 2)));
            const float x = colour[0][1][j], y = colour[1][1][j], z = colour[2][1][j], size2 = x * x + y * y + z * z;
            // Nothing tells of a pixel by itself.
            const bool by_itself = !(there[0][j] | there[2][j] | there[1][i] | there[1][i + 2]);
            contrast2 = by_itself ? size2 : contrast2;
            bool all = true, any = false, beside = false;
            for (int line = 0; line < 3; ++line) {
                all &= there[line][i] & there[line][j] & there[line][i + 2];
                any |= there[line][i] | there[line][j] | there[line][i + 2];
                beside |= empty[line][i] | empty[line][j] | empty[line][i + 2];
            }
            const bool rim = any & beside;
            // By how much changes of (u, v) along rows and columns, and aslant, are not those before.
            auto square = [](float x, float y) { return x * x + y * y; };
            const float left_u = u[1][i] - u[1][j], right_u = u[1][i + 2] - u[1][j];
            const float left_v = v[1][i] - v[1][j], right_v = v[1][i + 2] - v[1][j];
            const float above_u = u[0][j] - u[1][j], below_u = u[2][j] - u[1][j];
            const float above_v = v[0][j] - v[1][j], below_v = v[2][j] - v[1][j];
            const float tiny = 1.0e-30f;
            const float along = larger(square(left_u, left_v), square(right_u, right_v)) + tiny;
            const float down = larger(square(above_u, above_v), square(below_u, below_v)) + tiny;
            float uneven2 = larger(square(left_u + right_u, left_v + right_v) / along,
                square(above_u + below_u, above_v + below_v) / down);
            auto aslant = [&](int line, int at, float side_u, float side_v, float over_u, float over_v) {
                const float of_u = u[line][at] - u[1][j] - side_u - over_u;
                const float of_v = v[line][at] - v[1][j] - side_v - over_v;
                uneven2 = larger(uneven2, square(of_u, of_v) / larger(along, down));
            };
            aslant(0, i, left_u, left_v, above_u, above_v);
            aslant(0, i + 2, right_u, right_v, above_u, above_v);
            aslant(2, i, left_u, left_v, below_u, below_v);
            aslant(2, i + 2, right_u, right_v, below_u, below_v);
            const float uv2 = larger(square(first_u + u[1][j], first_v + v[1][j]), 1.0e-6f);
            const float wide = wp::sqrt(larger(along, down) / uv2);
            const float share = all ? SMOOTH + PER_UNEVEN * wp::sqrt(uneven2) + PER_WIDE * wide : 1.0f;
            const float error = (share < 1.0f ? share : 1.0f) * wp::sqrt(contrast2);
            const float size = larger(wp::sqrt(size2), least);
            if (i >= count) continue;
            errors[from + i] = there[1][j] ? error : 0.0f;
            wanted[from + i] = all_of_them || (any && (error > bound * size || (rim && splits_rims))) ? 1 : 0;
        }
    }
"""


@wp.func_native(
    filled(
        simd_batch(32) + _ESTIMATE,
        SMOOTH=f"{cell_levels.SMOOTH}f",
        PER_UNEVEN=f"{cell_levels.PER_UNEVEN}f",
        PER_WIDE=f"{cell_levels.PER_WIDE}f",
    )
)
def estimate_errors_run(
    colours: wp.array(dtype=wp.vec3f),
    deflections: wp.array(dtype=wp.vec3d),
    hit: wp.array(dtype=wp.int32),
    width: wp.int32,
    height: wp.int32,
    low: wp.int32,
    high: wp.int32,
    floor: wp.array(dtype=wp.float32),
    bound: wp.float32,
    all_of_them: wp.bool,
    splits_rims: wp.bool,
    begin: wp.int32,
    end: wp.int32,
    errors_out: wp.array(dtype=wp.float32),
    wanted_out: wp.array(dtype=wp.uint8),
):
    """Estimates for pixels one after the other."""


@wp.kernel
def estimate_errors(
    # In:
    colours: wp.array(dtype=wp.vec3f),
    deflections: wp.array(dtype=wp.vec3d),
    hit: wp.array(dtype=wp.int32),
    width: wp.int32,
    low: wp.int32,
    high: wp.int32,
    floor: wp.array(dtype=wp.float32),
    bound: wp.float32,
    all_of_them: wp.bool,
    splits_rims: wp.bool,
    first: wp.int32,
    run: wp.int32,
    # Out:
    errors_out: wp.array(dtype=wp.float32),
    wanted_out: wp.array(dtype=wp.uint8),
):
    """Estimated errors of pixels of one ray each, ‖ΔXYZ‖, and which of them are to be split.

    Args:
        colours: Theirs, of whole rows.
        deflections: What their rays see.
        hit: Whether they meet the mesh.
        width: Pixels in a row.
        low: The first pixel that may see anything.
        high: The one after the last of these.
        floor: What errors are relative to at least.
        bound: Of errors relative to the colour, or to the floor, from which pixels are split.
        all_of_them: Whether all are split, also where only cells may meet the mesh.
        splits_rims: Whether those are beside which the mesh ends.
        first: The first thread's pixel.
        run: How many a thread takes.
        errors_out: 0 where nothing is met.
        wanted_out: 1 for those to be split, otherwise 0.
    """
    thread, _ = wp.tid()
    begin = first + thread * run
    estimate_errors_run(
        colours, deflections, hit, width, hit.shape[0] // width, low, high, floor, bound, all_of_them, splits_rims,
        begin, begin + run, errors_out, wanted_out
    )  # fmt: skip


# Cell after cell in rows, and rows for the three pixels above, here and below.
_SHARE_OUT = """
    const float* const of_cells = (const float*)colours.data;
    const int* const is_hit = (const int*)hit.data;
    const float* const before = (const float*)colours_before.data;
    const float* const erred = (const float*)errors_before.data;
    const float* const along = (const float*)weights.data;
    const int* const rank_of = ranks.shape[0] > 0 ? (const int*)ranks.data : nullptr;
    const bool* const is_hidden = hidden.shape[0] > 0 ? (const bool*)hidden.data : nullptr;
    const int across = 1 << level;
    for (int tile = begin; tile < end; ++tile) {
        const int pixel = ((const int*)pixels.data)[tile];
        if (pixel < 0) continue;
        float shares[3][3][4] = {}, mean[3] = {};
        unsigned char dark = 0;
        long long cell = (long long)tile * across * across;
        for (int row = 0; row < across; ++row) {
            float sums[3][4] = {};
            for (int column = 0; column < across; ++column, ++cell) {
                if (is_hit[cell] == 0) continue;
                const float value[4] = {of_cells[3 * cell], of_cells[3 * cell + 1], of_cells[3 * cell + 2], 1.0f};
                const int quadrant = 2 * (2 * row >= across) + (2 * column >= across);
                dark |= (is_hidden && is_hidden[cell]) << quadrant;
                for (int c = 0; c < 3; ++c) mean[c] += value[c];
                for (int k = 0; k < 3; ++k)
                    for (int c = 0; c < 4; ++c) sums[k][c] += along[k * across + column] * value[c];
            }
            for (int line = 0; line < 3; ++line)
                for (int k = 0; k < 3; ++k)
                    for (int c = 0; c < 4; ++c) shares[line][k][c] += along[line * across + row] * sums[k][c];
        }
        const long long rank = rank_of ? rank_of[pixel] : pixel;
        memcpy((float*)shares_out.data + 36 * rank, shares, sizeof(shares));
        float* const known = (float*)means_out.data + 3 * rank;
        float change2 = 0.0f;
        for (int c = 0; c < 3; ++c) {
            mean[c] /= (float)(across * across);
            const float change = mean[c] - (level == 1 ? before[3LL * pixel + c] : known[c]);
            change2 += change * change;
            known[c] = mean[c];
        }
        // Cells may agree with what was before where both are wrong.
        float* const last_change = (float*)changes_out.data + rank;
        const float least = LEAST_FALL * (level == 1 ? erred[pixel] : *last_change);
        *last_change = wp::max(wp::sqrt(change2), least);
        ((unsigned char*)levels_out.data)[rank] = (unsigned char)level;
        ((unsigned char*)dark_out.data)[rank] = dark;
    }
"""


@wp.func_native(filled(_SHARE_OUT, LEAST_FALL=f"{cell_levels.LEAST_FALL}f"))
def splat_cells_run(
    colours: wp.array(dtype=wp.vec3f),
    hit: wp.array(dtype=wp.int32),
    hidden: wp.array(dtype=wp.bool),
    pixels: wp.array(dtype=wp.int32),
    colours_before: wp.array(dtype=wp.vec3f),
    errors_before: wp.array(dtype=wp.float32),
    ranks: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.float32),
    level: wp.int32,
    begin: wp.int32,
    end: wp.int32,
    shares_out: wp.array2d(dtype=wp.vec4f),
    means_out: wp.array(dtype=wp.vec3f),
    changes_out: wp.array(dtype=wp.float32),
    levels_out: wp.array(dtype=wp.uint8),
    dark_out: wp.array(dtype=wp.uint8),
):
    """Shares of pixels one after the other."""


@wp.kernel
def splat_cells(
    # In:
    colours: wp.array(dtype=wp.vec3f),
    hit: wp.array(dtype=wp.int32),
    hidden: wp.array(dtype=wp.bool),
    pixels: wp.array(dtype=wp.int32),
    colours_before: wp.array(dtype=wp.vec3f),
    errors_before: wp.array(dtype=wp.float32),
    ranks: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.float32),
    level: wp.int32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    shares_out: wp.array2d(dtype=wp.vec4f),
    means_out: wp.array(dtype=wp.vec3f),
    changes_out: wp.array(dtype=wp.float32),
    levels_out: wp.array(dtype=wp.uint8),
    dark_out: wp.array(dtype=wp.uint8),
):
    """Splat a pixel's cells through the filter: what they add to that pixel and to the eight around it.

    Args:
        colours: Those of the cells, pixel after pixel and row by row.
        hit: Whether they meet the mesh.
        hidden: Whether the light is hidden from there; empty is nowhere.
        pixels: Whose they are; −1 is none.
        colours_before: Of the picture's pixels by one ray each.
        errors_before: Theirs.
        ranks: Where in what is found each pixel of the picture comes; empty is its own number.
        weights: By how far, along one axis, a cell is from the middle pixel of three, (3 · 2ⁿ,).
        level: Which this one is.
        first: The first thread's place among ``pixels``.
        run: How many a thread takes.
        shares_out: Sums of colours times weights, and of the weights, (n, 9): entry 3 i + j is for the pixel that lies
            1 − i rows below and 1 − j columns to the right.
        means_out: Means over the cells, those of the level before.
        changes_out: How far these are apart; at first, from the pixel's one ray.
        levels_out: Set to ``level``.
        dark_out: A bit for each quadrant, row by row: 1 if the light is hidden from any of its cells.
    """
    thread, _ = wp.tid()
    begin = first + thread * run
    splat_cells_run(
        colours, hit, hidden, pixels, colours_before, errors_before, ranks, weights, level, begin, begin + run,
        shares_out, means_out, changes_out, levels_out, dark_out
    )  # fmt: skip


@wp.struct
class Shares:
    """Filtered sums of split pixels for themselves and for those around them, as ``splat_cells`` finds them."""

    shares: wp.array2d(dtype=wp.vec4f)
    means: wp.array(dtype=wp.vec3f)
    changes: wp.array(dtype=wp.float32)
    levels: wp.array(dtype=wp.uint8)
    dark: wp.array(dtype=wp.uint8)
    ranks: wp.array(dtype=wp.int32)
    per_thirds: wp.array2d(dtype=wp.float32)  # by level, what the filter has in each of three pixels over the weights'


@wp.func
def rank_of(ranks: wp.array(dtype=wp.int32), pixel: wp.int32) -> wp.int32:
    """Where a pixel of the picture comes."""
    result = pixel
    if ranks.shape[0] > 0:
        result = ranks[pixel]
    return result


@wp.kernel
def resolve_pixels(
    # In:
    given: Shares,
    pixels: wp.array(dtype=wp.int32),
    width: wp.int32,
    height: wp.int32,
    floor: wp.array(dtype=wp.float32),
    bound: wp.float32,
    level: wp.int32,
    goes_on: wp.bool,
    rim_level: wp.int32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    colours_out: wp.array(dtype=wp.vec3f),
    errors_out: wp.array(dtype=wp.float32),
    coverage_out: wp.array(dtype=wp.float64),
    lit_out: wp.array(dtype=wp.bool),
    wanted_out: wp.array(dtype=wp.uint8),
):
    """Set pixels to what cells give them; by how much that changed with the last levels is what they may err by.

    Args:
        given: What the cells give.
        pixels: Those to be set; empty is all of the picture that are wanted.
        width: Pixels in a row.
        height: Rows.
        floor: What errors are relative to at least.
        bound: As ``estimate_errors`` has it.
        level: The last one.
        goes_on: Whether all of them are split again.
        rim_level: To which those that are covered in part are split at least.
        first: The first thread's place among ``pixels``.
        run: How many a thread takes.
        colours_out: Colours before, and now, times coverage.
        errors_out: ‖ΔXYZ‖.
        coverage_out: Shares of cells that meet the mesh.
        lit_out: Set where any cell has a colour.
        wanted_out: 1 for those to be split again, otherwise 0.
    """
    thread, _ = wp.tid()
    for k in range(first + thread * run, first + (thread + 1) * run):
        pixel = k
        if pixels.shape[0] > 0:
            pixel = pixels[k]
        if wanted_out[pixel] == wp.uint8(0):
            continue
        row = pixel // width
        column = pixel % width
        # Pixels that are split unequally leave edges between them as they are if each counts for what the filter has
        # there; alike, they are the filter together, and closer to it by themselves.
        least = wp.int32(cell_levels.MOST_LEVEL)
        most = wp.int32(0)
        for line in range(wp.max(1 - row, 0), wp.min(height + 1 - row, 3)):
            for side in range(wp.max(1 - column, 0), wp.min(width + 1 - column, 3)):
                there = rank_of(given.ranks, (row + line - 1) * width + column + side - 1)
                least = wp.min(least, wp.int32(given.levels[there]))
                most = wp.max(most, wp.int32(given.levels[there]))
        if most < level:
            # None of its parts still changes by much.
            wanted_out[pixel] = wp.uint8(0)
            continue
        total = wp.vec4f()
        weight = wp.float32(0.0)
        square = wp.float32(0.0)
        for line in range(wp.max(1 - row, 0), wp.min(height + 1 - row, 3)):
            for side in range(wp.max(1 - column, 0), wp.min(width + 1 - column, 3)):
                there = rank_of(given.ranks, (row + line - 1) * width + column + side - 1)
                of_level = wp.int32(given.levels[there])
                share = FILTER_SHARES[line] * FILTER_SHARES[side]
                per_weight = given.per_thirds[of_level, line] * given.per_thirds[of_level, side]
                square += share * share * given.changes[there] * given.changes[there]
                if least == most:
                    weight += share / per_weight
                    total += given.shares[there, 3 * line + side]
                else:
                    weight += share
                    total += per_weight * given.shares[there, 3 * line + side]
        # Of what there is of the picture.
        total = total / weight
        colour = wp.vec3f(total[0], total[1], total[2])
        of_difference = wp.where(
            level == 1,
            wp.static(wp.float32(cell_levels.ERROR_PER_FIRST_DIFFERENCE)),
            wp.static(wp.float32(cell_levels.ERROR_PER_LATER_DIFFERENCE)),
        )
        # What parts change by may cancel once.
        error = wp.max(
            of_difference * wp.length(colour - colours_out[pixel]),
            wp.static(wp.float32(cell_levels.ERROR_PER_CHANGES)) * wp.sqrt(square),
        )
        colours_out[pixel] = colour
        errors_out[pixel] = error
        coverage_out[pixel] = wp.float64(wp.min(total[3], wp.float32(1.0)))
        lit_out[pixel] = lit_out[pixel] or wp.length_sq(colour) > wp.float32(0.0)
        rim = level < rim_level and total[3] > wp.float32(0.0) and total[3] < wp.float32(1.0) - wp.float32(1.0e-4)
        if not goes_on and not rim and not error > bound * wp.max(wp.length(colour), floor[0]):
            wanted_out[pixel] = wp.uint8(0)


@wp.kernel
def select_cells(
    # In:
    given: Shares,
    tiles: wp.array(dtype=wp.int32),
    wanted: wp.array(dtype=wp.uint8),
    colours: wp.array(dtype=wp.vec3f),
    coverage: wp.array(dtype=wp.float64),
    width: wp.int32,
    height: wp.int32,
    floor: wp.array(dtype=wp.float32),
    bound: wp.float32,
    level: wp.int32,
    goes_on: wp.bool,
    rim_level: wp.int32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    chosen_out: wp.array(dtype=wp.uint8),
):
    """Whether pixels are split again: those by whose cells any pixel around that is wanted changes much.

    Args:
        given: What the cells give.
        tiles: Pixels that were split last; empty is all of the picture that are chosen.
        wanted: Which pixels are yet to be told better.
        colours: Of the picture.
        coverage: Of the picture.
        width: Pixels in a row.
        height: Rows.
        floor: What errors are relative to at least.
        bound: As ``estimate_errors`` has it.
        level: The last one.
        goes_on: Whether all of them are.
        rim_level: As ``resolve_pixels`` has it.
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
        rank = rank_of(given.ranks, pixel)
        row = pixel // width
        column = pixel % width
        chosen = wp.uint8(0)
        for line in range(3):
            for side in range(3):
                y = row + 1 - line
                x = column + 1 - side
                if y >= 0 and y < height and x >= 0 and x < width:
                    there = y * width + x
                    if wanted[there] != wp.uint8(0):
                        share = FILTER_SHARES[line] * FILTER_SHARES[side]
                        change = share * given.changes[rank]
                        least = (
                            wp.static(wp.float32(cell_levels.SPLIT_AGAIN_SHARE))
                            * bound
                            * wp.max(wp.length(colours[there]), floor[0])
                        )
                        covered = coverage[there]
                        rim = level < rim_level and covered > wp.float64(0.0) and covered < wp.float64(1.0 - 1.0e-4)
                        if goes_on or rim or change > least:
                            chosen = wp.uint8(1)
        chosen_out[pixel] = chosen


@wp.kernel
def accumulate(
    # In:
    colours: wp.array(dtype=wp.vec3f),
    errors: wp.array(dtype=wp.float32),
    first: wp.int32,
    run: wp.int32,
    # Out:
    xyz_out: wp.array(dtype=wp.vec3f),
    errors_out: wp.array(dtype=wp.float32),
):
    """Add a light's colours, and what they err by, to others."""
    thread, _ = wp.tid()
    for i in range(first + thread * run, first + (thread + 1) * run):
        xyz_out[i] = xyz_out[i] + colours[i]
        errors_out[i] = errors_out[i] + errors[i]
