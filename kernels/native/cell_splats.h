// Splatting of subpixel cells: the colour of each cell is added to its pixel and to the eight pixels around it, with
// the weights of the pixel filter.

#pragma once

#include "simd.h"

namespace warpdiff {

// Bits that describe the cells of a pixel. Each is set if at least one cell is illuminated (LIT), hits the mesh but is
// dark (UNLIT), or does not hit the mesh (MISSED).
constexpr unsigned char LIT = 1, UNLIT = 2, MISSED = 4;

// The scatter of a pixel is estimated from the means over square blocks of its cells. This is the largest number of
// blocks along an axis of the pixel. Limit: size of local arrays.
constexpr int BLOCKS = 4;

// Sums over the cells of one subdivided pixel. `filtered_sums[i][j]` is this pixel's contribution to the pixel that
// lies 1 − i rows below and 1 − j columns to the right: the sum of colours times weights, and the sum of weights.
// `blocks` has the sum of colours of each block and the number of its cells that hit the mesh. `lighting` has the bits
// LIT, UNLIT and MISSED.
struct CellSums {
    float filtered_sums[3][3][4] = {}, blocks[BLOCKS][BLOCKS][4] = {};
    int across, cells; // number of blocks along an axis, number of cells per block
    unsigned char lighting = 0;

    // Compute the mean colour of one of the four quadrants of the pixel. The row and the column of the quadrant are 0
    // or 1.
    WARPDIFF_INLINE void quadrant(int row, int column, float* mean) const
    {
        const int half = across / 2;
        for (int c = 0; c < 3; ++c) {
            mean[c] = 0.0f;
            for (int i = 0; i < half; ++i)
                for (int j = 0; j < half; ++j) mean[c] += blocks[half * row + i][half * column + j][c];
            mean[c] /= (float)(half * half * cells);
        }
    }

    // Return the estimated standard deviation ‖ΔXYZ‖ of the pixel's mean colour. The means of the blocks count as
    // independent samples. Cells that hit nothing are black without noise, and do not contribute.
    WARPDIFF_INLINE float scatter() const
    {
        float total[4] = {}, square = 0.0f;
        int used = 0;
        for (const auto& row : blocks)
            for (const auto& block : row) {
                used += block[3] > 0.0f;
                for (int c = 0; c < 4; ++c) total[c] += block[c];
            }
        if (used < 2) return 0.0f;
        for (const auto& row : blocks)
            for (const auto& block : row)
                for (int c = 0; c < 3; ++c) {
                    const float off = block[c] - block[3] * total[c] / total[3];
                    square += off * off;
                }
        return wp::sqrt(square * (float)used / (float)(used - 1)) / (float)(across * across * cells);
    }
};

// Sum the `across` × `across` cells of a pixel, row by row. `along` has the weights of the cells along one axis: first
// for the previous pixel, then for their own and for the next one. `is_sampled` states whether each cell has drawn a
// random direction to the light.
WARPDIFF_INLINE CellSums sum_cells(
    const float* colours, const int* hit, bool is_sampled, const float* along, int across)
{
    CellSums sums;
    sums.across = across < BLOCKS ? across : BLOCKS;
    const int per_block = across / sums.across;
    sums.cells = per_block * per_block;
    int cell = 0;
    for (int row = 0; row < across; ++row) {
        float of_row[3][4] = {};
        for (int column = 0; column < across; ++column, ++cell) {
            if (hit[cell] == 0) {
                sums.lighting |= MISSED;
                continue;
            }
            const float value[4] = {colours[3 * cell], colours[3 * cell + 1], colours[3 * cell + 2], 1.0f};
            // If the direction to the light is random, a black cell may still be illuminated from another direction.
            // All cells that hit the mesh then count as illuminated.
            sums.lighting |= is_sampled || value[0] + value[1] + value[2] > 0.0f ? LIT : UNLIT;
            float* const block = sums.blocks[row / per_block][column / per_block];
            for (int c = 0; c < 4; ++c) block[c] += value[c];
            for (int k = 0; k < 3; ++k)
                for (int c = 0; c < 4; ++c) of_row[k][c] += along[k * across + column] * value[c];
        }
        for (int line = 0; line < 3; ++line)
            for (int k = 0; k < 3; ++k)
                for (int c = 0; c < 4; ++c) sums.filtered_sums[line][k][c] += along[line * across + row] * of_row[k][c];
    }
    return sums;
}

// Sum the cells of the subdivided pixels with numbers from `begin` to `end`, and store the sums; the index −1 marks no
// pixel. If directions to the light are random, `changes_out` receives the scatter. Otherwise, and only at the base
// level, it receives the change from the previous colour, and `quadrants_out` receives the mean colours of the
// quadrants.
template <class Colours, class Hits, class Numbers, class Sums, class Quadrants, class Bytes>
WARPDIFF_INLINE void splat_cells(const Colours& colours, const Hits& hit, const Hits& pixels,
    const Colours& colours_before, const Hits& ranks, const Numbers& weights, int level, bool is_base, bool is_sampled,
    int begin, int end, Sums& filtered_sums_out, Quadrants& quadrants_out, Numbers& changes_out, Bytes& levels_out,
    Bytes& lighting_out)
{
    const int across = 1 << level;
    for (int tile = begin; tile < end; ++tile) {
        const int pixel = numbers<const int>(pixels)[tile];
        if (pixel < 0) continue;
        const long long first = (long long)tile * across * across;
        const CellSums sums = sum_cells(numbers<const float>(colours) + 3 * first, numbers<const int>(hit) + first,
            is_sampled, numbers<const float>(weights), across);
        const long long rank = is_empty(ranks) ? pixel : numbers<const int>(ranks)[pixel];
        memcpy(numbers<float>(filtered_sums_out) + 36 * rank, sums.filtered_sums, sizeof(sums.filtered_sums));
        numbers<unsigned char>(levels_out)[rank] = (unsigned char)level;
        numbers<unsigned char>(lighting_out)[rank] = sums.lighting;
        if (is_sampled) numbers<float>(changes_out)[rank] = sums.scatter();
        if (is_sampled || !is_base) continue;
        float* const quadrants = numbers<float>(quadrants_out) + 12 * rank;
        for (int quadrant = 0; quadrant < 4; ++quadrant)
            sums.quadrant(quadrant / 2, quadrant % 2, quadrants + 3 * quadrant);
        float change2 = 0.0f;
        for (int c = 0; c < 3; ++c) {
            const float mean = 0.25f * (quadrants[c] + quadrants[3 + c] + quadrants[6 + c] + quadrants[9 + c]);
            const float change = mean - numbers<const float>(colours_before)[3LL * pixel + c];
            change2 += change * change;
        }
        numbers<float>(changes_out)[rank] = wp::sqrt(change2);
    }
}

} // namespace warpdiff
