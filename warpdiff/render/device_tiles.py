"""Work queues of pixels to be split, which the device fills and drains without the host."""

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
        options = light.frame.rays.options
        device = options["device"]

        def empty(shape: Any, dtype: Any = wp.int32) -> Any:
            return wp.empty(shape, dtype=dtype, device=device)

        self._device, self._pixels = device, pixels
        self._options: dict[str, Any] = {**options, "slice_size": SLICE}
        self._tallies, self._floor = empty(tile_lists.GROUPS * (1 + tile_lists.BINS)), empty(1, wp.float32)
        self._wanted, self._chosen, self._of_all = empty(pixels, wp.uint8), empty(pixels, wp.uint8), empty(0)
        self._given = light.empty_shares(pixels)
        self._listed, self._counts = empty(pixels), empty(1)
        self._found, self._most_found = empty(1), wp.zeros(1, dtype=wp.int32, device=device)
        self._taken, self._left = empty(1), empty(1)
        whole = refinement_levels.rays_at(refinement_levels.MOST_LEVEL)
        rays = -(-min(whole * pixels, _MOST_RAYS) // whole) * whole
        self._buffers = TileBuffers.allocate(rays, kind=light.buffer_kind, device=device)

    @property
    def count(self) -> int:
        """How many pixels were split, of the light of which these are most."""
        return int(self._most_found.numpy()[0])

    def _launch(self, kernel: Any, inputs: list[Any], outputs: list[Any], size: int | None = None) -> None:
        """Launch a kernel over all pixels, or so many of something."""
        launch(kernel, self._pixels if size is None else size, inputs, outputs, in_runs=True, **self._options)

    def _launch_step(self, step: KernelCall) -> None:
        launch_pipeline([step], self._pixels, **self._options)

    def split(
        self,
        light: LightRefinement,
        _progress: Callable[[float], None] | None,
        _coarser: Sequence[tuple[float, Callable[[], None]]],
    ) -> None:
        """Launch what splits pixels until none is left; nobody is told of what is on the way."""
        self._find_floor(light.colours, light.others[1])
        self._found.zero_()
        self._launch_step(light.estimate_errors(self._floor, self._wanted))
        if light.subdivides:
            self._split_all(light)
        inputs = [self._found, light.lobes.start == 0]
        wp.launch(tile_lists.running_max, dim=1, inputs=inputs, outputs=[self._most_found], device=self._device)

    def _split_all(self, light: LightRefinement) -> None:
        shape = [light.frame.rays.width, light.frame.rays.height]
        self._launch(tile_lists.count_marks, [self._wanted], [self._found])
        self._launch(tile_lists.dilate_marks, [self._wanted, *shape], [self._chosen])
        self._launch(tile_lists.mark_interior, [self._chosen, *shape], [self._wanted])
        for level in refinement_levels.LEVELS:
            self._meet(level, light.splat_cells(level, self._buffers, self._given, shadows=True))
            self._launch_step(light.resolve_pixels(level, self._given, self._of_all, self._floor, self._wanted))
            if level < refinement_levels.MOST_LEVEL:
                chosen = light.select_cells(level, self._given, self._of_all, self._floor, self._wanted, self._chosen)
                self._launch_step(chosen)

    def _find_floor(self, colours: wp.array, illuminated: wp.array) -> None:
        """Set the floor to that of a picture."""
        self._tallies.zero_()
        self._launch(tile_lists.luminance_histogram, [colours, illuminated], [self._tallies])
        wp.launch(tile_lists.luminance_floor, dim=1, inputs=[self._tallies], outputs=[self._floor], device=self._device)

    def _meet(self, level: int, steps: Sequence[KernelCall]) -> None:
        """Launch steps over the cells of as many chosen pixels as there is room for until none is left; −1 is none."""
        tiles = self._buffers.tiles[level]
        self._counts.zero_()
        self._taken.zero_()
        self._launch(tile_lists.compact_marks, [self._chosen], [self._listed, self._counts])

        def advance_batch(count: int) -> None:
            inputs, outputs = [self._counts, count], [self._taken, self._left]
            wp.launch(tile_lists.advance_batch, dim=1, inputs=inputs, outputs=outputs, device=self._device)

        def meet() -> None:
            self._launch(tile_lists.copy_batch, [self._listed, self._counts, self._taken], [tiles], len(tiles))
            self._buffers.colours.zero_()
            launch_pipeline(steps, len(tiles) * refinement_levels.rays_at(level), device=self._device, threads=1)
            advance_batch(len(tiles))

        advance_batch(0)
        wp.capture_while(self._left, meet)
