"""Range of the directions of a call, and a sample of these directions on which the planner tries plans.

A plan holds the numbers of a computation, such as the number of wavelengths.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.optics.colorimetry import LAMBDA_MAX_NM, LAMBDA_MIN_NM

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence

# Largest number of directions that the planner samples from the directions of a call. The planner tries plans (numbers
# of a computation) on the sampled directions. If the number was doubled, planning would require more time.
MOST_SAMPLED = 8192
# If a call has fewer directions than this, the planner tries plans (numbers of a computation) on all of them. Otherwise
# it samples at most half of them.
_SAMPLED_FROM = 4096
# Random seed that selects the sampled directions. It is arbitrary; with another seed, the planner selects slightly
# different numbers of wavelengths and terms.
_SEED = 2


@dataclass(frozen=True)
class DirectionSample:
    """Sample of the illuminated directions of a call, on which the planner measures errors.

    Attributes:
        scattering_vectors: Scattering vectors (u, v, w), shape (n, 3), float64.
        to_lights: Unit vectors to the light in the local frame, shape (n, 3), float64.
        gains: Geometry factors by which the diffracted powers ⟨|P|²⟩ are multiplied, shape (n,).
        weights: Number of directions of the call that each direction of the sample represents, shape (n,).
    """

    scattering_vectors: NDArray[np.float64]
    to_lights: NDArray[np.float64]
    gains: NDArray[np.float64]
    weights: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.gains)

    @classmethod
    def among(
        cls,
        scattering_vectors: NDArray[np.float64],
        to_lights: NDArray[np.floating],
        gains: NDArray[np.floating],
        parts: int = 1,
    ) -> DirectionSample:
        """Return a sample of the illuminated directions of one pass, whose indices are evenly distributed.

        A call with several lights computes each part of its lights in a separate pass. A part is a directional light, a
        disc or the smooth rest of a sky. ``parts`` is the number of these passes, which contribute equal shares to the
        sample of the call.
        """
        illuminated = np.flatnonzero(gains > 0.0)
        places = illuminated[sample_ranks(len(illuminated), parts)]
        weights = np.full(len(places), len(illuminated) / max(len(places), 1))
        return cls(
            scattering_vectors[places].astype(np.float64), to_lights[places].astype(np.float64),
            gains[places].astype(float), weights,
        )  # fmt: skip

    @classmethod
    def joined(cls, parts: Sequence[DirectionSample]) -> DirectionSample:
        """Join the samples of all passes of a call to one sample; a pass computes one part of the lights."""
        weights = np.concatenate([part.weights for part in parts])
        return cls(
            np.concatenate([part.scattering_vectors for part in parts]),
            np.concatenate([part.to_lights for part in parts]), np.concatenate([part.gains for part in parts]), weights,
        )  # fmt: skip

    def some(self, places: NDArray[np.int64], weights: NDArray[np.float64]) -> DirectionSample:
        """Return the sampled directions with the indices ``places``, with ``weights`` as new weights."""
        return DirectionSample(self.scattering_vectors[places], self.to_lights[places], self.gains[places], weights)


def sample_ranks(count: int, parts: int = 1) -> NDArray[np.int64]:
    """Return the indices of the sampled directions for one pass of a call.

    A pass computes the directions of one part of the lights, such as a disc. The call has ``parts`` passes, and this
    pass has ``count`` illuminated directions.
    """
    # The sample of a call is divided equally among ``parts`` passes, each of which computes one part of the lights,
    # such as a disc. Each pass contributes at least one direction. If the call has few directions, all of them are
    # used.
    most = max(min(MOST_SAMPLED // parts, count // 2), 1)
    return np.arange(count) if count * parts < _SAMPLED_FROM else stratified(count, most)


def stratified(count: int, most: int) -> NDArray[np.int64]:
    """Return at most ``most`` ascending indices below ``count``: a random index from each of equally long intervals.

    Indices at a constant step would not suffice: if the directions are pixels of a picture, they could all be in a
    single column or diagonal.
    """
    if count <= most:
        return np.arange(count)
    places = np.arange(most) + np.random.default_rng(_SEED).uniform(size=most)
    return np.unique((places * (count / most)).astype(np.int64))


@dataclass(frozen=True)
class DirectionRange:
    """Range of the illuminated directions, with the scattering vectors (u, v, w), and of the wavelengths of a call.

    Attributes:
        max_uv: Largest |(u, v)|.
        max_order_rate: Largest order rate: how fast orders pass a direction as 1/λ changes, see :func:`order_rate`.
        min_w: Smallest |w|.
        max_w: Largest |w|.
        lambda_min_nm: Shortest wavelength [nm].
        lambda_max_nm: Longest wavelength [nm].
    """

    max_uv: float
    max_order_rate: float
    min_w: float
    max_w: float
    lambda_min_nm: float = LAMBDA_MIN_NM
    lambda_max_nm: float = LAMBDA_MAX_NM

    @classmethod
    def of(
        cls, heightfield: HeightField, coherence: Coherence, scattering_vectors: NDArray[np.float64],
        to_lights: NDArray[np.floating], illuminated: NDArray[np.bool_],
        wavelengths_nm: NDArray[np.float64] | None = None,
    ) -> DirectionRange:  # fmt: skip
        """Return the range of the directions for which the mask ``illuminated`` is True, and of the wavelengths.

        Without ``wavelengths_nm``, the range is that of visible wavelengths.
        """
        band = (float(LAMBDA_MIN_NM), float(LAMBDA_MAX_NM))
        if wavelengths_nm is not None:
            band = (float(wavelengths_nm.min()), float(wavelengths_nm.max()))
        if not illuminated.all():
            scattering_vectors, to_lights = scattering_vectors[illuminated], to_lights[illuminated]
        if not len(scattering_vectors):
            return cls(0.0, 0.0, 0.0, 0.0, *band)
        u, v, w = scattering_vectors.T
        max_uv = max_order_rate = math.sqrt(float(np.max(u * u + v * v)))
        if coherence.sigma_um is None:
            max_order_rate = float(np.max(order_rate(heightfield, coherence, scattering_vectors, to_lights)))
        return cls(max_uv, max_order_rate, float(-w.max()), float(-w.min()), *band)

    def joined(self, other: DirectionRange) -> DirectionRange:
        """Return the range of directions that covers this one and ``other``; ranges without directions are ignored."""
        if other.max_w == 0.0:
            return self
        if self.max_w == 0.0:
            return other
        return DirectionRange(
            max(self.max_uv, other.max_uv), max(self.max_order_rate, other.max_order_rate),
            min(self.min_w, other.min_w), max(self.max_w, other.max_w), min(self.lambda_min_nm, other.lambda_min_nm),
            max(self.lambda_max_nm, other.lambda_max_nm),
        )  # fmt: skip

    @property
    def kappas(self) -> tuple[float, float]:
        """Smallest and largest |κ| = |w|/λ [1/µm], with the normal component w of the scattering vector."""
        return 1e3 * self.min_w / self.lambda_max_nm, 1e3 * self.max_w / self.lambda_min_nm


def order_rate(
    heightfield: HeightField,
    coherence: Coherence,
    scattering_vectors: NDArray[np.float64],
    to_lights: NDArray[np.floating],
) -> NDArray[np.float64]:
    """Return the order rate of n directions: how fast diffraction orders pass a direction as 1/λ changes, shape (n,).

    The rate is |(u, v)| for a coherence window, and |(u Lx, v Ly)| [µm] for replicas of a patch with the sides Lx and
    Ly. For a light source of finite size, the rate is a stretched |(u, v)|. The disc of the source is foreshortened
    along the tangential part of the direction to the light. The component of (u, v) along this part is therefore
    divided by cos θi, where θi is the angle of the light from the normal.
    """
    u, v = scattering_vectors[:, 0], scattering_vectors[:, 1]
    if coherence.kind == "replicas":
        return np.hypot(u * heightfield.size_um[1], v * heightfield.size_um[0])
    if coherence.kind == "source":
        along = (u * to_lights[:, 0] + v * to_lights[:, 1]) / np.maximum(to_lights[:, 2], 1e-6)
        return np.asarray(np.sqrt(u**2 + v**2 + along**2))
    return np.hypot(u, v)


def hemisphere_pairs(count: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two arrays of random unit vectors, uniform over the hemisphere, both of shape (count, 3)."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.0, 1.0, (2, count))
    phi = rng.uniform(0.0, 2.0 * math.pi, (2, count))
    s = np.sqrt(1.0 - z * z)
    pairs = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)
    return pairs[0], pairs[1]
