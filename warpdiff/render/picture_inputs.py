"""Checked inputs of pictures: one or several surfaces of a mesh, lights and settings.

A plan holds the numbers of a computation, such as wavelengths. Coherence states how far light interferes. Colours are
relative to a mirror, the unit of the picture. A plain surface has no height field.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.core import memory, validation
from warpdiff.core.wording import ArgumentTypeError, ArgumentValueError, ref, renaming
from warpdiff.heightfield.field import HeightField
from warpdiff.heightfield.grating_map import GratingMap
from warpdiff.kernels import refinement_levels
from warpdiff.lights.base import Light, listed
from warpdiff.lights.grating_dots import material_of_dots
from warpdiff.lights.surface_optics import PictureUnit, SurfaceOptics
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.coherence import Coherence
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.planner.refusals import warn_outside
from warpdiff.planner.strategy import directions_of, plan_for
from warpdiff.render import map_inputs
from warpdiff.render.light_parts import parts_of
from warpdiff.render.picture import Picture
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.plan import AUTOMATIC, Plan, has_table
from warpdiff.request.surface import Surface
from warpdiff.scene.camera import View
from warpdiff.scene.part_names import key_of_faces
from warpdiff.tables import polar_grid
from warpdiff.tables.lookup import ColourLookup, Lookups
from warpdiff.tables.pitch_ladder import LadderLookup

if TYPE_CHECKING:
    import contextlib
    from collections.abc import Iterable, Sequence

    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.image.image import Image
    from warpdiff.lights.base import LightPart
    from warpdiff.request.directions import DirectionRange, DirectionSample
    from warpdiff.request.settings import PictureSettings
    from warpdiff.scene.mesh_import import Surface as Mesh

SurfaceOfPart = HeightField | GratingMap | Surface | None
SurfacesOfMesh = HeightField | GratingMap | Mapping[str, SurfaceOfPart]

# Largest memory per pixel that pictures require during their computation [bytes]. The value was measured. If it were
# doubled, pictures that would fit into memory would be refused.
_BYTES_PER_PIXEL = 210


# Height field that stands for a plain surface in structures that require one. Its colours are never looked up.
_FLAT = HeightField(np.zeros((1, 1)), 1.0)


@dataclass(frozen=True)
class SurfaceInputs:
    """Checked inputs of pictures for one of their surfaces.

    Attributes:
        evaluation: Inputs of the colours: height field, coherence, materials, method, tolerance and device.
        settings: Options of the call, with those of the surface.
        parts: Parts that the lights consist of: lobes, discs and skies. Plans are chosen for their spectra.
        is_plain: Whether the surface has no height field, and reflects light by its base colour and material.
        unit: Factor that makes the colours of the surface relative to the picture's mirror; None if they are already.
        grating_map: Map of one grating per small rectangle; its ``reference`` is ``evaluation.heightfield``; or None.
    """

    evaluation: Evaluation
    settings: PictureSettings
    parts: list[LightPart]
    is_plain: bool = False
    unit: float | None = None
    grating_map: GratingMap | None = None

    @classmethod
    def of(
        cls, heightfield: HeightField | GratingMap | None, lights: Sequence[Light], settings: PictureSettings
    ) -> SurfaceInputs:
        """Combine and check settings, lights and a height field or grating map; None is a plain surface."""
        grating_map = heightfield if isinstance(heightfield, GratingMap) else None
        if isinstance(heightfield, GratingMap):
            settings, heightfield = map_inputs.settings_of_map(heightfield, settings), heightfield.reference
        footprint = settings.effective_footprint
        evaluation = Evaluation.of(
            _FLAT if heightfield is None else heightfield, settings, by_geometry=True, footprint=footprint
        )
        parts = parts_of(lights, evaluation, refine=settings.refine, means=footprint)
        plan = None if evaluation.plan is None else replace(evaluation.plan, footprint=footprint)
        # The planner tests colour tables for the illuminants of lobes. If a sky is the only light, it suffices to test
        # one of the sky's three primary spectra, because all three are smooth.
        spectra = [name for part in parts if part.has_lobes for name in part.spectra] or parts[0].spectra[:1]
        materials = [material_of_dots(material, grating_map) for material in evaluation.materials.values()]
        illuminated = IlluminatedMaterial.of(spectra, materials)
        evaluation = replace(evaluation, plan=plan, illuminated=illuminated)
        return cls(evaluation, settings, parts, heightfield is None, grating_map=grating_map)

    def optics(self, mesh: Mesh) -> SurfaceOptics:
        """Return the optics of the surface on a mesh, except for the diffraction of its height field."""
        evaluation, settings = self.evaluation, self.settings
        energy, size_um = evaluation.energy_factors, evaluation.heightfield.size_um
        return SurfaceOptics(
            evaluation.coherence, size_um[0] * size_um[1], evaluation.normal_reflectance,
            tuple(evaluation.materials.values()), evaluation.masking, None if energy is None else energy.values,
            settings.pigment if self.is_plain or mesh.has_base_colour else 0.0, settings.shadows, self.is_plain,
            self.unit, self.grating_map,
        )  # fmt: skip

    def materials_of_faces(self, mesh: Mesh) -> NDArray[np.int32] | None:
        """Return the index of each face's material; None for a single material."""
        materials = self.evaluation.materials
        if "" in materials:
            return None
        names, known = mesh.geometry_names, list(materials)
        if differing := sorted(set(names) - set(known)) or sorted(set(known) - set(names)):
            raise ArgumentValueError(
                f"{ref('material')} must name each of the mesh's geometries, "
                f"{', '.join(map(repr, sorted(set(names))))}, "
                f"and no others, got {', '.join(map(repr, known))}: see {differing[0]!r}"
            )
        return np.array([known.index(name) for name in names], dtype=np.int32)[mesh.geometries]

    def planned(self, direction_range: DirectionRange, sample: DirectionSample, count: float) -> Plan:
        """Return the user's plan (numbers of the computation), or choose a plan for the measured directions.

        Lights with an extent require a plan with a table of colours. If no table meets the tolerance for lobes (parts
        of lights) with an extent, the plan has the best table. For skies, and for lights under which all measured
        directions are dark, the plan has the smallest table that is expected to suffice.
        """
        request = evaluation = self._evaluation_of_table
        if evaluation.plan is not None:
            is_known = count < np.inf
            warn_outside(evaluation.plan, evaluation.heightfield, direction_range, compares_rates=is_known)
        if evaluation.integration == "auto" and not any(part.has_lobes for part in self.parts):
            # The planner tests the errors of tables in single directions. This is not done for skies: a sky averages
            # over many directions, so that such errors have little effect.
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
        return evaluation.with_energy(replace(plan, coherence=self.evaluation.coherence))

    def lookup(self, plan: Plan, direction_range: DirectionRange) -> ColourLookup:
        """Return the object that looks up the surface's colours, in tables or by sums over wavelengths, by the plan."""
        evaluation, ladder = self._evaluation_of_table, map_inputs.ladder_of(self.grating_map, self.evaluation)
        inputs = evaluation.heightfield, replace(plan, coherence=evaluation.coherence), direction_range
        device, threads = evaluation.device, evaluation.threads
        if ladder is not None:
            return LadderLookup(ladder, *inputs, device=device, threads=threads)
        has_map = self.grating_map is not None
        return ColourLookup(*inputs, pitch_scales=has_map, device=device, threads=threads)

    @property
    def _evaluation_of_table(self) -> Evaluation:
        """Inputs from which plan and colour table are made. With a grating map, they may have another coherence."""
        evaluation = self.evaluation
        if self.grating_map is None:
            return evaluation
        coherence = map_inputs.coherence_of_table(self.grating_map, evaluation)
        plan = None if evaluation.plan is None else replace(evaluation.plan, coherence=coherence)
        return replace(evaluation, coherence=coherence, plan=plan)


@dataclass(frozen=True)
class PictureInputs:
    """Checked inputs of pictures of a mesh.

    Attributes:
        heightfield: Height field or surfaces, as the user gave them.
        settings: Options of the call.
        lights: Lights as the user gave them.
        surfaces: Inputs of each surface by the key of its part (such as the name of a geometry); the key is ``""`` if
            the mesh has one height field.
        parts: Parts that the lights consist of (lobes, discs and skies), with powers relative to the picture's mirror.
    """

    heightfield: SurfacesOfMesh
    settings: PictureSettings
    lights: list[Light]
    surfaces: dict[str, SurfaceInputs]
    parts: list[LightPart]

    @classmethod
    def of(
        cls, heightfield: SurfacesOfMesh, lights: Light | Sequence[Light], view: View, settings: PictureSettings
    ) -> PictureInputs:
        """Combine settings, surfaces, lights and view; raise errors if they contradict, before any kernel runs."""
        lights = listed(lights)
        if isinstance(heightfield, Mapping):
            surfaces = _inputs_by_key(heightfield, lights, settings)
        else:
            if isinstance(settings.plan, Mapping):
                raise ArgumentValueError(
                    f"{ref('plan')} must be a warpdiff.Plan for one {ref('heightfield')}, got a mapping"
                )
            if not isinstance(heightfield, GratingMap):
                validation.instance(heightfield, HeightField, "heightfield")
            surfaces = {"": SurfaceInputs.of(heightfield, lights, settings)}
        first = next(iter(surfaces.values()))
        validation.instance(view, View, "view")
        require_picture_memory(view, first.evaluation.device)
        most = refinement_levels.rays_at(refinement_levels.MOST_LEVEL)
        if first.evaluation.footprint and settings.samples_per_pixel > most:
            raise ArgumentValueError(
                f"{ref('samples_per_pixel')} must be at most {most} with footprints, got {settings.samples_per_pixel}; "
                f"{ref('footprint', False)} accepts more"
            )
        inputs = cls(heightfield, settings, lights, surfaces, first.parts)
        if not isinstance(heightfield, Mapping):
            return inputs
        parts = parts_of(lights, _in_unit(inputs), refine=settings.refine, means=first.evaluation.footprint)
        return replace(inputs, parts=parts)

    @property
    def _reference_area_um2(self) -> float:
        """Area of the first height field [µm²]; the mirror to which colours are relative has this area, too.

        The area has an effect only if the coherence is a number of whole periods that interfere.
        """
        first = next(heightfield for heightfield in self.heightfields if heightfield is not None)
        return first.size_um[0] * first.size_um[1]

    @property
    def heightfields(self) -> list[HeightField | None]:
        """Height field of each surface; None for a plain surface."""
        return [None if own.is_plain else own.evaluation.heightfield for own in self.surfaces.values()]

    @property
    def has_map(self) -> list[bool]:
        """Whether each surface has a grating map."""
        return [own.grating_map is not None for own in self.surfaces.values()]

    @property
    def plain(self) -> dict[str, bool] | None:
        """Whether each surface is plain, by the name of its mesh part; None if the mesh has one height field."""
        if not isinstance(self.heightfield, Mapping):
            return None
        return {key: own.is_plain for key, own in self.surfaces.items()}

    @property
    def evaluation(self) -> Evaluation:
        """Inputs of the first surface's colours; device, threads and footprints are the same for all surfaces."""
        return next(iter(self.surfaces.values())).evaluation

    def parts_of(self, lights: Sequence[Light], *, means: bool) -> list[LightPart]:
        """Check lights for each surface. Return their parts, with powers relative to the mirror of the picture."""
        refine = self.settings.refine
        if isinstance(self.heightfield, Mapping):
            for own in self.surfaces.values():
                parts_of(lights, own.evaluation, refine=refine, means=means)
        return parts_of(lights, _in_unit(self), refine=refine, means=means)

    def planned(
        self, directions: Iterable[tuple[DirectionRange, DirectionSample, float]] | None
    ) -> tuple[list[Plan], Lookups]:
        """Return the plans of surfaces with a height field, and the look-ups of the colours of all surfaces.

        Args:
            directions: Directions for which each of these plans is required: their range, a sample of them, and the
                number of all of them, which may be infinite. None means all directions of the hemisphere.
        """
        measured = None if directions is None else iter(directions)
        plans: list[Plan] = []
        lookups: list[ColourLookup | None] = []
        for own in self.surfaces.values():
            if own.is_plain:
                lookups.append(None)
                continue
            direction_range, sample, count = directions_of(own.evaluation) if measured is None else next(measured)
            with map_inputs.naming_depth_scale(own.grating_map):
                plans.append(own.planned(direction_range, sample, count))
            lookups.append(own.lookup(plans[-1], direction_range))
        return plans, Lookups(lookups)

    def parts_of_light(self, index: int) -> list[LightPart]:
        """Return the lobes, discs and skies (parts) of one light; they are not combined with those of other lights."""
        evaluation = _in_unit(self)
        light = self.lights[index]
        return parts_of([light], evaluation, refine=self.settings.refine, means=evaluation.footprint, first=index)

    def of_points(self, parts: Sequence[LightPart]) -> PictureInputs:
        """Return the inputs for a picture with one ray per pixel and without footprints, under parts of lights."""
        settings = replace(self.settings, footprint=False, refine=False, samples_per_pixel=1)
        surfaces = {
            key: replace(own, evaluation=replace(own.evaluation, footprint=False)) for key, own in self.surfaces.items()
        }
        return replace(self, settings=settings, surfaces=surfaces, parts=list(parts))

    def by_key(self, plans: Sequence[Plan]) -> Plan | dict[str, Plan]:
        """Return the only plan if the user gave one height field, otherwise the plans by keys of the mesh's parts.

        Plain surfaces have no plan, and are omitted.
        """
        if not isinstance(self.heightfield, Mapping):
            return plans[0]
        keys = [key for key, surface in self.surfaces.items() if not surface.is_plain]
        return dict(zip(keys, plans, strict=True))

    def picture(self, mesh: Mesh, view: View, **options: Any) -> Picture:
        """Return a picture of a mesh, whose arrays are allocated but not yet computed."""
        footprint, settings = self.evaluation.footprint, self.settings
        # Filters of pixels at the picture's border include subpixel cells beyond the border. A margin of additional
        # pixels contains these cells.
        margin = int(footprint and (settings.refine or settings.samples_per_pixel > 1))
        optics = [own.optics(mesh) for own in self.surfaces.values()]
        if isinstance(self.heightfield, Mapping):
            finish_of_faces: NDArray[np.int32] | None = key_of_faces(mesh, list(self.surfaces), "heightfield")
            if not mesh.has_base_colour:
                # On a mesh without a base colour, plain surfaces are white.
                mesh = replace(mesh, plain_colour=np.ones(3, dtype=np.float32), has_base_colour=True)
        else:
            finish_of_faces = next(iter(self.surfaces.values())).materials_of_faces(mesh)
        map_inputs.check_texture_coordinates(
            mesh, optics, finish_of_faces if isinstance(self.heightfield, Mapping) else None
        )  # fmt: skip
        unit = PictureUnit(_in_unit(self).coherence, self._reference_area_um2)
        return Picture(
            mesh, view, optics, unit=unit, finish_of_faces=finish_of_faces, smooth=settings.smooth,
            samples_per_pixel=settings.samples_per_pixel, means=footprint, refine=settings.refine, margin=margin,
            device=self.evaluation.device, threads=self.evaluation.threads, **options,
        )  # fmt: skip

    def image(self, picture: Picture, plans: Sequence[Plan]) -> Image:
        """Return a finished picture with its plan or plans, and the steps that made its height fields."""
        image = replace(picture.image(plans), plan=self.by_key(plans))
        histories = {key: own.evaluation.heightfield.history for key, own in self.surfaces.items()}
        history = tuple(f"{key}: {step}" if key else step for key, steps in histories.items() for step in steps)
        if image.report is None or not history:
            return image
        return replace(image, report=replace(image.report, history=history))

    def refined(self, *, refine: bool) -> PictureInputs:
        """Return these inputs with or without refinement.

        The parts of the lights are made again, because those of discs of 1.5° to 5° depend on refinement. Without
        refinement, one lobe approximates such a disc; with refinement, its directions are sampled.
        """
        result = replace(self, settings=replace(self.settings, refine=refine))
        return replace(result, parts=result.parts_of(self.lights, means=self.evaluation.footprint))

    def with_plans(self, plans: Sequence[Plan]) -> PictureInputs:
        """Return these inputs with explicit plans for the surfaces that have a height field."""
        given = iter(plans)
        surfaces = {
            key: surface
            if surface.is_plain
            else replace(surface, evaluation=replace(surface.evaluation, plan=next(given)))
            for key, surface in self.surfaces.items()
        }
        return replace(self, surfaces=surfaces)


def _in_unit(inputs: PictureInputs) -> Evaluation:
    """Return the inputs of the first surface, with the coherence to which all colours of the picture are relative."""
    evaluation = inputs.evaluation
    if not isinstance(inputs.heightfield, Mapping):
        return evaluation
    return replace(evaluation, coherence=_unit_coherence(inputs.heightfield, inputs.settings))


def _unit_coherence(surfaces: Mapping[str, SurfaceOfPart], settings: PictureSettings) -> Coherence:
    """Return the coherence of the mirror to which all colours of a picture are relative.

    It is the argument ``coherence`` of the call, which applies to surfaces without a coherence of their own.
    """
    if settings.coherence is not None or not isinstance(settings.plan, Mapping):
        return settings.coherence or Coherence()
    own = {key for key, value in surfaces.items() if _has_own_coherence(value)}
    planned = {plan.coherence for key, plan in settings.plan.items() if key not in own}
    if len(planned) > 1:
        raise ArgumentValueError(
            f"{ref('coherence')} must be given, because the plans of surfaces without a coherence of their own differ: "
            f"{', '.join(sorted(map(str, planned)))}; it is the unit of the picture"
        )
    return planned.pop() if planned else Coherence()


def _has_own_coherence(surface: SurfaceOfPart) -> bool:
    """Whether a surface does not use the call's argument ``coherence``. A grating map has a default of its own."""
    if isinstance(surface, Surface):
        return surface.coherence is not None or isinstance(surface.heightfield, GratingMap)
    return isinstance(surface, GratingMap)


def _inputs_by_key(
    surfaces: Mapping[str, SurfaceOfPart], lights: Sequence[Light], settings: PictureSettings
) -> dict[str, SurfaceInputs]:
    """Check a mapping from keys (names of mesh parts) to surfaces; return the inputs of each surface by its key."""
    checked = {key: _checked_surface(key, value) for key, value in surfaces.items()}
    gratings = {key: surface for key, surface in checked.items() if surface is not None}
    if not gratings:
        raise ArgumentValueError(f"{ref('heightfield')} must have a height field for at least one part, got none")
    for name in ("material", "plan"):
        given = getattr(settings, name)
        if isinstance(given, Mapping) and (unknown := [key for key in given if key not in gratings]):
            raise ArgumentValueError(
                f"{ref(name)} must have the keys of {ref('heightfield')}, {', '.join(map(repr, gratings))}, got "
                f"{unknown[0]!r}"
            )
    if (settings.plan is not None and not isinstance(settings.plan, Mapping)) or settings.method == "direct":
        word = ref("method", "direct") if settings.method == "direct" else "one plan"
        raise ArgumentValueError(
            f"{ref('heightfield')} has several surfaces, for which {word} is not supported, got "
            f"{', '.join(map(repr, gratings))}: give {ref('plan')} by their keys, or another {ref('method')}"
        )
    of_plain = replace(settings, material=None, ior=None, plan=None)
    first = next(iter(gratings.values())).heightfield
    in_unit = _mean_solid_angle(
        _unit_coherence(surfaces, settings), first.reference if isinstance(first, GratingMap) else first
    )
    inputs = {}
    for key, surface in checked.items():
        if surface is None:
            inputs[key] = replace(SurfaceInputs.of(None, lights, replace(of_plain, pigment=1.0)), unit=1.0)
            continue
        with renaming({"heightfield": f"heightfield[{key!r}]"}):
            own = SurfaceInputs.of(surface.heightfield, lights, _settings_of(surface, key, settings))
        unit = (
            own.evaluation.normal_reflectance
            * in_unit
            / _mean_solid_angle(own.evaluation.coherence, own.evaluation.heightfield)
        )
        inputs[key] = replace(own, unit=unit)
    if len({own.evaluation.footprint for own in inputs.values()}) > 1:
        raise ArgumentValueError(
            f"{ref('heightfield')} must have surfaces of which all or none have footprints, got both, because "
            f"{ref('coherence')} of the kinds 'centred' and 'replicas' has none: give {ref('footprint', False)}"
        )
    return inputs


def _checked_surface(key: object, value: object) -> Surface | None:
    """Return a value of the user's mapping from mesh parts to surfaces, after checks; None is a plain surface."""
    if not isinstance(key, str):
        raise ArgumentTypeError(f"{ref('heightfield')} must have names of parts as keys, got {type(key).__name__}")
    if isinstance(value, (HeightField, GratingMap)):
        return Surface(value)
    if value is None or isinstance(value, Surface):
        return value
    raise ArgumentTypeError(
        f"{ref(f'heightfield[{key!r}]')} must be a HeightField, a GratingMap, a Surface or None, got "
        f"{type(value).__name__}"
    )


def _settings_of(surface: Surface, key: str, settings: PictureSettings) -> PictureSettings:
    """Return the options of the picture, in which the options of a surface replace those of the same name."""
    material = settings.material.get(key) if isinstance(settings.material, Mapping) else settings.material
    plan = settings.plan.get(key) if isinstance(settings.plan, Mapping) else settings.plan
    ior = settings.ior
    if surface.material is not None or surface.ior is not None:
        material, ior = surface.material, surface.ior
    return replace(
        settings, material=material, ior=ior, plan=plan,
        coherence=surface.coherence or (settings.coherence if plan is None else plan.coherence),
        pigment=settings.pigment if surface.pigment is None else surface.pigment,
    )  # fmt: skip


def _mean_solid_angle(coherence: Coherence, heightfield: HeightField) -> float:
    """Return the solid angle Ω(λ) of a light with a certain coherence [sr], as a mean over λ weighted by D65 · ȳ."""
    area_um2 = heightfield.size_um[0] * heightfield.size_um[1]
    wavelengths_um = 1e-3 * colorimetry.VISIBLE_NM
    solid_angle = reflectance_factors.light_solid_angle(wavelengths_um, coherence, area_um2)
    return float(solid_angle @ colorimetry.colour_products("D65")[:, 1])


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
