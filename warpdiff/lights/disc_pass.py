"""Pass of a disc light: a direction of its own for each ray, with a shadow ray, blurred over a part of the disc."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import disc_samples, light_samples
from warpdiff.kernels.refinement_levels import FILTER_SIGMA, rays_at
from warpdiff.lights.lobe_pass import LobePass
from warpdiff.scene.occluder_grid import no_grid
from warpdiff.tables import polar_grid

if TYPE_CHECKING:
    from collections.abc import Callable

    from warpdiff.lights.base import DiscPart
    from warpdiff.lights.light_pass import Counting, PassContext, RayBatch

# Number of pixels whose cells a pixel's filter covers, a Gaussian: 4π of its variance.
_COVERED_PIXELS = 4.0 * math.pi * FILTER_SIGMA**2
# Deviation of a sample's directions, in radii of the disc, over the root of the number of samples of a pixel, and at
# most: a disc has half of its radius.
_EXTENT, _MOST_EXTENT = 1.0, 0.5
# Number of samples whose directions are measured.
_MEASURED = 16


class DiscPass(LobePass):
    """Pass of a disc. Its last lobe is the one with the mean and the variance of the disc, its others are samples."""

    is_sampled = True

    def __init__(self, part: DiscPart, context: PassContext) -> None:
        super().__init__(part, context)
        self._lobe = polar_grid.blur(context.optics.coherence) * polar_grid.MIDDLE_UM
        self.illuminated = (self.part.sample_count + 1) * self.illuminated

    @property
    def first_lobes(self) -> range:
        """The single lobe where cells follow, otherwise the samples."""
        return (
            range(self.part.sample_count, self.part.sample_count + 1)
            if self.context.refines
            else range(self.part.sample_count)
        )

    @property
    def measured_lobes(self) -> range:
        """Some of the samples, so that a plan's sample has many pixels."""
        return range(_MEASURED)

    def cell_lobes(self, level: int) -> range:
        """Return one sample of each cell of refined pictures, otherwise the samples of a ray, shared by its cells."""
        return range(1 if self.context.refines else -(-self.part.sample_count // rays_at(level)))

    def prepare_shadow_rays(self, count: Callable[[], int]) -> None:  # noqa: ARG002 (of grids)
        """Make no grid, as each ray has a direction of its own: all ask the hierarchy."""
        self._grids[:] = [no_grid(self.context.rays.scene)]

    def _samples(self, batch: RayBatch) -> int:
        """Return the number of samples of each ray."""
        return len(self.cell_lobes(batch.level)) if batch.level else self.part.sample_count

    def _extent(self, batch: RayBatch) -> float:
        """Return the standard deviation of a sample's directions, in radii of the disc."""
        rays = _COVERED_PIXELS * rays_at(batch.level) if batch.level else 1.0
        return min(_EXTENT / math.sqrt(rays * self._samples(batch)), _MOST_EXTENT)

    def scatter(self, lobe: int, batch: RayBatch, counting: Counting) -> list[KernelCall]:
        """Return the calls that draw a direction for each ray, and find its occlusion and scattering vector."""
        if lobe == self.part.sample_count:
            return super().scatter(0, batch, counting)
        samples = self._samples(batch)
        inputs = [
            self._lights, 0, self._extent(batch), self._lobe, batch.gbuffer.pixels, batch.tiles,
            self.context.rays.width, 1 << batch.level, lobe, samples,
        ]  # fmt: skip
        draw = KernelCall(disc_samples.draw_disc, inputs, [batch.samples.towards], in_runs=True)
        return [draw, *self.scatter_towards(batch.samples.towards, 0, 1.0 / samples, batch, counting)]

    def footprint_calls(self, lobe: int, batch: RayBatch) -> list[KernelCall]:
        """Return the calls that find the footprints of a batch: its filter's, widened by what each ray's light adds."""
        if lobe == self.part.sample_count:
            return super().footprint_calls(0, batch)
        samples = batch.samples
        inputs = [self._lights, 0, samples.towards, self._extent(batch), batch.gbuffer.pixels]
        widen = KernelCall(light_samples.add_light_extent, inputs, [samples.footprints], in_runs=True)
        return [self.filter_footprints(batch), widen]
