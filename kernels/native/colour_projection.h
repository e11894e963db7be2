// Computation of the colours in a table from the power spectrum. An azimuth is a line of constant polar angle in the
// plane of frequencies (u, v)/λ, and a ring is a circle in this plane. As λ changes, (u, v)/λ moves from ring to ring.
// The integral over λ is therefore a weighted sum over rings. The spectrum is stored as one row per ring and azimuth; a
// row has the weights of basis functions (terms). A few azimuths are processed together.
//
// (u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
// light and to the viewer.

#pragma once

#include "quadratic_spline.h"
#include "simd.h"

namespace warpdiff {

// Buffer for the rows of the spectrum along one azimuth (polar angle), from which colours are computed. It has `length`
// rows, one per ring (circle of constant frequency).
template <int TERMS>
struct AzimuthRows {
    typedef typename Row<TERMS>::Vector Vector;
    static constexpr int VECTORS = Row<TERMS>::VECTORS;

    Vector* rows;
    int length;

    template <class Rows>
    WARPDIFF_INLINE AzimuthRows(const Rows& all, int at, int length_of)
        : rows(numbers<Vector>(all) + (long long)at * VECTORS),
          length(length_of)
    {
    }
};

// Interpolate the power spectrum along one azimuth (polar angle), which lies halfway between two azimuths of the table.
// Each ring (circle) is interpolated separately, by the Lagrange polynomial through its values at the four nearest
// azimuths on each side.
template <int TERMS, class Rows>
WARPDIFF_INLINE void interpolate_halfway(
    const Rows& values, long long first, int before, int azimuths, int rings, typename AzimuthRows<TERMS>::Vector* out)
{
    constexpr float HALFWAY[4] = {1225.0f / 2048.0f, -245.0f / 2048.0f, 49.0f / 2048.0f, -5.0f / 2048.0f};
    typedef typename AzimuthRows<TERMS>::Vector Vector;
    const int size = rings * AzimuthRows<TERMS>::VECTORS;
    const Vector* rows[8];
    for (int k = 0; k < 8; ++k) {
        const long long azimuth = (before + k - 3 + azimuths) % azimuths;
        rows[k] = numbers<const Vector>(values) + (first + azimuth * rings) * AzimuthRows<TERMS>::VECTORS;
    }
    for (int l = 0; l < size; ++l) {
        Vector sum = Vector{};
        for (int k = 0; k < 4; ++k) sum += HALFWAY[k] * (rows[3 - k][l] + rows[4 + k][l]);
        out[l] = sum;
    }
}

// Collect the rows of the spectrum from which colours along AZIMUTHS azimuths (polar angles) are computed, `length`
// rows per azimuth. A row belongs to one ring (circle of constant frequency). The first row is zero and stands for the
// ring inside the first octave (factor of 2) of the frequency. The rows of this octave follow, then the rows of the
// next octave, and if necessary the rows of a third octave. An octave may have half as many azimuths as the next
// octave. Rows between the azimuths of the first octave are then interpolated.
template <int TERMS, int AZIMUTHS, class Values, class Integers>
WARPDIFF_INLINE void join_octaves(const Values& values, const Integers& starts, const Integers& azimuths_of, int rings,
    int octave, int first_azimuth, Values& sequence, int at, int length)
{
    typedef typename AzimuthRows<TERMS>::Vector Vector;
    constexpr int ROW = AzimuthRows<TERMS>::VECTORS;
    const int* const begins = numbers<const int>(starts);
    const int* const counts = numbers<const int>(azimuths_of);
    const int coarse = counts[octave], count = counts[octave + 1], size = rings * ROW;
    const int more = octave + 2 < azimuths_of.shape[0] ? counts[octave + 2] / count : 0;
    // With few rings (circles) per octave of the frequency, two octaves have fewer rows of the spectrum than the filter
    // for spline coefficients requires. The remaining rows are taken from a third octave.
    const int left = (length - 1 - rings) * ROW, next = wp::min(left, size);
    const int further = more > 0 ? wp::min(left - next, size) : 0;
    auto rows_of_azimuth = [&](int of, int azimuth) {
        return numbers<const Vector>(values) + (begins[of] + (long long)azimuth * rings) * ROW;
    };
    Vector* out = AzimuthRows<TERMS>(sequence, at, length).rows;
    for (int azimuth = first_azimuth; azimuth < first_azimuth + AZIMUTHS; ++azimuth, out += (long long)length * ROW) {
        for (int l = 0; l < ROW; ++l) out[l] = Vector{};
        Vector* const own = out + ROW;
        if (coarse != count && azimuth % 2 != 0)
            interpolate_halfway<TERMS>(values, begins[octave], azimuth / 2, coarse, rings, own);
        else
            memcpy(own, rows_of_azimuth(octave, coarse == count ? azimuth : azimuth / 2), size * sizeof(Vector));
        memcpy(own + size, rows_of_azimuth(octave + 1, azimuth), next * sizeof(Vector));
        if (further > 0)
            memcpy(own + size + next, rows_of_azimuth(octave + 2, azimuth * more), further * sizeof(Vector));
        for (int l = next + further; l < left; ++l) own[size + l] = Vector{};
    }
}

// Replace samples of the power spectrum along one azimuth (polar angle) by the coefficients of the quadratic spline
// that passes through them. A recursive filter, which runs forwards and then backwards, computes the coefficients.
template <int TERMS>
WARPDIFF_INLINE void filter_to_spline(typename AzimuthRows<TERMS>::Vector* rows, int length)
{
    constexpr float POLE = SPLINE_POLE, GAIN = 1.41421356f * (1.0f - POLE * POLE);
    constexpr int ROW = AzimuthRows<TERMS>::VECTORS;
    typedef typename AzimuthRows<TERMS>::Vector Vector;
    for (int l = 0; l < ROW; ++l) {
        Vector last = Vector{};
        for (int j = 0; j < length; ++j) rows[j * ROW + l] = last = rows[j * ROW + l] + POLE * last;
        last *= POLE / (1.0f - POLE * POLE);
        for (int j = length - 1; j >= 0; --j) {
            last = rows[j * ROW + l] + POLE * last;
            rows[j * ROW + l] = GAIN * last;
        }
    }
}

// Division of a row into SIMD vectors. The row has W_BASIS_SIZE coefficients, one for each basis function of w (the
// normal component of the scattering vector). The last vector may overlap the vector before it.
template <int W_BASIS_SIZE>
struct FunctionVectors {
    static constexpr int LANES = ON_GPU ? 1 : W_BASIS_SIZE > 4 ? 8 : 4;
    static constexpr int COUNT = (W_BASIS_SIZE + LANES - 1) / LANES;
    typedef typename FloatVector<LANES>::type Vector;

    static constexpr int first(int p)
    {
        return p * LANES < W_BASIS_SIZE - LANES ? p * LANES : W_BASIS_SIZE - LANES;
    }
};

// Compute the colours at one ring (circle) on AZIMUTHS azimuths (polar angles): weighted sums over `taps` rows of the
// spectrum. A matrix converts the terms of a row to coefficients of the basis functions of w, the normal component of
// the scattering vector; each row has its own matrix, the same for all azimuths. The weights of the rows for X, Y and Z
// are in `colour`. The rows of neighbouring azimuths are `apart` floats from each other in memory.
template <int TERMS, int W_BASIS_SIZE, int AZIMUTHS>
WARPDIFF_INLINE void project_ring(const float* row, long long apart, const float* factor, const float* colour, int taps,
    int terms, float* out, long long out_apart)
{
    typedef FunctionVectors<W_BASIS_SIZE> Functions;
    typedef typename Functions::Vector Vector;
    Vector sum[AZIMUTHS][3][Functions::COUNT];
    for (int b = 0; b < AZIMUTHS; ++b)
        for (int c = 0; c < 3; ++c)
            for (int p = 0; p < Functions::COUNT; ++p) sum[b][c][p] = Vector{};
    for (int i = 0; i < taps; ++i) {
        Vector at_w[AZIMUTHS][Functions::COUNT];
        for (int b = 0; b < AZIMUTHS; ++b)
            for (int p = 0; p < Functions::COUNT; ++p) at_w[b][p] = Vector{};
        for (int l = 0; l < terms; ++l) {
#pragma unroll
            for (int b = 0; b < AZIMUTHS; ++b) {
#pragma unroll
                for (int p = 0; p < Functions::COUNT; ++p)
                    at_w[b][p] += row[b * apart + l] * *(const Vector*)(factor + Functions::first(p));
            }
            factor += W_BASIS_SIZE;
        }
#pragma unroll
        for (int b = 0; b < AZIMUTHS; ++b) {
#pragma unroll
            for (int c = 0; c < 3; ++c)
                for (int p = 0; p < Functions::COUNT; ++p) sum[b][c][p] += colour[c] * at_w[b][p];
        }
        row += TERMS;
        colour += 3;
    }
    for (int b = 0; b < AZIMUTHS; ++b)
        for (int c = 0; c < 3; ++c)
            for (int p = 0; p < Functions::COUNT; ++p)
                *(Vector*)(out + b * out_apart + c * W_BASIS_SIZE + Functions::first(p)) = sum[b][c][p];
}

// Compute colours along AZIMUTHS azimuths (polar angles) from `length` rows of the spectrum per azimuth, one per ring
// (circle). The first `skipped` rows belong to rings before the ring of the first colour.
template <int TERMS, int W_BASIS_SIZE, int AZIMUTHS, class Rows, class Matrices, class Weights, class Colours>
WARPDIFF_INLINE void project_azimuths(Rows& sequence, int at, int length, int skipped, const Matrices& matrices,
    const Weights& weights, int terms, int rings, int first_azimuth, Colours& rows_out)
{
    const AzimuthRows<TERMS> first(sequence, at, length);
    for (int b = 0; b < AZIMUTHS; ++b)
        filter_to_spline<TERMS>(first.rows + (long long)b * length * AzimuthRows<TERMS>::VECTORS, length);
    float* const out = numbers<float>(rows_out) + 3LL * first_azimuth * rings * W_BASIS_SIZE;
    for (int k = 0; k < rings; ++k)
        project_ring<TERMS, W_BASIS_SIZE, AZIMUTHS>((const float*)first.rows + (long long)(skipped + k) * TERMS,
            (long long)length * TERMS, numbers<const float>(matrices), numbers<const float>(weights), weights.shape[0],
            terms, out + 3LL * k * W_BASIS_SIZE, 3LL * rings * W_BASIS_SIZE);
}

} // namespace warpdiff
