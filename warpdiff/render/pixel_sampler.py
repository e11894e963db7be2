"""Pixel sampler: traces one ray for each pixel, and computes its sample under one lobe of one light at a time.

A lobe is a direction to a light or a Gaussian of directions. A sample has the scattering vector, the direction to the
light and the geometry factor at the hit of a ray.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import warp as wp

from warpdiff.lights.grating_dots import LookupSamples
from warpdiff.lights.light_pass import Counting, LightSamples, RayBatch
from warpdiff.render import pixel_filter
from warpdiff.request.directions import DirectionRange, DirectionSample

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from warpdiff.device.kernel_calls import KernelCall
    from warpdiff.heightfield.field import HeightField
    from warpdiff.lights.light_pass import LightPass, PassContext
    from warpdiff.render.accumulators import Accumulators

# Before a plan (the numbers of a computation) is chosen, rays are traced to measure the range of the scattering
# vectors. If pixels show single directions, there are at most `_SAMPLES_MEASURED` rays per pixel. If pixels show means
# over their filter, there are about `_CELLS_MEASURED` rays in total, and at most `_MOST_SAMPLES_MEASURED` per pixel.
# The positions of these rays in the pixel vary, because pixels are later divided into subpixel cells with directions
# that do not occur at pixel centres. The numbers are limited by time, which is proportional to them.
_SAMPLES_MEASURED, _CELLS_MEASURED, _MOST_SAMPLES_MEASURED = 4, 8192, 16


class LobeIndex(NamedTuple):
    """Index of a light in the list of lights, and index of one of its lobes (directions or Gaussians of directions)."""

    light: int
    lobe: int


class PixelSampler:
    """Sampler that traces one ray for each pixel, and samples one lobe of a light (a direction) at the hits.

    Attributes:
        samples: Samples of the lobe of the last call of :meth:`scatter`, one entry per pixel.
    """

    def __init__(self, context: PassContext, *, samples_per_pixel: int, means: bool, shadow_rays_per_hit: int) -> None:
        self._context, self._samples_per_pixel, self._means = context, samples_per_pixel, means
        self._shadow_rays_per_hit = shadow_rays_per_hit
        self.samples = LightSamples.allocate(
            context.rays.size, means=means, has_finishes=context.has_finishes, has_directions=False,
            has_dots=context.dots is not None, device=context.device,
        )  # fmt: skip
        self._passes: Sequence[LightPass] = ()
        self._no_tiles = wp.empty(0, dtype=wp.int32, device=context.device)
        self._no_gains = wp.empty(0, dtype=wp.float32, device=context.device)
        self.invalidate()

    def invalidate(self) -> None:
        """Discard the hits of rays and the light samples at the hits, for example after a change of the view."""
        self._sample: int | None = None
        self._lobe: LobeIndex | None = None

    def set_lights(self, passes: Sequence[LightPass]) -> None:
        """Set the passes of the lights.

        A pass computes the colours under one part of a light. Hits of rays remain valid. Light samples at the hits are
        discarded, because they belong to the previous lights.
        """
        self._passes, self._lobe = passes, None
        if any(light_pass.has_directions for light_pass in passes) and not self.samples.spectral_gains.size:
            rays, device = self._context.rays.size, self._context.device
            self.samples = replace(
                self.samples, spectral_gains=wp.empty((3, rays), dtype=wp.float32, device=device),
                towards=wp.empty(rays, dtype=wp.vec4f, device=device),
            )  # fmt: skip

    def lobes(self) -> Iterator[LobeIndex]:
        """Yield all lobes whose directions are measured before a plan (numbers of the computation) is chosen.

        A lobe is a direction to a light, or a Gaussian of such directions.
        """
        for light, light_pass in enumerate(self._passes):
            for lobe in light_pass.measured_lobes:
                yield LobeIndex(light, lobe)

    def batch(self, sums: Accumulators, unserved_gain: wp.array | None = None, *, deviation: float = 0.0) -> RayBatch:
        """Return the rays of all pixels as a batch, whose colours are added to ``sums``.

        ``deviation`` is the standard deviation of the pixel filter [pixels].
        """
        unserved_gain = self._no_gains if unserved_gain is None else unserved_gain
        return RayBatch(
            self._context.rays.gbuffer, self.samples, sums.xyz, sums.coverage, sums.illuminated, unserved_gain,
            self._no_tiles, level=0, deviation=deviation,
        )  # fmt: skip

    def trace(self, sample: int, samples_per_pixel: int | None = None) -> None:
        """Trace one ray per pixel: the ray with the index ``sample`` among all rays of the pixel."""
        self._context.rays.launch(self._trace_calls(sample, samples_per_pixel or self._samples_per_pixel))
        self._sample = sample

    def _trace_calls(self, sample: int, samples_per_pixel: int) -> list[KernelCall]:
        self.invalidate()
        deviation = pixel_filter.deviation_at(0, means=self._means)
        return self._context.rays.trace(sample, samples_per_pixel, deviation)

    def scatter(
        self, sample: int, index: LobeIndex, sums: Accumulators, *, samples_per_pixel: int | None = None
    ) -> None:
        """Sample a lobe (direction to a light) at the hits of one ray per pixel, and write the result to ``samples``.

        The light that the pigment reflects is added to the colours in ``sums``. The light that the height field
        diffracts is looked up later. ``sample`` is the index of the ray among the rays of a pixel. The ray is traced
        first, unless the last traced ray has the same index. If the previous call had the same ray and lobe, the method
        does nothing.
        """
        if (self._sample, self._lobe) == (sample, index):
            return
        rays, light_pass = self._context.rays, self._passes[index.light]
        count = samples_per_pixel or self._samples_per_pixel
        calls = self._trace_calls(sample, count) if self._sample != sample else []
        if self._context.casts_shadows and not light_pass.is_prepared:
            # The rays are traced before shadow rays are prepared, because the preparation depends on the number of
            # hits: occluder grids are made only if there are many shadow rays.
            rays.launch(calls)
            calls = []
            light_pass.prepare_shadow_rays(lambda: self._shadow_rays_per_hit * rays.gbuffer.hit_count)
        is_first_lobe = index.lobe == light_pass.first_lobes.start
        is_first = index.light == 0 and is_first_lobe
        begins = is_first and sample == 0
        # If pixels show means over their filter, the colours of each light are added in a sum of its own, which begins
        # at 0. Hits are counted only under the first light, because they are the same under all lights.
        counting = Counting(
            1.0 / count, 1.0 / count if is_first else 0.0, begins=begins,
            resets=begins or (self._means and is_first_lobe),
        )  # fmt: skip
        batch = self.batch(sums, deviation=pixel_filter.deviation_at(0, means=True) if self._means else 0.0)
        rays.launch([*calls, *light_pass.scatter(index.lobe, batch, counting)])
        self._sample, self._lobe = sample, index

    def directions(self) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]]:
        """Return scattering vectors, directions to the light and geometry factors of the last lobe, one per pixel.

        A lobe is a direction to a light, or a Gaussian of such directions.
        """
        scattering_vectors, to_lights, gains = (values.numpy() for values in self.samples.directions)
        return scattering_vectors, to_lights, gains

    def _of_dots(self, surface: int) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]] | None:
        """Return the directions of the last lobe in the frames of a surface's dots; None without a grating map.

        A grating map divides a surface into small rectangles (dots). A dot rotates a height field and scales its
        lengths by the pitch scale.

        Directions to the light are scaled to unit length. A plan that is chosen for them therefore meets its tolerance
        for the dots with the smallest pitch scale, whose diffraction orders are the narrowest.
        """
        dots, of_dots = self._context.dots, self.samples.of_dots
        if dots is None or of_dots is None or not dots.has_map(surface):
            return None
        samples = LookupSamples(self.samples.scattering_vectors, self.samples.to_lights, None)
        gbuffer = self._context.rays.gbuffer
        result, transform = dots.transform(surface, gbuffer, samples, of_dots, part=0)
        self._context.rays.launch([dots.find(surface, gbuffer, of_dots, level=0), transform])
        to_lights = result.to_lights.numpy()
        lengths = np.linalg.norm(to_lights, axis=1, keepdims=True)
        return result.scattering_vectors.numpy(), to_lights / np.maximum(lengths, 1e-6), self.samples.gains.numpy()

    def measure_directions(
        self, heightfields: Sequence[HeightField | None], sums: Accumulators
    ) -> list[tuple[DirectionRange, DirectionSample, int]]:
        """Return the directions for which plans (numbers of computations) are made, by height field.

        Only directions of light that reaches the surface count. They are described by their range, a sample of them and
        their number.

        Additional rays are traced for this purpose. They require about 1 % of the time in which the picture's colours
        are computed.

        Args:
            heightfields: Height field of each surface; None for a plain surface, which has no entry in the result.
            sums: Sums of the picture's pixels.
        """
        surfaces = [
            _Measured(heightfield, surface)
            for surface, heightfield in enumerate(heightfields)
            if heightfield is not None
        ]
        lobes = list(self.lobes())
        # If pixels show points (single directions), only the first rays of each pixel are used. If pixels show means
        # over their filter, several rays per pixel represent the directions of the later subpixel cells.
        per_pixel, measured = self._samples_per_pixel, min(self._samples_per_pixel, _SAMPLES_MEASURED)
        if self._means:
            self.trace(0)
            pixels = max(self._context.rays.gbuffer.hit_count, 1)
            per_pixel = measured = min(-(-_CELLS_MEASURED // pixels), _MOST_SAMPLES_MEASURED)
        parts = len(lobes) * (measured if self._means else 1)
        for sample in range(measured):
            for index in lobes:
                # If pixels show means, the first measured ray passes through the pixel centre, like the single ray of
                # an undivided pixel in the picture.
                self.scatter(sample, index, sums, samples_per_pixel=1 if self._means and sample == 0 else per_pixel)
                directions = self.directions()
                for of_surface in surfaces:
                    own = self._of_dots(of_surface.surface) or directions
                    of_surface.add(self._context, own, parts if self._means or sample == 0 else 0)
        if measured > self._samples_per_pixel:
            self.invalidate()
        return [
            (
                of_surface.within,
                DirectionSample.joined(of_surface.sampled),
                of_surface.count * self._samples_per_pixel // measured,
            )
            for of_surface in surfaces
        ]


@dataclass
class _Measured:
    """Directions to the light and to the viewer on one surface, collected for each ray and each lobe of a light.

    Attributes:
        heightfield: Height field of the surface.
        surface: Index of the surface.
        within: Range of the directions.
        count: Number of the directions.
        sampled: Random samples of the directions, one for each call of :meth:`add` with ``parts``.
    """

    heightfield: HeightField
    surface: int
    within: DirectionRange = field(default_factory=lambda: DirectionRange(0.0, 0.0, 0.0, 0.0))
    count: int = 0
    sampled: list[DirectionSample] = field(default_factory=list)

    def add(
        self,
        context: PassContext,
        directions: tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]],
        parts: int,
    ) -> None:
        """Add the directions of one lobe: a direction to a light, or a Gaussian of such directions.

        A random sample of the directions is added, too, unless ``parts`` is 0. ``parts`` is the number of such samples
        that will be joined to one: the more there are, the fewer directions each sample has.
        """
        scattering_vectors, to_lights, gains = directions
        gains = context.gains_on(self.surface, gains)
        is_lit = gains > 0.0
        coherence = context.surfaces[self.surface].coherence
        self.within = self.within.joined(
            DirectionRange.of(self.heightfield, coherence, scattering_vectors, to_lights, is_lit)
        )
        self.count += int(np.count_nonzero(is_lit))
        if parts:
            self.sampled.append(DirectionSample.among(scattering_vectors, to_lights, gains, parts))
