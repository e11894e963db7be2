"""Adaptive supersampling: kernel calls that select pixels to subdivide, shade their cells, and compare levels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import refinement_levels, subdivision
from warpdiff.render import pixel_filter
from warpdiff.render.gbuffer import BufferKind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpdiff.render.gbuffer import TileBuffers
    from warpdiff.render.picture import Picture
    from warpdiff.tables.lookup import ColourLookup

# Pixels of a slice.
SLICE = 32_768


@dataclass(frozen=True)
class LightRefinement:
    """A picture under one light, by one ray a pixel, and how its pixels are split.

    Attributes:
        picture: The picture.
        lookup: What colours are from.
        lobes: Which of the picture's lobes it has.
        colours: XYZ of pixels, before and after.
        errors: What they err by, ‖ΔXYZ‖.
        accumulators: Their coverage, which are illuminated, and through which an edge passes.
        tolerance: From which errors, relative to the colour, pixels are split.
        least: The level that all pixels are split to.
        refine: Whether any are split further.
    """

    picture: Picture
    lookup: ColourLookup
    lobes: range
    colours: wp.array
    errors: wp.array
    accumulators: Sequence[wp.array]
    tolerance: float
    least: int
    refine: bool

    @property
    def buffer_kind(self) -> BufferKind:
        """The arrays that cells take."""
        return BufferKind(self.lookup.needs_sampling, self.picture.pigmented, self.picture.has_materials)

    @property
    def subdivides(self) -> bool:
        """Whether any pixels are split."""
        return self.refine or self.least > 0

    def _threshold(self, level: int, *, converged: bool = False) -> float:
        """From which errors pixels at a level are split, or those that had converged and take cells of others."""
        last = refinement_levels.MOST_LEVEL - (self.tolerance >= refinement_levels.COARSE_TOLERANCE)
        if not self.refine or level >= last:
            return np.inf
        return self.tolerance if converged else pixel_filter.threshold_at(level, self.tolerance)

    def _must_subdivide(self, level: int) -> tuple[bool, int]:
        """Whether all pixels are split beyond a level, and to which the rims are."""
        return level < self.least, pixel_filter.SILHOUETTE_LEVEL if self.refine else 0

    def estimate_errors(self, floor: wp.array, marks: wp.array) -> KernelCall:
        """The call that estimates the error of every pixel by one ray, and says which are to be split."""
        gbuffer = self.picture.gbuffer
        unevenness = subdivision.Unevenness()
        unevenness.scattering_vectors, unevenness.mirrored = gbuffer.scattering_vectors, gbuffer.to_lights
        unevenness.estimates = self.picture.estimates_of(self.lobes)
        inputs = [
            self.colours, unevenness, gbuffer.pixels.hit, self.picture.rays.width, floor, self._threshold(0),
            self.least > 0, self.refine,
        ]  # fmt: skip
        return KernelCall(subdivision.estimate_errors, inputs, [self.errors, marks], in_runs=True)

    def splat_cells(self, level: int, buffers: TileBuffers, sums: Any, *, shadows: bool) -> list[KernelCall]:
        """The calls that shade the cells in the buffers and splat them to the pixels around."""
        gbuffer, means, name = buffers.gbuffer, self.lookup.uses_footprints, self.picture.rays.options["device"].alias
        steps = self.picture.cell_calls(self.lookup, self.lobes, level, buffers, shadows=shadows)
        weights = pixel_filter.weights_at(level, means, name)
        inputs = [
            buffers.colours, gbuffer.pixels.hit, self.picture.occlusion_of(gbuffer, self.lobes, shadows=shadows),
            gbuffer.gains, buffers.tiles[level], self.colours, self.errors, sums.ranks, weights, level,
        ]  # fmt: skip
        outputs = [
            sums.filtered_sums, sums.means, sums.level_difference, sums.levels, sums.has_unlit_quadrant, sums.has_edge,
        ]  # fmt: skip
        return [
            *steps,
            KernelCall(subdivision.splat_cells, inputs, outputs, in_runs=True, block=refinement_levels.rays_at(level)),
        ]

    def resolve_pixels(self, level: int, sums: Any, pixels: wp.array, floor: wp.array, marks: wp.array) -> KernelCall:
        """The call that sets pixels to the sums of the cells around, and compares these with the level before."""
        rays = self.picture.rays
        inputs = [
            sums, pixels, rays.width, rays.height, floor, self._threshold(level),
            self._threshold(level, converged=True), level, *self._must_subdivide(level),
        ]  # fmt: skip
        return KernelCall(
            subdivision.resolve_pixels, inputs, [self.colours, self.errors, *self.accumulators, marks], in_runs=True
        )

    def select_cells(
        self, level: int, sums: Any, tiles: wp.array, floor: wp.array, marks: wp.array, chosen: wp.array
    ) -> KernelCall:
        """The call that says which pixels are split again."""
        rays = self.picture.rays
        inputs = [
            sums, tiles, marks, self.colours, self.accumulators[0], rays.width, rays.height, floor,
            self._threshold(level), level, *self._must_subdivide(level),
        ]  # fmt: skip
        return KernelCall(subdivision.select_cells, inputs, [chosen], in_runs=True)

    def empty_tile_sums(self, pixels: int) -> Any:
        """The struct ``FilteredSums`` of the kernels for so many pixels that are split."""
        device = self.picture.rays.options["device"]
        result = subdivision.FilteredSums()
        result.filtered_sums = wp.empty((pixels, 9), dtype=wp.vec4f, device=device)
        result.means = wp.empty(pixels, dtype=wp.vec3f, device=device)
        result.level_difference = wp.empty(pixels, dtype=wp.float32, device=device)
        result.levels, result.has_unlit_quadrant = (wp.empty(pixels, dtype=wp.uint8, device=device) for _ in range(2))
        result.has_edge = wp.empty(pixels, dtype=wp.bool, device=device)
        result.ranks = wp.empty(0, dtype=wp.int32, device=device)
        result.filter_normalisation = pixel_filter.filter_normalisation_on(self.lookup.uses_footprints, device.alias)
        return result
