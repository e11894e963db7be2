"""What a picture's pixels are lit by, without bringing them all from the device."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.device import launch
from warpdiff.scope import CROWD, Pilots, Scope, equally_far

if TYPE_CHECKING:
    import warp as wp

    from warpdiff.coherence import Coherence
    from warpdiff.heightfield import HeightField

# Pixels that are summed up together, and how many such blocks are worth a launch.
_BLOCK, _LEAST_SLICE = 512, 32


def survey(
    hf: HeightField,
    coherence: Coherence,
    deflections: wp.array,
    to_lights: wp.array,
    gains: wp.array,
    *,
    device: wp.Device,
    threads: int,
) -> tuple[Scope, int, Pilots]:
    """The scope of the lit ones among deflections, their number, and some of them, equally far apart in their order.

    They are those of ``Scope.of`` and ``Pilots.among``.
    """
    import warp as wp

    from warpdiff.kernels import directions

    options: dict[str, Any] = {"device": device, "threads": threads, "in_runs": True}
    blocks = -(-len(gains) // _BLOCK)
    counts = wp.empty(blocks, dtype=wp.int32, device=device)
    ranges = wp.empty(blocks, dtype=wp.vec4d, device=device)
    copies = coherence.kind == "replicas"
    per_uv = (hf.size_um[1], hf.size_um[0]) if copies else (1.0, 1.0)
    inputs = [deflections, to_lights, gains, wp.vec2d(*per_uv), coherence.kind == "source", _BLOCK]
    slice_size = max(blocks // (4 * threads), _LEAST_SLICE)
    launch(directions.sum_up, blocks, inputs, [counts, ranges], slice_size=slice_size, **options)
    before = np.concatenate([[0], np.cumsum(counts.numpy(), dtype=np.int64)])
    count = int(before[-1])
    scope = Scope(0.0, 0.0, 0.0, 0.0)
    if count:
        lit = ranges.numpy()[np.diff(before) > 0]
        uv, lateral = (math.sqrt(value) for value in lit[:, :2].max(axis=0))
        scope = Scope(uv, lateral, float(lit[:, 2].min()), float(lit[:, 3].max()))
    ranks = equally_far(count, CROWD)
    block = np.searchsorted(before, ranks, side="right") - 1
    found = [wp.empty(len(ranks), dtype=each.dtype, device=device) for each in (deflections, to_lights, gains)]
    places = [wp.array(each, dtype=wp.int32, device=device) for each in (block, ranks - before[block])]
    launch(directions.pick, len(ranks), [deflections, to_lights, gains, *places, _BLOCK], found, **options)
    return scope, count, Pilots(*(each.numpy().astype(np.float64) for each in found))
