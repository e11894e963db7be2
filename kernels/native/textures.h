// Textures: look-ups in an image pyramid, filtered by the footprint of a ray. A footprint is a Gaussian over texture
// coordinates. Two rows of probes (bilinear look-ups) along the long axis of the footprint, on one level of the
// pyramid, approximate the Gaussian (as in Feline, McCormack et al. 1999).
//
// All texels are in one array. Level 0 of a texture is its image, and each further level has half the size.

#pragma once

#include "simd.h"

namespace warpdiff {

// Continuation of a texture outside of its image along an axis: repeated, clamped to the edge, or mirrored.
constexpr int REPEAT = 0, CLAMP = 1, MIRROR = 2;
// Largest number of probes along the long axis of a footprint. For a longer footprint, the texture is also blurred
// along the short axis. The value was fitted (docs/decisions/textures.md): with 8, errors of long footprints are 1.4
// times as large.
constexpr int MOST_PROBES = 12;
// Largest distance of probes along the long axis, in standard deviations of the blur by the pyramid level and by
// bilinear interpolation. The value was fitted (docs/decisions/textures.md): twice the distance leaves gaps between the
// probes.
constexpr float PROBE_SPACING = 1.5f;
// Probes (bilinear look-ups) extend up to this distance on both sides along the long axis [standard deviations of the
// footprint]. The Gaussian beyond it is neglected.
constexpr float PROBE_RANGE = 2.0f;
// Smallest variance of a footprint that counts as covering the whole image [texels²]. The value is limited because
// squares of larger numbers exceed the range of float32.
constexpr float MOST_VARIANCE = 1.0e30f;

struct Rgba {
    float channels[4] = {};
};

// Size of one level of an image pyramid, and its first texel.
struct TextureLevel {
    const float* texels;
    int width, height;
};

// Texture with the index `number`. `row` has the index of the first level of its image pyramid, the number of levels,
// and the wrap mode on both axes.
template <class Textures>
struct Texture {
    const float* texels;
    const int* levels;
    int count, wrap[2];

    WARPDIFF_INLINE Texture(const Textures& textures, int number)
    {
        const int* const row = numbers<const int>(textures.table) + 4LL * number;
        texels = numbers<const float>(textures.texels);
        levels = numbers<const int>(textures.levels) + 3LL * row[0];
        count = row[1];
        wrap[0] = row[2];
        wrap[1] = row[3];
    }

    WARPDIFF_INLINE TextureLevel level(int index) const
    {
        const int* const entry = levels + 3LL * index;
        return {texels + 4LL * entry[0], entry[1], entry[2]};
    }
};

// Return the position in the image, 0 to 1, of a texture coordinate, which may be outside of the image.
WARPDIFF_INLINE float wrapped(float coordinate, int wrap)
{
    if (wrap == CLAMP) return wp::min(wp::max(coordinate, 0.0f), 1.0f);
    const float fraction = coordinate - wp::floor(coordinate);
    if (wrap == REPEAT) return fraction;
    return coordinate - 2.0f * wp::floor(0.5f * coordinate) < 1.0f ? fraction : 1.0f - fraction;
}

// Return the index of a texel in the image, for an index from −1 to `size`, which may be just outside of the image.
WARPDIFF_INLINE int wrapped_index(int index, int size, int wrap)
{
    if (index < 0) return wrap == REPEAT ? size - 1 : 0;
    if (index >= size) return wrap == REPEAT ? 0 : size - 1;
    return index;
}

// Four texels around a position in an image, and the position relative to them, 0 to 1. Texel centres are half a texel
// from the edges of the image. Row 0 is at the top.
struct TexelSquare {
    const float *upper_left, *upper_right, *lower_left, *lower_right;
    float right, down;

    // Find the four texels around a position. `x` is its distance from the left edge and `y` from the top edge
    // [texels], minus 0.5.
    WARPDIFF_INLINE TexelSquare(const TextureLevel& level, const int* wrap, float x, float y)
    {
        const float column = wp::floor(x), row = wp::floor(y);
        right = x - column;
        down = y - row;
        const int x0 = wrapped_index((int)column, level.width, wrap[0]);
        const int x1 = wrapped_index((int)column + 1, level.width, wrap[0]);
        const int y0 = wrapped_index((int)row, level.height, wrap[1]);
        const int y1 = wrapped_index((int)row + 1, level.height, wrap[1]);
        const float* const upper = level.texels + 4LL * y0 * level.width;
        const float* const lower = level.texels + 4LL * y1 * level.width;
        upper_left = upper + 4 * x0;
        upper_right = upper + 4 * x1;
        lower_left = lower + 4 * x0;
        lower_right = lower + 4 * x1;
    }
};

// Add `factor` times the colour of a pyramid level at the texture coordinates (u, v) to `result`. The colour is
// interpolated bilinearly between texel centres.
WARPDIFF_INLINE void add_bilinear(
    const TextureLevel& level, const int* wrap, float u, float v, float factor, Rgba& result)
{
    const float x = wrapped(u, wrap[0]) * (float)level.width - 0.5f;
    const float y = (1.0f - wrapped(v, wrap[1])) * (float)level.height - 0.5f;
    const TexelSquare texels(level, wrap, x, y);
    const float lower = factor * texels.down, upper = factor - lower;
    const float upper_right = upper * texels.right, lower_right = lower * texels.right;
    const float upper_left = upper - upper_right, lower_left = lower - lower_right;
    for (int c = 0; c < 4; ++c)
        result.channels[c] += upper_left * texels.upper_left[c] + upper_right * texels.upper_right[c]
            + lower_left * texels.lower_left[c] + lower_right * texels.lower_right[c];
}

// Texture coordinates (u, v) of a point. `v_again` is v with a different rounding error.
struct PointUv {
    float u, v, v_again;

    // Interpolate between the texture coordinates of three corners of a face, by barycentric coordinates.
    //
    // In this constructor and in `sample_point`, operations and roundings have a fixed order. It is the order that a
    // compiler once chose. Pictures that show points therefore do not change with the compiler or its options.
    WARPDIFF_INLINE PointUv(const float* uvs, const int* corners, const float* place)
    {
#if defined(__clang__)
#pragma clang fp reassociate(off) contract(off)
#endif
        const float* const a = uvs + 2LL * corners[0];
        const float* const b = uvs + 2LL * corners[1];
        const float* const c = uvs + 2LL * corners[2];
        const float share0 = place[0], share1 = place[1], share2 = wp::max(0.0f, 1.0f - (share0 + share1));
        u = fmaf(share2, c[0], fmaf(share1, b[0], share0 * a[0]));
        v = fmaf(share2, c[1], fmaf(share1, b[1], share0 * a[1]));
        v_again = fmaf(share2, c[1], fmaf(share0, a[1], share1 * b[1]));
    }
};

// Return the colour of a texture at a point, by bilinear interpolation between texel centres.
template <class Textures>
WARPDIFF_INLINE Rgba sample_point(const Textures& textures, int number, const PointUv& uv)
{
#if defined(__clang__)
#pragma clang fp reassociate(off) contract(off)
#endif
    const Texture<Textures> texture(textures, number);
    const TextureLevel level = texture.level(0);
    const float from_left = wrapped(uv.u, texture.wrap[0]);
    const float from_top =
        texture.wrap[1] == REPEAT ? wp::floor(uv.v) + (1.0f - uv.v_again) : 1.0f - wrapped(uv.v, texture.wrap[1]);
    const float x = fmaf(from_left, (float)level.width, -0.5f), y = fmaf(from_top, (float)level.height, -0.5f);
    const TexelSquare texels(level, texture.wrap, x, y);
    const float right = texels.right, left = 1.0f - right, down = texels.down, up = 1.0f - down;
    Rgba result;
    for (int c = 0; c < 4; ++c) {
        const float *const a = texels.upper_left + c, *const b = texels.upper_right + c;
        const float *const d = texels.lower_left + c, *const e = texels.lower_right + c;
        if (c == 0)
            result.channels[c] = fmaf(up, fmaf(right, *b, left * *a), down * fmaf(right, *e, left * *d));
        else
            result.channels[c] = fmaf(down, fmaf(left, *d, right * *e), up * fmaf(left, *a, right * *b));
    }
    return result;
}

// Return the mean colour of a texture over a Gaussian footprint around (u, v). `footprint` has the changes of (u, v)
// over one standard deviation along rows and along columns of the picture. If all are zero, there is no footprint.
template <class Textures>
WARPDIFF_INLINE Rgba sample_footprint(const Textures& textures, int number, float u, float v, const float* footprint)
{
    const Texture<Textures> texture(textures, number);
    const TextureLevel whole = texture.level(0);
    const float width = (float)whole.width, height = (float)whole.height;
    // Covariance of the footprint in texels of level 0 (the image itself), and its eigenvalues.
    const float x0 = width * footprint[0], y0 = height * footprint[1];
    const float x1 = width * footprint[2], y1 = height * footprint[3];
    const float xx = x0 * x0 + x1 * x1, xy = x0 * y0 + x1 * y1, yy = y0 * y0 + y1 * y1;
    const float mean = 0.5f * (xx + yy), half = 0.5f * (xx - yy), root = wp::sqrt(half * half + xy * xy);
    const float longest = mean + root, shortest = wp::max(mean - root, 0.0f);
    Rgba result;
    if (!(longest < MOST_VARIANCE)) {
        add_bilinear(texture.level(texture.count - 1), texture.wrap, u, v, 1.0f, result);
        return result;
    }
    if (longest <= 1.0e-6f) {
        add_bilinear(whole, texture.wrap, u, v, 1.0f, result);
        return result;
    }
    // Level n of a pyramid adds the variance (4ⁿ − 1)/4 along each axis [texels²]: the variance of the box filter, and
    // that of bilinear interpolation between its wider texels. The chosen level is the coarsest level whose blur is at
    // most the footprint's variance along the short axis. Probes add the remaining variance. If the footprint is too
    // long for the largest number of probes, the level is coarser. `limited` is then the variance of the blur with
    // which the distance of the probes is the largest permitted one.
    constexpr float PROBES = MOST_PROBES * PROBE_SPACING / (2.0f * PROBE_RANGE);
    const float limited = (longest - 0.25f * PROBES * PROBES) / (1.0f + PROBES * PROBES);
    const float variance = wp::max(shortest, limited);
    int chosen = 0;
    float power = 1.0f;
    for (; chosen < texture.count - 1 && 4.0f * power <= 1.0f + 4.0f * variance; ++chosen) power *= 4.0f;
    const TextureLevel level = texture.level(chosen);
    const float blur = 0.25f * (power - 1.0f);
    // Unit vector along the long axis of the footprint, in the coordinates of texels.
    float along_x = xx >= yy ? longest - yy : xy, along_y = xx >= yy ? xy : longest - xx;
    const float length2 = along_x * along_x + along_y * along_y;
    const float per_length = length2 > 0.0f ? 1.0f / wp::sqrt(length2) : 0.0f;
    along_x = length2 > 0.0f ? along_x * per_length : 1.0f;
    along_y *= per_length;
    const float rest = wp::sqrt(wp::max(longest - blur, 0.0f)), beside = wp::sqrt(wp::max(shortest - blur, 0.0f));
    const float spacing = PROBE_SPACING * wp::sqrt(blur + 0.25f);
    const int probes = wp::min(wp::max((int)wp::ceil(2.0f * PROBE_RANGE * rest / spacing), 1), MOST_PROBES);
    const float side_u = -beside * along_y / width, side_v = beside * along_x / height;
    const float step = 2.0f * PROBE_RANGE / (float)probes;
    float total = 0.0f;
    for (int probe = 0; probe < probes; ++probe) {
        const float place = (0.5f + (float)probe) * step - PROBE_RANGE;
        const float weight = wp::exp(-0.5f * place * place);
        total += 2.0f * weight;
        const float at_u = u + rest * place * along_x / width, at_v = v + rest * place * along_y / height;
        add_bilinear(level, texture.wrap, at_u + side_u, at_v + side_v, weight, result);
        add_bilinear(level, texture.wrap, at_u - side_u, at_v - side_v, weight, result);
    }
    for (int c = 0; c < 4; ++c) result.channels[c] /= total;
    return result;
}

} // namespace warpdiff
