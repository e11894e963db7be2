"""The arrays of a picture on a device, and the launches that fill them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core.threads import subprogress
from warpdiff.device.devices import load
from warpdiff.device.kernel_calls import KernelCall, launch_pipeline
from warpdiff.evaluate.reflectance import direct_colour
from warpdiff.image.image import EDGES_PER_TOLERANCE, Image, lengths, relative_errors, share_beyond
from warpdiff.kernels import light_samples, primary_hits, sky_sum, subdivision
from warpdiff.kernels.shadow_rays import trace_shadow_rays
from warpdiff.kernels.structs import Sampling
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.materials import IlluminatedMaterial, transmittances
from warpdiff.render import pixel_filter, refinement
from warpdiff.render.camera_rays import RAYS_OF_SLICE, PixelRays, RasterizedRays
from warpdiff.render.device_tiles import DeviceSchedule
from warpdiff.render.threaded_tiles import HostSchedule
from warpdiff.request.directions import DirectionRange, DirectionSample

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.lights.light_types import Lobe
    from warpdiff.lights.sky_maps import SkyMaps
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.materials import Material
    from warpdiff.render.gbuffer import GBuffer, TileBuffers
    from warpdiff.request.plan import Plan
    from warpdiff.scene.camera import View
    from warpdiff.scene.mesh_import import Surface
    from warpdiff.tables.lookup import ColourLookup

# Samples of a pixel that are measured; rays of means, whose cells see more than pixels' centres do, and of a pixel.
_SAMPLES_MEASURED, _CELLS_MEASURED, _MOST_SAMPLES_MEASURED = 4, 8192, 16
# What a mean over a pixel errs by, of what 99 of 100 directions of a plan err by at most, where its contrast with those
# beside it is as large as its colour: a table errs where colours change, and by the eighth root of how much they do.
_MEAN_ERROR_PER_PLAN_ERROR = 0.32
# What bounds 95 of 100 errors, over the root sum of squares of what cells and a table err by: see
# docs/decisions/error_estimates.md.
_BOUND_OF_BOTH = 1.1
# What a sum over cells of a sky errs by, of what each may, as if these did not depend on each other.
_ERROR_PER_COARSENESS = 0.7
# Pixels' own rays, as a share of a light's progress.
_PROGRESS_OF_FIRST_RAYS = 0.3
# Power of lights at a place, at a distance of the mesh's radius: squares of colours near them are float32.
_MOST_NEARBY = 1e9
# Shadow rays of the cells of a pixel that is split, about: of a snake 22 at 1e-1, 43 at 3e-2.
_SHADOW_RAYS_OF_CELLS = 16
# Pixels of a slice, whose colours are found.
_COLOURS_OF_SLICE = 2048


def load_kernels(device: wp.Device) -> None:
    """Begin to load what every picture needs, while the mesh is looked at."""
    load([primary_hits.intersect_known_faces, light_samples.scattering_vectors, trace_shadow_rays], device)


class Picture:
    """A picture of a surface: seen by a view, lit, and filled with colours; then by another view, or lit otherwise."""

    def __init__(
        self,
        surface: Surface,
        view: View,
        *,
        smooth: bool = True,
        samples: int = 1,
        means: bool = False,
        margin: int = 0,
        materials_of_faces: NDArray[np.int32] | None = None,
        device_driven: bool | None = None,
        device: wp.Device,
        threads: int,
    ) -> None:
        """A frame of so many samples a pixel, or of means over pixels that are split into at least as many cells.

        A ``margin`` of so many pixels on each side is rendered, too, and is not shown: what filters reach there.

        ``materials_of_faces`` says which of several materials each face is of; None is that there is one.

        If ``device_driven`` the device fills it from the view and the lights on without the host, so that its launches
        may be recorded; None is so on a GPU. Otherwise the host has a part, which is faster on the CPU.
        """
        # Means begin with one ray a pixel.
        self._samples, self._least = 1 if means else samples, samples
        self._device, self._surface, self._means = device, surface, means
        self.has_materials = materials_of_faces is not None
        self._of_faces = wp.array(
            [] if materials_of_faces is None else materials_of_faces, dtype=wp.int32, device=device
        )
        options: dict[str, Any] = {"smooth": smooth, "means": means, "device": device, "threads": threads}
        options |= {"materials": self.has_materials, "margin": margin}
        on_device = not device.is_cpu if device_driven is None else device_driven
        self.rays = (PixelRays if on_device else RasterizedRays)(surface, view, **options)
        self._size = size = self.rays.width * self.rays.height
        self._inner = (slice(margin, margin + view.height), slice(margin, margin + view.width))
        self._shown: wp.array | None = None
        self.invalidate_gbuffer()
        self._none_hidden = wp.empty(0, dtype=wp.bool, device=device)
        # XYZ, coverage, and what any light reaches.
        dtypes = (wp.vec3f, wp.float64, wp.bool)
        self._sums = [wp.zeros(size, dtype=dtype, device=device) for dtype in dtypes]
        self._no_sums = [wp.empty(0, dtype=dtype, device=device) for dtype in dtypes]
        # Where pictures are sums, a light's, and what it reaches; what both err by, and what a table leaves out.
        self._colours = wp.empty(0, dtype=wp.vec3f, device=device)
        self._lit_by_one = wp.empty(0, dtype=wp.bool, device=device)
        self._errors: list[wp.array] = []
        # Under skies, what pixels' own rays err by; or empty.
        self._estimates = self._no_estimates = wp.empty(0, dtype=wp.vec2f, device=device)
        # What is hidden of a light of several lobes, and what all such penumbrae err by; or empty.
        self._shadow, self._penumbrae = (wp.empty(0, dtype=wp.float32, device=device) for _ in range(2))
        # Through which pixels an edge passes, as cells have found.
        self._edges = wp.empty(0, dtype=wp.bool, device=device)
        self._refined = False
        self._left_out = wp.empty(0, dtype=wp.float32, device=device)
        self._schedule: HostSchedule | DeviceSchedule | None = None
        self._lights: Any = None
        self._lit: list[tuple[tuple[IlluminatedMaterial, ...], ...]] = []
        self._skies: list[SkyMaps | None] = []
        self._sky_maps: dict[SkyMaps, Any] = {}
        self._transmittances: wp.array | None = None
        self._energy: wp.array | None = None
        self._to_lights: list[tuple[float, float, float]] = []
        self._have_sizes: list[bool] = []
        # Lights are one lobe each, or several that follow each other.
        self._lobes_of_lights: list[range] = []
        self._at_places: list[bool] = []
        self._shadows = False
        self._grids: dict[int, Any] = {}

    def set_view(self, view: View) -> None:
        """Set the view, of the same size as any before."""
        self.rays.set_view(view)
        self.invalidate_gbuffer()

    @property
    def view(self) -> View:
        """The last view."""
        return self.rays.view

    @property
    def seen(self) -> GBuffer:
        """The G-buffer of the pixels' own rays, under the last light."""
        return self.rays.seen

    def invalidate_gbuffer(self) -> None:
        """Forget what was cast and deflected."""
        # The sample and the light whose are what arrays hold.
        self._now: tuple[int | None, int | None] = (None, None)

    def set_lights(
        self,
        lights: Sequence[Lobe],
        window: Coherence,
        area_um2: float,
        *,
        normal: float,
        materials: Sequence[Material | None] = (None,),
        masking: bool = True,
        energy: NDArray[np.float32] | None = None,
        pigment: float = 0.0,
        shadows: bool = True,
    ) -> None:
        """Set the lights and the reflectance.

        Args:
            lights: One or several.
            window: The coherence.
            area_um2: Of the height field.
            normal: R(0).
            materials: Those of faces; None is one by Schlick's reflectance of ``normal``.
            masking: Whether V-cavity masking is included.
            energy: Factors that make energy whole, as ``AchromaticFactors`` has them, the same every time; None leaves
                Stam's as it is.
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
            self._lights = light_samples.Lights()
            for name, dtype in (
                ("places", wp.vec4d), ("strengths", wp.vec2d), ("white_rgb", wp.vec3d),
            ):  # fmt: skip
                setattr(self._lights, name, wp.empty(len(lights), dtype=dtype, device=self._device))
            self._lights.deviations = wp.empty((len(lights), 2), dtype=wp.vec3f, device=self._device)
            self._lights.rgb_to_xyz = wp.mat33d(*colorimetry.RGB_TO_XYZ.ravel())
        of_pigment = pigment / normal if self.pigmented else 0.0
        self._at_places = [each.position is not None for each in lights]
        self._lights.places.assign(np.array([self._place_of(each) for each in lights]))
        # Distances are told in the mesh's unit, and kernels take them in its radii.
        falloffs = [self._surface.radius**-2.0 if at_place else 1.0 for at_place in self._at_places]
        strengths = [(each.power * left, of_pigment) for each, left in zip(lights, falloffs, strict=True)]
        for (strength, _), at_place in zip(strengths, self._at_places, strict=True):
            if at_place and strength > _MOST_NEARBY:
                raise ValueError(
                    f"light: power of a PointLight must be at most {_MOST_NEARBY:g} times the square of the mesh's "
                    f"radius, {self._surface.radius:g}, got {strength * self._surface.radius**2:g}; give less power"
                )
        self._lights.strengths.assign(np.array(strengths))
        self._lights.white_rgb.assign(np.array(whites))
        self._have_sizes = [each.deviations is not None for each in lights]
        firsts = [index for index, each in enumerate(lights) if not each.is_same_light]
        self._lobes_of_lights = list(map(range, firsts, [*firsts[1:], len(lights)]))
        deviations = [np.zeros((2, 3)) if each.deviations is None else each.deviations for each in lights]
        self._lights.deviations.assign(np.array(deviations, dtype=np.float32))
        self._to_lights = [each.to_light for each in lights]
        self._lit = [
            tuple(tuple(IlluminatedMaterial(name, material) for name in each.illuminants) for material in materials)
            for each in lights
        ]
        self._skies = [each.sky for each in lights]
        if any(self._skies) and not len(self._estimates):
            self._estimates = wp.zeros(self._size, dtype=wp.vec2f, device=self._device)
        # Those of before stay, where a recorded picture finds them.
        kept = self._sky_maps
        self._sky_maps = {
            sky: kept.get(sky) or self._sky_map(sky, solid_angle) for sky in self._skies if sky is not None
        }
        self._shadows = shadows
        self._grids = {}
        self._reflection = light_samples.Reflection()
        self._reflection.normal_reflectance = normal
        self._reflection.masking = masking
        if self._energy is None:
            values = np.zeros((0, 0), dtype=np.float32) if energy is None else energy
            self._energy = wp.array(values, dtype=wp.float32, device=self._device)
        self._reflection.energy = self._energy
        self._reflection.per_light_cosine = window.kind == "source"
        through = [transmittances(normal, each) for each in materials] if self.pigmented else np.zeros((0, 0, 3))
        if self._transmittances is None or self._transmittances.shape != np.shape(through)[:2]:
            self._transmittances = wp.empty(np.shape(through)[:2], dtype=wp.vec3f, device=self._device)
        # Into the same array, which a recorded picture finds again.
        self._transmittances.assign(np.asarray(through, dtype=np.float32))
        self._reflection.transmittances = self._transmittances
        self._reflection.materials = self._of_faces
        self._now = self._now[0], None

    def _sky_map(self, sky: SkyMaps, solid_angle: NDArray[np.float64]) -> Any:
        """The struct ``SkyMap`` of a light."""
        result = sky_sum.SkyMap()
        result.texels = wp.array(sky.texels, dtype=wp.vec4f, device=self._device)
        result.sides = wp.array(sky.sides, dtype=wp.int32, device=self._device)
        starts = np.cumsum([0, *((side + 2) ** 2 for side in sky.sides[:-1])])
        result.firsts = wp.array(starts, dtype=wp.int32, device=self._device)
        result.variance = sky.blur**2
        result.turn = wp.vec2f(math.cos(sky.turn), math.sin(sky.turn))
        whites = [colorimetry.xyz_to_rgb(solid_angle @ colorimetry.colour_products(each)) for each in sky.spectra]
        result.whites = wp.mat33f(*np.ravel(whites))
        return result

    def _place_of(self, light: Lobe) -> tuple[float, ...]:
        """Where a light is, in homogeneous coordinates and the surface's units."""
        if light.position is None:
            return *light.to_light, 0.0
        return *((np.asarray(light.position) - self._surface.centre) / self._surface.radius), 1.0

    @property
    def launches_depend_on(self) -> tuple[Any, ...]:
        """The part of the view and the lights that the launches depend on; all else of these is on the device."""
        sizes, lobes, places = tuple(self._have_sizes), tuple(self._lobes_of_lights), tuple(self._at_places)
        return tuple(self._skies), sizes, lobes, places, self.view.extent_y is None, self.casts_shadows, self.pigmented

    def measure_directions(
        self, heightfield: HeightField, window: Coherence
    ) -> tuple[DirectionRange, int, DirectionSample]:
        """The range of all lit directions, their number, and some of them.

        That is a first pass over the rays, which cost a hundredth of the colours.
        """
        within, count = DirectionRange(0.0, 0.0, 0.0, 0.0), 0
        some = []
        # A few rays a pixel see what all do, and of many pixels their own rays what cells do.
        samples, measured = self._samples, min(self._samples, _SAMPLES_MEASURED)
        if self._means:
            self.cast(0)
            pixels = max(int(np.count_nonzero(self.seen.pixels.hit.numpy())), 1)
            samples = measured = min(-(-_CELLS_MEASURED // pixels), _MOST_SAMPLES_MEASURED)
        for sample in range(measured):
            for light_index in range(len(self._to_lights)):
                # Means begin with the pixels' centres.
                self.deflect(sample, light_index, samples=1 if self._means and sample == 0 else samples)
                scattering_vectors, to_lights, gains = self.directions()
                illuminated = gains > 0.0
                within = within.joined(
                    DirectionRange.of(heightfield, window, scattering_vectors, to_lights, illuminated)
                )
                count += int(np.count_nonzero(illuminated))
                if self._means or sample == 0:
                    parts = len(self._to_lights) * (measured if self._means else 1)
                    some.append(DirectionSample.among(scattering_vectors, to_lights, gains, parts))
        if measured > self._samples:
            self.invalidate_gbuffer()
        return within, count * self._samples // measured, DirectionSample.joined(some)

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
                yield light_index, subprogress(progress, index / passes, (index + 1) / passes)

    def integrate(
        self,
        lookup: ColourLookup,
        *,
        tolerance: float,
        refine: bool = True,
        progress: Callable[[float], None] | None = None,
        previews: Sequence[tuple[float, Callable[[], None]]] = (),
    ) -> None:
        """Add the diffraction colours of all samples and lights.

        Where the host splits pixels, the picture of each ``previews`` tolerance, from the largest one on, is there when
        the function beside it is called.
        """
        if self._means:
            if len(self._lobes_of_lights) > 1:
                # Each light takes all of its cells before the next.
                parts = len(previews) + 1
                for index, (each, reached) in enumerate(previews):
                    part = subprogress(progress, index / parts, (index + 1) / parts)
                    self._integrate_means(lookup, tolerance=each, refine=refine, progress=part)
                    reached()
                    self._now = self._now[0], None
                progress, previews = subprogress(progress, 1.0 - 1.0 / parts, 1.0), ()
            self._integrate_means(lookup, tolerance=tolerance, refine=refine, progress=progress, previews=previews)
            return
        unserved_gain = self._left_out_buffer(lookup)
        for light_index, share in self._passes(progress):
            steps = self._colour_steps(lookup, light_index, self.seen, self._sums[0], None, unserved_gain)
            launch_pipeline(steps, self._size, slice_size=lookup.slice_size, progress=share, **self.rays.options)

    def _footprints(self, light_index: int, seen: GBuffer, level: int) -> list[KernelCall]:
        """The calls that find the footprints of cells at a level under a light, of which its size is a part."""
        deviation = pixel_filter.deviation_at(level, means=True)
        steps = [self.rays.footprints(seen, deviation)]
        if self._at_places[light_index]:
            steps.append(self.rays.turned_footprints(seen, self._lights, light_index, deviation))
        if self._have_sizes[light_index]:
            inputs = [self._lights, light_index, seen.pixels]
            steps.append(KernelCall(light_samples.add_light_extent, inputs, [seen.footprints], in_runs=True))
        return steps

    def _colour_steps(
        self,
        lookup: ColourLookup,
        light_index: int,
        seen: GBuffer,
        colours: wp.array,
        footprints: wp.array | None,
        unserved_gain: wp.array,
        *,
        shadows: bool = True,
    ) -> list[KernelCall]:
        """The calls that add the colours of what rays see under a light, one material after the other."""
        scattering_vectors, to_lights, gains = seen.directions
        if (sky := self._skies[light_index]) is not None:
            occluded = self._hidden_of_one(seen, shadows=shadows)
            inputs = [
                self._sky_maps[sky], lookup.sky_table(self._lit[light_index], sky.directions), seen.pixels,
                gains, footprints, self._lights, light_index, self._reflection,
                self._grid_of(light_index).mesh_id if len(occluded) else 0, sky.directions,
            ]  # fmt: skip
            estimates = self._estimates if seen is self.seen else self._no_estimates
            return [KernelCall(sky_sum.add_sky, inputs, [occluded, estimates, colours], in_runs=True)]
        steps: list[KernelCall] = []
        for index, (illuminated,) in enumerate(self._lit[light_index]):
            if self.has_materials:
                inputs = [seen.gains, seen.pixels.face, self._of_faces, index]
                gains = seen.gains_of_one
                steps.append(KernelCall(light_samples.select_material, inputs, [gains], in_runs=True))
            steps += lookup.steps(scattering_vectors, to_lights, gains, illuminated, colours, footprints, unserved_gain)
        return steps

    def _left_out_buffer(self, lookup: ColourLookup) -> wp.array:
        """An array of a picture's size, which is made once, for a table that leaves directions out."""
        if lookup.needs_sampling and not len(self._left_out):
            self._left_out = wp.empty(self._size, dtype=wp.float32, device=self._device)
        return self._left_out

    def _integrate_means(
        self,
        lookup: ColourLookup,
        *,
        tolerance: float,
        refine: bool,
        progress: Callable[[float], None] | None,
        previews: Sequence[tuple[float, Callable[[], None]]] = (),
    ) -> None:
        """Add means over pixels, which are split where one ray does not tell them."""
        if not self._errors:
            self._errors = [wp.empty(self._size, dtype=wp.float32, device=self._device) for _ in range(2)]
            self._edges = wp.empty(self._size, dtype=wp.bool, device=self._device)
        if self.casts_shadows and not len(self._shadow) and any(len(each) > 1 for each in self._lobes_of_lights):
            self._shadow, self._penumbrae = (wp.empty(self._size, wp.float32, device=self._device) for _ in range(2))
        unserved_gain = self._left_out_buffer(lookup)
        several, (colours, illuminated) = len(self._lobes_of_lights) > 1, self._sums_of_one
        errors = self._errors[several]
        self._errors[0].zero_()
        self._edges.zero_()
        self._estimates.zero_()
        self._penumbrae.zero_()
        self._refined = refine
        if several:
            self._sums[0].zero_()
            self._sums[2].zero_()
        for index, lobes in enumerate(self._lobes_of_lights):
            if several:
                errors.zero_()
                illuminated.zero_()
            count = len(self._lobes_of_lights)
            share = subprogress(progress, index / count, (index + 1) / count)
            first, rest = (
                subprogress(share, 0.0, _PROGRESS_OF_FIRST_RAYS),
                subprogress(share, _PROGRESS_OF_FIRST_RAYS, 1.0),
            )
            self._add_first_rays(lookup, lobes, colours, unserved_gain, first)
            light = refinement.LightRefinement(
                self, lookup, lobes, colours, errors, [self._sums[1], illuminated, self._edges], tolerance,
                pixel_filter.level_of(self._least, means=lookup.uses_footprints), refine,
            )  # fmt: skip
            self._schedule = self._schedule or self._scheduled(light)
            self._schedule.split(light, rest, previews)
            if rest is not None:
                rest(1.0)
            if several:
                sums = [self._sums[0], self._errors[0], self._sums[2]]
                self._launch([KernelCall(subdivision.accumulate, [colours, errors, illuminated], sums, in_runs=True)])

    def _add_first_rays(
        self,
        lookup: ColourLookup,
        lobes: range,
        colours: wp.array,
        unserved_gain: wp.array,
        progress: Callable[[float], None] | None,
    ) -> None:
        """Add what pixels' own rays see under the lobes of a light."""
        seen, strengths = self.seen, self._lights.strengths
        has_penumbrae = self.casts_shadows and len(lobes) > 1
        for light_index in lobes:
            # Measuring directions has left behind what a single light needs.
            if self._now != (0, light_index):
                self.deflect(0, light_index)
            steps = self._footprints(light_index, seen, 0) if lookup.uses_footprints else []
            if has_penumbrae:
                inputs = [seen.occluded, strengths, light_index, light_index == lobes.start]
                steps.append(KernelCall(subdivision.add_occluded_power, inputs, [self._shadow], in_runs=True))
            footprints = seen.footprints if lookup.uses_footprints else None
            steps += self._colour_steps(lookup, light_index, seen, colours, footprints, unserved_gain)
            begin, end = ((light_index + more - lobes.start) / len(lobes) for more in (0, 1))
            launch_pipeline(
                steps, self._size, slice_size=_COLOURS_OF_SLICE, progress=subprogress(progress, begin, end),
                **self.rays.options,
            )  # fmt: skip
        if has_penumbrae:
            inputs = [colours, self._shadow, strengths, lobes.start, lobes.stop]
            self._launch([KernelCall(subdivision.add_penumbra_error, inputs, [self._penumbrae], in_runs=True)])

    def _scheduled(self, light: refinement.LightRefinement) -> HostSchedule | DeviceSchedule:
        """What splits pixels under lights like this one."""
        if isinstance(self.rays, RasterizedRays):
            return HostSchedule(self.rays)
        return DeviceSchedule(light, self._size)

    @property
    def _sums_of_one(self) -> tuple[wp.array, wp.array]:
        """Where a light's colours come, and what it reaches: of means under several by themselves, or the picture's."""
        if not self._means or len(self._lobes_of_lights) == 1:
            return self._sums[0], self._sums[2]
        if not len(self._colours):
            self._colours = wp.zeros(self._size, dtype=wp.vec3f, device=self._device)
            self._lit_by_one = wp.zeros(self._size, dtype=wp.bool, device=self._device)
        return self._colours, self._lit_by_one

    def estimates_of(self, lobes: range) -> wp.array:
        """What the colours of pixels' own rays err by under a light, if it is a sky."""
        return self._no_estimates if self._skies[lobes.start] is None else self._estimates

    def steps_of_cells(
        self,
        lookup: ColourLookup,
        lobes: range,
        level: int,
        buffers: TileBuffers,
        *,
        shadows: bool,
    ) -> list[KernelCall]:
        """The calls that add the colours of cells under a light to zeros in the buffers."""
        seen, means = buffers.seen, lookup.uses_footprints
        sampling = Sampling()
        sampling.tiles, sampling.places = buffers.tiles[level], pixel_filter.places_at(level, self._device.alias)
        steps = self.rays.steps(sampling, seen.pixels)
        sums = [buffers.colours, *self._no_sums[1:]]
        footprints = seen.footprints if means else None
        several_hidden = self.hidden_of(seen, lobes, shadows=shadows) is seen.hidden_from_any
        for light_index in lobes:
            steps += self._deflect(light_index, seen, 1.0, sums, sample=0, shadows=shadows)
            if several_hidden:
                inputs = [seen.occluded, light_index == lobes.start]
                steps.append(KernelCall(subdivision.any_occluded, inputs, [seen.hidden_from_any], in_runs=True))
            if means:
                steps += self._footprints(light_index, seen, level)
            steps += self._colour_steps(
                lookup, light_index, seen, buffers.colours, footprints, buffers.unserved_gain, shadows=shadows
            )
        return steps

    def sum_directly(self, heightfield: HeightField, plan: Plan, *, progress: Callable[[float], None] | None) -> None:
        """Add the colours of all samples and lights by the direct sum."""
        for light_index, share in self._passes(progress):
            scattering_vectors, to_lights, gains = (each.astype(np.float64) for each in self.directions())
            if self.has_materials:
                of_pixels = self._of_faces.numpy()[np.maximum(self.seen.pixels.face.numpy(), 0)]
            of_light = self._lit[light_index]
            for index, (illuminated,) in enumerate(of_light):
                part = subprogress(share, index / len(of_light), (index + 1) / len(of_light))
                of_one = np.where(of_pixels == index, gains, 0.0) if self.has_materials else gains
                added = direct_colour(
                    heightfield, scattering_vectors, to_lights, of_one, plan, illuminated, progress=part
                )
                self._sums[0].assign((self._sums[0].numpy() + added).astype(np.float32))

    def cast(self, sample: int) -> None:
        """Send one ray through every pixel."""
        self._launch(self._cast(sample, self._samples))
        self._now = sample, None

    def _launch(self, steps: Sequence[KernelCall]) -> None:
        """Launch what finds rays and directions over all pixels."""
        launch_pipeline(steps, self._size, slice_size=RAYS_OF_SLICE, **self.rays.options)

    def _cast(self, sample: int, samples: int) -> list[KernelCall]:
        """The calls that send one ray through every pixel."""
        self.invalidate_gbuffer()
        return self.rays.cast(sample, samples)

    @property
    def casts_shadows(self) -> bool:
        """Whether the mesh may hide the lights."""
        return self._shadows and self.rays.may_be_hidden

    def _grid_of(self, light_index: int) -> Any:
        """A grid of faces for shadow rays where it is worth it, once rays are cast."""
        if light_index not in self._grids:
            self._make_grid(light_index, self._samples)
        return self._grids[light_index]

    def expect_cells(self, lobes: range, pixels: int) -> None:
        """Get ready for the shadow rays of so many pixels that are split."""
        if self.casts_shadows:
            for light_index in lobes:
                self._make_grid(light_index, _SHADOW_RAYS_OF_CELLS, pixels)

    def _make_grid(self, light_index: int, rays: int, pixels: int | None = None) -> None:
        has_none = self._at_places[light_index] or self._skies[light_index] is not None
        to_light = None if has_none else self._to_lights[light_index]
        self._grids[light_index] = self.rays.shadow_grid(to_light, rays, pixels)

    def deflect(self, sample: int, light_index: int, *, samples: int | None = None) -> None:
        """Compute the deflections and gains of a sample under one light, and add its pigment.

        Rays are cast first, if they are another sample's.
        """
        steps: list[KernelCall] = []
        if self._now[0] != sample:
            steps = self._cast(sample, samples or self._samples)
            if self.casts_shadows and light_index not in self._grids:
                # Whether a grid is worth it, those that meet the mesh tell.
                self._launch(steps)
                steps = []
        colours, illuminated = self._sums_of_one
        sums = [colours, self._sums[1], illuminated]
        steps += self._deflect(light_index, self.seen, 1.0 / (samples or self._samples), sums, sample=sample)
        self._launch(steps)
        self._now = sample, light_index

    def hidden_of(self, seen: GBuffer, lobes: range, *, shadows: bool = True) -> wp.array:
        """From which of the points that rays meet any lobe of a light is hidden; empty is none of them."""
        if len(lobes) > 1 and shadows and self.casts_shadows:
            return seen.hidden_from_any
        return self._hidden_of_one(seen, shadows=shadows)

    def _hidden_of_one(self, seen: GBuffer, *, shadows: bool) -> wp.array:
        return seen.occluded if shadows and self.casts_shadows else self._none_hidden

    def _deflect(
        self, light_index: int, seen: GBuffer, weight: float, sums: list[wp.array], *, sample: int, shadows: bool = True
    ) -> list[KernelCall]:
        shadows, occluded = shadows and self.casts_shadows, self._hidden_of_one(seen, shadows=shadows)
        # What is covered counts once.
        counted, begins = weight if light_index == 0 else 0.0, light_index == 0 and sample == 0
        # Of means each light's colours are found by themselves.
        resets = begins or (self._means and any(each.start == light_index for each in self._lobes_of_lights))
        if self._skies[light_index] is not None:
            inputs = [seen.pixels, counted, begins, resets]
            return [KernelCall(sky_sum.mirror_directions, inputs, [*seen.directions, *sums], in_runs=True)]
        inputs = [seen.pixels, self._lights, light_index, self._reflection, weight, counted, begins, resets, occluded]
        steps = [KernelCall(light_samples.scattering_vectors, inputs, [*seen.directions, *sums], in_runs=True)]
        if len(self._reflection.energy):
            scattering_vectors, to_lights, gains = seen.directions
            inputs = [scattering_vectors, to_lights, self._reflection]
            steps.append(KernelCall(light_samples.balance_energy, inputs, [gains], in_runs=True))
        if shadows:
            inputs = [self._grid_of(light_index), self._lights.places, light_index, seen.pixels]
            steps.insert(0, KernelCall(trace_shadow_rays, inputs, [occluded], in_runs=True))
        return steps

    def directions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The last deflections, directions to the light and gains."""
        scattering_vectors, to_lights, gains = (each.numpy() for each in self.seen.directions)
        return scattering_vectors, to_lights, gains

    def met(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
        """Hits of the pixels' central rays: whether, which face, where on it, and the shading normal."""
        self._launch(self._cast(0, 1))
        pixels = self.seen.pixels
        return pixels.hit.numpy(), pixels.face.numpy(), pixels.place.numpy(), pixels.normal.numpy()

    @property
    def xyz(self) -> wp.array:
        """The colours, (height, width), where they are or, from within a margin, in an array that stays the same."""
        colours = self._sums[0].reshape((self.rays.height, self.rays.width))
        if self._size == self.view.width * self.view.height:
            return colours
        if self._shown is None:
            self._shown = wp.empty((self.view.height, self.view.width), dtype=wp.vec3f, device=self._device)
        wp.copy(self._shown, colours[self._inner])
        return self._shown

    def _seen_of(self, values: Any) -> NDArray[Any]:
        """What the view shows of values of pixels, an array on the device or on the host, (height, width, …)."""
        values = values.numpy() if isinstance(values, wp.array) else values
        return np.ascontiguousarray(values.reshape(self.rays.height, self.rays.width, *values.shape[1:])[self._inner])

    @np.errstate(under="ignore")
    def image(self, plan: Plan) -> Image:
        """The finished picture."""
        sums = [each.numpy() for each in self._sums]
        xyz, coverage, illuminated = (self._seen_of(each) for each in sums)
        coverage = coverage.astype(np.float32)
        seen = xyz[illuminated]
        # That of a table, or of sums over wavelengths, is in proportion to the colour.
        size = lengths(seen).astype(np.float64)
        errors = plan.error * size
        if self._means:
            # Beside the outermost ones are those of the margin.
            whole = sums[0].reshape(self.rays.height, self.rays.width, 3)
            contrasts = self._seen_of(pixel_filter.contrasts(whole).ravel())[illuminated]
            errors = _MEAN_ERROR_PER_PLAN_ERROR * plan.error * np.sqrt(np.sqrt(np.sqrt(size**7 * contrasts)))
        if self._errors:
            # Neither depends on the other.
            errors = _BOUND_OF_BOTH * np.hypot(errors, self._seen_of(self._errors[0])[illuminated])
        if any(self._skies):
            errors = errors + _ERROR_PER_COARSENESS * self._seen_of(self._estimates)[illuminated, 1]
        if len(self._penumbrae):
            errors = np.hypot(errors, self._seen_of(self._penumbrae)[illuminated])
        error = np.zeros(illuminated.shape, dtype=np.float32)
        error[illuminated] = relative_errors(errors, seen)
        told = np.percentile(error[illuminated], (50.0, 99.0)).tolist() if illuminated.any() else (0.0, 0.0)
        found = 0 if self._schedule is None else self._schedule.count
        # Where only cells may meet the mesh, pixels are split that do not.
        split = min(found / max(int(np.count_nonzero(coverage)), 1), 1.0)
        inside, at_edges = 0.0, 0.0
        if self._refined:
            edges = self._seen_of(self._edges)
            inside = share_beyond(error[illuminated & ~edges], plan.tolerance)
            at_edges = share_beyond(error[illuminated & edges], EDGES_PER_TOLERANCE * plan.tolerance)
        light_sample_count = sum(1 if each is None else each.directions for each in self._skies)
        return Image(
            xyz=xyz,
            mask=coverage > 0.0,
            illuminated=illuminated,
            coverage=coverage,
            error=error,
            plan=replace(
                plan,
                light_sample_count=light_sample_count,
                refined_share=split,
                unconverged_share=inside,
                unconverged_edge_share=at_edges,
                errors=(told[0], told[1]),
            ),
        )
