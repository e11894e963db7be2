// Sums over the cells of a subdivided pixel, for that pixel and the eight around it, weighted by the pixels' filter.

#pragma once

#include "simd.h"

namespace warpdiff {

// Bits of what the cells of a pixel show: any that is lit, any that is not, and any that meets nothing.
constexpr unsigned char LIT = 1, UNLIT = 2, MISSED = 4;

// Of one split pixel: for the pixel that lies 1 − i rows below and 1 − j columns to the right, the sum of colours times
// weights, and that of the weights; the mean colour of each quadrant; and the bits.
struct CellSums {
    float filtered_sums[3][3][4] = {}, quadrants[4][3] = {};
    unsigned char lighting = 0;
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
            sums.lighting |= hit[cell] == 0 ? MISSED : gains[cell] > 0.0f ? LIT : UNLIT;
            if (hit[cell] == 0) continue;
            const float value[4] = {colours[3 * cell], colours[3 * cell + 1], colours[3 * cell + 2], 1.0f};
            float* const quadrant = sums.quadrants[2 * (2 * row >= across) + (2 * column >= across)];
            for (int c = 0; c < 3; ++c) quadrant[c] += value[c];
            for (int k = 0; k < 3; ++k)
                for (int c = 0; c < 4; ++c) of_row[k][c] += along[k * across + column] * value[c];
        }
        for (int line = 0; line < 3; ++line)
            for (int k = 0; k < 3; ++k)
                for (int c = 0; c < 4; ++c) sums.filtered_sums[line][k][c] += along[line * across + row] * of_row[k][c];
    }
    for (auto& quadrant : sums.quadrants)
        for (float& value : quadrant) value *= 4.0f / (float)(across * across);
    return sums;
}

// Splat pixels from begin to end of those that are split, −1 is none. At the base level, quadrants and changes from the
// colours before are written, too.
template <class Colours, class Hits, class Numbers, class Sums, class Quadrants, class Bytes>
WARPDIFF_INLINE void splat_cells(const Colours& colours, const Hits& hit, const Numbers& gains, const Hits& pixels,
    const Colours& colours_before, const Hits& ranks, const Numbers& weights, int level, bool is_base, int begin,
    int end, Sums& filtered_sums_out, Quadrants& quadrants_out, Numbers& changes_out, Bytes& levels_out,
    Bytes& lighting_out)
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
        numbers<unsigned char>(levels_out)[rank] = (unsigned char)level;
        numbers<unsigned char>(lighting_out)[rank] = sums.lighting;
        if (!is_base) continue;
        memcpy(numbers<float>(quadrants_out) + 12 * rank, sums.quadrants, sizeof(sums.quadrants));
        float change2 = 0.0f;
        for (int c = 0; c < 3; ++c) {
            const float mean = 0.25f
                * (sums.quadrants[0][c] + sums.quadrants[1][c] + sums.quadrants[2][c] + sums.quadrants[3][c]);
            const float change = mean - numbers<const float>(colours_before)[3LL * pixel + c];
            change2 += change * change;
        }
        numbers<float>(changes_out)[rank] = wp::sqrt(change2);
    }
}

} // namespace warpdiff
