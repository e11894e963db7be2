"""Which face each ray of a picture meets first, found face by face."""

import warp as wp

from warpdiff.kernels import cell_levels
from warpdiff.kernels.snippets import filled
from warpdiff.kernels.structs import Camera, Cells, Sampling, SurfaceArrays

# Faces side by side.
ABREAST = 16

# Faces side by side as they lie in the picture, so that the compiler makes vectors of that, and then one after the
# other: with the pixels of a row, one by one, or with the cells of pixels side by side.
_COVER = """
#if !defined(__CUDA_ARCH__)
    // Products of corners on such a grid are exact in a picture, so that faces leave no gap where they meet.
    constexpr double PER_PIXEL = 1 << 14;
    // Before the eye, in units of the surface: what is nearer is not seen.
    constexpr double NEAR = 1.0e-9;
    constexpr int LANES = 8;
    typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4)));
    typedef signed flags __attribute__((vector_size(4 * LANES)));
    const flags BITS = {1, 2, 4, 8, 16, 32, 64, 128};
    const double* const axes = (const double*)camera.axes.data;
    const int* const faces = (const int*)surface.faces.data;
    const float* const positions = (const float*)surface.positions.data;
    const double* const offsets = (const double*)sampling.offsets.data;
    const unsigned long long* const marks = (const unsigned long long*)cells.marks.data;
    const int* const ranks = (const int*)cells.ranks.data;
    unsigned long long* const nearest = (unsigned long long*)nearest_out.data;
    const bool orthographic = camera.orthographic, of_cells = cells.ranks.shape[0] > 0;
    const bool scattered = sampling.offsets.shape[0] > 0;
    const int width = camera.width, height = camera.height, words = (width + 63) / 64;
    const double per_width = 0.5 * width / axes[12], per_height = 0.5 * height / axes[13];
    // Distances begin before the sphere around the mesh: a float32 of those from afar would tell no faces apart.
    const double before = wp::max(axes[0] * axes[9] + axes[1] * axes[10] + axes[2] * axes[11] - 1.0, 0.0);
    auto smaller = [](double a, double b) { return a < b ? a : b; };
    auto larger = [](double a, double b) { return a > b ? a : b; };

    // Where cells lie about the centre of a pixel.
    double most = reach;
    float aside[MOST_RAYS] = {}, below[MOST_RAYS] = {};
    const int across = cells.across, size = across * across;
    const double reach_of_cells = 0.5 - 0.5 / across;
    for (int ray = 0; of_cells && ray < size; ++ray) {
        aside[ray] = (float)((ray % across + 0.5) / across - 0.5);
        below[ray] = (float)((ray / across + 0.5) / across - 0.5);
    }
    if (of_cells) most = larger(most, reach_of_cells);

    // Triangles: columns, rows and distances of their corners, whether the edges across from these run from the vertex
    // of the smaller number to the larger, and the face.
    double columns[3][ABREAST], rows[3][ABREAST], depths[3][ABREAST];
    bool rises[3][ABREAST];
    int face_of[ABREAST], least_row = height, most_row = -1;
    auto cover = [&](int count) {
        double sides[ABREAST], low_column[ABREAST], high_column[ABREAST], low_row[ABREAST], high_row[ABREAST];
        for (int i = 0; i < ABREAST; ++i) {
            for (int k = 0; k < 3; ++k) {
                columns[k][i] = wp::rint(columns[k][i] * PER_PIXEL) / PER_PIXEL;
                rows[k][i] = wp::rint(rows[k][i] * PER_PIXEL) / PER_PIXEL;
            }
            const double x0 = columns[0][i], x1 = columns[1][i], x2 = columns[2][i];
            const double y0 = rows[0][i], y1 = rows[1][i], y2 = rows[2][i];
            sides[i] = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0) < 0.0 ? -1.0 : 1.0;
            low_column[i] = larger(wp::ceil(smaller(x0, smaller(x1, x2)) - most - 0.5), 0.0);
            high_column[i] = smaller(wp::floor(larger(x0, larger(x1, x2)) + most - 0.5), width - 1.0);
            low_row[i] = larger(wp::ceil(smaller(y0, smaller(y1, y2)) - most - 0.5), 0.0);
            high_row[i] = smaller(wp::floor(larger(y0, larger(y1, y2)) + most - 0.5), height - 1.0);
        }
        // What two faces find of an edge is the same but for its sign.
        double x_from[3][ABREAST], y_from[3][ABREAST], right[3][ABREAST], down[3][ABREAST], signs[3][ABREAST];
        double slopes[3][ABREAST];
        for (int k = 0; k < 3; ++k) {
            const int one = (k + 1) % 3, other = (k + 2) % 3;
            for (int i = 0; i < ABREAST; ++i) {
                const double x1 = columns[one][i], x2 = columns[other][i], y1 = rows[one][i], y2 = rows[other][i];
                x_from[k][i] = rises[k][i] ? x1 : x2;
                y_from[k][i] = rises[k][i] ? y1 : y2;
                right[k][i] = rises[k][i] ? x2 - x1 : x1 - x2;
                down[k][i] = rises[k][i] ? y2 - y1 : y1 - y2;
                signs[k][i] = rises[k][i] ? sides[i] : -sides[i];
                slopes[k][i] = right[k][i] / (down[k][i] == 0.0 ? 1.0 : down[k][i]);
            }
        }
        for (int i = 0; i < count; ++i) {
            if (!(low_row[i] <= high_row[i] && low_column[i] <= high_column[i])) continue;
            least_row = wp::min(least_row, (int)low_row[i]);
            most_row = wp::max(most_row, (int)high_row[i]);
            // By how much a place lies inside of each edge, in areas.
            auto find = [&](double column, double row, double* inside) {
                for (int k = 0; k < 3; ++k)
                    inside[k] = signs[k][i] * (right[k][i] * (row - y_from[k][i])
                        - down[k][i] * (column - x_from[k][i]));
            };
            auto keep = [&](double inside0, double inside1, double inside2, int ray) {
                const double total = inside0 + inside1 + inside2;
                if (!(total > 0.0)) return;
                const double d0 = depths[0][i], d1 = depths[1][i], d2 = depths[2][i];
                const double depth = orthographic ? (inside0 * d0 + inside1 * d1 + inside2 * d2) / total
                    : total / (inside0 / d0 + inside1 / d1 + inside2 / d2);
                union { float number; unsigned int bits; } distance;
                distance.number = (float)wp::max(depth - before, 0.0);
                const unsigned long long found = (unsigned long long)distance.bits << 32 | (unsigned int)face_of[i];
                // Atomic, as slices of a launch run on several threads.
                unsigned long long known = __atomic_load_n(nearest + ray, __ATOMIC_RELAXED);
                while (found < known && !__atomic_compare_exchange_n(nearest + ray, &known, found, true,
                    __ATOMIC_RELAXED, __ATOMIC_RELAXED)) {}
            };
            for (int row = (int)low_row[i]; row <= (int)high_row[i]; ++row) {
                // What of the row may count, with a pixel's width of slack.
                double least = low_column[i], largest = high_column[i];
                for (int k = 0; k < 3; ++k) {
                    const double rise = signs[k][i] * down[k][i], beyond = most * (1.0 + wp::abs(slopes[k][i]));
                    const double crossing = x_from[k][i] + slopes[k][i] * (row + 0.5 - y_from[k][i]) - 0.5;
                    if (rise < 0.0) least = larger(least, wp::floor(crossing - beyond));
                    if (rise > 0.0) largest = smaller(largest, wp::ceil(crossing + beyond));
                }
                if (!(least <= largest)) continue;
                const int left = (int)least, end_column = (int)largest + 1;
                if (!of_cells) {
                    for (int column = left; column < end_column; ++column) {
                        const int ray = row * width + column;
                        const double* const offset = offsets + 2LL * ray;
                        double inside[3];
                        find(column + 0.5 + (scattered ? offset[0] : 0.0),
                            row + 0.5 + (scattered ? offset[1] : 0.0), inside);
                        if (inside[0] >= 0.0 && inside[1] >= 0.0 && inside[2] >= 0.0)
                            keep(inside[0], inside[1], inside[2], ray);
                    }
                    continue;
                }
                for (int word = left / 64; 64 * word < end_column; ++word) {
                    unsigned long long pixels = marks[row * words + word];
                    if (64 * word < left) pixels &= ~0ULL << (left - 64 * word);
                    if (64 * word + 64 > end_column) pixels &= ~0ULL >> (64 * word + 64 - end_column);
                    for (; pixels != 0; pixels &= pixels - 1) {
                        const int column = 64 * word + __builtin_ctzll(pixels);
                        const int first = ranks[row * width + column] * size;
                        double inside[3];
                        find(column + 0.5, row + 0.5, inside);
                        bool is_beside = false;
                        lanes at_centre[3], along[3], athwart[3];
                        for (int k = 0; k < 3; ++k) {
                            along[k] = lanes{} + (float)(signs[k][i] * right[k][i]);
                            athwart[k] = lanes{} + (float)(signs[k][i] * down[k][i]);
                            at_centre[k] = lanes{} + (float)inside[k];
                            is_beside |= inside[k] < -reach_of_cells * (wp::abs(right[k][i]) + wp::abs(down[k][i]));
                        }
                        if (is_beside) continue;
                        for (int ray = 0; ray < size; ray += LANES) {
                            const lanes x = *(const lanes*)(aside + ray), y = *(const lanes*)(below + ray);
                            lanes at[3];
                            for (int k = 0; k < 3; ++k) at[k] = at_centre[k] + (along[k] * y - athwart[k] * x);
                            const flags each = (at[0] >= 0.0f) & (at[1] >= 0.0f) & (at[2] >= 0.0f) & BITS;
                            int covered = 0;
                            for (int j = 0; j < LANES; ++j) covered |= each[j];
                            if (ray + LANES > size) covered &= (1 << (size - ray)) - 1;
                            for (; covered != 0; covered &= covered - 1) {
                                const int j = __builtin_ctz(covered);
                                keep(at[0][j], at[1][j], at[2][j], first + ray + j);
                            }
                        }
                    }
                }
            }
        }
    };

    // What crosses the plane of the eye is cut off there, a triangle or two of it left; their edges, but for the cut
    // and where the two meet, are the face's.
    double across_view[3], up_view[3], away[3];
    int number = 0;
    auto add = [&](int face, const double (*corners)[3], const int* which, const bool* ascends) {
        for (int k = 0; k < 3; ++k) {
            const double* const corner = corners[which[k]];
            const double scale = orthographic ? 1.0 : 1.0 / corner[2];
            columns[k][number] = 0.5 * width + per_width * scale * corner[0];
            rows[k][number] = 0.5 * height - per_height * scale * corner[1];
            depths[k][number] = corner[2];
            rises[k][number] = ascends[k];
        }
        face_of[number] = face;
        if (++number == ABREAST) {
            cover(number);
            number = 0;
        }
    };
    auto cut = [&](int face) {
        for (int k = 0; k < 3; ++k) {
            const float* const place = positions + 3LL * faces[3LL * face + k];
            const double x = place[0] - axes[0], y = place[1] - axes[1], z = place[2] - axes[2];
            across_view[k] = x * axes[3] + y * axes[4] + z * axes[5];
            up_view[k] = x * axes[6] + y * axes[7] + z * axes[8];
            away[k] = -(x * axes[9] + y * axes[10] + z * axes[11]);
        }
        // Corners of what is left, and whether the edge from each to the next one ascends.
        double corners[4][3];
        bool ascends[4];
        int left = 0;
        for (int k = 0; k < 3; ++k) {
            const int next = (k + 1) % 3;
            const bool rise = faces[3LL * face + k] < faces[3LL * face + next];
            if (away[k] >= NEAR) {
                corners[left][0] = across_view[k];
                corners[left][1] = up_view[k];
                corners[left][2] = away[k];
                ascends[left++] = rise;
            }
            if ((away[k] >= NEAR) == (away[next] >= NEAR)) continue;
            // From the vertex of the smaller number on, for both faces.
            const int a = rise ? k : next, b = rise ? next : k;
            const double t = (NEAR - away[a]) / (away[b] - away[a]);
            corners[left][0] = across_view[a] + t * (across_view[b] - across_view[a]);
            corners[left][1] = up_view[a] + t * (up_view[b] - up_view[a]);
            corners[left][2] = NEAR;
            ascends[left++] = rise;
        }
        for (int k = 2; k < left; ++k) {
            const int which[3] = {0, k - 1, k};
            // Across from each of these: the edge between the other two, that to the first one, that from it.
            const bool of_edges[3] = {ascends[k - 1], k == left - 1 ? ascends[k] : false, k == 2 ? ascends[0] : true};
            add(face, corners, which, of_edges);
        }
    };
    for (int from = begin; from < end; from += ABREAST) {
        const int count = wp::min(end - from, ABREAST);
        bool behind[ABREAST] = {};
        for (int corner = 0; corner < 3; ++corner) {
            float places[3][ABREAST];
            for (int i = 0; i < ABREAST; ++i) {
                const int* const corners = faces + 3LL * (from + (i < count ? i : 0));
                const float* const place = positions + 3LL * corners[corner];
                for (int c = 0; c < 3; ++c) places[c][i] = place[c];
                rises[corner][i] = corners[(corner + 1) % 3] < corners[(corner + 2) % 3];
            }
            for (int i = 0; i < ABREAST; ++i) {
                const double x = places[0][i] - axes[0], y = places[1][i] - axes[1], z = places[2][i] - axes[2];
                const double depth = -(x * axes[9] + y * axes[10] + z * axes[11]);
                const double scale = orthographic ? 1.0 : 1.0 / depth;
                columns[corner][i] = 0.5 * width + per_width * scale * (x * axes[3] + y * axes[4] + z * axes[5]);
                rows[corner][i] = 0.5 * height - per_height * scale * (x * axes[6] + y * axes[7] + z * axes[8]);
                depths[corner][i] = depth;
                behind[i] |= !(depth >= NEAR);
            }
        }
        bool any = false;
        for (int i = 0; i < count; ++i) {
            face_of[i] = from + i;
            any |= behind[i];
        }
        if (!any) {
            cover(count);
            continue;
        }
        for (int i = 0; i < count; ++i) cut(from + i);
        if (number > 0) cover(number);
        number = 0;
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


@wp.func_native(filled(_COVER, ABREAST=ABREAST, MOST_RAYS=max(cell_levels.rays_at(cell_levels.MOST_LEVEL), 8)))
def rasterize_run(
    camera: Camera,
    surface: SurfaceArrays,
    sampling: Sampling,
    cells: Cells,
    reach: wp.float64,
    begin: wp.int32,
    end: wp.int32,
    nearest_out: wp.array(dtype=wp.uint64),
    rows_out: wp.array(dtype=wp.int32),
):
    """Rasterize a run of faces into the nearest face of each ray."""
