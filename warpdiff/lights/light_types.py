"""Light sources: directional lights of a size, points, and the lobes that pictures are lit by."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import validation
from warpdiff.lights.disc_lobes import lobes_of_disc
from warpdiff.optics.spectra import Spectrum

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.lights.sky_maps import SkyMaps

# Squares of colours are float32.
MOST_POWER = 1e12
# Softboxes: beyond, a light is an environment.
_WIDEST_DEG = 60.0
# A disc up to this wide shows no shape, and is one Gaussian; up to that one where there are to be few. A wider one is
# rings of them.
_SHAPELESS_DEG, ONE_LOBE_DEG = 1.5, 5.0


@dataclass(frozen=True)
class DirectionalLight:
    """Light from infinitely far away, from a point or a disc in the sky.

    Attributes:
        to_light: Direction from the surface towards the light, world frame; it is normalised.
        illuminant: Name of the light's CIE illuminant, or a light source that colour-science knows, or a ``Spectrum``.
        power: Linear factor, up to 1e12; at 1 a flat mirror in the mirror direction of a point shows Y = 1. That of a
            disc is shared out over it.
        angular_diameter_deg: Diameter of a disc of even brightness, 0 to 60°; 0 is a point. A disc takes footprints
            (``footprint=`` of pictures). Up to 1.5°, or up to 5° in pictures with ``refine=False``, it is taken for a
            Gaussian and has a hard shadow.
    """

    to_light: tuple[float, float, float]
    _: KW_ONLY
    illuminant: str | Spectrum = "D65"
    power: float = 1.0
    angular_diameter_deg: float = 0.0

    def __post_init__(self) -> None:
        unit = validation.directions(validation.vector(self.to_light, "to_light"), "to_light")[0][0]
        object.__setattr__(self, "to_light", (float(unit[0]), float(unit[1]), float(unit[2])))
        _check_illuminant(self.illuminant)
        object.__setattr__(self, "power", validation.number(self.power, "power", least=0.0, most=MOST_POWER))
        diameter = validation.number(self.angular_diameter_deg, "angular_diameter_deg", least=0.0, most=_WIDEST_DEG)
        object.__setattr__(self, "angular_diameter_deg", diameter)


@dataclass(frozen=True)
class PointLight:
    """Light from a point of the scene, alike in all directions: its power falls off by the square of the distance.

    Attributes:
        position: Where it is, world frame.
        illuminant: As of a :class:`DirectionalLight`.
        power: Linear factor, up to 1e12; at 1 a flat mirror at a distance of 1 [the mesh's unit] that shows it has
            Y = 1.
    """

    position: tuple[float, float, float]
    _: KW_ONLY
    illuminant: str | Spectrum = "D65"
    power: float = 1.0

    def __post_init__(self) -> None:
        x, y, z = map(float, validation.vector(self.position, "position", most=validation.MOST))
        object.__setattr__(self, "position", (x, y, z))
        _check_illuminant(self.illuminant)
        object.__setattr__(self, "power", validation.number(self.power, "power", least=0.0, most=MOST_POWER))


def _check_illuminant(illuminant: object) -> None:
    if not isinstance(illuminant, (str, Spectrum)):
        raise TypeError(
            "illuminant must be the name of a CIE illuminant, such as 'D65', or a warpdiff.Spectrum, got "
            f"{type(illuminant).__name__}"
        )


@dataclass(frozen=True)
class Lobe:
    """A part of a light: a Gaussian of directions, or one direction.

    Attributes:
        to_light: Unit vector towards it, world frame.
        illuminant: Its illuminant.
        power: Its linear factor.
        deviations: Of its directions [radians], along two vectors at right angles to it, shape (2, 3), world frame;
            None is a single direction.
        position: Where it is, world frame, from where its power falls off by the square of the distance; None is
            infinitely far away. ``to_light`` is then of no account.
        sky: Light from all directions, in place of all of these; the power is 1.
        is_same_light: Whether it is of the same light as the lobe before.
    """

    to_light: tuple[float, float, float]
    illuminant: str | Spectrum
    power: float
    deviations: NDArray[np.float64] | None = None
    position: tuple[float, float, float] | None = None
    sky: SkyMaps | None = None
    is_same_light: bool = False

    @property
    def illuminants(self) -> tuple[str | Spectrum, ...]:
        """What the light consists of."""
        return (self.illuminant,) if self.sky is None else self.sky.spectra

    @property
    def has_extent(self) -> bool:
        """Whether it is more than one direction."""
        return self.deviations is not None or self.sky is not None


def lobes_of(
    light: DirectionalLight | PointLight, sigma_um: float | None = None, *, single_lobe: bool = False
) -> list[Lobe]:
    """The lobes that stand for a light, seen by windows of a deviation [µm].

    One, of a disc of up to 1.5°, or up to 5° if there are to be ``few``, has its mean and its variance; several also
    have its rim, but for a blur that is less than what windows blur by.
    """
    if isinstance(light, PointLight):
        return [Lobe((0.0, 0.0, 1.0), light.illuminant, light.power, position=light.position)]
    radius = math.radians(light.angular_diameter_deg / 2.0)
    if radius == 0.0:
        return [Lobe(light.to_light, light.illuminant, light.power)]
    axis = np.asarray(light.to_light)
    aside, other = orthonormal_pair(axis)
    if light.angular_diameter_deg <= (ONE_LOBE_DEG if single_lobe else _SHAPELESS_DEG):
        return [Lobe(light.to_light, light.illuminant, light.power, radius / 2.0 * np.stack([aside, other]))]
    result: list[Lobe] = []
    for polar, around, across, along, share in lobes_of_disc(light.angular_diameter_deg, sigma_um):
        outwards = math.cos(around) * aside + math.sin(around) * other
        x, y, z = (math.cos(polar) * axis + math.sin(polar) * outwards).tolist()
        deviations = [
            across * (math.cos(polar) * outwards - math.sin(polar) * axis),
            along * (math.cos(around) * other - math.sin(around) * aside),
        ]
        power = light.power * share
        result.append(Lobe((x, y, z), light.illuminant, power, np.stack(deviations), is_same_light=len(result) > 0))
    return result


def orthonormal_pair(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two unit vectors at right angles to one and to each other, (2, 3)."""
    aside = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(axis, aside)])
