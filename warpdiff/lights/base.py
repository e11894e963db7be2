"""Lobes: the parts of a light that pictures are computed from, whatever kind of light it is."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core.wording import ArgumentTypeError, ref
from warpdiff.optics.spectra import Spectrum

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.lights.sky_maps import SkyMaps

# Squares of colours are float32.
MOST_POWER = 1e12


class Light:
    """Base class of light sources; the file of each kind registers its function of :func:`lobes_of`."""


@dataclass(frozen=True)
class Lobe:
    """A part of a light: a Gaussian of directions, or one direction.

    Attributes:
        to_light: Unit vector towards it, world frame.
        illuminant: Its illuminant.
        power: Its linear factor.
        deviations: Standard deviations of its directions [radians] along two vectors orthogonal to it, shape (2, 3),
            world frame; None is a single direction.
        position: Position, world frame, from which the power falls off by the square of the distance; ``to_light`` is
            then ignored. None is infinitely far away.
        sky: Light from all directions, instead of all of these; the power is then 1.
        is_same_light: Whether it belongs to the same light as the lobe before.
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
        """The illuminants that the lobe consists of."""
        return (self.illuminant,) if self.sky is None else self.sky.spectra

    @property
    def has_extent(self) -> bool:
        """Whether it is more than one direction."""
        return self.deviations is not None or self.sky is not None


@functools.singledispatch
def lobes_of(
    light: Any,
    sigma_um: float | None = None,  # noqa: ARG001 (of the registered functions)
    *,
    single_lobe: bool = False,  # noqa: ARG001
) -> list[Lobe]:
    """Return the lobes of a light; the file of each kind of light registers its own function.

    Args:
        light: The light.
        sigma_um: Standard deviation of the window that blurs the light [µm]; None does not blur it.
        single_lobe: Whether a light that can be approximated by one lobe is.
    """
    raise TypeError(f"no function is registered for the lobes of {type(light).__name__}")


def check_illuminant(illuminant: object) -> None:
    """Refuse an illuminant of a type that lights do not have."""
    if not isinstance(illuminant, (str, Spectrum)):
        raise ArgumentTypeError(
            f"{ref('illuminant')} must be the name of a CIE illuminant, such as 'D65', or a warpdiff.Spectrum, got "
            f"{type(illuminant).__name__}"
        )


def orthonormal_pair(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two unit vectors orthogonal to a vector and to each other, shape (2, 3)."""
    tangent = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    tangent /= np.linalg.norm(tangent)
    return np.stack([tangent, np.cross(axis, tangent)])
