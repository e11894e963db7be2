"""Refinement on the CPU: threads subdivide pixels into cells, level after level."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core.threads import subprogress
from warpdiff.device.kernel_calls import KernelCall, Pipeline, launch_pipeline
from warpdiff.kernels import refinement_levels, subdivision
from warpdiff.render import pixel_filter
from warpdiff.render.gbuffer import SharedTileBuffers
from warpdiff.render.refinement import SLICE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from warpdiff.render.camera_rays import RasterizedRays
    from warpdiff.render.gbuffer import BufferKind
    from warpdiff.render.refinement import LightRefinement

# Pixels that are split together, for each of which there are some 40 numbers.
_MOST_PIXELS = 1 << 17


class HostSchedule:
    """What is split, and when, as the host finds out.

    Attributes:
        count: How many pixels were split, of the light of which these are most.
    """

    def __init__(self, rays: RasterizedRays) -> None:
        """For pictures by these rays."""
        self._rays = rays
        self.count = 0
        # To make them takes as long as to look up thousands of pixels.
        self._buffers: dict[BufferKind, SharedTileBuffers] = {}

    def split(
        self,
        light: LightRefinement,
        progress: Callable[[float], None] | None,
        previews: Sequence[tuple[float, Callable[[], None]]],
    ) -> None:
        """Split pixels until none is left that is to be.

        First for tolerances that are ``previews``, each with what is called then. The picture is the same to the bit:
        each begins anew from pixels of one ray, but finds the cells again that there are.
        """
        cache = _CachedTiles() if previews else None
        before = 0 if light.lobes.start == 0 else self.count
        changing = light.colours, *light.accumulators
        unrefined = [array.numpy().copy() for array in changing] if previews else []
        for index, tolerance in enumerate([*(preview for preview, _ in previews), light.tolerance]):
            part = subprogress(progress, index / (len(previews) + 1), (index + 1) / (len(previews) + 1))
            splitting = _Splitting(replace(light, tolerance=tolerance), self._rays, cache)
            self.count = max(before, splitting.run(self._buffers, part))
            if index < len(previews):
                previews[index][1]()
                for array, values in zip(changing, unrefined, strict=True):
                    array.numpy()[:] = values


@dataclass
class TileGroup:
    """Pixels that are split together.

    Attributes:
        pixels: Those that were to be refined at first, and others that are between their tiles.
        tiles: Pixels whose cells refine these: they, and those around.
        sums: What cells give, the struct ``FilteredSums`` of the kernels.
        ranks: Where in it each pixel of the picture comes.
        chosen: By pixel of the picture, whether it is among the tiles.
    """

    pixels: NDArray[np.int32]
    tiles: NDArray[np.int32]
    sums: Any
    ranks: NDArray[np.int32]
    chosen: NDArray[np.uint8]

    @property
    def results(self) -> list[NDArray[Any]]:
        """What each of the tiles in ``sums`` gives."""
        names = "filtered_sums", "means", "level_difference", "levels", "has_unlit_quadrant", "has_edge"
        return [getattr(self.sums, name).numpy() for name in names]


class _CachedTiles:
    """What cells gave for a coarser tolerance: for a finer one the same tiles would give it again."""

    def __init__(self) -> None:
        # By level: tiles, at which levels each took shadow rays, and what it gave.
        self._by_level: dict[int, tuple[NDArray[np.int32], NDArray[np.uint8], list[NDArray[Any]]]] = {}

    def fill(self, level: int, part: TileGroup, shadowed: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Give tiles of a part what they gave before with as many shadow rays, and say of which there is none."""
        if level not in self._by_level:
            return np.ones(len(part.tiles), dtype=np.bool_)
        tiles, shadowed_before, results = self._by_level[level]
        rows = np.full(part.chosen.shape, -1, dtype=np.int32)
        rows[tiles] = np.arange(len(tiles), dtype=np.int32)
        row = rows[part.tiles]
        is_cached: NDArray[np.bool_] = (row >= 0) & (shadowed_before[row] == shadowed)
        ranks, row = part.ranks[part.tiles[is_cached]], row[is_cached]
        for values, before in zip(part.results, results, strict=True):
            values[ranks] = before[row]
        return ~is_cached

    def store(self, level: int, part: TileGroup, shadowed: NDArray[np.uint8]) -> None:
        """Keep what the tiles of a part gave."""
        ranks = part.ranks[part.tiles]
        self._by_level[level] = part.tiles, shadowed, [values[ranks] for values in part.results]


class _Splitting:
    """A picture's pixels under one light while they are split."""

    def __init__(self, light: LightRefinement, rays: RasterizedRays, cache: _CachedTiles | None) -> None:
        self._light, self._rays, self._cache, self._device = light, rays, cache, rays.options["device"]
        self._width, self._height = rays.width, rays.height
        size = self._width * self._height
        floor = pixel_filter.floor_of(light.colours, light.accumulators[1])
        self._floor = self._array(np.array([floor], dtype=np.float32), wp.float32)
        self._marks = np.zeros(size, dtype=np.uint8)
        self._marks_out = self._array(self._marks, wp.uint8)
        # Of pixels, the quadrants in which any cell is not lit.
        self._unlit_quadrants = np.zeros(size, dtype=np.uint8)
        # A bit for each level at whose cells shadow rays were sent.
        self._shadowed = np.zeros(size, dtype=np.uint8)
        self._threads = min(rays.options["threads"], pixel_filter.most_threads(size))

    def _array(self, values: NDArray[Any], dtype: Any = wp.int32) -> wp.array:
        return wp.array(values, dtype=dtype, device=self._device, copy=False)

    def _launch(self, step: KernelCall, elements: int) -> None:
        launch_pipeline([step], elements, slice_size=SLICE, **self._rays.options)

    def run(self, buffers: dict[BufferKind, SharedTileBuffers], progress: Callable[[float], None] | None) -> int:
        """Split all, by buffers that are made once, and say how many there were."""
        light = self._light
        self._launch(light.estimate_errors(self._floor, self._marks_out), len(self._marks))
        pixels = np.flatnonzero(self._marks).astype(np.int32)
        if not light.subdivides or not len(pixels):
            return 0
        light.picture.prepare_occluders(light.lobes, len(pixels))
        if len(pixels) > _MOST_PIXELS:
            # Tiles between parts see what the part before has changed.
            self._cache = None
        kind = light.buffer_kind
        if kind not in buffers:
            buffers[kind] = SharedTileBuffers(self._threads, kind=kind, device=self._device)
        for first in range(0, len(pixels), _MOST_PIXELS):
            together = min(len(pixels) - first, _MOST_PIXELS)
            part = self._part(pixels[first : first + together])
            for level in refinement_levels.LEVELS:
                ends = (level - 1) / refinement_levels.MOST_LEVEL, level / refinement_levels.MOST_LEVEL
                begin, end = ((first + share * together) / len(pixels) for share in ends)
                self._splat(level, part, buffers[kind], subprogress(progress, begin, end))
                self._compare(level, part)
                if not len(part.tiles):
                    break
        return len(pixels)

    def _part(self, pixels: NDArray[np.int32]) -> TileGroup:
        has_cells = pixel_filter.around(pixels, self._width, self._height)
        tiles = np.flatnonzero(has_cells).astype(np.int32)
        # What needs no cells takes those that are there for the sake of others.
        touched = pixel_filter.around(np.flatnonzero(~has_cells), self._width, self._height).ravel()
        between = np.flatnonzero(~touched & (self._marks == 0)).astype(np.int32)
        self._marks[between] = subdivision.CONVERGED
        pixels = np.concatenate([pixels, between])
        ranks = np.empty_like(self._marks, dtype=np.int32)
        ranks[tiles] = np.arange(len(tiles), dtype=np.int32)
        sums = self._light.empty_tile_sums(len(tiles))
        sums.ranks = self._array(ranks)
        chosen = np.zeros_like(self._marks)
        chosen[tiles] = 1
        return TileGroup(pixels, tiles, sums, ranks, chosen)

    def _splat(
        self, level: int, part: TileGroup, shared: SharedTileBuffers, progress: Callable[[float], None] | None
    ) -> None:
        """Shade the cells of a part at a level, and add them up for the pixels around."""
        # The first cells tell whether a shadow's edge passes: it does not where all of them are lit, and those beside
        # them. What faces away may have a part that does not, from which the light is hidden.
        near_unlit = np.full(self._marks.shape, self._light.picture.casts_shadows)
        if level > 1:
            self._unlit_quadrants[part.tiles] |= part.sums.has_unlit_quadrant.numpy()[part.ranks[part.tiles]]
            near_unlit = pixel_filter.beside_quadrants(self._unlit_quadrants, self._width, self._height).ravel()
        is_near = near_unlit[part.tiles]
        # Tiles change from what they were at the level before, too.
        self._shadowed[part.tiles] |= is_near.astype(np.uint8) << level
        shadowed = self._shadowed[part.tiles]
        is_new = np.ones(len(part.tiles), dtype=np.bool_)
        if self._cache is not None:
            is_new = self._cache.fill(level, part, shadowed)
        new = np.concatenate([part.tiles[is_new & ~is_near], part.tiles[is_new & is_near]])
        batches = list(pixel_filter.parts(new, level))
        for index, batch in enumerate(batches):
            in_light = int(np.count_nonzero(~near_unlit[batch]))
            pipelines = [
                (Pipeline(self._light.splat_cells(level, shared.buffers, part.sums, shadows=shadows)), tiles)
                for shadows, tiles in ((False, range(in_light)), (True, range(in_light, len(batch))))
                if tiles
            ]
            cells = pixel_filter.grid_of(batch, level, self._width, self._height, self._device)
            shared.meet(
                level, batch, pipelines, self._rays.rasterize_cells(cells, len(batch)), threads=self._threads,
                progress=subprogress(progress, index / len(batches), (index + 1) / len(batches)),
            )  # fmt: skip
        if self._cache is not None:
            self._cache.store(level, part, shadowed)

    def _compare(self, level: int, part: TileGroup) -> None:
        """Set the pixels of a part, and leave those of its tiles that are split again."""
        step = self._light.resolve_pixels(level, part.sums, self._array(part.pixels), self._floor, self._marks_out)
        self._launch(step, len(part.pixels))
        if level == refinement_levels.MOST_LEVEL:
            return
        chosen = self._array(part.chosen, wp.uint8)
        step = self._light.select_cells(level, part.sums, self._array(part.tiles), self._floor, self._marks_out, chosen)
        self._launch(step, len(part.tiles))
        part.tiles = part.tiles[part.chosen[part.tiles] != 0]
