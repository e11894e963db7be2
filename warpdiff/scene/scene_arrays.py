"""Arrays of a whole scene in world coordinates, joined from its parts: positions, colours, names.

A part has the triangles of one geometry with one material. It is plain if it has no height field.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from warpdiff.core import validation
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, listed, ref
from warpdiff.scene import mesh_files, trimesh_parts
from warpdiff.scene.mesh_geometry import unit

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from numpy.typing import NDArray

    from warpdiff.scene.scene_parts import Appearance, ScenePart, TextureMap
    from warpdiff.scene.textures import MaterialMaps, Texture, TextureImages

_Name = TypeVar("_Name", bound="Hashable")
# Beginning of the label by which messages name a geometry of a scene. The name of the geometry follows it.
_GEOMETRY = f"{ref('mesh')}'s geometry "


@dataclass(frozen=True, eq=False)
class PartAppearance:
    """Appearance of a material on a part of a scene. It depends on the textures that can be sampled on this part.

    Attributes:
        material: Appearance of the material in the file.
        texture: Base-colour texture; None if there is none, or if the part lacks the texture's coordinates.
        cutoff: Alpha below which rays pass through faces. It is 0 for opaque faces, and negative for faces that are
            blended with their background.
        has_map_uvs: Two flags: for the texture of metallic and roughness, and for the texture of emission. A flag is
            True if the texture has an image, and the part has the texture coordinates of this texture.
    """

    material: Appearance
    texture: Texture | None
    cutoff: float
    has_map_uvs: tuple[bool, bool]

    @property
    def key(self) -> tuple[object, ...]:
        """Key for dictionaries, which is equal for equal appearances; materials of a scene have different names."""
        return self.material.name, self.texture, self.cutoff, self.has_map_uvs


@dataclass
class SceneArrays:
    """Arrays of one part of a scene, or of a whole scene, in world coordinates.

    Some vertices of the input are duplicated. For each vertex, ``source`` has the index of the input vertex, and
    ``count`` is the number of input vertices. The arrays ``geometries``, ``materials`` and ``rows`` have one index per
    face. They are indices of ``geometry_names``, ``material_names`` and ``appearances``.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    source: NDArray[np.int64]
    count: int
    normals: NDArray[np.float64] | None
    tangents: NDArray[np.float64] | None
    uvs: NDArray[np.float64] | None
    colours: NDArray[np.float64] | None
    alphas: NDArray[np.float64] | None
    geometries: NDArray[np.int32]
    geometry_names: tuple[str, ...]
    materials: NDArray[np.int32]
    material_names: tuple[str, ...]
    rows: NDArray[np.int32]
    appearances: tuple[PartAppearance, ...]
    label: str
    maps: MaterialMaps | None = None

    @property
    def is_textured(self) -> bool:
        """Whether any base colour is that of a texture."""
        return any(own.texture is not None for own in self.appearances)


def labelled_parts(mesh: Any) -> list[tuple[ScenePart, str]]:
    """Return the parts of a mesh, each with the label by which messages name it."""
    parts = mesh_files.load(mesh) if isinstance(mesh, (str, os.PathLike)) else trimesh_parts.parts_of(mesh)
    if len(parts) == 1:
        return [(parts[0], ref("mesh"))]
    return [(part, f"{_GEOMETRY}{part.geometry!r}") for part in parts]


def arrays_of(entry: ScenePart, label: str, images: TextureImages | None) -> SceneArrays:
    """Check a part of a scene and return its arrays in world coordinates. Messages of errors begin with its label.

    Args:
        entry: Part of a scene.
        label: Label for messages.
        images: Images of the scene; None computes no colours.
    """
    _check(entry, label)
    normals = None if entry.normals is None else _sound(entry.normals)
    tangents = None if entry.tangents is None else _sound(entry.tangents)
    placed = replace(entry, normals=normals, tangents=tangents).placed()
    if not np.isfinite(placed.vertices).all():
        raise ArgumentValueError(f"{label} must be placed at finite coordinates, got a transform with huge numbers")
    base_texture = None if placed.appearance is None else placed.appearance.base_texture
    uvs = uvs_at(placed, base_texture, label)
    part = SceneArrays(
        vertices=placed.vertices, faces=placed.faces, source=placed.source, count=placed.source_count,
        normals=placed.normals, tangents=placed.tangents, uvs=uvs, colours=None, alphas=None,
        geometries=np.zeros(len(placed.faces), np.int32), geometry_names=(placed.geometry or mesh_files.UNNAMED,),
        materials=np.full(len(placed.faces), -1 if placed.appearance is None else 0, np.int32),
        material_names=() if placed.appearance is None else (placed.appearance.name,),
        rows=np.full(len(placed.faces), -1 if placed.appearance is None else 0, np.int32),
        appearances=() if placed.appearance is None else (_of_part(placed, placed.appearance, None, 0.0),), label=label,
    )  # fmt: skip
    if images is not None:
        _take_colours(placed, part, images)
    return part


def _check(entry: ScenePart, label: str) -> None:
    """Check the positions and faces of a part of a scene."""
    vertices, faces = entry.vertices, entry.faces
    if vertices.shape[1:] != (3,):
        raise ArgumentValueError(
            f"{label} must have vertices of 3 coordinates, shape (n, 3), got {vertices.shape}; a file may be truncated"
        )
    if len(vertices) == 0:
        raise ArgumentValueError(f"{label} must have vertices, got none")
    if len(faces) == 0:
        raise ArgumentValueError(f"{label} must have faces, got {len(vertices)} vertices and no face")
    if not np.isfinite(vertices).all():
        bad = int(np.count_nonzero(~np.isfinite(vertices).all(axis=1)))
        raise ArgumentValueError(f"{label} must have finite vertices, got {bad} with NaN or infinite coordinates")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ArgumentValueError(
            f"{label} must have face indices within 0 to {len(vertices) - 1} for its {len(vertices)} vertices, "
            f"got {faces.min()} to {faces.max()}"
        )


def _sound(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return normals, or tangents with their handedness, as unit vectors; vectors that are not finite become zero."""
    result = np.where(np.isfinite(vectors), vectors, 0.0)
    result[:, :3] = unit(result[:, :3].T).T
    return np.asarray(result)


def _of_part(part: ScenePart, material: Appearance, texture: Texture | None, cutoff: float) -> PartAppearance:
    """Return the appearance of a material on a part of the scene."""
    of_roughness, of_emission = (
        source is not None and source.image is not None and source.uv_set in part.uvs
        for source in (material.metallic_roughness_texture, material.emission_texture)
    )
    return PartAppearance(material, texture, cutoff, (of_roughness, of_emission))


def uvs_at(part: ScenePart, texture: TextureMap | None, label: str) -> NDArray[np.float64] | None:
    """Return the coordinates at which a texture is sampled, shape (n, 2); None if the part lacks them.

    Args:
        part: Part of a scene.
        texture: The texture. None stands for the first texture coordinates without a transform.
        label: Label of the part for messages.
    """
    uvs = part.uvs.get(0 if texture is None else texture.uv_set)
    if uvs is None:
        return None
    if texture is not None and not np.array_equal(texture.transform, np.eye(2, 3)):
        with np.errstate(all="ignore"):  # coordinates that are not finite are refused below
            uvs = uvs @ texture.transform[:, :2].T + texture.transform[:, 2]
    sound = np.all(np.abs(uvs) <= validation.MOST, axis=1)
    if not sound.all():
        bad = int(np.count_nonzero(~sound))
        raise ArgumentValueError(
            f"{label} must have finite texture coordinates, got {bad} NaN, infinite or beyond {validation.MOST:g}"
        )
    return uvs


def _take_colours(entry: ScenePart, part: SceneArrays, images: TextureImages) -> None:
    """Set the texture or the vertex colours of a part, and its transparency."""
    appearance = entry.appearance
    colour = None if appearance is None else appearance.base_colour
    if appearance is not None and appearance.base_texture is not None:
        source = appearance.base_texture
        if source.image is not None and part.uvs is not None:
            texture = images.texture(source, (1.0,) * 4 if colour is None else colour)
            if texture is not None:
                cutoff = _cutoff(appearance, float(texture.texels[..., 3].min()))
                part.appearances = (_of_part(entry, appearance, texture, cutoff),)
                return
        colour = appearance.fallback_colour or colour if source.image is not None else colour
    alphas = np.full(len(part.vertices), 1.0 if colour is None else colour[3])
    if entry.colours is not None:
        part.colours = entry.colours[:, :3] if colour is None else entry.colours[:, :3] * np.array(colour[:3])
        alphas *= entry.colours[:, 3]
    elif colour is not None:
        part.colours = np.tile(np.array(colour[:3]), (len(part.vertices), 1))
    if appearance is not None:
        cutoff = _cutoff(appearance, float(alphas.min()))
        part.appearances = (_of_part(entry, appearance, None, cutoff),)
        part.alphas = alphas if cutoff else None


def _cutoff(appearance: Appearance, least: float) -> float:
    """Return the alpha below which rays pass through a part; see :class:`PartAppearance`.

    The result is 0 (opaque) if no alpha of the part is small enough to make it transparent. ``least`` is the smallest
    alpha of the part.
    """
    if appearance.alpha_mode == "opaque":
        return 0.0
    if appearance.alpha_mode == "blend":
        return -1.0 if least < 1.0 else 0.0
    return appearance.alpha_cutoff if least < appearance.alpha_cutoff else 0.0


def warn_of_features(parts: list[ScenePart], not_sampled: Mapping[str, Sequence[str]]) -> None:
    """Warn once of the features of the scene's materials that have no effect on pictures.

    Args:
        parts: Parts of the scene.
        not_sampled: Texts about textures that cannot be sampled, by the names of materials.
    """
    features: dict[str, dict[str, None]] = {}
    for part in parts:
        if part.appearance is None:
            continue
        names = dict.fromkeys([*part.appearance.not_rendered, *not_sampled.get(part.appearance.name, ())])
        texture = part.appearance.base_texture
        if texture is not None and texture.image is not None:
            if texture.uv_set not in part.uvs:
                names["texture without texture coordinates"] = None
            elif part.colours is not None:
                names["vertex colours on a texture"] = None
        if names:
            features.setdefault(part.appearance.name, {}).update(names)
    if features:
        texts = [f"{', '.join(names)} of {name!r}" for name, names in features.items()]
        listing = listed(texts, "; ", "; and of {} more")
        warn(f"{ref('mesh')} has materials with features that are not rendered: {listing}")


def joined(parts: list[SceneArrays]) -> SceneArrays:
    """Join the parts of a scene to one part.

    Missing values become NaN. Colours become −1 at vertices whose base colour is that of a texture.
    """
    if len(parts) == 1:
        return parts[0]
    geometry_names, geometries = _joined_names([(part.geometry_names, part.geometries) for part in parts])
    material_names, materials = _joined_names([(part.material_names, part.materials) for part in parts])
    appearances = {own.key: own for part in parts for own in part.appearances}
    _, rows = _joined_names([(tuple(own.key for own in part.appearances), part.rows) for part in parts])
    vertex_start = np.cumsum([0, *(len(part.vertices) for part in parts)])
    source_start = np.cumsum([0, *(part.count for part in parts)])

    def gather(name: str, columns: int) -> NDArray[np.float64] | None:
        arrays = [getattr(part, name) for part in parts]
        if all(array is None for array in arrays):
            return None
        return np.concatenate(
            [
                np.full((len(part.vertices), columns), np.nan) if array is None else array
                for array, part in zip(arrays, parts, strict=True)
            ]
        )

    colours = None
    textured = [part.is_textured for part in parts]
    if any(part.colours is not None for part in parts) or (any(textured) and not all(textured)):
        colours = np.concatenate(
            [
                np.full((len(part.vertices), 3), -1.0 if part.is_textured else np.nan)
                if part.colours is None
                else part.colours
                for part in parts
            ]
        )
    alphas = None
    if any(part.alphas is not None for part in parts):
        ones = [np.ones(len(part.vertices)) if part.alphas is None else part.alphas for part in parts]
        alphas = np.concatenate(ones)
    return SceneArrays(
        vertices=np.concatenate([part.vertices for part in parts]),
        faces=np.concatenate([part.faces + start for part, start in zip(parts, vertex_start[:-1], strict=True)]),
        source=np.concatenate([part.source + start for part, start in zip(parts, source_start[:-1], strict=True)]),
        count=int(source_start[-1]), normals=gather("normals", 3), tangents=gather("tangents", 4),
        uvs=gather("uvs", 2), colours=colours, alphas=alphas, geometries=geometries,
        geometry_names=geometry_names, materials=materials, material_names=material_names, rows=rows,
        appearances=tuple(appearances.values()), label=ref("mesh"),
    )  # fmt: skip


def with_missing_colours(scene: SceneArrays, is_plain: NDArray[np.bool_]) -> SceneArrays:
    """Return a scene with a colour at each vertex, if any vertex has a colour or a texture.

    Parts without a colour get the colour that changes nothing: white for plain parts, and black for parts with a height
    field. The base colour of a part with a height field is that of the pigment under the relief, and a black pigment
    reflects no light.

    Args:
        scene: Joined parts of a scene.
        is_plain: Whether the part of each face is plain, shape (m,).
    """
    if scene.colours is None:
        return scene
    white = np.zeros((len(scene.vertices), 1))
    white[scene.faces[is_plain]] = 1.0
    return replace(scene, colours=np.where(np.isnan(scene.colours), white, scene.colours))


def _joined_names(
    parts: list[tuple[tuple[_Name, ...], NDArray[np.int32]]],
) -> tuple[tuple[_Name, ...], NDArray[np.int32]]:
    """Return the distinct names of all parts, and for each face the index of its name; −1 (no name) is unchanged."""
    numbers: dict[_Name, int] = {}
    joined = []
    for names, indices in parts:
        table = np.array([*(numbers.setdefault(name, len(numbers)) for name in names), -1], dtype=np.int32)
        joined.append(table[indices])
    return tuple(numbers), np.concatenate(joined)
