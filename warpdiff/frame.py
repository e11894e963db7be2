"""The arrays of a picture on a device, and the launches that fill them."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff import optics, spectrum, supersample
from warpdiff.device import load
from warpdiff.evaluate import direct_colour
from warpdiff.image import Image
from warpdiff.launches import Chain, Step, begin_in_turn, launch, launch_in_turn
from warpdiff.rooms import Room, Seen, shared_room
from warpdiff.scope import DirectionSample, Scope
from warpdiff.shadows import grid_for, grid_pays, no_grid
from warpdiff.survey import BLOCK, Survey

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.coherence import Coherence
    from warpdiff.heightfield import HeightField
    from warpdiff.integration import Integrator
    from warpdiff.light import DirectionalLight
    from warpdiff.plans import Plan
    from warpdiff.surface import Surface
    from warpdiff.view import View
    from warpdiff.work import Work

_SEED = 0
_SURVEYED = 4
# Of a slice: pixels whose rays are found, or whose colours are, and faces.
_SLICE, _COLOURS, _FACES = 8192, 2048, 2048


def load_kernels(device: wp.Device) -> None:
    """Begin to load what every picture needs, while the mesh is looked at."""
    from warpdiff.kernels import directions, raycast, shadows

    load([raycast.meet, directions.deflect_pixels, shadows.hide], device)


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
        alone: bool | None = None,
        device: wp.Device,
        threads: int,
    ) -> None:
        """A frame of so many samples a pixel, of which each shows a mean over its part of the pixel if ``means``.

        If ``alone`` the device fills it from the view and the lights on without the host, so that its launches may be
        recorded; None is so on a GPU. Otherwise the host has a part, which is faster on the CPU.
        """
        import warp as wp

        from warpdiff import scene
        from warpdiff.kernels import raycast

        self._samples = samples
        places, self._weights, self._deviation = np.zeros((0, 2)), np.full(samples, 1.0 / samples), 0.0
        if means:
            places, self._weights, self._deviation = supersample.rays_of(samples)
        self._places = wp.array(places, dtype=wp.vec2d, device=device)
        self._device = device
        self._threads = threads
        self._alone = not device.is_cpu if alone is None else alone
        self._surface = surface
        self._scene = scene.arrays_for(surface, smooth=smooth, device=device)
        self._axes = wp.empty(5, dtype=wp.vec3d, device=device)
        self._size = size = view.width * view.height
        self._blurred = means and samples == 1
        # The pixels that may see anything, of whole blocks and with a row more on either side, once faces have told.
        self._among = range(size if self._alone else 0)
        self._rows = wp.empty(2, dtype=wp.int32, device=device)
        # A GPU has no lack of threads for rays, and no use for faces of uneven sizes.
        self._nearest = wp.empty(0 if self._alone else size, dtype=wp.uint64, device=device)
        # How far from pixels' centres rays lie, and where those of a sample do, if each pixel's lies elsewhere.
        self._reach = 0.0 if samples == 1 else float(np.abs(places).max()) if means else raycast.MOST_OFFSET
        self._offsets = wp.empty(0, dtype=wp.vec2d, device=device)
        # Faces that are yet finding their pixels.
        self._covering: Work | None = None
        self.look(view)
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
        # One light's, where pictures are sums; footprints of samples; and what a table leaves out.
        self._colours = wp.empty(0, dtype=wp.vec3f, device=device)
        self._spreads: list[wp.array] = []
        self._left_out = wp.empty(0, dtype=wp.float32, device=device)
        self._queue: supersample.Queue | None = None
        self._lights: Any = None
        self._to_lights: list[tuple[float, float, float]] = []
        self._shadows = False
        self._grids: dict[int, Any] = {}
        # Lit pixels of all lights, and those that took more rays.
        self._lit, self._tiled = 0, 0

    @property
    def _options(self) -> dict[str, Any]:
        return {"device": self._device, "threads": self._threads}

    def look(self, view: View) -> None:
        """Set the view, of the same size as any before."""
        from warpdiff import scene

        self._end_covering()
        self._view = view
        self._camera = scene.camera(view, self._surface, axes=self._axes)
        self._may_be_hidden = scene.needs_shadow_rays(self._surface, view)
        if not self._alone and self._samples == 1:
            self._covering = self._begin_to_cover(self._sampling(0, 1))
        self.begin()

    @functools.cached_property
    def _seen(self) -> Seen:
        """What the pixels' own rays see."""
        coloured = self._surface.has_base_colour
        return Seen.by(self._size, device=self._device, means=self._blurred, coloured=coloured)

    def _end_covering(self) -> None:
        """Wait for faces that are finding pixels of a view that is no longer looked at."""
        covering, self._covering = self._covering, None
        if covering is not None:
            covering.abandon()

    def begin(self) -> None:
        """Forget what was cast and deflected."""
        # The sample and the light whose are what arrays hold.
        self._now: tuple[int | None, int | None] = (None, None)

    def light_up(
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
        import warp as wp

        from warpdiff.kernels import directions

        self._pigmented = pigment > 0.0 and self._surface.has_base_colour
        grid_um = np.arange(spectrum.LAMBDA_MIN_NM, spectrum.LAMBDA_MAX_NM + 1, dtype=np.float64) * 1e-3
        solid_angle = optics.pigment_solid_angle(grid_um, window, area_um2)
        whites = [
            spectrum.xyz_to_rgb(solid_angle @ spectrum.colour_products(name))
            for name in (each.illuminant for each in lights)
        ]
        if self._lights is None or len(self._to_lights) != len(lights):
            self._lights = directions.Lights()
            for name, dtype in (("to_lights", wp.vec3d), ("strengths", wp.vec2d), ("white_rgb", wp.vec3d)):
                setattr(self._lights, name, wp.empty(len(lights), dtype=dtype, device=self._device))
            self._lights.rgb_to_xyz = wp.mat33d(*spectrum.RGB_TO_XYZ.ravel())
        of_pigment = pigment / normal if self._pigmented else 0.0
        self._lights.to_lights.assign(np.array([each.to_light for each in lights]))
        self._lights.strengths.assign(np.array([(each.power, of_pigment) for each in lights]))
        self._lights.white_rgb.assign(np.array(whites))
        self._to_lights = [each.to_light for each in lights]
        self._shadows = shadows
        self._grids = {}
        self._reflection = directions.Reflection()
        self._reflection.normal_reflectance = normal
        self._reflection.masking = masking
        self._reflection.per_light_cosine = window.kind == "source"
        self._now = self._now[0], None

    @property
    def launches_depend_on(self) -> tuple[Any, ...]:
        """What of the view and the lights' directions the launches depend on; all else of these is on the device."""
        return len(self._to_lights), self._view.extent_y is None, self._casts_shadows, self._pigmented

    def survey(self, hf: HeightField, window: Coherence, *, sampled: bool = True) -> tuple[Scope, int, DirectionSample]:
        """The range of all lit directions, their number, and some of them unless they are of no use.

        That is a first pass over the rays, which cost a hundredth of the colours.
        """
        scope, count = Scope(0.0, 0.0, 0.0, 0.0), 0
        seen = []
        # A few rays a pixel see what all do.
        surveyed = min(self._samples, _SURVEYED)
        for sample in range(surveyed):
            for which in range(len(self._to_lights)):
                summary = Survey(hf, window, self._size, device=self._device)
                self.deflect(sample, which, summary)
                parts = len(self._to_lights) if sampled and sample == 0 else 0
                found, lit, some = summary.found(parts=parts, among=self._among)
                scope = scope.joined(found)
                count += lit
                seen.append(some)
        return scope, count * self._samples // surveyed, DirectionSample.joined(seen)

    def _passes(self, progress: Callable[[float], None] | None) -> Iterator[tuple[int, Callable[[float], None] | None]]:
        """Cast and deflect sample after sample, light after light.

        Yields a light's index, and the pass' share of progress.
        """
        count = len(self._to_lights)
        for sample in range(self._samples):
            for which in range(count):
                # The survey has left behind what a single pass needs.
                if self._now != (sample, which):
                    self.deflect(sample, which)
                yield which, _share(progress, sample * count + which, self._samples * count)

    def integrate(
        self,
        integrator: Integrator,
        illuminants: list[str],
        *,
        footprint: bool,
        tolerance: float,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Add the diffraction colours of all samples and lights."""
        if footprint and self._samples == 1:
            self._integrate_means(integrator, illuminants, tolerance=tolerance, progress=progress)
            return
        if footprint:
            self._launch(self._cast(0, 1))
            self._spreads = [
                self.spread(which, self._spreads[which] if which < len(self._spreads) else None)
                for which in range(len(self._to_lights))
            ]
        left_out = self._room_for_what_is_left_out(integrator)
        for which, share in self._passes(progress):
            integrator.add(
                *self._seen.directions, illuminants[which], self._sums[0],
                footprints=self._spreads[which] if footprint else None, left_out=left_out, among=self._among,
                progress=share,
            )  # fmt: skip

    def _room_for_what_is_left_out(self, integrator: Integrator) -> wp.array:
        """An array of a picture's size, which is made once, for a table that leaves directions out."""
        import warp as wp

        if integrator.leaves_out and not len(self._left_out):
            self._left_out = wp.empty(self._size, dtype=wp.float32, device=self._device)
        return self._left_out

    def _integrate_means(
        self,
        integrator: Integrator,
        illuminants: list[str],
        *,
        tolerance: float,
        progress: Callable[[float], None] | None,
    ) -> None:
        """The same of means over pixels, where that takes it over several rays in each."""
        import warp as wp

        self._lit, self._tiled = 0, 0
        left_out = self._room_for_what_is_left_out(integrator)
        # A single light's without pigments are the picture.
        are_picture = len(self._to_lights) == 1 and not self._pigmented
        if not are_picture and not len(self._colours):
            self._colours = wp.empty(self._size, dtype=wp.vec3f, device=self._device)
        colours = self._sums[0] if are_picture else self._colours
        for which, share in self._passes(progress):
            if not are_picture:
                colours.zero_()
            illuminant, seen, width = illuminants[which], self._seen, self._view.width
            steps = [self._spread(seen, width, self._view.height, self._deviation, seen.footprints)]
            steps += integrator.steps(*seen.directions, illuminant, colours, seen.footprints, left_out)
            options = {"slice_size": _COLOURS, "progress": share, **self._options}
            if self._alone:
                launch_in_turn(steps, self._among, **options)
                self._work_off_tiles(integrator, which, illuminant, tolerance, colours)
            else:
                threads = max(min(self._threads, supersample.most_threads(len(self._among))), 1)
                with shared_room(threads, leaves_out=integrator.leaves_out, device=self._device) as shared:
                    with begin_in_turn(steps, self._among, **options):
                        of_kinds = self._steps_of_tiles(integrator, which, illuminant, shared.room, colours)
                        chains = [Chain(each) for each in of_kinds]
                    lit, batches = supersample.batches(
                        colours, seen.deflections, seen.gains, width, tolerance, among=self._among, **self._options
                    )
                    for group in supersample.groups(batches):
                        shared.meet(group, chains, self._meet_tiles(group), threads=threads)
                self._lit += lit
                self._tiled += sum(len(batch.pixels) for batch in batches)
            if not are_picture:
                supersample.add(colours, self._sums[0], among=self._among, **self._options)

    def _meet_tiles(self, batches: Sequence[supersample.Batch]) -> NDArray[np.uint64]:
        """What ``cover`` finds of the rays of batches, one after the other, but for those that fan out."""
        import warp as wp

        from warpdiff.kernels import raycast

        rays = batches[-1].end_ray
        if not rays:
            return np.zeros(0, dtype=np.uint64)
        tiles = supersample.tiles_of(batches, self._view.width, self._view.height, self._device)
        nearest = wp.full(rays, raycast.UNSEEN, dtype=wp.uint64, device=self._device)
        inputs = [self._camera, self._scene.bare, self._sampling(0, 1), tiles, 0.0]
        launch(
            raycast.cover, self._scene.face_count, inputs, [nearest, self._rows[:0]], slice_size=_FACES,
            in_runs=True, **self._options,
        )  # fmt: skip
        return np.asarray(nearest.numpy())

    def _work_off_tiles(
        self, integrator: Integrator, which: int, illuminant: str, tolerance: float, colours: wp.array
    ) -> None:
        """The same, where the device itself finds these pixels and goes on until it has met them all."""
        lights = len(self._to_lights)
        if self._queue is None or self._queue.lights != lights:
            self._queue = supersample.Queue(self._size, lights, tolerance, **self._options)
            self._room = Room.by(self._queue.most_rays, leaves_out=integrator.leaves_out, device=self._device)
        self._queue.list_up(which, colours, self._seen.deflections, self._seen.gains, self._view.width)
        steps = self._steps_of_tiles(integrator, which, illuminant, self._room, colours)
        for kind in supersample.KINDS:
            self._queue.work_off(which, kind, steps[kind.index], self._room.tiles[kind.rays], self._room.colours)

    def _steps_of_tiles(
        self, integrator: Integrator, which: int, illuminant: str, room: Room, colours: wp.array
    ) -> list[list[Step]]:
        """What sets the colours of pixels of each kind to the means over tiles of rays, which add to zeros."""
        from warpdiff.kernels import directions
        from warpdiff.kernels.scene import Sampling

        seen = room.seen
        # What kinds share is one step for all of them, as it takes longer to make than to launch. The pigment of the
        # pixel's own ray stays.
        lit = {
            shadows: self._deflect(which, seen, 1.0, self._no_sums, sample=0, shadows=shadows)
            for shadows in (False, True)
        }
        look_up = integrator.steps(*seen.directions, illuminant, room.colours, seen.footprints, room.left_out)
        result = []
        of_rays: dict[int, tuple[Step, list[Step], Step, Step]] = {}
        for kind in supersample.KINDS:
            tile = kind.tile
            if kind.rays not in of_rays:
                sampling = Sampling()
                sampling.tiles = room.tiles[kind.rays]
                sampling.places, weights = tile.on(self._device)
                counts = [self._view.width, tile.deviation, integrator.leaves_out]
                of_rays[kind.rays] = (
                    Step(
                        directions.fan_out, [*self._seen.directions, sampling.tiles, sampling.places, *counts],
                        [*seen.directions, seen.footprints, seen.pixels.hit], in_runs=True, block=kind.rays,
                    ),
                    self._steps_of_rays(sampling, seen.pixels),
                    self._spread(seen, tile.across, tile.across, tile.deviation / tile.apart, seen.footprints),
                    Step(
                        directions.gather, [room.colours, seen.pixels.hit, sampling.tiles, weights], [colours],
                        in_runs=True, block=kind.rays,
                    ),
                )  # fmt: skip
            fan_out, meet, spread, gather = of_rays[kind.rays]
            seen_by_rays = [fan_out] if kind.even else [*meet, *lit[kind.shadows], spread]
            result.append([*seen_by_rays, *look_up, gather])
        return result

    def sum_directly(
        self, hf: HeightField, plan: Plan, illuminants: list[str], *, progress: Callable[[float], None] | None
    ) -> None:
        """The same by the direct sum."""
        for which, share in self._passes(progress):
            deflections, to_lights, gains = (each.astype(np.float64) for each in self.directions())
            added = direct_colour(hf, deflections, to_lights, gains, plan, illuminants[which], progress=share)
            self._sums[0].assign((self._sums[0].numpy() + added).astype(np.float32))

    def cast(self, sample: int) -> None:
        """Send one ray through every pixel."""
        self._launch(self._cast(sample, self._samples))
        self._now = sample, None

    def _launch(self, steps: Sequence[Step]) -> None:
        """Launch what finds rays and directions over all pixels."""
        launch_in_turn(steps, self._among, slice_size=_SLICE, **self._options)

    def _begin_to_cover(self, sampling: Any) -> Work:
        """Let faces find their pixels, while there is yet to be room for what these see, and a grid for shadow rays."""
        from warpdiff.kernels import raycast
        from warpdiff.kernels.scene import Tiles

        self._nearest.fill_(raycast.UNSEEN)
        self._rows.assign([self._view.height, -1])
        inputs = [self._camera, self._scene.bare, sampling, Tiles(), self._reach]
        cover = Step(raycast.cover, inputs, [self._nearest, self._rows], in_runs=True)
        return begin_in_turn([cover], self._scene.face_count, slice_size=_FACES, **self._options)

    def _keep_to(self, first_row: int, last_row: int) -> None:
        """Look at pixels of these rows alone from now on, and leave zeros elsewhere.

        They are the same for all samples of a view: how far these lie from pixels' centres is reckoned in for each.
        """
        written = self._among
        if first_row <= last_row:
            first = max(int(first_row) - 1, 0) * self._view.width // BLOCK
            end = -(-(int(last_row) + 2) * self._view.width // BLOCK)
            self._among = range(first * BLOCK, min(end * BLOCK, self._size))
        else:
            self._among = range(0)
        for sums in self._sums:
            values = sums.numpy()
            values[written.start : min(written.stop, self._among.start)] = 0
            values[max(written.start, self._among.stop) : written.stop] = 0

    def _prepare(self) -> None:
        """Make what rays need, on this thread."""
        from warpdiff import scene

        self._seen.pixels.nearest = self._nearest
        if self._casts_shadows and 0 not in self._grids:
            rays = self._samples * scene.pixels_within(self._surface, self._view)
            self._grids[0] = self._grid_for(0, rays, device=self._device, threads=1)

    def _cast(self, sample: int, samples: int) -> list[Step]:
        """What sends one ray through every pixel."""
        self.begin()
        sampling = self._sampling(sample, samples)
        if not self._alone:
            covering, self._covering = self._covering or self._begin_to_cover(sampling), None
            with covering:
                self._prepare()
            self._keep_to(*self._rows.numpy())
        return self._steps_of_rays(sampling, self._seen.pixels)

    def _sampling(self, sample: int, samples: int) -> Any:
        """Where a sample of every pixel lies."""
        import warp as wp

        from warpdiff.kernels import raycast
        from warpdiff.kernels.scene import Sampling

        sampling = Sampling()
        sampling.sample, sampling.samples, sampling.seed = sample, samples, _SEED
        if samples > 1 and len(self._places):
            sampling.places = self._places
        elif samples > 1 and not self._alone:
            if not len(self._offsets):
                self._offsets = wp.empty(self._size, dtype=wp.vec2d, device=self._device)
            inputs = [sample, samples, _SEED]
            launch(
                raycast.scatter, self._size, inputs, [self._offsets], slice_size=_SLICE, in_runs=True, **self._options
            )
            sampling.offsets = self._offsets
        return sampling

    def _steps_of_rays(self, sampling: Any, pixels: Any) -> list[Step]:
        """What finds where rays meet the mesh, and how it lies there."""
        from warpdiff.kernels import hierarchy, raycast

        arrays = self._scene.with_hierarchy() if self._alone else self._scene.bare
        find = hierarchy.cast if self._alone else raycast.meet
        return [
            Step(find, [self._camera, arrays, sampling, pixels], [], in_runs=True),
            Step(raycast.stand, [arrays, pixels], [], in_runs=True),
        ]

    @property
    def _casts_shadows(self) -> bool:
        """Whether the mesh may hide the lights."""
        return self._shadows and self._may_be_hidden

    def _grid_of(self, which: int) -> Any:
        """A grid of faces for shadow rays where it is worth it, once rays are cast."""
        if which not in self._grids:
            rays = 0 if self._alone else self._samples * int(np.count_nonzero(self._hits()))
            self._grids[which] = self._grid_for(which, rays, **self._options)
        return self._grids[which]

    def _grid_for(self, which: int, rays: int, **options: Any) -> Any:
        if not grid_pays(self._scene.face_count, rays):
            return no_grid(self._scene, few=not self._alone)
        return grid_for(self._surface, self._scene, self._to_lights[which], **options)

    def deflect(self, sample: int, which: int, summary: Survey | None = None) -> None:
        """Compute the deflections and gains of a sample under one light, add its pigment, and sum up, if that is asked.

        Rays are cast first, if they are another sample's.
        """
        steps: list[Step] = []
        if self._now[0] != sample:
            steps = self._cast(sample, self._samples)
            if self._casts_shadows and which not in self._grids:
                # Whether a grid is worth it, those that meet the mesh tell.
                self._launch(steps)
                steps = []
        steps += self._deflect(which, self._seen, float(self._weights[sample]), self._sums, sample=sample)
        if summary is not None:
            steps.append(summary.step(*self._seen.directions))
        self._launch(steps)
        self._now = sample, which

    def _deflect(
        self, which: int, seen: Seen, weight: float, sums: list[wp.array], *, sample: int, shadows: bool = True
    ) -> list[Step]:
        from warpdiff.kernels import directions
        from warpdiff.kernels.shadows import hide

        shadows = shadows and self._casts_shadows
        hidden = seen.hidden if shadows else self._none_hidden
        # What is covered counts once.
        counted, begins = weight if which == 0 else 0.0, which == 0 and sample == 0
        inputs = [seen.pixels, self._lights, which, self._reflection, weight, counted, begins, hidden]
        steps = [Step(directions.deflect_pixels, inputs, [*seen.directions, *sums], in_runs=True)]
        if shadows:
            inputs = [self._grid_of(which), self._lights.to_lights, which, seen.pixels]
            steps.insert(0, Step(hide, inputs, [hidden], in_runs=True))
        return steps

    def directions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The last deflections, directions to the light and gains."""
        deflections, to_lights, gains = (self._looked_at(each) for each in self._seen.directions)
        return deflections, to_lights, gains

    def _hits(self) -> NDArray[np.int32]:
        """Which pixels' rays have met the mesh."""
        return self._looked_at(self._seen.pixels.hit)

    def _looked_at(self, values: wp.array) -> NDArray[Any]:
        """What is found of all pixels; zero for those that are not looked at."""
        all_values, seen = values.numpy(), slice(self._among.start, self._among.stop)
        found: NDArray[Any] = np.zeros_like(all_values)
        found[seen] = all_values[seen]
        return found

    def spread(self, which: int, result: wp.array | None = None) -> wp.array:
        """What each pixel's filter, or a sample's share of it, does to (u, v), under one light."""
        import warp as wp

        from warpdiff.kernels.scene import Footprint

        if result is None:
            result = wp.zeros(self._size, dtype=Footprint, device=self._device)
        self._now = self._now[0], None
        steps = self._deflect(which, self._seen, 1.0, self._no_sums, sample=0, shadows=False)
        self._launch(steps)
        # A pixel's neighbours lie in other slices.
        self._launch([self._spread(self._seen, self._view.width, self._view.height, self._deviation, result)])
        return result

    @staticmethod
    def _spread(seen: Seen, width: int, height: int, deviation: float, result: wp.array) -> Step:
        """What filters do to (u, v), once it is known."""
        from warpdiff.kernels import directions

        inputs = [seen.deflections, seen.gains, seen.pixels.hit, width, height, deviation]
        return Step(directions.spread_pixels, inputs, [result], in_runs=True)

    @property
    def xyz(self) -> wp.array:
        """The colours, (height, width), where they are."""
        return self._sums[0].reshape((self._view.height, self._view.width))

    def image(self, plan: Plan) -> Image:
        """The finished picture."""
        shape = (self._view.height, self._view.width)
        xyz, coverage, lit = (sums.numpy() for sums in self._sums)
        coverage = coverage.astype(np.float32).reshape(shape)
        lit_pixels, tiled = (self._lit, self._tiled) if self._queue is None else self._queue.counts
        return Image(
            xyz=xyz.reshape(*shape, 3),
            mask=coverage > 0.0,
            lit=lit.reshape(shape),
            coverage=coverage,
            plan=replace(plan, supersampled=tiled / max(lit_pixels, 1)),
        )


def _share(progress: Callable[[float], None] | None, index: int, count: int) -> Callable[[float], None] | None:
    """The progress of one of several passes as a share of all."""
    if progress is None:
        return None
    return lambda done: progress((index + done) / count)
