"""The arrays of a picture on a device, and the launches that fill them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.compute.device import load
from warpdiff.compute.pipeline import KernelCall, begin_pipeline, launch, launch_pipeline
from warpdiff.core import fork_safety
from warpdiff.evaluate.directions import direct_colour
from warpdiff.image.image import Image, relative_errors
from warpdiff.kernels import adaptive, bvh, ray_hits, scattering, shadow_grid
from warpdiff.kernels.shadow_grid import trace_shadow_rays
from warpdiff.kernels.structs import Cells, Sampling
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.plans.direction_range import DirectionRange, DirectionSample
from warpdiff.render import adaptive_sampling, pixel_filters
from warpdiff.render.direction_statistics import BLOCK, DirectionStatistics
from warpdiff.render.gbuffer import GBuffer
from warpdiff.scene import device_mesh
from warpdiff.scene.shadow_grid import grid_for, grid_pays, no_grid

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from warpdiff.core.thread_pool import Work
    from warpdiff.optics.coherence import Coherence
    from warpdiff.plans.plan import Plan
    from warpdiff.render.gbuffer import TileBuffers
    from warpdiff.scene.camera import View
    from warpdiff.scene.lights import DirectionalLight
    from warpdiff.scene.mesh_import import Surface
    from warpdiff.surface.heightfield import HeightField
    from warpdiff.tables.integrator import Integrator

_SEED = 0
# Samples of a pixel that are measured; rays of means, whose cells see more than pixels' centres do, and of a pixel.
_SAMPLES_MEASURED, _CELLS_MEASURED, _MOST_SAMPLES_MEASURED = 4, 8192, 16
# What a mean over a pixel errs by, of what 99 of 100 directions of a plan err by at most.
_MEAN_ERROR_PER_PLAN_ERROR = 0.3
# Pixels' own rays, as a share of a light's progress.
_PROGRESS_OF_FIRST_RAYS = 0.3
# Shadow rays of the cells of a pixel that is split, about: of a snake 22 at 1e-1, 43 at 3e-2.
_SHADOW_RAYS_OF_CELLS = 16
# Of a slice: pixels whose rays are found, or whose colours are, and faces.
_RAYS_OF_SLICE, _COLOURS_OF_SLICE, _FACES_OF_SLICE = 8192, 2048, 2048


def load_kernels(device: wp.Device) -> None:
    """Begin to load what every picture needs, while the mesh is looked at."""
    load([ray_hits.intersect_known_faces, scattering.scattering_vectors, shadow_grid.trace_shadow_rays], device)


class Frame:
    """A picture of a surface: seen by a view, lit, and filled with colours; then by another view, or lit otherwise."""

    def __init__(
        self,
        surface: Surface,
        view: View,
        *,
        smooth: bool = True,
        samples: int = 1,
        means: bool = False,
        device_driven: bool | None = None,
        device: wp.Device,
        threads: int,
    ) -> None:
        """A frame of so many samples a pixel, or of means over pixels that are split into at least as many cells.

        If ``device_driven`` the device fills it from the view and the lights on without the host, so that its launches
        may be recorded; None is so on a GPU. Otherwise the host has a part, which is faster on the CPU.
        """
        # Means begin with one ray a pixel.
        self._samples, self._least = 1 if means else samples, samples
        self._device = device
        self._threads = threads
        self._device_driven = not device.is_cpu if device_driven is None else device_driven
        self._surface = surface
        self._scene = device_mesh.arrays_for(surface, smooth=smooth, device=device)
        self._axes = wp.empty(5, dtype=wp.vec3d, device=device)
        self._size = size = view.width * view.height
        self._means = means
        # The pixels that may see anything, of whole blocks and with a row more on either side, once faces have told.
        self.may_see = range(size if self._device_driven else 0)
        self._rows = wp.empty(2, dtype=wp.int32, device=device)
        # A GPU has no lack of threads for rays, and no use for faces of uneven sizes.
        self._nearest = wp.empty(0 if self._device_driven else size, dtype=wp.uint64, device=device)
        # Where rays of a sample lie, if each pixel's lies elsewhere.
        self._offsets = wp.empty(0, dtype=wp.vec2d, device=device)
        # Faces that are yet finding their pixels.
        self._covering: Work | None = None
        self.set_view(view)
        # While these are at it: room for what they see.
        self._none_hidden = wp.empty(0, dtype=wp.bool, device=device)
        # XYZ, coverage, and what any light reaches: zeros, which are no memory yet, where no pixel is written to.
        zeros = (np.zeros((size, 3), dtype=np.float32), np.zeros(size), np.zeros(size, dtype=np.bool_))
        dtypes = (wp.vec3f, wp.float64, wp.bool)
        self._sums = [
            wp.array(each, dtype=dtype, device=device, copy=device.is_cuda)
            for each, dtype in zip(zeros, dtypes, strict=True)
        ]
        self._no_sums = [wp.empty(0, dtype=dtype, device=device) for dtype in dtypes]
        # One light's, where pictures are sums, what these and it err by, and what a table leaves out.
        self._colours = wp.empty(0, dtype=wp.vec3f, device=device)
        self._errors: list[wp.array] = []
        self._left_out = wp.empty(0, dtype=wp.float32, device=device)
        self._queue: adaptive_sampling.DeviceQueue | None = None
        self._lights: Any = None
        self._to_lights: list[tuple[float, float, float]] = []
        self._shadows = False
        self._grids: dict[int, Any] = {}
        # Pixels that were split, and that this does not settle, of the light of which these are most.
        self._split = np.zeros(2)

    @property
    def options(self) -> dict[str, Any]:
        """The device and the number of threads of launches."""
        return {"device": self._device, "threads": self._threads}

    def set_view(self, view: View) -> None:
        """Set the view, of the same size as any before."""
        self._end_covering()
        self.view = view
        self._camera = device_mesh.camera(view, self._surface, axes=self._axes)
        self._may_be_hidden = device_mesh.needs_shadow_rays(self._surface, view)
        if not self._device_driven and self._samples == 1:
            self._covering = self._begin_to_rasterize(self._sampling(0, 1))
        self.invalidate_gbuffer()

    @fork_safety.cached_property
    def seen(self) -> GBuffer:
        """The G-buffer of the pixels' own rays, under the last light."""
        coloured = self._surface.has_base_colour
        return GBuffer.by(self._size, device=self._device, means=self._means, coloured=coloured)

    def _end_covering(self) -> None:
        """Wait for faces that are finding pixels of a view that is no longer looked at."""
        covering, self._covering = self._covering, None
        if covering is not None:
            covering.abandon()

    def invalidate_gbuffer(self) -> None:
        """Forget what was cast and deflected."""
        # The sample and the light whose are what arrays hold.
        self._now: tuple[int | None, int | None] = (None, None)

    def set_lights(
        self,
        lights: Sequence[DirectionalLight],
        window: Coherence,
        area_um2: float,
        *,
        normal: float,
        masking: bool = True,
        pigment: float = 0.0,
        shadows: bool = True,
    ) -> None:
        """Set the lights and the reflectance.

        Args:
            lights: One or several.
            window: The coherence.
            area_um2: Of the height field.
            normal: R(0).
            masking: Whether V-cavity masking is included.
            pigment: Its strength.
            shadows: Whether the mesh may hide the lights.
        """
        self.pigmented = pigment > 0.0 and self._surface.has_base_colour
        grid_um = np.arange(colorimetry.LAMBDA_MIN_NM, colorimetry.LAMBDA_MAX_NM + 1, dtype=np.float64) * 1e-3
        solid_angle = reflectance_factors.pigment_solid_angle(grid_um, window, area_um2)
        whites = [
            colorimetry.xyz_to_rgb(solid_angle @ colorimetry.colour_products(name))
            for name in (each.illuminant for each in lights)
        ]
        if self._lights is None or len(self._to_lights) != len(lights):
            self._lights = scattering.Lights()
            for name, dtype in (("to_lights", wp.vec3d), ("strengths", wp.vec2d), ("white_rgb", wp.vec3d)):
                setattr(self._lights, name, wp.empty(len(lights), dtype=dtype, device=self._device))
            self._lights.rgb_to_xyz = wp.mat33d(*colorimetry.RGB_TO_XYZ.ravel())
        of_pigment = pigment / normal if self.pigmented else 0.0
        self._lights.to_lights.assign(np.array([each.to_light for each in lights]))
        self._lights.strengths.assign(np.array([(each.power, of_pigment) for each in lights]))
        self._lights.white_rgb.assign(np.array(whites))
        self._to_lights = [each.to_light for each in lights]
        self._shadows = shadows
        self._grids = {}
        self._reflection = scattering.Reflection()
        self._reflection.normal_reflectance = normal
        self._reflection.masking = masking
        self._reflection.per_light_cosine = window.kind == "source"
        self._now = self._now[0], None

    @property
    def launches_depend_on(self) -> tuple[Any, ...]:
        """The part of the view and the lights that the launches depend on; all else of these is on the device."""
        return len(self._to_lights), self.view.extent_y is None, self.casts_shadows, self.pigmented

    def measure_directions(
        self, hf: HeightField, window: Coherence, *, sampled: bool = True
    ) -> tuple[DirectionRange, int, DirectionSample]:
        """The range of all lit directions, their number, and some of them unless they are of no use.

        That is a first pass over the rays, which cost a hundredth of the colours.
        """
        within, count = DirectionRange(0.0, 0.0, 0.0, 0.0), 0
        seen = []
        # A few rays a pixel see what all do, and of many pixels their own rays what cells do.
        samples, measured = self._samples, min(self._samples, _SAMPLES_MEASURED)
        if self._means:
            pixels = max(device_mesh.pixels_within(self._surface, self.view), 1)
            samples = measured = min(-(-_CELLS_MEASURED // pixels), _MOST_SAMPLES_MEASURED)
        for sample in range(measured):
            for light_index in range(len(self._to_lights)):
                summary = DirectionStatistics(hf, window, self._size, device=self._device)
                # Means begin with the pixels' centres.
                self.deflect(sample, light_index, summary, samples=1 if self._means and sample == 0 else samples)
                parts = len(self._to_lights) * (measured if self._means else sample == 0) if sampled else 0
                found, lit, some = summary.found(parts=parts, among=self.may_see)
                within = within.joined(found)
                count += lit
                seen.append(some)
        if measured > self._samples:
            self.invalidate_gbuffer()
        return within, count * self._samples // measured, DirectionSample.joined(seen)

    def _passes(self, progress: Callable[[float], None] | None) -> Iterator[tuple[int, Callable[[float], None] | None]]:
        """Cast and deflect sample after sample, light after light.

        Yields a light's index, and the pass' share of progress.
        """
        count = len(self._to_lights)
        for sample in range(self._samples):
            for light_index in range(count):
                # Measuring directions has left behind what a single pass needs.
                if self._now != (sample, light_index):
                    self.deflect(sample, light_index)
                index, passes = sample * count + light_index, self._samples * count
                yield light_index, _part(progress, index / passes, (index + 1) / passes)

    def integrate(
        self,
        integrator: Integrator,
        illuminants: list[str],
        *,
        tolerance: float,
        refine: bool = True,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Add the diffraction colours of all samples and lights."""
        if self._means:
            self._integrate_means(integrator, illuminants, tolerance=tolerance, refine=refine, progress=progress)
            return
        left_out = self._left_out_buffer(integrator)
        for light_index, share in self._passes(progress):
            integrator.add(
                *self.seen.directions, illuminants[light_index], self._sums[0], left_out=left_out, among=self.may_see,
                progress=share,
            )  # fmt: skip

    def _left_out_buffer(self, integrator: Integrator) -> wp.array:
        """An array of a picture's size, which is made once, for a table that leaves directions out."""
        if integrator.leaves_out and not len(self._left_out):
            self._left_out = wp.empty(self._size, dtype=wp.float32, device=self._device)
        return self._left_out

    def _integrate_means(
        self,
        integrator: Integrator,
        illuminants: list[str],
        *,
        tolerance: float,
        refine: bool,
        progress: Callable[[float], None] | None,
    ) -> None:
        """Add means over pixels, which are split where one ray does not tell them."""
        self._split = np.zeros(2)
        if not self._errors:
            self._errors = [wp.empty(self._size, dtype=wp.float32, device=self._device) for _ in range(2)]
        left_out = self._left_out_buffer(integrator)
        several, colours = len(self._to_lights) > 1, self._colours_of_one
        errors = self._errors[several]
        self._errors[0].zero_()
        if several:
            self._sums[0].zero_()
        for light_index, share in self._passes(progress):
            if several:
                errors.zero_()
            illuminant, seen = illuminants[light_index], self.seen
            steps = [self._spread(seen, pixel_filters.deviation_at(0, means=True))] if integrator.blurs else []
            steps += integrator.steps(
                *seen.directions, illuminant, colours, seen.footprints if integrator.blurs else None, left_out
            )
            first, rest = _part(share, 0.0, _PROGRESS_OF_FIRST_RAYS), _part(share, _PROGRESS_OF_FIRST_RAYS, 1.0)
            launch_pipeline(steps, self.may_see, slice_size=_COLOURS_OF_SLICE, progress=first, **self.options)
            light = adaptive_sampling.LightRefinement(
                self, integrator, light_index, illuminant, colours, errors, self._sums[1:], tolerance,
                pixel_filters.level_of(self._least, means=integrator.blurs), refine,
            )  # fmt: skip
            if self._device_driven:
                self._queue = self._queue or adaptive_sampling.DeviceQueue(light, self._size)
                self._queue.work_off(light)
            else:
                self._split = np.maximum(self._split, adaptive_sampling.split(light, rest))
            if rest is not None:
                rest(1.0)
            if several:
                step = KernelCall(
                    adaptive.accumulate, [colours, errors], [self._sums[0], self._errors[0]], in_runs=True
                )
                self._launch([step])

    @property
    def _colours_of_one(self) -> wp.array:
        """Where a light's colours come: of means under several lights by themselves, otherwise in the picture."""
        if not self._means or len(self._to_lights) == 1:
            return self._sums[0]
        if not len(self._colours):
            self._colours = wp.zeros(self._size, dtype=wp.vec3f, device=self._device)
        return self._colours

    def rasterize_cells(self, cells: Any, pixels: int) -> NDArray[np.uint64]:
        """Rasterize the cells of so many pixels: the nearest faces, one pixel's after the other."""
        nearest = wp.full(pixels * cells.across**2, ray_hits.UNSEEN, dtype=wp.uint64, device=self._device)
        inputs = [self._camera, self._scene.bare, self._sampling(0, 1), cells, 0.0]
        launch(
            ray_hits.rasterize, self._scene.face_count, inputs, [nearest, self._rows[:0]], slice_size=_FACES_OF_SLICE,
            in_runs=True, **self.options,
        )  # fmt: skip
        return np.asarray(nearest.numpy())

    def steps_of_cells(
        self,
        integrator: Integrator,
        light_index: int,
        illuminant: str,
        level: int,
        buffers: TileBuffers,
        *,
        shadows: bool,
    ) -> list[KernelCall]:
        """The calls that add the colours of cells under a light to zeros in the buffers."""
        seen, means = buffers.seen, integrator.blurs
        sampling = Sampling()
        sampling.tiles, sampling.places = buffers.tiles[level], pixel_filters.places_at(level, self._device.alias)
        steps = self._steps_of_rays(sampling, seen.pixels)
        sums = [buffers.colours, *self._no_sums[1:]]
        steps += self._deflect(light_index, seen, 1.0, sums, sample=0, shadows=shadows)
        if means:
            steps.append(self._spread(seen, pixel_filters.deviation_at(level, means=True)))
        footprints = seen.footprints if means else None
        return [*steps, *integrator.steps(*seen.directions, illuminant, buffers.colours, footprints, buffers.left_out)]

    def sum_directly(
        self, hf: HeightField, plan: Plan, illuminants: list[str], *, progress: Callable[[float], None] | None
    ) -> None:
        """Add the colours of all samples and lights by the direct sum."""
        for light_index, share in self._passes(progress):
            deflections, to_lights, gains = (each.astype(np.float64) for each in self.directions())
            added = direct_colour(hf, deflections, to_lights, gains, plan, illuminants[light_index], progress=share)
            self._sums[0].assign((self._sums[0].numpy() + added).astype(np.float32))

    def cast(self, sample: int) -> None:
        """Send one ray through every pixel."""
        self._launch(self._cast(sample, self._samples))
        self._now = sample, None

    def _launch(self, steps: Sequence[KernelCall]) -> None:
        """Launch what finds rays and directions over all pixels."""
        launch_pipeline(steps, self.may_see, slice_size=_RAYS_OF_SLICE, **self.options)

    def _begin_to_rasterize(self, sampling: Any) -> Work:
        """Let faces find their pixels, while there is yet to be room for what these see, and a grid for shadow rays."""
        self._nearest.fill_(ray_hits.UNSEEN)
        self._rows.assign([self.view.height, -1])
        reach = 0.0 if sampling.samples == 1 else ray_hits.MOST_OFFSET
        inputs = [self._camera, self._scene.bare, sampling, Cells(), reach]
        rasterize = KernelCall(ray_hits.rasterize, inputs, [self._nearest, self._rows], in_runs=True)
        return begin_pipeline([rasterize], self._scene.face_count, slice_size=_FACES_OF_SLICE, **self.options)

    def _keep_to(self, first_row: int, last_row: int) -> None:
        """Look at pixels of these rows alone from now on, and leave zeros elsewhere.

        They are the same for all samples of a view: how far these lie from pixels' centres is reckoned in for each.
        """
        written = self.may_see
        if first_row <= last_row:
            first = max(int(first_row) - 1, 0) * self.view.width // BLOCK
            end = -(-(int(last_row) + 2) * self.view.width // BLOCK)
            self.may_see = range(first * BLOCK, min(end * BLOCK, self._size))
        else:
            self.may_see = range(0)
        for sums in self._sums:
            values = sums.numpy()
            values[written.start : min(written.stop, self.may_see.start)] = 0
            values[max(written.start, self.may_see.stop) : written.stop] = 0

    def _cast(self, sample: int, samples: int) -> list[KernelCall]:
        """The calls that send one ray through every pixel."""
        self.invalidate_gbuffer()
        sampling = self._sampling(sample, samples)
        if not self._device_driven:
            covering, self._covering = self._covering or self._begin_to_rasterize(sampling), None
            with covering:
                self.seen.pixels.nearest = self._nearest
            self._keep_to(*self._rows.numpy())
        return self._steps_of_rays(sampling, self.seen.pixels)

    def _sampling(self, sample: int, samples: int) -> Any:
        """Where a sample of every pixel lies."""
        sampling = Sampling()
        sampling.sample, sampling.samples, sampling.seed = sample, samples, _SEED
        if samples > 1 and not self._device_driven:
            if not len(self._offsets):
                self._offsets = wp.empty(self._size, dtype=wp.vec2d, device=self._device)
            inputs = [sample, samples, _SEED]
            launch(
                ray_hits.place_samples,
                self._size,
                inputs,
                [self._offsets],
                slice_size=_RAYS_OF_SLICE,
                in_runs=True,
                **self.options,
            )
            sampling.offsets = self._offsets
        return sampling

    def _steps_of_rays(self, sampling: Any, pixels: Any) -> list[KernelCall]:
        """The calls that find where rays meet the mesh, and its shading frames there."""
        arrays = self._scene.with_hierarchy() if self._device_driven else self._scene.bare
        find = bvh.trace_bvh if self._device_driven else ray_hits.intersect_known_faces
        return [
            KernelCall(find, [self._camera, arrays, sampling, pixels], [], in_runs=True),
            KernelCall(ray_hits.make_shading_frames, [arrays, pixels], [], in_runs=True),
        ]

    @property
    def casts_shadows(self) -> bool:
        """Whether the mesh may hide the lights."""
        return self._shadows and self._may_be_hidden

    def _grid_of(self, light_index: int) -> Any:
        """A grid of faces for shadow rays where it is worth it, once rays are cast."""
        if light_index not in self._grids:
            rays = 0 if self._device_driven else self._samples * int(np.count_nonzero(self._hits()))
            self._grids[light_index] = self._grid_for(light_index, rays, **self.options)
        return self._grids[light_index]

    def expect_cells(self, light_index: int, pixels: int) -> None:
        """Get ready for the shadow rays of so many pixels that are split."""
        rays = _SHADOW_RAYS_OF_CELLS * pixels
        if self.casts_shadows and grid_pays(self._scene.face_count, rays):
            self._grids[light_index] = self._grid_for(light_index, rays, **self.options)

    def _grid_for(self, light_index: int, rays: int, **options: Any) -> Any:
        if not grid_pays(self._scene.face_count, rays):
            return no_grid(self._scene, few=not self._device_driven)
        return grid_for(self._surface, self._scene, self._to_lights[light_index], **options)

    def deflect(
        self, sample: int, light_index: int, summary: DirectionStatistics | None = None, *, samples: int | None = None
    ) -> None:
        """Compute the deflections and gains of a sample under one light, add its pigment, and sum up, if that is asked.

        Rays are cast first, if they are another sample's.
        """
        steps: list[KernelCall] = []
        if self._now[0] != sample:
            steps = self._cast(sample, samples or self._samples)
            if self.casts_shadows and light_index not in self._grids:
                # Whether a grid is worth it, those that meet the mesh tell.
                self._launch(steps)
                steps = []
        sums = [self._colours_of_one, *self._sums[1:]]
        steps += self._deflect(light_index, self.seen, 1.0 / (samples or self._samples), sums, sample=sample)
        if summary is not None:
            steps.append(summary.step(*self.seen.directions))
        self._launch(steps)
        self._now = sample, light_index

    def hidden_of(self, seen: GBuffer, *, shadows: bool = True) -> wp.array:
        """From which of the points that rays meet a light is hidden; empty is none of them."""
        return seen.hidden if shadows and self.casts_shadows else self._none_hidden

    def _deflect(
        self, light_index: int, seen: GBuffer, weight: float, sums: list[wp.array], *, sample: int, shadows: bool = True
    ) -> list[KernelCall]:
        shadows, hidden = shadows and self.casts_shadows, self.hidden_of(seen, shadows=shadows)
        # What is covered counts once.
        counted, begins = weight if light_index == 0 else 0.0, light_index == 0 and sample == 0
        # Of means each light's colours are found by themselves.
        resets = begins or self._means
        inputs = [seen.pixels, self._lights, light_index, self._reflection, weight, counted, begins, resets, hidden]
        steps = [KernelCall(scattering.scattering_vectors, inputs, [*seen.directions, *sums], in_runs=True)]
        if shadows:
            inputs = [self._grid_of(light_index), self._lights.to_lights, light_index, seen.pixels]
            steps.insert(0, KernelCall(trace_shadow_rays, inputs, [hidden], in_runs=True))
        return steps

    def directions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The last deflections, directions to the light and gains."""
        deflections, to_lights, gains = (self._looked_at(each) for each in self.seen.directions)
        return deflections, to_lights, gains

    def met(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
        """Hits of the pixels' central rays: whether, which face, where on it, and the shading normal."""
        self._launch(self._cast(0, 1))
        pixels = self.seen.pixels
        hit, face, place, normal = map(self._looked_at, (pixels.hit, pixels.face, pixels.place, pixels.normal))
        return hit, face, place, normal

    def _hits(self) -> NDArray[np.int32]:
        """Which pixels' rays have met the mesh."""
        return self._looked_at(self.seen.pixels.hit)

    def _looked_at(self, values: wp.array) -> NDArray[Any]:
        """Values of all pixels on the host; zero for those that are not looked at."""
        all_values, seen = values.numpy(), slice(self.may_see.start, self.may_see.stop)
        found: NDArray[Any] = np.zeros_like(all_values)
        found[seen] = all_values[seen]
        return found

    def _spread(self, seen: GBuffer, deviation: float) -> KernelCall:
        """The call that finds the footprints of filters of a deviation [pixels]."""
        inputs = [self._camera, self._scene.bare, seen.pixels, seen.deflections, deviation]
        return KernelCall(scattering.pixel_footprints, inputs, [seen.footprints], in_runs=True)

    @property
    def xyz(self) -> wp.array:
        """The colours, (height, width), where they are."""
        return self._sums[0].reshape((self.view.height, self.view.width))

    @np.errstate(under="ignore")
    def image(self, plan: Plan) -> Image:
        """The finished picture."""
        shape = (self.view.height, self.view.width)
        xyz, coverage, lit = (sums.numpy() for sums in self._sums)
        coverage = coverage.astype(np.float32).reshape(shape)
        # That of a table, or of sums over wavelengths, is in proportion to the colour.
        errors = (_MEAN_ERROR_PER_PLAN_ERROR if self._means else 1.0) * plan.error * np.linalg.norm(xyz, axis=1)
        if self._errors:
            errors += self._errors[0].numpy()
        error = relative_errors(errors, xyz, lit) * lit
        told = np.percentile(error[lit], (50.0, 99.0)).tolist() if lit.any() else (0.0, 0.0)
        found = self._split if self._queue is None else np.array(self._queue.counts)
        # Where only cells may meet the mesh, pixels are split that do not.
        split, unsettled = np.minimum(found / max(int(np.count_nonzero(coverage)), 1), 1.0)
        return Image(
            xyz=xyz.reshape(*shape, 3),
            mask=coverage > 0.0,
            lit=lit.reshape(shape),
            coverage=coverage,
            error=error.reshape(shape),
            plan=replace(plan, split=float(split), unsettled=float(unsettled), errors=(told[0], told[1])),
        )


def _part(progress: Callable[[float], None] | None, begin: float, end: float) -> Callable[[float], None] | None:
    """The progress of what is a part of all."""
    if progress is None:
        return None
    return lambda done: progress(begin + (end - begin) * done)
