"""G-buffers: arrays of what rays hit, for the pixels of a picture and for tiles of subpixel cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import warp as wp

from warpdiff.core.threads import parallel_for
from warpdiff.kernels import refinement_levels
from warpdiff.kernels.colour_lookup import BATCH
from warpdiff.kernels.structs import Footprint, Pixels
from warpdiff.render import pixel_filter

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from warpdiff.device.kernel_calls import Pipeline


@dataclass(frozen=True)
class GBuffer:
    """The G-buffer of rays: hits and frames, and samples of the last light (shadows, scattering vectors, gains).

    ``any_occluded`` is of all lobes of a light together.
    """

    pixels: Any
    occluded: wp.array
    any_occluded: wp.array
    scattering_vectors: wp.array
    to_lights: wp.array
    gains: wp.array
    footprints: wp.array
    material_gains: wp.array

    @classmethod
    def allocate(
        cls, rays: int, *, device: wp.Device, means: bool, coloured: bool = False, materials: bool = False
    ) -> GBuffer:
        """Arrays for so many rays, with footprints if they show ``means``, with base colours if ``coloured``.

        Of several ``materials`` gains are picked, those of one after the other.
        """

        def empty(dtype: Any, size: int = rays) -> Any:
            return wp.empty(size, dtype=dtype, device=device)

        pixels = Pixels()
        pixels.nearest = empty(wp.uint64)
        pixels.hit, pixels.face, pixels.place = empty(wp.int32), empty(wp.int32), empty(wp.vec2f)
        for name in ("tangent", "bitangent", "normal", "to_view", "shadow_origin"):
            setattr(pixels, name, empty(wp.vec3f))
        pixels.base_colour = empty(wp.vec3f, rays * coloured)
        footprints = empty(Footprint, rays if means else 0)
        gains, material_gains = empty(wp.float32), empty(wp.float32, rays * materials)
        occluded = empty(wp.bool), empty(wp.bool)
        return cls(pixels, *occluded, empty(wp.vec3d), empty(wp.vec3f), gains, footprints, material_gains)

    @property
    def directions(self) -> tuple[wp.array, wp.array, wp.array]:
        """Scattering vectors, directions to the light and gains."""
        return self.scattering_vectors, self.to_lights, self.gains


class BufferKind(NamedTuple):
    """Which arrays tile buffers have: of what a table leaves out, base colours, gains of one material of several."""

    needs_sampling: bool
    coloured: bool
    materials: bool


@dataclass(frozen=True)
class TileBuffers:
    """Buffers for the rays of cells: their G-buffer, colours, and the pixels that they belong to.

    Attributes:
        gbuffer: Their G-buffer.
        colours: Theirs.
        unserved_gain: What a table leaves out of them.
        tiles: By level, the pixels whose cells these are.
    """

    gbuffer: GBuffer
    colours: wp.array
    unserved_gain: wp.array
    tiles: dict[int, wp.array]

    @classmethod
    def allocate(cls, rays: int, *, kind: BufferKind, device: wp.Device) -> TileBuffers:
        """Buffers of a kind for so many rays."""
        unserved_gain = wp.empty(rays * kind.needs_sampling, dtype=wp.float32, device=device)
        colours = wp.empty(rays, dtype=wp.vec3f, device=device)
        tiles = {
            level: wp.empty(rays // refinement_levels.rays_at(level), dtype=wp.int32, device=device)
            for level in refinement_levels.LEVELS
        }
        gbuffer = GBuffer.allocate(rays, device=device, means=True, coloured=kind.coloured, materials=kind.materials)
        return cls(gbuffer, colours, unserved_gain, tiles)


class SharedTileBuffers:
    """Tile buffers on the CPU, of which each thread takes a part: the launches over one are those over all.

    Attributes:
        buffers: All of them.
    """

    def __init__(self, parts: int, *, kind: BufferKind, device: wp.Device) -> None:
        """Make so many parts."""
        # Whole pixels of any level, and whole runs of look-ups.
        multiple = math.lcm(refinement_levels.rays_at(refinement_levels.MOST_LEVEL), BATCH)
        self._size = -(-pixel_filter.MOST_RAYS // multiple) * multiple
        rays = parts * self._size
        self.buffers = TileBuffers.allocate(rays, kind=kind, device=device)
        self._nearest = self.buffers.gbuffer.pixels.nearest.numpy()
        self._tiles = {level: tiles.numpy() for level, tiles in self.buffers.tiles.items()}
        self._colours = self.buffers.colours.numpy()
        self._gains = [self.buffers.gbuffer.gains.numpy(), self.buffers.gbuffer.material_gains.numpy()]
        # Appending to and taking from a list are atomic.
        self._free = [part * self._size for part in range(parts)]

    def meet(
        self, level: int, pixels: NDArray[np.int32], pipelines: Sequence[tuple[Pipeline, range]],
        nearest: NDArray[np.uint64], *, threads: int, progress: Callable[[float], None] | None,
    ) -> None:  # fmt: skip
        """Launch pipelines over the cells of pixels at a level, of whose rays ``nearest`` tells the faces.

        Each is for a range of the pixels; it adds colours to zeros, on so many threads, for each of which there is a
        part.
        """
        rays = refinement_levels.rays_at(level)
        slices = [
            (pipeline, range(among.start + part.start, among.start + part.stop))
            for pipeline, among in pipelines
            for part in pixel_filter.slices(len(among), level, threads)
        ]
        # The largest first, so that threads finish together.
        slices.sort(key=lambda piece: -len(piece[1]))

        def work(piece: tuple[Pipeline, range]) -> None:
            pipeline, part = piece
            first = self._free.pop()
            end = first + len(part) * rays
            self._tiles[level][first // rays : end // rays] = pixels[part.start : part.stop]
            self._nearest[first:end] = nearest[part.start * rays : part.stop * rays]
            self._colours[first:end] = 0.0
            # Look-ups take whole runs.
            for gains in self._gains:
                gains[end : -(-end // BATCH) * BATCH] = 0.0
            try:
                pipeline.launch(range(first, end))
            finally:
                self._free.append(first)

        parallel_for(work, slices, threads=threads, progress=progress)
