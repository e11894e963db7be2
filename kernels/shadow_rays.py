"""Shadow rays: a grid over the mesh, projected along the light. Each cell of the grid lists the faces in it.

The grid is called an occluder grid. It is a plane grid perpendicular to the direction of a distant light.

Positions perpendicular to the light are rounded to whole multiples of 2^-24 radii. Their differences and products are
then exact in float64, with any compiler. For two faces that meet at an edge, a point is therefore on the same side of
the edge in the tests of both faces, and no ray passes between the faces.
"""

import warp as wp

from warpdiff.kernels import compile_options
from warpdiff.kernels.atomics import atomic_increment
from warpdiff.kernels.bvh import FAR
from warpdiff.kernels.structs import Pixels

wp.set_module_options(compile_options.options("shadow_rays.h", "atomics.h"))

# Most kernels of this module have a second thread index, which is always 0. Warp then compiles one variant of a kernel
# instead of two, as explained in ``light_samples``.

# Number of steps per radius of the mesh to which positions are rounded. The value is limited by float32, which
# represents all whole numbers up to 2^24.
STEPS = wp.constant(wp.float64(16777216.0))
# A shadow ray is traced if the cosine between the normal and the direction to the light exceeds this number. The number
# is slightly negative, so that no ray is omitted because of rounding. It was derived from the rounding error of
# cosines, which is smaller than 1e-5.
FACING_AWAY = wp.constant(wp.float32(-1.0e-5))


@wp.struct
class ShadowGrid:
    """Grid over a mesh that is projected along the direction to a light, to find faces that occlude the light.

    Each cell of the grid has a list of the faces that overlap it.
    """

    mesh_id: wp.uint64  # mesh whose bounding-volume hierarchy is used if the grid has no lists
    across: wp.vec3d  # first unit vector perpendicular to the light
    up: wp.vec3d  # second unit vector perpendicular to the light
    towards: wp.vec3d  # unit vector to the light
    low_x: wp.float64  # position of the first cell's corner along ``across`` [steps]
    low_y: wp.float64  # position of the first cell's corner along ``up`` [steps]
    per_step: wp.float64  # number of grid cells per step
    columns: wp.int32
    rows: wp.int32
    is_closed: wp.bool  # whether the mesh is closed; faces that face away from the light then need no lists
    # For each face: a matrix with one row per corner, counter-clockwise. A row has the positions along ``across`` and
    # ``up`` [steps], and the height, the position along ``towards``.
    corners: wp.array(dtype=wp.mat33f)
    # Index in ``faces`` at which the list of each grid cell begins, and index at which the last list ends; empty
    # without lists.
    starts: wp.array(dtype=wp.int32)
    faces: wp.array(dtype=wp.int32)  # indices of the faces in the lists, one list after the other
    tops: wp.array(dtype=wp.float32)  # largest height of each listed face


@wp.func
def light_coordinates(grid: ShadowGrid, position: wp.vec3f) -> wp.vec3d:
    """Return the coordinates of a position along the axes ``across``, ``up`` and ``towards`` of an occluder grid.

    The coordinates along ``across`` and ``up`` are whole numbers of steps.
    """
    at = wp.vec3d(position)
    return wp.vec3d(
        wp.rint(wp.dot(at, grid.across) * STEPS), wp.rint(wp.dot(at, grid.up) * STEPS), wp.dot(at, grid.towards)
    )


@wp.func
def cell_of(place: wp.float64, low: wp.float64, per_step: wp.float64) -> wp.int32:
    """Return the column or row of the occluder grid that contains a coordinate.

    A larger coordinate never has a smaller column or row, in spite of rounding.
    """
    return wp.int32(wp.floor((place - low) * per_step))


@wp.func
def left_of(a: wp.vec3f, b: wp.vec3f, x: wp.float64, y: wp.float64) -> wp.float64:
    """Return twice the signed area of the triangle (a, b, (x, y)), exactly.

    The area is positive if the point (x, y) is to the left of the edge from a to b; x points to the right and y
    upwards.
    """
    ax = wp.float64(a[0])
    ay = wp.float64(a[1])
    return (wp.float64(b[0]) - ax) * (y - ay) - (wp.float64(b[1]) - ay) * (x - ax)


@wp.func
def cells_of(grid: ShadowGrid, corners: wp.mat33f) -> wp.vec4i:
    """Return the first and last column and the first and last row of the occluder grid that a face overlaps.

    The ranges are those of the face's bounding box. They are empty for a face without area.
    """
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
    grid: ShadowGrid, positions: wp.array(dtype=wp.vec3f), faces: wp.array2d(dtype=wp.int32), first: wp.int32,
    run: wp.int32,
    cells_out: wp.array(dtype=wp.int32),
):  # fmt: skip
    """Project the corners of faces along the light, and count the grid cells that each face's bounding box overlaps.

    The count is 0 for faces that are edge-on. In a closed mesh it is also 0 for faces that face away from the light.
    """
    for face in range(first + wp.tid() * run, first + (wp.tid() + 1) * run):
        p0 = light_coordinates(grid, positions[faces[face, 0]])
        p1 = light_coordinates(grid, positions[faces[face, 1]])
        p2 = light_coordinates(grid, positions[faces[face, 2]])
        c0 = wp.vec3f(p0)
        c1 = wp.vec3f(p1)
        c2 = wp.vec3f(p2)
        if left_of(c0, c1, p2[0], p2[1]) < wp.float64(0.0):
            c1 = wp.where(grid.is_closed, c0, wp.vec3f(p2))
            c2 = wp.where(grid.is_closed, c0, wp.vec3f(p1))
        corners = wp.matrix_from_rows(c0, c1, c2)
        grid.corners[face] = corners
        cells = cells_of(grid, corners)
        cells_out[face] = (cells[1] - cells[0] + 1) * (cells[3] - cells[2] + 1)


@wp.kernel
def count(
    grid: ShadowGrid,
    first: wp.int32,
    run: wp.int32,
    counts_out: wp.array(dtype=wp.int32),
):
    """Count the faces that overlap each cell of the occluder grid, to allocate the lists of faces."""
    thread, _ = wp.tid()
    for face in range(first + thread * run, first + (thread + 1) * run):
        cells = cells_of(grid, grid.corners[face])
        for row in range(cells[2], cells[3] + 1):
            for column in range(cells[0], cells[1] + 1):
                atomic_increment(counts_out, row * grid.columns + column)


@wp.kernel
def fill(
    grid: ShadowGrid,
    first: wp.int32,
    run: wp.int32,
    ends_out: wp.array(dtype=wp.int32),
):
    """Write the indices of faces into the lists of the grid cells that the faces overlap, in arbitrary order.

    The order depends on the threads, but occlusion does not depend on it. Before the launch, ``ends_out`` has the index
    at which each cell's list begins. After the launch, it has the index at which the list ends.
    """
    thread, _ = wp.tid()
    for face in range(first + thread * run, first + (thread + 1) * run):
        corners = grid.corners[face]
        top = wp.max(wp.max(corners[0, 2], corners[1, 2]), corners[2, 2])
        cells = cells_of(grid, corners)
        for row in range(cells[2], cells[3] + 1):
            for column in range(cells[0], cells[1] + 1):
                place = atomic_increment(ends_out, row * grid.columns + column)
                grid.faces[place] = face
                grid.tops[place] = top


# ``native/shadow_rays.h`` computes coordinates, cells and sides of edges exactly as the functions above, which make the
# lists of faces.
@wp.func_native(
    f"warpdiff::look_up_shadows<8>(grid, towards, pixels, {float(FACING_AWAY)}f, {float(STEPS)}, begin, end, "
    "occluded_out);"
)
def look_up(
    grid: ShadowGrid, towards: wp.vec3f, pixels: Pixels, begin: wp.int32, end: wp.int32,
    occluded_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Determine whether faces in lists of the occluder grid occlude the light, at hits from ``begin`` to ``end``."""


@wp.kernel
def trace_shadow_rays(
    grid: ShadowGrid, places: wp.array(dtype=wp.vec4d), light_index: wp.int32, directions: wp.array(dtype=wp.vec4f),
    pixels: Pixels, first: wp.int32, run: wp.int32,
    occluded_out: wp.array(dtype=wp.bool),
):  # fmt: skip
    """Trace a shadow ray from each hit to the light ``light_index``, unless the surface faces away from it.

    ``grid`` is the occluder grid of the light. For a point light it has no lists, and the ray uses the hierarchy of
    bounding boxes. ``directions`` has a direction to the light for each ray. Its fourth component is the weight of the
    direction, which is not used here. If ``directions`` is empty, all rays use the direction of the light.
    """
    place = places[light_index]
    towards = wp.vec3f(wp.float32(place[0]), wp.float32(place[1]), wp.float32(place[2]))
    at_place = wp.bool(place[3] != wp.float64(0.0))
    thread, _ = wp.tid()
    begin = first + thread * run
    if grid.starts.shape[0] > 0 and directions.shape[0] == 0:
        look_up(grid, towards, pixels, begin, begin + run, occluded_out)
        return
    for ray in range(begin, begin + run):
        is_occluded = bool(False)
        origin = pixels.shadow_origin[ray]
        along = towards
        far = FAR
        if directions.shape[0] > 0:
            along = wp.vec3f(directions[ray][0], directions[ray][1], directions[ray][2])
        if at_place:
            along = towards - origin
            far = wp.min(FAR, wp.length(along))
            along = wp.normalize(along)
        if pixels.hit[ray] != 0 and wp.dot(pixels.normal[ray], along) > FACING_AWAY:
            is_occluded = wp.mesh_query_ray_anyhit(grid.mesh_id, origin, along, far)
        occluded_out[ray] = is_occluded
