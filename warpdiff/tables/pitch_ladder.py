"""Look-up of the colours of dots with different pitch scales under an averaged coherence window.

A dot of a grating map has the height field of all dots, the cell, with its lengths multiplied by the pitch scale p. The
power spectrum of a dot under a coherence window of the standard deviation σ is that of the cell under a window of σ/p.
The colours of all dots are therefore interpolated between tables for windows of different widths: the rungs of a
ladder. Neighbouring rungs have equal ratios of σ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import dot_transforms
from warpdiff.tables.lookup import ColourLookup

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import IlluminatedMaterial
    from warpdiff.request.directions import DirectionRange
    from warpdiff.request.plan import Plan

# Rungs per factor of two of σ for a tolerance of 0.1. The error of cubic interpolation is proportional to the fourth
# power of the step, so that the number for other tolerances follows from this one. Measured by
# ``bench/reproduce/grating_maps.py --pitches``. If halved, errors exceed the tolerance; if doubled, so do the tables.
_RUNGS_PER_OCTAVE = 6.0
# Least distance in octaves between two pitch scales that get rungs of their own. Smaller distances would be lost among
# the rounding errors of the logarithm in float32.
_LEAST_GAP = 0.01


@dataclass(frozen=True)
class PitchLadder:
    """Ladder of tables for the pitch scales of a map.

    Attributes:
        octaves: Binary logarithm of the pitch scale of each rung, relative to the smallest pitch scale of the map.
        per_octave: Weights of a rung vanish at two steps from it; this is the number of steps per octave.
        span: Binary logarithm of the ratio of the largest pitch scale to the smallest one.
    """

    octaves: tuple[float, ...]
    per_octave: float
    span: float

    @classmethod
    def of(cls, pitch_scales: NDArray[np.float64], tolerance: float) -> PitchLadder:
        """Return the ladder for the pitch scales of a map and the tolerance of a picture.

        If the map has few different pitch scales, each of them has a rung, and colours are not interpolated.
        """
        places = np.log2(np.unique(pitch_scales))
        places -= places[0]
        span = float(places[-1])
        count = math.ceil(_RUNGS_PER_OCTAVE * (0.1 / tolerance) ** 0.25)
        # Cubic interpolation requires one more rung at each end.
        steps = np.arange(-1, math.ceil(span * count - 1e-9) + 2)
        gaps = np.diff(places)
        if len(places) <= len(steps) and gaps.min() >= _LEAST_GAP:
            return cls(tuple(places.tolist()), 2.0 / float(gaps.min()), span)
        return cls(tuple((steps / count).tolist()), float(count), span)

    def coherences(self, coherence: Coherence) -> list[Coherence]:
        """Return the coherence of the table of each rung, for a coherence of the picture; the longest window first."""
        assert coherence.sigma_um is not None
        return [replace(coherence, sigma_um=coherence.sigma_um * 2.0 ** (self.span - place)) for place in self.octaves]


class LadderLookup(ColourLookup):
    """Look-up of the colours of dots with different pitch scales, interpolated between the tables of a ladder."""

    def __init__(
        self, ladder: PitchLadder, coherence: Coherence, heightfield: HeightField, plan: Plan,
        direction_range: DirectionRange, *, device: wp.Device, threads: int,
    ) -> None:  # fmt: skip
        """Prepare the look-ups of all rungs; tables are computed at the first use.

        ``coherence`` is that of the picture, ``heightfield`` the cell with the largest pitch scale, and ``plan`` a plan
        for the longest window of the ladder, which suffices for the others.
        """
        super().__init__(heightfield, plan, direction_range, device=device, threads=threads)
        self._ladder, self._coherence = ladder, coherence
        self._rungs = [
            ColourLookup(heightfield, replace(plan, coherence=own), direction_range, device=device, threads=threads)
            for own in ladder.coherences(coherence)
        ]

    def copy_with(self, plan: Plan) -> LadderLookup:
        """Return a look-up for the same range of directions by another plan; it has separate tables."""
        return LadderLookup(
            self._ladder, self._coherence, self.heightfield, plan, self._range, device=self.device,
            threads=self._threads,
        )  # fmt: skip

    def kernel_calls(
        self, scattering_vectors: wp.array, to_lights: wp.array, gains: wp.array, illuminated: IlluminatedMaterial,
        xyz: wp.array, footprints: wp.array | None = None, unserved_gain: wp.array | None = None,
    ) -> list[KernelCall]:  # fmt: skip
        """Return the kernel calls of all rungs. Each rung adds its colours, multiplied by its weight for each dot.

        The length of a direction in ``to_lights`` is the pitch scale relative to the smallest one of the map.
        """
        # All rungs write their gains into the same array, because the calls of a slice run one after the other.
        weighed = wp.empty(len(gains), dtype=wp.float32, device=self.device)
        calls = []
        for octaves, rung in zip(self._ladder.octaves, self._rungs, strict=True):
            inputs = [to_lights, gains, octaves, self._ladder.per_octave]
            calls.append(KernelCall(dot_transforms.weigh_gains, inputs, [weighed], in_runs=True))
            calls += rung.kernel_calls(
                scattering_vectors, to_lights, weighed, illuminated, xyz, footprints, unserved_gain
            )
        return calls
