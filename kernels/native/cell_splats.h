// Splatting of subpixel cells (parts of a pixel with one ray each): the colour of each cell is added to its pixel and
// to the eight pixels around it, with the weights of the pixel filter.

#pragma once

#include "simd.h"
#include "vectors.h"

namespace warpdiff {

// Bits that describe the subpixel cells of a pixel. LIT is set if at least one cell is illuminated. UNLIT is set if at
// least one cell hits the mesh but is dark. MISSED is set if at least one cell does not hit the mesh.
constexpr unsigned char LIT = 1, UNLIT = 2, MISSED = 4;

// Sums over the subpixel cells of one subdivided pixel. `filtered_sums[i][j]` is this pixel's contribution to the pixel
// that lies 1 − i rows below and 1 − j columns to the right: the sum of colours times weights, and the sum of weights.
// `quadrants` has the mean colours of the four quadrants, row by row. `lighting` has the bits LIT, UNLIT and MISSED.
struct CellSums {
    float filtered_sums[3][3][4] = {}, quadrants[4][3] = {};
    unsigned char lighting = 0;
};

// Return the estimated standard deviation ‖ΔXYZ‖ of the mean colour of `across` × `across` subpixel cells, if each cell
// has a random direction to the light. The estimate uses only differences between the colours of 2 × 2 neighbouring
// cells. Slow changes of colour over the pixel therefore do not count as noise. Cells that miss the mesh are black
// without noise, and do not contribute.
WARPDIFF_INLINE float scatter_of(const float* colours, const int* hit, int across)
{
    float sum = 0.0f;
    for (int row = 0; row < across; row += 2)
        for (int column = 0; column < across; column += 2) {
            float total[3] = {}, square = 0.0f;
            int hits = 0;
            for (int k = 0; k < 4; ++k) {
                const int cell = (row + k / 2) * across + column + k % 2;
                if (hit[cell] == 0) continue;
                ++hits;
                for (int c = 0; c < 3; ++c) {
                    total[c] += colours[3 * cell + c];
                    square += colours[3 * cell + c] * colours[3 * cell + c];
                }
            }
            if (hits < 2) continue;
            const float off = square - dot(total, total) / (float)hits;
            sum += wp::max(off, 0.0f) * (float)hits / (float)(hits - 1);
        }
    return wp::sqrt(sum) / (float)(across * across);
}

// Sum the `across` × `across` subpixel cells of a pixel, row by row. `along` has the weights of the cells along one
// axis: first in the filter of the previous pixel, then in the pixel's filter, then in the next pixel's filter.
// `is_sampled` states whether each cell has drawn a random direction to the light.
WARPDIFF_INLINE CellSums sum_cells(
    const float* colours, const int* hit, bool is_sampled, const float* along, int across)
{
    CellSums sums;
    const int half = across / 2;
    int cell = 0;
    for (int row = 0; row < across; ++row) {
        float of_row[3][4] = {};
        for (int column = 0; column < across; ++column, ++cell) {
            if (hit[cell] == 0) {
                sums.lighting |= MISSED;
                continue;
            }
            const float value[4] = {colours[3 * cell], colours[3 * cell + 1], colours[3 * cell + 2], 1.0f};
            // Directions to the light may be random. A subpixel cell that is black for its random direction may then be
            // illuminated from another direction. All cells that hit the mesh therefore count as illuminated.
            sums.lighting |= is_sampled || value[0] + value[1] + value[2] > 0.0f ? LIT : UNLIT;
            float* const quadrant = sums.quadrants[row / half * 2 + column / half];
            for (int c = 0; c < 3; ++c) quadrant[c] += value[c] / (float)(half * half);
            for (int k = 0; k < 3; ++k)
                for (int c = 0; c < 4; ++c) of_row[k][c] += along[k * across + column] * value[c];
        }
        for (int line = 0; line < 3; ++line)
            for (int k = 0; k < 3; ++k)
                for (int c = 0; c < 4; ++c) sums.filtered_sums[line][k][c] += along[line * across + row] * of_row[k][c];
    }
    return sums;
}

// Sum the subpixel cells of the subdivided pixels with the indices from `begin` to `end` in a list, and store the sums.
// The index −1 marks no pixel. If each cell has a random direction to the light, `changes_out` receives the standard
// deviation of the mean colour of each pixel. Otherwise `changes_out` and `quadrants_out` are written only if `is_base`
// is true. It states that these are the first cells of a pixel, from whose colours the final number of cells is
// selected. `changes_out` then receives the change from the pixel's colour before its subdivision, `colours_before`.
// `quadrants_out` receives the mean colours of the pixel's quadrants.
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
        const float* const cells = numbers<const float>(colours) + 3 * first;
        const int* const hits = numbers<const int>(hit) + first;
        const CellSums sums = sum_cells(cells, hits, is_sampled, numbers<const float>(weights), across);
        const long long rank = is_empty(ranks) ? pixel : numbers<const int>(ranks)[pixel];
        memcpy(numbers<float>(filtered_sums_out) + 36 * rank, sums.filtered_sums, sizeof(sums.filtered_sums));
        numbers<unsigned char>(levels_out)[rank] = (unsigned char)level;
        numbers<unsigned char>(lighting_out)[rank] = sums.lighting;
        if (is_sampled) numbers<float>(changes_out)[rank] = scatter_of(cells, hits, across);
        if (is_sampled || !is_base) continue;
        float* const quadrants = numbers<float>(quadrants_out) + 12 * rank;
        memcpy(quadrants, sums.quadrants, sizeof(sums.quadrants));
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
