"""Pass of a disc light: each ray draws a direction on the disc, traces a shadow ray, and blurs the look-up."""

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

# Effective number of pixels under the pixel filter, a Gaussian with standard deviation σ in pixels. Derived: 4πσ².
_COVERED_PIXELS = 4.0 * math.pi * FILTER_SIGMA**2
# Blur of one sample of a disc: its standard deviation is ``_EXTENT`` disc radii over √(samples of the pixel). Choice:
# twice as much lowers the noise but narrows penumbrae. The limit ``_MOST_EXTENT``, in radii, is the standard deviation
# of a whole disc.
_EXTENT, _MOST_EXTENT = 1.0, 0.5
# Number of samples per pixel whose directions are measured to choose a plan. Limit: time is proportional to it.
_MEASURED = 16


class DiscPass(LobePass):
    """Pass of a disc.

    Lobe indices below ``sample_count`` are samples; the last one is a Gaussian with the disc's extent.
    """

    is_sampled = True

    def __init__(self, part: DiscPart, context: PassContext) -> None:
        super().__init__(part, context)
        self._lobe = polar_grid.blur(context.optics.coherence) * polar_grid.MIDDLE_UM
        self.illuminated = (self.part.sample_count + 1) * self.illuminated

    @property
    def first_lobes(self) -> range:
        """Lobes that are evaluated with one ray per pixel: the Gaussian if cells follow, otherwise all samples."""
        return (
            range(self.part.sample_count, self.part.sample_count + 1)
            if self.context.refines
            else range(self.part.sample_count)
        )

    @property
    def measured_lobes(self) -> range:
        """Lobes whose directions are measured for the plan.

        The first samples suffice, as each pixel draws other directions.
        """
        return range(_MEASURED)

    def cell_lobes(self, level: int) -> range:
        """Return one sample per cell if pixels are refined; otherwise the cells of a pixel share its samples."""
        return range(1 if self.context.refines else -(-self.part.sample_count // rays_at(level)))

    def prepare_shadow_rays(self, count: Callable[[], int]) -> None:  # noqa: ARG002 (of grids)
        """Make no occluder grid. A grid serves only one direction, but each ray draws its own."""
        self._grids[:] = [no_grid(self.context.rays.scene)]

    def _samples(self, batch: RayBatch) -> int:
        """Return the number of samples of each ray."""
        return len(self.cell_lobes(batch.level)) if batch.level else self.part.sample_count

    def _extent(self, batch: RayBatch) -> float:
        """Return the standard deviation of the blur of one sample, in radii of the disc."""
        rays = _COVERED_PIXELS * rays_at(batch.level) if batch.level else 1.0
        return min(_EXTENT / math.sqrt(rays * self._samples(batch)), _MOST_EXTENT)

    def scatter(self, lobe: int, batch: RayBatch, counting: Counting) -> list[KernelCall]:
        """Return kernel calls that draw a direction for each ray, trace shadow rays and compute scattering vectors."""
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
        """Return kernel calls that compute footprints: those of the pixel filter, widened by the blur of the sample."""
        if lobe == self.part.sample_count:
            return super().footprint_calls(0, batch)
        samples = batch.samples
        inputs = [self._lights, 0, samples.towards, self._extent(batch), batch.gbuffer.pixels]
        widen = KernelCall(light_samples.add_light_extent, inputs, [samples.footprints], in_runs=True)
        return [self.filter_footprints(batch), widen]
