"""Which pixels take tiles of rays, and what these see where that follows from the pixels around."""

import warp as wp

from warpdiff import supersample
from warpdiff.kernels.footprints import PUT_FOOTPRINT
from warpdiff.kernels.native import abreast, filled
from warpdiff.kernels.scene import Footprint

# What a mean leaves out goes with the contrast and with how uneven (u, v) is: by how much its change from one pixel to
# the next differs from that to the one before, relative to the larger one. Of what it errs by where all is uneven, it
# errs by this share where nothing is, and by so much of what is uneven more.
SMOOTH, PER_UNEVEN = 0.4, 1.0
# Rays fan out where (u, v) is uneven by no more than this if the contrast is just at the bound from which uneven pixels
# take tiles, and in proportion less, the more it exceeds that.
EVENLY = 0.1

# Parts of rows, one after the other, with the rows above and below and what is beside their ends.
_CLASSIFY = """
    const float* const gain = (const float*)gains.data;
    const float* const bounds_of = (const float*)bounds.data;
    // Along rows and columns and between.
    auto unevenness2 = [&](long long pixel) {
        const double* const here = (const double*)deflections.data + 3 * pixel;
        float u[3][3], v[3][3];
        for (int line = 0; line < 3; ++line)
            for (int j = 0; j < 3; ++j) {
                const double* const there = here + 3 * ((line - 1LL) * width + j - 1);
                u[line][j] = (float)(there[0] - here[0]);
                v[line][j] = (float)(there[1] - here[1]);
            }
        auto square = [](float x, float y) { return x * x + y * y; };
        auto larger = [](float a, float b) { return a > b ? a : b; };
        const float along = larger(square(u[1][0], v[1][0]), square(u[1][2], v[1][2]));
        const float down = larger(square(u[0][1], v[0][1]), square(u[2][1], v[2][1]));
        const float tiny = 1.0e-30f, both = larger(along, down) + tiny;
        float result = larger(square(u[1][0] + u[1][2], v[1][0] + v[1][2]) / (along + tiny),
            square(u[0][1] + u[2][1], v[0][1] + v[2][1]) / (down + tiny));
        for (int line = 0; line < 3; line += 2)
            for (int j = 0; j < 3; j += 2)
                result = larger(result,
                    square(u[line][j] - u[line][1] - u[1][j], v[line][j] - v[line][1] - v[1][j]) / both);
        return result;
    };
    for (int from = begin, count; from < end; from += count) {
        const int column = from % width, row = from / width;
        count = wp::min(wp::min(end - from, ABREAST), width - column);
        unsigned char* const classes = (unsigned char*)classes_out.data + from;
        bool any = false;
        for (int i = 0; i < count; ++i) any |= gain[from + i] > 0.0f;
        if (!any) {
            memset(classes, 0, count);
            continue;
        }
        // Above, here and below, from one pixel further to the left to one further to the right.
        float colour[3][3][ABREAST + 2];
        bool lit[3][ABREAST + 2], there[3][ABREAST + 2];
        for (int line = 0; line < 3; ++line) {
            const bool inside = row + line > 0 && row + line <= height;
            for (int j = 0; j < count + 2; ++j) {
                const long long k = from + (line - 1LL) * width + j - 1;
                there[line][j] = inside && column + j > 0 && column + j <= width;
                lit[line][j] = there[line][j] && gain[k] > 0.0f;
                for (int c = 0; c < 3; ++c)
                    colour[c][line][j] = lit[line][j] ? ((const float*)colours.data)[3 * k + c] : 0.0f;
            }
        }
        const float least = *(const float*)floor.data;
        float largest[ABREAST], least_bound2[ABREAST];
        bool beside_dark[ABREAST];
        for (int i = 0; i < count; ++i) {
            largest[i] = 0.0f;
            beside_dark[i] = false;
        }
        auto compare = [&](int line, int shift) {
            for (int i = 0; i < count; ++i) {
                const int j = i + 1, at = j + shift;
                const float x = colour[0][line][at] - colour[0][1][j], y = colour[1][line][at] - colour[1][1][j];
                const float z = colour[2][line][at] - colour[2][1][j], apart = x * x + y * y + z * z;
                largest[i] = lit[line][at] && apart > largest[i] ? apart : largest[i];
                beside_dark[i] |= there[line][at] && !lit[line][at];
            }
        };
        compare(0, 0);
        compare(1, -1);
        compare(1, 1);
        compare(2, 0);
        for (int i = 0; i < count; ++i) {
            const float x = colour[0][1][i + 1], y = colour[1][1][i + 1], z = colour[2][1][i + 1];
            const float size2 = x * x + y * y + z * z, least2 = least * least;
            least_bound2[i] = bounds_of[0] * bounds_of[0] * (size2 > least2 ? size2 : least2);
            classes[i] = lit[1][i + 1] ? 1 : 0;
        }
        for (int i = 0; i < count; ++i) {
            if (classes[i] == 0 || !(largest[i] > least_bound2[i])) continue;
            float uneven2 = 1.0f;
            bool all_lit = true;
            for (int line = 0; line < 3; ++line)
                for (int j = i; j < i + 3; ++j) all_lit &= lit[line][j];
            if (all_lit) uneven2 = unevenness2(from + (long long)i);
            const float share = SMOOTH + PER_UNEVEN * wp::sqrt(uneven2);
            const float error2 = largest[i] * (share < 1.0f ? share * share : 1.0f);
            int exceeded = 0;
            for (int k = 0; k < (int)bounds.shape[0]; ++k) {
                const float relative = bounds_of[k] / bounds_of[0];
                exceeded += error2 > relative * relative * least_bound2[i];
            }
            if (exceeded == 0) continue;
            // A parabola has what is even.
            const bool even = all_lit && uneven2 * largest[i] <= EVENLY * EVENLY * least_bound2[i];
            classes[i] = 3 * exceeded + (beside_dark[i] ? 1 : 0) - (even ? 1 : 0);
        }
    }
"""


@wp.func_native(filled(abreast(32) + _CLASSIFY, EVENLY=f"{EVENLY}f", SMOOTH=f"{SMOOTH}f", PER_UNEVEN=f"{PER_UNEVEN}f"))
def classes_of(
    colours: wp.array(dtype=wp.vec3f),
    deflections: wp.array(dtype=wp.vec3d),
    gains: wp.array(dtype=wp.float32),
    width: wp.int32,
    height: wp.int32,
    floor: wp.array(dtype=wp.float32),
    bounds: wp.array(dtype=wp.float32),
    begin: wp.int32,
    end: wp.int32,
    classes_out: wp.array(dtype=wp.uint8),
):
    """Classes of pixels one after the other."""


# Most pixels are of no class from 2 on, eight of them at a time.
_LIST_STEEP = """
    const unsigned char* const of_pixels = (const unsigned char*)classes.data;
    const int kinds = (int)lists_out.shape[0];
    int* const counts = (int*)counts_out.data + (long long)part * (kinds + 1);
    for (int kind = 0; kind <= kinds; ++kind) counts[kind] = 0;
    for (int from = begin; from < end; from += 8) {
        unsigned long long eight = 0;
        memcpy(&eight, of_pixels + from, end - from < 8 ? end - from : 8);
        if ((eight & 0xfefefefefefefefeULL) == 0) {
            counts[kinds] += (int)((eight * 0x0101010101010101ULL) >> 56);
            continue;
        }
        for (int i = from; i < end && i < from + 8; ++i) {
            const int kind = of_pixels[i] - 2;
            counts[kinds] += kind >= -1;
            if (kind >= 0)
                ((int*)lists_out.data)[kind * (long long)lists_out.shape[1] + begin + counts[kind]++] = i;
        }
    }
"""


@wp.func_native(_LIST_STEEP)
def list_classes(
    classes: wp.array(dtype=wp.uint8),
    begin: wp.int32,
    end: wp.int32,
    part: wp.int32,
    lists_out: wp.array2d(dtype=wp.int32),
    counts_out: wp.array2d(dtype=wp.int32),
):
    """The pixels of each class from 2 on, one after the other."""


# Tile after tile, with rays side by side.
_FAN_OUT = """
    const double* const all = (const double*)deflections.data;
    const float* const all_lights = (const float*)to_lights.data;
    const float* const all_gains = (const float*)gains.data;
    const double* const places_of = (const double*)places.data;
    double* const deflection_at = (double*)deflections_out.data;
    float* const light_at = (float*)to_lights_out.data;
    float* const gain_at = (float*)gains_out.data;
    float* const footprint_at = (float*)footprints_out.data;
    int* const hit_at = (int*)hit_out.data;
    const int rays = (int)places.shape[0], quantities = with_lights ? 7 : 4;
    float x[MOST_RAYS] = {}, y[MOST_RAYS] = {}, xx[MOST_RAYS] = {}, xy[MOST_RAYS] = {}, yy[MOST_RAYS] = {};
    for (int ray = 0; ray < rays; ++ray) {
        x[ray] = (float)places_of[2 * ray];
        y[ray] = (float)places_of[2 * ray + 1];
        xx[ray] = 0.5f * x[ray] * x[ray];
        xy[ray] = x[ray] * y[ray];
        yy[ray] = 0.5f * y[ray] * y[ray];
    }
    for (int tile = begin; tile < end; ++tile) {
        const long long pixel = ((const int*)tiles.data)[tile], first = (long long)tile * rays;
        if (pixel < 0) {
            for (int ray = 0; ray < rays; ++ray) {
                hit_at[first + ray] = 0;
                gain_at[first + ray] = 0.0f;
            }
            continue;
        }
        // (u, v, w), the gain, and the direction to the light where that counts: by how much those around differ.
        float around[7][9], changes[7][MOST_RAYS], along[4][MOST_RAYS], down[4][MOST_RAYS], made[8][MOST_RAYS];
        float bend[2] = {};
        for (int k = 0; k < 9; ++k) {
            const long long there = pixel + (k / 3 - 1LL) * width + k % 3 - 1;
            for (int c = 0; c < 3; ++c) around[c][k] = (float)(all[3 * there + c] - all[3 * pixel + c]);
            around[3][k] = all_gains[there] - all_gains[pixel];
            if (with_lights)
                for (int c = 0; c < 3; ++c) around[4 + c][k] = all_lights[3 * there + c] - all_lights[3 * pixel + c];
        }
        for (int q = 0; q < quantities; ++q) {
            const float* const f = around[q];
            const float f_x = 0.5f * (f[5] - f[3]), f_y = 0.5f * (f[7] - f[1]), f_xx = f[5] + f[3], f_yy = f[7] + f[1];
            const float f_xy = 0.25f * (f[8] - f[6] - f[2] + f[0]);
            for (int ray = 0; ray < MOST_RAYS; ++ray)
                changes[q][ray] = f_x * x[ray] + f_y * y[ray] + f_xx * xx[ray] + f_xy * xy[ray] + f_yy * yy[ray];
            if (q >= 4) continue;
            for (int ray = 0; ray < MOST_RAYS; ++ray) {
                along[q][ray] = f_x + f_xx * x[ray] + f_xy * y[ray];
                down[q][ray] = f_y + f_xy * x[ray] + f_yy * y[ray];
            }
            if (q < 2) bend[q] = 0.5f * (f_xx + f_yy);
        }
        for (int ray = 0; ray < MOST_RAYS; ++ray) {
            const float here = all_gains[pixel], there = here + changes[3][ray];
            // The third of a deflection is −w.
            const float w = -(float)all[3 * pixel + 2] - changes[2][ray], per_w = w > 0.0f ? -2.0f / w : 0.0f;
            const float per_gain = 1.0f / (there > 0.0f ? there : here);
            const float right[4] = {along[0][ray], along[1][ray], -along[2][ray],
                per_gain * along[3][ray] + per_w * along[2][ray]};
            const float below[4] = {down[0][ray], down[1][ray], -down[2][ray],
                per_gain * down[3][ray] + per_w * down[2][ray]};
            put_footprint(right, below, bend[0], bend[1], [&](int c, float value) { made[c][ray] = value; });
        }
        for (int ray = 0; ray < rays; ++ray) {
            const long long k = first + ray;
            hit_at[k] = 1;
            for (int c = 0; c < 3; ++c) deflection_at[3 * k + c] = all[3 * pixel + c] + (double)changes[c][ray];
            const float gain = all_gains[pixel] + changes[3][ray];
            gain_at[k] = gain > 0.0f ? gain : 0.0f;
            for (int c = 0; c < 8; ++c) footprint_at[8 * k + c] = made[c][ray];
            if (with_lights)
                for (int c = 0; c < 3; ++c) light_at[3 * k + c] = all_lights[3 * pixel + c] + changes[4 + c][ray];
        }
    }
"""


@wp.func_native(PUT_FOOTPRINT + filled(_FAN_OUT, MOST_RAYS=supersample.LANES))
def fan_out_run(
    deflections: wp.array(dtype=wp.vec3d),
    to_lights: wp.array(dtype=wp.vec3f),
    gains: wp.array(dtype=wp.float32),
    tiles: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.vec2d),
    width: wp.int32,
    deviation: wp.float32,
    with_lights: wp.bool,
    begin: wp.int32,
    end: wp.int32,
    deflections_out: wp.array(dtype=wp.vec3d),
    to_lights_out: wp.array(dtype=wp.vec3f),
    gains_out: wp.array(dtype=wp.float32),
    footprints_out: wp.array(dtype=Footprint),
    hit_out: wp.array(dtype=wp.int32),
):
    """What rays of tiles see, by parabolas."""
