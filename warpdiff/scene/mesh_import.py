"""Import of triangle meshes: normals, tangents and base colours at the vertices.

Every mesh becomes a :class:`Surface` of float32 arrays. Faces without area and vertices without a face are removed.
"""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from warpdiff.core import forks, validation
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.optics.colorimetry import srgb_decode
from warpdiff.scene import mesh_colours, mesh_files
from warpdiff.scene.mesh_geometry import (
    FaceGeometry,
    TextureGeometry,
    compacted,
    fill,
    is_closed,
    is_convex,
    join_seams,
    tangential,
    tangents_from_uvs,
    unit,
    vertex_normals,
    weld,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    import trimesh
    from numpy.typing import ArrayLike, NDArray

HOW_TO_GET_TANGENTS = (
    f"give {ref('tangents')} (directions of the height field's x axis, world frame: (n, 3), one per vertex, or (3,), "
    "one for all), or a mesh with texture coordinates, whose u axis is then the direction"
)

# First words of the label by which messages name a geometry of a scene; the name of the geometry follows.
_GEOMETRY = f"{ref('mesh')}'s geometry "


@dataclass(frozen=True, eq=False)
class Surface:
    """Prepared mesh of n vertices and m faces; every face has an area, and every vertex belongs to a face.

    Attributes:
        vertices: Positions in the unit sphere, (world − ``centre``) / ``radius``, shape (n, 3), float32.
        faces: Vertex indices, counter-clockwise as viewed from the front, shape (m, 3), int32.
        normals: Unit vertex normals, shape (n, 3), float32; zero where no direction is defined.
        tangents: Unit vectors along the height field's x axis, perpendicular to the normals, shape (n, 3), float32.
        handedness: −1 where the texture mapping is mirrored, else 1, shape (n,), float32; equal for all vertices of a
            face.
        uvs: Texture coordinates, v upwards, shape (n, 2), float32; zero where undefined.
        texture: Linear RGB, row 0 at v = 1, shape (h, w, 3), float32; 1 × 1 for a uniform colour, black without colour.
        vertex_colours: Linear RGB, shape (n, 3), float32; negative at vertices that use ``texture``. None if all
            vertices use ``texture``.
        has_base_colour: Whether the input mesh has a colour of any kind.
        geometries: For each face, the index of its geometry in a scene, shape (m,), int32.
        geometry_names: Names of the geometries in a scene; one empty name for a single mesh.
        is_convex: Whether the mesh bounds a convex body or is in a plane, so that no point on its outside is in shadow.
        centre: Origin of ``vertices``, world frame, shape (3,), float64.
        radius: Unit of ``vertices``, in mesh units.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    tangents: NDArray[np.float32]
    handedness: NDArray[np.float32]
    uvs: NDArray[np.float32]
    texture: NDArray[np.float32]
    vertex_colours: NDArray[np.float32] | None
    has_base_colour: bool
    geometries: NDArray[np.int32]
    is_convex: bool
    centre: NDArray[np.float64]
    radius: float
    geometry_names: tuple[str, ...] = ("",)

    @forks.cached_property
    def is_closed(self) -> bool:
        """Whether the mesh bounds bodies, each with outward normals."""
        return is_closed(self.vertices.T.astype(np.float64), self.faces.T)


def prepare_surface(
    mesh: trimesh.Trimesh | trimesh.Scene | Surface | str | os.PathLike[str], *, tangents: ArrayLike | None = None
) -> Surface:
    """Check a mesh and compute its normals, tangents and base colours.

    Vertices with normals in the input keep them. Other normals are angle-weighted means over all faces that meet at a
    position, so that texture seams are invisible. STL files have one normal per face. Tangents are ``tangents``, or
    ∂P/∂u of the texture coordinates, averaged across seams where directions differ by less than 30°.

    Args:
        mesh: A ``trimesh.Trimesh``, a ``trimesh.Scene`` (its transforms apply) or the path of a mesh file. trimesh
            merges vertices of a mesh that is built or loaded without ``process=False``. A :class:`Surface` is returned
            unchanged.
        tangents: Directions of the height field's x axis, world frame, of any length and not necessarily tangential.
            Shape (n, 3) is one per vertex, for a scene in the order of its nodes; shape (3,) is one for all vertices.
            None takes them from the texture coordinates.

    Returns:
        The surface.

    Raises:
        FileNotFoundError: The file does not exist.
        TypeError: ``mesh`` is of another type.
        ValueError: The file cannot be read; the mesh has no vertices, faces or area, is not finite, or its faces have
            indices without a vertex; there are neither tangents nor texture coordinates; there are several textures.
    """
    if isinstance(mesh, Surface) and tangents is None:
        return mesh
    with _naming_file(mesh):
        geometries = _geometries(mesh)
        field = None if tangents is None else validation.finite_array(tangents, "tangents")
        with single_threaded_blas():
            part = _join([_named_part(geometry) for geometry in geometries])
            if field is not None and field.shape == (3,):
                field = np.broadcast_to(field, (part.count, 3))
            _check_tangents(part, field)
            return replace(_build(part, field), geometry_names=tuple(geometry.name for geometry in geometries))


def normalised_positions(
    mesh: trimesh.Trimesh | trimesh.Scene | Surface | str | os.PathLike[str],
) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
    """Return ``centre``, ``radius`` and ``vertices`` as in :class:`Surface`, without computing the other attributes."""
    if isinstance(mesh, Surface):
        return mesh.centre, mesh.radius, mesh.vertices.astype(np.float64)
    with _naming_file(mesh), single_threaded_blas():
        part = _join([_named_part(geometry, colours=False) for geometry in _geometries(mesh)])
        index, _ = compacted(part.faces.T, len(part.vertices))
        world = part.vertices.T.take(index, axis=1)
        centre, radius = _sphere(world)
        return centre, radius, ((world.T - centre) / radius).astype(np.float64)


@contextlib.contextmanager
def _naming_file(mesh: Any) -> Iterator[None]:
    """Add the path of the mesh file to the messages of errors that do not contain it."""
    try:
        yield
    except ValueError as error:
        if isinstance(mesh, (str, os.PathLike)) and str(mesh) not in str(error):
            raise ArgumentValueError(f"{getattr(error, 'marked', error)} (in {str(mesh)!r})") from error
        raise


class _Geometry(NamedTuple):
    """Mesh object of trimesh with its transform to the world, its label in messages, and its name in a scene."""

    mesh: Any
    transform: NDArray[np.float64]
    label: str
    name: str


@dataclass
class _Part:
    """Arrays of one geometry, or of a whole scene, in world coordinates.

    Some vertices of the input are duplicated. For each vertex, ``source`` has the index of the input vertex, and
    ``count`` is the number of input vertices.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    source: NDArray[np.int64]
    count: int
    normals: NDArray[np.float64] | None
    uvs: NDArray[np.float64] | None
    texture: NDArray[np.float32] | None
    colours: NDArray[np.float64] | None
    geometries: NDArray[np.int32]
    label: str = ref("mesh")


def _geometries(mesh: Any) -> list[_Geometry]:
    """Return the meshes in ``mesh``, each with its transform."""
    import trimesh

    if isinstance(mesh, (str, os.PathLike)):
        return _geometries(mesh_files.load(mesh))
    if isinstance(mesh, trimesh.Trimesh):
        return [_Geometry(mesh, np.eye(4), ref("mesh"), "")]
    if not isinstance(mesh, trimesh.Scene):
        raise ArgumentTypeError(
            f"{ref('mesh')} must be a trimesh.Trimesh, a trimesh.Scene or a path, got {type(mesh).__name__}"
        )
    geometries = []
    for node in mesh.graph.nodes_geometry:
        transform, name = mesh.graph[node]
        geometry = mesh.geometry[name]
        if isinstance(geometry, trimesh.Trimesh):
            label = f"{_GEOMETRY}{name!r}"
            geometries.append(_Geometry(geometry, np.asarray(transform, dtype=np.float64), label, str(name)))
    if not geometries:
        raise ArgumentValueError(f"{ref('mesh')} must have triangles, got a scene or file without any")
    return geometries if len(geometries) > 1 else [geometries[0]._replace(label=ref("mesh"))]


def _named_part(geometry: _Geometry, *, colours: bool = True) -> _Part:
    """Return the checked arrays of a geometry. Messages of errors begin with the label of the geometry."""
    try:
        part = _part(geometry.mesh, geometry.transform, colours=colours)
    except ValueError as error:
        message = getattr(error, "marked", str(error)).removeprefix(ref("mesh"))
        raise ArgumentValueError(f"{geometry.label}{message}") from error
    part.label = geometry.label
    return part


def _part(mesh: Any, transform: NDArray[np.float64], *, colours: bool) -> _Part:
    """Check one mesh and copy its arrays."""
    vertices = np.array(mesh.vertices, dtype=np.float64)
    faces = np.array(mesh.faces, dtype=np.int64)
    if vertices.shape[1:] != (3,):
        raise ArgumentValueError(
            f"{ref('mesh')} must have vertices of 3 coordinates, shape (n, 3), got {vertices.shape}; "
            "a file may be truncated"
        )
    if len(vertices) == 0:
        raise ArgumentValueError(f"{ref('mesh')} must have vertices, got none")
    if len(faces) == 0:
        raise ArgumentValueError(f"{ref('mesh')} must have faces, got {len(vertices)} vertices and no face")
    if not np.isfinite(vertices).all():
        bad = int(np.count_nonzero(~np.isfinite(vertices).all(axis=1)))
        raise ArgumentValueError(f"{ref('mesh')} must have finite vertices, got {bad} with NaN or infinite coordinates")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ArgumentValueError(
            f"{ref('mesh')} must have face indices within 0 to {len(vertices) - 1} for its {len(vertices)} vertices, "
            f"got {faces.min()} to {faces.max()}"
        )
    part = _Part(
        vertices=vertices, faces=faces, source=np.arange(len(vertices)), count=len(vertices),
        normals=_own_normals(mesh, vertices, faces), uvs=_own_uvs(mesh, len(vertices)), texture=None, colours=None,
        geometries=np.zeros(len(faces), np.int32),
    )  # fmt: skip
    if colours:
        _take_colours(mesh, part)
    part.vertices = part.vertices @ transform[:3, :3].T + transform[:3, 3]
    determinant = float(np.linalg.det(transform[:3, :3]))
    if determinant < 0.0:
        part.faces = part.faces[:, ::-1]
    if part.normals is not None and determinant != 0.0:
        # Normals are multiplied by the transposed inverse of the transform, times the absolute value of its
        # determinant. For a reflection, the order of each face's corners was reversed above, so that normals remain on
        # the outside.
        part.normals = part.normals @ (np.linalg.inv(transform[:3, :3]) * abs(determinant))
    return part


def _own_normals(mesh: Any, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64] | None:
    """Return the vertex normals of the input mesh, shape (n, 3), or None if trimesh computed them.

    trimesh stores normals of the file and computed normals in the same place. To compute normals, it also computes the
    angles of faces, which its cache then contains. The cache may also contain the angles for another reason. If it
    contains them, normals count as computed only if they have the values that trimesh would compute.
    """
    normals = mesh.vertex_normals if "vertex_normals" in mesh._cache else None
    worked_out = normals is None or "face_angles" in mesh._cache
    if worked_out and _has_facets(mesh):
        facets = np.zeros(vertices.shape)
        facets[faces] = mesh.face_normals[:, None]
        return facets
    if normals is None or np.shape(normals) != vertices.shape:
        return None
    normals = np.asarray(normals, dtype=np.float64)
    normals = unit(np.where(np.isfinite(normals), normals, 0.0).T)
    if not worked_out:
        return normals.T
    corners = np.ascontiguousarray(faces.T)
    # Normals of the input are compared with computed ones at the vertices of a few faces first, and at all vertices
    # only if these agree.
    some = np.zeros(len(vertices), dtype=np.bool_)
    some[faces[:: len(faces) // 16 + 1]] = True
    for at in (some, np.ones_like(some)):
        beside = corners.compress(at.take(corners).any(axis=0), axis=1)
        computed = unit(FaceGeometry(vertices.T, beside).angle_weighted_normals(beside, len(vertices)))
        if not np.allclose(normals[:, at], computed[:, at], atol=1e-6):
            return normals.T
    return None


def _has_facets(mesh: Any) -> bool:
    """Return whether a mesh is from an unmerged STL file, which has one normal per face and no other normals."""
    source = getattr(mesh, "source", None)
    return getattr(source, "file_type", None) == "stl" and len(mesh.vertices) == 3 * len(mesh.faces)


def _own_uvs(mesh: Any, count: int) -> NDArray[np.float64] | None:
    """Return the texture coordinates of the input mesh, shape (n, 2), or None if it has none."""
    uvs = getattr(mesh.visual, "uv", None)
    if uvs is None or np.ndim(uvs) != 2 or len(uvs) != count or np.shape(uvs)[1] < 2:
        return None
    uvs = np.array(uvs[:, :2], dtype=np.float64)
    sound = np.all(np.abs(uvs) <= validation.MOST, axis=1)
    if not sound.all():
        bad = int(np.count_nonzero(~sound))
        raise ArgumentValueError(
            f"{ref('mesh')} must have finite texture coordinates, got {bad} NaN, infinite or beyond {validation.MOST:g}"
        )
    return uvs


def _take_colours(mesh: Any, part: _Part) -> None:
    """Set the texture or the vertex colours of a part. If faces have colours, vertices are duplicated for each face."""
    visual = mesh.visual
    if visual.kind == "vertex":
        part.colours = srgb_decode(np.asarray(visual.vertex_colors)[:, :3] / 255.0)
    elif visual.kind == "face":
        corner = part.faces.ravel()
        part.colours = np.repeat(srgb_decode(np.asarray(visual.face_colors)[:, :3] / 255.0), 3, axis=0)
        part.vertices, part.source = part.vertices[corner], part.source[corner]
        part.normals = None if part.normals is None else part.normals[corner]
        part.uvs = None if part.uvs is None else part.uvs[corner]
        part.faces = np.arange(len(corner)).reshape(-1, 3)
    elif hasattr(visual, "material"):
        if getattr(visual, "face_materials", None) is not None:
            raise ArgumentValueError(
                f"{ref('mesh')} must have one material per geometry, got face materials; split it by material, or bake "
                "them into one texture"
            )
        texture, colour = mesh_colours.colours_of(visual.material)
        if texture is not None and part.uvs is not None:
            part.texture = texture
        elif colour is not None:
            part.colours = np.tile(colour, (len(part.vertices), 1))


def _join(parts: list[_Part]) -> _Part:
    """Join the parts of a scene to one part.

    Missing values become NaN; colours are −1 at vertices that use the texture.
    """
    if len(parts) == 1:
        return parts[0]
    textures: list[NDArray[np.float32]] = []
    textured: list[str] = []
    for part in parts:
        if part.texture is not None and not any(np.array_equal(part.texture, known) for known in textures):
            textures.append(part.texture)
            textured.append(part.label.removeprefix(_GEOMETRY))
    if len(textures) > 1:
        raise ArgumentValueError(
            f"{ref('mesh')} must have at most one texture image, got a scene with {len(textures)}, of "
            f"{', '.join(textured)}; render its geometries one by one, or bake them into one texture"
        )
    without_uvs = [part.label for part in parts if part.uvs is None]
    vertex_start = np.cumsum([0, *(len(part.vertices) for part in parts)])
    source_start = np.cumsum([0, *(part.count for part in parts)])

    def gather(name: str, columns: int) -> NDArray[np.float64] | None:
        arrays = [getattr(part, name) for part in parts]
        if all(array is None for array in arrays):
            return None
        missing = [np.full((len(part.vertices), columns), np.nan) for part in parts]
        return np.concatenate([gap if array is None else array for array, gap in zip(arrays, missing, strict=True)])

    colours = gather("colours", 3)
    if colours is not None:
        # A part of the scene without colour and texture has no pigment, so its colour is black.
        none = [np.full(len(part.vertices), -1.0 if part.texture is not None else 0.0) for part in parts]
        colours = np.where(np.isnan(colours), np.concatenate(none)[:, None], colours)
    return _Part(
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + start for part, start in zip(parts, vertex_start[:-1], strict=True)]),
        source=np.concatenate([part.source + start for part, start in zip(parts, source_start[:-1], strict=True)]),
        count=int(source_start[-1]), normals=gather("normals", 3), uvs=gather("uvs", 2),
        texture=textures[0] if textures else None, colours=colours,
        geometries=np.repeat(np.arange(len(parts), dtype=np.int32), [len(part.faces) for part in parts]),
        label=without_uvs[0] if without_uvs else ref("mesh"),
    )  # fmt: skip


def _sphere(world: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return centre and radius of the sphere around the bounding box of positions, shape (3, n)."""
    low, high = world.min(axis=1), world.max(axis=1)
    centre = low / 2.0 + high / 2.0
    largest = float(np.max(high - centre))
    # The radius is half the diagonal of the box. Its sides are divided by the largest one, so that the squares of tiny
    # and huge lengths neither underflow nor overflow.
    radius = largest * float(np.linalg.norm((high - centre) / largest)) if largest > 0.0 else 1.0
    if not validation.LEAST <= radius <= validation.MOST:
        raise ArgumentValueError(
            f"{ref('mesh')} must have a radius of {validation.LEAST:g} to {validation.MOST:g}, got {radius:g}"
        )
    return centre, radius


def _build(part: _Part, tangents: NDArray[np.float64] | None) -> Surface:
    """Return the surface of a part: remove faces without area, compute normals and tangents, and convert to float32."""
    index, faces = compacted(part.faces.T, len(part.vertices))
    world = part.vertices.T.take(index, axis=1)
    centre, radius = _sphere(world)
    # Positions are rounded to float32 before areas are tested, because kernels use the rounded positions.
    vertices = ((world - centre[:, None]) / radius).astype(np.float32).astype(np.float64)
    geometry = FaceGeometry(vertices, faces)
    keep, geometries = geometry.has_area, part.geometries
    dropped = int(np.count_nonzero(~keep))
    if dropped == len(keep):
        raise ArgumentValueError(f"{ref('mesh')} must have a face with an area, got {dropped} without")
    if dropped:
        warn(f"{ref('mesh')}: {dropped} of {len(keep)} faces have no area and are ignored")
        used, faces = compacted(faces.compress(keep, axis=1), len(index))
        geometries = geometries[keep]
        index, vertices = index[used], vertices.take(used, axis=1)
        geometry = FaceGeometry(vertices, faces)

    uvs = None if part.uvs is None else part.uvs.T.take(index, axis=1)
    handedness = np.ones(len(index))
    if tangents is None:
        assert uvs is not None  # noqa: S101 - for mypy; refused above
        texture_geometry = TextureGeometry(uvs, faces)
        mirrored = texture_geometry.mirrored(faces, len(index))
        if mirrored.any():
            # All vertices of a face must have the same handedness. A vertex between mirrored and other faces is
            # therefore duplicated.
            used, faces = compacted(faces * 2 + mirrored, 2 * len(index))
            handedness = np.where(used % 2 == 1, -1.0, 1.0)
            used //= 2
            index, vertices, uvs = index[used], vertices.take(used, axis=1), uvs.take(used, axis=1)

    welded, order = weld(vertices)
    own = None if part.normals is None else part.normals.T.take(index, axis=1)
    normals = vertex_normals(geometry, faces, welded, own)
    if tangents is not None:
        scale = np.max(np.abs(tangents), initial=0.0)
        field = tangents.T.take(part.source[index], axis=1) / (scale if scale > 0.0 else 1.0)
        name = ref("tangents")
    else:
        field = tangents_from_uvs(geometry, texture_geometry, faces, normals)
        field = join_seams(field, welded, order, handedness)
        name = f"{ref('mesh')}'s texture coordinates"
    field = fill(unit(tangential(field, normals)), normals, faces, welded, name)

    has_colour = part.texture is not None or part.colours is not None
    texture = np.zeros((1, 1, 3), np.float32) if part.texture is None else part.texture
    colours = None if part.colours is None else part.colours[index]
    if colours is not None and np.all(colours == colours[0]) and part.texture is None:
        texture, colours = colours[:1].reshape(1, 1, 3).astype(np.float32), None
    uvs = np.zeros((2, len(index))) if uvs is None else np.nan_to_num(uvs)
    return Surface(
        vertices=vertices.T.astype(np.float32, order="C"), faces=faces.T.astype(np.int32, order="C"),
        normals=normals.T.astype(np.float32, order="C"), tangents=field.T.astype(np.float32, order="C"),
        handedness=handedness.astype(np.float32), uvs=uvs.T.astype(np.float32, order="C"), texture=texture,
        vertex_colours=None if colours is None else colours.astype(np.float32), has_base_colour=has_colour,
        geometries=geometries, is_convex=is_convex(vertices, faces, geometry.normals, welded), centre=centre,
        radius=radius,
    )  # fmt: skip


def _check_tangents(part: _Part, tangents: NDArray[np.float64] | None) -> None:
    """Check that ``tangents`` has a vector per vertex, or if it is None, that all vertices have texture coordinates."""
    if tangents is not None:
        if tangents.shape != (part.count, 3):
            raise ArgumentValueError(
                f"{ref('tangents')} must have shape ({part.count}, 3), one vector per vertex of the mesh, or (3,), "
                f"got {tangents.shape}"
            )
    elif part.uvs is None:
        raise ArgumentValueError(f"{ref('mesh')} has neither texture coordinates nor tangents; {HOW_TO_GET_TANGENTS}")
    elif np.any(np.isnan(part.uvs)):
        raise ArgumentValueError(f"{part.label} has no texture coordinates; {HOW_TO_GET_TANGENTS}")
