"""From pixels to points on a mesh: where their rays lie, what they meet, shading frames and base colours."""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.rasterize import rasterize_run
from warpdiff.kernels.shading_frames import LEAST_TANGENT, face_the_viewer, perpendicular, shading_frames_run
from warpdiff.kernels.snippets import filled, simd_batch
from warpdiff.kernels.structs import SPECIAL, Camera, Cells, Pixels, Sampling, SurfaceArrays

wp.set_module_options(compile_options.options())

# How far from a pixel's centre its samples lie, at most.
MOST_OFFSET = 1.5
# Of a ray that meets no face.
UNSEEN = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))

# Multipliers of the hash ("lowbias32", Wellons 2018), the golden ratio, and the two of the R2 sequence (Roberts 2018),
# the last three as shares of 2^32.
HASH_1 = wp.constant(wp.uint32(0x7FEB352D))
HASH_2 = wp.constant(wp.uint32(0x846CA68B))
GOLDEN = wp.constant(wp.uint32(0x9E3779B9))
R2_X = wp.constant(wp.uint32(3242174889))
R2_Y = wp.constant(wp.uint32(2447445414))


@wp.func
def scramble(value: wp.uint32) -> wp.uint32:
    """A hash of 32 bits to 32 bits."""
    x = value
    x = x ^ (x >> wp.uint32(16))
    x = x * HASH_1
    x = x ^ (x >> wp.uint32(15))
    x = x * HASH_2
    return x ^ (x >> wp.uint32(16))


@wp.func
def to_unit(bits: wp.uint32) -> wp.float64:
    """32 bits as a number strictly between 0 and 1."""
    return (wp.float64(bits) + wp.float64(0.5)) / wp.float64(4294967296.0)


@wp.func
def pixel_offset(sample: wp.int32, samples: wp.int32, seed: wp.int32, pixel: wp.int32) -> wp.vec2d:
    """Where in the pixel a sample lies, (right, down) of its centre [pixels].

    The offsets are distributed as the reconstruction filter, a Gaussian of 0.5 pixel cut at 1.5, so that samples
    count alike. They follow the R2 sequence, rotated for each pixel by its hash (Cranley-Patterson);
    in 32-bit integers the sequence is exact at any index.
    """
    result = wp.vec2d()
    if samples > 1:
        index = wp.uint32(sample)
        rotation_x = scramble(wp.uint32(pixel) ^ scramble(wp.uint32(seed)))
        rotation_y = scramble(rotation_x + GOLDEN)
        radial = to_unit(index * R2_X + rotation_x)
        angular = to_unit(index * R2_Y + rotation_y)
        # 1 − exp(−1.5² / (2 · 0.5²)) of the Gaussian lies within the cut.
        inside = wp.float64(1.0) - wp.exp(wp.float64(-4.5))
        radius = wp.float64(0.5) * wp.sqrt(-wp.float64(2.0) * wp.log(wp.float64(1.0) - radial * inside))
        angle = wp.float64(2.0) * wp.float64(wp.pi) * angular
        result = wp.vec2d(radius * wp.cos(angle), radius * wp.sin(angle))
    return result


@wp.func
def wrap(index: wp.int32, size: wp.int32) -> wp.int32:
    """``index`` modulo ``size``, for an index that is out by less than one period."""
    result = index
    if result < 0:
        result = result + size
    if result >= size:
        result = result - size
    return result


@wp.func
def sample_texture(texture: wp.array2d(dtype=wp.vec3f), uv: wp.vec2f) -> wp.vec3f:
    """Bilinear texture look-up; the texture repeats, its row 0 is the one at v = 1, texel centres lie at +0.5."""
    height = texture.shape[0]
    width = texture.shape[1]
    x = (uv[0] - wp.floor(uv[0])) * wp.float32(width) - 0.5
    y = (wp.float32(1.0) - (uv[1] - wp.floor(uv[1]))) * wp.float32(height) - 0.5
    fx = x - wp.floor(x)
    fy = y - wp.floor(y)
    x0 = wrap(wp.int32(wp.floor(x)), width)
    y0 = wrap(wp.int32(wp.floor(y)), height)
    x1 = wrap(x0 + 1, width)
    y1 = wrap(y0 + 1, height)
    top = (1.0 - fx) * texture[y0, x0] + fx * texture[y0, x1]
    bottom = (1.0 - fx) * texture[y1, x0] + fx * texture[y1, x1]
    return (1.0 - fy) * top + fy * bottom


@wp.kernel
def rasterize(
    # In:
    camera: Camera,
    surface: SurfaceArrays,
    sampling: Sampling,
    cells: Cells,
    reach: wp.float64,
    first: wp.int32,
    run: wp.int32,
    # Out:
    nearest_out: wp.array(dtype=wp.uint64),
    rows_out: wp.array(dtype=wp.int32),
):
    """Which face each pixel's ray sees, or each cell's: on the CPU alone.

    A picture's worth of rays visits every face's box in the hierarchy thousands of times; a face knows its pixels.

    Args:
        camera: The view.
        surface: The mesh.
        sampling: Where in the pixel a ray lies.
        cells: Pixels that are split; empty stands for one ray of each pixel.
        reach: How far from pixels' centres rays lie, at most, along an axis [pixels].
        first: The first thread's face.
        run: How many a thread takes.
        nearest_out: The distance along the view, as the bits of a float32, and the face below them; the smallest is
            kept. All bits set is none.
        rows_out: The least and the largest row that a face may be seen in, from those that are there on; or empty.
    """
    begin = first + wp.tid() * run
    rasterize_run(camera, surface, sampling, cells, reach, begin, begin + run, nearest_out, rows_out)


@wp.func
def paint(surface: SurfaceArrays, pixels: Pixels, ray: wp.int32):
    """The base colour of what a ray has met."""
    i0 = surface.faces[pixels.face[ray], 0]
    i1 = surface.faces[pixels.face[ray], 1]
    i2 = surface.faces[pixels.face[ray], 2]
    b0 = pixels.place[ray][0]
    b1 = pixels.place[ray][1]
    b2 = wp.max(wp.float32(0.0), 1.0 - b0 - b1)
    colour = wp.vec3f(-1.0, -1.0, -1.0)
    if surface.has_vertex_colours:
        c0 = surface.vertex_colours[i0]
        c1 = surface.vertex_colours[i1]
        c2 = surface.vertex_colours[i2]
        colour = b0 * c0 + b1 * c1 + b2 * c2
    if colour[0] < 0.0:
        # A plain colour is a texture of one texel.
        colour = surface.texture[0, 0]
        if surface.texture.shape[0] * surface.texture.shape[1] > 1:
            uv = b0 * surface.uvs[i0] + b1 * surface.uvs[i1] + b2 * surface.uvs[i2]
            colour = sample_texture(surface.texture, uv)
    pixels.base_colour[ray] = colour


# Rays with a face each side by side, step after step, so that the compiler makes vectors of each; a GPU takes one at a
# time.
_MEET = """
    const double* const axes = (const double*)camera.axes.data;
    const int* const faces = (const int*)surface.faces.data;
    const float* const positions = (const float*)surface.positions.data;
    const unsigned long long* const nearest = (const unsigned long long*)pixels.nearest.data;
    const int* const tiles = (const int*)sampling.tiles.data;
    const double* const places = (const double*)sampling.places.data;
    const double* const offsets = (const double*)sampling.offsets.data;
    int* const hit = (int*)pixels.hit.data;
    int* const face_at = (int*)pixels.face.data;
    float* const place_at = (float*)pixels.place.data;
    float* const view_at = (float*)pixels.to_view.data;
    const bool orthographic = camera.orthographic, of_tiles = sampling.tiles.shape[0] > 0;
    const bool scattered = sampling.offsets.shape[0] > 0;
    const int width = camera.width, of_tile = of_tiles ? (int)sampling.places.shape[0] : 1;
    const double per_width = 2.0 * axes[12] / width, per_height = 2.0 * axes[13] / camera.height;
    // Rays that meet a face, and where they are in the picture.
    int rays[ABREAST], met[ABREAST], number = 0;
    double right[ABREAST], down[ABREAST];
    auto meet = [&]() {
        float corner[3][3][ABREAST];
        for (int i = 0; i < ABREAST; ++i) {
            const int* const corners = faces + 3LL * (i < number ? met[i] : 0);
            for (int which = 0; which < 3; ++which)
                for (int c = 0; c < 3; ++c) corner[which][c][i] = positions[3LL * corners[which] + c];
        }
        float views[3][ABREAST], kept[2][ABREAST];
        for (int i = 0; i < ABREAST; ++i) {
            // In float64, as the eye may be thousands of radii away.
            const double x = per_width * right[i] - axes[12], y = axes[13] - per_height * down[i];
            double along[3], edge1[3], edge2[3], away[3], across1[3], across2[3];
            for (int c = 0; c < 3; ++c) {
                const double across = x * axes[3 + c] + y * axes[6 + c];
                along[c] = (orthographic ? 0.0 : across) - axes[9 + c];
                away[c] = axes[c] + (orthographic ? across : 0.0) - corner[0][c][i];
                edge1[c] = (double)corner[1][c][i] - corner[0][c][i];
                edge2[c] = (double)corner[2][c][i] - corner[0][c][i];
            }
            const double per_length = 1.0
                / wp::sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]);
            for (int c = 0; c < 3; ++c) {
                along[c] *= per_length;
                views[c][i] = -(float)along[c];
            }
            across2[0] = along[1] * edge2[2] - along[2] * edge2[1];
            across2[1] = along[2] * edge2[0] - along[0] * edge2[2];
            across2[2] = along[0] * edge2[1] - along[1] * edge2[0];
            across1[0] = away[1] * edge1[2] - away[2] * edge1[1];
            across1[1] = away[2] * edge1[0] - away[0] * edge1[2];
            across1[2] = away[0] * edge1[1] - away[1] * edge1[0];
            const double determinant = edge1[0] * across2[0] + edge1[1] * across2[1] + edge1[2] * across2[2];
            const double inverse = determinant == 0.0 ? 0.0 : 1.0 / determinant;
            const double share1 = inverse * (away[0] * across2[0] + away[1] * across2[1] + away[2] * across2[2]);
            const double share2 = inverse * (along[0] * across1[0] + along[1] * across1[1] + along[2] * across1[2]);
            const double kept1 = wp::min(wp::max(share1, 0.0), 1.0), kept2 = wp::min(wp::max(share2, 0.0), 1.0 - kept1);
            kept[0][i] = (float)(1.0 - kept1 - kept2);
            kept[1][i] = (float)kept1;
        }
        for (int i = 0; i < number; ++i) {
            const long long at = rays[i];
            hit[at] = 1;
            face_at[at] = met[i];
            for (int c = 0; c < 2; ++c) place_at[2 * at + c] = kept[c][i];
            for (int c = 0; c < 3; ++c) view_at[3 * at + c] = views[c][i];
        }
        number = 0;
    };
    for (int i = 0; i < ABREAST; ++i) right[i] = down[i] = 0.0;
    for (int ray = begin; ray < end;) {
        const int pixel = of_tiles ? tiles[ray / of_tile] : ray, row = pixel / width, column = pixel % width;
        // The rest of a row, or of a tile.
        int count = of_tiles ? of_tile - ray % of_tile : width - column;
        count = count < end - ray ? count : end - ray;
        for (int k = 0; k < count; ++k) {
            const int at = ray + k;
            hit[at] = 0;
            face_at[at] = -1;
            if (nearest[at] == UNSEEN) continue;
            rays[number] = at;
            met[number] = (int)(unsigned int)nearest[at];
            const double* const place = of_tiles ? places + 2 * (at % of_tile) : scattered ? offsets + 2 * at : nullptr;
            right[number] = column + (of_tiles ? 0 : k) + 0.5 + (place ? place[0] : 0.0);
            down[number] = row + 0.5 + (place ? place[1] : 0.0);
            if (++number == ABREAST) meet();
        }
        ray += count;
    }
    if (number > 0) meet();
"""


@wp.func_native(filled(simd_batch(32) + _MEET, UNSEEN=f"{int(UNSEEN)}ULL"))
def intersect_known_faces_run(
    camera: Camera, surface: SurfaceArrays, sampling: Sampling, pixels: Pixels, begin: wp.int32, end: wp.int32
):
    """Where rays one after the other meet the faces that are known to be nearest."""


@wp.kernel
def intersect_known_faces(
    # In:
    camera: Camera,
    surface: SurfaceArrays,
    sampling: Sampling,
    pixels: Pixels,
    first: wp.int32,
    run: wp.int32,
):
    """Where the rays of pixels, or of tiles, meet the faces that ``rasterize`` has found.

    Args:
        camera: The view.
        surface: The mesh.
        sampling: Where in the pixel.
        pixels: What was and is found.
        first: The first thread's pixel, or ray of a tile.
        run: How many a thread takes.
    """
    begin = first + wp.tid() * run
    intersect_known_faces_run(camera, surface, sampling, pixels, begin, begin + run)
    if pixels.base_colour.shape[0] > 0:
        for ray in range(begin, begin + run):
            if pixels.hit[ray] != 0:
                paint(surface, pixels, ray)


@wp.kernel
def place_samples(
    # In:
    sample: wp.int32,
    samples: wp.int32,
    seed: wp.int32,
    first: wp.int32,
    run: wp.int32,
    # Out:
    offsets_out: wp.array(dtype=wp.vec2d),
):
    """Where a sample of each pixel lies, as ``pixel_offset`` has it."""
    for pixel in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        offsets_out[pixel] = pixel_offset(sample, samples, seed, pixel)


@wp.kernel
def make_shading_frames(
    # In:
    surface: SurfaceArrays,
    pixels: Pixels,
    first: wp.int32,
    run: wp.int32,
):
    """The shading frames at what was met, and where shadow rays start.

    The frame is right-handed on both sides of the surface: seen from behind, the normal is turned over, t stays, and
    b = (n × t) · handedness is taken with the turned normal, as if the height field had been laid on that side with
    the same x direction.

    Args:
        surface: The mesh.
        pixels: What was and is found.
        first: The first thread's pixel.
        run: How many a thread takes.
    """
    begin = first + wp.tid() * run
    if shading_frames_run(surface, pixels, begin, begin + run) == 0:
        return
    for ray in range(begin, begin + run):
        if pixels.hit[ray] == SPECIAL:
            pixels.hit[ray] = 1
            i0 = surface.faces[pixels.face[ray], 0]
            i1 = surface.faces[pixels.face[ray], 1]
            i2 = surface.faces[pixels.face[ray], 2]
            p0 = surface.positions[i0]
            geometric = wp.normalize(wp.cross(surface.positions[i1] - p0, surface.positions[i2] - p0))
            to_view = pixels.to_view[ray]
            if wp.dot(geometric, to_view) < 0.0:
                geometric = -geometric
            normal = face_the_viewer(pixels.normal[ray], geometric, to_view)
            place = pixels.place[ray]
            share = wp.max(wp.float32(0.0), 1.0 - place[0] - place[1])
            tangent = place[0] * surface.tangents[i0] + place[1] * surface.tangents[i1] + share * surface.tangents[i2]
            tangent = tangent - wp.dot(tangent, normal) * normal
            if wp.length_sq(tangent) > LEAST_TANGENT:
                # Projected twice, as in face_the_viewer.
                tangent = wp.normalize(tangent - wp.dot(tangent, normal) * normal)
            else:
                tangent = perpendicular(normal)
            pixels.normal[ray] = normal
            pixels.tangent[ray] = tangent
            pixels.bitangent[ray] = surface.handedness[i0] * wp.cross(normal, tangent)
