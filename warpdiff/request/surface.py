"""``Surface``: height field and optics of one part of a mesh, for pictures with several surfaces."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Interval

from warpdiff.core.options import Checked
from warpdiff.core.wording import ArgumentTypeError, ref
from warpdiff.heightfield.field import HeightField
from warpdiff.heightfield.grating_map import GratingMap
from warpdiff.optics.coherence import Coherence  # noqa: TC001 (fields are described at run time)
from warpdiff.optics.materials import Material  # noqa: TC001 (fields are described at run time)


@dataclass(frozen=True)
class Surface(Checked):
    """Height field and optics of one part of a mesh, for pictures with several surfaces.

    If a value is None, the setting of the call is used, such as ``shade(..., coherence=...)``.

    Attributes:
        heightfield: Height field, whose x axis lies along the tangents of the mesh, or a grating map, which divides the
            surface into small rectangles with turned and scaled copies of a height field.
        coherence: Coherence: a window, a light source or a number of periods. A grating map without a coherence uses
            ``Coherence("source")``.
        material: Material of the surface. None uses ``ior`` if that is not None, else the material of the call.
        ior: Index of refraction; ``math.inf`` is a perfect mirror.
        pigment: Strength of the mesh's base colour, which lies under the relief, at least 0.

    Examples:
        >>> import warpdiff as wd
        >>> track = wd.Surface(wd.gratings.disc("CD", tracks=2, length_um=12.5), material=wd.Material.metal("Al"))
        >>> track.coherence is None
        True
    """

    heightfield: HeightField | GratingMap
    coherence: Coherence | None = None
    material: Material | None = None
    ior: Annotated[float, Interval(gt=1.0, le=math.inf)] | None = None
    pigment: Annotated[float, Ge(0.0)] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.heightfield, (HeightField, GratingMap)):
            raise ArgumentTypeError(
                f"{ref('heightfield')} must be a warpdiff.HeightField or a warpdiff.GratingMap, got "
                f"{type(self.heightfield).__name__}"
            )
