"""Factors of the materials of a mesh: metallic, roughness and emission, for surfaces without a height field.

A factor is a constant number or colour, by which the texture of the same quantity is multiplied. A row is the
appearance of one material on one part of the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, listed, ref
from warpdiff.scene.mesh_images import mean_values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.scene.material_maps import NotSampled
    from warpdiff.scene.scene_arrays import PartAppearance
    from warpdiff.scene.scene_parts import Appearance, ScenePart


# Factors of materials whose ranges are checked: name in messages, attribute of ``Appearance``, and largest accepted
# value.
_FACTORS = (
    ("base colour", "base_colour", 1.0), ("base colour", "fallback_colour", 1.0), ("metallic", "metallic", 1.0),
    ("roughness", "roughness", 1.0), ("emission", "emission", np.inf), ("alpha cut-off", "alpha_cutoff", np.inf),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class MaterialFactors:
    """Metallic, roughness and emission of a mesh, in k rows: one row for each material on each part of the mesh.

    Attributes:
        metallic: Metallic of the metallic-roughness model, 0 to 1, shape (k,), float32.
        roughness: Perceptual roughness, 0 to 1, shape (k,), float32; −1 for a matte material.
        emission: Emitted linear RGB, shape (k, 3), float32.
    """

    metallic: NDArray[np.float32]
    roughness: NDArray[np.float32]
    emission: NDArray[np.float32]


def checked_parts(parts: Sequence[ScenePart]) -> list[ScenePart]:
    """Return the parts of a scene with finite vertex colours, and with factors of materials within their limits.

    Base colour, metallic and roughness are from 0 to 1, and other factors are at least 0. One warning names all factors
    outside of these limits; they are replaced by the nearest limit.

    Raises:
        ValueError: A factor of a material is not finite; the message names it and its material.
    """
    checked: dict[Appearance, Appearance] = {}
    outside: list[str] = []
    result = []
    for part in parts:
        if part.appearance is not None and part.appearance not in checked:
            checked[part.appearance] = _checked(part.appearance, outside)
        colours = part.colours
        if colours is not None and not np.all((colours >= 0.0) & (colours <= 1.0)):
            outside.append(f"vertex colours of {part.geometry!r}")
            colours = np.nan_to_num(colours).clip(0.0, 1.0)
        appearance = None if part.appearance is None else checked[part.appearance]
        result.append(replace(part, appearance=appearance, colours=colours))
    if outside:
        listing = listed([*dict.fromkeys(outside)], "; ", "; and {} more")
        warn(f"{ref('mesh')} has colours or factors outside of 0 to 1, which are set to 0 or 1: {listing}")
    return result


def _checked(material: Appearance, outside: list[str]) -> Appearance:
    """Return a material whose factors are within their limits; add the names of other factors to ``outside``."""
    changes: dict[str, Any] = {}
    for label, name, most in _FACTORS:
        value = getattr(material, name)
        if value is None:
            continue
        numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
        shown = ", ".join(f"{number:g}" for number in numbers)
        if not np.isfinite(numbers).all():
            raise ArgumentValueError(
                f"{ref('mesh')}'s material {material.name!r} must have a finite {label}, got {shown}; correct the "
                "material"
            )
        limited = numbers.clip(0.0, most)
        if not np.array_equal(limited, numbers):
            outside.append(f"{label} {shown} of {material.name!r}")
            changes[name] = tuple(limited.tolist()) if np.ndim(value) else float(limited[0])
    return replace(material, **changes) if changes else material


def factors_of(appearances: Sequence[PartAppearance], not_sampled: NotSampled) -> MaterialFactors | None:
    """Return metallic, roughness and emission of materials; None if all materials are matte and emit no light.

    Args:
        appearances: Appearances of materials on parts of the mesh. Each is one row of the result.
        not_sampled: Masks of the rows whose textures cannot be sampled.
    """
    emission = np.array([own.material.emission for own in appearances], dtype=np.float32).reshape(-1, 3)
    emission[not_sampled.emission] = 0.0
    if not emission.any() and all(own.material.roughness is None for own in appearances):
        return None
    pairs = [
        _metallic_roughness(own.material, by_mean=bool(missing) and not own.has_map_uvs[0])
        for own, missing in zip(appearances, not_sampled.metallic_roughness, strict=True)
    ]
    metallic, roughness = np.array(pairs, dtype=np.float32).T
    return MaterialFactors(metallic, roughness, emission)


def warn_of_hidden_emission(factors: MaterialFactors, rows: NDArray[np.int32], names: Sequence[str]) -> None:
    """Warn of materials that emit light on faces with a height field, where the emission has no effect.

    Args:
        factors: Factors of the materials, one row per material and part of the mesh.
        rows: Index of the row in ``factors`` for each face that has a height field; −1 without a material.
        names: Name of the material of each row.
    """
    used = np.unique(rows[rows >= 0])
    hidden = [*dict.fromkeys(repr(names[row]) for row in used[factors.emission[used].any(axis=1)])]
    if hidden:
        listing = listed(hidden)
        warn(f"{ref('mesh')} has materials whose emission is not rendered where faces have a height field: {listing}")


def _metallic_roughness(material: Appearance, *, by_mean: bool) -> tuple[float, float]:
    """Return metallic and roughness of a material; the roughness is −1 if the material is matte.

    If ``by_mean`` is True, the material's texture cannot be sampled at points, and both factors are multiplied by the
    mean of the texture.
    """
    if material.roughness is None:
        return 0.0, -1.0
    texture = material.metallic_roughness_texture if by_mean else None
    means = None if texture is None or texture.image is None else mean_values(texture.image)
    _, of_roughness, of_metallic = (1.0, 1.0, 1.0) if means is None else means
    return material.metallic * of_metallic, material.roughness * of_roughness
