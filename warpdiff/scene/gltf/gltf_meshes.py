"""Primitives of glTF meshes: triangles, strips and fans with their attributes."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.scene.gltf import gltf_draco
from warpdiff.scene.gltf.gltf_values import refuse
from warpdiff.scene.scene_parts import Appearance, ScenePart, unique_names

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.scene.gltf.gltf_accessors import Accessors
    from warpdiff.scene.gltf.gltf_buffers import Container
    from warpdiff.scene.gltf.gltf_materials import Materials
    from warpdiff.scene.gltf.gltf_values import Element

# Measured peak memory while a mesh without normals is read and prepared [bytes per corner of a triangle]; a mesh with
# normals requires 160. If doubled, meshes that would fit are refused.
BYTES_PER_CORNER = 540.0
# Numbers in glTF files of the primitive modes that are read: list, strip and fan of triangles.
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_UV_SET = re.compile(r"TEXCOORD_([0-7])")


class Meshes:
    """Meshes of a glTF file. Primitives are read when they are first used.

    Attributes:
        names: Names of the meshes, which all differ.
        not_read: Texts that name features of meshes that are not read, such as points and lines.
    """

    def __init__(self, container: Container, accessors: Accessors, materials: Materials) -> None:
        """Store the container, the accessors and the materials of a glTF file. Meshes are read from them later."""
        self._container, self._accessors, self._materials = container, accessors, materials
        self._elements = container.root.elements("meshes")
        self._parts: dict[tuple[int, tuple[float, ...]], list[ScenePart]] = {}
        self.names = unique_names((mesh.text("name") for mesh in self._elements), "mesh")
        self.not_read: dict[str, None] = {}

    def __len__(self) -> int:
        return len(self._elements)

    def size(self, index: int) -> int:
        """Return the largest possible number of corners of a mesh's triangles, from the JSON of the file alone."""
        corners = 0
        for primitive in self._elements[index].elements("primitives"):
            accessor = primitive.index("indices", len(self._accessors))
            if accessor is None:
                accessor = primitive.stated_element("attributes").index("POSITION", len(self._accessors))
            if accessor is not None:
                mode = primitive.integer("mode", _TRIANGLES, most=_FAN)
                corners += self._accessors.count(accessor, BYTES_PER_CORNER) * (1 if mode == _TRIANGLES else 3)
        return corners

    def parts(self, index: int, node_weights: list[float] | None) -> list[ScenePart]:
        """Return the triangles of a mesh, in its own coordinates.

        Args:
            index: Index of the mesh.
            node_weights: Weights of morph targets of the node that places the mesh; None uses those of the mesh.
        """
        mesh = self._elements[index]
        primitives = mesh.elements("primitives")
        targets = max((len(primitive.elements("targets")) for primitive in primitives), default=0)
        weights = [0.0] * targets
        if targets:
            weights = mesh.numbers("weights", weights) if node_weights is None else node_weights
            self.not_read[f"morph targets of mesh {self.names[index]!r} apart from their default weights"] = None
        key = (index, tuple(weights))
        if key not in self._parts:
            parts = (self._part(index, primitive, weights) for primitive in primitives)
            self._parts[key] = [part for part in parts if part is not None]
        return self._parts[key]

    def _part(self, index: int, primitive: Element, weights: list[float]) -> ScenePart | None:
        """Return the triangles of a primitive, or None if it has none."""
        numbers = primitive.stated_element("attributes")
        attributes = {name: numbers.integer(name, most=len(self._accessors) - 1) for name in numbers.values}
        mode = primitive.integer("mode", _TRIANGLES, most=_FAN)
        if mode < _TRIANGLES:
            self.not_read[f"points or lines of mesh {self.names[index]!r}"] = None
            return None
        if "POSITION" not in attributes:
            self.not_read[f"a primitive without positions in mesh {self.names[index]!r}"] = None
            return None
        if primitive.extension("KHR_materials_variants") is not None:
            self.not_read[f"variants of the materials of mesh {self.names[index]!r}"] = None
        compressed = primitive.extension(gltf_draco.EXTENSION)
        corners: NDArray[np.int64] | None = None
        values: dict[str, NDArray[np.float64]] = {}
        if compressed is not None:
            read = {name: accessor for name, accessor in attributes.items() if _widths(name)}
            corners, values = gltf_draco.decoded_primitive(compressed, read, self._container, self._accessors)
            mode = _TRIANGLES
        for name, accessor in attributes.items():
            if name not in values and (widths := _widths(name)):
                values[name] = self._accessors.vectors(accessor, widths, normalise=name.startswith("COLOR"))
        self._add_morph_targets(primitive, values, weights)
        count = len(values["POSITION"])
        for name, array in values.items():
            if len(array) != count or array.shape[1] not in _widths(name):
                refuse(numbers.where(name), f"must have {count} vectors, as POSITION has, got shape {array.shape}")
        if corners is None:
            number = primitive.index("indices", len(self._accessors))
            corners = np.arange(count) if number is None else self._accessors.indices(number)
        if len(corners) and not 0 <= corners.min() <= corners.max() < count:
            refuse(primitive.where("indices"), f"must be from 0 to {count - 1}, got {corners.min()} to {corners.max()}")
        faces = _faces(corners, mode)
        if not len(faces):
            return None
        part = ScenePart(
            geometry=self.names[index], appearance=self._appearance(index, primitive, values),
            vertices=values["POSITION"], faces=faces, source=np.arange(count), source_count=count,
            normals=values.get("NORMAL"), tangents=values.get("TANGENT"),
            uvs={
                int(match[1]): np.stack([uvs[:, 0], 1.0 - uvs[:, 1]], axis=1)
                for name, uvs in values.items()
                if (match := _UV_SET.fullmatch(name))
            },
            colours=_with_alpha(values.get("COLOR_0")),
        )  # fmt: skip
        if part.normals is None:
            return _flat(part)
        return replace(part, tangents=_tangents_of_base(part, self._normal_uv_set(primitive)))

    def _appearance(self, index: int, primitive: Element, values: dict[str, NDArray[np.float64]]) -> Appearance | None:
        """Return the material of a primitive. A texture whose texture coordinates are absent is removed."""
        number = primitive.index("material", len(self._materials))
        if number is None:
            return None
        appearance = self._materials.appearance(number)
        texture = appearance.base_texture
        if texture is not None and f"TEXCOORD_{texture.uv_set}" not in values:
            if texture.image is not None:
                name = f"texture of material {appearance.name!r} on mesh {self.names[index]!r}"
                self.not_read[f"{name}, which has no TEXCOORD_{texture.uv_set}"] = None
            return replace(appearance, base_texture=None)
        return appearance

    def _normal_uv_set(self, primitive: Element) -> int:
        """Return n for the texture coordinates TEXCOORD_n of a primitive's normal map, to which its tangents belong."""
        number = primitive.index("material", len(self._materials))
        return 0 if number is None else self._materials.normal_uv_set(number)

    def _add_morph_targets(
        self, primitive: Element, values: dict[str, NDArray[np.float64]], weights: list[float]
    ) -> None:
        """Add the morph targets, times their weights, to the positions, normals and tangents of a primitive."""
        for weight, target in zip(weights, primitive.elements("targets"), strict=False):
            for name in ("POSITION", "NORMAL", "TANGENT"):
                if weight == 0.0 or name not in target or name not in values:
                    continue
                difference = self._accessors.vectors(target.integer(name, most=len(self._accessors) - 1), (3,))
                if len(difference) != len(values[name]):
                    rule = f"must have {len(values[name])} vectors, as the primitive has, got {len(difference)}"
                    target.refuse(name, rule)
                values[name] = values[name].copy()
                values[name][:, :3] += weight * difference


def _widths(name: str) -> tuple[int, ...]:
    """Return the accepted numbers of components of a vertex attribute; an empty tuple if the attribute is not read."""
    if _UV_SET.fullmatch(name):
        return (2,)
    return {"POSITION": (3,), "NORMAL": (3,), "TANGENT": (4,), "COLOR_0": (3, 4)}.get(name, ())


def _faces(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return triangles from the vertex indices of a list, a strip or a fan of triangles, shape (m, 3)."""
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if mode == _STRIP:
        faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        faces[1::2] = faces[1::2][:, [1, 0, 2]]
    else:
        faces = np.stack([np.broadcast_to(corners[:1], max(len(corners) - 2, 0)), corners[1:-1], corners[2:]], axis=1)
    # A triangle strip repeats vertices to join separate parts of a mesh. The triangles between two parts have no area
    # on purpose and are removed.
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return np.asarray(faces[distinct])


def _with_alpha(colours: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
    """Return vertex colours as linear RGBA; colours without alpha get an alpha of 1."""
    if colours is None or colours.shape[1] == 4:
        return colours
    return np.concatenate([colours, np.ones((len(colours), 1))], axis=1)


def _tangents_of_base(part: ScenePart, normal_uv_set: int) -> NDArray[np.float64] | None:
    """Return the tangents of a scene part along u of its base-colour texture, shape (n, 4); None if they are not known.

    Tangents in a file are along u of the normal map. If the base colour uses the same set of texture coordinates, the
    tangents are rotated by the transform of the base-colour texture. Otherwise their relation to its u is not known.
    """
    if part.tangents is None or part.normals is None:
        return None
    texture = None if part.appearance is None else part.appearance.base_texture
    if (0 if texture is None else texture.uv_set) != normal_uv_set:
        return None
    linear = np.eye(2) if texture is None else texture.transform[:, :2]
    determinant = float(np.linalg.det(linear))
    if determinant == 0.0 or np.array_equal(linear, np.eye(2)):
        return part.tangents
    along_u, side = part.tangents[:, :3], part.tangents[:, 3:]
    with np.errstate(all="ignore"):  # vectors that are not finite are replaced later
        along_v = side * np.cross(part.normals, along_u)
        inverse = np.linalg.inv(linear)
        turned = inverse[0, 0] * along_u + inverse[1, 0] * along_v
    return np.concatenate([turned, side * np.sign(determinant)], axis=1)


def _flat(part: ScenePart) -> ScenePart:
    """Add face normals to a part whose file states no normals. Tangents of the file are dropped, as glTF requires."""
    separate = replace(part, tangents=None).with_separate_corners()
    first, second, third = (separate.vertices[corner::3] for corner in range(3))
    with np.errstate(all="ignore"):  # vertices that are not finite are refused later
        normals = np.repeat(np.cross(second - first, third - first), 3, axis=0)
    return replace(separate, normals=normals)
