"""Parts of a scene, as every reader of mesh files returns them: triangles with their transform, and materials."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray
    from PIL import Image

AlphaMode = Literal["opaque", "mask", "blend"]
Wrap = Literal["repeat", "clamp", "mirror"]


def identity_transform() -> NDArray[np.float64]:
    """Return the transform of texture coordinates that changes nothing, shape (2, 3)."""
    return np.eye(2, 3)


@dataclass(frozen=True, eq=False)
class TextureMap:
    """Image that a material uses, and how texture coordinates address it.

    Attributes:
        image: The image, whose row 0 is at v = 1; None if it cannot be read.
        uv_set: Number of the set of texture coordinates that the material uses; 0 is the first set.
        transform: Matrix that maps (u, v, 1) to the coordinates in the image, v upwards, shape (2, 3).
        wrap: Wrap modes outside of the image, along u and along v: ``"repeat"``, ``"clamp"`` or ``"mirror"``.
    """

    image: Image.Image | None
    uv_set: int = 0
    transform: NDArray[np.float64] = field(default_factory=identity_transform)
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")


@dataclass(frozen=True, eq=False)
class Appearance:
    """Appearance of a material.

    Attributes:
        name: Name, which no other material of the scene has.
        base_colour: Linear RGBA that multiplies the base-colour texture; None without a colour.
        base_texture: Base-colour texture, or None.
        fallback_colour: Linear RGBA that replaces ``base_colour`` if the texture cannot be used, or None.
        metallic: Metallic of the metallic-roughness model, 0 to 1.
        roughness: Perceptual roughness, 0 to 1. None is a matte material without specular reflection, for which
            ``metallic`` has no effect.
        metallic_roughness_texture: Texture with roughness in green and metallic in blue, which multiply ``roughness``
            and ``metallic``, or None.
        emission: Emitted linear RGB.
        emission_texture: Texture that multiplies ``emission``, or None.
        alpha_mode: Use of the alpha of the base colour: it is ignored, compared with ``alpha_cutoff``, or mixes the
            surface with its background.
        alpha_cutoff: Smallest alpha at which a surface with the mode "mask" is visible.
        not_rendered: Features of the material in the file that have no effect on pictures.
    """

    name: str
    base_colour: tuple[float, float, float, float] | None = None
    base_texture: TextureMap | None = None
    fallback_colour: tuple[float, float, float, float] | None = None
    metallic: float = 0.0
    roughness: float | None = None
    metallic_roughness_texture: TextureMap | None = None
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)
    emission_texture: TextureMap | None = None
    alpha_mode: AlphaMode = "opaque"
    alpha_cutoff: float = 0.5
    not_rendered: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ScenePart:
    """Triangles of one geometry with one material.

    Some vertices of the file are duplicated. For each vertex, ``source`` has the index of the file's vertex.

    Attributes:
        geometry: Name of the geometry, such as a mesh of a glTF file or an object of an .obj file.
        appearance: Material, or None.
        vertices: Positions in the geometry's own coordinates, shape (n, 3), float64.
        faces: Vertex indices, counter-clockwise as viewed from the front, shape (m, 3), int64.
        normals: Normals of the file at the vertices, of any length, shape (n, 3); None without normals.
        tangents: Directions along u and handedness (±1, −1 where the mapping is mirrored), shape (n, 4); None
            without tangents.
        uvs: Sets of texture coordinates by their number, v upwards, each of shape (n, 2).
        colours: Linear RGBA at the vertices, shape (n, 4), or None.
        source: Index of the file's vertex for each vertex, shape (n,).
        source_count: Number of vertices in the file.
        transform: Matrix from the geometry's own coordinates to the world, shape (4, 4).
    """

    geometry: str
    appearance: Appearance | None
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    source: NDArray[np.int64]
    source_count: int
    normals: NDArray[np.float64] | None = None
    tangents: NDArray[np.float64] | None = None
    uvs: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    colours: NDArray[np.float64] | None = None
    transform: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))

    def placed(self) -> ScenePart:
        """Return this part of the scene in world coordinates."""
        linear, shift = self.transform[:3, :3], self.transform[:3, 3]
        determinant = float(np.linalg.det(linear))
        normals, tangents = self.normals, self.tangents
        if normals is not None and determinant != 0.0:
            # Normals are multiplied by the transposed inverse of the transform, times the absolute value of its
            # determinant. A reflection reverses the order of the corners of faces below; normals remain on the outside.
            normals = normals @ (np.linalg.inv(linear) * abs(determinant))
        if tangents is not None:
            side = np.where(determinant < 0.0, -tangents[:, 3:], tangents[:, 3:])
            tangents = np.concatenate([tangents[:, :3] @ linear.T, side], axis=1)
        return replace(
            self, vertices=self.vertices @ linear.T + shift, normals=normals, tangents=tangents,
            faces=self.faces[:, ::-1] if determinant < 0.0 else self.faces, transform=np.eye(4),
        )  # fmt: skip

    def with_separate_corners(self) -> ScenePart:
        """Return the part with separate vertices for each face, in the order of the faces and their corners."""
        corner = self.faces.ravel()

        def at_corners(values: NDArray[np.float64] | None) -> NDArray[np.float64] | None:
            return None if values is None else values[corner]

        return replace(
            self, vertices=self.vertices[corner], faces=np.arange(len(corner)).reshape(-1, 3),
            source=self.source[corner], normals=at_corners(self.normals), tangents=at_corners(self.tangents),
            uvs={number: uvs[corner] for number, uvs in self.uvs.items()}, colours=at_corners(self.colours),
        )  # fmt: skip


def unique_names(names: Iterable[str | None], kind: str) -> list[str]:
    """Return names that are all different: "(2)" is appended to the second equal name, and missing names get a number.

    Args:
        names: Names in the file; None or empty if unnamed.
        kind: Word before the number that replaces a missing name, such as "mesh".
    """
    result: list[str] = []
    used: set[str] = set()
    # Equal names get a number in brackets. The dictionary stores the last number that was appended to each name. The
    # search for an unused number begins after it, so that the search is fast for many equal names.
    last: dict[str, int] = {}
    for index, name in enumerate(names):
        base = name or f"{kind} {index}"
        unique = base
        while unique in used:
            last[base] = last.get(base, 1) + 1
            unique = f"{base} ({last[base]})"
        used.add(unique)
        result.append(unique)
    return result
