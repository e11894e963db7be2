"""Base classes of lights and of their parts, which describe a light before any kernel runs.

A public light consists of parts: its lobes, a disc, or the smooth rest of a sky. A lobe is a Gaussian of directions or
a single direction. Each part makes a pass (``light_pass``), an object that adds the light of this part to one picture.
Pixels are refined separately for each part, because the error estimate of a pixel requires the colours under one part
alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core import validation
from warpdiff.core.options import Checked
from warpdiff.core.wording import ArgumentTypeError, ref
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.device.kernel_calls import KernelCall
    from warpdiff.kernels.light_samples import Lights
    from warpdiff.lights.light_pass import LightPass, PassContext, RayBatch
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.spectra import Spectrum

# Largest power of a light, a linear factor. The value is limited by kernels, which square colours in float32; float32
# ends at 3e38.
MOST_POWER = 1e12
# Smallest number of directional lights with the same illuminant at which each subpixel cell chooses one light at
# random, instead of evaluating all lights. A subpixel cell is a part of a pixel with one camera ray. The number was
# fitted to two pictures, of a snake and of a tube: with fewer lights, one of the two pictures requires less time if all
# lights are evaluated.
MANY_LIGHTS = 64
# Number of random directions per pixel to a disc light that is too wide for one lobe (a Gaussian of directions), in
# pictures with ``refine=False``. The value is limited by time, which is proportional to it.
DISC_SAMPLES = 128


class Light(ABC):
    """Base class of light sources."""

    @abstractmethod
    def parts(self, coherence: Coherence, *, single_lobe: bool, name: str) -> Sequence[LightPart]:
        """Return the parts that pictures render one after the other.

        Args:
            coherence: Coherence of the picture (how far light interferes). An environment requires the kind
                ``"averaged"``.
            single_lobe: Whether disc lights of up to 5° become one lobe (a Gaussian of directions), as in pictures
                without refinement. Otherwise only disc lights of up to 1.5° become one lobe.
            name: Name of the argument that contains this light, for error messages.

        Raises:
            ValueError: The light does not suit the coherence; the message names the argument.
        """


class LightPart(ABC):
    """Part of a light that pictures render separately.

    Attributes:
        spectra: The illuminants of the part.
        has_lobes: Whether the part consists of lobes, which are Gaussians of directions. The plan of a picture (numbers
            of its computation, such as wavelengths) then covers only the directions of the lobes, otherwise the whole
            hemisphere.
        has_extent: Whether light arrives from more than one direction. Such a part requires that pixels show means over
            footprints (the directions within the pixel filter).
        sample_count: Number of lobes, or of directions per pixel that are drawn if pixels are not refined.
    """

    spectra: tuple[str | Spectrum, ...]
    has_lobes: bool
    has_extent: bool
    sample_count: int

    @abstractmethod
    def make_pass(self, context: PassContext) -> LightPass:
        """Return the pass of this part, an object that adds the light of the part to the colours of a picture.

        The module of the pass is imported in this method, so that the command line can describe lights without loading
        Warp.
        """


class EmissionProfile(ABC):
    """Emission profile: the power of a light as a function of the direction of emission, as for a spotlight.

    Subclasses are frozen dataclasses.
    """

    @abstractmethod
    def kernel_call(self, lights: Lights, lobe: int, batch: RayBatch) -> KernelCall:
        """Return the kernel call that computes the unit vector to a light's lobe, and the factor of its power, per ray.

        The kernel writes both to the array ``batch.samples.towards``. ``lobe`` is an index of the struct ``lights``.
        """


@dataclass(frozen=True, eq=False)
class Lobe:
    """Lobe of a light: a Gaussian of directions or of positions, a single direction, or a single position.

    Attributes:
        to_light: Unit vector from the surface towards the light, world frame.
        illuminant: Illuminant of the lobe.
        power: Linear factor of the illuminant.
        deviations: Two vectors orthogonal to ``to_light``, world frame, shape (2, 3). Their lengths are the standard
            deviations of the directions along them [radians]. If ``position`` is set, the vectors may have any
            direction, and their lengths are standard deviations of the positions [mesh units]. None is a single
            direction or position.
        position: Mean position, world frame. The power falls off with the square of the distance, and ``to_light`` is
            ignored. None for a light that is infinitely far away.
        profile: Factor of the power by direction of emission; None is equal light in all directions.
        name: Argument and class of the light, for messages; pictures set it.
        is_of_sky: Whether ``illuminant`` is a spectral radiance L(λ) divided by λ², as for suns of an environment. A
            white pigment (base colour of the mesh) then has the chromaticity of L.
    """

    to_light: tuple[float, float, float]
    illuminant: str | Spectrum
    power: float
    deviations: NDArray[np.float64] | None = None
    position: tuple[float, float, float] | None = None
    profile: EmissionProfile | None = None
    name: str = "lights"
    is_of_sky: bool = False

    @property
    def is_direction(self) -> bool:
        """Whether the same light arrives at all points of the scene, from a single direction."""
        return self.power > 0.0 and self.deviations is None and self.position is None and self.profile is None


@dataclass(frozen=True, eq=False)
class LobeSet(LightPart):
    """Set of lobes (Gaussians of directions) of directional lights, small discs, suns or point lights.

    Pixels are refined by their error under all lobes of the set together.

    Attributes:
        lobes: Lobes of one light, or of all lights of a picture that consist of lobes.
    """

    lobes: tuple[Lobe, ...]
    has_lobes = True

    def __post_init__(self) -> None:
        # The fields of a frozen dataclass cannot be assigned. The attributes that follow from the lobes of the light
        # are therefore set through ``vars``.
        vars(self).update(
            spectra=tuple(lobe.illuminant for lobe in self.lobes), sample_count=len(self.lobes),
            has_extent=any(lobe.deviations is not None for lobe in self.lobes),
        )  # fmt: skip

    def make_pass(self, context: PassContext) -> LightPass:
        """Return the pass in which every ray adds the colours under all lobes (Gaussians of directions)."""
        from warpdiff.lights.lobe_pass import LobePass

        return LobePass(self, context)


@dataclass(frozen=True, eq=False)
class LobeChoice(LobeSet):
    """Set of many lobes with one illuminant, each with a single direction. Each ray chooses one lobe at random."""

    def make_pass(self, context: PassContext) -> LightPass:
        """Return the pass in which every subpixel cell adds the colour under one lobe (direction), chosen at random."""
        # Warp is imported here, so that the help of the command line can describe lights without loading Warp.
        from warpdiff.lights.choice_pass import ChoicePass

        return ChoicePass(self, context)


@dataclass(frozen=True, eq=False)
class DiscPart(LobeSet):
    """Disc light that is too wide for one lobe: each ray draws directions on the disc.

    Before pixels are subdivided, a single lobe (a Gaussian of directions) approximates the disc.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        vars(self).update(sample_count=DISC_SAMPLES)

    def make_pass(self, context: PassContext) -> LightPass:
        """Return the pass in which every ray draws a direction on the disc and adds the colour in this direction."""
        from warpdiff.lights.disc_pass import DiscPass

        return DiscPass(self, context)


class LobeLight(Checked, Light):
    """Base class of lights that consist of lobes (Gaussians of directions). Subclasses are frozen dataclasses."""

    illuminant: str | Spectrum

    def __post_init__(self) -> None:
        super().__post_init__()
        colorimetry.check_illuminant_type(self.illuminant)

    @abstractmethod
    def lobes(self) -> tuple[Lobe, ...]:
        """Return the lobes of the light: Gaussians of directions or of positions."""

    def parts(self, coherence: Coherence, *, single_lobe: bool, name: str) -> Sequence[LightPart]:  # noqa: ARG002 (of discs and environments)
        """Return the lobes (Gaussians of directions) as the only part of the light."""
        colorimetry.check_illuminant(self.illuminant, f"{name}.illuminant")
        return [LobeSet(self.lobes())]


def listed(lights: object) -> list[Light]:
    """Return one or several lights as a checked list; an empty sequence raises an error."""
    several = [lights] if isinstance(lights, Light) else lights
    if not isinstance(several, Sequence) or not several:
        raise ArgumentTypeError(
            f"{ref('lights')} must be a light, such as a DirectionalLight, or a non-empty sequence of lights, got "
            f"{lights!r:.60}"
        )
    for index, light in enumerate(several):
        validation.instance(light, Light, f"lights[{index}]")
    return list(several)


def orthonormal_pair(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return two unit vectors orthogonal to a unit vector and to each other, shape (2, 3)."""
    tangent = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    tangent /= np.linalg.norm(tangent)
    return np.stack([tangent, np.cross(axis, tangent)])
