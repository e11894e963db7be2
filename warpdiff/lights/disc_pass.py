"""Pass of a disc light: each ray draws a direction on the disc, traces a shadow ray, and looks up a blurred colour."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import disc_samples, light_samples, plain_samples
from warpdiff.kernels.refinement_levels import FILTER_SIGMA, rays_at
from warpdiff.lights.lobe_pass import LobePass
from warpdiff.scene.occluder_grid import no_grid
from warpdiff.tables import polar_grid

if TYPE_CHECKING:
    from collections.abc import Callable

    from warpdiff.lights.base import DiscPart
    from warpdiff.lights.light_pass import Counting, PassContext, RayBatch

# Effective number of pixels whose samples contribute to one pixel through the pixel filter, a Gaussian with the
# standard deviation σ pixels. For such a filter, the number is 4πσ².
_COVERED_PIXELS = 4.0 * math.pi * FILTER_SIGMA**2
# A sample is a random direction to the disc. It is treated as a small Gaussian source around this direction, which
# lowers the noise. The standard deviation of this source, in radii of the disc, is `_EXTENT` divided by the square root
# of the samples per pixel. It is at most `_MOST_EXTENT`, the standard deviation of the whole disc. `_EXTENT` was chosen
# so that shadows are sharp. If it is doubled, directions are drawn on a smaller part of the disc, and penumbrae become
# narrower than those of the disc.
_EXTENT, _MOST_EXTENT = 1.0, 0.5
# Number of random directions per pixel that are drawn to find the range of scattering vectors, before a plan (numbers
# of wavelengths and terms) is chosen for this range. The value is limited by time, which is proportional to it.
_MEASURED = 16


class DiscPass(LobePass):
    """Pass of a disc light whose directions are drawn at random.

    An index of a lobe below ``lobe_count`` stands for one random direction. The index ``lobe_count`` stands for a
    Gaussian lobe with the extent of the whole disc.
    """

    is_sampled, first_level = True, 2

    def __init__(self, part: DiscPart, context: PassContext) -> None:
        super().__init__(part, context)
        blurs = [polar_grid.blur(optics.coherence) for optics in context.surfaces]
        self._lobe = min(blurs) * polar_grid.MIDDLE_UM
        self.lobe_count = part.sample_count
        self.illuminated = (self.lobe_count + 1) * self.illuminated

    @property
    def first_lobes(self) -> range:
        """Indices of the lobes that are evaluated with one ray per pixel.

        If pixels are subdivided afterwards, the only lobe is the Gaussian of the whole disc. Otherwise the lobes are
        all random directions.
        """
        count = self.lobe_count
        return range(count, count + 1) if self.context.refines else range(count)

    @property
    def measured_lobes(self) -> range:
        """Indices of the lobes whose scattering vectors determine the range of directions for which a plan is chosen.

        A lobe stands for one random direction. A few lobes suffice, because every pixel draws other directions on the
        disc. A plan holds the numbers of a computation, such as wavelengths.
        """
        return range(_MEASURED)

    def prepare_shadow_rays(self, count: Callable[[], int]) -> None:  # noqa: ARG002 (of grids)
        """Make no occluder grid: a grid serves shadow rays of one direction, but each ray draws another direction."""
        self._grids[:] = [no_grid(self.context.rays.scene)]

    def _samples(self, batch: RayBatch) -> int:
        """Return the number of directions on the disc that each ray of a batch draws."""
        return len(self.cell_lobes(batch.level)) if batch.level else self.lobe_count

    def _extent(self, batch: RayBatch) -> float:
        """Return the standard deviation of the Gaussian source that one sample represents, in radii of the disc."""
        rays = _COVERED_PIXELS * rays_at(batch.level) if batch.level else 1.0
        return min(_EXTENT / math.sqrt(rays * self._samples(batch)), _MOST_EXTENT)

    def scatter(self, lobe: int, batch: RayBatch, counting: Counting) -> list[KernelCall]:
        """Return kernel calls that draw a direction for each ray, trace shadow rays and compute scattering vectors."""
        if lobe == self.lobe_count:
            return self.scatter_towards(self._no_directions, 0, 1.0, batch, counting, lobe)
        samples = self._samples(batch)
        light, pixels = [self._lights, 0, self._extent(batch)], batch.gbuffer.pixels
        rays = [batch.tiles, self.context.rays.width, 1 << batch.level, lobe, samples]
        inputs = [*light, self._lobe, pixels, *rays]
        draws = [KernelCall(disc_samples.draw_disc, inputs, [batch.samples.towards], in_runs=True)]
        plain = self.context.plain
        if plain is not None and plain.has_glossy_faces:
            inputs = [*light, plain.struct, pixels, *rays]
            draws.append(KernelCall(plain_samples.draw_plain_disc, inputs, [batch.samples.towards], in_runs=True))
        return [*draws, *self.scatter_towards(batch.samples.towards, 0, 1.0 / samples, batch, counting, lobe)]

    def footprint_calls(self, lobe: int, batch: RayBatch) -> list[KernelCall]:
        """Return kernel calls that compute footprints: changes of the scattering vector (u, v) over the pixel filter.

        Footprints are widened by the extent of the Gaussian source that one sample of the disc represents.
        """
        if lobe == self.lobe_count:
            return super().footprint_calls(0, batch)
        samples = batch.samples
        inputs = [self._lights, 0, samples.towards, self._extent(batch), batch.gbuffer.pixels]
        widen = KernelCall(light_samples.add_light_extent, inputs, [samples.footprints], in_runs=True)
        return [self.filter_footprints(batch), widen]
