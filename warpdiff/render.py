"""``shade``: a picture of a mesh whose surface carries a height field."""

from __future__ import annotations

import queue
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff import checks, optics, search, spectrum, supersample
from warpdiff.coherence import Coherence
from warpdiff.device import Step, launch, launch_in_turn, load, resolve_device, resolve_threads, side_by_side
from warpdiff.evaluate import check_call, check_plan, direct_colour
from warpdiff.image import Image
from warpdiff.integration import Integrator
from warpdiff.light import DirectionalLight
from warpdiff.planning import AUTOMATIC, Plan, check_method, plan_for, warn_outside
from warpdiff.scope import Pilots, Scope
from warpdiff.shadows import grid_for, grid_pays, no_grid
from warpdiff.surface import prepare_surface
from warpdiff.survey import Survey
from warpdiff.view import View

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import warp as wp
    from numpy.typing import ArrayLike

    from warpdiff.heightfield import HeightField
    from warpdiff.surface import Surface

_SEED = 0
_SURVEYED = 4
# Rays and frames take a tenth of a microsecond each, colours three, faces two, and a launch as much as hundreds.
_SLICE, _COLOURS, _FACES = 8192, 2048, 2048


def shade(
    mesh: Any,
    hf: HeightField,
    light: DirectionalLight | Sequence[DirectionalLight],
    view: View,
    *,
    tolerance: float = 1e-2,
    method: str = "auto",
    coherence: Coherence | None = None,
    ior: float = 1.5,
    masking: bool = True,
    pigment: float = 1.0,
    shadows: bool = True,
    smooth: bool = True,
    tangents: ArrayLike | None = None,
    footprint: bool | None = None,
    samples_per_pixel: int = 1,
    plan: Plan | None = None,
    strict: bool = True,
    device: Any = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Image:
    """Render a mesh whose surface carries a height field.

    A pixel is the sum over the lights of power · XYZ(ρ, illuminant), a ratio of radiances, with the pigment's share
    where the mesh has a base colour. The mesh is seen from both sides.

    Args:
        mesh: A ``trimesh.Trimesh``, a ``trimesh.Scene``, or a path to a mesh file. Its unit has nothing to do with µm.
        hf: The height field; its x axis lies along the tangent field.
        light: One light, or several.
        view: The camera.
        tolerance: Error of XYZ against max(‖XYZ‖, 1e-3 · 99th percentile of Y), in 99 % of the lit pixels.
        method: ``"auto"``, ``"low-rank"``, ``"power"``, ``"jacobi-anger"``, ``"taylor"``, ``"taylor-uncentred"``, or
            ``"direct"`` (float64, slow and certain).
        coherence: The window, source or copies; None is averaged with σ = 16.25 µm.
        ior: Index of refraction, > 1; ``math.inf`` is a perfect mirror.
        masking: Whether V-cavity masking and shadowing is included.
        pigment: Strength of the base colour (texture, vertex colours or plain) that lies under the height field.
        shadows: Whether lights are hidden by the mesh itself.
        smooth: Whether vertex normals are interpolated; otherwise facets are seen.
        tangents: The direction of the height field's x at each vertex, world frame, shape (n, 3); None takes it from
            the texture coordinates.
        footprint: Whether a pixel shows the mean over the range of (u, v) that it sees, to first order, rather than the
            colour in its centre: no aliasing, no speckle of orders that fall between pixels. None is on for an averaged
            window and for a source where a table keeps the tolerance, and off otherwise. Where the picture is so steep
            that first order will not do, 9 or 25 rays of a pixel have footprints of their own.
        samples_per_pixel: Rays a pixel under a Gaussian filter (0.5 pixel, cut at 1.5); 1 is its centre. With
            footprints, 4, 9, 16 and 25 lie on a grid, where means over parts of a pixel add up best, and others on a
            spiral.
        plan: An explicit plan in place of ``tolerance``, ``method`` and ``coherence``; implies ``strict=False``.
        strict: Raise where the tolerance cannot be met, rather than warn.
        device: ``"cpu"`` (None) or a CUDA device.
        threads: Threads on the CPU; None is one a core. The picture does not depend on it.
        progress: Called with the share that is done, 0 to 1, from whichever thread did it, one at a time.

    Returns:
        The picture; ``image.plan`` says what was computed and why.

    Raises:
        ValueError: A bad argument, a mesh without area or tangents, a tolerance out of reach; the message names it.
        FileNotFoundError: ``mesh`` is a path to nothing.
    """
    check_call(
        hf, tolerance=tolerance, method=method, coherence=coherence, masking=masking, strict=strict, device=device,
        threads=threads, progress=progress,
    )  # fmt: skip
    lights = _check_lights(light)
    checks.instance(view, View, "view")
    checks.flag(shadows, "shadows")
    checks.flag(smooth, "smooth")
    normal = optics.normal_reflectance(ior)
    pigment = checks.number(pigment, "pigment", least=0.0)
    samples = checks.count(samples_per_pixel, "samples_per_pixel")
    if plan is not None:
        check_plan(plan, coherence, colour=True)
    window = plan.coherence if plan is not None else coherence or Coherence()
    blurred = _takes_footprints(footprint, method, window, plan)
    if plan is not None:
        plan = replace(plan, footprint=blurred)
    target, workers = resolve_device(device), resolve_threads(threads)
    _load_ray_kernels(target)
    if plan is None:
        _load_likely_kernels(hf, window, method, lights, view, footprint=blurred, tolerance=tolerance, device=target)
    names = [each.illuminant for each in lights]
    for index, name in enumerate(names):
        spectrum.check_illuminant(name, f"light[{index}].illuminant")
    surface = prepare_surface(mesh, tangents=tangents)

    frame = _Frame(surface, view, smooth=smooth, samples=samples, means=blurred, device=target, threads=workers)
    area = hf.size_um[0] * hf.size_um[1]
    frame.light_up(
        [frame.light_arguments(each, window, area, pigment=pigment / normal, shadows=shadows) for each in lights],
        frame.reflection(normal, window, masking=masking),
    )
    scope, count, pilots = frame.survey(hf, window)
    if plan is not None:
        warn_outside(plan, hf, scope)
    else:
        plan = plan_for(
            hf, scope, pilots, tolerance=tolerance, method=method, coherence=window, strict=strict, count=count,
            footprint=blurred, illuminants=tuple(dict.fromkeys(names)), device=target, threads=workers,
        )  # fmt: skip
    if plan.method == "direct":
        frame.sum_directly(hf, plan, names, progress=progress)
    else:
        integrator = Integrator(hf, plan, scope, device=target, threads=workers)
        share = frame.integrate(
            integrator, names, footprint=plan.footprint, tolerance=plan.tolerance, progress=progress
        )
        plan = replace(plan, supersampled=share)
    return frame.image(plan)


def _load_ray_kernels(device: wp.Device) -> None:
    """Begin to load what every picture needs, while the mesh is looked at."""
    from warpdiff.kernels import directions, raycast, shadows

    load([raycast.cast, directions.deflect_pixels, shadows.hide], device)


def _load_likely_kernels(
    hf: HeightField,
    window: Coherence,
    method: str,
    lights: list[DirectionalLight],
    view: View,
    *,
    footprint: bool,
    tolerance: float,
    device: wp.Device,
) -> None:
    """Begin to load what the plan is likely to take: threads that compile would wait until rays have been cast."""
    if method.partition("/")[0] not in ("auto", AUTOMATIC):
        return
    # What looks halfway between light and eye has the largest |w|.
    back = view.frame().back
    max_w = max(float(np.linalg.norm(np.add(each.to_light, back))) for each in lights)
    search.begin_to_load(hf, AUTOMATIC, window, max_w, footprint=footprint, tolerance=tolerance, device=device)


def _takes_footprints(footprint: bool | None, method: str, window: Coherence, plan: Plan | None) -> bool:
    """Whether pixels show means over what they see."""
    if footprint is not None:
        checks.flag(footprint, "footprint")
    if plan is not None:
        return plan.footprint if footprint is None else footprint
    tabled = method == "auto" or method.endswith("/table")
    if footprint is None:
        return tabled and window.adds_powers
    if footprint and not tabled:
        raise ValueError(f"footprint=True takes a table: use method='auto' or 'low-rank/table', got method={method!r}")
    if footprint:
        check_method("low-rank/table" if method == "auto" else method, window)
    return footprint


@dataclass(frozen=True)
class _Seen:
    """What rays see: the mesh, and under the last light whether it is hidden, deflections, directions to it, gains."""

    pixels: Any
    hidden: wp.array
    deflections: wp.array
    to_lights: wp.array
    gains: wp.array
    footprints: wp.array

    @classmethod
    def by(cls, rays: int, *, device: wp.Device, means: bool, covered: bool = False) -> _Seen:
        """Arrays for so many rays, with footprints if they show ``means``.

        Their first hits are found face by face if ``covered``.
        """
        import warp as wp

        from warpdiff.kernels import raycast

        def empty(dtype: Any, size: int = rays) -> Any:
            return wp.empty(size, dtype=dtype, device=device)

        pixels = raycast.Pixels()
        pixels.nearest = empty(wp.uint64, rays if covered else 0)
        pixels.hit, pixels.face = empty(wp.int32), empty(wp.int32)
        for name in ("tangent", "bitangent", "normal", "to_view", "shadow_origin", "base_colour"):
            setattr(pixels, name, empty(wp.vec3f))
        footprints = empty(wp.vec4f, rays if means else 0)
        return cls(pixels, empty(wp.bool), empty(wp.vec3d), empty(wp.vec3f), empty(wp.float32), footprints)

    @property
    def directions(self) -> tuple[wp.array, wp.array, wp.array]:
        """Deflections, directions to the light and gains."""
        return self.deflections, self.to_lights, self.gains


class _Frame:
    """The arrays of one picture on a device, and the launches that fill them."""

    def __init__(
        self,
        surface: Surface,
        view: View,
        *,
        smooth: bool,
        samples: int,
        means: bool = False,
        device: wp.Device,
        threads: int,
    ) -> None:
        """A frame of so many samples a pixel, of which each shows a mean over its part of the pixel if ``means``."""
        import warp as wp

        from warpdiff import scene

        self._view = view
        self._samples = samples
        self._places, self._weights, self._deviation = np.zeros((0, 2)), np.full(samples, 1.0 / samples), 0.0
        if means:
            self._places, self._weights, self._deviation = supersample.rays_of(samples)
        self._sample = 0
        self._device = device
        self._threads = threads
        self._options: dict[str, Any] = {"device": device, "threads": threads}
        self._surface = surface
        self._scene = scene.arrays_for(surface, smooth=smooth, device=device)
        self._camera = scene.camera(view, surface)
        self._needs_shadow_rays = scene.needs_shadow_rays(surface, view)
        # A GPU has no lack of threads for rays, and no use for faces of uneven sizes.
        self._covers = device.is_cpu and samples == 1 and scene.lies_ahead(surface, view)
        self._has_base_colour = surface.has_base_colour
        self._size = size = view.width * view.height

        self._seen = _Seen.by(size, device=device, means=means and samples == 1, covered=self._covers)
        self._none_hidden = wp.empty(0, dtype=wp.bool, device=device)
        dtypes = (wp.vec3f, wp.float64, wp.bool)
        # XYZ, coverage, and what any light reaches.
        self._sums = [wp.empty(size, dtype=dtype, device=device) for dtype in dtypes]
        self._no_sums = [wp.empty(0, dtype=dtype, device=device) for dtype in dtypes]
        self._lit_count = 0
        self._lights: list[Any] = []
        self._reflection: Any = None

    def light_up(self, lights: list[Any], reflection: Any) -> None:
        """Set the lights, structs of :meth:`light_arguments`, and the reflectance."""
        self._lights, self._reflection = lights, reflection

    def survey(self, hf: HeightField, window: Coherence) -> tuple[Scope, int, Pilots]:
        """The range of all lit directions, their number, and some of them.

        That is a first pass over the rays, which cost a hundredth of the colours.
        """
        scope, count = Scope(0.0, 0.0, 0.0, 0.0), 0
        seen = []
        # A few rays a pixel see what all do.
        surveyed = min(self._samples, _SURVEYED)
        for sample in range(surveyed):
            self.cast(sample)
            if sample == 0:
                self._sort_faces()
            for light in self._lights:
                summary = Survey(hf, window, *self._seen.directions, device=self._device)
                self.deflect(light, summary.step)
                found, lit, pilots = summary.found()
                scope = scope.joined(found)
                count += lit
                if sample == 0:
                    seen.append(pilots.arrays)
        self._lit_count = count * self._samples // surveyed
        return scope, self._lit_count, Pilots.among(*(np.concatenate(part) for part in zip(*seen, strict=True)))

    def _passes(self, progress: Callable[[float], None] | None) -> Iterator[tuple[int, Callable[[float], None] | None]]:
        """Cast and deflect sample after sample, light after light.

        Yields a light's index, and the pass' share of progress.
        """
        passes = self._samples * len(self._lights)
        for sample in range(self._samples):
            if self._samples > 1:
                self.cast(sample)
            for index, light in enumerate(self._lights):
                # The survey has left behind what a single pass needs.
                if passes > 1:
                    self.deflect(light)
                yield index, _share(progress, sample * len(self._lights) + index, passes)

    def integrate(
        self,
        integrator: Integrator,
        illuminants: list[str],
        *,
        footprint: bool,
        tolerance: float,
        progress: Callable[[float], None] | None,
    ) -> float:
        """Add the diffraction colours of all samples and lights; returns the share of pixels that took more rays."""
        if footprint and self._samples == 1:
            return self._integrate_means(integrator, illuminants, tolerance=tolerance, progress=progress)
        spreads: list[Any] = [None] * len(self._lights)
        if footprint:
            self._cast(0, 1)
            spreads = [self.spread(light) for light in self._lights]
        for index, share in self._passes(progress):
            integrator.add(
                *self._seen.directions, illuminants[index], self._sums[0], footprints=spreads[index], progress=share
            )
        return 0.0

    def _integrate_means(
        self,
        integrator: Integrator,
        illuminants: list[str],
        *,
        tolerance: float,
        progress: Callable[[float], None] | None,
    ) -> float:
        """The same of means over pixels, where that takes it over several rays in each."""
        import warp as wp

        tiled, width = 0, self._view.width
        for index, share in self._passes(progress):
            light, illuminant, seen = self._lights[index], illuminants[index], self._seen
            # A single light's without pigments are the picture.
            alone = len(self._lights) == 1 and not light.pigment
            colours = self._sums[0] if alone else wp.zeros(self._size, dtype=wp.vec3f, device=self._device)
            steps = [self._spread(light, seen, width, self._view.height, self._deviation, seen.footprints)]
            steps += integrator.steps(*seen.directions, illuminant, colours, seen.footprints)
            launch_in_turn(steps, self._size, least_slice=_COLOURS, progress=share, **self._options)
            batches = supersample.batches(colours, seen.gains, width, tolerance, **self._options)
            self._set_means(integrator, light, illuminant, batches, colours)
            tiled += sum(len(batch.pixels) for batch in batches)
            if not alone:
                supersample.add(colours, self._sums[0], **self._options)
        return tiled / max(self._lit_count, 1)

    def _set_means(
        self,
        integrator: Integrator,
        light: Any,
        illuminant: str,
        batches: list[supersample.Batch],
        colours: wp.array,
    ) -> None:
        """Set the colours of some pixels to the means over tiles of rays."""
        import warp as wp

        from warpdiff.kernels import directions, raycast

        threads = self._threads if self._device.is_cpu else 1
        # What a part of the pixels of a batch takes, made here, as other threads' memory is given back each time.
        rays = {batch.tile.across: batch.tile.on(self._device) for batch in batches}
        parts = [(batch, part) for batch in batches for part in batch.parts(self._device, threads)]
        most = max((len(part) * len(batch.tile.rays[1]) for batch, part in parts), default=0)
        rooms: queue.SimpleQueue[tuple[_Seen, wp.array]] = queue.SimpleQueue()
        for _ in range(min(len(parts), threads)):
            seen = _Seen.by(most, device=self._device, means=True)
            rooms.put((seen, wp.empty(most, dtype=wp.vec3f, device=self._device)))

        def work(each: tuple[supersample.Batch, range]) -> None:
            (batch, part), (seen, of_rays) = each, rooms.get()
            tile = batch.tile
            sampling = raycast.Sampling()
            sampling.tiles = wp.array(batch.pixels[part.start : part.stop], dtype=wp.int32, device=self._device)
            sampling.places, weights = rays[tile.across]
            if not batch.shadows:
                sampling.faces = self._seen.pixels.face
            of_rays.zero_()
            count = len(part) * len(weights)
            deflections, to_lights, gains = seen.directions
            deviation = tile.deviation / tile.apart
            steps = [
                Step(raycast.cast, [self._camera, self._scene.arrays, sampling, seen.pixels], [], in_runs=True),
                # The pigment of the pixel's own ray stays.
                *self._deflect(light, seen, 1.0, self._no_sums, shadows=batch.shadows),
                self._spread(light, seen, tile.across, tile.across, deviation, seen.footprints),
                # Look-ups take whole runs of those that there are gains of.
                *integrator.steps(deflections, to_lights, gains[:count], illuminant, of_rays, seen.footprints),
                Step(
                    directions.gather, [of_rays, seen.pixels.hit, sampling.tiles, weights], [colours],
                    in_runs=True, block=len(weights),
                ),
            ]  # fmt: skip
            launch_in_turn(steps, count, least_slice=count, device=self._device, threads=1)
            rooms.put((seen, of_rays))

        side_by_side(work, parts, threads=threads)

    def sum_directly(
        self, hf: HeightField, plan: Plan, illuminants: list[str], *, progress: Callable[[float], None] | None
    ) -> None:
        """The same by the direct sum."""
        for index, share in self._passes(progress):
            deflections, to_lights, gains = (each.astype(np.float64) for each in self.directions())
            added = direct_colour(hf, deflections, to_lights, gains, plan, illuminants[index], progress=share)
            self._sums[0].assign((self._sums[0].numpy() + added).astype(np.float32))

    def light_arguments(
        self, light: DirectionalLight, window: Coherence, area_um2: float, *, pigment: float, shadows: bool
    ) -> Any:
        """The struct of one light."""
        import warp as wp

        from warpdiff.kernels import directions

        grid_um = np.arange(spectrum.LAMBDA_MIN_NM, spectrum.LAMBDA_MAX_NM + 1, dtype=np.float64) * 1e-3
        white = optics.pigment_solid_angle(grid_um, window, area_um2) @ spectrum.colour_products(light.illuminant)
        arguments = directions.LightArguments()
        arguments.to_light = wp.vec3d(*light.to_light)
        arguments.power = light.power
        arguments.grid = no_grid(self._scene, light.to_light)
        arguments.shadows = shadows and self._needs_shadow_rays
        arguments.pigment = pigment if self._has_base_colour else 0.0
        arguments.white_rgb = wp.vec3d(*spectrum.xyz_to_rgb(white))
        arguments.rgb_to_xyz = wp.mat33d(*spectrum.RGB_TO_XYZ.ravel())
        return arguments

    @staticmethod
    def reflection(normal: float, window: Coherence, *, masking: bool) -> Any:
        """The struct of the reflectance."""
        from warpdiff.kernels import directions

        result = directions.Reflection()
        result.normal_reflectance = normal
        result.masking = masking
        result.per_light_cosine = window.kind == "source"
        return result

    def cast(self, sample: int) -> None:
        """Send one ray through every pixel."""
        self._cast(sample, self._samples)

    def _cast(self, sample: int, samples: int) -> None:
        import warp as wp

        from warpdiff.kernels import raycast

        sampling = raycast.Sampling()
        sampling.sample, sampling.samples, sampling.seed = sample, samples, _SEED
        self._sample = sample
        if samples > 1:
            sampling.places = wp.array(self._places, dtype=wp.vec2d, device=self._device)
        pixels = self._seen.pixels
        if self._covers:
            pixels.nearest.fill_(raycast.UNSEEN)
            faces = self._scene.face_count
            inputs = [self._camera, self._scene.arrays, pixels]
            launch(raycast.cover, faces, inputs, [], least_slice=_FACES, in_runs=True, **self._options)
        inputs = [self._camera, self._scene.arrays, sampling, pixels]
        launch(raycast.cast, self._size, inputs, [], least_slice=_SLICE, in_runs=True, **self._options)

    def _sort_faces(self) -> None:
        """Make grids of faces for shadow rays where these are worth it. A GPU has rays enough for its hierarchy."""
        rays = self._samples * int(np.count_nonzero(self._seen.pixels.hit.numpy())) if self._device.is_cpu else 0
        for light in self._lights:
            if light.shadows and grid_pays(self._scene.face_count, rays):
                to_light = [float(part) for part in light.to_light]
                light.grid = grid_for(self._surface, self._scene, to_light, **self._options)

    def deflect(self, light: Any, *after: Step) -> None:
        """Compute the deflections and gains under one light, add its pigment, and what comes after."""
        steps = self._deflect(light, self._seen, float(self._weights[self._sample]), self._sums)
        launch_in_turn([*steps, *after], self._size, least_slice=_SLICE, **self._options)

    def _deflect(
        self, light: Any, seen: _Seen, weight: float, sums: list[wp.array], *, shadows: bool = True
    ) -> list[Step]:
        from warpdiff.kernels import directions
        from warpdiff.kernels.shadows import hide

        shadows = shadows and light.shadows
        hidden = seen.hidden if shadows else self._none_hidden
        # What is covered counts once.
        is_first = light is self._lights[0]
        counted, begins = weight if is_first else 0.0, is_first and self._sample == 0
        inputs = [seen.pixels, light, self._reflection, weight, counted, begins, hidden]
        steps = [Step(directions.deflect_pixels, inputs, [*seen.directions, *sums], in_runs=True)]
        if shadows:
            steps.insert(0, Step(hide, [light.grid, seen.pixels], [hidden], in_runs=True))
        return steps

    def directions(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The last deflections, directions to the light and gains."""
        deflections, to_lights, gains = (each.numpy() for each in self._seen.directions)
        return deflections, to_lights, gains

    def spread(self, light: Any) -> wp.array:
        """How (u, v) changes over each pixel's filter, or a sample's share of it, under one light."""
        import warp as wp

        result = wp.empty(self._size, dtype=wp.vec4f, device=self._device)
        step = self._spread(light, self._seen, self._view.width, self._view.height, self._deviation, result)
        launch_in_turn([step], self._size, least_slice=_SLICE, **self._options)
        return result

    @staticmethod
    def _spread(light: Any, seen: _Seen, width: int, height: int, deviation: float, result: wp.array) -> Step:
        import warp as wp

        from warpdiff.kernels import directions

        inputs = [seen.pixels, wp.vec3f(*light.to_light), width, height, deviation]
        return Step(directions.spread_pixels, inputs, [result], in_runs=True)

    def image(self, plan: Plan) -> Image:
        """The finished picture."""
        shape = (self._view.height, self._view.width)
        xyz, coverage, lit = (sums.numpy() for sums in self._sums)
        coverage = coverage.astype(np.float32).reshape(shape)
        return Image(
            xyz=xyz.reshape(*shape, 3),
            mask=coverage > 0.0,
            lit=lit.reshape(shape),
            coverage=coverage,
            plan=plan,
        )


def _check_lights(light: Any) -> list[DirectionalLight]:
    lights = [light] if isinstance(light, DirectionalLight) else light
    if not isinstance(lights, Sequence) or not lights:
        raise TypeError(f"light must be a DirectionalLight, or a non-empty sequence of them, got {light!r}")
    for index, each in enumerate(lights):
        checks.instance(each, DirectionalLight, f"light[{index}]")
    return list(lights)


def _share(progress: Callable[[float], None] | None, index: int, count: int) -> Callable[[float], None] | None:
    """The progress of one of several passes as a share of all."""
    if progress is None:
        return None
    return lambda done: progress((index + done) / count)
