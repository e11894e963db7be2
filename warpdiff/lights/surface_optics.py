"""Optics of the surfaces of a picture, the unit of its colours, and the finishes of its faces.

R(0) is the reflectance at normal incidence. A finish is a surface with one of its materials. A plain surface has no
height field. Coherence states how far light interferes, for example within a window. A dot is a part of a grating map
with its own rotation, depth and pitch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from warpdiff.heightfield.grating_map import GratingMap
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import Material


@dataclass(frozen=True, eq=False)
class SurfaceOptics:
    """Optics of one surface of a picture, except for the diffraction of its height field.

    Attributes:
        coherence: Coherence of the light at the surface: how far light interferes, such as a window.
        area_um2: Area of the height field [µm²].
        normal_reflectance: Reflectance R(0) at normal incidence of Schlick's approximation; 1 if the surface has
            materials.
        materials: Materials of the faces. An entry of None means that the face has Schlick's reflectance with
            ``normal_reflectance``.
        masking: Whether V-cavity masking is included.
        energy: Factors of the energy normalisation
            (:class:`~warpdiff.diffraction.energy_normalisation.AchromaticFactors`); without them, the orders of a
            perfect mirror do not sum to 1.
        pigment: Linear factor of the light that the pigment reflects; 0 is no pigment.
        shadows: Whether the mesh may occlude the lights.
        is_plain: Whether the surface has no height field: it reflects light by its base colour and its material.
        unit: Factor from the colours of this surface to the unit of the picture. None if the colours of the picture are
            relative to this surface's own R(0) and coherence.
        grating_map: Map of the surface's dots; None if the whole surface has the same height field.
    """

    coherence: Coherence
    area_um2: float
    normal_reflectance: float
    materials: tuple[Material | None, ...] = (None,)
    masking: bool = True
    energy: NDArray[np.float32] | None = None
    pigment: float = 0.0
    shadows: bool = True
    is_plain: bool = False
    unit: float | None = None
    grating_map: GratingMap | None = None


class PictureUnit(NamedTuple):
    """Light that a perfect mirror would show in a picture; the colours of the picture are relative to this light.

    Attributes:
        coherence: Coherence (how far light interferes) of the mirror's light.
        area_um2: Area of the height field [µm²]; it has an effect only if the coherence is a number of periods that
            interfere.
    """

    coherence: Coherence
    area_um2: float


class Finish(NamedTuple):
    """Finish of a face: index of its surface, its material, and the material that is included in looked-up colours."""

    surface: int
    material: Material | None
    looked_up: Material | None = None
