"""Range and sample of the directions that a picture's pixels see, reduced on the device."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.compute.pipeline import KernelCall, launch
from warpdiff.kernels import scattering
from warpdiff.plans.direction_range import DirectionRange, DirectionSample, sample_ranks

if TYPE_CHECKING:
    from warpdiff.optics.coherence import Coherence
    from warpdiff.surface.heightfield import HeightField

# Pixels that are summed up together.
BLOCK = 512


class DirectionStatistics:
    """The scope of the lit ones among deflections, their number, and some of them, spread over their order.

    They are those of ``DirectionRange.of`` and ``DirectionSample.among``.
    """

    def __init__(
        self,
        hf: HeightField,
        coherence: Coherence,
        size: int,
        *,
        device: wp.Device,
    ) -> None:
        """Make room for the summary of ``size`` deflections."""
        self._device = device
        blocks = -(-size // BLOCK)
        self._counts = wp.empty(blocks, dtype=wp.int32, device=device)
        self._ranges = wp.empty(blocks, dtype=wp.vec4d, device=device)
        copies = coherence.kind == "replicas"
        per_uv = (hf.size_um[1], hf.size_um[0]) if copies else (1.0, 1.0)
        self._scope = [wp.vec2d(*per_uv), coherence.kind == "source"]
        self._seen: tuple[wp.array, wp.array, wp.array]

    def step(self, deflections: wp.array, to_lights: wp.array, gains: wp.array) -> KernelCall:
        """The kernel call over the deflections that comes before ``found``."""
        self._seen = deflections, to_lights, gains
        inputs = [*self._seen, *self._scope, BLOCK]
        return KernelCall(scattering.reduce_directions, inputs, [self._counts, self._ranges], in_runs=True, block=BLOCK)

    def found(self, *, parts: int = 1, among: range | None = None) -> tuple[DirectionRange, int, DirectionSample]:
        """The scope, the number of lit deflections, and some of these.

        Args:
            parts: How many passes share the sample; 0 takes none.
            among: Which of all were summed up, from a whole block on.
        """
        first, end = (0, len(self._counts)) if among is None else (among.start // BLOCK, -(-among.stop // BLOCK))
        counts = self._counts.numpy()[first:end]
        count = int(counts.sum(dtype=np.int64))
        if not count:
            return DirectionRange(0.0, 0.0, 0.0, 0.0), 0, DirectionSample.none()
        # Blocks without lit ones neither raise a maximum nor lower a minimum.
        ranges = self._ranges.numpy()[first:end]
        uv2, lateral2, _, max_w = ranges.max(axis=0)
        scope = DirectionRange(math.sqrt(uv2), math.sqrt(lateral2), float(ranges[:, 2].min()), float(max_w))
        if not parts:
            return scope, count, DirectionSample.none()
        before = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
        ranks = sample_ranks(count, parts)
        block = np.searchsorted(before, ranks, side="right") - 1
        picked = [wp.empty(len(ranks), dtype=each.dtype, device=self._device) for each in self._seen]
        places = [
            wp.array(each, dtype=wp.int32, device=self._device) for each in (first + block, ranks - before[block])
        ]
        inputs = [*self._seen, *places, BLOCK]
        launch(scattering.sample_directions, len(ranks), inputs, picked, in_runs=True, device=self._device, threads=1)
        deflections, to_lights, gains = (each.numpy().astype(np.float64) for each in picked)
        weights = np.full(len(ranks), count / len(ranks))
        return scope, count, DirectionSample(deflections, to_lights, gains, weights)
