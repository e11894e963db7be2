// Sums of Fourier coefficients under Gaussian lobes in float64, their derivatives, and the transposed sum.
//
// A Fourier coefficient of order (s, r) is a series of Chebyshev polynomials in x, one row of `terms` numbers. Here x
// is κ = w/λ, scaled to the range from −1 to 1, for the wavelength λ and the scattering vector (u, v, w). A pair of a
// direction and a wavelength has a centre q = (u, v)/λ [1/µm], a positive definite matrix M [µm²], and its x. The
// weight of the coefficient at the frequency q_rs is exp(−dᵀMd) with d = q − q_rs. L_x and L_y are the lengths of the
// patch. The adjoint of a quantity is the derivative of a scalar loss with respect to it.

#pragma once

#include "simd.h"

namespace warpdiff {

// Number of values that `differentiate_lobe` writes for a weighted sum of Fourier coefficients: the derivatives with
// respect to the centre (q_x, q_y) of the weights, their matrix (M_xx, M_xy, M_yy), the argument x of the Chebyshev
// series, and the lengths L_x and L_y of the patch; two sums with the orders r and s as further factors; the sum.
constexpr int LOBE_DERIVATIVES = 11;

// Compute the first `count` Chebyshev polynomials at x.
WARPDIFF_INLINE void chebyshev_polynomials(double x, int count, double* values)
{
    double now = 1.0, after = x;
    for (int k = 0; k < count; ++k) {
        values[k] = now;
        const double next = 2.0 * x * after - now;
        now = after;
        after = next;
    }
}

// Compute the derivatives k U_{k−1} of the first `count` Chebyshev polynomials at x. U are the Chebyshev polynomials of
// the second kind.
WARPDIFF_INLINE void chebyshev_slopes(double x, int count, double* values)
{
    double now = 0.0, after = 1.0;
    for (int k = 0; k < count; ++k) {
        values[k] = (double)k * now;
        const double next = 2.0 * x * after - now;
        now = after;
        after = next;
    }
}

// Gaussian weights (a lobe) for a pair of a direction and a wavelength. The struct also has the rows and columns of the
// block of Fourier coefficients in which these weights are not negligible.
struct Lobe {
    double qx, qy, xx, xy, yy, step_x, step_y, exponent;
    int first_row, last_row, first_column, last_column;

    template <class Table, class Pairs>
    WARPDIFF_INLINE Lobe(const Table& table, const Pairs& pairs, int pair)
    {
        const double* const centre = numbers<const double>(pairs.centres) + 2LL * pair;
        const double* const form = numbers<const double>(pairs.forms) + 3LL * pair;
        qx = centre[0], qy = centre[1], xx = form[0], xy = form[1], yy = form[2];
        step_x = table.step_x, step_y = table.step_y, exponent = table.exponent;
    }

    // Find the rows and columns of the block of Fourier coefficients in which Gaussian weights are not negligible.
    template <class Table>
    WARPDIFF_INLINE void find_range(const Table& table)
    {
        // Gaussian weights of coefficients are not negligible inside the ellipse dᵀMd = exponent. It extends to
        // √(exponent · (M⁻¹)_xx) along x.
        const double scale = exponent / (xx * yy - xy * xy);
        const double reach_x = wp::sqrt(scale * yy) / step_x, reach_y = wp::sqrt(scale * xx) / step_y;
        first_column = within(qx / step_x - reach_x, table.first_column, table.columns, 1);
        last_column = within(qx / step_x + reach_x, table.first_column, table.columns, 0);
        first_row = within(qy / step_y - reach_y, table.first_row, table.rows, 1);
        last_row = within(qy / step_y + reach_y, table.first_row, table.rows, 0);
    }

    // Round the end of a range of frequencies to a Fourier coefficient of the block. Return the index of its row or
    // column, from 0 to `count` − 1. If the lower end of the range is beyond the block, the result is `count`. If the
    // upper end of the range is before the block, the result is −1. The range is then empty.
    static WARPDIFF_INLINE int within(double position, int first, int count, int up)
    {
        const double index = (up ? wp::ceil(position) : wp::floor(position)) - (double)first;
        return (
            int)(up ? wp::min(wp::max(index, 0.0), (double)count) : wp::max(wp::min(index, (double)count - 1.0), -1.0));
    }

    // Return the Gaussian weight of the Fourier coefficient in a row and a column. Set `dx` and `dy` to the distances
    // of its frequency from the centre. The weight is 0 outside of the ellipse in which coefficients are summed.
    template <class Table>
    WARPDIFF_INLINE double weight(const Table& table, int row, int column, double& dx, double& dy) const
    {
        dx = qx - (double)(table.first_column + column) * step_x;
        dy = qy - (double)(table.first_row + row) * step_y;
        const double form = xx * dx * dx + 2.0 * xy * dx * dy + yy * dy * dy;
        return form > exponent ? 0.0 : wp::exp(-form);
    }
};

WARPDIFF_INLINE double dot_rows(const double* a, const double* b, int count)
{
    double sum = 0.0;
    for (int k = 0; k < count; ++k) sum += a[k] * b[k];
    return sum;
}

template <class Table>
WARPDIFF_INLINE const double* coefficient_row(const Table& table, int row, int column)
{
    const int place = numbers<const int>(table.places)[(long long)row * table.columns + column];
    return numbers<const double>(table.coefficients) + (long long)place * table.terms;
}

// Return the weighted sum of Fourier coefficients for a pair of a direction and a wavelength. Each coefficient is a
// series of at most MOST_TERMS terms.
template <int MOST_TERMS, class Table, class Pairs>
WARPDIFF_INLINE double sum_lobe(const Table& table, const Pairs& pairs, int pair)
{
    Lobe lobe(table, pairs, pair);
    lobe.find_range(table);
    double polynomials[MOST_TERMS], sum = 0.0, dx, dy;
    chebyshev_polynomials(numbers<const double>(pairs.places)[pair], table.terms, polynomials);
    for (int row = lobe.first_row; row <= lobe.last_row; ++row) {
        for (int column = lobe.first_column; column <= lobe.last_column; ++column) {
            const double weight = lobe.weight(table, row, column, dx, dy);
            if (weight != 0.0) sum += weight * dot_rows(coefficient_row(table, row, column), polynomials, table.terms);
        }
    }
    return sum;
}

// Compute the derivatives of the weighted sum of Fourier coefficients for a pair of a direction and a wavelength, in
// the order in which `LOBE_DERIVATIVES` has them.
template <int MOST_TERMS, class Table, class Pairs, class Values>
WARPDIFF_INLINE void differentiate_lobe(const Table& table, const Pairs& pairs, int pair, Values& derivatives_out)
{
    Lobe lobe(table, pairs, pair);
    lobe.find_range(table);
    double* const out = numbers<double>(derivatives_out) + (long long)pair * LOBE_DERIVATIVES;
    double polynomials[MOST_TERMS], slopes[MOST_TERMS], sums[LOBE_DERIVATIVES] = {}, dx, dy;
    chebyshev_polynomials(numbers<const double>(pairs.places)[pair], table.terms, polynomials);
    chebyshev_slopes(numbers<const double>(pairs.places)[pair], table.terms, slopes);
    for (int row = lobe.first_row; row <= lobe.last_row; ++row) {
        const double s = (double)(table.first_row + row);
        for (int column = lobe.first_column; column <= lobe.last_column; ++column) {
            const double weight = lobe.weight(table, row, column, dx, dy);
            if (weight == 0.0) continue;
            const double* const coefficient = coefficient_row(table, row, column);
            const double r = (double)(table.first_column + column);
            const double value = weight * dot_rows(coefficient, polynomials, table.terms);
            const double along_x = -2.0 * (lobe.xx * dx + lobe.xy * dy) * value;
            const double along_y = -2.0 * (lobe.xy * dx + lobe.yy * dy) * value;
            sums[0] += along_x;
            sums[1] += along_y;
            sums[2] -= dx * dx * value;
            sums[3] -= 2.0 * dx * dy * value;
            sums[4] -= dy * dy * value;
            sums[5] += weight * dot_rows(coefficient, slopes, table.terms);
            // The frequency of the Fourier coefficient is r/L_x. The distance d_x of the centre from it therefore grows
            // by r/L_x² per unit of L_x.
            sums[6] += along_x * r * lobe.step_x * lobe.step_x;
            sums[7] += along_y * s * lobe.step_y * lobe.step_y;
            sums[8] += r * value;
            sums[9] += s * value;
            sums[10] += value;
        }
    }
    for (int k = 0; k < LOBE_DERIVATIVES; ++k) out[k] = sums[k];
}

// Write the values of the Chebyshev polynomials at the κ = w/λ of a pair of a direction and a wavelength. The function
// `spread_lobes` uses these values.
template <class Table, class Pairs>
WARPDIFF_INLINE void write_polynomials(const Table& table, const Pairs& pairs, int pair)
{
    double* const out = numbers<double>(pairs.polynomials) + (long long)pair * table.terms;
    chebyshev_polynomials(numbers<const double>(pairs.places)[pair], table.terms, out);
}

// Add the contributions of all nearby pairs (a direction and a wavelength) to the adjoint of one Fourier coefficient.
// An adjoint is the derivative of a loss. The function is the transpose of `sum_lobe`.
//
// The frequencies of the block of Fourier coefficients are divided into cells, one per coefficient. Pairs are sorted by
// the cell that contains their centre q, and `begins` has the first pair of each cell. Cells at most `reach_y` rows and
// `reach_x` columns away are searched.
template <class Table, class Pairs, class Values>
WARPDIFF_INLINE void spread_lobes(const Table& table, const Pairs& pairs, int cell, Values& rows_out)
{
    const int row = cell / table.columns, column = cell - row * table.columns;
    const int* const begins = numbers<const int>(pairs.begins);
    const double* const adjoints = numbers<const double>(pairs.adjoints);
    double* const out = numbers<double>(rows_out) + (long long)cell * table.terms;
    const int first_row = wp::max(row - pairs.reach_y, 0), last_row = wp::min(row + pairs.reach_y, table.rows - 1);
    const int first = wp::max(column - pairs.reach_x, 0);
    const int last = wp::min(column + pairs.reach_x, table.columns - 1);
    double dx, dy;
    for (int other = first_row; other <= last_row; ++other) {
        const long long cells = (long long)other * table.columns;
        for (int pair = begins[cells + first]; pair < begins[cells + last + 1]; ++pair) {
            const double weight = Lobe(table, pairs, pair).weight(table, row, column, dx, dy) * adjoints[pair];
            if (weight == 0.0) continue;
            const double* const polynomials = numbers<const double>(pairs.polynomials) + (long long)pair * table.terms;
            for (int n = 0; n < table.terms; ++n) out[n] += weight * polynomials[n];
        }
    }
}

} // namespace warpdiff
