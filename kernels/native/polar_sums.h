// Power spectrum on a polar grid of the frequency plane in float64, colours as sums over its rings, and transposes.
//
// An azimuth is a line of constant polar angle in the frequency plane, and a ring is a circle in this plane. t is the
// frequency along an azimuth. A block of rings has equally many azimuth samples on each ring. The spectrum is also
// sampled between rings: a sample contributes to three rings, with the weights of a quadratic B-spline in ln t. Along a
// ring, values are the coefficients of a cubic B-spline over the azimuth. κ is w/λ, for the wavelength λ and the
// scattering vector (u, v, w). The power |H|² of each Fourier coefficient of the surface is a Chebyshev series in κ.
// The adjoint of a quantity is the derivative of a scalar loss with respect to it.

#pragma once

#include "lobe_sums.h"

namespace warpdiff {

// Template arguments of the functions below, which kernels/polar_sums.py sets: BLOCK_RINGS is the number of rings
// (circles of the polar grid) per block, RINGS_TOGETHER the number of rings that one thread of `spread_pixels`
// processes, and MOST_TERMS the largest number of terms of a Chebyshev series.
constexpr double RADIANS_PER_TURN = 6.283185307179586;
// Number of columns of the block of Fourier coefficients whose Gaussian weights are computed together.
constexpr int COLUMNS_TOGETHER = 128;

// Weights with which a sample of the spectrum contributes to three rings (circles of the polar grid), whose indices are
// `ring` − 1, `ring` and `ring` + 1. `k` is the index of the sample along an azimuth (polar angle) within a block of
// rings. Sample 0 is about 1.5 ring spacings inside the first ring of the block, at a lower frequency.
struct SampleWeights {
    int ring;
    double weights[3];

    WARPDIFF_INLINE SampleWeights(int k, int divisions, double step)
    {
        const double place = ((double)k + 0.5) / (double)divisions - 1.5;
        const double nearest = wp::floor(place + 0.5), away = place - nearest, scale = step / (double)divisions;
        ring = (int)nearest;
        weights[0] = scale * 0.5 * (0.5 - away) * (0.5 - away);
        weights[1] = scale * (0.75 - away * away);
        weights[2] = scale * 0.5 * (0.5 + away) * (0.5 + away);
    }
};

// The Gaussian weight of a Fourier coefficient is a product of two factors, one for x and one for y. Return the
// negative logarithm of the factor of one axis.
template <class Grid>
WARPDIFF_INLINE double exponent_along(const Grid& grid, double position, int order, double step)
{
    const double away = position - (double)order * step;
    return grid.falloff * away * away;
}

// Add the Fourier coefficients near the frequency (qx, qy), multiplied by their Gaussian weights, to `total`.
template <class Table, class Grid>
WARPDIFF_INLINE void add_neighbours(const Table& table, const Grid& grid, double qx, double qy, double* total)
{
    const double reach = wp::sqrt(table.exponent / grid.falloff);
    const int first_row = Lobe::within((qy - reach) / table.step_y, table.first_row, table.rows, 1);
    const int last_row = Lobe::within((qy + reach) / table.step_y, table.first_row, table.rows, 0);
    const int first_column = Lobe::within((qx - reach) / table.step_x, table.first_column, table.columns, 1);
    const int last_column = Lobe::within((qx + reach) / table.step_x, table.first_column, table.columns, 0);
    for (int begin = first_column; begin <= last_column; begin += COLUMNS_TOGETHER) {
        const int count = wp::min(last_column - begin + 1, COLUMNS_TOGETHER);
        double exponents[COLUMNS_TOGETHER], weights[COLUMNS_TOGETHER];
        for (int j = 0; j < count; ++j) {
            exponents[j] = exponent_along(grid, qx, table.first_column + begin + j, table.step_x);
            weights[j] = wp::exp(-exponents[j]);
        }
        for (int row = first_row; row <= last_row; ++row) {
            const double across = exponent_along(grid, qy, table.first_row + row, table.step_y);
            const double of_row = wp::exp(-across);
            for (int j = 0; j < count; ++j) {
                const int column = begin + j;
                if (exponents[j] + across > table.exponent || row * table.columns + column == grid.excluded) continue;
                const double* const coefficient = coefficient_row(table, row, column);
                const double weight = of_row * weights[j];
                for (int n = 0; n < table.terms; ++n) total[n] += weight * coefficient[n];
            }
        }
    }
}

// Compute the power spectrum along one azimuth (polar angle of the frequency), at a group of consecutive rings. A ring
// is a circle of constant frequency.
template <int BLOCK_RINGS, int MOST_TERMS, class Table, class Grid, class Values>
WARPDIFF_INLINE void sample_azimuth_rings(const Table& table, const Grid& grid, int direction, Values& values_out)
{
    if (!numbers<const bool>(grid.is_used)[direction]) return;
    const int block = numbers<const int>(grid.block_of)[direction];
    const int azimuths = numbers<const int>(grid.azimuths)[block];
    const int azimuth = direction - numbers<const int>(grid.first_directions)[block];
    const int divisions = numbers<const int>(grid.divisions)[block], terms = table.terms;
    const double cosine = numbers<const double>(grid.directions)[2LL * direction];
    const double sine = numbers<const double>(grid.directions)[2LL * direction + 1];
    const double* const radii = numbers<const double>(grid.radii) + numbers<const int>(grid.first_radii)[block];
    const long long stride = (long long)azimuths * terms;
    double* const out =
        numbers<double>(values_out) + ((long long)numbers<const int>(grid.starts)[block] + azimuth) * terms;
    double total[MOST_TERMS];
    for (int k = 0; k < (BLOCK_RINGS + 2) * divisions; ++k) {
        for (int n = 0; n < terms; ++n) total[n] = 0.0;
        add_neighbours(table, grid, radii[k] * cosine, radii[k] * sine, total);
        const SampleWeights sample(k, divisions, grid.step);
        for (int m = 0; m < 3; ++m) {
            const int ring = sample.ring - 1 + m;
            if (ring < 0 || ring >= BLOCK_RINGS) continue;
            for (int n = 0; n < terms; ++n) out[ring * stride + n] += sample.weights[m] * total[n];
        }
    }
}

// Azimuth samples of the polar grid, from `begin` to `end` (excluded), that have samples of the spectrum within the
// distance `reach` of the frequency (x, y). `radius` is the length of (x, y). The range is wider by one azimuth on each
// side because of rounding errors. Indices below 0 and from `azimuths` on continue around the circle.
struct NearAzimuths {
    int begin, end;

    WARPDIFF_INLINE NearAzimuths(double x, double y, double radius, double reach, int azimuths)
    {
        begin = 0, end = azimuths;
        if (radius > 1.01 * reach) {
            const double per_azimuth = RADIANS_PER_TURN / (double)azimuths;
            const double middle = wp::atan2(y, x) / per_azimuth, half = wp::asin(reach / radius) / per_azimuth;
            begin = (int)wp::floor(middle - half) - 1;
            end = wp::min((int)wp::ceil(middle + half) + 2, begin + azimuths);
        }
    }
};

// Add the contributions of nearby samples of the spectrum to the adjoint of one Fourier coefficient. An adjoint is the
// derivative of a loss. The function is the transpose of `sample_azimuth_rings`.
template <int BLOCK_RINGS, class Table, class Grid, class Values, class Rows>
WARPDIFF_INLINE void spread_rings(const Table& table, const Grid& grid, const Values& values, int cell, Rows& rows_out)
{
    if (cell == grid.excluded) return;
    const int row = cell / table.columns, column = cell - row * table.columns, terms = table.terms;
    const double x = (double)(table.first_column + column) * table.step_x;
    const double y = (double)(table.first_row + row) * table.step_y;
    const double radius = wp::sqrt(x * x + y * y), reach = wp::sqrt(table.exponent / grid.falloff);
    double* const out = numbers<double>(rows_out) + (long long)cell * terms;
    const int blocks = (int)grid.azimuths.shape[0];
    for (int block = 0; block < blocks; ++block) {
        const int divisions = numbers<const int>(grid.divisions)[block], count = (BLOCK_RINGS + 2) * divisions;
        const int azimuths = numbers<const int>(grid.azimuths)[block];
        const int first_direction = numbers<const int>(grid.first_directions)[block];
        const double* const radii = numbers<const double>(grid.radii) + numbers<const int>(grid.first_radii)[block];
        if (radii[count - 1] < radius - reach || radii[0] > radius + reach) continue;
        const NearAzimuths near(x, y, radius, reach, azimuths);
        const double first_log = grid.log_first + (double)(block * BLOCK_RINGS) * grid.step;
        for (int j = near.begin; j < near.end; ++j) {
            const int azimuth = j < 0 ? j + azimuths : j >= azimuths ? j - azimuths : j;
            if (!numbers<const bool>(grid.is_used)[first_direction + azimuth]) continue;
            const double cosine = numbers<const double>(grid.directions)[2LL * (first_direction + azimuth)];
            const double sine = numbers<const double>(grid.directions)[2LL * (first_direction + azimuth) + 1];
            const double along = x * cosine + y * sine, across = y * cosine - x * sine;
            const double half2 = reach * reach - across * across;
            if (half2 < -1.0e-9 * reach * reach) continue;
            const double half = wp::sqrt(wp::max(half2, 0.0));
            if (along + half < radii[0] || along - half > radii[count - 1]) continue;
            // Along this azimuth (polar angle), only samples at frequencies from `low` to `high` are near the Fourier
            // coefficient. The range of their indices is wider on each side because of rounding errors.
            const double per_sample = (double)divisions / grid.step;
            const double low = wp::max(along - half, radii[0]), high = wp::min(along + half, radii[count - 1]);
            const int from = wp::max((int)wp::floor((wp::log(low) - first_log) * per_sample + 1.5 * divisions) - 2, 0);
            const int to =
                wp::min((int)wp::ceil((wp::log(high) - first_log) * per_sample + 1.5 * divisions) + 2, count);
            double weights[BLOCK_RINGS] = {};
            int low_ring = BLOCK_RINGS, high_ring = -1;
            for (int k = from; k < to; ++k) {
                const double form = exponent_along(grid, radii[k] * cosine, table.first_column + column, table.step_x)
                    + exponent_along(grid, radii[k] * sine, table.first_row + row, table.step_y);
                if (form > table.exponent) continue;
                const double weight = wp::exp(-form);
                const SampleWeights sample(k, divisions, grid.step);
                for (int m = 0; m < 3; ++m) {
                    const int ring = sample.ring - 1 + m;
                    if (ring < 0 || ring >= BLOCK_RINGS) continue;
                    weights[ring] += weight * sample.weights[m];
                    low_ring = wp::min(low_ring, ring), high_ring = wp::max(high_ring, ring);
                }
            }
            const double* const from_row =
                numbers<const double>(values) + ((long long)numbers<const int>(grid.starts)[block] + azimuth) * terms;
            for (int ring = low_ring; ring <= high_ring; ++ring) {
                const double* const value = from_row + (long long)ring * azimuths * terms;
                for (int n = 0; n < terms; ++n) out[n] += weights[ring] * value[n];
            }
        }
    }
}

// Position of a direction on one ring (circle) of the polar grid: the four azimuth samples around it, and their cubic
// B-spline weights.
template <int BLOCK_RINGS>
struct AroundRing {
    long long start;
    int azimuths, first;
    double weights[4];

    template <class Grid>
    WARPDIFF_INLINE AroundRing(const Grid& grid, int ring, double turns)
    {
        const int block = ring / BLOCK_RINGS;
        azimuths = numbers<const int>(grid.azimuths)[block];
        start = numbers<const int>(grid.starts)[block] + (long long)(ring - block * BLOCK_RINGS) * azimuths;
        const double place = turns * (double)azimuths, before = wp::floor(place), t = place - before, s = 1.0 - t;
        first = (int)before - 1;
        weights[0] = s * s * s / 6.0;
        weights[1] = 2.0 / 3.0 - 0.5 * t * t * (2.0 - t);
        weights[2] = 2.0 / 3.0 - 0.5 * s * s * (2.0 - s);
        weights[3] = t * t * t / 6.0;
    }

    // Return the index of the array row with the power spectrum at azimuth sample j of the four, where j is 0 to 3.
    WARPDIFF_INLINE long long row(int j) const
    {
        const int azimuth = first + j;
        return start + (azimuth < 0 ? azimuth + azimuths : azimuth >= azimuths ? azimuth - azimuths : azimuth);
    }
};

// Rings (circles of constant frequency) whose spectrum contributes to the colour of one direction, and their weights in
// X, Y and Z.
struct ColourRings {
    int first, count, entry;
    double share, place;

    template <class Pixels>
    WARPDIFF_INLINE ColourRings(const Pixels& pixels, int pixel)
    {
        place = numbers<const double>(pixels.places)[pixel];
        count = (int)pixels.curves.shape[1];
        const double ahead = wp::ceil(place);
        const int intervals = (int)pixels.curves.shape[0] - 1;
        first = (int)ahead - 2;
        const double at = (ahead - place) * (double)intervals;
        entry = wp::min((int)at, intervals - 1);
        share = at - (double)entry;
    }

    // Compute the weights in X, Y and Z of ring m (a circle of constant frequency) among the rings that contribute to
    // the colour of a direction. The weights are 0 if m is not the index of such a ring.
    template <class Pixels>
    WARPDIFF_INLINE void weights(const Pixels& pixels, int m, double* xyz) const
    {
        const bool inside = m >= 0 && m < count;
        const double* const low = numbers<const double>(pixels.curves) + 3LL * (entry * count + (inside ? m : 0));
        const double* const high = low + 3LL * count;
        for (int c = 0; c < 3; ++c) xyz[c] = inside ? (1.0 - share) * low[c] + share * high[c] : 0.0;
    }

    // Return the reflectance at the wavelength of ring m (a circle of constant |(u, v)|/λ) among the rings that
    // contribute to the colour of a direction. If m is not the index of such a ring, return the reflectance at the
    // nearest of these rings.
    template <class Pixels>
    WARPDIFF_INLINE double reflectance(const Pixels& pixels, int pixel, int m) const
    {
        if (is_empty(pixels.reflectances)) return 1.0;
        const int ring = wp::min(wp::max(m, 0), count - 1);
        return numbers<const double>(pixels.reflectances)[(long long)pixel * count + ring];
    }
};

// Compute the Chebyshev polynomials at κ = w/λ, multiplied by the reflectance at λ. At the wavelength λ, the frequency
// of a direction is on ring m, a circle of the polar grid.
template <class Grid, class Pixels>
WARPDIFF_INLINE void polynomials_at(
    const Grid& grid, const Pixels& pixels, const ColourRings& rings, int pixel, int m, int terms, double* polynomials)
{
    const double frequency = wp::exp(grid.log_first + (double)(rings.first + m) * grid.step);
    const double kappa = numbers<const double>(pixels.slopes)[pixel] * frequency;
    chebyshev_polynomials((kappa - pixels.least_kappa) * pixels.places_per_kappa - 1.0, terms, polynomials);
    const double reflectance = rings.reflectance(pixels, pixel, m);
    for (int n = 0; n < terms; ++n) polynomials[n] *= reflectance;
}

// Compute the colour of one direction.
//
// A colour curve is the illuminant times x̄, ȳ or z̄. It is fitted by quadratic splines, one for each ring (circle of
// constant |(u, v)|/λ), with the weights c. The value at a ring is the integral of the spectrum over the spline of this
// ring. The Chebyshev polynomials in κ times the reflectance of the material, T, change within a spline. In a fit of
// the product of colour curve and T, the spline therefore has the weight c T − (c₊ (T₊ − T) + c₋ (T₋ − T))/8, to second
// order. Here c₋ and T₋ belong to the ring before, and c₊ and T₊ to the ring after.
template <int BLOCK_RINGS, int MOST_TERMS, class Grid, class Values, class Pixels, class Colours>
WARPDIFF_INLINE void sum_rings(
    const Grid& grid, const Values& values, const Pixels& pixels, int pixel, Colours& xyz_out)
{
    const ColourRings rings(pixels, pixel);
    const int terms = (int)values.shape[1];
    const double turns = numbers<const double>(pixels.turns)[pixel], gain = numbers<const double>(pixels.gains)[pixel];
    double polynomials[3][MOST_TERMS], weights[3][3], sums[3] = {}, row[MOST_TERMS];
    for (int k = 0; k < 2; ++k) {
        polynomials_at(grid, pixels, rings, pixel, k - 1, terms, polynomials[k]);
        rings.weights(pixels, k - 1, weights[k]);
    }
    for (int m = 0; m < rings.count; ++m) {
        const int before = m % 3, here = (m + 1) % 3, after = (m + 2) % 3;
        polynomials_at(grid, pixels, rings, pixel, m + 1, terms, polynomials[after]);
        rings.weights(pixels, m + 1, weights[after]);
        const AroundRing<BLOCK_RINGS> around(grid, rings.first + m, turns);
        const double* rows[4];
        for (int j = 0; j < 4; ++j) rows[j] = numbers<const double>(values) + around.row(j) * terms;
        double own = 0.0, earlier = 0.0, later = 0.0;
        for (int n = 0; n < terms; ++n)
            row[n] = around.weights[0] * rows[0][n] + around.weights[1] * rows[1][n] + around.weights[2] * rows[2][n]
                + around.weights[3] * rows[3][n];
        for (int n = 0; n < terms; ++n) {
            own += row[n] * polynomials[here][n];
            earlier += row[n] * polynomials[before][n];
            later += row[n] * polynomials[after][n];
        }
        for (int c = 0; c < 3; ++c)
            sums[c] += weights[here][c] * own
                - 0.125 * (weights[before][c] * (earlier - own) + weights[after][c] * (later - own));
    }
    for (int c = 0; c < 3; ++c) numbers<double>(xyz_out)[3LL * pixel + c] = gain * sums[c];
}

// Add the contributions of the colours of all directions to the adjoints of the power spectrum on a few rings (circles
// of the polar grid). An adjoint is the derivative of a loss. The function is the transpose of `sum_rings`.
template <int BLOCK_RINGS, int RINGS_TOGETHER, int MOST_TERMS, class Grid, class Pixels, class Values>
WARPDIFF_INLINE void spread_pixels(const Grid& grid, const Pixels& pixels, int group, Values& values_out)
{
    constexpr int N = RINGS_TOGETHER + 2;
    const int terms = (int)values_out.shape[1], first_ring = group * RINGS_TOGETHER;
    double polynomials[N][MOST_TERMS], weights[N];
    for (int pixel = numbers<const int>(pixels.begins)[group]; pixel < numbers<const int>(pixels.ends)[group];
        ++pixel) {
        const ColourRings rings(pixels, pixel);
        const double turns = numbers<const double>(pixels.turns)[pixel];
        const double gain = numbers<const double>(pixels.gains)[pixel];
        const double* const adjoint = numbers<const double>(pixels.adjoints) + 3LL * pixel;
        for (int k = 0; k < N; ++k) {
            const int ring = first_ring - 1 + k;
            double xyz[3];
            rings.weights(pixels, ring - rings.first, xyz);
            weights[k] = gain * (adjoint[0] * xyz[0] + adjoint[1] * xyz[1] + adjoint[2] * xyz[2]);
            // For rings (circles of the grid) that do not contribute to the colour of this direction, the polynomials
            // are not computed, because their values may be huge.
            const bool used = ring >= rings.first - 1 && ring <= rings.first + rings.count;
            if (used) polynomials_at(grid, pixels, rings, pixel, ring - rings.first, terms, polynomials[k]);
        }
        for (int k = 1; k <= RINGS_TOGETHER; ++k) {
            const int ring = first_ring - 1 + k;
            if (ring < rings.first || ring >= rings.first + rings.count) continue;
            const double own = weights[k] + 0.125 * (weights[k - 1] + weights[k + 1]);
            const double earlier = -0.125 * weights[k - 1], later = -0.125 * weights[k + 1];
            double row[MOST_TERMS];
            for (int n = 0; n < terms; ++n)
                row[n] = own * polynomials[k][n] + earlier * polynomials[k - 1][n] + later * polynomials[k + 1][n];
            const AroundRing<BLOCK_RINGS> around(grid, ring, turns);
            for (int j = 0; j < 4; ++j) {
                double* const out = numbers<double>(values_out) + around.row(j) * terms;
                for (int n = 0; n < terms; ++n) out[n] += around.weights[j] * row[n];
            }
        }
    }
}

} // namespace warpdiff
