"""What a picture's pixels are lit by, without bringing them all from the device."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.device import Step, launch
from warpdiff.scope import CROWD, Pilots, Scope, equally_far

if TYPE_CHECKING:
    import warp as wp

    from warpdiff.coherence import Coherence
    from warpdiff.heightfield import HeightField

# Pixels that are summed up together.
_BLOCK = 512


class Survey:
    """The scope of the lit ones among deflections, their number, and some of them, equally far apart in their order.

    They are those of ``Scope.of`` and ``Pilots.among``.

    Attributes:
        step: What is to be launched over the deflections before ``found``.
    """

    def __init__(
        self,
        hf: HeightField,
        coherence: Coherence,
        deflections: wp.array,
        to_lights: wp.array,
        gains: wp.array,
        *,
        device: wp.Device,
    ) -> None:
        import warp as wp

        from warpdiff.kernels import directions

        self._seen = deflections, to_lights, gains
        self._device = device
        blocks = -(-len(gains) // _BLOCK)
        self._counts = wp.empty(blocks, dtype=wp.int32, device=device)
        self._ranges = wp.empty(blocks, dtype=wp.vec4d, device=device)
        copies = coherence.kind == "replicas"
        per_uv = (hf.size_um[1], hf.size_um[0]) if copies else (1.0, 1.0)
        inputs = [*self._seen, wp.vec2d(*per_uv), coherence.kind == "source", _BLOCK]
        self.step = Step(directions.sum_up, inputs, [self._counts, self._ranges], in_runs=True, block=_BLOCK)

    def found(self) -> tuple[Scope, int, Pilots]:
        """The scope, the number of lit deflections, and pilots among them."""
        import warp as wp

        from warpdiff.kernels import directions

        before = np.concatenate([[0], np.cumsum(self._counts.numpy(), dtype=np.int64)])
        count = int(before[-1])
        scope = Scope(0.0, 0.0, 0.0, 0.0)
        if count:
            lit = self._ranges.numpy()[np.diff(before) > 0]
            uv, lateral = (math.sqrt(value) for value in lit[:, :2].max(axis=0))
            scope = Scope(uv, lateral, float(lit[:, 2].min()), float(lit[:, 3].max()))
        ranks = equally_far(count, CROWD)
        block = np.searchsorted(before, ranks, side="right") - 1
        picked = [wp.empty(len(ranks), dtype=each.dtype, device=self._device) for each in self._seen]
        places = [wp.array(each, dtype=wp.int32, device=self._device) for each in (block, ranks - before[block])]
        inputs = [*self._seen, *places, _BLOCK]
        launch(directions.pick, len(ranks), inputs, picked, in_runs=True, device=self._device, threads=1)
        return scope, count, Pilots(*(each.numpy().astype(np.float64) for each in picked))
