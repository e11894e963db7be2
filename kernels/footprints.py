"""What a pixel's filter makes of (u, v): how they spread, to first order, and where their mean lies, to second.

Powers are means over a Gaussian of (u, v) whose changes along rows and columns are those of its deviation. What is
brighter within it counts for more: to first order a factor that changes moves the mean by what its logarithm has in
common with (u, v). The gain is one; and weak gratings send w² times a spectrum of (u, v) on. What others do differently
a look-up adds, from what w has in common with (u, v).
"""

import warp as wp

from warpdiff.kernels.native import abreast, filled
from warpdiff.kernels.scene import Footprint

# By how much of itself the gain times w² changes at most along a deviation, that the mean still moves in proportion.
_MOST_GAINED = 0.5

# A footprint, from changes from pixel to pixel along rows and columns, of (u, v, w) and of the gain times w², relative
# to it, and half the sum of second differences.
PUT_FOOTPRINT = filled(
    """
    const float variance = deviation * deviation, most_gained = MOST / deviation;
    auto gained = [&](float change) {
        return change < -most_gained ? -most_gained : change < most_gained ? change : most_gained;
    };
    auto put_footprint = [&](const float* along, const float* down, float bend_u, float bend_v, auto put) {
        const float more = gained(along[3]), more_down = gained(down[3]);
        put(0, deviation * along[0]);
        put(1, deviation * along[1]);
        put(2, deviation * down[0]);
        put(3, deviation * down[1]);
        put(4, variance * (more * along[0] + more_down * down[0] + bend_u));
        put(5, variance * (more * along[1] + more_down * down[1] + bend_v));
        put(6, variance * (along[2] * along[0] + down[2] * down[0]));
        put(7, variance * (along[2] * along[1] + down[2] * down[1]));
    };
""",
    MOST=f"{_MOST_GAINED}f",
)

# How (u, v, w) and the gain differ to the left, to the right, above and below, and then many pixels side by side.
_SPREAD = """
    const double* const all = (const double*)deflections.data;
    const float* const all_gains = (const float*)gains.data;
    const int* const is_hit = (const int*)hit.data;
    float* const out = (float*)footprints_out.data;
    const int offsets[4] = {-1, 1, -width, width};
    int column = begin % width, row = begin / width % height;
    for (int from = begin; from < end; from += ABREAST) {
        const int count = wp::min(end - from, ABREAST);
        int hits = 0;
        for (int i = 0; i < count; ++i) hits |= is_hit[from + i];
        if (hits == 0) {
            memset(out + 8LL * from, 0, 8 * count * sizeof(float));
            row = (row + (column + count) / width) % height;
            column = (column + count) % width;
            continue;
        }
        float there[4][ABREAST] = {}, u[4][ABREAST] = {}, v[4][ABREAST] = {}, w[4][ABREAST] = {};
        float gain[4][ABREAST] = {}, w_here[ABREAST] = {}, gain_here[ABREAST] = {}, made[8][ABREAST];
        for (int i = 0; i < count; ++i) {
            const long long k = from + i;
            const bool inside[4] = {column > 0, column < width - 1, row > 0, row < height - 1};
            for (int n = 0; n < 4; ++n) {
                const bool counts = is_hit[k] != 0 && inside[n] && is_hit[k + offsets[n]] != 0;
                const long long other = counts ? k + offsets[n] : k;
                there[n][i] = counts ? 1.0f : 0.0f;
                u[n][i] = (float)(all[3 * other] - all[3 * k]);
                v[n][i] = (float)(all[3 * other + 1] - all[3 * k + 1]);
                w[n][i] = (float)(all[3 * k + 2] - all[3 * other + 2]);
                gain[n][i] = all_gains[other];
            }
            w_here[i] = (float)-all[3 * k + 2];
            gain_here[i] = all_gains[k];
            if (++column < width) continue;
            column = 0;
            row = row + 1 < height ? row + 1 : 0;
        }
        for (int i = 0; i < ABREAST; ++i) {
            float changes[2][4], bend_u = 0.0f, bend_v = 0.0f;
            const float per_w = w_here[i] > 0.0f ? 2.0f / w_here[i] : 0.0f;
            for (int axis = 0; axis < 2; ++axis) {
                const int n = 2 * axis;
                // From the one before and to the one after; where the two disagree, an edge of the body or of a
                // texture's chart lies between: the smaller change is the surface.
                const float u0 = -u[n][i], v0 = -v[n][i], u1 = u[n + 1][i], v1 = v[n + 1][i];
                const float size0 = u0 * u0 + v0 * v0, size1 = u1 * u1 + v1 * v1;
                const float bent_u = u1 - u0, bent_v = v1 - v0, bent = bent_u * bent_u + bent_v * bent_v;
                const float both = there[n][i] * there[n + 1][i];
                const float agree = bent < (size0 < size1 ? size0 : size1) ? both : 0.0f;
                const float smaller = size0 < size1 ? 1.0f : 0.0f;
                const float share0 = both > 0.0f ? (agree > 0.0f ? 0.5f : smaller) : there[n][i];
                const float share1 = both > 0.0f ? 1.0f - share0 : there[n + 1][i];
                // None from or to what is not lit.
                auto change = [&](float other, float of_w) {
                    const float sum = other + gain_here[i], least = other < gain_here[i] ? other : gain_here[i];
                    return least > 0.0f ? 2.0f * (other - gain_here[i]) / sum + per_w * of_w : 0.0f;
                };
                changes[axis][0] = share0 * u0 + share1 * u1;
                changes[axis][1] = share0 * v0 + share1 * v1;
                changes[axis][2] = share1 * w[n + 1][i] - share0 * w[n][i];
                changes[axis][3] = share1 * change(gain[n + 1][i], w[n + 1][i]) - share0 * change(gain[n][i], w[n][i]);
                bend_u += 0.5f * agree * bent_u;
                bend_v += 0.5f * agree * bent_v;
            }
            auto put = [&](int c, float value) { made[c][i] = value; };
            put_footprint(changes[0], changes[1], bend_u, bend_v, put);
        }
        for (int i = 0; i < count; ++i)
            for (int c = 0; c < 8; ++c) out[8LL * (from + i) + c] = made[c][i];
    }
"""


@wp.func_native(abreast(32) + PUT_FOOTPRINT + _SPREAD)
def spread(
    deflections: wp.array(dtype=wp.vec3d),
    gains: wp.array(dtype=wp.float32),
    hit: wp.array(dtype=wp.int32),
    width: wp.int32,
    height: wp.int32,
    deviation: wp.float32,
    begin: wp.int32,
    end: wp.int32,
    footprints_out: wp.array(dtype=Footprint),
):
    """Footprints of pixels one after the other, in pictures of this size one after the other."""
