"""Structs of kernels: cameras, meshes, ray positions, subpixel cells and hits.

Positions are in units in which the mesh fills the unit sphere around the origin. Relative rounding errors in float32
then depend neither on the size of the mesh nor on its distance from the origin of the world.
"""

import warp as wp

# A footprint: the changes of (u, v) over one standard deviation of the pixel filter, first along rows and then along
# columns.
Footprint = wp.types.vector(length=4, dtype=wp.float32)
# Value of the field ``hit`` for a pixel whose shading frame is computed separately, by a slower method.
SPECIAL = wp.constant(2)


@wp.struct
class Camera:
    """Camera, in units in which the mesh fills the unit sphere around the origin."""

    # Five vectors: origin; unit vectors to the right, up and back; half the width and height of the picture. They are
    # in an array, so that a recorded graph can be replayed for new views. With an array of structs, compilation would
    # take half a second longer.
    axes: wp.array(dtype=wp.vec3d)
    orthographic: wp.bool
    width: wp.int32
    height: wp.int32


@wp.struct
class Sampling:
    """Positions of rays in pixels: at the centre, at one offset per pixel, or at all cells of some pixels."""

    tiles: wp.array(dtype=wp.int32)  # pixels whose cells are the rays, −1 is no pixel; empty if pixels have no cells
    places: wp.array(dtype=wp.vec2d)  # positions of a pixel's cells, (right, down) of the centre [pixels]; or empty
    offsets: wp.array(dtype=wp.vec2d)  # position of the one ray in each pixel, as ``places``; or empty


@wp.struct
class Cells:
    """Set of pixels whose cells are rasterized; each of these pixels has the same number of cells."""

    marks: wp.array(dtype=wp.uint64)  # one bit per pixel of the picture; each row begins with a new 64-bit word
    ranks: wp.array(dtype=wp.int32)  # for each pixel of the picture, its index in the set
    across: wp.int32  # number of cells along a side of a pixel


@wp.struct
class SurfaceArrays:
    """Mesh in units in which it fills the unit sphere, with normals, tangents and other attributes of its vertices."""

    mesh_id: wp.uint64
    positions: wp.array(dtype=wp.vec3f)
    faces: wp.array2d(dtype=wp.int32)
    normals: wp.array(dtype=wp.vec3f)
    tangents: wp.array(dtype=wp.vec3f)
    handedness: wp.array(dtype=wp.float32)
    uvs: wp.array(dtype=wp.vec2f)
    vertex_colours: wp.array(dtype=wp.vec3f)  # negative at vertices whose base colour is that of a texture; or empty
    plain_colour: wp.vec3f  # base colour without vertex colours; negative if it is that of a texture
    smooth: wp.bool


@wp.struct
class Textures:
    """Textures of a scene: images with their pyramids, and the textures that each material uses."""

    texels: wp.array(dtype=wp.vec4f)  # linear RGBA of all levels of all images, row by row; row 0 is at v = 1
    levels: wp.array2d(dtype=wp.int32)  # for each level of each image: index of its first texel, width and height
    table: wp.array2d(dtype=wp.int32)  # for each texture: index and number of its levels, continuation along u and v
    rows: wp.array(dtype=wp.int32)  # row of each face in the next array; −1 without a material
    of_base_colour: wp.array(dtype=wp.int32)  # texture of each row's base colour; −1 without one
    of_metallic_roughness: wp.array(dtype=wp.int32)  # that of its metallic (blue) and roughness (green); or empty
    of_emission: wp.array(dtype=wp.int32)  # that of its emission; or empty
    metallic_roughness_uvs: wp.array(dtype=wp.vec2f)  # coordinates of these textures at the vertices; or empty
    emission_uvs: wp.array(dtype=wp.vec2f)  # coordinates of the textures of emission; or empty


@wp.struct
class Transparency:
    """Alpha of the scene by which rays pass through faces, in addition to that of textures; empty if it is opaque."""

    cutoffs: wp.array(dtype=wp.float32)  # alpha below which rays pass, by row; 0: opaque; negative: blended
    vertex_alphas: wp.array(dtype=wp.float32)  # alpha at the vertices; empty if it is 1 everywhere


@wp.struct
class Pixels:
    """Arrays of hits and shading frames, one entry per ray.

    With one struct instead of many arrays, kernels compile a third faster.
    """

    nearest: wp.array(dtype=wp.uint64)  # nearest face of each ray, from ``rasterize`` or ``trace_bvh``
    hit: wp.array(dtype=wp.int32)  # 1 where the ray hits the mesh, else 0; other fields but ``face`` are then undefined
    face: wp.array(dtype=wp.int32)  # index of the face that is hit, or −1
    place: wp.array(dtype=wp.vec2f)  # barycentric coordinates of the face's first and second corner
    tangent: wp.array(dtype=wp.vec3f)  # tangent t, unit vector
    bitangent: wp.array(dtype=wp.vec3f)  # bitangent b, unit vector
    normal: wp.array(dtype=wp.vec3f)  # shading normal n, unit vector, n·ωr >= 0.01
    to_view: wp.array(dtype=wp.vec3f)  # unit vector ωr to the viewer
    shadow_origin: wp.array(dtype=wp.vec3f)  # origin of shadow rays
    base_colour: wp.array(dtype=wp.vec3f)  # base colour, linear RGB; empty without a pigment
    # Factors of metallic and roughness by textures, the standard deviation of roughness within the footprint, and the
    # change of metallic over this deviation; empty without textures.
    metallic_roughness: wp.array(dtype=wp.vec4f)
    emission: wp.array(dtype=wp.vec3f)  # factors of emission by textures, linear RGB; empty without any
