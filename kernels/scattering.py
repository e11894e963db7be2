"""From what rays see and a light to what the spectral kernels take: (u, v, w), gain and footprint."""

import warp as wp

from warpdiff.kernels import compile_options, limits
from warpdiff.kernels.footprints import pixel_footprints_run
from warpdiff.kernels.snippets import filled, simd_batch
from warpdiff.kernels.structs import Camera, Footprint, Pixels, SurfaceArrays

wp.set_module_options(compile_options.options())

# Of a kernel of arrays with one index, Warp compiles a second variant for the CPU, for arrays that lie densely, hardly
# faster. A second index, which is always 0, spares it: a third of these modules' time to compile.


@wp.struct
class Lights:
    """Lights, and what of them the pigment sends back: in arrays, so that a recorded picture finds the next ones."""

    to_lights: wp.array(dtype=wp.vec3d)
    strengths: wp.array(dtype=wp.vec2d)  # power, and the pigment's strength over R(0); 0 leaves the pigment out
    white_rgb: wp.array(dtype=wp.vec3d)  # ∫ G S x̄ȳz̄ dλ / ∫ S ȳ dλ in linear sRGB
    rgb_to_xyz: wp.mat33d


@wp.struct
class Reflection:
    """Parameters of the reflectance besides the directions."""

    normal_reflectance: wp.float64
    masking: wp.bool
    per_light_cosine: wp.bool  # for a light of a size


# Pixels side by side, step after step, so that the compiler makes vectors of each; a GPU takes one at a time.
_DEFLECT = """
    const int* const hit = (const int*)pixels.hit.data;
    const float* const frames[3] = {(const float*)pixels.tangent.data, (const float*)pixels.bitangent.data,
        (const float*)pixels.normal.data};
    const float* const aways = (const float*)pixels.to_view.data;
    const bool* const is_hidden = hidden.shape[0] > 0 ? (const bool*)hidden.data : nullptr;
    double* const deflections = (double*)deflections_out.data;
    float* const to_lights = (float*)to_lights_out.data;
    float* const gains = (float*)gains_out.data;
    const double beyond_normal = 1.0 / reflection.normal_reflectance - 1.0;
    const bool masking = reflection.masking, per_cosine = reflection.per_light_cosine;
    const bool sums = coverage_out.shape[0] > 0;
    float* const xyz = (float*)xyz_out.data;
    double* const coverage = (double*)coverage_out.data;
    bool* const lit = (bool*)lit_out.data;
    for (int from = begin; from < end; from += ABREAST) {
        const int count = wp::min(end - from, ABREAST);
        int hits = 0;
        for (int i = 0; i < count; ++i) hits |= hit[from + i];
        if (sums && resets) memset(xyz + 3LL * from, 0, 3 * count * sizeof(float));
        if (sums && begins) {
            memset(coverage + from, 0, count * sizeof(double));
            memset(lit + from, 0, count * sizeof(bool));
        }
        if (hits == 0) {
            memset(deflections + 3LL * from, 0, 3 * count * sizeof(double));
            memset(to_lights + 3LL * from, 0, 3 * count * sizeof(float));
            memset(gains + from, 0, count * sizeof(float));
            continue;
        }
        // Of pixels that meet nothing, and behind the last one, whatever is there.
        float frame[3][3][ABREAST], away[3][ABREAST];
        for (int i = 0; i < ABREAST; ++i) {
            const long long at = 3LL * (from + (i < count ? i : 0));
            for (int c = 0; c < 3; ++c) {
                for (int axis = 0; axis < 3; ++axis) frame[axis][c][i] = frames[axis][at + c];
                away[c][i] = aways[at + c];
            }
        }
        double light_x[ABREAST], light_y[ABREAST], light_z[ABREAST], u[ABREAST], v[ABREAST], w[ABREAST];
        float gain[ABREAST];
        for (int i = 0; i < ABREAST; ++i) {
            // The frame comes from float32: unit lengths are restored, so that the mirror direction is met exactly.
            const double away_x = away[0][i], away_y = away[1][i], away_z = away[2][i];
            double to_light[3], to_view[3];
            for (int axis = 0; axis < 3; ++axis) {
                const double x = frame[axis][0][i], y = frame[axis][1][i], z = frame[axis][2][i];
                to_light[axis] = towards[0] * x + towards[1] * y + towards[2] * z;
                to_view[axis] = away_x * x + away_y * y + away_z * z;
            }
            const double per_light = 1.0 / wp::sqrt(to_light[0] * to_light[0] + to_light[1] * to_light[1]
                + to_light[2] * to_light[2]);
            const double per_view = 1.0 / wp::sqrt(to_view[0] * to_view[0] + to_view[1] * to_view[1]
                + to_view[2] * to_view[2]);
            light_x[i] = to_light[0] * per_light;
            light_y[i] = to_light[1] * per_light;
            light_z[i] = to_light[2] * per_light;
            u[i] = light_x[i] + to_view[0] * per_view;
            v[i] = light_y[i] + to_view[1] * per_view;
            w[i] = light_z[i] + to_view[2] * per_view;
            // C·M, the factor between ⟨|P|²⟩ and ρ (Single 2014, eq. 3.15), with Schlick's reflectance and 1 + ωi·ωr
            // without cancellation.
            const double cos_i = light_z[i], cos_r = to_view[2] * per_view, total = w[i];
            const double overlap = 0.5 * (u[i] * u[i] + v[i] * v[i] + total * total);
            const double cos_d = wp::sqrt(0.5 * overlap), m = 1.0 - (cos_d < 1.0 ? cos_d : 1.0);
            const double least = cos_i < cos_r ? cos_i : cos_r;
            const double mask = masking ? least * total * wp::sqrt(2.0 / overlap) / cos_d : 1.0;
            const double schlick = 1.0 + beyond_normal * m * m * m * m * m;
            const double result = schlick * overlap * overlap * (mask < 1.0 ? mask : 1.0)
                / (total * total * cos_r * (per_cosine ? cos_i : 1.0));
            gain[i] = least > HORIZON ? (float)(scale * result) : 0.0f;
        }
        for (int i = 0; i < count; ++i) {
            const long long k = from + i, at = 3 * k;
            const bool is_hit = hit[k] != 0;
            const bool is_lit = is_hit && gain[i] > 0.0f && !(is_hidden && is_hidden[k]);
            // Whether it is lit or not: those beside it ask how (u, v) changes.
            deflections[at] = is_hit ? -u[i] : 0.0;
            deflections[at + 1] = is_hit ? -v[i] : 0.0;
            deflections[at + 2] = is_hit ? -w[i] : 0.0;
            to_lights[at] = is_lit ? (float)light_x[i] : 0.0f;
            to_lights[at + 1] = is_lit ? (float)light_y[i] : 0.0f;
            to_lights[at + 2] = is_lit ? (float)light_z[i] : 0.0f;
            gains[k] = is_lit ? gain[i] : 0.0f;
        }
        if (!sums) continue;
        for (int i = 0; i < count; ++i) {
            coverage[from + i] += hit[from + i] != 0 ? counted : 0.0;
            lit[from + i] |= gains[from + i] > 0.0f;
        }
    }
"""


@wp.func_native(filled(simd_batch(32) + _DEFLECT, HORIZON=limits.HORIZON))
def scattering_vectors_run(
    pixels: Pixels,
    towards: wp.vec3d,
    reflection: Reflection,
    scale: wp.float64,
    counted: wp.float64,
    begins: wp.bool,
    resets: wp.bool,
    hidden: wp.array(dtype=wp.bool),
    begin: wp.int32,
    end: wp.int32,
    deflections_out: wp.array(dtype=wp.vec3d),
    to_lights_out: wp.array(dtype=wp.vec3f),
    gains_out: wp.array(dtype=wp.float32),
    xyz_out: wp.array(dtype=wp.vec3f),
    coverage_out: wp.array(dtype=wp.float64),
    lit_out: wp.array(dtype=wp.bool),
):
    """Deflections, directions to the light and gains of pixels one after the other, and what of them is summed up."""


@wp.func
def schlick(cosine: wp.float64, normal: wp.float64) -> wp.float64:
    """Schlick's power reflectance; ``normal`` is R(0)."""
    one = wp.float64(1.0)
    m = one - wp.min(cosine, one)
    return normal + (one - normal) * m * m * m * m * m


@wp.kernel
def scattering_vectors(
    # In:
    pixels: Pixels,
    lights: Lights,
    which: wp.int32,
    reflection: Reflection,
    weight: wp.float64,
    counted: wp.float64,
    begins: wp.bool,
    resets: wp.bool,
    hidden: wp.array(dtype=wp.bool),
    first: wp.int32,
    run: wp.int32,
    # Out:
    deflections_out: wp.array(dtype=wp.vec3d),
    to_lights_out: wp.array(dtype=wp.vec3f),
    gains_out: wp.array(dtype=wp.float32),
    xyz_out: wp.array(dtype=wp.vec3f),
    coverage_out: wp.array(dtype=wp.float64),
    lit_out: wp.array(dtype=wp.bool),
):
    """Deflection, direction to the light and gain of pixels under one of the lights.

    All that meet the mesh have a deflection, and where the light does not come their gain is 0. Its pigment is added to
    ``xyz_out``, ``counted`` to the coverage of those that meet the mesh, and those that it reaches are marked as lit,
    from nothing if the sum ``begins``, or that of ``xyz_out`` ``resets``; empty arrays are none of these. ``hidden``
    says which pixels the light does not reach; empty is none.
    """
    to_light = lights.to_lights[which]
    strength = lights.strengths[which]
    scale = weight * strength[0]
    thread, _ = wp.tid()
    begin = first + thread * run
    scattering_vectors_run(
        pixels, to_light, reflection, scale, counted, begins, resets, hidden, begin, begin + run,
        deflections_out, to_lights_out, gains_out, xyz_out, coverage_out, lit_out,
    )  # fmt: skip
    if strength[1] == wp.float64(0.0) or xyz_out.shape[0] == 0:
        return
    for i in range(begin, begin + run):
        if gains_out[i] > 0.0:
            cos_i = wp.float64(to_lights_out[i][2])
            normal = reflection.normal_reflectance
            one = wp.float64(1.0)
            cos_r = -deflections_out[i][2] - cos_i
            under = (one - schlick(cos_i, normal)) * (one - schlick(cos_r, normal)) * cos_i
            base = wp.vec3d(pixels.base_colour[i])
            colour = lights.rgb_to_xyz * wp.cw_mul(base, lights.white_rgb[which])
            xyz_out[i] = xyz_out[i] + wp.vec3f(scale * strength[1] * under * colour)


@wp.kernel
def reduce_directions(
    # In:
    deflections: wp.array(dtype=wp.vec3d),
    to_lights: wp.array(dtype=wp.vec3f),
    gains: wp.array(dtype=wp.float32),
    per_uv: wp.vec2d,
    is_source: wp.bool,
    size: wp.int32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    counts_out: wp.array(dtype=wp.int32),
    ranges_out: wp.array(dtype=wp.vec4d),
):
    """How many of each ``size`` deflections are lit; their largest |(u, v)|² and lateral², least and largest |w|.

    Lateral is as ``warpdiff.plans.direction_range.lateral`` has it, ``per_uv`` the lengths that multiply u and v.
    """
    thread, _ = wp.tid()
    for block in range(first + thread * run, first + (thread + 1) * run):
        count = wp.int32(0)
        uv = wp.float64(0.0)
        rate = wp.float64(0.0)
        least = wp.float64(2.0)
        most = wp.float64(0.0)
        for i in range(block * size, wp.min((block + 1) * size, gains.shape[0])):
            if gains[i] > 0.0:
                count += 1
                d = deflections[i]
                square = d[0] * d[0] + d[1] * d[1]
                uv = wp.max(uv, square)
                least = wp.min(least, -d[2])
                most = wp.max(most, -d[2])
                if is_source:
                    light = wp.vec3d(to_lights[i])
                    along = (d[0] * light[0] + d[1] * light[1]) / wp.max(light[2], wp.float64(1.0e-6))
                    square += along * along
                else:
                    square = d[0] * d[0] * per_uv[0] * per_uv[0] + d[1] * d[1] * per_uv[1] * per_uv[1]
                rate = wp.max(rate, square)
        counts_out[block] = count
        ranges_out[block] = wp.vec4d(uv, rate, least, most)


@wp.kernel
def sample_directions(
    # In:
    deflections: wp.array(dtype=wp.vec3d),
    to_lights: wp.array(dtype=wp.vec3f),
    gains: wp.array(dtype=wp.float32),
    blocks: wp.array(dtype=wp.int32),
    ranks: wp.array(dtype=wp.int32),
    size: wp.int32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    deflections_out: wp.array(dtype=wp.vec3d),
    to_lights_out: wp.array(dtype=wp.vec3f),
    gains_out: wp.array(dtype=wp.float32),
):
    """The lit deflections of some ranks, from 0 on, within blocks of ``size``."""
    thread, _ = wp.tid()
    for k in range(first + thread * run, first + (thread + 1) * run):
        left = ranks[k]
        i = blocks[k] * size - 1
        while left >= 0:
            i += 1
            if gains[i] > 0.0:
                left -= 1
        deflections_out[k] = deflections[i]
        to_lights_out[k] = to_lights[i]
        gains_out[k] = gains[i]


@wp.kernel
def pixel_footprints(
    # In:
    camera: Camera,
    surface: SurfaceArrays,
    pixels: Pixels,
    deflections: wp.array(dtype=wp.vec3d),
    deviation: wp.float32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    footprints_out: wp.array(dtype=Footprint),
):
    """Footprints in (u, v) of rays' filters of a deviation in pixels."""
    thread, _ = wp.tid()
    begin = first + thread * run
    pixel_footprints_run(camera, surface, pixels, deflections, deviation, begin, begin + run, footprints_out)
