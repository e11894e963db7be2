"""Which face each ray of a picture meets first, found face by face.

A picture's worth of rays visits every face's box in the hierarchy thousands of times; a face knows its pixels.
"""

import warp as wp

from warpdiff.kernels.native import filled
from warpdiff.kernels.scene import Camera, SurfaceArrays, Tiles

# Faces side by side, and rays of a tile at most.
ABREAST, MOST_RAYS = 16, 32

# Faces side by side as they lie in the picture, so that the compiler makes vectors of that, and then one after the
# other, with rays side by side: those of a row's pixels, or of a pixel's tile.
_COVER = """
#if !defined(__CUDA_ARCH__)
    constexpr double PER_PIXEL = 1 << 14;
    constexpr int LANES = 8;
    typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4)));
    typedef signed flags __attribute__((vector_size(4 * LANES)));
    const flags BITS = {1, 2, 4, 8, 16, 32, 64, 128};
    const double* const axes = (const double*)camera.axes.data;
    const int* const faces = (const int*)surface.faces.data;
    const float* const positions = (const float*)surface.positions.data;
    const int* const first_rays = (const int*)tiles.first_rays.data;
    const int* const ends = (const int*)tiles.ends.data;
    unsigned long long* const nearest = (unsigned long long*)nearest_out.data;
    const unsigned long long* const marks = (const unsigned long long*)tiles.marks.data;
    const bool orthographic = camera.orthographic, of_tiles = tiles.first_rays.shape[0] > 0;
    const int width = camera.width, height = camera.height, words = (width + 63) / 64;
    // Where rays lie beside the first pixel of a row's part, or the centre of a pixel that has a tile of a kind.
    constexpr int KINDS = 4;
    float aside[KINDS][MOST_RAYS] = {}, below[KINDS][MOST_RAYS] = {};
    double reaches[KINDS] = {}, reach = 0.0;
    int sizes[KINDS] = {};
    for (int kind = 0; of_tiles && kind < (int)tiles.ends.shape[0]; ++kind) {
        const int across = ((const int*)tiles.across.data)[kind];
        const double apart = ((const double*)tiles.apart.data)[kind];
        sizes[kind] = across * across;
        reaches[kind] = 0.5 * (across - 1) * apart;
        reach = wp::max(reach, reaches[kind]);
        for (int ray = 0; ray < sizes[kind]; ++ray) {
            aside[kind][ray] = ray % across * apart - reaches[kind];
            below[kind][ray] = ray / across * apart - reaches[kind];
        }
    }
    const double per_width = 0.5 * width / axes[12], per_height = 0.5 * height / axes[13];
    // Distances begin before the sphere around the mesh: a float32 of those from afar would tell no faces apart.
    const double before = wp::max(axes[0] * axes[9] + axes[1] * axes[10] + axes[2] * axes[11] - 1.0, 0.0);
    int least_row = height, most_row = -1;
    for (int from = begin; from < end; from += ABREAST) {
        const int count = wp::min(end - from, ABREAST);
        double columns[3][ABREAST], rows[3][ABREAST], depths[3][ABREAST], sides[ABREAST];
        double low_column[ABREAST], high_column[ABREAST], low_row[ABREAST], high_row[ABREAST];
        for (int corner = 0; corner < 3; ++corner) {
            float places[3][ABREAST];
            for (int i = 0; i < ABREAST; ++i) {
                const float* const place = positions + 3LL * faces[3LL * (from + (i < count ? i : 0)) + corner];
                for (int c = 0; c < 3; ++c) places[c][i] = place[c];
            }
            for (int i = 0; i < ABREAST; ++i) {
                const double x = places[0][i] - axes[0], y = places[1][i] - axes[1], z = places[2][i] - axes[2];
                const double depth = -(x * axes[9] + y * axes[10] + z * axes[11]);
                const double scale = orthographic ? 1.0 : 1.0 / depth;
                const double column = 0.5 * width + per_width * scale * (x * axes[3] + y * axes[4] + z * axes[5]);
                const double row = 0.5 * height - per_height * scale * (x * axes[6] + y * axes[7] + z * axes[8]);
                // Products of such places are exact in a picture, so that faces leave no gap where they meet.
                columns[corner][i] = wp::rint(column * PER_PIXEL) / PER_PIXEL;
                rows[corner][i] = wp::rint(row * PER_PIXEL) / PER_PIXEL;
                depths[corner][i] = depth;
            }
        }
        auto smaller = [](double a, double b) { return a < b ? a : b; };
        auto larger = [](double a, double b) { return a > b ? a : b; };
        for (int i = 0; i < ABREAST; ++i) {
            const double x0 = columns[0][i], x1 = columns[1][i], x2 = columns[2][i];
            const double y0 = rows[0][i], y1 = rows[1][i], y2 = rows[2][i];
            sides[i] = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0) < 0.0 ? -1.0 : 1.0;
            low_column[i] = larger(wp::ceil(smaller(x0, smaller(x1, x2)) - reach - 0.5), 0.0);
            high_column[i] = smaller(wp::floor(larger(x0, larger(x1, x2)) + reach - 0.5), width - 1.0);
            low_row[i] = larger(wp::ceil(smaller(y0, smaller(y1, y2)) - reach - 0.5), 0.0);
            high_row[i] = smaller(wp::floor(larger(y0, larger(y1, y2)) + reach - 0.5), height - 1.0);
        }
        // The edges across from the corners, from the vertex of the smaller number to the larger: what two faces find
        // of one is the same but for its sign, so that they leave no gap.
        double x_from[3][ABREAST], y_from[3][ABREAST], right[3][ABREAST], down[3][ABREAST], signs[3][ABREAST];
        double slopes[3][ABREAST];
        for (int k = 0; k < 3; ++k) {
            const int one = (k + 1) % 3, other = (k + 2) % 3;
            bool rises[ABREAST];
            for (int i = 0; i < ABREAST; ++i) {
                const int* const corners = faces + 3LL * (from + (i < count ? i : 0));
                rises[i] = corners[one] < corners[other];
            }
            for (int i = 0; i < ABREAST; ++i) {
                const double x1 = columns[one][i], x2 = columns[other][i], y1 = rows[one][i], y2 = rows[other][i];
                x_from[k][i] = rises[i] ? x1 : x2;
                y_from[k][i] = rises[i] ? y1 : y2;
                right[k][i] = rises[i] ? x2 - x1 : x1 - x2;
                down[k][i] = rises[i] ? y2 - y1 : y1 - y2;
                signs[k][i] = rises[i] ? sides[i] : -sides[i];
                slopes[k][i] = right[k][i] / (down[k][i] == 0.0 ? 1.0 : down[k][i]);
            }
        }
        for (int i = 0; i < count; ++i) {
            if (!(low_row[i] <= high_row[i] && low_column[i] <= high_column[i])) continue;
            const int face = from + i;
            // By how much a pixel's centre lies inside of each edge, in areas.
            auto centre = [&](int column, int row, double* inside) {
                for (int k = 0; k < 3; ++k)
                    inside[k] = signs[k][i] * (right[k][i] * (row + 0.5 - y_from[k][i])
                        - down[k][i] * (column + 0.5 - x_from[k][i]));
            };
            auto keep = [&](double inside0, double inside1, double inside2, int ray) {
                const double total = inside0 + inside1 + inside2;
                if (!(total > 0.0)) return;
                const double d0 = depths[0][i], d1 = depths[1][i], d2 = depths[2][i];
                const double depth = orthographic ? (inside0 * d0 + inside1 * d1 + inside2 * d2) / total
                    : total / (inside0 / d0 + inside1 / d1 + inside2 / d2);
                union { float number; unsigned int bits; } distance;
                distance.number = (float)wp::max(depth - before, 0.0);
                const unsigned long long found = (unsigned long long)distance.bits << 32 | (unsigned int)face;
                // Atomic, as slices of a launch run on several threads.
                unsigned long long known = __atomic_load_n(nearest + ray, __ATOMIC_RELAXED);
                while (found < known && !__atomic_compare_exchange_n(nearest + ray, &known, found, true,
                    __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {}
            };
            const int left = (int)low_column[i], end_column = (int)high_column[i] + 1;
            least_row = wp::min(least_row, (int)low_row[i]);
            most_row = wp::max(most_row, (int)high_row[i]);
            for (int row = (int)low_row[i]; row <= (int)high_row[i]; ++row) {
                if (!of_tiles) {
                    double least = low_column[i], most = high_column[i];
                    for (int k = 0; k < 3; ++k) {
                        // A pixel's width of slack: what counts is tested below.
                        const double rise = signs[k][i] * down[k][i];
                        const double crossing = x_from[k][i] + slopes[k][i] * (row + 0.5 - y_from[k][i]) - 0.5;
                        if (rise < 0.0) least = larger(least, wp::floor(crossing));
                        if (rise > 0.0) most = smaller(most, wp::ceil(crossing));
                    }
                    for (int column = (int)least; column <= (int)most; ++column) {
                        double inside[3];
                        centre(column, row, inside);
                        if (inside[0] >= 0.0 && inside[1] >= 0.0 && inside[2] >= 0.0)
                            keep(inside[0], inside[1], inside[2], row * width + column);
                    }
                    continue;
                }
                for (int word = left / 64; 64 * word < end_column; ++word) {
                    unsigned long long pixels = marks[row * words + word];
                    if (64 * word < left) pixels &= ~0ULL << (left - 64 * word);
                    if (64 * word + 64 > end_column) pixels &= ~0ULL >> (64 * word + 64 - end_column);
                    for (; pixels != 0; pixels &= pixels - 1) {
                        const int column = 64 * word + __builtin_ctzll(pixels);
                        const int first = first_rays[row * width + column];
                        int kind = 0;
                        while (first >= ends[kind]) ++kind;
                        double inside[3];
                        centre(column, row, inside);
                        bool is_beside = false;
                        lanes at_centre[3], along[3], across[3];
                        for (int k = 0; k < 3; ++k) {
                            along[k] = lanes{} + (float)(signs[k][i] * right[k][i]);
                            across[k] = lanes{} + (float)(signs[k][i] * down[k][i]);
                            at_centre[k] = lanes{} + (float)inside[k];
                            is_beside |= inside[k] < -reaches[kind] * (wp::abs(right[k][i]) + wp::abs(down[k][i]));
                        }
                        if (is_beside) continue;
                        for (int ray = 0; ray < sizes[kind]; ray += LANES) {
                            const lanes x = *(const lanes*)(aside[kind] + ray), y = *(const lanes*)(below[kind] + ray);
                            lanes at[3];
                            for (int k = 0; k < 3; ++k) at[k] = at_centre[k] + (along[k] * y - across[k] * x);
                            const flags each = (at[0] >= 0.0f) & (at[1] >= 0.0f) & (at[2] >= 0.0f) & BITS;
                            int covered = 0;
                            for (int j = 0; j < LANES; ++j) covered |= each[j];
                            if (ray + LANES > sizes[kind]) covered &= (1 << (sizes[kind] - ray)) - 1;
                            for (; covered != 0; covered &= covered - 1) {
                                const int j = __builtin_ctz(covered);
                                keep(at[0][j], at[1][j], at[2][j], first + ray + j);
                            }
                        }
                    }
                }
            }
        }
    }
    // Atomic, too.
    int* const seen = (int*)rows_out.data;
    if (most_row < 0 || rows_out.shape[0] == 0) return;
    for (int known = __atomic_load_n(seen, __ATOMIC_RELAXED); least_row < known
        && !__atomic_compare_exchange_n(seen, &known, least_row, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED);) {}
    for (int known = __atomic_load_n(seen + 1, __ATOMIC_RELAXED); most_row > known
        && !__atomic_compare_exchange_n(seen + 1, &known, most_row, true, __ATOMIC_RELAXED, __ATOMIC_RELAXED);) {}
#endif
"""


@wp.func_native(filled(_COVER, ABREAST=ABREAST, MOST_RAYS=MOST_RAYS))
def cover_run(
    camera: Camera,
    surface: SurfaceArrays,
    tiles: Tiles,
    begin: wp.int32,
    end: wp.int32,
    nearest_out: wp.array(dtype=wp.uint64),
    rows_out: wp.array(dtype=wp.int32),
):
    """What faces one after the other cover."""
