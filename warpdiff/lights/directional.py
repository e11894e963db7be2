"""Directional lights: light from infinitely far away, from a point or a disc."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Interval, Unit

from warpdiff.core import validation
from warpdiff.core.options import Checked
from warpdiff.lights.base import MOST_POWER, Lobe, LobeLight, orthonormal_pair
from warpdiff.lights.disc_lobes import lobes_of_disc
from warpdiff.optics.colorimetry import check_illuminant_type

if TYPE_CHECKING:
    from warpdiff.optics.spectra import Spectrum

# Softboxes: beyond, a light is an environment.
_WIDEST_DEG = 60.0
# A disc up to this diameter shows no shape, and is one Gaussian; up to the second one if a single lobe is preferred. A
# wider disc is rings of Gaussians.
_SHAPELESS_DEG, ONE_LOBE_DEG = 1.5, 5.0


@dataclass(frozen=True)
class DirectionalLight(Checked, LobeLight):
    """Light from infinitely far away, from a point or a disc in the sky.

    Attributes:
        to_light: Direction from the surface towards the light, world frame; it is normalised.
        illuminant: Name of a CIE illuminant or of a light source of colour-science, or a ``Spectrum``.
        power: Linear factor: with 1, a flat mirror that reflects a point light to the viewer has Y = 1. The power of a
            disc is distributed over its area.
        angular_diameter_deg: Angular diameter of a disc of uniform radiance; 0 is a point. A disc requires footprints
            (``footprint=`` of pictures). Up to 1.5°, or up to 5° in pictures with ``refine=False``, it is approximated
            by a Gaussian and has a hard shadow.
    """

    to_light: tuple[float, float, float]
    _: KW_ONLY
    illuminant: str | Spectrum = "D65"
    power: Annotated[float, Interval(ge=0.0, le=MOST_POWER)] = 1.0
    angular_diameter_deg: Annotated[float, Interval(ge=0.0, le=_WIDEST_DEG), Unit("°")] = 0.0

    def __post_init__(self) -> None:
        unit = validation.directions(validation.vector(self.to_light, "to_light"), "to_light")[0][0]
        object.__setattr__(self, "to_light", tuple(unit.tolist()))
        super().__post_init__()
        check_illuminant_type(self.illuminant)

    def lobes(self, sigma_um: float | None = None, *, single_lobe: bool = False) -> list[Lobe]:
        """Return one lobe with the mean and variance of the disc, or several that also have its rim.

        Args:
            sigma_um: Standard deviation of the window, which blurs the rim [µm]; None does not blur it.
            single_lobe: Whether a disc that one lobe can approximate becomes one.
        """
        radius = math.radians(self.angular_diameter_deg / 2.0)
        if radius == 0.0:
            return [Lobe(self.to_light, self.illuminant, self.power)]
        axis = np.asarray(self.to_light)
        tangent, bitangent = orthonormal_pair(axis)
        if self.angular_diameter_deg <= (ONE_LOBE_DEG if single_lobe else _SHAPELESS_DEG):
            return [Lobe(self.to_light, self.illuminant, self.power, radius / 2.0 * np.stack([tangent, bitangent]))]
        result: list[Lobe] = []
        for polar, azimuth, radial, tangential, share in lobes_of_disc(self.angular_diameter_deg, sigma_um):
            outwards = math.cos(azimuth) * tangent + math.sin(azimuth) * bitangent
            x, y, z = (math.cos(polar) * axis + math.sin(polar) * outwards).tolist()
            deviations = [
                radial * (math.cos(polar) * outwards - math.sin(polar) * axis),
                tangential * (math.cos(azimuth) * bitangent - math.sin(azimuth) * tangent),
            ]
            power = self.power * share
            result.append(Lobe((x, y, z), self.illuminant, power, np.stack(deviations)))
        return result
