// Elementary functions by short series. These functions are faster than those of the standard library and have no
// branches, so that compilers can vectorise loops over them.

#pragma once

#include "simd.h"

namespace warpdiff {

constexpr float PI = 3.14159265f;

WARPDIFF_INLINE float larger(float a, float b)
{
    return a > b ? a : b;
}

WARPDIFF_INLINE float smaller(float a, float b)
{
    return a < b ? a : b;
}

WARPDIFF_INLINE int bits_of(float number)
{
    int bits;
    memcpy(&bits, &number, sizeof(bits));
    return bits;
}

WARPDIFF_INLINE float float_of(int bits)
{
    float number;
    memcpy(&number, &bits, sizeof(number));
    return number;
}

struct LogPolar {
    float log2;  // logarithm of the radius to the base 2
    float turns; // angle [turns], from 0 to 1
};

// Convert a point (u, v) to polar coordinates: its angle and the logarithm of its radius. Radii below `least` are
// replaced by `least`.
WARPDIFF_INLINE LogPolar log_polar(float u, float v, float least)
{
    // The squared radius is a power of two times m, where m lies between √½ and √2. The logarithm of m is a series in
    // (m − 1)/(m + 1).
    const float uv2 = u * u + v * v, least2 = least * least;
    const int above = bits_of(uv2 > least2 ? uv2 : least2) - 0x3f3504f3;
    const float m = float_of((above & 0x7fffff) + 0x3f3504f3);
    const float s = (m - 1.0f) / (m + 1.0f), s2 = s * s;
    const float series_of_m = 1.0f + s2 * (1.0f / 3.0f + s2 * (0.2f + s2 * (1.0f / 7.0f)));
    // The angle is computed by the series of the arc tangent, after the angle is reduced to at most 1/16 turn.
    const float x = u < 0.0f ? -u : u, y = v < 0.0f ? -v : v;
    const float more = x > y ? x : y, less = x > y ? y : x;
    const bool beyond = less > 0.41421356f * more;
    const float t = (beyond ? less - more : less) / ((beyond ? less + more : more) + 1.0e-30f), t2 = t * t;
    const float series_of_t = 1.0f
        + t2
            * (-1.0f / 3.0f
                + t2 * (0.2f + t2 * (-1.0f / 7.0f + t2 * (1.0f / 9.0f + t2 * (-1.0f / 11.0f + t2 * (1.0f / 13.0f))))));
    float turn = 0.159154943f * t * series_of_t + (beyond ? 0.125f : 0.0f);
    turn = x > y ? turn : 0.25f - turn;
    turn = u < 0.0f ? 0.5f - turn : turn;
    return {
        0.5f * (float)(above >> 23) + 1.442695041f * s * series_of_m,
        wp::min(v < 0.0f ? 1.0f - turn : turn, 1.0f),
    };
}

// Compute the point (x, y) of the unit circle at an angle in turns. The error is at most 1e-6.
WARPDIFF_INLINE void on_circle(float turns, float& x, float& y)
{
    // The sine and cosine series are evaluated at half the angle, which is at most a quarter of a turn.
    const float a = PI * (turns - wp::rint(turns)), a2 = a * a;
    const float series =
        1.0f + a2 * (-1.0f / 6.0f + a2 * (1.0f / 120.0f + a2 * (-1.0f / 5040.0f + a2 * (1.0f / 362880.0f))));
    const float cosine = 1.0f
        + a2
            * (-0.5f
                + a2 * (1.0f / 24.0f + a2 * (-1.0f / 720.0f + a2 * (1.0f / 40320.0f + a2 * (-1.0f / 3628800.0f)))));
    const float sine = a * series;
    x = 1.0f - 2.0f * sine * sine;
    y = 2.0f * sine * cosine;
}

// Return the arc cosine of an argument [turns], from 0 to ½. Arguments are clamped to −1 and 1, where the result is
// exact. Elsewhere the error is at most 2e-5 (Abramowitz and Stegun 4.4.45).
WARPDIFF_INLINE float turns_of_cosine(float cosine)
{
    const float x = smaller(cosine < 0.0f ? -cosine : cosine, 1.0f);
    const float angle = wp::sqrt(1.0f - x) * (1.5707288f + x * (-0.2121144f + x * (0.0742610f - x * 0.0187293f)));
    return cosine < 0.0f ? 0.5f - angle * (0.5f / PI) : angle * (0.5f / PI);
}

// Return exp(−t) by a series of degree four, for |t| up to about 1.
WARPDIFF_INLINE float exp_of_minus_small(float t)
{
    return 1.0f - t * (1.0f - t * (0.5f - t * (1.0f / 6.0f - t * (1.0f / 24.0f))));
}

// Return exp(16 x), for x between −0.3 and 0, as the 16th power of exp(x), which is a series of degree four.
WARPDIFF_INLINE float exp_of_sixteenfold(float x)
{
    float result = 1.0f + x * (1.0f + x * (0.5f + x * (1.0f / 6.0f + x * (1.0f / 24.0f))));
    result *= result;
    result *= result;
    result *= result;
    result *= result;
    return result;
}

// Return exp(x) for x ≤ 0 with a relative error of at most 8e-8. The result is a power of two times a polynomial for
// the fractional exponent, which lies between −½ and ½.
WARPDIFF_INLINE float exp_of_negative(float x)
{
    const float y = wp::max(1.442695041f * x, -126.0f);
    const int whole = (int)(y - 0.5f);
    const float f = y - (float)whole;
    return float_of((whole + 127) << 23)
        * (1.00000007f
            + f
                * (0.693146967f
                    + f * (0.240221197f + f * (0.0555071328f + f * (0.00967554132f + f * 0.00132764707f)))));
}

} // namespace warpdiff
