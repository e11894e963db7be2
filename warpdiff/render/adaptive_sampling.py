"""Adaptive supersampling: pixels split into cells, level after level, on threads of the host or by the device alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.compute.pipeline import KernelCall, Pipeline, launch, launch_pipeline
from warpdiff.kernels import adaptive, cell_levels, work_queues
from warpdiff.render import pixel_filters
from warpdiff.render.gbuffer import TileBuffers, shared_tile_buffers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from warpdiff.render.frame import Frame
    from warpdiff.tables.integrator import Integrator

# Pixels of a slice.
_SLICE = 32_768
# Pixels that are split together, for each of which there are some 40 numbers.
_MOST_PIXELS = 1 << 17
# Rays at a time of a device alone: a GPU has much memory, and many threads.
_MOST_RAYS = 1 << 20


@dataclass(frozen=True)
class LightRefinement:
    """A picture under one light, by one ray a pixel, and how its pixels are split.

    Attributes:
        frame: What rays meet.
        integrator: What colours are from.
        light_index: Which of the picture's lights it is.
        illuminant: Its name.
        colours: XYZ of pixels, before and after.
        errors: What they err by, ‖ΔXYZ‖.
        others: Their coverage, and which are lit.
        tolerance: From which errors, relative to the colour, pixels are split.
        least: The level that all pixels are split to.
        refine: Whether any are split further.
    """

    frame: Frame
    integrator: Integrator
    light_index: int
    illuminant: str
    colours: wp.array
    errors: wp.array
    others: Sequence[wp.array]
    tolerance: float
    least: int
    refine: bool

    @property
    def splits(self) -> bool:
        """Whether any pixels are split."""
        return self.refine or self.least > 0

    @property
    def _bound(self) -> float:
        return pixel_filters.bound_of(self.tolerance) if self.refine else np.inf

    @property
    def levels(self) -> range:
        """Those that pixels may be split to."""
        return range(1, 1 + pixel_filters.last_level_for(self.tolerance, self.least))

    def _goes_on(self, level: int) -> tuple[bool, int]:
        """Whether all pixels are split beyond a level, and to which the rims are."""
        return level < self.least, pixel_filters.RIM_LEVEL if self.refine else 0

    def estimate_errors(self, floor: wp.array, wanted: wp.array) -> KernelCall:
        """The call that estimates the error of every pixel by one ray, and says which are to be split."""
        seen, view, among = self.frame.seen, self.frame.view, self.frame.may_see
        inputs = [
            self.colours, seen.deflections, seen.pixels.hit, view.width, among.start, among.stop, floor, self._bound,
            self.least > 0, self.refine,
        ]  # fmt: skip
        return KernelCall(adaptive.estimate_errors, inputs, [self.errors, wanted], in_runs=True)

    def splat_cells(self, level: int, buffers: TileBuffers, given: Any, *, shadows: bool) -> list[KernelCall]:
        """The calls that shade the cells in the buffers and splat them to the pixels around."""
        means, name = self.integrator.blurs, self.frame.options["device"].alias
        steps = self.frame.steps_of_cells(
            self.integrator, self.light_index, self.illuminant, level, buffers, shadows=shadows
        )
        weights = pixel_filters.weights_at(level, means, name)
        inputs = [
            buffers.colours, buffers.seen.pixels.hit, self.frame.hidden_of(buffers.seen, shadows=shadows),
            buffers.tiles[level], self.colours, self.errors, given.ranks, weights, level,
        ]  # fmt: skip
        outputs = [given.shares, given.means, given.changes, given.levels, given.dark]
        return [
            *steps,
            KernelCall(adaptive.splat_cells, inputs, outputs, in_runs=True, block=cell_levels.rays_at(level)),
        ]

    def resolve_pixels(self, level: int, given: Any, pixels: wp.array, floor: wp.array, wanted: wp.array) -> KernelCall:
        """The call that sets pixels to the sums of the cells around, and compares these with the level before."""
        view = self.frame.view
        # In the end it is not whether to go on that counts, but whether it errs by more, as a rule.
        bound = self._bound
        if self.refine and level == self.levels[-1]:
            bound = pixel_filters.UNSETTLED_FACTOR * self.tolerance
        inputs = [given, pixels, view.width, view.height, floor, bound, level, *self._goes_on(level)]
        return KernelCall(
            adaptive.resolve_pixels, inputs, [self.colours, self.errors, *self.others, wanted], in_runs=True
        )

    def select_cells(
        self, level: int, given: Any, tiles: wp.array, floor: wp.array, wanted: wp.array, chosen: wp.array
    ) -> KernelCall:
        """The call that says which pixels are split again."""
        view = self.frame.view
        inputs = [
            given, tiles, wanted, self.colours, self.others[0], view.width, view.height, floor, self._bound, level,
            *self._goes_on(level),
        ]  # fmt: skip
        return KernelCall(adaptive.select_cells, inputs, [chosen], in_runs=True)

    def empty_shares(self, pixels: int) -> Any:
        """The struct ``Shares`` of the kernels for so many pixels that are split."""
        device = self.frame.options["device"]
        result = adaptive.Shares()
        result.shares = wp.empty((pixels, 9), dtype=wp.vec4f, device=device)
        result.means = wp.empty(pixels, dtype=wp.vec3f, device=device)
        result.changes = wp.empty(pixels, dtype=wp.float32, device=device)
        result.levels, result.dark = (wp.empty(pixels, dtype=wp.uint8, device=device) for _ in range(2))
        result.ranks = wp.empty(0, dtype=wp.int32, device=device)
        result.per_thirds = pixel_filters.per_thirds_on(self.integrator.blurs, device.alias)
        return result


def split(light: LightRefinement, progress: Callable[[float], None] | None = None) -> tuple[int, int]:
    """Split pixels on threads of the host, and say how many there were at first, and in the end."""
    frame = light.frame
    among, options, view = frame.may_see, frame.options, frame.view
    if not among:
        return 0, 0
    device, size = options["device"], view.width * view.height

    def array(values: NDArray[Any], dtype: Any = wp.int32) -> wp.array:
        return wp.array(values, dtype=dtype, device=device, copy=False)

    seen, some = frame.seen, slice(among.start, among.stop)
    least = pixel_filters.floor_of(light.colours, seen.gains, among)
    floor = array(np.array([least], dtype=np.float32), wp.float32)
    is_wanted = np.zeros(size, dtype=np.uint8)
    wanted = array(is_wanted, wp.uint8)
    launch_pipeline([light.estimate_errors(floor, wanted)], among, slice_size=_SLICE, **options)
    if not light.splits:
        return 0, 0
    pixels = (np.flatnonzero(is_wanted[some]) + among.start).astype(np.int32)
    dark = np.zeros(size, dtype=np.uint8)
    unsettled = 0
    threads = min(options["threads"], pixel_filters.most_threads(size))
    frame.expect_cells(light.light_index, len(pixels))
    with shared_tile_buffers(
        threads, leaves_out=light.integrator.leaves_out, coloured=frame.pigmented, device=device
    ) as shared:
        for first in range(0, len(pixels), _MOST_PIXELS):
            part = pixels[first : first + _MOST_PIXELS]
            tiles = np.flatnonzero(pixel_filters.around(part, view.width, view.height)).astype(np.int32)
            given, together = light.empty_shares(len(tiles)), len(part)
            ranks = np.empty(size, dtype=np.int32)
            ranks[tiles] = np.arange(len(tiles), dtype=np.int32)
            given.ranks = array(ranks)
            dark_quadrants = given.dark.numpy()
            is_chosen = np.zeros(size, dtype=np.uint8)
            is_chosen[tiles] = 1
            for level in light.levels:
                # The first cells tell whether a shadow's edge passes: it does not where no light is hidden from them,
                # nor from those beside them. Those together that take shadow rays.
                beside_dark = np.full(size, frame.casts_shadows)
                if level > 1:
                    dark[tiles] |= dark_quadrants[ranks[tiles]]
                    beside_dark = pixel_filters.beside_quadrants(dark, view.width, view.height).ravel()
                tiles = np.concatenate([tiles[~beside_dark[tiles]], tiles[beside_dark[tiles]]])
                for met in pixel_filters.parts(tiles, level):
                    in_light = int(np.count_nonzero(~beside_dark[met]))
                    pipelines = [
                        (Pipeline(light.splat_cells(level, shared.buffers, given, shadows=shadows)), each)
                        for shadows, each in ((False, range(in_light)), (True, range(in_light, len(met))))
                        if each
                    ]
                    nearest = frame.rasterize_cells(
                        pixel_filters.grid_of(met, level, view.width, view.height, device), len(met)
                    )
                    shared.meet(level, met, pipelines, nearest, threads=threads)
                if progress is not None:
                    progress((first + level / len(light.levels) * together) / len(pixels))
                part = part[is_wanted[part] != 0]
                step = light.resolve_pixels(level, given, array(part), floor, wanted)
                launch_pipeline([step], len(part), slice_size=_SLICE, **options)
                if level == light.levels[-1]:
                    unsettled += int(np.count_nonzero(is_wanted[part]))
                    break
                step = light.select_cells(level, given, array(tiles), floor, wanted, array(is_chosen, wp.uint8))
                launch_pipeline([step], len(tiles), slice_size=_SLICE, **options)
                tiles = tiles[is_chosen[tiles] != 0]
                if not len(tiles):
                    break
    return len(pixels), unsettled


class DeviceQueue:
    """Lists of pixels to be split, which the device that finds them works off without the host."""

    def __init__(self, light: LightRefinement, pixels: int) -> None:
        """Room for a picture under lights like this one."""
        options = light.frame.options
        device = options["device"]

        def empty(shape: Any, dtype: Any = wp.int32) -> Any:
            return wp.empty(shape, dtype=dtype, device=device)

        self._device, self._pixels = device, pixels
        self._options: dict[str, Any] = {**options, "slice_size": _SLICE}
        self._tallies, self._floor = empty(work_queues.GROUPS * (1 + work_queues.BINS)), empty(1, wp.float32)
        self._wanted, self._chosen, self._of_all = empty(pixels, wp.uint8), empty(pixels, wp.uint8), empty(0)
        self._given = light.empty_shares(pixels)
        self._listed, self._counts = empty(pixels), empty(1)
        self._found, self._most_found = empty(2), wp.zeros(2, dtype=wp.int32, device=device)
        self._taken, self._left = empty(1), empty(1)
        whole = cell_levels.rays_at(cell_levels.MOST_LEVEL)
        rays = -(-min(whole * pixels, _MOST_RAYS) // whole) * whole
        kind = {"leaves_out": light.integrator.leaves_out, "coloured": light.frame.pigmented}
        self._buffers = TileBuffers.by(rays, **kind, device=device)

    @property
    def counts(self) -> tuple[int, int]:
        """How many pixels were split at first, and in the end, of the light of which these are most."""
        first, last = self._most_found.numpy().tolist()
        return first, last

    def _launch(self, kernel: Any, inputs: list[Any], outputs: list[Any], size: int | None = None) -> None:
        """Launch a kernel over all pixels, or so many of something."""
        launch(kernel, self._pixels if size is None else size, inputs, outputs, in_runs=True, **self._options)

    def _launch_step(self, step: KernelCall) -> None:
        launch_pipeline([step], self._pixels, **self._options)

    def work_off(self, light: LightRefinement) -> None:
        """Launch what splits pixels until none is left."""
        self._find_floor(light.colours, light.frame.seen.gains)
        self._found.zero_()
        self._launch_step(light.estimate_errors(self._floor, self._wanted))
        if light.splits:
            self._split_all(light)
        inputs = [self._found, light.light_index == 0]
        wp.launch(work_queues.keep_larger, dim=2, inputs=inputs, outputs=[self._most_found], device=self._device)

    def _split_all(self, light: LightRefinement) -> None:
        view = light.frame.view
        self._launch(work_queues.count_up, [self._wanted], [self._found[:1]])
        self._launch(work_queues.mark_around, [self._wanted, view.width, view.height], [self._chosen])
        for level in light.levels:
            self._meet(level, light.splat_cells(level, self._buffers, self._given, shadows=True))
            self._launch_step(light.resolve_pixels(level, self._given, self._of_all, self._floor, self._wanted))
            if level < light.levels[-1]:
                chosen = light.select_cells(level, self._given, self._of_all, self._floor, self._wanted, self._chosen)
                self._launch_step(chosen)
        self._launch(work_queues.count_up, [self._wanted], [self._found[1:]])

    def _find_floor(self, colours: wp.array, gains: wp.array) -> None:
        """Set the floor to that of a picture."""
        self._tallies.zero_()
        apart = pixel_filters.luminance_stride(self._pixels)
        self._launch(work_queues.tally, [colours, gains, apart], [self._tallies], -(-self._pixels // apart))
        wp.launch(work_queues.find_floor, dim=1, inputs=[self._tallies], outputs=[self._floor], device=self._device)

    def _meet(self, level: int, steps: Sequence[KernelCall]) -> None:
        """Launch steps over the cells of as many chosen pixels as there is room for until none is left; −1 is none."""
        tiles = self._buffers.tiles[level]
        self._counts.zero_()
        self._taken.zero_()
        self._launch(work_queues.list_up, [self._chosen], [self._listed, self._counts])

        def go_on(count: int) -> None:
            inputs, outputs = [self._counts, count], [self._taken, self._left]
            wp.launch(work_queues.go_on, dim=1, inputs=inputs, outputs=outputs, device=self._device)

        def meet() -> None:
            self._launch(work_queues.take, [self._listed, self._counts, self._taken], [tiles], len(tiles))
            self._buffers.colours.zero_()
            launch_pipeline(steps, len(tiles) * cell_levels.rays_at(level), device=self._device, threads=1)
            go_on(len(tiles))

        go_on(0)
        wp.capture_while(self._left, meet)
