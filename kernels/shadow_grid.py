"""Whether a light is hidden, by a grid over the mesh as the light sees it: each cell lists the faces in its reach.

Positions across the light are whole numbers of 2^-24 radii. Their differences and products are exact in float64, so
that the side of an edge on which a point lies is the same for both faces that meet there, however it is compiled: no
ray slips between them.
"""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.bvh import occluded
from warpdiff.kernels.snippets import filled, simd_batch, take_number
from warpdiff.kernels.structs import Pixels

wp.set_module_options(compile_options.options())

# Why most ask for a second index: see ``directions``.

# Steps in a radius: the most that float32 counts one by one.
STEPS = wp.constant(wp.float64(16777216.0))
# Less than any cosine that rounds to above the horizon.
FACING_AWAY = wp.constant(wp.float32(-1.0e-5))


@wp.struct
class ShadowGrid:
    """A mesh as a light sees it."""

    mesh_id: wp.uint64  # whose hierarchy is asked where there is no grid
    across: wp.vec3d  # unit vectors at right angles to the light, ...
    up: wp.vec3d
    towards: wp.vec3d  # ... and towards it
    low_x: wp.float64  # the first cell's corner [steps]
    low_y: wp.float64
    per_step: wp.float64  # cells
    columns: wp.int32
    rows: wp.int32
    corners: wp.array(dtype=wp.mat33f)  # of each face, a row each, counter-clockwise: across and up [steps], height
    starts: wp.array(dtype=wp.int32)  # where each cell's list begins, and the last one ends; empty is no grid
    faces: wp.array(dtype=wp.int32)  # the lists
    tops: wp.array(dtype=wp.float32)  # the largest height of each listed face


@wp.func
def seen(grid: ShadowGrid, position: wp.vec3f) -> wp.vec3d:
    """A position across the light, in whole steps, and its height."""
    at = wp.vec3d(position)
    return wp.vec3d(
        wp.rint(wp.dot(at, grid.across) * STEPS), wp.rint(wp.dot(at, grid.up) * STEPS), wp.dot(at, grid.towards)
    )


@wp.func
def cell_of(place: wp.float64, low: wp.float64, per_step: wp.float64) -> wp.int32:
    """The column or row of a place: never less for one further on."""
    return wp.int32(wp.floor((place - low) * per_step))


@wp.func
def left_of(a: wp.vec3f, b: wp.vec3f, x: wp.float64, y: wp.float64) -> wp.float64:
    """Twice the area between an edge and a point to its left, exactly."""
    ax = wp.float64(a[0])
    ay = wp.float64(a[1])
    return (wp.float64(b[0]) - ax) * (y - ay) - (wp.float64(b[1]) - ay) * (x - ax)


@wp.func
def cells_of(grid: ShadowGrid, corners: wp.mat33f) -> wp.vec4i:
    """First and last column and row of a face's box; none of a face without area."""
    c0 = corners[0]
    c1 = corners[1]
    c2 = corners[2]
    result = wp.vec4i(0, -1, 0, -1)
    if left_of(c0, c1, wp.float64(c2[0]), wp.float64(c2[1])) > wp.float64(0.0):
        result[0] = cell_of(wp.float64(wp.min(wp.min(c0[0], c1[0]), c2[0])), grid.low_x, grid.per_step)
        result[1] = cell_of(wp.float64(wp.max(wp.max(c0[0], c1[0]), c2[0])), grid.low_x, grid.per_step)
        result[2] = cell_of(wp.float64(wp.min(wp.min(c0[1], c1[1]), c2[1])), grid.low_y, grid.per_step)
        result[3] = cell_of(wp.float64(wp.max(wp.max(c0[1], c1[1]), c2[1])), grid.low_y, grid.per_step)
    return result


@wp.kernel
def project(
    # In:
    grid: ShadowGrid,
    positions: wp.array(dtype=wp.vec3f),
    faces: wp.array2d(dtype=wp.int32),
    first: wp.int32,
    run: wp.int32,
    # Out:
    cells_out: wp.array(dtype=wp.int32),
):
    """Each face's corners as the light sees them, and how many cells its box overlaps."""
    for face in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        p0 = seen(grid, positions[faces[face, 0]])
        p1 = seen(grid, positions[faces[face, 1]])
        p2 = seen(grid, positions[faces[face, 2]])
        c0 = wp.vec3f(p0)
        c1 = wp.vec3f(p1)
        c2 = wp.vec3f(p2)
        if left_of(c0, c1, p2[0], p2[1]) < wp.float64(0.0):
            c1 = wp.vec3f(p2)
            c2 = wp.vec3f(p1)
        corners = wp.matrix_from_rows(c0, c1, c2)
        grid.corners[face] = corners
        cells = cells_of(grid, corners)
        cells_out[face] = (cells[1] - cells[0] + 1) * (cells[3] - cells[2] + 1)


@wp.kernel
def count(
    # In:
    grid: ShadowGrid,
    first: wp.int32,
    run: wp.int32,
    # Out:
    counts_out: wp.array(dtype=wp.int32),
):
    """How many faces each cell lists."""
    thread, _ = wp.tid()
    for face in range(first + thread * run, first + (thread + 1) * run):
        cells = cells_of(grid, grid.corners[face])
        for row in range(cells[2], cells[3] + 1):
            for column in range(cells[0], cells[1] + 1):
                take_number(counts_out, row * grid.columns + column)


@wp.kernel
def fill(
    # In:
    grid: ShadowGrid,
    first: wp.int32,
    run: wp.int32,
    # Out:
    ends_out: wp.array(dtype=wp.int32),
):
    """The cells' lists, in whatever order threads come: whether any face hides the light does not depend on it.

    ``ends_out`` are the lists' beginnings and become their ends.
    """
    thread, _ = wp.tid()
    for face in range(first + thread * run, first + (thread + 1) * run):
        corners = grid.corners[face]
        top = wp.max(wp.max(corners[0, 2], corners[1, 2]), corners[2, 2])
        cells = cells_of(grid, corners)
        for row in range(cells[2], cells[3] + 1):
            for column in range(cells[0], cells[1] + 1):
                place = take_number(ends_out, row * grid.columns + column)
                grid.faces[place] = face
                grid.tops[place] = top


# Pixels side by side, of which those in one cell meet its list together; a GPU takes one at a time. Places and cells
# are those of ``seen`` and ``cell_of``, and sides of edges those of ``left_of``, by which lists are made.
_LOOK_UP = """
    constexpr int MOST = 32;
    const int* const hit = (const int*)pixels.hit.data;
    const float* const normals = (const float*)pixels.normal.data;
    const float* const origins = (const float*)pixels.shadow_origin.data;
    const float* const corners = (const float*)grid.corners.data;
    const float* const tops = (const float*)grid.tops.data;
    const int* const starts = (const int*)grid.starts.data;
    const int* const faces = (const int*)grid.faces.data;
    bool* const hidden_at = (bool*)hidden_out.data;
    for (int from = begin; from < end; from += ABREAST) {
        const int count = wp::min(end - from, ABREAST);
        // Whole numbers across the light, and heights.
        double x[ABREAST], y[ABREAST], z[ABREAST];
        int cell[ABREAST], hidden[ABREAST];
        for (int i = 0; i < ABREAST; ++i) {
            const long long k = from + (i < count ? i : 0), at = 3 * k;
            const bool asks = i < count && hit[k] != 0 && normals[at] * towards[0] + normals[at + 1] * towards[1]
                + normals[at + 2] * towards[2] > FACING_AWAY;
            // What is nowhere is in the middle.
            const double p0 = asks ? origins[at] : 0.0f, p1 = asks ? origins[at + 1] : 0.0f;
            const double p2 = asks ? origins[at + 2] : 0.0f;
            x[i] = rint((p0 * grid.across[0] + p1 * grid.across[1] + p2 * grid.across[2]) * STEPS);
            y[i] = rint((p0 * grid.up[0] + p1 * grid.up[1] + p2 * grid.up[2]) * STEPS);
            z[i] = p0 * grid.towards[0] + p1 * grid.towards[1] + p2 * grid.towards[2];
            const int column = (int)floor((x[i] - grid.low_x) * grid.per_step);
            const int row = (int)floor((y[i] - grid.low_y) * grid.per_step);
            const bool inside = column >= 0 && row >= 0 && column < grid.columns && row < grid.rows;
            cell[i] = asks && inside ? row * grid.columns + column : -1;
            hidden[i] = 0;
        }
        for (int i = 0; i < count; ++i) {
            if (cell[i] < 0) continue;
            const int here = cell[i];
            double least = 4.0;
            for (int j = i; j < ABREAST; ++j)
                if (cell[j] == here && z[j] < least) least = z[j];
            for (int next = starts[here]; next < starts[here + 1];) {
                // Those that rise above any of the pixels: told apart without branches, which none could foresee.
                int above[MOST], number = 0;
                float top[MOST];
                const int stop = wp::min(next + MOST, starts[here + 1]);
                for (; next < stop; ++next) {
                    above[number] = faces[next];
                    top[number] = tops[next];
                    number += tops[next] > least;
                }
                for (int which = 0; which < number; ++which) {
                    const float* const of_face = corners + 9LL * above[which];
                    const float most = top[which];
                    const double x0 = of_face[0], y0 = of_face[1], z0 = of_face[2];
                    const double x1 = of_face[3], y1 = of_face[4], z1 = of_face[5];
                    const double x2 = of_face[6], y2 = of_face[7], z2 = of_face[8];
                    for (int j = 0; j < ABREAST; ++j) {
                        // Twice the areas between the edges and the point, exactly.
                        const double e0 = (x2 - x1) * (y[j] - y1) - (y2 - y1) * (x[j] - x1);
                        const double e1 = (x0 - x2) * (y[j] - y2) - (y0 - y2) * (x[j] - x2);
                        const double e2 = (x1 - x0) * (y[j] - y0) - (y1 - y0) * (x[j] - x0);
                        const int below = (e0 >= 0.0) & (e1 >= 0.0) & (e2 >= 0.0)
                            & (z0 * e0 + z1 * e1 + z2 * e2 > z[j] * (e0 + e1 + e2));
                        // What lies in a face's plane is not to depend on what is beside it and lower.
                        hidden[j] |= below & (cell[j] == here) & (most > z[j]);
                    }
                }
            }
            for (int j = 0; j < ABREAST; ++j) cell[j] = cell[j] == here ? -1 : cell[j];
        }
        for (int i = 0; i < count; ++i) hidden_at[from + i] = hidden[i] != 0;
    }
"""


@wp.func_native(filled(simd_batch(8) + _LOOK_UP, FACING_AWAY=f"{float(FACING_AWAY)}f", STEPS=float(STEPS)))
def look_up(
    grid: ShadowGrid,
    towards: wp.vec3f,
    pixels: Pixels,
    begin: wp.int32,
    end: wp.int32,
    hidden_out: wp.array(dtype=wp.bool),
):
    """Whether faces in the lists hide what pixels one after the other see."""


@wp.kernel
def trace_shadow_rays(
    # In:
    grid: ShadowGrid,
    to_lights: wp.array(dtype=wp.vec3d),
    which: wp.int32,
    pixels: Pixels,
    first: wp.int32,
    run: wp.int32,
    # Out:
    hidden_out: wp.array(dtype=wp.bool),
):
    """Whether the mesh is met on the way from what pixels see to one of the lights; those that look away do not ask.

    ``grid`` is that of the same light.
    """
    towards = wp.vec3f(to_lights[which])
    thread, _ = wp.tid()
    begin = first + thread * run
    if grid.starts.shape[0] > 0:
        look_up(grid, towards, pixels, begin, begin + run, hidden_out)
        return
    for ray in range(begin, begin + run):
        hidden = bool(False)
        if pixels.hit[ray] != 0 and wp.dot(pixels.normal[ray], towards) > FACING_AWAY:
            hidden = occluded(grid.mesh_id, pixels.shadow_origin[ray], towards)
        hidden_out[ray] = hidden
