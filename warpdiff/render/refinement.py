"""Refinement: selection of the pixels that are subdivided into cells, and of the level of each.

One loop serves both kinds of device. A :class:`TileExecutor` shades the cells. On the CPU, the host lists the tiles of
each level, reports progress and can be cancelled. A GPU lists tiles without the host, so that launches can be recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import warp as wp

from warpdiff.core.threads import subprogress
from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import refinement_levels, subdivision
from warpdiff.kernels.refinement_levels import ERROR_ORDER, ERROR_PER_CHANGES, SCATTER_FACTOR
from warpdiff.kernels.structs import Sampling
from warpdiff.render import pixel_filter
from warpdiff.render.tile_buffers import BufferKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from warpdiff.lights.light_pass import LightPass, RayBatch
    from warpdiff.render.accumulators import Accumulators
    from warpdiff.render.tile_buffers import TileBuffers
    from warpdiff.tables.lookup import ColourLookup

# Number of pixels per slice of a launch on the CPU. Fitted: launches then take 1 % of the kernels' time.
SLICE = 32_768


@dataclass(frozen=True)
class RefinementPolicy:
    """Rule by which pixels are subdivided.

    Attributes:
        tolerance: Tolerance of the picture.
        least_level: Level to which all pixels are subdivided.
        refine: Whether pixels with larger estimated errors are subdivided further.
        is_sampled: Whether each cell draws a direction to the light. Level 1 then has too few cells to estimate noise.
    """

    tolerance: float
    least_level: int
    refine: bool
    is_sampled: bool = False

    @property
    def subdivides(self) -> bool:
        """Whether any pixels are subdivided."""
        return self.refine or self.least_level > 0

    @property
    def base_level(self) -> int:
        """Level that is shaded first, and from which the level of each tile is selected."""
        return max(self.least_level, 2 if self.is_sampled else 1)

    @property
    def most_level(self) -> int:
        """Finest level of tiles."""
        finest = refinement_levels.MOST_LEVEL - (self.tolerance >= refinement_levels.COARSE_TOLERANCE)
        return max(finest, self.base_level) if self.refine else self.base_level

    @property
    def silhouette_level(self) -> int:
        """Least level of pixels at silhouettes."""
        return pixel_filter.SILHOUETTE_LEVEL if self.refine else 0


@dataclass(frozen=True)
class LightRefinement:
    """Light of a picture whose pixels are refined: its colours by one ray per pixel, and the kernel calls.

    Attributes:
        light_pass: The pass of the light.
        lookup: Look-up of the light's colours.
        batch: The rays of whole pixels under the last lobe.
        sums: Colours, errors and illuminated pixels of the light, which refinement updates.
        policy: The rule of subdivision.
        is_first: Whether this is the first light of the picture.
    """

    light_pass: LightPass
    lookup: ColourLookup
    batch: RayBatch
    sums: Accumulators
    policy: RefinementPolicy
    is_first: bool

    @property
    def buffer_kind(self) -> BufferKind:
        """Kinds of arrays that the cells require."""
        context = self.light_pass.context
        return BufferKind(
            self.lookup.needs_sampling, context.is_pigmented, context.has_materials, self.light_pass.is_sampled
        )

    @property
    def _resolved(self) -> list[wp.array]:
        """Arrays that ``resolve_pixels`` writes."""
        sums = self.sums
        return [sums.xyz, sums.errors, sums.coverage, sums.coverage_levels, sums.illuminated, sums.edges]

    def estimate_errors(self, floor: wp.array, marks: wp.array) -> KernelCall:
        """Return the kernel call that estimates errors of pixels with one ray, and marks pixels for subdivision."""
        rays, policy = self.light_pass.context.rays, self.policy
        bound = -1.0 if policy.is_sampled else policy.tolerance
        inputs = [
            self.sums.xyz, self.batch.samples.scattering_vectors, self.batch.gbuffer.pixels.hit, rays.width, floor,
            bound if policy.refine else np.inf, policy.least_level > 0, policy.refine,
        ]  # fmt: skip
        return KernelCall(subdivision.estimate_errors, inputs, [self.sums.errors, marks], in_runs=True)

    def shade_cells(self, level: int, buffers: TileBuffers, sums: subdivision.FilteredSums) -> list[KernelCall]:
        """Return kernel calls that trace and shade the cells in the buffers, and splat them to surrounding pixels."""
        rays, batch = self.light_pass.context.rays, buffers.batch(level)
        device = rays.options["device"].alias
        sampling = Sampling()
        sampling.tiles, sampling.places = buffers.tiles[level], pixel_filter.places_at(level, device)
        inputs = [
            batch.xyz, batch.gbuffer.pixels.hit, buffers.tiles[level], self.sums.xyz, sums.ranks,
            pixel_filter.weights_at(level, self.lookup.plan.uses_footprints, device), level,
            level == self.policy.base_level, self.policy.is_sampled,
        ]  # fmt: skip
        outputs = [sums.filtered_sums, sums.quadrants, sums.changes, sums.levels, sums.lighting]
        splat = KernelCall(
            subdivision.splat_cells, inputs, outputs, in_runs=True, block=refinement_levels.rays_at(level)
        )
        return [*rays.calls(sampling, batch.gbuffer), *self.light_pass.shade(batch, self.lookup), splat]

    def resolve_pixels(self, group: TileGroup, marks: wp.array) -> KernelCall:
        """Return the kernel call that sets pixels to weighted sums over the cells of nine tiles."""
        rays = self.light_pass.context.rays
        inputs = [
            group.sums, group.pixels, marks, rays.width, rays.height,
            *((0.0, SCATTER_FACTOR) if self.policy.is_sampled else (ERROR_ORDER, ERROR_PER_CHANGES)),
        ]  # fmt: skip
        return KernelCall(subdivision.resolve_pixels, inputs, self._resolved, in_runs=True)

    def select_levels(self, level: int, group: TileGroup, floor: wp.array, marks: wp.array) -> KernelCall:
        """Return the kernel call that selects the final levels of the tiles that have this level."""
        rays, policy = self.light_pass.context.rays, self.policy
        inputs = [
            group.sums, group.tiles, marks, self.sums.xyz, rays.width, rays.height, floor, policy.tolerance, level,
            policy.most_level,
        ]  # fmt: skip
        if policy.is_sampled:
            return KernelCall(subdivision.raise_levels, inputs, [group.levels], in_runs=True)
        inputs.append(policy.silhouette_level)
        return KernelCall(subdivision.select_levels, inputs, [group.sums.changes, group.levels], in_runs=True)

    def empty_tile_sums(self, tiles: int) -> subdivision.FilteredSums:
        """Return the struct ``FilteredSums`` of the kernels for a number of tiles."""
        device = self.sums.xyz.device
        result = subdivision.FilteredSums()
        result.filtered_sums = wp.empty((tiles, 9), dtype=wp.vec4f, device=device)
        result.quadrants = wp.empty((tiles, 4), dtype=wp.vec3f, device=device)
        result.changes = wp.empty(tiles, dtype=wp.float32, device=device)
        result.levels, result.lighting = (wp.empty(tiles, dtype=wp.uint8, device=device) for _ in range(2))
        result.ranks = wp.empty(0, dtype=wp.int32, device=device)
        result.filter_normalisation = pixel_filter.filter_normalisation_on(
            self.lookup.plan.uses_footprints, device.alias
        )
        return result


@dataclass
class TileGroup:
    """Group of pixels that are subdivided together, with the tiles whose cells they use.

    Attributes:
        pixels: Pixels to resolve; empty, on a GPU, stands for the whole picture.
        tiles: The tiles; empty, on a GPU, stands for all pixels that have a level.
        sums: Sums over the cells of the tiles, the struct ``FilteredSums`` of the kernels.
        levels: For each pixel of the picture, the level of its tile; 0 is no tile.
        share: Beginning and end of the group as shares of the light's progress.
    """

    pixels: wp.array
    tiles: wp.array
    sums: subdivision.FilteredSums
    levels: wp.array
    share: tuple[float, float]


class TileExecutor(Protocol):
    """Executor that shades the tiles which the loop requests.

    Attributes:
        floor: Least luminance that errors are relative to, (1,).
        marks: For each pixel, whether it is subdivided (``ACTIVE``), uses its neighbours' cells (``SHARED``), or
            neither (0).
    """

    floor: wp.array
    marks: wp.array

    @property
    def count(self) -> int:
        """Number of pixels that were subdivided; under several lights, the largest number of a light."""

    def keep_tiles(self, *, keep: bool) -> None:
        """Delete stored results of tiles. With ``keep``, store new ones, for finer tolerances of the same picture."""

    def begin(self, light: LightRefinement) -> None:
        """Begin the refinement of a light at a tolerance: compute the floor of relative errors."""

    def groups(self, light: LightRefinement) -> Iterator[TileGroup]:
        """Yield the groups of the marked pixels; the tiles of a group are these pixels and the eight around each."""

    def shade(self, level: int, group: Any, light: LightRefinement, progress: Callable[[float], None] | None) -> None:
        """Shade the cells of a group's tiles at a level, and splat the cells to surrounding pixels."""

    def launch(self, call: KernelCall, elements: wp.array) -> None:
        """Launch a kernel call over the pixels or tiles of a group, or over all pixels of the picture."""

    def end(self, light: LightRefinement) -> None:
        """Finish the refinement of a light."""


class RefinementLoop:
    """Loop that refines the pixels of a picture, one light after the other.

    Attributes:
        tiles: Executor that shades the tiles.
    """

    def __init__(self, tiles: TileExecutor) -> None:
        self.tiles = tiles

    def run(
        self, light: LightRefinement, progress: Callable[[float], None] | None,
        previews: Sequence[tuple[float, Callable[[], None]]] = (),
    ) -> None:  # fmt: skip
        """Refine a light: shade the base level, select the level of each tile, and shade those levels.

        The light is first refined to the larger tolerance of each preview, and then the preview's callable is called.
        Previews do not change the final picture: each refinement begins from one ray per pixel. Refinements reuse the
        results of tiles that were shaded before.
        """
        unrefined = [array.numpy().copy() for array in light._resolved] if previews else []
        tolerances = [*(tolerance for tolerance, _ in previews), light.policy.tolerance]
        self.tiles.keep_tiles(keep=len(previews) > 0)
        for index, tolerance in enumerate(tolerances):
            part = subprogress(progress, index / len(tolerances), (index + 1) / len(tolerances))
            policy = replace(light.policy, tolerance=tolerance)
            self._subdivide(replace(light, policy=policy), part)
            if index < len(previews):
                previews[index][1]()
                for array, values in zip(light._resolved, unrefined, strict=True):
                    array.numpy()[:] = values

    def _subdivide(self, light: LightRefinement, progress: Callable[[float], None] | None) -> None:
        tiles = self.tiles
        tiles.begin(light)
        tiles.launch(light.estimate_errors(tiles.floor, tiles.marks), tiles.marks)
        policy = light.policy
        for group in tiles.groups(light) if policy.subdivides else ():
            first, last = group.share
            levels = range(policy.base_level, policy.most_level + 1)
            for level in levels:
                begin, end = (first + (last - first) * (level - levels.start + done) / len(levels) for done in (0, 1))
                tiles.shade(level, group, light, subprogress(progress, begin, end))
                if level == policy.base_level or policy.is_sampled:
                    # Levels are selected from filtered colours. Without the filter, dark pixels next to bright ones
                    # would get too many cells.
                    tiles.launch(light.resolve_pixels(group, tiles.marks), group.pixels)
                    tiles.launch(light.select_levels(level, group, tiles.floor, tiles.marks), group.tiles)
            tiles.launch(light.resolve_pixels(group, tiles.marks), group.pixels)
        tiles.end(light)
