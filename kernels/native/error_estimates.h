// What pixels of one ray are estimated to err by, from the eight pixels around.

#pragma once

#include "fast_math.h"
#include "simd.h"
#include "vectors.h"

namespace warpdiff {

// What errors are taken to be of the contrast with pixels beside: where (u, v) is even, and more in proportion to how
// uneven it is and to how much it changes.
struct ContrastShares {
    float even, per_uneven, per_wide;
};

// Which pixels are split.
struct SplitRule {
    float least; // what errors are relative to at least
    float bound; // of errors relative to the colour
    bool all, rims;
};

// A part of a row with the rows above and below, and what is beside its ends: three lines, from one pixel further to
// the left to one further to the right. What does not meet the mesh differs in nothing from the pixel beside it.
template <int N>
struct Neighbourhood {
    float first_u, first_v;
    float colour[3][3][N + 2] = {}, u[3][N + 2] = {}, v[3][N + 2] = {}; // (u, v) from that of the first pixel
    bool there[3][N + 2] = {}, empty[3][N + 2] = {};

    // The part of `count` pixels from the pixel `from` on; only those from `low` to before `high` may meet the mesh.
    WARPDIFF_INLINE void load(const float* xyz, const double* uvw, const int* hit, int width, int height, int low,
        int high, int from, int count)
    {
        const int column = from % width, row = from / width;
        first_u = (float)uvw[3LL * from];
        first_v = (float)uvw[3LL * from + 1];
        for (int line = 0; line < 3; ++line) {
            if (row + line < 1 || row + line > height) continue;
            for (int j = 0; j < count + 2; ++j) {
                const long long k = from + (line - 1LL) * width + j - 1;
                if (column + j < 1 || column + j > width) continue;
                there[line][j] = k >= low && k < high && hit[k] != 0;
                empty[line][j] = !there[line][j];
                if (!there[line][j]) continue;
                for (int c = 0; c < 3; ++c) colour[c][line][j] = xyz[3 * k + c];
                u[line][j] = (float)(uvw[3 * k] - uvw[3LL * from]);
                v[line][j] = (float)(uvw[3 * k + 1] - uvw[3LL * from + 1]);
            }
        }
    }
};

WARPDIFF_INLINE float square(float x, float y)
{
    return x * x + y * y;
}

// The largest square of a colour's distance from those of the four pixels beside it; of a pixel by itself, of which
// nothing tells, its own square.
template <int N>
WARPDIFF_INLINE float contrast2(const Neighbourhood<N>& around, int j, float own2)
{
    auto apart = [&](int line, int at) {
        const float x = around.colour[0][line][at] - around.colour[0][1][j];
        const float y = around.colour[1][line][at] - around.colour[1][1][j];
        const float z = around.colour[2][line][at] - around.colour[2][1][j];
        return around.there[line][at] ? x * x + y * y + z * z : 0.0f;
    };
    const float most = larger(larger(apart(0, j), apart(2, j)), larger(apart(1, j - 1), apart(1, j + 1)));
    const bool by_itself = !(around.there[0][j] | around.there[2][j] | around.there[1][j - 1] | around.there[1][j + 1]);
    return by_itself ? own2 : most;
}

// By how much (u, v) changes from pixel to pixel, relative to itself, and by how much these changes along rows, columns
// and aslant are not those before, squared and relative to the larger one.
struct Evenness {
    float uneven2, wide;
};

template <int N>
WARPDIFF_INLINE Evenness evenness_of(const Neighbourhood<N>& around, int j)
{
    const auto& u = around.u;
    const auto& v = around.v;
    const float left_u = u[1][j - 1] - u[1][j], right_u = u[1][j + 1] - u[1][j];
    const float left_v = v[1][j - 1] - v[1][j], right_v = v[1][j + 1] - v[1][j];
    const float above_u = u[0][j] - u[1][j], below_u = u[2][j] - u[1][j];
    const float above_v = v[0][j] - v[1][j], below_v = v[2][j] - v[1][j];
    const float tiny = 1.0e-30f;
    const float along = larger(square(left_u, left_v), square(right_u, right_v)) + tiny;
    const float down = larger(square(above_u, above_v), square(below_u, below_v)) + tiny;
    float uneven2 =
        larger(square(left_u + right_u, left_v + right_v) / along, square(above_u + below_u, above_v + below_v) / down);
    auto aslant = [&](int line, int at, float side_u, float side_v, float over_u, float over_v) {
        const float of_u = u[line][at] - u[1][j] - side_u - over_u;
        const float of_v = v[line][at] - v[1][j] - side_v - over_v;
        uneven2 = larger(uneven2, square(of_u, of_v) / larger(along, down));
    };
    aslant(0, j - 1, left_u, left_v, above_u, above_v);
    aslant(0, j + 1, right_u, right_v, above_u, above_v);
    aslant(2, j - 1, left_u, left_v, below_u, below_v);
    aslant(2, j + 1, right_u, right_v, below_u, below_v);
    const float uv2 = larger(square(around.first_u + u[1][j], around.first_v + v[1][j]), 1.0e-6f);
    return {uneven2, wp::sqrt(larger(along, down) / uv2)};
}

// Whether pixel j of the middle line and all eight around it meet the mesh, any of them does, or only some.
struct Coverage {
    bool all, any, rim;
};

template <int N>
WARPDIFF_INLINE Coverage coverage_of(const Neighbourhood<N>& around, int j)
{
    bool all = true, any = false, beside = false;
    for (int line = 0; line < 3; ++line) {
        const bool* const there = around.there[line] + j;
        const bool* const empty = around.empty[line] + j;
        all &= there[-1] & there[0] & there[1];
        any |= there[-1] | there[0] | there[1];
        beside |= empty[-1] | empty[0] | empty[1];
    }
    return {all, any, any && beside};
}

// Estimates of `count` pixels, ‖ΔXYZ‖, 0 where nothing is met, and which of them are to be split.
template <int N>
WARPDIFF_INLINE void estimate_part_of_row(const Neighbourhood<N>& around, ContrastShares shares, SplitRule rule,
    int count, float* errors, unsigned char* wanted)
{
    for (int i = 0; i < N; ++i) {
        const int j = i + 1;
        const float x = around.colour[0][1][j], y = around.colour[1][1][j], z = around.colour[2][1][j];
        const float size2 = x * x + y * y + z * z;
        const float apart2 = contrast2(around, j, size2);
        const Coverage coverage = coverage_of(around, j);
        const Evenness evenness = evenness_of(around, j);
        const float share = coverage.all
            ? shares.even + shares.per_uneven * wp::sqrt(evenness.uneven2) + shares.per_wide * evenness.wide
            : 1.0f;
        const float error = (share < 1.0f ? share : 1.0f) * wp::sqrt(apart2);
        const float size = larger(wp::sqrt(size2), rule.least);
        if (i >= count) continue;
        errors[i] = around.there[1][j] ? error : 0.0f;
        wanted[i] = rule.all || (coverage.any && (error > rule.bound * size || (coverage.rim && rule.rims))) ? 1 : 0;
    }
}

// Estimates for pixels from begin to end, part of a row after part of a row.
template <int BATCH, class Colours, class Deflections, class Hits, class Numbers, class Marks>
WARPDIFF_INLINE void estimate_errors(const Colours& colours, const Deflections& deflections, const Hits& hit, int width,
    int height, int low, int high, ContrastShares shares, SplitRule rule, int begin, int end, Numbers& errors_out,
    Marks& wanted_out)
{
    constexpr int N = batch_of(BATCH);
    const int* const hits = numbers<const int>(hit);
    auto meets = [&](long long pixel) { return pixel >= low && pixel < high ? hits[pixel] : 0; };
    for (int from = begin, count; from < end; from += count) {
        count = wp::min(wp::min(end - from, N), width - from % width);
        float* const errors = numbers<float>(errors_out) + from;
        unsigned char* const wanted = numbers<unsigned char>(wanted_out) + from;
        // A silhouette passes between pixels that meet the mesh and others, on either side.
        int any = 0;
        for (int line = -1; line < 2; ++line)
            for (int i = -1; i < count + 1; ++i) any |= meets(from + (long long)line * width + i);
        if (any == 0) {
            memset(errors, 0, count * sizeof(float));
            memset(wanted, rule.all ? 1 : 0, count);
            continue;
        }
        Neighbourhood<N> around;
        around.load(numbers<const float>(colours), numbers<const double>(deflections), hits, width, height, low, high,
            from, count);
        estimate_part_of_row(around, shares, rule, count, errors, wanted);
    }
}

} // namespace warpdiff
