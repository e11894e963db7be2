"""Pictures: the rays, the passes of lights and the sums of a picture on a device.

A pass computes the colours under one part of a light. A pixel begins as one ray. Refinement divides a pixel into
subpixel cells, with one ray per cell; level n has 2ⁿ × 2ⁿ cells. A pixel shows either the mean of the colours over its
footprint (the area of its filter) or the colour of points.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core.threads import subprogress
from warpdiff.device.devices import load
from warpdiff.device.kernel_calls import KernelCall, launch_pipeline
from warpdiff.evaluate.reflectance import direct_colour
from warpdiff.image.error_model import ErrorParts, combined_errors, relative_errors, texture_error
from warpdiff.image.image import Image
from warpdiff.image.report import report_of
from warpdiff.kernels import light_samples, primary_hits, subdivision
from warpdiff.kernels.shadow_rays import trace_shadow_rays
from warpdiff.lights.emission_pass import EmissionPass
from warpdiff.lights.light_pass import PassContext
from warpdiff.lights.lobe_pass import LobePass
from warpdiff.render import pixel_filter
from warpdiff.render.accumulators import Accumulators
from warpdiff.render.device_tiles import DeviceTiles
from warpdiff.render.pixel_sampler import LobeIndex, PixelSampler
from warpdiff.render.refinement import LightRefinement, RefinementLoop, RefinementPolicy
from warpdiff.render.threaded_tiles import ThreadedTiles
from warpdiff.scene.camera_rays import RasterizedRays, rays_for

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator, Sequence

    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.lights.base import LightPart
    from warpdiff.lights.light_pass import LightPass, RayBatch
    from warpdiff.lights.surface_optics import PictureUnit, SurfaceOptics
    from warpdiff.optics.materials import IlluminatedMaterial
    from warpdiff.request.directions import DirectionRange, DirectionSample
    from warpdiff.request.plan import Plan
    from warpdiff.scene.camera import View
    from warpdiff.scene.mesh_import import Surface
    from warpdiff.tables.lookup import Lookups

    Progress = Callable[[float], None] | None
    Previews = Sequence[tuple[float, Callable[[], None]]]

# Fraction of the work for one light [0 to 1] that is reported as finished when one ray per pixel has been shaded and
# refinement begins. The value was fitted to the times of a picture at a tolerance of 0.1.
_PROGRESS_OF_FIRST_RAYS = 0.3
# Expected number of shadow rays per hit in a refined picture. If it is large, occluder grids (lists of the faces that
# may block a light) are made, which save time for many shadow rays. The value was fitted to pictures of a snake mesh,
# which have 20 shadow rays per hit at a tolerance of 0.1, and 59 at 0.03.
_SHADOW_RAYS_REFINED = 24
# Level of the first subdivision of pixels if a surface has a grating map: its dots (small rectangles) change colours
# abruptly. Level 2 has 16 cells per pixel. The value was chosen because 4 cells often miss the differences of colour
# within a pixel.
_FIRST_LEVEL_OF_DOTS = 2
# Number of pixels per slice when colours of one ray per pixel are looked up on the CPU. The value was chosen because
# larger slices distribute work less evenly over threads, and smaller slices require more launches.
_COLOURS_OF_SLICE = 2048


def load_kernels(device: wp.Device) -> None:
    """Begin to load the kernels that every picture requires. Loading continues while the caller prepares the mesh."""
    load([primary_hits.intersect_known_faces, light_samples.scattering_vectors, trace_shadow_rays], device)


class Picture:
    """Picture of a mesh with one or several surfaces, whose view and lights may change between renderings.

    :meth:`set_lights` makes the passes, which compute the colours under each light. :meth:`render` or
    :meth:`render_directly` then computes the colours.
    """

    def __init__(
        self, surface: Surface, view: View, optics: Sequence[SurfaceOptics], *, unit: PictureUnit | None = None,
        finish_of_faces: NDArray[np.int32] | None = None, smooth: bool = True, samples_per_pixel: int = 1,
        means: bool = False, refine: bool = False, margin: int = 0, device_driven: bool = False, device: wp.Device,
        threads: int,
    ) -> None:  # fmt: skip
        """Allocate the arrays of a picture.

        Args:
            surface: The prepared mesh.
            view: Camera of the first rendering; later renderings may have other cameras.
            optics: Optics of each surface, except for the diffraction of its height field.
            unit: Mirror to which the colours are relative; None is a mirror under the coherence of the first surface.
            finish_of_faces: Index of each face's finish, which is a surface with one of its materials; None for a
                single finish.
            smooth: Whether vertex normals are interpolated.
            samples_per_pixel: Number of samples per pixel; with ``means``, the smallest number of cells per pixel.
            means: Whether pixels show means over footprints; otherwise they show points.
            refine: Whether pixels that show means are subdivided further where their errors are large.
            margin: Number of pixels that are added on each side, because the filter of a pixel at the border extends to
                them.
            device_driven: Whether the CPU uses the algorithms of the GPU, whose launches can be recorded. On the CPU
                they are slower.
            device: The Warp device.
            threads: Number of threads on the CPU.
        """
        self.rays = rays_for(
            surface, view, smooth=smooth, margin=margin, device_driven=device_driven, device=device, threads=threads
        )
        self._means, self._refine, self._least_samples = means, refine, samples_per_pixel
        self._samples_per_pixel = 1 if means else samples_per_pixel
        self.context = PassContext(self.rays, optics, unit, finish_of_faces, refines=means and refine)
        self.sampler = PixelSampler(
            self.context, samples_per_pixel=self._samples_per_pixel, means=means,
            shadow_rays_per_hit=max(samples_per_pixel, _SHADOW_RAYS_REFINED if means and refine else 1),
        )  # fmt: skip
        self._sums = Accumulators.allocate(self.rays.size, means=means, device=device)
        # If pixels show means and there are several lights, the light that is rendered at the moment has separate sums
        # of colours. Other pictures add colours directly to the sums over all lights.
        self._light_sums = self._sums
        self._own_sums: Accumulators | None = None
        self._parts: list[LightPart] = []
        self._passes: list[LightPass] = []
        self._inner = (slice(margin, margin + view.height), slice(margin, margin + view.width))
        self._shown_xyz: wp.array | None = None
        self._unserved_gain = wp.empty(0, dtype=wp.float32, device=device)
        self._loop: RefinementLoop | None = None

    @property
    def view(self) -> View:
        """View of the last rendering."""
        return self.rays.view

    def set_view(self, view: View) -> None:
        """Set the view, which must have the same size in pixels as the first one."""
        self.rays.set_view(view)
        self.invalidate()

    def invalidate(self) -> None:
        """Discard the hits of camera rays and the samples of lights, so that the next rendering computes both again."""
        self.sampler.invalidate()

    def set_lights(self, parts: Sequence[LightPart]) -> None:
        """Set the lights of the next renderings.

        A pass computes the colours under one part of a light. The passes of the new lights reuse the arrays of the
        previous passes, because a recorded CUDA graph reads these arrays.
        """
        before: list[LightPass | None] = [*self._passes, *[None] * (len(parts) + 1)]
        # If a light is not accepted, making its pass (computation of its colours) raises an error here, and the passes
        # of the previous lights stay in use.
        passes = [part.make_pass(self.context) for part in parts]
        plain = self.context.plain
        if plain is not None and plain.emits and passes:
            brightness = max(light_pass.white_luminance for light_pass in passes)
            passes.append(EmissionPass(self.context, plain, brightness))
        for light_pass, previous in zip(passes, before, strict=False):
            light_pass.begin(previous)
        self._parts, self._passes = list(parts), passes
        self.sampler.set_lights(self._passes)
        self._light_sums = self._sums
        if self._means and len(passes) > 1:
            # The arrays for a single light stay the same when lights change, because a recorded CUDA graph refers to
            # them.
            self._own_sums = self._light_sums = self._sums.of_one_light(self._own_sums)

    @property
    def graph_key(self) -> tuple[Hashable, ...]:
        """Key of a recorded CUDA graph: everything that its launches depend on, except the values in arrays."""
        passes = tuple(light_pass.graph_key for light_pass in self._passes)
        return *passes, self.view.extent_y is None, self.context.casts_shadows

    def measure_directions(
        self, heightfields: Sequence[HeightField | None]
    ) -> list[tuple[DirectionRange, DirectionSample, int]]:
        """Return the directions of light and viewer for which plans are required, for each height field.

        A plan has the numbers of a computation, such as wavelengths. Directions are described by their range, a sample
        of them and their number. ``heightfields`` has the height field of each surface; None is a plain surface, which
        is not in the result.
        """
        return self.sampler.measure_directions(heightfields, self._light_sums)

    def sampled(
        self, progress: Progress, xyz_by_part: list[NDArray[np.float32]] | None = None
    ) -> Iterator[tuple[LobeIndex, Progress]]:
        """Sample every lobe (direction of a light) for every camera ray, one ray per pixel at a time.

        After each lobe, yield its index and a callable that reports the progress of the caller's work on this lobe. If
        ``xyz_by_part`` is a list, the parts of the lights are sampled one after the other. The list then gets the
        colours under each part.
        """
        lobes = list(self.sampler.lobes())
        groups = [lobes]
        if xyz_by_part is not None:
            groups = [[lobe for lobe in lobes if lobe.light == part] for part in range(len(self._passes))]
        done, count = 0, self._samples_per_pixel * len(lobes)
        for group in groups:
            if group is not groups[0]:
                self._sums.xyz.zero_()
            for sample in range(self._samples_per_pixel):
                for index in group:
                    self.sampler.scatter(sample, index, self._light_sums)
                    yield index, subprogress(progress, done / count, (done + 1) / count)
                    done += 1
            if xyz_by_part is not None:
                xyz_by_part.append(self._cropped(self._sums.xyz).copy())
        if xyz_by_part is not None and len(groups) > 1:
            # This picture has no margin of additional pixels, because it does not show means. The cropped colours are
            # therefore those of all pixels.
            self._sums.xyz.assign(np.sum(xyz_by_part, axis=0, dtype=np.float32).reshape(-1, 3))

    def illuminated(self, index: LobeIndex) -> Sequence[Sequence[IlluminatedMaterial]]:
        """Return the illuminants of a lobe with the materials that they illuminate, by finish and spectrum.

        A lobe is a direction to a light, or a Gaussian of such directions. A finish is a surface with one of its
        materials.
        """
        return self._passes[index.light].illuminated[index.lobe]

    @property
    def sums(self) -> Accumulators:
        """Sums of the colours of pixels under the light that is rendered at the moment; :attr:`sampler` fills them."""
        return self._light_sums

    def footprint_calls(self, index: LobeIndex, batch: RayBatch) -> list[KernelCall]:
        """Return the kernel calls that compute the footprints of a batch of rays under a lobe.

        A footprint is the change of (u, v), the tangential part of the scattering vector, over the filter of a ray.

        The lobe must be that of a directional or point light.

        Raises:
            TypeError: The lobe is that of another kind of light.
        """
        light_pass = self._passes[index.light]
        if not isinstance(light_pass, LobePass):
            raise TypeError(f"{type(light_pass).__name__} has no footprints of its own")
        return light_pass.footprint_calls(index.lobe, batch)

    def directions_to(self, light: int) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]]:
        """Return scattering vectors, directions to a light and geometry factors where rays through pixel centres hit.

        The picture must show points with one ray per pixel. Factors are 0 where the light does not reach the hit.
        """
        self.sampler.scatter(0, LobeIndex(light, 0), self._light_sums)
        return self.sampler.directions()

    def render(
        self, lookups: Lookups, *, tolerance: float, progress: Progress = None, previews: Previews = (),
        xyz_by_part: list[NDArray[np.float32]] | None = None,
    ) -> None:  # fmt: skip
        """Compute the picture by look-ups of colours.

        Args:
            lookups: Look-ups of the colours of the surfaces, in tables or by sums over wavelengths.
            tolerance: Tolerance of the picture.
            progress: Callable that gets the finished fraction; None reports nothing.
            previews: Pairs of a larger tolerance and a callable, the largest tolerance first. The callable is called
                when the picture meets the tolerance. Previews have no effect on a GPU.
            xyz_by_part: List that gets the colours under each part of the lights, shape (height, width, 3). None gets
                no colours. The list requires that there are no previews.
        """
        if lookups.overwrites_gains and not len(self._unserved_gain):
            self._unserved_gain = wp.empty(self.rays.size, dtype=wp.float32, device=self.context.device)
        if not self._means:
            batch = self.sampler.batch(self._sums, self._unserved_gain)
            for index, share in self.sampled(progress, xyz_by_part):
                calls = self._passes[index.light].colour(index.lobe, batch, lookups)
                launch_pipeline(
                    calls, self.rays.size, slice_size=lookups.slice_size, progress=share, **self.rays.options
                )
            return
        # The callables of previews (pictures at larger tolerances) are called by the host between launches. A recorded
        # graph is launched without the host, so it has no previews.
        previews = previews if isinstance(self.rays, RasterizedRays) else ()
        least_level = pixel_filter.level_of(self._least_samples, means=lookups.uses_footprints)
        if len(self._passes) > 1:
            # Each light is refined to its final tolerance before the next light begins. A preview, a picture at a
            # larger tolerance, requires all lights, so that they are all rendered at the tolerance of the preview
            # first.
            count = len(previews) + 1
            for at, (preview, completed) in enumerate(previews):
                policy = RefinementPolicy(preview, least_level, self._refine)
                self._render_means(lookups, policy, subprogress(progress, at / count, (at + 1) / count))
                completed()
                self.sampler.set_lights(self._passes)
            progress, previews = subprogress(progress, 1.0 - 1.0 / count, 1.0), ()
        policy = RefinementPolicy(tolerance, least_level, self._refine)
        self._render_means(lookups, policy, progress, previews, xyz_by_part)

    def _render_means(
        self, lookups: Lookups, policy: RefinementPolicy, progress: Progress, previews: Previews = (),
        xyz_by_part: list[NDArray[np.float32]] | None = None,
    ) -> None:  # fmt: skip
        """Compute pixels as means over footprints, one light after the other."""
        self._sums.clear_errors()
        of_light, count = self._light_sums, len(self._passes)
        if count > 1:
            self._sums.xyz.zero_()
            self._sums.illuminated.zero_()
        batch = self.sampler.batch(of_light, self._unserved_gain, deviation=pixel_filter.deviation_at(0, means=True))
        for light, light_pass in enumerate(self._passes):
            if count > 1:
                of_light.illuminated.zero_()
            share = subprogress(progress, light / count, (light + 1) / count)
            self._add_own_rays(light, batch, lookups, subprogress(share, 0.0, _PROGRESS_OF_FIRST_RAYS))
            has_dots = self.context.dots is not None
            first_level = max(light_pass.first_level, _FIRST_LEVEL_OF_DOTS) if has_dots else light_pass.first_level
            policy = replace(policy, is_sampled=light_pass.is_sampled, first_level=first_level, has_dots=has_dots)
            refinement = LightRefinement(light_pass, lookups, batch, of_light, policy, is_first=light == 0)
            if self._loop is None:
                rays = self.rays
                self._loop = RefinementLoop(
                    ThreadedTiles(rays) if isinstance(rays, RasterizedRays) else DeviceTiles(refinement)
                )
            refined = subprogress(share, _PROGRESS_OF_FIRST_RAYS, 1.0)
            self._loop.run(refinement, refined, previews)
            if refined is not None:
                refined(1.0)
            if xyz_by_part is not None:
                xyz_by_part.append(self._cropped(of_light.xyz).copy())
            if count > 1:
                light_sums = [of_light.xyz, of_light.errors, of_light.illuminated]
                sums = [self._sums.xyz, self._sums.errors, self._sums.illuminated]
                self.rays.launch([KernelCall(subdivision.accumulate, light_sums, sums, in_runs=True)])

    def _add_own_rays(self, light: int, batch: RayBatch, lookups: Lookups, progress: Progress) -> None:
        """Compute the colours of pixels under a light with one ray per pixel. Refinement starts from these colours."""
        light_pass, sums = self._passes[light], self._light_sums
        lobes = light_pass.first_lobes
        for at, lobe in enumerate(lobes):
            self.sampler.scatter(0, LobeIndex(light, lobe), sums)
            launch_pipeline(
                light_pass.colour(lobe, batch, lookups), self.rays.size, slice_size=_COLOURS_OF_SLICE,
                progress=subprogress(progress, at / len(lobes), (at + 1) / len(lobes)), **self.rays.options,
            )  # fmt: skip

    def render_directly(
        self, heightfield: HeightField, plan: Plan, *, progress: Progress,
        xyz_by_part: list[NDArray[np.float32]] | None = None,
    ) -> None:  # fmt: skip
        """Compute the picture by the direct sum over height samples, for every ray and every light, without tables.

        The list ``xyz_by_part`` is filled as in :meth:`render`.
        """
        for index, share in self.sampled(progress, xyz_by_part):
            scattering_vectors, to_lights, gains = (values.astype(np.float64) for values in self.sampler.directions())
            by_finish = self.illuminated(index)
            finishes = self.context.finishes_of_hits()
            if finishes is None:
                finishes = np.zeros(self.rays.size, dtype=np.int32)
            for finish, (illuminated,) in enumerate(by_finish):
                part = subprogress(share, finish / len(by_finish), (finish + 1) / len(by_finish))
                added = direct_colour(
                    heightfield, scattering_vectors, to_lights, np.where(finishes == finish, gains, 0.0), plan,
                    illuminated, progress=part,
                )  # fmt: skip
                self._sums.xyz.assign((self._sums.xyz.numpy() + added).astype(np.float32))

    @property
    def xyz(self) -> wp.array:
        """Colours of the picture, shape (height, width), without the margin.

        The margin consists of pixels that are added around the picture. Without a margin, the array is that of the
        sums; otherwise it is a copy of the inner part.
        """
        colours = self._sums.xyz.reshape((self.rays.height, self.rays.width))
        if self.rays.size == self.view.width * self.view.height:
            return colours
        if self._shown_xyz is None:
            self._shown_xyz = wp.empty((self.view.height, self.view.width), dtype=wp.vec3f, device=self.context.device)
        wp.copy(self._shown_xyz, colours[self._inner])
        return self._shown_xyz

    def _cropped(self, values: wp.array | NDArray[Any]) -> NDArray[Any]:
        """Return values of all pixels as an array on the host, without the margin of pixels around the picture."""
        values = values.numpy() if isinstance(values, wp.array) else values
        return np.ascontiguousarray(values.reshape(self.rays.height, self.rays.width, *values.shape[1:])[self._inner])

    @np.errstate(under="ignore")
    def image(self, plans: Sequence[Plan]) -> Image:
        """Return the finished picture with the first of the plans, and with errors estimated by the least accurate one.

        A plan has the numbers of the computation for one surface, and predicts its errors.
        """
        sums = self._sums
        xyz, coverage, illuminated = map(self._cropped, (sums.xyz, sums.coverage, sums.illuminated))
        coverage = coverage.astype(np.float32)
        if self.context.dots is not None:
            # Colours of dots are interpolated between tables with weights that may be negative.
            xyz = np.maximum(xyz, 0.0)

        def part(values: wp.array | NDArray[Any]) -> NDArray[Any] | None:
            return self._cropped(values)[illuminated] if len(values) else None

        contrasts = None
        if self._means:
            # A contrast is the largest difference between the colours of a pixel and its neighbours. Contrasts are
            # computed before the margin is removed, because pixels at the border require all their neighbours.
            padded = sums.xyz.numpy().reshape(self.rays.height, self.rays.width, 3)
            contrasts = part(pixel_filter.contrasts(padded).ravel())
        tolerance = min(plan.tolerance for plan in plans)
        textures = texture_error(tolerance) if self._means and self.context.is_textured else 0.0
        parts = ErrorParts(xyz[illuminated], contrasts, cells=part(sums.errors), textures=textures)
        error = np.zeros(illuminated.shape, dtype=np.float32)
        error[illuminated] = relative_errors(combined_errors(parts, max(plan.error for plan in plans)), parts.xyz)
        # The fraction of refined pixels is limited to 1. The number of subdivided pixels may exceed the number of
        # covered pixels: it includes pixels in which no ray hits the mesh.
        subdivided = 0 if self._loop is None else self._loop.tiles.count
        covered = int(np.count_nonzero(sums.coverage.numpy()))
        edges = self._cropped(sums.edges) if self._means and self._refine else None
        report = report_of(
            error, illuminated, edges, tolerance=tolerance,
            light_sample_count=sum(light.sample_count for light in self._parts),
            refined_share=min(subdivided / max(covered, 1), 1.0),
        )  # fmt: skip
        return Image(
            xyz=xyz, mask=coverage > 0.0, illuminated=illuminated, coverage=coverage, error=error, plan=plans[0],
            report=report,
        )  # fmt: skip
