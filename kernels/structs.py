"""Structs of kernels: cameras, meshes, ray positions, subpixel cells and hits.

Positions are in units in which the mesh fills the unit sphere around the origin. Relative rounding errors in float32
then depend neither on the size of the mesh nor on its distance from the origin of the world.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer. n is the shading normal.
"""

import warp as wp

# A footprint of a pixel: the change of (u, v) over one standard deviation of the pixel filter along picture rows,
# followed by the change along columns.
Footprint = wp.types.vector(length=4, dtype=wp.float32)
# This value of the field ``hit`` marks a pixel whose shading frame is computed separately, by a slower method.
SPECIAL = wp.constant(2)


@wp.struct
class Camera:
    """Camera, in units in which the mesh fills the unit sphere around the origin."""

    # Five vectors: origin; unit vectors to the right, up and back; half the width and height of the picture. They are
    # in an array, so that a recorded CUDA graph can be replayed for new views. With an array of structs, compilation
    # would take half a second longer.
    axes: wp.array(dtype=wp.vec3d)
    orthographic: wp.bool
    width: wp.int32
    height: wp.int32


@wp.struct
class Sampling:
    """Positions of rays in pixels: at the centre, at one offset per pixel, or at all subpixel cells of some pixels."""

    # Pixels that are divided into cells, with one ray per cell; −1 stands for no pixel. The array is empty if no pixel
    # is divided.
    tiles: wp.array(dtype=wp.int32)
    # Positions of the cells of a pixel, (right, down) from the centre of the pixel [pixels]; empty if there are no
    # cells.
    places: wp.array(dtype=wp.vec2d)
    # Position of the ray of each pixel, (right, down) from the centre of the pixel [pixels], if each pixel has one ray.
    # The array is empty if all rays are at the centres.
    offsets: wp.array(dtype=wp.vec2d)


@wp.struct
class Cells:
    """Set of pixels with subpixel cells that are rasterized; each of these pixels has the same number of cells."""

    marks: wp.array(dtype=wp.uint64)  # one bit per pixel of the picture; each row begins with a new 64-bit word
    ranks: wp.array(dtype=wp.int32)  # for each pixel of the picture: its index among the pixels of the set
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
    # Base colours of the vertices, negative if a texture determines the base colour; empty if vertices have no colours.
    vertex_colours: wp.array(dtype=wp.vec3f)
    plain_colour: wp.vec3f  # base colour if vertices have no colours; negative if a texture determines it
    smooth: wp.bool


@wp.struct
class Textures:
    """Textures of a scene: images with their pyramids, and the textures that each material uses."""

    texels: wp.array(dtype=wp.vec4f)  # linear RGBA of all levels of all images, row by row; the first row is at v = 1
    levels: wp.array2d(dtype=wp.int32)  # for each level of each image: index of its first texel, width and height
    # For each texture: index of the first level of its image pyramid in ``levels``, number of levels, and how it
    # continues beyond its edges along u and v.
    table: wp.array2d(dtype=wp.int32)
    rows: wp.array(dtype=wp.int32)  # row of each face in the next array; −1 without a material
    of_base_colour: wp.array(dtype=wp.int32)  # texture of each row's base colour; −1 without one
    of_metallic_roughness: wp.array(dtype=wp.int32)  # texture of metallic (blue) and roughness (green); or empty
    of_emission: wp.array(dtype=wp.int32)  # texture of each row's emission; or empty
    metallic_roughness_uvs: wp.array(dtype=wp.vec2f)  # coordinates of these textures at the vertices; or empty
    emission_uvs: wp.array(dtype=wp.vec2f)  # coordinates of the textures of emission; or empty


@wp.struct
class Transparency:
    """Transparency of a scene: alpha, which decides whether rays pass through faces, except the alpha of textures.

    The arrays are empty if the scene is opaque.
    """

    # For each material (its index is in ``Textures.rows``): alpha below which rays pass a face. 0 stands for an opaque
    # material. A negative number stands for a blended material: the smaller its alpha, the more rays pass.
    cutoffs: wp.array(dtype=wp.float32)
    vertex_alphas: wp.array(dtype=wp.float32)  # alpha at the vertices; empty if it is 1 everywhere


@wp.struct
class Pixels:
    """Arrays of hits and shading frames, one entry per ray.

    With one struct instead of many arrays, kernels compile a third faster.
    """

    nearest: wp.array(dtype=wp.uint64)  # nearest face of each ray, from ``rasterize`` or ``trace_bvh``
    hit: wp.array(dtype=wp.int32)  # 1 where the ray hits the mesh, else 0; other fields but ``face`` are then undefined
    face: wp.array(dtype=wp.int32)  # index of the face that the ray hits, −1 if it hits no face
    place: wp.array(dtype=wp.vec2f)  # barycentric coordinates of the hit, for the first and second corner of the face
    tangent: wp.array(dtype=wp.vec3f)  # tangent t, unit vector
    bitangent: wp.array(dtype=wp.vec3f)  # bitangent b, unit vector
    normal: wp.array(dtype=wp.vec3f)  # shading normal n, unit vector, n·ωr >= 0.01
    to_view: wp.array(dtype=wp.vec3f)  # unit vector ωr to the viewer
    shadow_origin: wp.array(dtype=wp.vec3f)  # origin of shadow rays
    base_colour: wp.array(dtype=wp.vec3f)  # base colour, linear RGB; empty if there is no pigment
    # Factors of metallic and roughness that textures determine, the standard deviation of roughness within the
    # footprint, and the change of metallic over this deviation; empty without textures.
    metallic_roughness: wp.array(dtype=wp.vec4f)
    emission: wp.array(dtype=wp.vec3f)  # factors of emission that textures determine, linear RGB; or empty
