// Sampling of the power spectrum along azimuths (lines of constant polar angle) of the frequency plane. A ring is a
// circle in this plane. The value at a ring is the integral of the spectrum, weighted by a quadratic B-spline in ln t
// around the ring, where t is the radius [1/µm].

#pragma once

#include "fast_math.h"
#include "quadratic_spline.h"
#include "simd.h"

namespace warpdiff {

// `TAPS` is the number of Gaussian weights that are computed together. `KNOWN_ROWS` is the number of rows of Fourier
// coefficients for which the range of contributing columns is computed in advance.
constexpr int TAPS = 16, KNOWN_ROWS = 64;

// Range of the Fourier coefficients that contribute to a point of the frequency plane, relative to the coefficient
// nearest to the point. All points use the same range. It is therefore large enough for every position of a point
// relative to its nearest coefficient.
struct Neighbours {
    int reach_y, reach_x, on_row[KNOWN_ROWS];
    // Row and column of the zeroth order if it is excluded from sums of Fourier coefficients; −1 otherwise.
    int excluded_y, excluded_x;

    template <class Table>
    WARPDIFF_INLINE Neighbours(const Table& table, int excluded)
    {
        excluded_y = excluded < 0 ? -1 : excluded / table.count_x;
        excluded_x = excluded - excluded_y * table.count_x;
        reach_y = (int)(wp::sqrt(table.exponent / table.across) + 0.5f);
        reach_x = (int)(wp::sqrt(table.exponent / table.along) + 0.5f);
        for (int j = 0; j < KNOWN_ROWS; ++j) {
            const float away = wp::max((float)j - 0.5f, 0.0f);
            on_row[j] =
                (int)(wp::sqrt(wp::max(table.exponent - table.across * away * away, 0.0f) / table.along) + 0.5f);
        }
    }
};

// Compute exp(−scale · x²) at TAPS distances x. The distances are consecutive integers from `from` on, minus `beside`,
// the fractional part of a position.
WARPDIFF_INLINE void gaussian_taps(float scale, int from, float beside, float* taps)
{
    for (int i = 0; i < TAPS; ++i) {
        const float away = (float)(from + i) - beside;
        taps[i] = exp_of_negative(-scale * away * away);
    }
}

// Return the weighted sum of the Fourier coefficients in the columns from `column` + `begin` to `column` + `end`
// (excluded) of a row. Coefficients are periodic: a sum across the edge of the table continues at the other edge.
template <int WIDTH, class Table>
WARPDIFF_INLINE Row<WIDTH> sum_of_neighbours(
    const Table& table, const Neighbours& around, int y, int column, const float* taps, int begin, int end)
{
    const int count_x = table.count_x;
    const bool inside = column >= 0 && column + TAPS <= count_x;
    const float* const row = numbers<const float>(table.rows) + (long long)y * count_x * WIDTH;
    Row<WIDTH> sum;
    sum.clear();
    if (inside && y != around.excluded_y) {
        const float* const from = row + (long long)column * WIDTH;
        for (int i = begin; i < end; ++i) sum.add(taps[i], from + i * WIDTH);
        return sum;
    }
    for (int i = begin; i < end; ++i) {
        const int x = inside ? column + i : cyclic(column + i, count_x);
        if (y == around.excluded_y && x == around.excluded_x) continue;
        sum.add(taps[i], row + (long long)x * WIDTH);
    }
    return sum;
}

// Return the sum of the Fourier coefficients around a point of the frequency plane, weighted by the Gaussian of the
// coherence window.
template <int WIDTH, class Table>
WARPDIFF_INLINE Row<WIDTH> sample_spectrum(const Table& table, const Neighbours& around, double qy, double qx)
{
    // The point of the frequency plane may be hundreds of Fourier coefficients away from the zeroth order, where
    // float32 is too coarse. The integer part of its position is therefore subtracted in float64.
    const int nearest_y = (int)(qy + (qy < 0.0 ? -0.5 : 0.5)), nearest_x = (int)(qx + (qx < 0.0 ? -0.5 : 0.5));
    const float fy = (float)(qy - (double)nearest_y), fx = (float)(qx - (double)nearest_x);
    const int reach_y = around.reach_y, reach_x = around.reach_x;
    Row<WIDTH> total;
    total.clear();
    for (int from_x = -reach_x; from_x <= reach_x; from_x += TAPS) {
        float of_columns[TAPS];
        gaussian_taps(table.along, from_x, fx, of_columns);
        const int column = nearest_x + table.origin_x + from_x;
        for (int from_y = -reach_y; from_y <= reach_y; from_y += TAPS) {
            float of_rows[TAPS];
            gaussian_taps(table.across, from_y, fy, of_rows);
            for (int j = 0; j < TAPS && from_y + j <= reach_y; ++j) {
                const int aside = from_y + j < 0 ? -from_y - j : from_y + j;
                const int neighbour_extent = aside < KNOWN_ROWS ? around.on_row[aside] : reach_x;
                const int begin = wp::max(-neighbour_extent - from_x, 0),
                          end = wp::min(neighbour_extent - from_x + 1, TAPS);
                int y = nearest_y + table.origin_y + from_y + j;
                if (y < 0 || y >= table.count_y) y = cyclic(y, table.count_y);
                total.add(of_rows[j], sum_of_neighbours<WIDTH>(table, around, y, column, of_columns, begin, end));
            }
        }
    }
    return total;
}

// Return the power at WIDTH values of κ = w/λ from a weighted sum of rows. A row has the amplitude of a Fourier
// coefficient: the terms of its real part precede those of its imaginary part. `basis` has the values of each basis
// function at the WIDTH values of κ.
template <int TERMS, int WIDTH>
WARPDIFF_INLINE Row<WIDTH> powers_of(const Row<2 * TERMS>& amplitudes, const float* basis)
{
    Row<WIDTH> re, im;
    re.clear();
    im.clear();
    for (int n = 0; n < TERMS; ++n, basis += WIDTH) {
        re.add(((const float*)amplitudes.at)[n], basis);
        im.add(((const float*)amplitudes.at)[TERMS + n], basis);
    }
    for (int l = 0; l < Row<WIDTH>::VECTORS; ++l) re.at[l] = re.at[l] * re.at[l] + im.at[l] * im.at[l];
    return re;
}

// Integrals of the spectrum, weighted by the splines of three consecutive rings (circles of constant frequency). A
// sample contributes to three integrals, which remain in registers while the sampling proceeds from ring to ring.
template <int WIDTH>
struct SplineSums {
    Row<WIDTH> before, here, behind;

    WARPDIFF_INLINE SplineSums()
    {
        before.clear();
        here.clear();
        behind.clear();
    }

    // Add a sample of the spectrum to the integrals of three rings (circles of constant frequency). `f` is the distance
    // of the sample from the middle ring, in ring spacings.
    WARPDIFF_INLINE void add(const Row<WIDTH>& value, float f, float scale)
    {
        float weights[3];
        quadratic_spline(f, weights);
        before.add(scale * weights[0], value);
        here.add(scale * weights[1], value);
        behind.add(scale * weights[2], value);
    }

    WARPDIFF_INLINE void move_on()
    {
        before = here;
        here = behind;
        behind.clear();
    }
};

template <int WIDTH>
WARPDIFF_INLINE void put_ring(float* rows, int ring, int count, const Row<WIDTH>& value)
{
    if (ring < 0 || ring >= count) return;
    for (int l = 0; l < Row<WIDTH>::VECTORS; ++l)
        ((typename Row<WIDTH>::Vector*)rows)[(long long)ring * Row<WIDTH>::VECTORS + l] = value.at[l];
}

// Compute the integrals of the spectrum along one azimuth (polar angle) at `rings` rings (circles), and store them from
// the row `begin` on. A sample at the frequency t [1/µm] is at the position (`sine` · t, `cosine` · t), in units of the
// distance of neighbouring coefficients. There are `divisions` samples from one ring to the next. The argument `t` is
// the frequency of the first sample. Each sample has `ratio` times the frequency of the previous sample, up to the
// frequency `highest`.
//
// A row has the TERMS series terms of a power |H|² (PARTS = 1), or of the real and imaginary part of an amplitude H
// (PARTS = 2). Amplitudes are converted to powers at WIDTH values of κ = w/λ before integration.
template <int TERMS, int PARTS, int WIDTH, class Table, class Bases, class Values>
WARPDIFF_INLINE void sample_azimuth(const Table& table, const Bases& bases, double sine, double cosine, int rings,
    double t, double ratio, int divisions, double highest, float scale, int excluded, int begin, Values& values_out)
{
    const Neighbours around(table, excluded);
    float* const out = numbers<float>(values_out) + (long long)begin * WIDTH;
    Row<WIDTH> nothing;
    nothing.clear();
    for (int ring = 0; ring < rings; ++ring) put_ring(out, ring, rings, nothing);
    SplineSums<WIDTH> sums;
    int ring = -1;
    for (; ring <= rings && t <= highest; ++ring) {
        for (int k = 0; k < divisions && t <= highest; ++k, t *= ratio) {
            const Row<TERMS * PARTS> total = sample_spectrum<TERMS * PARTS>(table, around, t * sine, t * cosine);
            const float f = ((float)k + 0.5f) / (float)divisions - 0.5f;
            if constexpr (PARTS == 1)
                sums.add(total, f, scale);
            else
                sums.add(powers_of<TERMS, WIDTH>(total, numbers<const float>(bases)), f, scale);
        }
        put_ring(out, ring - 1, rings, sums.before);
        sums.move_on();
    }
    put_ring(out, ring - 1, rings, sums.before);
    put_ring(out, ring, rings, sums.here);
}

} // namespace warpdiff
