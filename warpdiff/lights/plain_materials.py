"""Materials of plain surfaces (surfaces without a height field) on a device: their roughness and emission.

α is the roughness parameter of the GGX distribution of microfacets: the square of the perceptual roughness.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.kernels.plain_reflection import PlainMaterials

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.scene.mesh_import import Surface

# Smallest roughness parameter α (GGX) of a surface without a height field. The value is limited by directions in
# float32, with which narrower highlights cannot be computed. It corresponds to a perceptual roughness of 0.045, the
# smallest roughness in common renderers of glTF.
_LEAST_ALPHA = 0.002


@dataclass(frozen=True)
class PlainFaces:
    """Materials of the plain faces (faces without a height field) of a mesh.

    Attributes:
        struct: The struct ``PlainMaterials`` of the kernels.
        is_glossy: Whether each face is plain and has a roughness, shape (m,).
        emits: Whether any plain face emits light.
    """

    struct: PlainMaterials
    is_glossy: NDArray[np.bool_]
    emits: bool

    @property
    def has_glossy_faces(self) -> bool:
        """Whether any face without a height field has a roughness, so that it is not matte."""
        return bool(self.is_glossy.any())


def plain_faces(
    mesh: Surface, is_plain: NDArray[np.bool_], white_luminance: float, device: wp.Device
) -> PlainFaces | None:
    """Return the materials of plain faces (faces without a height field); None if all are matte and emit no light.

    Args:
        mesh: The prepared mesh.
        is_plain: Whether each face is plain, shape (m,).
        white_luminance: Luminance of a white matte surface that faces a light under which a mirror has the luminance 1.
            The GGX roughness α of a smooth surface is increased until its highlight has a luminance of at most 1, too.
        device: The Warp device.
    """
    factors = mesh.material_factors
    if factors is None:
        return None
    count = len(factors.roughness)
    # Faces without a material use the last element of the arrays, which is that of a matte material without emission.
    rows = np.where(is_plain & (mesh.rows >= 0), mesh.rows, count)
    roughness, emission = np.append(factors.roughness, -1.0), np.append(factors.emission, [[0.0] * 3], axis=0)
    is_glossy, emits = roughness[rows] >= 0.0, bool(np.any(emission[np.unique(rows)] > 0.0))
    if not (is_glossy.any() or emits):
        return None
    struct = PlainMaterials()
    struct.rows = wp.array(rows, dtype=wp.int32, device=device)
    pairs = np.stack([np.append(factors.metallic, 0.0), roughness], axis=1)
    struct.metallic_roughness = wp.array(pairs, dtype=wp.vec2f, device=device)
    struct.emission = wp.array(emission, dtype=wp.vec3f, device=device)
    # The maximum of the highlight is π D V = 1/(4 α²) times the luminance of a white surface, where D is the
    # distribution of microfacets and V is the masking, both at normal incidence. This limit of α makes the maximum at
    # most 1.
    struct.least_alpha = max(_LEAST_ALPHA, 0.5 * math.sqrt(white_luminance))
    return PlainFaces(struct, is_glossy, emits)
