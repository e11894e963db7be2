"""Factors of the materials of a mesh: metallic, roughness and emission, for surfaces without a height field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.warnings import warn
from warpdiff.core.wording import listed, ref
from warpdiff.scene.mesh_images import mean_values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.scene.scene_parts import Appearance


@dataclass(frozen=True, eq=False)
class MaterialFactors:
    """Factors of the materials of a mesh, one row for each of k appearances of materials on parts.

    Attributes:
        metallic: Share of metal, 0 to 1, shape (k,), float32.
        roughness: Perceptual roughness, 0 to 1, shape (k,), float32; −1 for a matte material.
        emission: Emitted linear RGB, shape (k, 3), float32.
    """

    metallic: NDArray[np.float32]
    roughness: NDArray[np.float32]
    emission: NDArray[np.float32]


def factors_of(materials: Sequence[Appearance]) -> MaterialFactors | None:
    """Return the factors of materials; None if all are matte and dark."""
    if not any(_emission(material).any() or material.roughness is not None for material in materials):
        return None
    metallic, roughness = np.array([_metallic_roughness(material) for material in materials], dtype=np.float32).T
    emission = np.array([_emission(material) for material in materials], dtype=np.float32)
    return MaterialFactors(metallic, roughness, emission)


def warn_of_hidden_emission(factors: MaterialFactors, rows: NDArray[np.int32], names: Sequence[str]) -> None:
    """Warn of materials that emit light, but whose faces have a height field, and are therefore dark.

    Args:
        factors: Factors of the materials.
        rows: Row of each face that has a height field; −1 without a material.
        names: Name of the material of each row.
    """
    used = np.unique(rows[rows >= 0])
    hidden = [*dict.fromkeys(repr(names[row]) for row in used[factors.emission[used].any(axis=1)])]
    if hidden:
        listing = listed(hidden)
        warn(f"{ref('mesh')} has materials whose emission is not rendered where faces have a height field: {listing}")


def _metallic_roughness(appearance: Appearance) -> tuple[float, float]:
    """Return metallic and roughness of a material, with the mean of its texture; the roughness is −1 if it is matte."""
    if appearance.roughness is None:
        return 0.0, -1.0
    texture = appearance.metallic_roughness_texture
    means = None if texture is None or texture.image is None else mean_values(texture.image)
    _, of_roughness, of_metallic = (1.0, 1.0, 1.0) if means is None else means
    metallic, roughness = np.clip([appearance.metallic * of_metallic, appearance.roughness * of_roughness], 0.0, 1.0)
    return float(metallic), float(roughness)


def _emission(appearance: Appearance) -> NDArray[np.float64]:
    """Return the emission of a material. Materials with an emission texture count as dark."""
    is_textured = appearance.emission_texture is not None
    return np.zeros(3) if is_textured else np.maximum(np.array(appearance.emission), 0.0)
