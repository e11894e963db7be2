"""Point lights: light from a position in the scene."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated

from annotated_types import Interval, Unit

from warpdiff.lights.base import MOST_POWER, Lobe, LobeLight

if TYPE_CHECKING:
    from warpdiff.optics.spectra import Spectrum


@dataclass(frozen=True)
class PointLight(LobeLight):
    """Light from a point in the scene, equal in all directions; it falls off with the square of the distance.

    Attributes:
        position: Position, world frame.
        illuminant: Name of a CIE illuminant or of a light source of colour-science, or a ``Spectrum``.
        power: Linear factor, specified at a distance of 1 mesh unit. With the power 1, a flat mirror at this distance
            that reflects the light has Y = 1.

    Examples:
        >>> import warpdiff as wd
        >>> bulb = wd.PointLight((0.5, 2.0, 1.0), illuminant="FL11", power=4.0)
        >>> bulb.power
        4.0
    """

    position: Annotated[tuple[float, float, float], Unit("mesh units")]
    _: KW_ONLY
    illuminant: str | Spectrum = "D65"
    power: Annotated[float, Interval(ge=0.0, le=MOST_POWER)] = 1.0

    def lobes(self) -> tuple[Lobe, ...]:
        """Return the light as one lobe, the representation of lights in passes: here a single point."""
        return (Lobe((0.0, 0.0, 1.0), self.illuminant, self.power, position=self.position),)
