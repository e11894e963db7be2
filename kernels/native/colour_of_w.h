// Conversion of a weighted sum of rows of a colour table to XYZ. A row has coefficients of basis functions of w, the
// normal component of the scattering vector (u, v, w). All rows share these functions. The zeroth order is added
// separately, because the rows exclude it.

#pragma once

#include "simd.h"

namespace warpdiff {

// Cubic interpolation in the table of the basis functions of w, the normal component of the scattering vector. The
// table has equal steps in |w|. Each of N pixels uses four consecutive entries of the table. The index of the first
// entry and the four weights are stored.
template <int N>
struct AtW {
    Batch<N, int> entry;
    Batch<N> weights[4];

    template <class Table>
    WARPDIFF_INLINE void set(int i, const Table& table, float w)
    {
        const float steps = wp::max((w - table.least_w) * table.per_w, 0.0f);
        const int last = table.w_basis.shape[0] - 4, before = (int)steps - 1;
        entry[i] = before < 0 ? 0 : before < last ? before : last;
        const float t = steps - (float)entry[i] - 1.0f, prior = t + 1.0f, after = 1.0f - t, beyond = 2.0f - t;
        weights[0][i] = (-1.0f / 6.0f) * t * after * beyond;
        weights[1][i] = 0.5f * prior * after * beyond;
        weights[2][i] = 0.5f * prior * t * beyond;
        weights[3][i] = (-1.0f / 6.0f) * prior * t * after;
    }
};

struct Colour {
    float xyz[3];
};

// Return X, Y and Z of pixel i: scalar products of a sum of table rows with basis functions of w, the normal component
// of the scattering vector, at the w of the pixel.
template <int WIDTH, int N, class Table>
WARPDIFF_INLINE Colour colour_at_w(const Table& table, const Row<WIDTH>& sum, const AtW<N>& at_w, int i)
{
    typedef typename Row<WIDTH>::Vector Vector;
    constexpr int CHANNEL_VECTORS = Row<WIDTH>::VECTORS / 3;
    const Vector* const entries = numbers<const Vector>(table.w_basis) + (long long)at_w.entry[i] * CHANNEL_VECTORS;
    const float w0 = at_w.weights[0][i], w1 = at_w.weights[1][i], w2 = at_w.weights[2][i], w3 = at_w.weights[3][i];
    Vector products[3] = {Vector{}, Vector{}, Vector{}};
    for (int k = 0; k < CHANNEL_VECTORS; ++k) {
        const Vector functions = w0 * entries[k] + w1 * entries[k + CHANNEL_VECTORS]
            + w2 * entries[k + 2 * CHANNEL_VECTORS] + w3 * entries[k + 3 * CHANNEL_VECTORS];
        for (int c = 0; c < 3; ++c) products[c] += sum.at[c * CHANNEL_VECTORS + k] * functions;
    }
    Colour result;
    for (int c = 0; c < 3; ++c) {
        result.xyz[c] = 0.0f;
        for (int l = 0; l < Row<WIDTH>::LANES; ++l) result.xyz[c] += ((const float*)&products[c])[l];
    }
    return result;
}

// Convert a weighted sum of rows of a colour table to XYZ at the w of index i, multiply the result by `share`, and add
// it to `xyz`, the sum of one pixel. XYZ may be slightly negative, because some weights of rows are negative. Negative
// values count as 0.
template <int WIDTH, int N, class Table>
WARPDIFF_INLINE void add_colour(
    const Table& table, const Row<WIDTH>& sum, const AtW<N>& at_w, int i, float share, float* xyz)
{
    const Colour colour = colour_at_w(table, sum, at_w, i);
    for (int c = 0; c < 3; ++c) xyz[c] += share * wp::max(colour.xyz[c], 0.0f);
}

// Add the XYZ of the zeroth order (the reflection at the mean plane) to one pixel. At each wavelength, this order is a
// Gaussian around (u, v) = 0, widened by the covariance (xx, xy, yy) of the footprint. `source2` is the square root of
// the determinant of the covariance of (u, v) over a light source of finite size, or 0 without such a source.
template <class Table>
WARPDIFF_INLINE void add_zeroth_order(
    const Table& table, float u, float v, float w, float xx, float xy, float yy, float source2, float gain, float* xyz)
{
    const int tabulated = table.zeroth_order.shape[0];
    if (tabulated == 0) return;
    const float* const wavenumbers = numbers<const float>(table.wavenumbers);
    const float* const weights = numbers<const float>(table.weights);
    const float* const powers = numbers<const float>(table.zeroth_order);
    const float least = wavenumbers[0];
    // Skip directions in which the Gaussian of the zeroth order, which is centred on u = v = 0, is below exp(−24) =
    // 4e-11 at all wavelengths.
    if (u * u + v * v >= 48.0f * (table.lobe2 / (least * least) + xx + yy)) return;
    // Interpolate the reflectance of the material linearly between two tabulated angles. The angle is θd, half of the
    // angle between light and view. Its cosine is |(u, v, w)|/2.
    const float* const reflectances = numbers<const float>(table.reflectances);
    const int angles = table.reflectances.shape[1];
    const float cosine = wp::min(0.5f * wp::sqrt(u * u + v * v + w * w), 1.0f) * (float)(angles - 1);
    const int angle = wp::clamp((int)cosine, 0, wp::max(angles - 2, 0));
    const float beyond = cosine - (float)angle;
    for (int k = 0; k < table.wavenumbers.shape[0]; ++k) {
        const float tau = wavenumbers[k], lobe2 = table.lobe2 / (tau * tau), a = lobe2 + xx, d = lobe2 + yy;
        const float determinant = a * d - xy * xy;
        const float exponent = (d * u * u - 2.0f * xy * u * v + a * v * v) / determinant;
        if (!(determinant > 0.0f && exponent < 48.0f)) continue;
        const float steps = wp::max((w * tau - table.least_kappa) * table.per_kappa, 0.0f);
        const int entry = wp::clamp((int)steps, 0, tabulated - 2);
        const float t = steps - (float)entry, power = (1.0f - t) * powers[entry] + t * powers[entry + 1];
        float factor = gain * power * (lobe2 + source2) / wp::sqrt(determinant) * wp::exp(-0.5f * exponent);
        if (angles > 0) {
            const float* const at = reflectances + k * angles + angle;
            factor *= (1.0f - beyond) * at[0] + beyond * at[1];
        }
        for (int c = 0; c < 3; ++c) xyz[c] += factor * weights[3 * k + c];
    }
}

} // namespace warpdiff
