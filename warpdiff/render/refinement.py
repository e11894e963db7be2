"""Refinement: which pixels are subdivided into cells, to which level, and in which order.

One loop serves both kinds of device. A :class:`TileExecutor` shades the cells. On the CPU, the host lists the tiles of
each level, reports progress and can be cancelled. A GPU lists them itself, as a recorded graph cannot ask the host.
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

# Number of pixels per slice of a launch on the CPU (fitted: launches take a percent of the kernels' time).
SLICE = 32_768


@dataclass(frozen=True)
class RefinementPolicy:
    """The rule by which pixels are subdivided.

    Attributes:
        tolerance: Tolerance of the picture.
        least_level: Level that all pixels are subdivided to.
        refine: Whether pixels are subdivided further where their estimated errors ask for it.
        is_sampled: Whether cells are samples, which are too few at level 1 to tell how they scatter.
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
        """Level whose cells come first, and show which level each tile needs."""
        return max(self.least_level, 2 if self.is_sampled else 1)

    @property
    def most_level(self) -> int:
        """Finest level of tiles."""
        finest = refinement_levels.MOST_LEVEL - (self.tolerance >= refinement_levels.COARSE_TOLERANCE)
        return max(finest, self.base_level) if self.refine else self.base_level

    @property
    def silhouette_level(self) -> int:
        """Level that pixels at silhouettes are subdivided to at least."""
        return pixel_filter.SILHOUETTE_LEVEL if self.refine else 0


@dataclass(frozen=True)
class LightRefinement:
    """One light of a picture whose pixels are refined: its colours by one ray per pixel, and the kernel calls.

    Attributes:
        light_pass: The pass of the light.
        lookup: The look-up of its colours.
        batch: The pixels' own rays under its last lobe.
        sums: Its colours, errors and illuminated pixels, before and after.
        policy: The rule.
        is_first: Whether it is the first light of the picture.
    """

    light_pass: LightPass
    lookup: ColourLookup
    batch: RayBatch
    sums: Accumulators
    policy: RefinementPolicy
    is_first: bool

    @property
    def buffer_kind(self) -> BufferKind:
        """The arrays that cells require."""
        context = self.light_pass.context
        return BufferKind(
            self.lookup.needs_sampling, context.is_pigmented, context.has_materials, self.light_pass.is_sampled
        )

    @property
    def _resolved(self) -> list[wp.array]:
        """Arrays that the cells of a level set."""
        sums = self.sums
        return [sums.xyz, sums.errors, sums.coverage, sums.coverage_levels, sums.illuminated, sums.edges]

    def estimate_errors(self, floor: wp.array, marks: wp.array) -> KernelCall:
        """Return the call that estimates the error of every pixel by one ray, and marks those to subdivide."""
        rays, policy = self.light_pass.context.rays, self.policy
        bound = -1.0 if policy.is_sampled else policy.tolerance
        inputs = [
            self.sums.xyz, self.batch.samples.scattering_vectors, self.batch.gbuffer.pixels.hit, rays.width, floor,
            bound if policy.refine else np.inf, policy.least_level > 0, policy.refine,
        ]  # fmt: skip
        return KernelCall(subdivision.estimate_errors, inputs, [self.sums.errors, marks], in_runs=True)

    def shade_cells(self, level: int, buffers: TileBuffers, sums: subdivision.FilteredSums) -> list[KernelCall]:
        """Return the calls that trace and shade the cells in the buffers, and splat them to the pixels around."""
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
        """Return the call that sets pixels to the sums of the cells around, with their errors."""
        rays = self.light_pass.context.rays
        inputs = [
            group.sums, group.pixels, marks, rays.width, rays.height,
            *((0.0, SCATTER_FACTOR) if self.policy.is_sampled else (ERROR_ORDER, ERROR_PER_CHANGES)),
        ]  # fmt: skip
        return KernelCall(subdivision.resolve_pixels, inputs, self._resolved, in_runs=True)

    def select_levels(self, level: int, group: TileGroup, floor: wp.array, marks: wp.array) -> KernelCall:
        """Return the call that selects finer levels of the tiles that have this level."""
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
    """Pixels that are subdivided together.

    Attributes:
        pixels: Pixels to resolve; empty, on a GPU, is all of the picture.
        tiles: The tiles; empty, on a GPU, is all of the picture that have a level.
        sums: What their cells give, the struct ``FilteredSums`` of the kernels.
        levels: By pixel of the picture, the level of its tile; 0 is none.
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
        floor: Luminance that errors are relative to at least, (1,).
        marks: By pixel, whether it is active, converged or neither.
    """

    floor: wp.array
    marks: wp.array

    @property
    def count(self) -> int:
        """Number of pixels that were subdivided, of the light of which these are most."""

    def keep_tiles(self, *, keep: bool) -> None:
        """Forget what tiles gave; if asked to, keep from now on what they give for finer tolerances."""

    def begin(self, light: LightRefinement) -> None:
        """Begin a light at a tolerance: find the floor."""

    def groups(self, light: LightRefinement) -> Iterator[TileGroup]:
        """Yield the groups of the marked pixels, whose tiles are those pixels and the ones around."""

    def shade(self, level: int, group: Any, light: LightRefinement, progress: Callable[[float], None] | None) -> None:
        """Shade the cells of a group's tiles of a level, and splat them to the pixels around."""

    def launch(self, call: KernelCall, elements: wp.array) -> None:
        """Launch a call over the pixels or tiles of a group, or over the marks of the whole picture."""

    def end(self, light: LightRefinement) -> None:
        """End a light."""


class RefinementLoop:
    """The order in which the pixels of a picture are refined, light after light.

    Attributes:
        tiles: What shades the tiles.
    """

    def __init__(self, tiles: TileExecutor) -> None:
        self.tiles = tiles

    def run(
        self, light: LightRefinement, progress: Callable[[float], None] | None,
        previews: Sequence[tuple[float, Callable[[], None]]] = (),
    ) -> None:  # fmt: skip
        """Refine a light: shade the base level, select the level of each tile, and shade those levels.

        It is first refined to the larger tolerance of each preview, whose function is then called. Previews do not
        change the final picture: each refinement begins from one ray per pixel, and reuses tiles that are shaded
        already.
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
                    # Without the filter, dark pixels next to bright ones would take too many cells.
                    tiles.launch(light.resolve_pixels(group, tiles.marks), group.pixels)
                    tiles.launch(light.select_levels(level, group, tiles.floor, tiles.marks), group.tiles)
            tiles.launch(light.resolve_pixels(group, tiles.marks), group.pixels)
        tiles.end(light)
