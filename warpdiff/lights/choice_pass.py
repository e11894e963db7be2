"""Pass of many directional lights: each ray chooses one light at random, and traces a shadow ray to this light.

Lights under which the surface is brighter are chosen more often. A sample is a light that a ray chooses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import light_choice, plain_samples, sky_samples
from warpdiff.lights import sky_distribution
from warpdiff.lights.light_pass import Counting
from warpdiff.lights.lobe_pass import LobePass
from warpdiff.scene.occluder_grid import no_grid

if TYPE_CHECKING:
    from collections.abc import Callable

    from warpdiff.lights.light_pass import RayBatch
    from warpdiff.tables.lookup import Lookups

# Number of lights that each pixel chooses at random before the pixel is subdivided into cells. The resulting colours
# serve only to estimate the luminance to which errors are relative, for which a few lights suffice. If the number is
# doubled, this estimate takes twice as long.
_FIRST_SAMPLES = 4
# A light is chosen with a probability proportional to the surface brightness that is expected under it. This brightness
# is that of the diffracted light, plus a constant that is the same for all directions. The constant is `_DIFFUSE`
# without a pigment (base colour of the mesh), and `_DIFFUSE_OF_PIGMENT` with a pigment. For comparison, the diffracted
# brightness has a mean of 0.08 over all scattering vectors (u, v). Other values would change the noise of pictures, not
# their mean.
_DIFFUSE, _DIFFUSE_OF_PIGMENT = 0.002, 0.08


class ChoicePass(LobePass):
    """Pass of many directional lights with the same illuminant.

    Lobe indices below the number of lights stand for the lights. Larger indices stand for samples: lights that each ray
    chooses at random.
    """

    is_sampled, first_level = True, 3

    @property
    def first_lobes(self) -> range:
        """Indices of the samples (random choices of a light) of each pixel before pixels are subdivided."""
        return range(self.lobe_count, self.lobe_count + _FIRST_SAMPLES)

    def cell_lobes(self, level: int) -> range:  # noqa: ARG002 (of lights that are not refined)
        """Return the index of the only sample of a subpixel cell. A sample is a light that the cell's ray chooses."""
        return range(self.lobe_count, self.lobe_count + 1)

    def prepare_shadow_rays(self, count: Callable[[], int]) -> None:  # noqa: ARG002 (of grids)
        """Make no occluder grids: a grid serves rays to one light, but neighbouring rays choose different lights."""
        self._grids[:] = self.lobe_count * [no_grid(self.context.rays.scene)]

    def scatter(self, lobe: int, batch: RayBatch, counting: Counting) -> list[KernelCall]:
        """Return the kernel calls that compute the scattering vectors of a light or of a sample.

        A sample is a light that each ray chooses. The choice is made later, by :meth:`colour`. Until then, a sample has
        the scattering vector of light from the mirror direction, with which footprints are computed.
        """
        if lobe < self.lobe_count:
            return super().scatter(lobe, batch, counting)
        inputs = [batch.gbuffer.pixels, counting.counted, counting.begins, counting.resets]
        outputs = [batch.samples.scattering_vectors, batch.samples.gains, *batch.sums]
        return [KernelCall(sky_samples.mirror_deflections, inputs, outputs, in_runs=True)]

    def colour(self, lobe: int, batch: RayBatch, lookups: Lookups) -> list[KernelCall]:
        """Return the kernel calls that choose a light for each ray, and add the colour under this light."""
        samples, context = batch.samples, self.context
        count = len(self.cell_lobes(batch.level) if batch.level else self.first_lobes)
        diffuse = _DIFFUSE_OF_PIGMENT if context.is_pigmented else _DIFFUSE
        choices = []
        for surface, lookup in enumerate(lookups):
            inputs = [
                self._lights, sky_distribution.surface_distribution(lookup, self.of_surface(surface), context.device),
                context.reflection, surface, diffuse, batch.gbuffer.pixels, samples.footprints, batch.tiles,
                context.rays.width, 1 << batch.level, lobe - self.lobe_count, count,
            ]  # fmt: skip
            choices.append(KernelCall(light_choice.choose_lights, inputs, [samples.towards], in_runs=True))
        plain = context.plain
        if plain is not None and plain.has_glossy_faces:
            inputs = [
                self._lights, plain.struct, batch.gbuffer.pixels, samples.footprints, batch.tiles,
                context.rays.width, 1 << batch.level, lobe - self.lobe_count, count,
            ]  # fmt: skip
            choices.append(KernelCall(plain_samples.choose_plain_lights, inputs, [samples.towards], in_runs=True))
        scatter = self.scatter_towards(samples.towards, 0, 1.0 / count, batch, Counting())
        return [self.filter_footprints(batch), *choices, *scatter, *super().colour(0, batch, lookups)]
