"""Textures of metallic, roughness and emission on the plain parts of a scene (parts without a height field).

A row is the appearance of one material on one part of the scene, see ``PartAppearance``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from warpdiff.scene.scene_arrays import uvs_at
from warpdiff.scene.textures import MaterialMaps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.scene.scene_arrays import PartAppearance, SceneArrays
    from warpdiff.scene.scene_parts import ScenePart
    from warpdiff.scene.textures import Texture, TextureImages

_WHITE = (1.0, 1.0, 1.0, 1.0)
# Names of the attributes of ``Appearance`` that have textures: one of metallic and roughness, and one of emission.
_Use = Literal["metallic_roughness_texture", "emission_texture"]


def maps_of(
    parts: Sequence[tuple[ScenePart, str]], scene: SceneArrays, is_plain: NDArray[np.bool_], images: TextureImages
) -> MaterialMaps | None:
    """Return the textures of metallic, roughness and emission on parts without a height field; None without textures.

    Args:
        parts: Parts of the scene, and their labels for messages.
        scene: The joined parts.
        is_plain: Whether the part of each face has no height field, shape (m,).
        images: Images of the scene.
    """
    used = set(scene.rows[is_plain].tolist())
    roughness, emission = [], []
    for row, own in enumerate(scene.appearances):
        material = own.material
        sources = [material.metallic_roughness_texture, material.emission_texture]
        has_effect = [material.roughness is not None, any(material.emission)]
        of_roughness, of_emission = (
            source if row in used and has_uvs and effect else None
            for source, has_uvs, effect in zip(sources, own.has_map_uvs, has_effect, strict=True)
        )
        roughness.append(None if of_roughness is None else images.texture(of_roughness, _WHITE, is_roughness=True))
        emission.append(None if of_emission is None else images.texture(of_emission, _WHITE))
    if not any(roughness) and not any(emission):
        return None
    return MaterialMaps(
        tuple(roughness), tuple(emission), _uvs(parts, scene, roughness, "metallic_roughness_texture"),
        _uvs(parts, scene, emission, "emission_texture"),
    )  # fmt: skip


def _uvs(
    parts: Sequence[tuple[ScenePart, str]], scene: SceneArrays, textures: Sequence[Texture | None], use: _Use
) -> NDArray[np.float64]:
    """Return for each vertex the coordinates at which a texture of emission, or of metallic and roughness, is sampled.

    The shape is (n, 2). ``textures`` has the texture of each row (one material on one part), or None. Vertices without
    a texture have NaN.
    """
    result = np.full((len(scene.vertices), 2), np.nan)
    vertex = face = 0
    for part, label in parts:
        row = scene.rows[face]
        if row >= 0 and textures[row] is not None:
            uvs = uvs_at(part, getattr(part.appearance, use), label)
            result[vertex : vertex + len(part.vertices)] = uvs
        vertex += len(part.vertices)
        face += len(part.faces)
    return result


@dataclass(frozen=True, eq=False)
class NotSampled:
    """Masks of the rows whose textures of metallic and roughness, or of emission, cannot be sampled.

    A row is the appearance of one material on one part of a scene.

    Attributes:
        metallic_roughness: Whether the texture of metallic and roughness cannot be sampled, for each row, shape (k,).
        emission: Whether the texture of emission cannot be sampled, for each row, shape (k,).
    """

    metallic_roughness: NDArray[np.bool_]
    emission: NDArray[np.bool_]

    @classmethod
    def of(cls, scene: SceneArrays, is_plain: NDArray[np.bool_], maps: MaterialMaps | None) -> NotSampled:
        """Return the masks for a scene. Both are False for rows without a plain face (face without a height field).

        The masks state for which rows textures cannot be sampled. A row is one material on one part of the scene.
        """
        used = np.zeros(len(scene.appearances), np.bool_)
        used[scene.rows[is_plain & (scene.rows >= 0)]] = True
        none = [None] * len(used)
        of_roughness, of_emission = (none, none) if maps is None else (maps.metallic_roughness, maps.emission)
        materials = [own.material for own in scene.appearances]
        roughness = [
            material.metallic_roughness_texture is not None and material.roughness is not None and texture is None
            for material, texture in zip(materials, of_roughness, strict=True)
        ]
        emission = [
            material.emission_texture is not None and any(material.emission) and texture is None
            for material, texture in zip(materials, of_emission, strict=True)
        ]
        return cls(used & np.array(roughness, np.bool_), used & np.array(emission, np.bool_))

    def features(self, appearances: Sequence[PartAppearance]) -> dict[str, list[str]]:
        """Return texts that describe the textures that cannot be sampled, for a warning, by the names of materials."""
        result: dict[str, list[str]] = {}
        for row, own in enumerate(appearances):
            texts = result.setdefault(own.material.name, [])
            if self.metallic_roughness[row]:
                source = own.material.metallic_roughness_texture
                by_mean = source is not None and source.image is not None and not own.has_map_uvs[0]
                texts.append(f"metallic-roughness texture{' except for its mean' if by_mean else ''}")
            if self.emission[row]:
                texts.append("emission texture that cannot be sampled")
        return result
