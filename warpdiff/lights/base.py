"""Lights and their parts: what the file of each kind of light provides before any kernel runs.

A public light makes parts, and a part makes a pass (``light_pass``), which fills and reads arrays of one picture.
Pictures refine pixels under one part after the other, as refinement needs the colours of that part alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.lights.light_pass import LightPass, PassContext
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.spectra import Spectrum

# Limit of powers: squares of colours are float32.
MOST_POWER = 1e12
# Samples of the pixels' own rays under a disc, where no cells follow.
DISC_SAMPLES = 128


class Light(ABC):
    """Base class of light sources."""

    @abstractmethod
    def parts(self, coherence: Coherence, *, single_lobe: bool, name: str) -> Sequence[LightPart]:
        """Return the parts that pictures render one after the other.

        Args:
            coherence: Coherence of the picture, whose window blurs the light.
            single_lobe: Whether a light that one lobe can approximate becomes one.
            name: The argument that holds this light, for messages.

        Raises:
            ValueError: The light does not suit the coherence; the message names the argument.
        """


class LightPart(ABC):
    """Part of a light that pictures render separately.

    Attributes:
        spectra: The illuminants that it consists of.
        has_lobes: Whether it consists of lobes, whose directions a plan is for; otherwise a plan is for the hemisphere.
        has_extent: Whether light arrives from more than one direction, which requires footprints.
        sample_count: Number of lobes or directions that represent it.
    """

    spectra: tuple[str | Spectrum, ...]
    has_lobes: bool
    has_extent: bool
    sample_count: int

    @abstractmethod
    def make_pass(self, context: PassContext) -> LightPass:
        """Return the pass of this part over the rays of a picture."""


@dataclass(frozen=True, eq=False)
class Lobe:
    """Lobe of a light: a Gaussian of directions, or one direction.

    Attributes:
        to_light: Unit vector towards it, world frame.
        illuminant: Its illuminant.
        power: Its linear factor.
        deviations: Standard deviations of its directions [radians] along two vectors orthogonal to it, shape (2, 3),
            world frame; None is a single direction.
        position: Position, world frame, from which the power falls off by the square of the distance; ``to_light`` is
            then ignored. None is infinitely far away.
    """

    to_light: tuple[float, float, float]
    illuminant: str | Spectrum
    power: float
    deviations: NDArray[np.float64] | None = None
    position: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class LobeSet(LightPart):
    """Lobes, which are refined together: directional lights, small discs, point lights and suns.

    Attributes:
        lobes: The lobes.
    """

    lobes: tuple[Lobe, ...]
    has_lobes = True

    def __post_init__(self) -> None:
        # Frozen: these follow from the lobes.
        vars(self).update(
            spectra=tuple(lobe.illuminant for lobe in self.lobes), sample_count=len(self.lobes),
            has_extent=any(lobe.deviations is not None for lobe in self.lobes),
        )  # fmt: skip

    def make_pass(self, context: PassContext) -> LightPass:
        """Return the pass of lobes."""
        # Lights are described, as for the command line's help, without loading Warp.
        from warpdiff.lights.lobe_pass import LobePass

        return LobePass(self, context)


@dataclass(frozen=True, eq=False)
class DiscPart(LobeSet):
    """A disc light whose directions are sampled; its only lobe has the mean and the variance of the disc."""

    def __post_init__(self) -> None:
        super().__post_init__()
        vars(self).update(sample_count=DISC_SAMPLES)

    def make_pass(self, context: PassContext) -> LightPass:
        """Return the pass of a disc."""
        # Lights are described, as for the command line's help, without loading Warp.
        from warpdiff.lights.disc_pass import DiscPass

        return DiscPass(self, context)


class LobeLight(Light):
    """Base class of lights that one lobe can approximate."""

    illuminant: str | Spectrum

    @abstractmethod
    def lobe(self) -> Lobe:
        """Return the light as one lobe, whose mean and variance are those of a disc."""

    def parts(self, coherence: Coherence, *, single_lobe: bool, name: str) -> Sequence[LightPart]:  # noqa: ARG002 (of discs and environments)
        """Return the lobe as a part."""
        colorimetry.check_illuminant(self.illuminant, f"{name}.illuminant")
        return [LobeSet((self.lobe(),))]


def orthonormal_pair(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return two unit vectors orthogonal to a vector and to each other, shape (2, 3)."""
    tangent = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    tangent /= np.linalg.norm(tangent)
    return np.stack([tangent, np.cross(axis, tangent)])
