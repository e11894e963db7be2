"""Refinement on a GPU: lists of pixels to subdivide that the device fills and drains without the host."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import warp as wp

from warpdiff.device.kernel_calls import KernelCall, launch, launch_pipeline
from warpdiff.kernels import refinement_levels, tile_lists
from warpdiff.render.gbuffer import TileBuffers
from warpdiff.render.refinement import SLICE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from warpdiff.render.refinement import LightRefinement

# Rays at a time: a GPU has much memory, and many threads.
_MOST_RAYS = 1 << 20


class DeviceSchedule:
    """Lists of pixels to be split, which the device that finds them works off without the host."""

    def __init__(self, light: LightRefinement, pixels: int) -> None:
        """Room for a picture under lights like this one."""
        options = light.picture.rays.options
        device = options["device"]

        def empty(shape: Any, dtype: Any = wp.int32) -> Any:
            return wp.empty(shape, dtype=dtype, device=device)

        self._device, self._pixels = device, pixels
        self._options: dict[str, Any] = {**options, "slice_size": SLICE}
        self._histogram, self._floor = empty(tile_lists.GROUPS * (1 + tile_lists.BINS)), empty(1, wp.float32)
        self._marks, self._chosen, self._all_pixels = empty(pixels, wp.uint8), empty(pixels, wp.uint8), empty(0)
        self._sums = light.empty_tile_sums(pixels)
        self._tiles, self._tile_count = empty(pixels), empty(1)
        self._marked_count, self._largest_count = empty(1), wp.zeros(1, dtype=wp.int32, device=device)
        self._offset, self._remaining = empty(1), empty(1)
        cells = refinement_levels.rays_at(refinement_levels.MOST_LEVEL)
        rays = -(-min(cells * pixels, _MOST_RAYS) // cells) * cells
        self._buffers = TileBuffers.allocate(rays, kind=light.buffer_kind, device=device)

    @property
    def count(self) -> int:
        """How many pixels were split, of the light of which these are most."""
        return int(self._largest_count.numpy()[0])

    def _launch(self, kernel: Any, inputs: list[Any], outputs: list[Any], size: int | None = None) -> None:
        """Launch a kernel over all pixels, or so many of something."""
        launch(kernel, self._pixels if size is None else size, inputs, outputs, in_runs=True, **self._options)

    def _launch_step(self, step: KernelCall) -> None:
        launch_pipeline([step], self._pixels, **self._options)

    def split(
        self,
        light: LightRefinement,
        _progress: Callable[[float], None] | None,
        _previews: Sequence[tuple[float, Callable[[], None]]],
    ) -> None:
        """Launch what splits pixels until none is left; previews are not made."""
        self._find_floor(light.colours, light.accumulators[1])
        self._marked_count.zero_()
        self._launch_step(light.estimate_errors(self._floor, self._marks))
        if light.subdivides:
            self._split_all(light)
        inputs = [self._marked_count, light.lobes.start == 0]
        wp.launch(tile_lists.running_max, dim=1, inputs=inputs, outputs=[self._largest_count], device=self._device)

    def _split_all(self, light: LightRefinement) -> None:
        shape = [light.picture.rays.width, light.picture.rays.height]
        self._launch(tile_lists.count_marks, [self._marks], [self._marked_count])
        self._launch(tile_lists.dilate_marks, [self._marks, *shape], [self._chosen])
        self._launch(tile_lists.mark_interior, [self._chosen, *shape], [self._marks])
        for level in refinement_levels.LEVELS:
            self._shade(level, light.splat_cells(level, self._buffers, self._sums, shadows=True))
            self._launch_step(light.resolve_pixels(level, self._sums, self._all_pixels, self._floor, self._marks))
            if level < refinement_levels.MOST_LEVEL:
                chosen = light.select_cells(level, self._sums, self._all_pixels, self._floor, self._marks, self._chosen)
                self._launch_step(chosen)

    def _find_floor(self, colours: wp.array, illuminated: wp.array) -> None:
        """Set the floor to that of a picture."""
        self._histogram.zero_()
        self._launch(tile_lists.luminance_histogram, [colours, illuminated], [self._histogram])
        inputs, outputs = [self._histogram], [self._floor]
        wp.launch(tile_lists.luminance_floor, dim=1, inputs=inputs, outputs=outputs, device=self._device)

    def _shade(self, level: int, steps: Sequence[KernelCall]) -> None:
        """Launch steps over the cells of as many chosen pixels as there is room for until none is left; −1 is none."""
        tiles = self._buffers.tiles[level]
        self._tile_count.zero_()
        self._offset.zero_()
        self._launch(tile_lists.compact_marks, [self._chosen], [self._tiles, self._tile_count])

        def advance_batch(count: int) -> None:
            inputs, outputs = [self._tile_count, count], [self._offset, self._remaining]
            wp.launch(tile_lists.advance_batch, dim=1, inputs=inputs, outputs=outputs, device=self._device)

        def shade_batch() -> None:
            self._launch(tile_lists.copy_batch, [self._tiles, self._tile_count, self._offset], [tiles], len(tiles))
            self._buffers.colours.zero_()
            launch_pipeline(steps, len(tiles) * refinement_levels.rays_at(level), device=self._device, threads=1)
            advance_batch(len(tiles))

        advance_batch(0)
        wp.capture_while(self._remaining, shade_batch)
