"""Structs of kernels: camera, mesh, samples, cells and hits.

Positions are in units in which the mesh fills the unit sphere about the origin: there float32 is as fine for a mesh of
a nanometre as for one of a kilometre, wherever either lies.
"""

import warp as wp

# Change of (u, v) by one standard deviation of the filter, along rows and along columns.
Footprint = wp.types.vector(length=4, dtype=wp.float32)
# Value of ``hit`` of a pixel whose shading frame is not computed yet.
SPECIAL = wp.constant(2)


@wp.struct
class Camera:
    """A view. The fields are those of ``warpdiff.scene.camera.ViewFrame``, in the surface's units."""

    # Origin, right, up, back, half the width and height: in an array, so that a recorded picture finds the next ones.
    # An array of structs would take half a second longer to compile.
    axes: wp.array(dtype=wp.vec3d)
    orthographic: wp.bool
    width: wp.int32
    height: wp.int32


@wp.struct
class Sampling:
    """Where rays lie: in pixels' centres or as offsets say; or cells of some pixels."""

    tiles: wp.array(dtype=wp.int32)  # pixels whose cells these are, one after the other, −1 is none; empty is off
    places: wp.array(dtype=wp.vec2d)  # where a pixel's cells lie, (right, down) of the centre [pixels]; or empty
    offsets: wp.array(dtype=wp.vec2d)  # where a sample of each pixel lies, as ``places``; or empty


@wp.struct
class Cells:
    """Pixels that are split into as many cells each, and where their rays come."""

    marks: wp.array(dtype=wp.uint64)  # which pixels these are: a bit each, rows begin with words of 64
    ranks: wp.array(dtype=wp.int32)  # of each pixel of the picture: its place among those that are split
    across: wp.int32  # cells along a side of a pixel


@wp.struct
class SurfaceArrays:
    """A mesh with what is interpolated on it. The fields are those of ``warpdiff.scene.mesh_import.Surface``."""

    mesh_id: wp.uint64
    positions: wp.array(dtype=wp.vec3f)
    faces: wp.array2d(dtype=wp.int32)
    normals: wp.array(dtype=wp.vec3f)
    tangents: wp.array(dtype=wp.vec3f)
    handedness: wp.array(dtype=wp.float32)
    uvs: wp.array(dtype=wp.vec2f)
    vertex_colours: wp.array(dtype=wp.vec3f)
    texture: wp.array2d(dtype=wp.vec3f)
    has_vertex_colours: wp.bool
    smooth: wp.bool


@wp.struct
class Pixels:
    """Hits and shading frames, one entry a pixel. Kernels whose arrays lie in structs compile a third faster."""

    nearest: wp.array(dtype=wp.uint64)  # what ``rasterize`` or ``trace_bvh`` found of these rays
    hit: wp.array(dtype=wp.int32)  # 1 where the mesh is met, else 0; all but the face is then of no account
    face: wp.array(dtype=wp.int32)  # the face that is met, or −1
    place: wp.array(dtype=wp.vec2f)  # where on it: the shares of its first and second corner
    tangent: wp.array(dtype=wp.vec3f)  # t, unit
    bitangent: wp.array(dtype=wp.vec3f)  # b, unit
    normal: wp.array(dtype=wp.vec3f)  # the shading normal n, unit, n·ωr >= 0.01
    to_view: wp.array(dtype=wp.vec3f)  # ωr, unit
    shadow_origin: wp.array(dtype=wp.vec3f)  # where shadow rays start
    base_colour: wp.array(dtype=wp.vec3f)  # linear RGB; empty is not asked for
