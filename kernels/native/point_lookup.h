// Colours of single directions from a colour table, by quadratic splines between rings and between azimuths. The table
// is a polar grid of (u, v): a ring is a circle of constant |(u, v)|, and an azimuth is a line of constant polar angle.

#pragma once

#include "colour_of_w.h"
#include "fast_math.h"
#include "quadratic_spline.h"
#include "simd.h"

namespace warpdiff {

// Positions of N points (u, v) in the colour table, and the rows that their colours require.
template <int N>
struct Points {
    Batch<N> u = {}, v = {}, w = {};
    Batch<N> turns, place; // polar angle [turns], and position as a fractional index of a ring
    AtW<N> at_w;
    // A look-up interpolates between table rows at three rings (circles) and three azimuths (polar angles). `first_row`
    // is the row of the first ring on the first azimuth. `aside` is the distance of the point from the middle azimuth
    // [spacings of azimuths].
    Batch<N, const float*> first_row;
    Batch<N> aside;
    Batch<N, int> first_ring, octave;
};

// Compute the positions of N points (u, v) in the colour table. Unused points of a batch are computed, too, because
// compilers vectorise a loop of fixed length.
template <int N, class Table>
WARPDIFF_INLINE void place_points(const Table& table, Points<N>& points)
{
    const int octaves = table.azimuths.shape[1];
    const float rings = (float)table.rings_per_octave, last = (float)(octaves * table.rings_per_octave - 2),
                least = table.least_uv;
    for (int i = 0; i < N; ++i) {
        const LogPolar at = log_polar(points.u[i], points.v[i], least);
        points.turns[i] = at.turns;
        points.place[i] = wp::min(at.log2 * rings + table.ring_of_one, last);
    }
    for (int i = 0; i < N; ++i) points.at_w.set(i, table, points.w[i]);
}

// Return the first table row of a ring (circle) that a look-up adds: the row on the first of the three azimuths (polar
// angles) around an angle. `aside` receives the distance of the angle from the middle azimuth [spacings of azimuths].
template <int WIDTH, class Table>
WARPDIFF_INLINE const float* row_at(const Table& table, float turns, int ring, int octave, float& aside)
{
    const float position = turns * (float)numbers<const int>(table.azimuths)[octave], nearest = wp::rint(position);
    aside = position - nearest;
    const long long row =
        numbers<const int>(table.first_rows)[octave] + ((int)nearest - 1 - octave) * table.rings_per_octave + ring;
    return numbers<const float>(table.rows) + row * WIDTH;
}

// Compute the addresses of the rows of the colour table for a point (u, v). On the CPU, begin to fetch these rows from
// memory if the point is illuminated.
template <int WIDTH, int N, class Table>
WARPDIFF_INLINE void locate_rows(const Table& table, Points<N>& points, int i, bool is_illuminated)
{
    points.first_ring[i] = (int)wp::rint(points.place[i]) - 1;
    points.octave[i] = (int)((float)points.first_ring[i] * table.octaves_per_ring);
    points.first_row[i] =
        row_at<WIDTH>(table, points.turns[i], points.first_ring[i], points.octave[i], points.aside[i]);
    if (ON_GPU || !is_illuminated) return;
    for (int j = 0; j < 3; ++j) {
        const float* const row = points.first_row[i] + j * (long long)table.rings_per_octave * WIDTH;
        for (int l = 0; l < 3 * WIDTH; l += 16) prefetch(row + l);
        prefetch(row + 3 * WIDTH - 1);
    }
}

// Return the weighted sum of the nine rows of the colour table around a point: at three rings (circles) on three
// azimuths (polar angles).
template <int WIDTH, int N, class Table>
WARPDIFF_INLINE Row<WIDTH> sum_of_rows(const Table& table, const Points<N>& points, int i)
{
    float ring_weights[3], azimuth_weights[3];
    quadratic_spline(points.place[i] - (float)(points.first_ring[i] + 1), ring_weights);
    quadratic_spline(points.aside[i], azimuth_weights);
    Row<WIDTH> sum;
    sum.clear();
    const long long stride = (long long)table.rings_per_octave * WIDTH;
    const int left = (points.octave[i] + 1) * table.rings_per_octave - points.first_ring[i];
    const float* first = points.first_row[i];
#pragma unroll
    for (int m = 0; m < 3; ++m) {
        if (m == left) {
            // The rings (circles) from index `left` on are in the next octave of the table (a doubling of the radius),
            // which has another number of azimuth samples.
            float aside;
            first = row_at<WIDTH>(table, points.turns[i], points.first_ring[i], points.octave[i] + 1, aside);
            quadratic_spline(aside, azimuth_weights);
        }
        const float* row = first + m * WIDTH;
#pragma unroll
        for (int j = 0; j < 3; ++j) {
            sum.add(ring_weights[m] * azimuth_weights[j], row);
            row += stride;
        }
    }
    return sum;
}

// Add the XYZ of the scattering vectors from `begin` to `end`, at most BATCH, multiplied by geometry factors (gains).
//
// While one direction is looked up, the table rows for the direction with an index larger by AHEAD are fetched from
// memory. With a larger AHEAD, rows would be evicted from the first-level cache before their use.
template <int W_BASIS_SIZE, int BATCH, int AHEAD, class Table, class ScatteringVectors, class Gains, class Colours>
WARPDIFF_INLINE void look_up_points(const Table& table, const ScatteringVectors& scattering_vectors, const Gains& gains,
    int begin, int end, Colours& xyz_out)
{
    constexpr int N = batch_of(BATCH), WIDTH = 3 * W_BASIS_SIZE;
    const int count = end - begin;
    const double* const uvw = numbers<const double>(scattering_vectors) + 3LL * begin;
    const float* const factors = numbers<const float>(gains) + begin;
    float* const xyz = numbers<float>(xyz_out) + 3LL * begin;
    Points<N> points;
    for (int i = 0; i < count; ++i) {
        points.u[i] = (float)uvw[3 * i];
        points.v[i] = (float)uvw[3 * i + 1];
        points.w[i] = (float)-uvw[3 * i + 2];
    }
    place_points(table, points);
    for (int i = 0; i < count && i < AHEAD; ++i) locate_rows<WIDTH>(table, points, i, factors[i] != 0.0f);
    for (int i = 0; i < count; ++i) {
        const int next = i + AHEAD;
        if (next < count) locate_rows<WIDTH>(table, points, next, factors[next] != 0.0f);
        if (factors[i] == 0.0f) continue;
        const Row<WIDTH> sum = sum_of_rows<WIDTH>(table, points, i);
        add_colour(table, sum, points.at_w, i, factors[i], xyz + 3 * i);
        add_zeroth_order(table, points.u[i], points.v[i], points.w[i], 0.0f, 0.0f, 0.0f, 0.0f, factors[i], xyz + 3 * i);
    }
}

} // namespace warpdiff
