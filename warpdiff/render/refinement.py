"""Refinement: selection of the pixels that are subdivided into cells, and of the level of each.

A tile is a pixel that is divided into subpixel cells, with one ray per cell. At level n, a tile has 2ⁿ × 2ⁿ cells. The
base level is the level of the first cells of a tile.

:class:`RefinementLoop` is the same for the CPU and GPUs; a :class:`TileExecutor` shades the cells. On the CPU, the host
lists the tiles of each level, reports progress, and stops if the caller cancels. On a GPU, kernels list the tiles
without the host, so that launches can be recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import warp as wp

from warpdiff.core.threads import subprogress
from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import dot_transforms, pixel_contrast, refinement_levels, subdivision
from warpdiff.kernels.refinement_levels import ERROR_ORDER, ERROR_PER_CHANGES, SCATTER_FACTOR
from warpdiff.kernels.structs import Sampling
from warpdiff.render import pixel_filter
from warpdiff.render.tile_buffers import BufferKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from warpdiff.lights.light_pass import LightPass, RayBatch
    from warpdiff.render.accumulators import Accumulators
    from warpdiff.render.tile_buffers import TileBuffers
    from warpdiff.tables.lookup import Lookups

# Number of pixels that one thread processes in one launch on the CPU (a slice). The value was fitted so that launches
# add 1 % to the time of the kernels.
SLICE = 32_768


@dataclass(frozen=True)
class RefinementPolicy:
    """Rule by which pixels are subdivided into cells. At level n, a pixel has 2ⁿ × 2ⁿ cells.

    Attributes:
        tolerance: Tolerance of the picture, or of a preview.
        least_level: Level to which all pixels are subdivided.
        refine: Whether pixels with larger estimated errors are subdivided further.
        is_sampled: Whether each cell draws a direction to the light at random.
        first_level: Level of the first subdivision of a tile under this light, unless ``least_level`` is higher.
            Colours of these first cells decide whether the tile is subdivided further. Lights whose directions are
            random require more first cells.
        has_dots: Whether a surface has a grating map. Colours then change abruptly within pixels.
    """

    tolerance: float
    least_level: int
    refine: bool
    is_sampled: bool = False
    first_level: int = 1
    has_dots: bool = False

    @property
    def measures_scatter(self) -> bool:
        """Whether errors are estimated from the noise of the cells' colours, not from smooth changes over a pixel."""
        return self.is_sampled or self.has_dots

    @property
    def subdivides(self) -> bool:
        """Whether pixels are subdivided at all."""
        return self.refine or self.least_level > 0

    @property
    def base_level(self) -> int:
        """Level of the first cells of a tile (subdivided pixel); their colours determine the tile's final level."""
        return max(self.least_level, self.first_level)

    @property
    def most_level(self) -> int:
        """Finest level to which tiles (subdivided pixels) may be refined."""
        finest = refinement_levels.MOST_LEVEL - (self.tolerance >= refinement_levels.COARSE_TOLERANCE)
        return max(finest, self.base_level) if self.refine else self.base_level

    @property
    def silhouette_level(self) -> int:
        """Smallest final level of subdivision of a pixel if the outline of the mesh passes through it."""
        return pixel_filter.SILHOUETTE_LEVEL if self.refine else 0


@dataclass(frozen=True)
class LightRefinement:
    """Inputs for refining the pixels under one light; the methods make the kernel calls of the refinement.

    Refinement starts from colours that were computed by one ray per pixel.

    Attributes:
        light_pass: Pass that samples the light and looks up its colours.
        lookups: Look-ups of the colours of the surfaces.
        batch: One ray for each pixel, whose colours are computed already.
        sums: Colours, errors and illuminated pixels of the light, which refinement updates.
        policy: Rule by which pixels are subdivided.
        is_first: Whether this is the first light of the picture.
    """

    light_pass: LightPass
    lookups: Lookups
    batch: RayBatch
    sums: Accumulators
    policy: RefinementPolicy
    is_first: bool

    @property
    def buffer_kind(self) -> BufferKind:
        """Flags that say which optional arrays of tile buffers (arrays of subpixel cells) this light requires."""
        context = self.light_pass.context
        return BufferKind(
            self.lookups.overwrites_gains, context.is_pigmented, context.has_finishes, self.light_pass.has_directions,
            context.has_maps, context.dots is not None,
        )  # fmt: skip

    @property
    def _resolved(self) -> list[wp.array]:
        """Arrays with one value per pixel, which refinement overwrites with the sums over the cells of each pixel."""
        sums = self.sums
        return [sums.xyz, sums.errors, sums.coverage, sums.coverage_levels, sums.illuminated, sums.edges]

    @property
    def _cells_are_means(self) -> bool:
        """Whether subpixel cells show means over their filter: means over footprints, or means of textures."""
        return self.lookups.uses_footprints or self.light_pass.context.is_textured

    def estimate_errors(self, floor: wp.array, marks: wp.array) -> KernelCall:
        """Return the kernel call that estimates errors from one ray per pixel, and marks pixels for subdivision."""
        context, policy, pixels = self.light_pass.context, self.policy, self.batch.gbuffer.pixels
        bound = -1.0 if policy.is_sampled else policy.tolerance
        inputs = [
            self.sums.xyz, self.batch.samples.signals, pixels.hit,
            pixels.base_colour if context.is_textured else context.no_colours, pixels.metallic_roughness,
            pixels.emission, context.rays.width, floor,
            bound if policy.refine else np.inf, policy.least_level > 0, policy.refine,
        ]  # fmt: skip
        return KernelCall(pixel_contrast.estimate_errors, inputs, [self.sums.errors, marks], in_runs=True)

    def mark_edges_of_dots(self, floor: wp.array, marks: wp.array) -> KernelCall | None:
        """Return the kernel call that marks pixels near edges of a grating map's dots for subdivision.

        Dots are small rectangles of a surface, each with a grating of its own. :meth:`estimate_errors` does not find
        their edges. The result is None without a grating map, without refinement, or if directions to the light are
        drawn at random.
        """
        policy, samples = self.policy, self.batch.samples
        if samples.of_dots is None or policy.is_sampled or not policy.refine:
            return None
        rays, hit = self.light_pass.context.rays, self.batch.gbuffer.pixels.hit
        inputs = [samples.signals, self.sums.xyz, hit, rays.width, floor, policy.tolerance]
        return KernelCall(dot_transforms.mark_edges_of_dots, inputs, [self.sums.errors, marks], in_runs=True)

    def shade_cells(self, level: int, buffers: TileBuffers, sums: subdivision.FilteredSums) -> list[KernelCall]:
        """Return the kernel calls that trace and shade the subpixel cells in the buffers.

        They also add each cell to the weighted sums of nine pixels: its own and the eight pixels around it.
        """
        rays, batch = self.light_pass.context.rays, buffers.batch(level)
        device = rays.options["device"].alias
        sampling = Sampling()
        sampling.tiles, sampling.places = buffers.tiles[level], pixel_filter.places_at(level, device)
        inputs = [
            batch.xyz, batch.gbuffer.pixels.hit, buffers.tiles[level], self.sums.xyz, sums.ranks,
            pixel_filter.weights_at(level, self._cells_are_means, device), level,
            level == self.policy.base_level, self.policy.measures_scatter,
        ]  # fmt: skip
        outputs = [sums.filtered_sums, sums.quadrants, sums.changes, sums.levels, sums.lighting]
        splat = KernelCall(
            subdivision.splat_cells, inputs, outputs, in_runs=True, block=refinement_levels.rays_at(level)
        )
        return [
            *rays.calls(sampling, batch.gbuffer, batch.deviation),
            *self.light_pass.shade(batch, self.lookups),
            splat,
        ]

    def resolve_pixels(self, group: TileGroup, marks: wp.array) -> KernelCall:
        """Return the kernel call that replaces the colours of pixels by weighted sums over cells.

        The sums include the cells of the pixel itself and of the eight pixels around it.
        """
        rays = self.light_pass.context.rays
        inputs = [
            group.sums, group.pixels, marks, rays.width, rays.height,
            *((0.0, SCATTER_FACTOR) if self.policy.measures_scatter else (ERROR_ORDER, ERROR_PER_CHANGES)),
        ]  # fmt: skip
        return KernelCall(subdivision.resolve_pixels, inputs, self._resolved, in_runs=True)

    def select_levels(self, level: int, group: TileGroup, floor: wp.array, marks: wp.array) -> KernelCall:
        """Return the kernel call that selects the tiles at ``level`` that are divided further, and their next level.

        A tile is a pixel that is divided into subpixel cells. At level n, it has 2ⁿ × 2ⁿ cells.
        """
        rays, policy = self.light_pass.context.rays, self.policy
        inputs = [
            group.sums, group.tiles, marks, self.sums.xyz, rays.width, rays.height, floor, policy.tolerance, level,
            policy.most_level,
        ]  # fmt: skip
        if policy.measures_scatter:
            inputs.insert(4, self.sums.errors)
            return KernelCall(subdivision.raise_levels, inputs, [group.levels], in_runs=True)
        inputs.append(policy.silhouette_level)
        return KernelCall(subdivision.select_levels, inputs, [group.sums.changes, group.levels], in_runs=True)

    def empty_tile_sums(self, tiles: int) -> subdivision.FilteredSums:
        """Return the struct ``FilteredSums`` with uninitialised arrays, to which kernels add colours of cells."""
        device = self.sums.xyz.device
        result = subdivision.FilteredSums()
        result.filtered_sums = wp.empty((tiles, 9), dtype=wp.vec4f, device=device)
        result.quadrants = wp.empty((tiles, 4), dtype=wp.vec3f, device=device)
        result.changes = wp.empty(tiles, dtype=wp.float32, device=device)
        result.levels, result.lighting = (wp.empty(tiles, dtype=wp.uint8, device=device) for _ in range(2))
        result.ranks = wp.empty(0, dtype=wp.int32, device=device)
        result.filter_normalisation = pixel_filter.filter_normalisation_on(self._cells_are_means, device.alias)
        return result


@dataclass
class TileGroup:
    """Group of pixels that are computed together from subpixel cells, and the tiles that contain these cells.

    Attributes:
        pixels: Pixels whose colours are computed from cells. On a GPU the array is empty, and the marks of pixels are
            used instead.
        tiles: Pixels that are divided into cells for the group. On a GPU the array is empty, and ``levels`` is used
            instead.
        sums: Sums over the cells of the tiles, the struct ``FilteredSums`` of the kernels.
        levels: For each pixel of the picture, the level of its tile; 0 is no tile.
        share: Beginning and end of the group, as fractions of the light's progress.
    """

    pixels: wp.array
    tiles: wp.array
    sums: subdivision.FilteredSums
    levels: wp.array
    share: tuple[float, float]


class TileExecutor(Protocol):
    """Interface of executors, which shade the tiles (subdivided pixels) that :class:`RefinementLoop` requests.

    Attributes:
        floor: Smallest ‖XYZ‖ by which errors are divided to give relative errors, shape (1,).
        marks: Mark of each pixel: ``ACTIVE`` if its error requires subdivision; ``SHARED`` if the pixel and its eight
            neighbours are subdivided only because of marked pixels near them; otherwise 0.
    """

    floor: wp.array
    marks: wp.array

    @property
    def count(self) -> int:
        """Number of pixels that were subdivided under one light; under several lights, the largest of these numbers."""

    def keep_tiles(self, *, keep: bool) -> None:
        """Delete the stored results of tiles (subdivided pixels). If ``keep`` is True, store results from now on.

        Results at the tolerance of a preview are reused at the next, smaller tolerance.
        """

    def begin(self, light: LightRefinement) -> None:
        """Begin to refine a light at a tolerance: compute ``floor``, the smallest divisor of relative errors."""

    def groups(self, light: LightRefinement) -> Iterator[TileGroup]:
        """Yield groups of marked pixels. Each group subdivides its pixels and the eight pixels around each of them.

        A mark states that the error of a pixel requires subdivision into cells.
        """

    def shade(self, level: int, group: Any, light: LightRefinement, progress: Callable[[float], None] | None) -> None:
        """Shade the cells of a group's tiles (subdivided pixels) at ``level``, and add them to the group's sums."""

    def launch(self, call: KernelCall, elements: wp.array) -> None:
        """Launch a kernel call over ``elements``: pixels or tiles (subdivided pixels) of a group.

        A GPU launches it over all pixels of the picture instead.
        """

    def end(self, light: LightRefinement) -> None:
        """Finish the refinement of a light."""


class RefinementLoop:
    """Loop that refines the pixels of a picture, one light after the other.

    Attributes:
        tiles: Executor for the device of the picture.
    """

    def __init__(self, tiles: TileExecutor) -> None:
        self.tiles = tiles

    def run(
        self, light: LightRefinement, progress: Callable[[float], None] | None,
        previews: Sequence[tuple[float, Callable[[], None]]] = (),
    ) -> None:  # fmt: skip
        """Refine a light: shade all tiles at the base level, select levels by errors, and shade tiles there.

        A tile is a pixel that is divided into cells. The base level is the level of its first cells. With previews, the
        light is first refined to the larger tolerance of each preview, and the preview's callable is called. Previews
        do not change the final picture, because each refinement begins again from one ray per pixel. Cells that were
        shaded for an earlier tolerance are reused.
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
        if (mark_more := light.mark_edges_of_dots(tiles.floor, tiles.marks)) is not None:
            tiles.launch(mark_more, tiles.marks)
        policy = light.policy
        for group in tiles.groups(light) if policy.subdivides else ():
            first, last = group.share
            levels = range(policy.base_level, policy.most_level + 1)
            for level in levels:
                begin, end = (first + (last - first) * (level - levels.start + done) / len(levels) for done in (0, 1))
                tiles.shade(level, group, light, subprogress(progress, begin, end))
                if level == policy.base_level or policy.measures_scatter:
                    # Levels of subdivision are selected by errors relative to the colours of pixels. The colours are
                    # therefore filtered first. Without the filter, a dark pixel next to a bright one is darker. Its
                    # relative error would be too large, and it would get too many cells.
                    tiles.launch(light.resolve_pixels(group, tiles.marks), group.pixels)
                    tiles.launch(light.select_levels(level, group, tiles.floor, tiles.marks), group.tiles)
            tiles.launch(light.resolve_pixels(group, tiles.marks), group.pixels)
        tiles.end(light)
