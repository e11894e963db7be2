"""Tile buffers: arrays with one entry per subpixel cell, for the rays of many tiles, one tile after the other.

A tile is a pixel that is divided into subpixel cells, with one ray per cell. At level n, a tile has 2ⁿ × 2ⁿ cells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import warp as wp

from warpdiff.core.threads import parallel_for
from warpdiff.kernels import refinement_levels
from warpdiff.kernels.colour_lookup import BATCH
from warpdiff.lights.light_pass import LightSamples, RayBatch
from warpdiff.render import pixel_filter
from warpdiff.scene.gbuffer import GBuffer

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from warpdiff.device.kernel_calls import Pipeline


class BufferKind(NamedTuple):
    """Flags that say which optional arrays tile buffers (arrays of subpixel cells) have.

    The flags are in the order of these optional arrays: geometry factors of directions that a colour table does not
    contain; base colours; geometry factors at faces with the finish (surface and material) that is evaluated, if there
    are several finishes; each ray's own direction to the light; metallic, roughness and emission of textures; and
    samples in the frames of the dots (small rectangles) of grating maps.
    """

    overwrites_gains: bool
    is_pigmented: bool
    has_finishes: bool
    has_directions: bool
    has_maps: bool
    has_dots: bool


@dataclass(frozen=True)
class TileBuffers:
    """Arrays with one entry per subpixel cell, for the rays of the cells of many tiles.

    Attributes:
        gbuffer: Hits of the rays.
        samples: Samples of one lobe (direction to a light) at the hits; the samples of the next lobe overwrite them.
        colours: Colours of the rays, added over the lobes of a light.
        unserved_gain: Geometry factors of directions that a colour table does not contain.
        tiles: For each level, an array of the pixels whose cells are in the buffers. Only the array of the level that
            is shaded at the moment is used.
    """

    gbuffer: GBuffer
    samples: LightSamples
    colours: wp.array
    unserved_gain: wp.array
    tiles: dict[int, wp.array]

    @classmethod
    def allocate(cls, rays: int, *, kind: BufferKind, device: wp.Device) -> TileBuffers:
        """Return uninitialised buffers for a number of rays. ``kind`` states which optional arrays they have."""
        tiles = {
            level: wp.empty(rays // refinement_levels.rays_at(level), dtype=wp.int32, device=device)
            for level in refinement_levels.LEVELS
        }
        return cls(
            GBuffer.allocate(rays, coloured=kind.is_pigmented, has_maps=kind.has_maps, device=device),
            LightSamples.allocate(
                rays,
                means=True,
                has_finishes=kind.has_finishes,
                has_directions=kind.has_directions,
                has_dots=kind.has_dots,
                device=device,
            ),
            wp.empty(rays, dtype=wp.vec3f, device=device),
            wp.empty(rays * kind.overwrites_gains, dtype=wp.float32, device=device),
            tiles,
        )

    def batch(self, level: int) -> RayBatch:
        """Return the cells of one level in the buffers as a batch of rays.

        The batch has no sums of coverage and illumination. These sums are made when cells are added to pixels.
        """
        device = self.colours.device
        coverage, illuminated = (wp.empty(0, dtype=dtype, device=device) for dtype in (wp.float64, wp.bool))
        return RayBatch(
            self.gbuffer, self.samples, self.colours, coverage, illuminated, self.unserved_gain,
            self.tiles[level], level, deviation=pixel_filter.deviation_at(level, means=True),
        )  # fmt: skip


class SharedTileBuffers:
    """Tile buffers (arrays of subpixel cells) on the CPU, in parts; each thread uses one part at a time.

    Attributes:
        buffers: The buffers of all parts, one part after the other.
    """

    def __init__(self, parts: int, *, kind: BufferKind, device: wp.Device) -> None:
        """Allocate buffers that ``parts`` threads can use at the same time."""
        # A part of the buffers is used by one thread at a time. Its size is a multiple of the largest number of cells
        # per pixel, and of the number of rays that look-ups process together (``BATCH``).
        multiple = math.lcm(refinement_levels.rays_at(refinement_levels.MOST_LEVEL), BATCH)
        self._size = -(-pixel_filter.MOST_RAYS // multiple) * multiple
        rays = parts * self._size
        self.buffers = TileBuffers.allocate(rays, kind=kind, device=device)
        self._nearest = self.buffers.gbuffer.pixels.nearest.numpy()
        self._tiles = {level: tiles.numpy() for level, tiles in self.buffers.tiles.items()}
        self._colours = self.buffers.colours.numpy()
        samples = self.buffers.samples
        self._gains = [samples.gains.numpy(), samples.finish_gains.numpy(), *samples.spectral_gains.numpy()]
        # This list has the first index of each free part. Several threads use it without a lock, because the list
        # methods ``append`` and ``pop`` are atomic.
        self._free = [part * self._size for part in range(parts)]

    def shade(
        self, level: int, pixels: NDArray[np.int32], pipeline: Pipeline, nearest: NDArray[np.uint64], *, threads: int,
        progress: Callable[[float], None] | None,
    ) -> None:  # fmt: skip
        """Launch kernel calls over all subpixel cells of some pixels, in slices of pixels that fit a buffer part.

        Args:
            level: Level of the cells.
            pixels: Indices of the pixels to subdivide.
            pipeline: Kernel calls that shade the cells in the buffers. The colours are set to zero before.
            nearest: Index of the nearest face for the ray of each cell, pixel after pixel.
            threads: Number of threads, at most the number of parts.
            progress: Callable that gets the finished fraction; None reports nothing.
        """
        rays = refinement_levels.rays_at(level)

        def work(part: range) -> None:
            first = self._free.pop()
            try:
                end = first + len(part) * rays
                self._tiles[level][first // rays : end // rays] = pixels[part.start : part.stop]
                self._nearest[first:end] = nearest[part.start * rays : part.stop * rays]
                self._colours[first:end] = 0.0
                # Look-ups process batches of ``BATCH`` rays. The last batch of a slice may contain rays after the end
                # of the slice. These rays get the gain 0, so that they contribute nothing.
                for gains in self._gains:
                    gains[end : -(-end // BATCH) * BATCH] = 0.0
                pipeline.launch(range(first, end))
            finally:
                self._free.append(first)

        slices = list(pixel_filter.slices(len(pixels), level, threads))
        parallel_for(work, slices, threads=threads, progress=progress)
