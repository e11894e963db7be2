"""Directional lights: light from infinitely far away, from a single direction or from a disc."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Interval, Unit

from warpdiff.core import validation
from warpdiff.lights.base import MOST_POWER, DiscPart, LightPart, Lobe, LobeLight, orthonormal_pair

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.spectra import Spectrum

# Largest diameter of a disc light [°]. The value was chosen because typical softboxes are smaller than 60°. Larger
# lights can be described by environments.
_WIDEST_DEG = 60.0
# Largest diameters [°] of disc lights that are approximated by one Gaussian lobe: in refined pictures, and in pictures
# with ``refine=False``. The values are limited by shadows, because a lobe has no penumbra. Directions to wider discs
# are drawn at random.
_SHAPELESS_DEG, ONE_LOBE_DEG = 1.5, 5.0


@dataclass(frozen=True)
class DirectionalLight(LobeLight):
    """Light from infinitely far away, from a point or a disc in the sky.

    Attributes:
        to_light: Direction from the surface towards the light, world frame, of any length; the attribute is a unit
            vector.
        illuminant: Name of a CIE illuminant or of a light source of colour-science, or a ``Spectrum``.
        power: Linear factor: with 1, a flat mirror that reflects a point light to the viewer has Y = 1. The power of a
            disc is distributed over its area.
        angular_diameter_deg: Angular diameter of a disc of uniform radiance; 0 is a point. A disc requires pictures
            whose pixels show means over footprints (``footprint=``). A disc of up to 1.5°, or up to 5° in pictures with
            ``refine=False``, is approximated by a Gaussian and has a hard shadow.

    Examples:
        >>> import warpdiff as wd
        >>> wd.DirectionalLight((0.6, 1.0, -0.1), angular_diameter_deg=3.0).angular_diameter_deg
        3.0
        >>> wd.DirectionalLight((0.0, 2.0, 0.0)).to_light
        (0.0, 1.0, 0.0)
    """

    to_light: tuple[float, float, float]
    _: KW_ONLY
    illuminant: str | Spectrum = "D65"
    power: Annotated[float, Interval(ge=0.0, le=MOST_POWER)] = 1.0
    angular_diameter_deg: Annotated[float, Interval(ge=0.0, le=_WIDEST_DEG), Unit("°")] = 0.0

    def __post_init__(self) -> None:
        unit = validation.unit_directions(validation.vector(self.to_light, "to_light"), "to_light")[0][0]
        object.__setattr__(self, "to_light", tuple(unit.tolist()))
        super().__post_init__()

    def lobes(self) -> tuple[Lobe, ...]:
        """Return one lobe (a Gaussian of directions) with the mean direction and the variance of the disc."""
        deviations = None
        if self.angular_diameter_deg > 0.0:
            radius = math.radians(self.angular_diameter_deg / 2.0)
            deviations = 0.5 * radius * orthonormal_pair(np.asarray(self.to_light))
        return (Lobe(self.to_light, self.illuminant, self.power, deviations),)

    def parts(self, coherence: Coherence, *, single_lobe: bool, name: str) -> Sequence[LightPart]:
        """Return one part: a lobe (a Gaussian) for a narrow disc, or random directions for a wide disc.

        The arguments are those of :meth:`warpdiff.lights.base.Light.parts`.
        """
        parts = super().parts(coherence, single_lobe=single_lobe, name=name)
        is_narrow = self.angular_diameter_deg <= (ONE_LOBE_DEG if single_lobe else _SHAPELESS_DEG)
        return parts if is_narrow else [DiscPart(self.lobes())]
