// What a split pixel's cells add to that pixel and to the eight around it, through the pixels' filter.

#pragma once

#include "simd.h"

namespace warpdiff {

// Of one split pixel: for the pixel that lies 1 − i rows below and 1 − j columns to the right, the sum of colours times
// weights, and that of the weights; the mean colour; and whether any cell meets nothing or is not lit.
struct CellSums {
    float filtered_sums[3][3][4] = {}, mean[3] = {};
    bool has_edge = false;
};

// Sum `across` times `across` cells: one after the other in rows, and rows for the three pixels above, here and below.
// `along` weighs cells by how far they are, along one axis, from the middle pixel of three.
WARPDIFF_INLINE CellSums sum_cells(
    const float* colours, const int* hit, const float* gains, const float* along, int across)
{
    CellSums sums;
    int cell = 0;
    for (int row = 0; row < across; ++row) {
        float of_row[3][4] = {};
        for (int column = 0; column < across; ++column, ++cell) {
            sums.has_edge |= hit[cell] == 0 || !(gains[cell] > 0.0f);
            if (hit[cell] == 0) continue;
            const float value[4] = {colours[3 * cell], colours[3 * cell + 1], colours[3 * cell + 2], 1.0f};
            for (int c = 0; c < 3; ++c) sums.mean[c] += value[c];
            for (int k = 0; k < 3; ++k)
                for (int c = 0; c < 4; ++c) of_row[k][c] += along[k * across + column] * value[c];
        }
        for (int line = 0; line < 3; ++line)
            for (int k = 0; k < 3; ++k)
                for (int c = 0; c < 4; ++c) sums.filtered_sums[line][k][c] += along[line * across + row] * of_row[k][c];
    }
    for (int c = 0; c < 3; ++c) sums.mean[c] /= (float)(across * across);
    return sums;
}

// Splat pixels from begin to end of those that are split, −1 is none: `min_contraction` is the least change of
// their means, as a share of what was expected.
template <class Colours, class Hits, class Flags, class Numbers, class Sums, class Bytes>
WARPDIFF_INLINE void splat_cells(const Colours& colours, const Hits& hit, const Numbers& gains, const Hits& pixels,
    const Colours& colours_before, const Numbers& errors_before, const Hits& ranks, const Numbers& weights, int level,
    float min_contraction, int begin, int end, Sums& filtered_sums_out, Colours& means_out,
    Numbers& level_difference_out, Bytes& levels_out, Flags& has_edge_out)
{
    const int across = 1 << level;
    for (int tile = begin; tile < end; ++tile) {
        const int pixel = numbers<const int>(pixels)[tile];
        if (pixel < 0) continue;
        const long long first = (long long)tile * across * across;
        const CellSums sums = sum_cells(numbers<const float>(colours) + 3 * first, numbers<const int>(hit) + first,
            numbers<const float>(gains) + first, numbers<const float>(weights), across);
        const long long rank = is_empty(ranks) ? pixel : numbers<const int>(ranks)[pixel];
        memcpy(numbers<float>(filtered_sums_out) + 36 * rank, sums.filtered_sums, sizeof(sums.filtered_sums));
        float* const mean = numbers<float>(means_out) + 3 * rank;
        const float* const before = level == 1 ? numbers<const float>(colours_before) + 3LL * pixel : mean;
        float change2 = 0.0f;
        for (int c = 0; c < 3; ++c) {
            const float change = sums.mean[c] - before[c];
            change2 += change * change;
        }
        for (int c = 0; c < 3; ++c) mean[c] = sums.mean[c];
        // Cells may agree with what was before where both are wrong.
        float* const change = numbers<float>(level_difference_out) + rank;
        const float expected = level == 1 ? numbers<const float>(errors_before)[pixel] : *change;
        *change = wp::max(wp::sqrt(change2), min_contraction * expected);
        numbers<unsigned char>(levels_out)[rank] = (unsigned char)level;
        numbers<bool>(has_edge_out)[rank] = sums.has_edge;
    }
}

} // namespace warpdiff
