"""Pictures: the arrays of a picture on a device, and the kernel calls that fill them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core.threads import subprogress
from warpdiff.core.wording import ArgumentValueError, ref
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
    from warpdiff.lights.base import Lobe
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


def upload_sky(sky: SkyMaps, device: wp.Device) -> tuple[wp.array, wp.array, wp.array]:
    """Upload the texels of a sky's maps, their sides, and the index of each map's first texel."""
    firsts = np.cumsum([0, *((side + 2) ** 2 for side in sky.sides[:-1])])
    return (
        wp.array(sky.texels, dtype=wp.vec4f, device=device),
        wp.array(sky.sides, dtype=wp.int32, device=device),
        wp.array(firsts, dtype=wp.int32, device=device),
    )


class Picture:
    """A picture of a surface, whose view and lights may change between renderings."""

    def __init__(
        self, surface: Surface, view: View, *, smooth: bool = True, samples: int = 1, means: bool = False,
        margin: int = 0, materials_of_faces: NDArray[np.int32] | None = None, device_driven: bool | None = None,
        device: wp.Device, threads: int,
    ) -> None:  # fmt: skip
        """A picture of so many samples per pixel, or of means over pixels that are split into at least as many cells.

        A ``margin`` of so many pixels on each side is rendered, too, and is not shown: what filters reach there.

        ``materials_of_faces`` holds the index of each face's material; None is a single material.

        If ``device_driven`` the device fills it from the view and the lights on without the host, so that its launches
        may be recorded; None is so on a GPU. Otherwise the host has a part, which is faster on the CPU.
        """
        # Means begin with one ray a pixel.
        self._samples, self._least = 1 if means else samples, samples
        self._device, self._surface, self._means = device, surface, means
        self.has_materials = materials_of_faces is not None
        self._materials_of_faces = wp.array(
            [] if materials_of_faces is None else materials_of_faces, dtype=wp.int32, device=device
        )
        options: dict[str, Any] = {"smooth": smooth, "means": means, "device": device, "threads": threads}
        options |= {"materials": self.has_materials, "margin": margin}
        on_device = not device.is_cpu if device_driven is None else device_driven
        self.rays = (PixelRays if on_device else RasterizedRays)(surface, view, **options)
        self._size = size = self.rays.width * self.rays.height
        self._inner = (slice(margin, margin + view.height), slice(margin, margin + view.width))
        self._shown_xyz: wp.array | None = None
        self.invalidate_gbuffer()
        self._no_occlusion = wp.empty(0, dtype=wp.bool, device=device)
        # XYZ, coverage, and what any light reaches.
        dtypes = (wp.vec3f, wp.float64, wp.bool)
        self._sums = [wp.zeros(size, dtype=dtype, device=device) for dtype in dtypes]
        self._no_sums = [wp.empty(0, dtype=dtype, device=device) for dtype in dtypes]
        # Where pictures are sums, a light's, and what it reaches; what both err by, and what a table leaves out.
        self._light_colours = wp.empty(0, dtype=wp.vec3f, device=device)
        self._light_illuminated = wp.empty(0, dtype=wp.bool, device=device)
        self._errors: list[wp.array] = []
        # Under skies, what pixels' own rays err by; or empty.
        self._estimates = self._no_estimates = wp.empty(0, dtype=wp.vec2f, device=device)
        # What is hidden of a light of several lobes, and what all such penumbrae err by; or empty.
        self._occluded_power, self._penumbra_errors = (wp.empty(0, dtype=wp.float32, device=device) for _ in range(2))
        # Through which pixels an edge passes, as cells have found.
        self._edges = wp.empty(0, dtype=wp.bool, device=device)
        self._refined = False
        self._unserved_gain = wp.empty(0, dtype=wp.float32, device=device)
        self._schedule: HostSchedule | DeviceSchedule | None = None
        self._lights: Any = None
        self._illuminated: list[tuple[tuple[IlluminatedMaterial, ...], ...]] = []
        self._skies: list[SkyMaps | None] = []
        self._sky_maps: dict[SkyMaps, Any] = {}
        self._transmittances: wp.array | None = None
        self._energy: wp.array | None = None
        self._to_lights: list[tuple[float, float, float]] = []
        self._have_extents: list[bool] = []
        # Lights are one lobe each, or several that follow each other.
        self._lobes_of_lights: list[range] = []
        self._are_points: list[bool] = []
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
    def gbuffer(self) -> GBuffer:
        """The G-buffer of the pixels' own rays, under the last light."""
        return self.rays.gbuffer

    def invalidate_gbuffer(self) -> None:
        """Discard hits and scattering vectors."""
        # The sample and the light whose results the arrays hold.
        self._current: tuple[int | None, int | None] = (None, None)

    def set_lights(
        self, lights: Sequence[Lobe], window: Coherence, area_um2: float, *, normal: float,
        materials: Sequence[Material | None] = (None,), masking: bool = True, energy: NDArray[np.float32] | None = None,
        pigment: float = 0.0, shadows: bool = True,
    ) -> None:  # fmt: skip
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
            for name in (lobe.illuminant for lobe in lights)
        ]
        if self._lights is None or len(self._to_lights) != len(lights):
            self._lights = light_samples.Lights()
            for name, dtype in (
                ("places", wp.vec4d), ("strengths", wp.vec2d), ("white_rgb", wp.vec3d),
            ):  # fmt: skip
                setattr(self._lights, name, wp.empty(len(lights), dtype=dtype, device=self._device))
            self._lights.deviations = wp.empty((len(lights), 2), dtype=wp.vec3f, device=self._device)
            self._lights.rgb_to_xyz = wp.mat33d(*colorimetry.RGB_TO_XYZ.ravel())
        pigment_strength = pigment / normal if self.pigmented else 0.0
        self._are_points = [lobe.position is not None for lobe in lights]
        self._lights.places.assign(np.array([self._homogeneous(lobe) for lobe in lights]))
        # Powers refer to distances in mesh units, and kernels take these in radii of the mesh.
        falloffs = [self._surface.radius**-2.0 if is_point else 1.0 for is_point in self._are_points]
        strengths = [(lobe.power * falloff, pigment_strength) for lobe, falloff in zip(lights, falloffs, strict=True)]
        for (strength, _), is_point in zip(strengths, self._are_points, strict=True):
            if is_point and strength > _MOST_NEARBY:
                raise ArgumentValueError(
                    f"{ref('lights')}: a PointLight has a power of {strength * self._surface.radius**2:g}, and must "
                    f"have at most {_MOST_NEARBY:g} times the square of the mesh's radius, {self._surface.radius:g}; "
                    "give less power"
                )
        self._lights.strengths.assign(np.array(strengths))
        self._lights.white_rgb.assign(np.array(whites))
        self._have_extents = [lobe.deviations is not None for lobe in lights]
        firsts = [index for index, lobe in enumerate(lights) if not lobe.is_same_light]
        self._lobes_of_lights = list(map(range, firsts, [*firsts[1:], len(lights)]))
        deviations = [np.zeros((2, 3)) if lobe.deviations is None else lobe.deviations for lobe in lights]
        self._lights.deviations.assign(np.array(deviations, dtype=np.float32))
        self._to_lights = [lobe.to_light for lobe in lights]
        self._illuminated = [
            tuple(tuple(IlluminatedMaterial(name, material) for name in lobe.illuminants) for material in materials)
            for lobe in lights
        ]
        self._skies = [lobe.sky for lobe in lights]
        if any(self._skies) and not len(self._estimates):
            self._estimates = wp.zeros(self._size, dtype=wp.vec2f, device=self._device)
        # Those of before stay, where a recorded picture finds them.
        before = self._sky_maps
        self._sky_maps = {
            sky: before.get(sky) or self._sky_map(sky, solid_angle) for sky in self._skies if sky is not None
        }
        self._shadows = shadows
        self._grids = {}
        self._reflection = light_samples.Reflection()
        self._reflection.normal_reflectance = normal
        self._reflection.masking = masking
        if self._energy is None:
            factors = np.zeros((0, 0), dtype=np.float32) if energy is None else energy
            self._energy = wp.array(factors, dtype=wp.float32, device=self._device)
        self._reflection.energy = self._energy
        self._reflection.per_light_cosine = window.kind == "source"
        values = [transmittances(normal, material) for material in materials] if self.pigmented else np.zeros((0, 0, 3))
        if self._transmittances is None or self._transmittances.shape != np.shape(values)[:2]:
            self._transmittances = wp.empty(np.shape(values)[:2], dtype=wp.vec3f, device=self._device)
        # Into the same array, which a recorded picture finds again.
        self._transmittances.assign(np.asarray(values, dtype=np.float32))
        self._reflection.transmittances = self._transmittances
        self._reflection.materials = self._materials_of_faces
        self._current = self._current[0], None

    def _sky_map(self, sky: SkyMaps, solid_angle: NDArray[np.float64]) -> Any:
        """The struct ``SkyMap`` of a light."""
        result = sky_sum.SkyMap()
        result.texels, result.sides, result.firsts = sky.device_arrays.get_or_make(
            self._device.alias, lambda: upload_sky(sky, self._device)
        )
        result.variance = sky.blur**2
        result.turn = wp.vec2f(math.cos(sky.turn), math.sin(sky.turn))
        whites = [colorimetry.xyz_to_rgb(solid_angle @ colorimetry.colour_products(primary)) for primary in sky.spectra]
        result.whites = wp.mat33f(*np.ravel(whites))
        return result

    def _homogeneous(self, light: Lobe) -> tuple[float, ...]:
        """Where a light is, in homogeneous coordinates and the surface's units."""
        if light.position is None:
            return *light.to_light, 0.0
        return *((np.asarray(light.position) - self._surface.centre) / self._surface.radius), 1.0

    @property
    def launches_depend_on(self) -> tuple[Any, ...]:
        """The part of the view and the lights that the launches depend on; all else of these is on the device."""
        sizes, lobes, places = tuple(self._have_extents), tuple(self._lobes_of_lights), tuple(self._are_points)
        return tuple(self._skies), sizes, lobes, places, self.view.extent_y is None, self.casts_shadows, self.pigmented

    def measure_directions(
        self, heightfield: HeightField, window: Coherence
    ) -> tuple[DirectionRange, int, DirectionSample]:
        """The range of all lit directions, their number, and some of them.

        That is a first pass over the rays, which cost a hundredth of the colours.
        """
        within, count = DirectionRange(0.0, 0.0, 0.0, 0.0), 0
        sampled = []
        # A few rays a pixel see what all do, and of many pixels their own rays what cells do.
        samples, measured = self._samples, min(self._samples, _SAMPLES_MEASURED)
        if self._means:
            self.trace(0)
            pixels = max(int(np.count_nonzero(self.gbuffer.pixels.hit.numpy())), 1)
            samples = measured = min(-(-_CELLS_MEASURED // pixels), _MOST_SAMPLES_MEASURED)
        for sample in range(measured):
            for light_index in range(len(self._to_lights)):
                # Means begin with the pixels' centres.
                self.scatter(sample, light_index, samples=1 if self._means and sample == 0 else samples)
                scattering_vectors, to_lights, gains = self.directions()
                illuminated = gains > 0.0
                within = within.joined(
                    DirectionRange.of(heightfield, window, scattering_vectors, to_lights, illuminated)
                )
                count += int(np.count_nonzero(illuminated))
                if self._means or sample == 0:
                    parts = len(self._to_lights) * (measured if self._means else 1)
                    sampled.append(DirectionSample.among(scattering_vectors, to_lights, gains, parts))
        if measured > self._samples:
            self.invalidate_gbuffer()
        return within, count * self._samples // measured, DirectionSample.joined(sampled)

    def _passes(self, progress: Callable[[float], None] | None) -> Iterator[tuple[int, Callable[[float], None] | None]]:
        """Trace and scatter sample after sample, light after light.

        Yields a light's index, and the pass' share of progress.
        """
        count = len(self._to_lights)
        for sample in range(self._samples):
            for light_index in range(count):
                # Measuring directions has left behind what a single pass needs.
                if self._current != (sample, light_index):
                    self.scatter(sample, light_index)
                index, passes = sample * count + light_index, self._samples * count
                yield light_index, subprogress(progress, index / passes, (index + 1) / passes)

    def integrate(
        self, lookup: ColourLookup, *, tolerance: float, refine: bool = True,
        progress: Callable[[float], None] | None = None, previews: Sequence[tuple[float, Callable[[], None]]] = (),
    ) -> None:  # fmt: skip
        """Add the diffraction colours of all samples and lights.

        Where the host splits pixels, the picture of each ``previews`` tolerance, from the largest one on, is there when
        the function beside it is called.
        """
        if self._means:
            if len(self._lobes_of_lights) > 1:
                # Each light takes all of its cells before the next.
                parts = len(previews) + 1
                for index, (preview, reached) in enumerate(previews):
                    part = subprogress(progress, index / parts, (index + 1) / parts)
                    self._integrate_means(lookup, tolerance=preview, refine=refine, progress=part)
                    reached()
                    self._current = self._current[0], None
                progress, previews = subprogress(progress, 1.0 - 1.0 / parts, 1.0), ()
            self._integrate_means(lookup, tolerance=tolerance, refine=refine, progress=progress, previews=previews)
            return
        unserved_gain = self._unserved_gain_buffer(lookup)
        for light_index, share in self._passes(progress):
            steps = self._colour_calls(lookup, light_index, self.gbuffer, self._sums[0], None, unserved_gain)
            launch_pipeline(steps, self._size, slice_size=lookup.slice_size, progress=share, **self.rays.options)

    def _footprints(self, light_index: int, gbuffer: GBuffer, level: int) -> list[KernelCall]:
        """The calls that find the footprints of cells at a level under a light, of which its size is a part."""
        deviation = pixel_filter.deviation_at(level, means=True)
        steps = [self.rays.footprints(gbuffer, deviation)]
        if self._are_points[light_index]:
            steps.append(self.rays.rotated_footprints(gbuffer, self._lights, light_index, deviation))
        if self._have_extents[light_index]:
            inputs = [self._lights, light_index, gbuffer.pixels]
            steps.append(KernelCall(light_samples.add_light_extent, inputs, [gbuffer.footprints], in_runs=True))
        return steps

    def _colour_calls(
        self, lookup: ColourLookup, light_index: int, gbuffer: GBuffer, colours: wp.array, footprints: wp.array | None,
        unserved_gain: wp.array, *, shadows: bool = True,
    ) -> list[KernelCall]:  # fmt: skip
        """The calls that add the colours of what rays see under a light, one material after the other."""
        scattering_vectors, to_lights, gains = gbuffer.directions
        if (sky := self._skies[light_index]) is not None:
            occluded = self._lobe_occlusion(gbuffer, shadows=shadows)
            inputs = [
                self._sky_maps[sky], lookup.sky_table(self._illuminated[light_index], sky.directions), gbuffer.pixels,
                gains, footprints, self._lights, light_index, self._reflection,
                self._grid_of(light_index).mesh_id if len(occluded) else 0, sky.directions,
            ]  # fmt: skip
            estimates = self._estimates if gbuffer is self.gbuffer else self._no_estimates
            return [KernelCall(sky_sum.add_sky, inputs, [occluded, estimates, colours], in_runs=True)]
        steps: list[KernelCall] = []
        for index, (illuminated,) in enumerate(self._illuminated[light_index]):
            if self.has_materials:
                inputs = [gbuffer.gains, gbuffer.pixels.face, self._materials_of_faces, index]
                gains = gbuffer.material_gains
                steps.append(KernelCall(light_samples.select_material, inputs, [gains], in_runs=True))
            steps += lookup.kernel_calls(
                scattering_vectors, to_lights, gains, illuminated, colours, footprints, unserved_gain
            )
        return steps

    def _unserved_gain_buffer(self, lookup: ColourLookup) -> wp.array:
        """An array of a picture's size, which is made once, for a table that leaves directions out."""
        if lookup.needs_sampling and not len(self._unserved_gain):
            self._unserved_gain = wp.empty(self._size, dtype=wp.float32, device=self._device)
        return self._unserved_gain

    def _integrate_means(
        self, lookup: ColourLookup, *, tolerance: float, refine: bool, progress: Callable[[float], None] | None,
        previews: Sequence[tuple[float, Callable[[], None]]] = (),
    ) -> None:  # fmt: skip
        """Add means over pixels, which are split where one ray does not tell them."""
        if not self._errors:
            self._errors = [wp.empty(self._size, dtype=wp.float32, device=self._device) for _ in range(2)]
            self._edges = wp.empty(self._size, dtype=wp.bool, device=self._device)
        has_several_lobes = any(len(lobes) > 1 for lobes in self._lobes_of_lights)
        if self.casts_shadows and has_several_lobes and not len(self._occluded_power):
            self._occluded_power, self._penumbra_errors = (
                wp.empty(self._size, wp.float32, device=self._device) for _ in range(2)
            )
        unserved_gain = self._unserved_gain_buffer(lookup)
        has_several, (colours, illuminated) = len(self._lobes_of_lights) > 1, self._light_sums
        errors = self._errors[has_several]
        self._errors[0].zero_()
        self._edges.zero_()
        self._estimates.zero_()
        self._penumbra_errors.zero_()
        self._refined = refine
        if has_several:
            self._sums[0].zero_()
            self._sums[2].zero_()
        for index, lobes in enumerate(self._lobes_of_lights):
            if has_several:
                errors.zero_()
                illuminated.zero_()
            count = len(self._lobes_of_lights)
            share = subprogress(progress, index / count, (index + 1) / count)
            unrefined, refined = (
                subprogress(share, 0.0, _PROGRESS_OF_FIRST_RAYS),
                subprogress(share, _PROGRESS_OF_FIRST_RAYS, 1.0),
            )
            self._add_first_rays(lookup, lobes, colours, unserved_gain, unrefined)
            light = refinement.LightRefinement(
                self, lookup, lobes, colours, errors, [self._sums[1], illuminated, self._edges], tolerance,
                pixel_filter.level_of(self._least, means=lookup.uses_footprints), refine,
            )  # fmt: skip
            self._schedule = self._schedule or self._make_schedule(light)
            self._schedule.split(light, refined, previews)
            if refined is not None:
                refined(1.0)
            if has_several:
                sums = [self._sums[0], self._errors[0], self._sums[2]]
                self._launch([KernelCall(subdivision.accumulate, [colours, errors, illuminated], sums, in_runs=True)])

    def _add_first_rays(
        self, lookup: ColourLookup, lobes: range, colours: wp.array, unserved_gain: wp.array,
        progress: Callable[[float], None] | None,
    ) -> None:  # fmt: skip
        """Add what pixels' own rays see under the lobes of a light."""
        gbuffer, strengths = self.gbuffer, self._lights.strengths
        has_penumbrae = self.casts_shadows and len(lobes) > 1
        for light_index in lobes:
            # Measuring directions has left behind what a single light needs.
            if self._current != (0, light_index):
                self.scatter(0, light_index)
            steps = self._footprints(light_index, gbuffer, 0) if lookup.uses_footprints else []
            if has_penumbrae:
                inputs = [gbuffer.occluded, strengths, light_index, light_index == lobes.start]
                steps.append(KernelCall(subdivision.add_occluded_power, inputs, [self._occluded_power], in_runs=True))
            footprints = gbuffer.footprints if lookup.uses_footprints else None
            steps += self._colour_calls(lookup, light_index, gbuffer, colours, footprints, unserved_gain)
            begin, end = ((light_index + more - lobes.start) / len(lobes) for more in (0, 1))
            launch_pipeline(
                steps, self._size, slice_size=_COLOURS_OF_SLICE, progress=subprogress(progress, begin, end),
                **self.rays.options,
            )  # fmt: skip
        if has_penumbrae:
            inputs = [colours, self._occluded_power, strengths, lobes.start, lobes.stop]
            self._launch([KernelCall(subdivision.add_penumbra_error, inputs, [self._penumbra_errors], in_runs=True)])

    def _make_schedule(self, light: refinement.LightRefinement) -> HostSchedule | DeviceSchedule:
        """What splits pixels under lights like this one."""
        if isinstance(self.rays, RasterizedRays):
            return HostSchedule(self.rays)
        return DeviceSchedule(light, self._size)

    @property
    def _light_sums(self) -> tuple[wp.array, wp.array]:
        """Where a light's colours come, and what it reaches: of means under several by themselves, or the picture's."""
        if not self._means or len(self._lobes_of_lights) == 1:
            return self._sums[0], self._sums[2]
        if not len(self._light_colours):
            self._light_colours = wp.zeros(self._size, dtype=wp.vec3f, device=self._device)
            self._light_illuminated = wp.zeros(self._size, dtype=wp.bool, device=self._device)
        return self._light_colours, self._light_illuminated

    def estimates_of(self, lobes: range) -> wp.array:
        """What the colours of pixels' own rays err by under a light, if it is a sky."""
        return self._no_estimates if self._skies[lobes.start] is None else self._estimates

    def cell_calls(
        self, lookup: ColourLookup, lobes: range, level: int, buffers: TileBuffers, *, shadows: bool
    ) -> list[KernelCall]:
        """The calls that add the colours of cells under a light to zeros in the buffers."""
        gbuffer, means = buffers.gbuffer, lookup.uses_footprints
        sampling = Sampling()
        sampling.tiles, sampling.places = buffers.tiles[level], pixel_filter.places_at(level, self._device.alias)
        steps = self.rays.calls(sampling, gbuffer.pixels)
        sums = [buffers.colours, *self._no_sums[1:]]
        footprints = gbuffer.footprints if means else None
        has_several = self.occlusion_of(gbuffer, lobes, shadows=shadows) is gbuffer.any_occluded
        for light_index in lobes:
            steps += self._scatter_calls(light_index, gbuffer, 1.0, sums, sample=0, shadows=shadows)
            if has_several:
                inputs = [gbuffer.occluded, light_index == lobes.start]
                steps.append(KernelCall(subdivision.any_occluded, inputs, [gbuffer.any_occluded], in_runs=True))
            if means:
                steps += self._footprints(light_index, gbuffer, level)
            steps += self._colour_calls(
                lookup, light_index, gbuffer, buffers.colours, footprints, buffers.unserved_gain, shadows=shadows
            )
        return steps

    def sum_directly(self, heightfield: HeightField, plan: Plan, *, progress: Callable[[float], None] | None) -> None:
        """Add the colours of all samples and lights by the direct sum."""
        for light_index, share in self._passes(progress):
            scattering_vectors, to_lights, gains = (values.astype(np.float64) for values in self.directions())
            if self.has_materials:
                indices = self._materials_of_faces.numpy()[np.maximum(self.gbuffer.pixels.face.numpy(), 0)]
            by_material = self._illuminated[light_index]
            for index, (illuminated,) in enumerate(by_material):
                part = subprogress(share, index / len(by_material), (index + 1) / len(by_material))
                material_gains = np.where(indices == index, gains, 0.0) if self.has_materials else gains
                added = direct_colour(
                    heightfield, scattering_vectors, to_lights, material_gains, plan, illuminated, progress=part
                )
                self._sums[0].assign((self._sums[0].numpy() + added).astype(np.float32))

    def trace(self, sample: int) -> None:
        """Send one ray through every pixel."""
        self._launch(self._trace_calls(sample, self._samples))
        self._current = sample, None

    def _launch(self, steps: Sequence[KernelCall]) -> None:
        """Launch what finds rays and directions over all pixels."""
        launch_pipeline(steps, self._size, slice_size=RAYS_OF_SLICE, **self.rays.options)

    def _trace_calls(self, sample: int, samples: int) -> list[KernelCall]:
        """The calls that send one ray through every pixel."""
        self.invalidate_gbuffer()
        return self.rays.trace(sample, samples)

    @property
    def casts_shadows(self) -> bool:
        """Whether the mesh may hide the lights."""
        return self._shadows and self.rays.may_be_occluded

    def _grid_of(self, light_index: int) -> Any:
        """A grid of faces for shadow rays where it is worth it, once rays are cast."""
        if light_index not in self._grids:
            self._make_grid(light_index, self._samples)
        return self._grids[light_index]

    def prepare_occluders(self, lobes: range, pixels: int) -> None:
        """Get ready for the shadow rays of so many pixels that are split."""
        if self.casts_shadows:
            for light_index in lobes:
                self._make_grid(light_index, _SHADOW_RAYS_OF_CELLS, pixels)

    def _make_grid(self, light_index: int, rays: int, pixels: int | None = None) -> None:
        has_none = self._are_points[light_index] or self._skies[light_index] is not None
        to_light = None if has_none else self._to_lights[light_index]
        self._grids[light_index] = self.rays.shadow_grid(to_light, rays, pixels)

    def scatter(self, sample: int, light_index: int, *, samples: int | None = None) -> None:
        """Compute the scattering vectors and gains of a sample under one light, and add its pigment.

        Rays are traced first, if they are another sample's.
        """
        steps: list[KernelCall] = []
        if self._current[0] != sample:
            steps = self._trace_calls(sample, samples or self._samples)
            if self.casts_shadows and light_index not in self._grids:
                # The number of rays that hit the mesh decides whether a grid is worth it.
                self._launch(steps)
                steps = []
        colours, illuminated = self._light_sums
        sums = [colours, self._sums[1], illuminated]
        share = 1.0 / (samples or self._samples)
        steps += self._scatter_calls(light_index, self.gbuffer, share, sums, sample=sample, shadows=True)
        self._launch(steps)
        self._current = sample, light_index

    def occlusion_of(self, gbuffer: GBuffer, lobes: range, *, shadows: bool = True) -> wp.array:
        """From which of the points that rays meet any lobe of a light is hidden; empty is none of them."""
        if len(lobes) > 1 and shadows and self.casts_shadows:
            return gbuffer.any_occluded
        return self._lobe_occlusion(gbuffer, shadows=shadows)

    def _lobe_occlusion(self, gbuffer: GBuffer, *, shadows: bool) -> wp.array:
        return gbuffer.occluded if shadows and self.casts_shadows else self._no_occlusion

    def _scatter_calls(
        self, light_index: int, gbuffer: GBuffer, share: float, sums: list[wp.array], *, sample: int, shadows: bool
    ) -> list[KernelCall]:
        shadows, occluded = shadows and self.casts_shadows, self._lobe_occlusion(gbuffer, shadows=shadows)
        # What is covered counts once.
        counted, begins = share if light_index == 0 else 0.0, light_index == 0 and sample == 0
        # Of means each light's colours are found by themselves.
        resets = begins or (self._means and any(lobes.start == light_index for lobes in self._lobes_of_lights))
        if self._skies[light_index] is not None:
            inputs = [gbuffer.pixels, counted, begins, resets]
            return [KernelCall(sky_sum.mirror_directions, inputs, [*gbuffer.directions, *sums], in_runs=True)]
        inputs = [
            gbuffer.pixels, self._lights, light_index, self._reflection, share, counted, begins, resets, occluded,
        ]  # fmt: skip
        steps = [KernelCall(light_samples.scattering_vectors, inputs, [*gbuffer.directions, *sums], in_runs=True)]
        if len(self._reflection.energy):
            scattering_vectors, to_lights, gains = gbuffer.directions
            inputs = [scattering_vectors, to_lights, self._reflection]
            steps.append(KernelCall(light_samples.balance_energy, inputs, [gains], in_runs=True))
        if shadows:
            inputs = [self._grid_of(light_index), self._lights.places, light_index, gbuffer.pixels]
            steps.insert(0, KernelCall(trace_shadow_rays, inputs, [occluded], in_runs=True))
        return steps

    def directions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The last scattering vectors, directions to the light and gains."""
        scattering_vectors, to_lights, gains = (values.numpy() for values in self.gbuffer.directions)
        return scattering_vectors, to_lights, gains

    def central_hits(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
        """Hits of the pixels' central rays: whether, which face, where on it, and the shading normal."""
        self._launch(self._trace_calls(0, 1))
        pixels = self.gbuffer.pixels
        return pixels.hit.numpy(), pixels.face.numpy(), pixels.place.numpy(), pixels.normal.numpy()

    @property
    def xyz(self) -> wp.array:
        """The colours, (height, width), where they are or, from within a margin, in an array that stays the same."""
        colours = self._sums[0].reshape((self.rays.height, self.rays.width))
        if self._size == self.view.width * self.view.height:
            return colours
        if self._shown_xyz is None:
            self._shown_xyz = wp.empty((self.view.height, self.view.width), dtype=wp.vec3f, device=self._device)
        wp.copy(self._shown_xyz, colours[self._inner])
        return self._shown_xyz

    def _cropped(self, values: Any) -> NDArray[Any]:
        """What the view shows of values of pixels, an array on the device or on the host, (height, width, …)."""
        values = values.numpy() if isinstance(values, wp.array) else values
        return np.ascontiguousarray(values.reshape(self.rays.height, self.rays.width, *values.shape[1:])[self._inner])

    @np.errstate(under="ignore")
    def image(self, plan: Plan) -> Image:
        """The finished picture."""
        sums = [values.numpy() for values in self._sums]
        xyz, coverage, illuminated = (self._cropped(values) for values in sums)
        coverage = coverage.astype(np.float32)
        visible = xyz[illuminated]
        # That of a table, or of sums over wavelengths, is in proportion to the colour.
        size = lengths(visible).astype(np.float64)
        errors = plan.error * size
        if self._means:
            # Beside the outermost ones are those of the margin.
            padded = sums[0].reshape(self.rays.height, self.rays.width, 3)
            contrasts = self._cropped(pixel_filter.contrasts(padded).ravel())[illuminated]
            errors = _MEAN_ERROR_PER_PLAN_ERROR * plan.error * np.sqrt(np.sqrt(np.sqrt(size**7 * contrasts)))
        if self._errors:
            # Neither depends on the other.
            errors = _BOUND_OF_BOTH * np.hypot(errors, self._cropped(self._errors[0])[illuminated])
        if any(self._skies):
            errors = errors + _ERROR_PER_COARSENESS * self._cropped(self._estimates)[illuminated, 1]
        if len(self._penumbra_errors):
            errors = np.hypot(errors, self._cropped(self._penumbra_errors)[illuminated])
        error = np.zeros(illuminated.shape, dtype=np.float32)
        error[illuminated] = relative_errors(errors, visible)
        percentiles = np.percentile(error[illuminated], (50.0, 99.0)).tolist() if illuminated.any() else (0.0, 0.0)
        subdivided = 0 if self._schedule is None else self._schedule.count
        # Where only cells may meet the mesh, pixels are split that do not.
        split = min(subdivided / max(int(np.count_nonzero(coverage)), 1), 1.0)
        inside, at_edges = 0.0, 0.0
        if self._refined:
            edges = self._cropped(self._edges)
            inside = share_beyond(error[illuminated & ~edges], plan.tolerance)
            at_edges = share_beyond(error[illuminated & edges], EDGES_PER_TOLERANCE * plan.tolerance)
        light_sample_count = sum(1 if sky is None else sky.directions for sky in self._skies)
        return Image(
            xyz=xyz, mask=coverage > 0.0, illuminated=illuminated, coverage=coverage, error=error,
            plan=replace(
                plan, light_sample_count=light_sample_count, refined_share=split, unconverged_share=inside,
                unconverged_edge_share=at_edges, errors=(percentiles[0], percentiles[1]),
            ),
        )  # fmt: skip
