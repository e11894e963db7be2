"""Tiles on a GPU: kernels list and count the tiles, without the host, so that launches can be recorded as a graph.

A tile is a pixel that is divided into subpixel cells, with one ray per cell. At level n, a tile has 2ⁿ × 2ⁿ cells.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import warp as wp

from warpdiff.device.kernel_calls import KernelCall, launch, launch_pipeline
from warpdiff.kernels import refinement_levels, tile_lists
from warpdiff.render.refinement import SLICE, TileGroup
from warpdiff.render.tile_buffers import TileBuffers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from warpdiff.render.refinement import LightRefinement

# Largest number of rays (one per subpixel cell) that are shaded in one launch. The number is limited by memory, which
# is proportional to it. With fewer rays, some threads of the GPU would have no work.
_MOST_RAYS = 1 << 20


class DeviceTiles:
    """Executor that shades tiles on a GPU, with launches that can be recorded as a CUDA graph.

    A tile is a pixel that is divided into subpixel cells. If no tile has a certain level of subdivision, the recorded
    launches for this level have no effect.

    Attributes:
        floor: Smallest ‖XYZ‖ by which errors are divided to give relative errors, shape (1,).
        marks: Mark of each pixel: ``ACTIVE`` if its error requires subdivision; ``SHARED`` if the pixel and its eight
            neighbours are subdivided only because of marked pixels near them; otherwise 0.
    """

    def __init__(self, light: LightRefinement) -> None:
        """Allocate all arrays for refining a picture, and further pictures with the same size and options.

        The arrays are not replaced later, because recorded CUDA graphs read them.
        """
        rays = light.light_pass.context.rays
        device = rays.options["device"]

        def empty(shape: int, dtype: type = wp.int32) -> wp.array:
            return wp.empty(shape, dtype=dtype, device=device)

        self._device, self._pixels, self._shape = device, rays.size, [rays.width, rays.height]
        self._options: dict[str, Any] = {**rays.options, "slice_size": SLICE}
        self._histogram, self.floor = empty(tile_lists.GROUPS * (1 + tile_lists.BINS)), empty(1, wp.float32)
        self.marks, levels, everywhere = empty(rays.size, wp.uint8), empty(rays.size, wp.uint8), empty(0)
        self._group = TileGroup(everywhere, everywhere, light.empty_tile_sums(rays.size), levels, (0.0, 1.0))
        self._tiles, self._tile_count = empty(rays.size), empty(1)
        self._marked_count, self._largest_count = empty(1), wp.zeros(1, dtype=wp.int32, device=device)
        self._offset, self._remaining = empty(1), empty(1)
        cells = refinement_levels.rays_at(refinement_levels.MOST_LEVEL)
        ray_count = -(-min(cells * rays.size, _MOST_RAYS) // cells) * cells
        # All lights of the picture use these buffers (arrays with one entry per subpixel cell). Arrays for the
        # directions to a light are allocated even if this light does not require them, because a later light may.
        kind = light.buffer_kind._replace(has_directions=True)
        self._buffers = TileBuffers.allocate(ray_count, kind=kind, device=device)

    @property
    def count(self) -> int:
        """Number of pixels that were subdivided under one light; under several lights, the largest of these numbers."""
        return int(self._largest_count.numpy()[0])

    def _launch(
        self, kernel: wp.Kernel, inputs: list[object], outputs: list[wp.array], size: int | None = None
    ) -> None:
        launch(kernel, self._pixels if size is None else size, inputs, outputs, in_runs=True, **self._options)

    def launch(self, call: KernelCall, elements: wp.array) -> None:  # noqa: ARG002 (of the host's groups)
        """Launch a kernel call over all pixels of the picture."""
        launch_pipeline([call], self._pixels, **self._options)

    def keep_tiles(self, *, keep: bool) -> None:
        """Do nothing: tile results are stored only for previews (larger tolerances), which a GPU does not render."""

    def begin(self, light: LightRefinement) -> None:
        """Begin the refinement under a light: compute the smallest divisor of relative errors by a histogram."""
        self._histogram.zero_()
        self._launch(tile_lists.luminance_histogram, [light.sums.xyz, light.sums.illuminated], [self._histogram])
        inputs, outputs = [self._histogram], [self.floor]
        wp.launch(tile_lists.luminance_floor, dim=1, inputs=inputs, outputs=outputs, device=self._device)
        self._marked_count.zero_()

    def end(self, light: LightRefinement) -> None:
        """Finish the refinement under a light: update :attr:`count`, the largest number of subdivided pixels so far."""
        inputs = [self._marked_count, light.is_first]
        wp.launch(tile_lists.running_max, dim=1, inputs=inputs, outputs=[self._largest_count], device=self._device)

    def groups(self, light: LightRefinement) -> Iterator[TileGroup]:
        """Yield the whole picture as one group. Pixels marked for subdivision and their neighbours are tiles."""
        self._launch(tile_lists.count_marks, [self.marks], [self._marked_count])
        level = light.policy.base_level
        self._launch(tile_lists.dilate_marks, [self.marks, *self._shape, level], [self._group.levels])
        self._launch(tile_lists.mark_shared, [self._group.levels, *self._shape], [self.marks])
        yield self._group

    def shade(
        self, level: int, group: TileGroup, light: LightRefinement,
        progress: Callable[[float], None] | None,  # noqa: ARG002 (of the host)
    ) -> None:  # fmt: skip
        """Shade the subpixel cells of all tiles (subdivided pixels) of a level, in batches that fit the buffers.

        The last batch is filled up with the tile index −1, for which kernels do nothing.
        """
        calls = light.shade_cells(level, self._buffers, group.sums)
        tiles = self._buffers.tiles[level]
        self._tile_count.zero_()
        self._offset.zero_()
        self._launch(tile_lists.compact_level, [group.levels, level], [self._tiles, self._tile_count])

        def advance_batch(count: int) -> None:
            inputs, outputs = [self._tile_count, count], [self._offset, self._remaining]
            wp.launch(tile_lists.advance_batch, dim=1, inputs=inputs, outputs=outputs, device=self._device)

        def shade_batch() -> None:
            self._launch(tile_lists.copy_batch, [self._tiles, self._tile_count, self._offset], [tiles], len(tiles))
            self._buffers.colours.zero_()
            launch_pipeline(calls, len(tiles) * refinement_levels.rays_at(level), device=self._device, threads=1)
            advance_batch(len(tiles))

        advance_batch(0)
        wp.capture_while(self._remaining, shade_batch)
