"""Pass of a sky: each ray draws directions where the surface and the sky are bright, and traces shadow rays to them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import plain_samples, sky_samples
from warpdiff.lights import sky_distribution
from warpdiff.lights.light_pass import LightPass
from warpdiff.tables.lookup import Lookups

if TYPE_CHECKING:
    from collections.abc import Hashable

    from warpdiff.lights.light_pass import Counting, PassContext, RayBatch
    from warpdiff.lights.sky_grid import SkyGrid

# Fraction of the directions that are drawn by the brightness of the sky alone. `_SKY_SHARE` is used without a pigment
# (base colour of the mesh), and `_SKY_SHARE_OF_PIGMENT` with a pigment. The other directions are drawn by the colours
# of the surface. With a pigment the fraction is larger, because a pigment reflects light from all directions. Other
# values would change only the noise.
_SKY_SHARE, _SKY_SHARE_OF_PIGMENT = 0.25, 0.5
# Number of directions to the sky that are drawn per pixel before pixels are subdivided. The resulting colours serve
# only to estimate the luminance to which errors are relative, for which a few directions suffice.
_FIRST_SAMPLES = 4


class SkyPass(LightPass):
    """Pass of a sky: each ray draws directions where the surface and the sky are bright.

    The environment caches the grid of the sky and the grid's arrays on a device.

    Attributes:
        grid: Grid of the sky's powers.
    """

    is_sampled = has_directions = True
    first_level = 2

    def __init__(self, grid: SkyGrid, context: PassContext) -> None:
        super().__init__(context, [grid.spectra])
        self.grid, self.lobe_count = grid, grid.directions
        self._sky = sky_samples.Sky()
        self._blocks: list[wp.array] = []

    @property
    def first_lobes(self) -> range:
        """Indices of the directions that each ray draws: a few if pixels are subdivided afterwards, otherwise all."""
        return range(min(self.lobe_count, _FIRST_SAMPLES) if self.context.refines else self.lobe_count)

    @property
    def graph_key(self) -> tuple[Hashable, ...]:
        """Grid of the sky, as a part of the key of a recorded CUDA graph, because recorded launches read its arrays."""
        return type(self), self.grid

    def begin(self, previous: LightPass | None) -> None:
        """Copy the sky to the device, unless the environment or the previous pass already has its arrays there."""
        context = self.context
        if isinstance(previous, SkyPass) and previous.grid is self.grid:
            self._lights, self._sky, self._blocks = previous._lights, previous._sky, previous._blocks
            return
        self._sky = sky_samples.Sky()
        self._sky.powers, *self._blocks = self.grid.device_arrays.get_or_make(
            context.device.alias, lambda: sky_distribution.upload_sky(self.grid, context.device)
        )
        self._sky.turn = self.grid.turn / (2.0 * math.pi)
        whites = [context.pigment_white(spectrum, is_of_sky=True) for spectrum in self.grid.spectra]
        self._sky.whites = wp.mat33f(*np.ravel(whites))

    @property
    def white_luminance(self) -> float:
        """Luminance of a white matte surface under a sky whose radiance is everywhere the mean over all directions."""
        rows = len(self.grid.powers)
        solid = -np.diff(np.cos(np.arange(rows + 1) / rows * math.pi)) * 0.5 / self.grid.powers.shape[1]
        # Under a sky of constant radiance, a white matte surface has a luminance of π times the power per solid angle.
        mean = np.einsum("rcs,r->s", self.grid.powers.astype(np.float64), solid)
        whites = [self.context.white_xyz(spectrum, is_of_sky=True)[1] for spectrum in self.grid.spectra]
        return float(math.pi * mean @ np.array(whites))

    def scatter(self, lobe: int, batch: RayBatch, counting: Counting) -> list[KernelCall]:  # noqa: ARG002 (of lobes)
        """Return the kernel call that computes scattering vectors as if all light came from the mirror direction.

        Footprints (changes of the scattering vector over the pixel filter) are computed from these vectors.
        :meth:`colour` draws the actual directions later.
        """
        inputs = [batch.gbuffer.pixels, counting.counted, counting.begins, counting.resets]
        outputs = [batch.samples.scattering_vectors, batch.samples.gains, *batch.sums]
        return [KernelCall(sky_samples.mirror_deflections, inputs, outputs, in_runs=True)]

    def colour(self, lobe: int, batch: RayBatch, lookups: Lookups) -> list[KernelCall]:
        """Return kernel calls that draw a direction of the sky for each ray, and add the colour from this direction."""
        samples, context = batch.samples, self.context
        pixels, gains = batch.gbuffer.pixels, samples.spectral_gains
        count = len(self.cell_lobes(batch.level) if batch.level else self.first_lobes)
        lookups = Lookups(map(sky_distribution.lookup_for_skies, lookups))
        share = _SKY_SHARE_OF_PIGMENT if context.is_pigmented else _SKY_SHARE
        scene = context.rays.scene
        mesh_id = scene.with_hierarchy().mesh_id if context.casts_shadows else 0
        outputs = [samples.scattering_vectors, samples.to_lights, gains, batch.xyz, batch.illuminated]
        calls = [self.filter_footprints(batch)]
        for surface, lookup in enumerate(lookups):
            table = sky_distribution.distribution_for(lookup, self.of_surface(surface), self._blocks, sky_share=share)
            inputs = [
                self._sky, table, pixels, samples.footprints, self._lights.rgb_to_xyz, context.reflection, surface,
                scene.bare, scene.textures, scene.transparency, mesh_id, context.casts_shadows, batch.tiles,
                context.rays.width, 1 << batch.level, lobe, count,
            ]  # fmt: skip
            calls.append(KernelCall(sky_samples.sample_sky, inputs, outputs, in_runs=True))
            calls += self.look_up(0, [gains[spectrum] for spectrum in range(3)], None, batch, lookups, surface)
        plain = context.plain
        if plain is not None and plain.has_glossy_faces:
            inputs = [
                self._sky, sky_distribution.distribution_of_blocks(self._blocks), pixels, plain.struct,
                samples.footprints, self._lights.rgb_to_xyz, scene.bare, scene.textures, scene.transparency, mesh_id,
                context.casts_shadows, batch.tiles, context.rays.width, 1 << batch.level, lobe, count,
            ]  # fmt: skip
            calls.append(KernelCall(plain_samples.sample_plain_sky, inputs, outputs[-2:], in_runs=True))
        return calls
