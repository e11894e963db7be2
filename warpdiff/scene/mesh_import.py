"""Import of triangle meshes: normals, tangents and base colours at the vertices.

Every mesh becomes a :class:`Surface` of float32 arrays. Faces without area and vertices without a face are removed. A
part of a mesh, which has one geometry and one material, is plain if it has no height field.
"""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import forks, validation
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref
from warpdiff.request.settings import TANGENT_RULES, TangentRule, check_tangents
from warpdiff.scene.direction_fields import Body, direction_field
from warpdiff.scene.material_factors import checked_parts, factors_of, warn_of_hidden_emission
from warpdiff.scene.material_maps import NotSampled, maps_of
from warpdiff.scene.mesh_files import UNNAMED
from warpdiff.scene.mesh_geometry import (
    FaceGeometry,
    TextureGeometry,
    compacted,
    dot,
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
from warpdiff.scene.part_names import key_of_faces
from warpdiff.scene.scene_arrays import (
    SceneArrays,
    arrays_of,
    joined,
    labelled_parts,
    warn_of_features,
    with_missing_colours,
)
from warpdiff.scene.textures import TextureImages

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import trimesh
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.scene.material_factors import MaterialFactors
    from warpdiff.scene.scene_parts import ScenePart
    from warpdiff.scene.textures import MaterialMaps, Texture

# Remedy in the messages about a mesh that has neither tangents nor texture coordinates.
HOW_TO_GET_TANGENTS = (
    f"give {ref('tangents', 'smooth')}, another rule ({', '.join(TANGENT_RULES[:-1])}) or directions of the height "
    "field's x axis, one for all or one per vertex, or a mesh with texture coordinates, whose u axis is then the "
    "direction"
)
# An edge counts as sharp if the cosine of the angle between its faces is below this number. It is the cosine of 40°,
# which was chosen because the faces of round bodies meet at smaller angles.
_SHARP_COSINE = float(np.cos(np.radians(40.0)))


@dataclass(frozen=True, eq=False)
class Surface:
    """Prepared mesh of n vertices and m faces; every face has an area, and every vertex belongs to a face.

    Attributes:
        vertices: Positions in the unit sphere, (world − ``centre``) / ``radius``, shape (n, 3), float32.
        faces: Vertex indices, counter-clockwise as viewed from the front, shape (m, 3), int32.
        normals: Unit vertex normals, shape (n, 3), float32; zero where no direction is defined.
        tangents: Unit vectors along the height field's x axis, perpendicular to the normals, shape (n, 3), float32;
            zero at a vertex between opposite directions (a pole), but not at all corners of a face.
        handedness: −1 where the texture mapping is mirrored, else 1, shape (n,), float32; equal for all vertices of a
            face.
        uvs: Texture coordinates, v upwards, shape (n, 2), float32; zero where undefined.
        lacks_uvs: Whether a corner of each face has no texture coordinates, shape (m,); None if all corners have them.
        plain_colour: Linear RGB of a uniform colour, shape (3,), float32; black without colour, −1 with textures.
        vertex_colours: Linear RGB, shape (n, 3), float32; negative at vertices whose base colour is that of a texture.
            None if the colour is uniform, or that of textures at all vertices.
        has_base_colour: Whether the input mesh has a colour of any kind.
        geometries: For each face, the index of its geometry in ``geometry_names``, shape (m,), int32.
        geometry_names: Names of the geometries, which all differ; "mesh 0" for a single mesh without a name.
        materials: For each face, the index of its material in ``material_names``, shape (m,), int32; −1 without one.
        material_names: Names of the materials, which all differ.
        rows: For each face, the index of its row in ``material_factors``, ``textures``, ``alpha_cutoffs`` and ``maps``,
            shape (m,), int32; −1 without a material. A material has several rows if only some of its faces have texture
            coordinates or transparency.
        material_factors: Metallic, roughness and emission by row; None if all are matte and emit no light.
        textures: Base-colour texture of each row; None without one.
        alpha_cutoffs: Alpha below which rays pass through a face, by row; 0 for opaque faces, and negative for faces
            that are mixed with their background.
        vertex_alphas: Alpha at the vertices, shape (n,), float32, which is 1 where a texture has the alpha; None if it
            is 1 at all vertices.
        maps: Textures of metallic, roughness and emission of parts without a height field; None if there are none.
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
    plain_colour: NDArray[np.float32]
    vertex_colours: NDArray[np.float32] | None
    has_base_colour: bool
    geometries: NDArray[np.int32]
    materials: NDArray[np.int32]
    rows: NDArray[np.int32]
    is_convex: bool
    centre: NDArray[np.float64]
    radius: float
    geometry_names: tuple[str, ...] = (UNNAMED,)
    material_names: tuple[str, ...] = ()
    material_factors: MaterialFactors | None = None
    textures: tuple[Texture | None, ...] = ()
    alpha_cutoffs: tuple[float, ...] = ()
    vertex_alphas: NDArray[np.float32] | None = None
    maps: MaterialMaps | None = None
    lacks_uvs: NDArray[np.bool_] | None = None

    @property
    def is_textured(self) -> bool:
        """Whether any base colour is that of a texture."""
        return any(texture is not None for texture in self.textures)

    @property
    def has_maps(self) -> bool:
        """Whether any face without a height field has a texture of metallic, roughness or emission."""
        return self.maps is not None

    @property
    def is_opaque(self) -> bool:
        """Whether every ray stops at the first face that it hits, because no face is transparent."""
        return not any(self.alpha_cutoffs)

    @forks.cached_property
    def is_closed(self) -> bool:
        """Whether the mesh bounds bodies, each with outward normals."""
        return is_closed(self.vertices.T.astype(np.float64), self.faces.T)


def prepare_surface(
    mesh: trimesh.Trimesh | trimesh.Scene | Surface | str | os.PathLike[str], *,
    tangents: TangentRule | ArrayLike | None = None, plain: Mapping[str, bool] | None = None,
) -> Surface:  # fmt: skip
    """Check a mesh and compute its normals, tangents and base colours.

    If the input has a normal at a vertex, this normal is used. Other normals are means over all faces that meet at a
    position, weighted by angle, so that texture seams are invisible. STL files, and glTF meshes without normals, have
    one normal per face. ``copy()`` of trimesh drops the normals of a mesh; ``copy(include_cache=True)`` keeps them.
    Tangents are ``tangents``, or those of a glTF file, or the derivatives ∂P/∂u of the position by the first texture
    coordinate of the base colour. They are averaged across seams where their directions differ by less than 30°.

    Args:
        mesh: A ``trimesh.Trimesh``, a ``trimesh.Scene`` (its transforms apply) or the path of a mesh file. trimesh
            merges vertices of a mesh that is built or loaded without ``process=False``. A :class:`Surface` is returned
            unchanged.
        tangents: Directions of the height field's x axis, world frame, of any length and not necessarily tangential.
            The shape (n, 3) has one direction per vertex, for a scene in the order of its nodes. The shape (3,) is one
            direction for all vertices. A text is a rule of :mod:`warpdiff.scene.direction_fields`. None takes the
            directions from the texture coordinates.
        plain: For each key that names a part of the mesh, whether the part is plain (has no height field). Plain parts
            need no tangents. None means that no part is plain.

    Returns:
        The surface.

    Raises:
        FileNotFoundError: The file does not exist.
        TypeError: ``mesh`` is of another type.
        ValueError: The file cannot be read; the mesh has no vertices, faces or area, is not finite, or its faces have
            indices without a vertex; there are neither tangents nor texture coordinates.
        MemoryError: A texture requires more memory than is free.
    """
    if isinstance(mesh, Surface) and tangents is None:
        return mesh
    field = _checked_field(tangents)
    with _naming_file(mesh):
        entries, labels = zip(*labelled_parts(mesh), strict=True)
        scene = [*zip(checked_parts(entries), labels, strict=True)]
        with single_threaded_blas():
            images = TextureImages()
            part = joined([arrays_of(entry, label, images) for entry, label in scene])
            if isinstance(field, np.ndarray) and field.shape == (3,):
                field = np.broadcast_to(field, (part.count, 3))
            roles = _FaceRoles.of([entry for entry, _ in scene], part, plain)
            _check_tangents(part, field, roles.is_plain)
            part = with_missing_colours(part, roles.is_plain)
            part = replace(part, maps=maps_of(scene, part, roles.is_plain, images))
            surface = _build(part, field, roles, in_memory=not isinstance(mesh, (str, os.PathLike)))
        not_sampled = NotSampled.of(part, roles.is_plain, part.maps)
        warn_of_features([entry for entry, _ in scene], not_sampled.features(part.appearances))
        factors = factors_of(part.appearances, not_sampled)
        if factors is not None:
            names = [own.material.name for own in part.appearances]
            warn_of_hidden_emission(factors, part.rows[~roles.is_plain], names)
        return replace(surface, material_factors=factors)


def normalised_positions(
    mesh: trimesh.Trimesh | trimesh.Scene | Surface | str | os.PathLike[str],
) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
    """Return ``centre``, ``radius`` and ``vertices`` as in :class:`Surface`, without computing the other attributes."""
    if isinstance(mesh, Surface):
        return mesh.centre, mesh.radius, mesh.vertices.astype(np.float64)
    with _naming_file(mesh), single_threaded_blas():
        part = joined([arrays_of(entry, label, None) for entry, label in labelled_parts(mesh)])
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


def _sphere(world: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return centre and radius of the sphere around the bounding box of positions, shape (3, n)."""
    low, high = world.min(axis=1), world.max(axis=1)
    centre = low / 2.0 + high / 2.0
    largest = float(np.max(high - centre))
    # The radius is half of the diagonal of the box. The sides of the box are divided by the largest side before they
    # are squared, so that the squares of tiny and huge lengths neither underflow nor overflow.
    radius = largest * float(np.linalg.norm((high - centre) / largest)) if largest > 0.0 else 1.0
    if not validation.LEAST <= radius <= validation.MOST:
        raise ArgumentValueError(
            f"{ref('mesh')} must have a radius of {validation.LEAST:g} to {validation.MOST:g}, got {radius:g}"
        )
    return centre, radius


@dataclass(frozen=True, eq=False)
class _FaceRoles:
    """Properties of the faces of a scene that determine how their tangents are computed.

    Attributes:
        is_plain: Whether each face has no height field and needs no tangents, shape (m,).
        objects: Number of the object of each face, shape (m,). An object is one geometry at one place.
    """

    is_plain: NDArray[np.bool_]
    objects: NDArray[np.int64]

    @classmethod
    def of(cls, scene: list[ScenePart], part: SceneArrays, plain: Mapping[str, bool] | None) -> _FaceRoles:
        """Return the properties of the faces of a scene, whose parts have been joined to ``part``."""
        is_plain = np.zeros(len(part.faces), np.bool_)
        if plain is not None:
            is_plain = np.array(list(plain.values()))[key_of_faces(part, list(plain), "heightfield")]
        numbers: dict[tuple[str, bytes], int] = {}
        objects = [numbers.setdefault((entry.geometry, entry.transform.tobytes()), len(numbers)) for entry in scene]
        return cls(is_plain, np.repeat(objects, [len(entry.faces) for entry in scene]))

    def kept(self, keep: NDArray[np.bool_]) -> _FaceRoles:
        """Return the properties of the faces that the mask ``keep`` selects."""
        return _FaceRoles(self.is_plain[keep], self.objects[keep])


def _build(
    part: SceneArrays, tangents: TangentRule | NDArray[np.float64] | None, roles: _FaceRoles, *, in_memory: bool
) -> Surface:
    """Return the surface of a scene, whose parts have been joined to ``part``.

    Faces without area are removed, normals and tangents are computed, and arrays are converted to float32.
    """
    index, faces = compacted(part.faces.T, len(part.vertices))
    world = part.vertices.T.take(index, axis=1)
    centre, radius = _sphere(world)
    # Positions are rounded to float32 before areas are tested, because kernels use the rounded positions.
    vertices = ((world - centre[:, None]) / radius).astype(np.float32).astype(np.float64)
    geometry = FaceGeometry(vertices, faces)
    keep, geometries, materials, rows = geometry.has_area, part.geometries, part.materials, part.rows
    dropped = int(np.count_nonzero(~keep))
    if dropped == len(keep):
        raise ArgumentValueError(f"{ref('mesh')} must have a face with an area, got {dropped} without")
    if dropped:
        warn(f"{ref('mesh')}: {dropped} of {len(keep)} faces have no area and are ignored")
        used, faces = compacted(faces.compress(keep, axis=1), len(index))
        geometries, materials, rows, roles = geometries[keep], materials[keep], rows[keep], roles.kept(keep)
        index, vertices = index[used], vertices.take(used, axis=1)
        geometry = FaceGeometry(vertices, faces)

    uvs, lacks_uvs = _texture_coordinates(part, index, faces)
    handedness = np.ones(len(index))
    if tangents is None:
        texture_geometry = TextureGeometry(uvs, faces)
        mirrored = texture_geometry.mirrored(faces, len(index))
        if part.tangents is not None:
            mirrored = _mirrored(np.nan_to_num(part.tangents.T.take(index, axis=1)), faces, mirrored)
        if mirrored.any():
            # All vertices of a face must have the same handedness. A vertex between mirrored and other faces is
            # therefore duplicated.
            used, faces = compacted(faces * 2 + mirrored, 2 * len(index))
            handedness = np.where(used % 2 == 1, -1.0, 1.0)
            used //= 2
            index, vertices, uvs = index[used], vertices.take(used, axis=1), uvs.take(used, axis=1)

    welded, order = weld(vertices)
    own = None if part.normals is None else part.normals.T.take(index, axis=1)
    if in_memory:
        _warn_of_lost_normals(_equal_but_for_normals(part, index, own, welded, order), geometry, faces, welded)
    normals = vertex_normals(geometry, faces, welded, own)
    body = Body(vertices, faces, normals, welded, roles.objects, ~roles.is_plain)
    if tangents is not None:
        field = _explicit_field(tangents, body, part.source[index])
        name = ref("tangents", tangents) if isinstance(tangents, str) else ref("tangents")
    else:
        field = tangents_from_uvs(geometry, texture_geometry, faces, normals)
        field = join_seams(field, welded, order, handedness)
        if part.tangents is not None:
            in_file = np.nan_to_num(part.tangents.T.take(index, axis=1)[:3])
            field = np.where(in_file.any(axis=0), in_file, field)
        name = f"{ref('mesh')}'s texture coordinates"
    field = fill(
        unit(tangential(field, normals)), normals, faces, welded, body.needs_directions, name,
        has_poles=isinstance(tangents, str),
    )  # fmt: skip

    single_uvs = uvs.T.astype(np.float32, order="C")
    colours = None if part.colours is None else part.colours[index]
    plain = np.full(3, -1.0 if part.is_textured else 0.0)
    if colours is not None and np.all(colours == colours[0]) and not part.is_textured:
        plain, colours = colours[0], None
    return Surface(
        vertices=vertices.T.astype(np.float32, order="C"), faces=faces.T.astype(np.int32, order="C"),
        normals=normals.T.astype(np.float32, order="C"), tangents=field.T.astype(np.float32, order="C"),
        handedness=handedness.astype(np.float32), uvs=single_uvs,
        plain_colour=plain.astype(np.float32), vertex_colours=None if colours is None else colours.astype(np.float32),
        has_base_colour=part.is_textured or part.colours is not None,
        geometries=geometries, materials=materials, rows=rows,
        is_convex=is_convex(vertices, faces, geometry.normals, welded), centre=centre, radius=radius,
        geometry_names=part.geometry_names, material_names=part.material_names,
        textures=tuple(own.texture for own in part.appearances),
        alpha_cutoffs=tuple(own.cutoff for own in part.appearances),
        vertex_alphas=None if part.alphas is None else part.alphas[index].astype(np.float32),
        maps=None if part.maps is None else part.maps.at(index, single_uvs),
        lacks_uvs=lacks_uvs,
    )  # fmt: skip


def _texture_coordinates(
    part: SceneArrays, index: NDArray[np.int64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_] | None]:
    """Return the texture coordinates at vertices, 0 where undefined, and whether they are undefined at a face's corner.

    The second result is a mask of faces; None if all corners have texture coordinates. ``index`` has the index of each
    vertex in the arrays of ``part``.
    """
    if part.uvs is None:
        return np.zeros((2, len(index))), np.ones(faces.shape[1], dtype=np.bool_)
    uvs = part.uvs.T.take(index, axis=1)
    lacks: NDArray[np.bool_] = np.asarray(np.asarray(np.isnan(uvs).any(axis=0))[faces].any(axis=0))
    return np.nan_to_num(uvs), lacks if lacks.any() else None


def _explicit_field(
    tangents: TangentRule | NDArray[np.float64], body: Body, source: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return directions at the body's vertices: by a rule such as "around-x", or from the array of the input mesh."""
    if isinstance(tangents, str):
        return direction_field(tangents, body)
    scale = np.max(np.abs(tangents), initial=0.0)
    return np.asarray(tangents.T.take(source, axis=1) / (scale if scale > 0.0 else 1.0))


def _mirrored(tangents: NDArray[np.float64], faces: NDArray[np.int64], by_uvs: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether the texture is mirrored on each face: by the tangents of its corners if the file has them.

    Args:
        tangents: Tangents and handedness of the file, shape (4, n); zero where the file has none.
        faces: Vertex indices, shape (3, m).
        by_uvs: Whether the texture coordinates of each face are mirrored, shape (m,).
    """
    is_stated = np.asarray(tangents[:3].any(axis=0))[faces].all(axis=0)
    sides = np.sign(tangents[3])[faces].sum(axis=0)
    return np.asarray(np.where(is_stated & (sides != 0.0), sides < 0.0, by_uvs))


def _equal_but_for_normals(
    part: SceneArrays, index: NDArray[np.int64], own: NDArray[np.float64] | None, welded: NDArray[np.int64],
    order: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:  # fmt: skip
    """Return pairs of vertices without normals that have the same position, texture coordinates and colour.

    Args:
        part: Scene.
        index: Index of each vertex in the arrays of ``part``.
        own: Normals of the input, shape (3, n), NaN where the input has none; None if it has no normals.
        welded: Index of each vertex's position; vertices at one position have the same index.
        order: Indices of the vertices in the order of the indices in ``welded``.
    """
    one, two = order[:-1], order[1:]
    alike = np.asarray(welded[one] == welded[two]) & (part.source[index[one]] != part.source[index[two]])
    geometry = np.zeros(len(part.vertices), np.int32)
    geometry[part.faces] = part.geometries[:, None]
    for values in (geometry[:, None], part.uvs, part.colours):
        if values is not None:
            at_vertices = np.nan_to_num(values)[index]
            alike &= np.all(at_vertices[one] == at_vertices[two], axis=1)
    if own is not None:
        missing = np.asarray(np.isnan(own).any(axis=0))
        alike &= missing[one] & missing[two]
    return one[alike], two[alike]


def _warn_of_lost_normals(
    alike: tuple[NDArray[np.int64], NDArray[np.int64]], geometry: FaceGeometry, faces: NDArray[np.int64],
    welded: NDArray[np.int64],
) -> None:  # fmt: skip
    """Warn if faces at sharp edges have separate but equal vertices, so that normals were probably lost.

    Args:
        alike: Pairs of vertices that are equal in everything except their normals.
        geometry: Normals of faces.
        faces: Vertex indices, shape (3, m).
        welded: Index of each vertex's position; vertices at one position have the same index.
    """
    is_alike = np.zeros(len(welded), np.bool_)
    is_alike[alike[0]] = is_alike[alike[1]] = True
    start, end = faces.ravel(), faces[[1, 2, 0]].ravel()
    chosen = np.flatnonzero(is_alike[start] & is_alike[end])
    if not len(chosen):
        return
    start, end, face = start[chosen], end[chosen], chosen % faces.shape[1]
    count = int(welded.max()) + 1
    edges = welded[start] * count + welded[end]
    opposite = welded[end] * count + welded[start]
    order = np.argsort(edges)
    other = order[np.searchsorted(edges, opposite, sorter=order).clip(max=len(edges) - 1)]
    is_split = np.asarray(edges[other] == opposite) & (start != end[other]) & (end != start[other])
    cosines = dot(geometry.normals.take(face, axis=1), geometry.normals.take(face[other], axis=1))
    # The two sides of a thin sheet have opposite normals. Their vertices are separate on purpose and do not count.
    is_split &= np.abs(cosines) < _SHARP_COSINE
    if split := int(np.count_nonzero(is_split)) // 2:
        warn(
            f"{ref('mesh')} has no normals, but separate vertices at {split} sharp edges, which become smooth. "
            "copy() of trimesh drops normals: use copy(include_cache=True)"
        )


def _checked_field(tangents: TangentRule | ArrayLike | None) -> Any:
    """Return ``tangents`` as a rule, a float64 array or None."""
    if tangents is None or isinstance(tangents, str):
        return check_tangents(tangents)
    try:
        return validation.finite_array(tangents, "tangents")
    except ArgumentTypeError:
        raise ArgumentTypeError(
            f"{ref('tangents')} must be an array of real numbers, or one of {', '.join(map(repr, TANGENT_RULES))}, got "
            f"{validation.described(tangents)}"
        ) from None


def _check_tangents(part: SceneArrays, tangents: Any, is_plain: NDArray[np.bool_]) -> None:
    """Check that an array of tangents has one vector per vertex; without tangents, require texture coordinates."""
    if isinstance(tangents, np.ndarray) and tangents.shape != (part.count, 3):
        raise ArgumentValueError(
            f"{ref('tangents')} must have shape ({part.count}, 3), one vector per vertex of the mesh, or (3,), "
            f"got {tangents.shape}"
        )
    if tangents is not None or is_plain.all():
        return
    if part.uvs is None and part.tangents is None:
        raise ArgumentValueError(f"{ref('mesh')} has neither texture coordinates nor tangents; {HOW_TO_GET_TANGENTS}")
    missing = np.ones(len(part.vertices), np.bool_)
    for values in (part.uvs, part.tangents):
        if values is not None:
            missing &= np.isnan(values).any(axis=1)
    if (faces := np.flatnonzero(missing[part.faces].any(axis=1) & ~is_plain)).size:
        name = part.geometry_names[part.geometries[faces[0]]]
        raise ArgumentValueError(f"{ref('mesh')}'s geometry {name!r} has no texture coordinates; {HOW_TO_GET_TANGENTS}")
