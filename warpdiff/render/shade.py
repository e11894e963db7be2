"""``shade``: a picture of a mesh whose surface carries a height field."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from warpdiff.core import memory, validation
from warpdiff.core.progress import Progress, reporter
from warpdiff.core.threads import subprogress
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.kernels import refinement_levels
from warpdiff.lights.base import MANY_LIGHTS, Light, LobeChoice, LobeSet, listed
from warpdiff.lights.light_pass import SurfaceOptics
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.planner.refusals import warn_outside
from warpdiff.planner.strategy import directions_of, plan_for
from warpdiff.render.layers import LIGHT, directed, expanded, layers_of, lights_of, names_of
from warpdiff.render.picture import Picture, load_kernels
from warpdiff.render.spectral_pictures import check_pigment, check_spectral, spectra_of
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.plan import AUTOMATIC, has_table
from warpdiff.request.settings import PictureSettings, SinglePictureSettings
from warpdiff.request.signatures import accepts
from warpdiff.scene.camera import View
from warpdiff.scene.mesh_import import prepare_surface
from warpdiff.tables import polar_grid
from warpdiff.tables.lookup import ColourLookup

if TYPE_CHECKING:
    import contextlib
    from collections.abc import Callable, Collection, Sequence

    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.image.image import Image
    from warpdiff.lights.base import LightPart, Lobe
    from warpdiff.optics.coherence import Coherence
    from warpdiff.request.directions import DirectionRange, DirectionSample
    from warpdiff.request.keywords import SinglePictureKeywords
    from warpdiff.request.plan import Plan
    from warpdiff.scene.mesh_import import Surface


@accepts(SinglePictureSettings)
def shade(
    mesh: Any, heightfield: HeightField, lights: Light | Sequence[Light], view: View, *, progress: Progress = None,
    **settings: Unpack[SinglePictureKeywords],
) -> Image:  # fmt: skip
    """Render a mesh whose surface carries a height field.

    A pixel is the sum over the lights of power · XYZ(ρ, illuminant), a ratio of radiances. Where the mesh has a base
    colour, the light of the pigment is added. The mesh is visible from both sides.

    Args:
        mesh: A ``trimesh.Trimesh``, a ``trimesh.Scene``, or the path of a mesh file. Mesh units are arbitrary and
            independent of µm.
        heightfield: The height field; its x axis lies along the tangent field.
        lights: One light, or several.
        view: Camera and size of the picture.
        progress: Callable that gets the share that is done, 0 to 1, from any thread, one call at a time; True shows a
            bar. An exception that it raises cancels the picture.

    Returns:
        The picture; ``image.plan`` states what was computed and why.

    Raises:
        ValueError: A bad argument, or a mesh without area or tangents; the message names it.
        ToleranceError: The tolerance cannot be met, and ``strict`` is True.
        FileNotFoundError: The mesh file does not exist.
        MemoryError: More memory than is free; the message states what fits.

    Examples:
        >>> import warpdiff as wd
        >>> body, grating = wd.meshes.tube(), wd.gratings.sinusoidal(2.0, 0.1)
        >>> light, view = wd.DirectionalLight((0.3, 1.0, 0.8)), wd.View.fit(body, width=32, height=18)
        >>> wd.shade(body, grating, light, view, tolerance=0.1)
        Image(32 × 18 pixels, 21 % illuminated, estimated error 3.2 at the 99th percentile)
    """
    checked = SinglePictureSettings(**settings)
    inputs = PictureInputs.of(heightfield, lights, view, checked)
    request = LayerRequest.of(checked.layers, inputs)
    spectral = None
    if checked.wavelengths_nm is not None:
        spectral = replace(inputs.evaluation, wavelengths_nm=np.asarray(checked.wavelengths_nm))
        check_spectral(spectral, inputs.parts, view)
    progress = reporter(progress, "shade")
    load_kernels(inputs.evaluation.device)
    with picture_memory(view):
        surface = prepare_surface(mesh, tangents=checked.tangents)
        if spectral is not None:
            check_pigment(checked.pigment, has_base_colour=surface.has_base_colour)
        colours = progress if spectral is None else subprogress(progress, 0.0, _PROGRESS_OF_COLOURS)
        image = request.added_to(_render(inputs, surface, view, colours, request), inputs, surface, view)
        if spectral is not None:
            picture = inputs.picture(surface, view)
            picture.set_lights(inputs.parts)
            spectra = spectra_of(picture, spectral, subprogress(progress, _PROGRESS_OF_COLOURS, 1.0))
            image = replace(image, spectra=spectra, wavelengths_nm=spectral.wavelengths_nm)
    warn_unconverged(image)
    if image.mask.any() and not image.illuminated.any():
        warn(
            f"none of the {ref('lights')} illuminates a visible point of the mesh, so that all pixels are black: check "
            f"{ref('to_light')}, which points from the surface towards the light, and {ref('view')}"
        )
    return image


@dataclass(frozen=True)
class LayerRequest:
    """Layers of a picture, after checks against its lights.

    Attributes:
        names: Names of the layers, with the index of a light where there is one layer per light.
        parts: Parts of the lights that are rendered one after the other, for each light; empty if no layer is the light
            of a single light.
        directed: Parts whose directions layers show, for each light of ``layers.lights_of``.
    """

    names: tuple[str, ...]
    parts: tuple[list[LightPart], ...]
    directed: tuple[LightPart, ...]

    @classmethod
    def of(cls, names: Collection[str], inputs: PictureInputs) -> LayerRequest:
        """Check layers, before any kernel runs."""
        every = expanded(tuple(names), inputs.lights, inputs.parts)
        apart = any(name.partition(".")[0] == LIGHT for name in every)
        of_light = [inputs.parts_of_light(index) for index in range(len(inputs.lights) * apart)]
        directions = [directed(inputs.parts_of_light(index), name) for index, name in lights_of(every).items()]
        return cls(every, tuple(of_light), tuple(directions))

    def added_to(
        self, rendered: tuple[Image, list[NDArray[np.float32]]], inputs: PictureInputs, surface: Surface, view: View
    ) -> Image:
        """Return a picture with its layers.

        Args:
            rendered: Picture, and its colours under each part of ``parts``.
            inputs: Inputs of the picture.
            surface: The prepared mesh.
            view: Camera of the picture.
        """
        image, xyz_by_part = rendered
        if not self.names:
            return image
        points = inputs.of_points(self.directed).picture(surface, view)
        points.set_lights(self.directed)
        colours = iter(xyz_by_part)
        by_light: dict[str, NDArray[Any]] = {
            f"{LIGHT}.{index}": sum((next(colours) for _ in parts[1:]), next(colours))
            for index, parts in enumerate(self.parts)
        }
        others = layers_of(points, [name for name in self.names if name not in by_light])
        layers = {name: by_light[name] if name in by_light else others[name] for name in self.names}
        return replace(image, layers=layers, names=names_of(surface, self.names))


def _render(
    inputs: PictureInputs, surface: Surface, view: View, progress: Callable[[float], None] | None, request: LayerRequest
) -> tuple[Image, list[NDArray[np.float32]]]:
    """Render a prepared mesh, after choosing a plan for the directions that its pixels require.

    The second result are the colours under each part of ``request.parts``.
    """
    parts = [part for of_light in request.parts for part in of_light]
    xyz_by_part: list[NDArray[np.float32]] = []
    if parts:
        inputs = replace(inputs, parts=parts)
    evaluation = inputs.evaluation
    picture = inputs.picture(surface, view)
    picture.set_lights(inputs.parts)
    count: float
    if all(part.has_lobes for part in inputs.parts):
        direction_range, sample, count = picture.measure_directions(evaluation.heightfield)
    else:
        # Light from a sky comes from the whole hemisphere, so that the plan must cover all directions.
        direction_range, sample, count = directions_of(evaluation)
    plan = inputs.planned(direction_range, sample, count)
    collected = xyz_by_part if parts else None
    if plan.method == "direct":
        picture.render_directly(evaluation.heightfield, plan, progress=progress, xyz_by_part=collected)
    else:
        lookup = ColourLookup(
            evaluation.heightfield, plan, direction_range, device=evaluation.device, threads=evaluation.threads
        )
        picture.render(lookup, tolerance=plan.tolerance, progress=progress, xyz_by_part=collected)
    return with_history(picture.image(plan), evaluation.heightfield), xyz_by_part


def with_history(image: Image, heightfield: HeightField) -> Image:
    """Return a picture whose report has the history of its height field."""
    if image.report is None or not heightfield.history:
        return image
    return replace(image, report=replace(image.report, history=heightfield.history))


# Share of the progress of a spectral picture [0 to 1] that is reported when its colours are complete. Choice: it
# changes only the display.
_PROGRESS_OF_COLOURS = 0.5
# Largest memory per pixel that any kind of picture requires during its computation [bytes]. Fitted to measurements.
_BYTES_PER_PIXEL = 210


@dataclass(frozen=True)
class PictureInputs:
    """Checked inputs of pictures.

    Attributes:
        evaluation: Inputs of the colours: height field, coherence, materials, method, tolerance and device.
        settings: Keyword options of the call.
        lights: Lights as the user gave them.
        parts: Parts that the lights consist of: lobes, discs and skies.
    """

    evaluation: Evaluation
    settings: PictureSettings
    lights: list[Light]
    parts: list[LightPart]

    @classmethod
    def of(
        cls, heightfield: HeightField, lights: Light | Sequence[Light], view: View, settings: PictureSettings
    ) -> PictureInputs:
        """Combine settings, height field, lights and view; raise errors about them before any kernel runs."""
        footprint = settings.effective_footprint
        evaluation = Evaluation.of(heightfield, settings, by_geometry=True, footprint=footprint)
        lights = listed(lights)
        parts = parts_of(lights, evaluation, refine=settings.refine, means=footprint)
        validation.instance(view, View, "view")
        require_picture_memory(view, evaluation.device)
        most = refinement_levels.rays_at(refinement_levels.MOST_LEVEL)
        if footprint and settings.samples_per_pixel > most:
            raise ArgumentValueError(
                f"{ref('samples_per_pixel')} must be at most {most} with footprints, got {settings.samples_per_pixel}; "
                f"{ref('footprint', False)} accepts more"
            )
        plan = None if evaluation.plan is None else replace(evaluation.plan, footprint=footprint)
        # The planner tries tables for the spectra of lobes. If only a sky illuminates, one of its three smooth spectra
        # suffices.
        spectra = [name for part in parts if part.has_lobes for name in part.spectra] or parts[0].spectra[:1]
        illuminated = IlluminatedMaterial.of(spectra, evaluation.materials.values())
        return cls(replace(evaluation, plan=plan, illuminated=illuminated), settings, lights, parts)

    def parts_of_light(self, index: int) -> list[LightPart]:
        """Return the parts of one light, which are not combined with those of other lights."""
        light, evaluation = self.lights[index], self.evaluation
        return parts_of([light], evaluation, refine=self.settings.refine, means=evaluation.footprint, first=index)

    def of_points(self, parts: Sequence[LightPart]) -> PictureInputs:
        """Return the inputs of a picture of points with one ray per pixel, under other parts of lights."""
        settings = replace(self.settings, footprint=False, refine=False, samples_per_pixel=1)
        return replace(self, settings=settings, evaluation=replace(self.evaluation, footprint=False), parts=list(parts))

    def picture(self, surface: Surface, view: View, **options: Any) -> Picture:
        """Return a picture of a surface, whose arrays are allocated but not yet computed."""
        footprint, settings = self.evaluation.footprint, self.settings
        # Filters of pixels at the picture's border include cells of pixels beyond the border. These pixels form a
        # margin.
        margin = int(footprint and (settings.refine or settings.samples_per_pixel > 1))
        energy, size_um = self.evaluation.energy_factors, self.evaluation.heightfield.size_um
        optics = SurfaceOptics(
            self.evaluation.coherence, size_um[0] * size_um[1], self.evaluation.normal_reflectance,
            tuple(self.evaluation.materials.values()), self.evaluation.masking,
            None if energy is None else energy.values, settings.pigment, settings.shadows,
        )  # fmt: skip
        return Picture(
            surface, view, optics, smooth=settings.smooth, samples_per_pixel=settings.samples_per_pixel,
            means=footprint, refine=settings.refine, margin=margin,
            materials_of_faces=self.materials_of_faces(surface), device=self.evaluation.device,
            threads=self.evaluation.threads, **options,
        )  # fmt: skip

    def materials_of_faces(self, surface: Surface) -> NDArray[np.int32] | None:
        """Return the index of each face's material; None for a single material."""
        materials = self.evaluation.materials
        if "" in materials:
            return None
        names, known = surface.geometry_names, list(materials)
        if differing := sorted(set(names) - set(known)) or sorted(set(known) - set(names)):
            raise ArgumentValueError(
                f"{ref('material')} must name each of the mesh's geometries, "
                f"{', '.join(map(repr, sorted(set(names))))}, "
                f"and no others, got {', '.join(map(repr, known))}: see {differing[0]!r}"
            )
        return np.array([known.index(name) for name in names], dtype=np.int32)[surface.geometries]

    def planned(self, direction_range: DirectionRange, sample: DirectionSample, count: float) -> Plan:
        """Return the user's plan, or choose a plan for the measured directions.

        Lights with an extent require a plan with a table. If no table meets the tolerance for lobes with an extent, the
        plan has the best table. The smallest table that is expected to suffice is used for skies, and for lights under
        which all measured directions are dark.
        """
        request = evaluation = self.evaluation
        if evaluation.plan is not None:
            warn_outside(evaluation.plan, evaluation.heightfield, direction_range)
        if evaluation.integration == "auto" and not any(part.has_lobes for part in self.parts):
            # The planner tries no table for skies: a sky averages over many directions, so that errors in single
            # directions have no effect.
            request = replace(evaluation, integration="sampled", footprint=False)
        plan = evaluation.plan or plan_for(request, direction_range, sample, count)
        if not plan.uses_footprints and any(part.has_extent for part in self.parts):
            method = plan.method if has_table(plan.method, plan.coherence) else AUTOMATIC
            if any(part.has_lobes and part.has_extent for part in self.parts):
                by_table = replace(
                    evaluation, plan=None, method=method, integration="table", tolerance=plan.tolerance, strict=False
                )
                plan = plan_for(by_table, direction_range, sample, count)
            if not plan.uses_footprints:
                rings, azimuths = polar_grid.size_for_skies(plan)
                plan = replace(plan, method=method, rings_per_octave=rings, azimuths_per_width=azimuths, footprint=True)
        return evaluation.with_energy(plan)

    def refined(self, *, refine: bool) -> PictureInputs:
        """Return these inputs with or without refinement.

        Disc lights of 1.5° to 5° change with it: they are approximated by one lobe only without refinement.
        """
        settings = replace(self.settings, refine=refine)
        parts = parts_of(self.lights, self.evaluation, refine=refine, means=self.evaluation.footprint)
        return replace(self, settings=settings, parts=parts)


def require_picture_memory(view: View, device: wp.Device) -> None:
    """Raise MemoryError before work starts if the host has too little memory for a picture."""
    if device.is_cpu:
        memory.require_memory(
            _BYTES_PER_PIXEL * view.width * view.height, f"a picture of {view.width} × {view.height} pixels",
            "take a view of at most {side} times the width and height",
        )  # fmt: skip


def picture_memory(view: View) -> contextlib.AbstractContextManager[None]:
    """Return a context that turns a failed allocation into a MemoryError with the picture's size and a remedy."""
    remedy = (
        f"take a smaller {ref('view')}, {ref('mesh')} or {ref('heightfield')}, fewer {ref('samples_per_pixel')}, or a "
        f"larger {ref('tolerance')}"
    )
    return memory.as_memory_error(f"a picture of {view.width} × {view.height} pixels", remedy)


def warn_unconverged(image: Image) -> None:
    """Warn if too many pixels of a picture are expected to exceed its tolerance."""
    report = image.report
    if report is not None and not report.is_converged:
        warn(
            f"{100.0 * report.unconverged_share:.2g} % of the illuminated pixels are expected to exceed "
            f"{ref('tolerance', report.tolerance)}, and {100.0 * report.unconverged_edge_share:.2g} % of those at "
            "edges to exceed three times the tolerance: see image.error; render a larger picture, or move the camera "
            "closer"
        )


def check_extent(light: Light, name: str, coherence: Coherence, *, means: bool) -> None:
    """Raise an error for a light with an extent, if the coherence or the settings exclude it.

    A coherence of the kind ``"source"`` has its own angular diameter. Other lights with an extent require footprints.
    """
    if coherence.kind == "source":
        raise ArgumentValueError(
            f"{ref(name)} must not have an extent of its own with {ref('coherence')} of kind 'source', whose diameter "
            f"is that of all lights, got {light!r}: give one of them"
        )
    if not (means and coherence.adds_powers):
        raise ArgumentValueError(
            f"{ref(name)} has an extent and requires footprints, which {ref('coherence')} of kind {coherence.kind!r}, "
            f"{ref('footprint', False)}, {ref('wavelengths_nm')}, {ref('method', 'direct')} or a {ref('plan')} without "
            "footprints excludes, got "
            f"{light!r}: give several lights without an extent"
        )


def parts_of(
    lights: Sequence[Light], evaluation: Evaluation, *, refine: bool, means: bool, first: int = 0
) -> list[LightPart]:
    """Check lights and return their parts. Without refinement, discs of up to 5° become single lobes.

    ``first`` is the index of the first light among the lights of the picture, for errors.

    The lobes of all lights form one part, so that the error of a pixel is estimated under all of them. An uneven
    surface causes errors under each light, and separate estimates would not bound the sum of these errors. Refined
    pictures choose one of many directional lights in each cell.
    """
    lobes: list[Lobe] = []
    others: list[LightPart] = []
    for index, light in enumerate(lights, first):
        name = f"lights[{index}]"
        for part in light.parts(evaluation.coherence, single_lobe=not refine, name=name):
            if part.has_extent:
                check_extent(light, name, evaluation.coherence, means=means)
            # A subclass that overrides the pass is refined separately.
            if isinstance(part, LobeSet) and type(part).make_pass is LobeSet.make_pass:
                lobes += [replace(lobe, name=f"{ref(name)} ({type(light).__name__})") for lobe in part.lobes]
            else:
                others.append(part)
    chosen: list[LightPart] = []
    if refine and evaluation.footprint and evaluation.coherence.kind == "averaged":
        for spectrum in dict.fromkeys(lobe.illuminant for lobe in lobes):
            group = tuple(lobe for lobe in lobes if lobe.illuminant == spectrum and lobe.is_direction)
            if len(group) >= MANY_LIGHTS:
                chosen.append(LobeChoice(group))
                lobes = [lobe for lobe in lobes if lobe not in group]
    return [*([LobeSet(tuple(lobes))] if lobes else []), *chosen, *others]
