"""Light sources: directional lights of a size, points, and the lobes that pictures are lit by."""

from __future__ import annotations

import functools
import math
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import checks
from warpdiff.optics.spectra import Spectrum

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.scene.sky_map import SkyLight

# Squares of colours are float32.
MOST_POWER = 1e12
# Softboxes: beyond, a light is an environment.
_WIDEST_DEG = 60.0
# A disc up to this wide shows no shape, and is one Gaussian; up to that one where there are to be few. A wider one is
# rings of them.
_SHAPELESS_DEG, ONE_LOBE_DEG = 1.5, 5.0
# Rings: so much wider each further in, up to a limit.
_RING_GROWTH, _WIDEST_RING_DEG = 1.5, 3.5
# Lobes blur the disc as the window does at this wavelength, but no less than by this, nor by more, a blur or a share of
# the radius: shadows are soft without a window.
_BLUR_NM, _LEAST_BLUR_DEG = 450.0, 0.13
_MOST_BLUR_DEG, _MOST_BLUR = 0.4, 0.1
# The ring at the rim in such blurs; deviations of lobes in what they are apart; of the middle one in its radius.
_RIM_BLURS, _LOBE_WIDTH, _MIDDLE_WIDTH = 1.8, 0.6, 0.8
# A lobe of a ring of radius r and width w is √(b r w) long.
_BEND = 0.7
_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
_FEWEST_OF_RING = 6
# Where lobes are made even together: so many radii within and at the rim, and angles around. Errors count relative to
# the blurred disc, down to so much of it.
_EVEN_RADII, _EVEN_RIM, _EVEN_AROUND, _DARKEST = 96, 96, 16, 1e-3


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
        unit = checks.directions(checks.vector(self.to_light, "to_light"), "to_light")[0][0]
        object.__setattr__(self, "to_light", (float(unit[0]), float(unit[1]), float(unit[2])))
        _check_illuminant(self.illuminant)
        object.__setattr__(self, "power", checks.number(self.power, "power", least=0.0, most=MOST_POWER))
        diameter = checks.number(self.angular_diameter_deg, "angular_diameter_deg", least=0.0, most=_WIDEST_DEG)
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
        x, y, z = map(float, checks.vector(self.position, "position", most=checks.MOST))
        object.__setattr__(self, "position", (x, y, z))
        _check_illuminant(self.illuminant)
        object.__setattr__(self, "power", checks.number(self.power, "power", least=0.0, most=MOST_POWER))


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
        continues: Whether it is of the same light as the lobe before.
    """

    to_light: tuple[float, float, float]
    illuminant: str | Spectrum
    power: float
    deviations: NDArray[np.float64] | None = None
    position: tuple[float, float, float] | None = None
    sky: SkyLight | None = None
    continues: bool = False

    @property
    def illuminants(self) -> tuple[str | Spectrum, ...]:
        """What the light consists of."""
        return (self.illuminant,) if self.sky is None else self.sky.spectra

    @property
    def has_size(self) -> bool:
        """Whether it is more than one direction."""
        return self.deviations is not None or self.sky is not None


def lobes_of(light: DirectionalLight | PointLight, sigma_um: float | None = None, *, few: bool = False) -> list[Lobe]:
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
    aside, other = at_right_angles(axis)
    if light.angular_diameter_deg <= (ONE_LOBE_DEG if few else _SHAPELESS_DEG):
        return [Lobe(light.to_light, light.illuminant, light.power, radius / 2.0 * np.stack([aside, other]))]
    of_window = 0.0 if sigma_um is None else 1e-3 * _BLUR_NM / (math.sqrt(8.0) * math.pi * sigma_um)
    result: list[Lobe] = []
    for polar, around, across, along, share in _lobes_of_disc(light.angular_diameter_deg, of_window):
        outwards = math.cos(around) * aside + math.sin(around) * other
        x, y, z = (math.cos(polar) * axis + math.sin(polar) * outwards).tolist()
        deviations = [
            across * (math.cos(polar) * outwards - math.sin(polar) * axis),
            along * (math.cos(around) * other - math.sin(around) * aside),
        ]
        power = light.power * share
        result.append(Lobe((x, y, z), light.illuminant, power, np.stack(deviations), continues=len(result) > 0))
    return result


@functools.lru_cache(maxsize=64)
def _lobes_of_disc(diameter_deg: float, of_window: float) -> tuple[tuple[float, float, float, float, float], ...]:
    """Rings of lobes that are a blurred disc: thin ones at its rim, and each as long as its ring's bend allows.

    Windows blur a light by themselves, so that lobes are thinner than they are apart, and at the rim may be lines.
    Lengths are those of a plane in which equal areas are equal solid angles. What ring by ring the lobes of one have of
    the light is found by least squares against the blurred disc.

    Args:
        diameter_deg: The disc's.
        of_window: Deviation of the windows' own lobes [radians].

    Returns:
        Of each lobe, angle from the disc's middle and around it, deviations outwards and around [all in radians], and
        its share of the light.
    """
    edge = 2.0 * math.sin(math.radians(diameter_deg) / 4.0)
    blur = min(max(of_window, math.radians(_LEAST_BLUR_DEG)), max(math.radians(_MOST_BLUR_DEG), _MOST_BLUR * edge))
    # Of which each has the middle and the deviations of a lobe that is seen.
    rings, outer, turn = [], edge, 0.0
    *widths, core = _widths(edge, _RIM_BLURS * blur)
    for width in widths:
        middle = outer - width / 2.0
        longest = max(width, math.sqrt(_BEND * middle * width))
        count = max(math.ceil(2.0 * math.pi * middle / longest), _FEWEST_OF_RING)
        across, along = _LOBE_WIDTH * width, _LOBE_WIDTH * 2.0 * math.pi * middle / count
        across, along = max(across, blur), max(along, blur)
        # Both ends of a straight lobe lie further out than the ring.
        bent = middle - (along**2 - across**2) / (2.0 * middle)
        around = turn + 2.0 * math.pi * np.arange(count) / count
        rings.append(np.column_stack([np.full(count, bent), around, np.full(count, across), np.full(count, along)]))
        outer, turn = outer - width, turn + _GOLDEN_ANGLE
    of_core = max(_MIDDLE_WIDTH * core, blur) if widths else math.hypot(edge / 2.0, min(of_window, blur))
    rings.append(np.array([[0.0, 0.0, of_core, of_core]]))
    radii = np.sort(np.concatenate([
        edge * np.sqrt((np.arange(_EVEN_RADII) + 0.5) / _EVEN_RADII), edge + blur * np.linspace(-4.0, 5.0, _EVEN_RIM)
    ]))  # fmt: skip
    radii = radii[radii > 0.0]
    at, angle = (each.ravel() for each in np.meshgrid(radii, 2.0 * math.pi * np.arange(_EVEN_AROUND) / _EVEN_AROUND))
    angle = angle + _GOLDEN_ANGLE * np.searchsorted(radii, at)
    wanted = np.tile(_blurred_disc(radii, edge, blur), _EVEN_AROUND)
    weights = 1.0 / np.sqrt(np.maximum(wanted, _DARKEST))
    shown = np.column_stack([_density(ring, at, angle) for ring in rings])
    powers = np.linalg.lstsq(weights[:, None] * shown, weights * wanted, rcond=None)[0]
    shares = np.concatenate([np.full(len(ring), power) for ring, power in zip(rings, powers, strict=True)])
    middles, around, *seen = np.concatenate(rings).T
    across, along = (np.sqrt(np.maximum(each**2 - min(of_window, blur) ** 2, 0.0)) for each in seen)
    polar = 2.0 * np.arcsin(middles / 2.0)
    stretch = np.cos(polar / 2.0)
    found = np.column_stack([polar, around, across / stretch, along * stretch, shares / shares.sum()])
    return tuple(map(tuple, found.tolist()))


def _widths(edge: float, rim: float) -> list[float]:
    """Widths of rings from the rim inwards, and the radius of what is left in the middle, which fill a radius."""
    found = [rim]
    while sum(found[:-1]) + _MIDDLE_WIDTH * found[-1] < edge:
        found.append(max(rim, min(_RING_GROWTH * found[-1], math.radians(_WIDEST_RING_DEG))))
    found[-1] *= _MIDDLE_WIDTH
    return [each * edge / sum(found) for each in found]


def _blurred_disc(radii: NDArray[np.float64], edge: float, blur: float) -> NDArray[np.float64]:
    """A disc of brightness 1 under a Gaussian, along a radius: a sum over its chords."""
    count = math.ceil(6.0 * math.pi * edge / blur)
    angle = math.pi * ((np.arange(count) + 0.5) / count - 0.5)
    x, half = edge * np.sin(angle), edge * np.cos(angle)
    chords = [math.erf(each) for each in half / (math.sqrt(2.0) * blur)]
    near = np.exp(-0.5 * ((radii[:, None] - x) / blur) ** 2) / (math.sqrt(2.0 * math.pi) * blur)
    return np.asarray(near @ (chords * half) * math.pi / count)


def _density(ring: NDArray[np.float64], radius: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sum of a ring's lobes, of power 1 each, in the plane, shape of ``radius``."""
    middle, around, across, along = ring[:, :, None].transpose(1, 0, 2)
    outwards = radius * np.cos(angle - around) - middle
    aside = radius * np.sin(angle - around)
    exponents = (outwards / across) ** 2 + (aside / along) ** 2
    return np.asarray((np.exp(-0.5 * exponents) / (2.0 * math.pi * across * along)).sum(axis=0))


def at_right_angles(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two unit vectors at right angles to one and to each other, (2, 3)."""
    aside = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(axis, aside)])
