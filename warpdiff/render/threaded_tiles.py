"""Tiles on the CPU: the host lists the tiles of each level, and threads shade them in slices.

A tile is a pixel that is divided into subpixel cells, with one ray per cell. At level n, a tile has 2ⁿ × 2ⁿ cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core.threads import subprogress
from warpdiff.device.kernel_calls import KernelCall, Pipeline, launch_pipeline
from warpdiff.kernels import pixel_contrast
from warpdiff.render import pixel_filter
from warpdiff.render.refinement import SLICE, TileGroup
from warpdiff.render.tile_buffers import SharedTileBuffers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from warpdiff.render.refinement import LightRefinement
    from warpdiff.render.tile_buffers import BufferKind
    from warpdiff.scene.camera_rays import RasterizedRays

# Largest number of pixels that are subdivided together. The number is limited by memory: each of their tiles requires
# about 200 bytes.
_MOST_PIXELS = 1 << 17


@dataclass
class HostTileGroup(TileGroup):
    """Group of pixels that are computed together from subpixel cells, with arrays that the host reads.

    Attributes:
        tile_indices: Indices of the pixels that are subdivided for the group.
        ranks: For each pixel of the picture that is subdivided, its index in the arrays of sums over cells.
        host_levels: The same memory as ``levels``, as a NumPy array.
    """

    tile_indices: NDArray[np.int32]
    ranks: NDArray[np.int32]
    host_levels: NDArray[np.uint8]

    def results(self, *, is_base: bool) -> list[NDArray[Any]]:
        """Return the arrays that are filled when tiles (subdivided pixels) are shaded: sums over their cells.

        ``is_base`` states whether the cells are those of the coarsest level. The mean colours of the quadrants of the
        pixels are then included.
        """
        names = "filtered_sums", "levels", "lighting", "changes", *(("quadrants",) if is_base else ())
        return [getattr(self.sums, name).numpy() for name in names]


class _ShadedTiles:
    """Cache of shaded tiles (pixels divided into cells): for each level, sums over the cells of each tile.

    The sums do not depend on the tolerance of a picture, and are reused when the same picture is refined to a smaller
    tolerance.
    """

    def __init__(self) -> None:
        # For each level of subdivision: the indices of the shaded tiles, and copies of the sums over their cells.
        self._by_level: dict[int, tuple[NDArray[np.int32], list[NDArray[Any]]]] = {}

    def fill(
        self, level: int, group: HostTileGroup, tiles: NDArray[np.int32], *, is_base: bool
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Copy cached sums over the cells of tiles into a group. Return a mask of the tiles that are not cached.

        A tile is a pixel that is divided into cells. A group is a set of pixels that are computed together.
        """
        if level not in self._by_level:
            return np.ones(len(tiles), dtype=np.bool_)
        before, results = self._by_level[level]
        rows = np.full(group.host_levels.shape, -1, dtype=np.int32)
        rows[before] = np.arange(len(before), dtype=np.int32)
        row = rows[tiles]
        is_known: NDArray[np.bool_] = row >= 0
        ranks, row = group.ranks[tiles[is_known]], row[is_known]
        for values, known in zip(group.results(is_base=is_base), results, strict=True):
            values[ranks] = known[row]
        return ~is_known

    def store(self, level: int, group: HostTileGroup, tiles: NDArray[np.int32], *, is_base: bool) -> None:
        """Store copies of the summed colours of the subpixel cells of some tiles at a level."""
        ranks = group.ranks[tiles]
        self._by_level[level] = tiles, [values[ranks] for values in group.results(is_base=is_base)]


class ThreadedTiles:
    """Executor that shades tiles (subdivided pixels) on the CPU: the host lists the tiles of each level.

    Attributes:
        count: Number of pixels that were subdivided under one light; under several lights, the largest of these
            numbers.
        floor: Smallest ‖XYZ‖ by which errors are divided to give relative errors, shape (1,).
        marks: Mark of each pixel: ``ACTIVE`` if its error requires subdivision; ``SHARED`` if the pixel and its eight
            neighbours are subdivided only because of marked pixels near them; otherwise 0.
    """

    def __init__(self, rays: RasterizedRays) -> None:
        """Prepare the executor for pictures with these camera rays."""
        self._rays, self._device = rays, rays.options["device"]
        self.count = 0
        self._threads = min(rays.options["threads"], pixel_filter.most_threads(rays.size))
        # Buffers (arrays of subpixel cells) are stored for later pictures, because their allocation takes as much time
        # as thousands of look-ups.
        self._buffers: dict[BufferKind, SharedTileBuffers] = {}
        self._shaded: _ShadedTiles | None = None

    def _array(self, values: NDArray[Any], dtype: Any = wp.int32) -> wp.array:
        return wp.array(values, dtype=dtype, device=self._device, copy=False)

    def keep_tiles(self, *, keep: bool) -> None:
        """Delete the stored results of tiles (subdivided pixels). If ``keep`` is True, store results from now on.

        Results at the tolerance of a preview are reused at the next, smaller tolerance.
        """
        self._shaded = _ShadedTiles() if keep else None

    def begin(self, light: LightRefinement) -> None:
        """Begin the refinement under a light: compute ``floor``, the smallest divisor of relative errors."""
        self.count = 0 if light.is_first else self.count
        floor = pixel_filter.floor_of(light.sums.xyz, light.sums.illuminated)
        self.floor = self._array(np.array([floor], dtype=np.float32), wp.float32)
        self._marked = np.zeros(self._rays.size, dtype=np.uint8)
        self.marks = self._array(self._marked, wp.uint8)

    def end(self, light: LightRefinement) -> None:
        """Do nothing; only the executor on a GPU has work at the end of the refinement under a light."""

    def launch(self, call: KernelCall, elements: wp.array) -> None:
        """Launch a kernel call over ``elements``, which are pixels or tiles (subdivided pixels), in slices."""
        launch_pipeline([call], len(elements), slice_size=SLICE, **self._rays.options)

    def groups(self, light: LightRefinement) -> Iterator[HostTileGroup]:
        """Yield groups of the pixels that are marked for subdivision, with all pixels that a group subdivides."""
        pixels = np.flatnonzero(self._marked).astype(np.int32)
        self.count = max(self.count, len(pixels))
        if not len(pixels):
            return
        if len(pixels) > _MOST_PIXELS:
            # Sums over cells are usually stored and reused at the next, smaller tolerance. If there are several groups,
            # this is not possible: the sums of a group depend on colours of pixels that the previous group has changed,
            # and thus on the tolerance.
            self.keep_tiles(keep=False)
        for first in range(0, len(pixels), _MOST_PIXELS):
            last = min(first + _MOST_PIXELS, len(pixels))
            yield self._group(light, pixels[first:last], (first / len(pixels), last / len(pixels)))

    def _group(self, light: LightRefinement, pixels: NDArray[np.int32], share: tuple[float, float]) -> HostTileGroup:
        width, height = self._rays.width, self._rays.height
        has_cells = pixel_filter.around(pixels, width, height)
        tiles = np.flatnonzero(has_cells).astype(np.int32)
        # A pixel that is not marked can still be computed from cells, if the pixel itself and its eight neighbours are
        # subdivided for other, marked pixels. It gets the mark ``SHARED``.
        touched = pixel_filter.around(np.flatnonzero(~has_cells), width, height).ravel()
        between = np.flatnonzero(~touched & (self._marked == 0)).astype(np.int32)
        self._marked[between] = pixel_contrast.SHARED
        ranks = np.empty_like(self._marked, dtype=np.int32)
        ranks[tiles] = np.arange(len(tiles), dtype=np.int32)
        sums = light.empty_tile_sums(len(tiles))
        sums.ranks = self._array(ranks)
        levels = np.zeros_like(self._marked)
        levels[tiles] = light.policy.base_level
        return HostTileGroup(
            self._array(np.concatenate([pixels, between])), self._array(tiles), sums, self._array(levels, wp.uint8),
            share, tiles, ranks, levels,
        )  # fmt: skip

    def shade(
        self, level: int, group: HostTileGroup, light: LightRefinement, progress: Callable[[float], None] | None
    ) -> None:
        """Shade the cells of a group's tiles (subdivided pixels) at ``level``, and add their colours to its sums."""
        width, height = self._rays.width, self._rays.height
        tiles = group.tile_indices[group.host_levels[group.tile_indices] == level]
        is_base, is_new = level == light.policy.base_level, np.ones(len(tiles), dtype=np.bool_)
        if self._shaded is not None:
            is_new = self._shaded.fill(level, group, tiles, is_base=is_base)
        buffers = self._buffers_of(light.buffer_kind)
        pipeline = Pipeline(light.shade_cells(level, buffers.buffers, group.sums))
        batches = list(pixel_filter.parts(tiles[is_new], level))
        for index, batch in enumerate(batches):
            cells = pixel_filter.grid_of(batch, level, width, height, self._device)
            buffers.shade(
                level, batch, pipeline, self._rays.rasterize_cells(cells, len(batch)), threads=self._threads,
                progress=subprogress(progress, index / len(batches), (index + 1) / len(batches)),
            )  # fmt: skip
        if self._shaded is not None:
            self._shaded.store(level, group, tiles, is_base=is_base)

    def _buffers_of(self, kind: BufferKind) -> SharedTileBuffers:
        if kind not in self._buffers:
            self._buffers[kind] = SharedTileBuffers(self._threads, kind=kind, device=self._device)
        return self._buffers[kind]
