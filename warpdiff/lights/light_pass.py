"""Passes of lights: each pass samples one part of a light at the hits of rays, and looks up its colours.

The hits are in ``scene.gbuffer``. This module defines :class:`LightSamples`, the samples of one lobe, and
:class:`RayBatch`, which contains rays and the sums to which their colours are added. A lobe is a Gaussian of
directions, or a single direction. A plain surface has no height field. A plan holds the numbers of a computation, such
as wavelengths. (u, v, w) is the scattering vector, and R(0) the reflectance at normal incidence. A geometry factor, or
gain, multiplies the looked-up colour: it contains the cosines, the masking, the reflectance relative to R(0), and the
power of the light.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import light_samples
from warpdiff.kernels.refinement_levels import rays_at
from warpdiff.kernels.structs import Footprint
from warpdiff.lights.grating_dots import MOST_DOTS, DotSamples, GratingDots, LookupSamples, material_of_dots
from warpdiff.lights.plain_materials import plain_faces
from warpdiff.lights.surface_optics import Finish, PictureUnit
from warpdiff.optics import colorimetry, reflectance_factors
from warpdiff.optics.materials import IlluminatedMaterial, transmittances

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from numpy.typing import NDArray

    from warpdiff.lights.plain_materials import PlainFaces
    from warpdiff.lights.surface_optics import SurfaceOptics
    from warpdiff.optics.spectra import Spectrum
    from warpdiff.scene.camera_rays import CameraRays
    from warpdiff.scene.gbuffer import GBuffer
    from warpdiff.tables.lookup import ColourLookup, Lookups


class PassContext:
    """Context that all passes of a picture share: its rays, the optics of its surfaces, and structs for the kernels.

    Attributes:
        rays: Camera rays, on whose hits the light is sampled.
        surfaces: Optics of the surfaces, without the diffraction of their height fields. If there are glossy faces
            (plain faces with a roughness), the last entry is for all of them. Kernels of ``kernels.plain_reflection``
            compute their light.
        plain: Materials of plain surfaces; None if all are matte and emit no light.
        finishes: Finishes of the picture; a finish is a surface with one of its materials.
        is_pigmented: Whether the mesh has base colours and the pigment is visible.
        has_maps: Whether textures have metallic, roughness or emission of plain faces.
        is_textured: Whether colours depend on any texture.
        no_colours: An empty array of colours.
        finish_of_faces: Index of each face's finish on the device; empty for a single finish.
        refines: Whether pixels with large errors are subdivided.
        dots: Dots of the surfaces with a grating map; None without any.
        reflection: The struct ``Reflection``, from which kernels compute reflectance, masking and the light of the
            pigment.
    """

    def __init__(
        self, rays: CameraRays, surfaces: Sequence[SurfaceOptics], unit: PictureUnit | None,
        finish_of_faces: NDArray[np.int32] | None, *, refines: bool,
    ) -> None:  # fmt: skip
        """Fill the structs that kernels read.

        ``finish_of_faces`` is None if all faces have the same finish (surface and material). If ``unit`` is None,
        colours are relative to a perfect mirror under the coherence of the first surface.
        """
        self._device = rays.options["device"]
        self.rays, self.surfaces, self.refines = rays, tuple(surfaces), refines
        self._unit = unit or PictureUnit(surfaces[0].coherence, surfaces[0].area_um2)
        self.finishes = [
            Finish(index, material, material_of_dots(material, optics.grating_map))
            for index, optics in enumerate(surfaces)
            for material in optics.materials
        ]
        self.plain = self._plain_faces(finish_of_faces)
        if finish_of_faces is not None and self.plain is not None and self.plain.has_glossy_faces:
            # All glossy faces of plain surfaces get one more finish, a pair of surface and material. Its surface has
            # neither a pigment nor a height field.
            plain = next(optics for optics in surfaces if optics.is_plain)
            self.surfaces += (replace(plain, pigment=0.0),)
            self.finishes.append(Finish(len(surfaces), None))
            finish_of_faces = np.where(self.plain.is_glossy, len(self.finishes) - 1, finish_of_faces).astype(np.int32)
        self.is_pigmented = rays.surface.has_base_colour and any(optics.pigment > 0.0 for optics in surfaces)
        self.has_maps = self.plain is not None and rays.surface.has_maps
        self.is_textured = self.has_maps or (self.is_pigmented and rays.surface.is_textured)
        self.no_colours = wp.empty(0, dtype=wp.vec3f, device=self._device)
        by_face = np.zeros(0, dtype=np.int32) if finish_of_faces is None else finish_of_faces
        self.finish_of_faces = self._array(by_face, wp.int32)
        self.dots = GratingDots.of(
            [optics.grating_map for optics in surfaces],
            np.array([finish.surface for finish in self.finishes], dtype=np.int32)[by_face], rays,
        )  # fmt: skip
        self.reflection = self._reflection()

    def _array(self, values: Any, dtype: Any) -> wp.array:
        return wp.array(np.asarray(values), dtype=dtype, device=self._device)

    def _plain_faces(self, finish_of_faces: NDArray[np.int32] | None) -> PlainFaces | None:
        """Return the materials of surfaces without a height field; None if all are matte and emit no light."""
        is_plain = np.array([self.surfaces[finish.surface].is_plain for finish in self.finishes])
        if finish_of_faces is None or not is_plain.any():
            return None
        white = float(self.white_xyz("D65", is_of_sky=False)[1])
        return plain_faces(self.rays.surface, is_plain[finish_of_faces], white, self._device)

    def _reflection(self) -> light_samples.Reflection:
        """Return the struct ``Reflection`` of the kernels, with one array entry for each material on each surface."""
        optics = [self.surfaces[finish.surface] for finish in self.finishes]
        reflection = light_samples.Reflection()
        reflection.finishes = self.finish_of_faces
        reflection.surfaces = self._array([finish.surface for finish in self.finishes], wp.int32)
        reflection.normal_reflectances = self._array([surface.normal_reflectance for surface in optics], wp.float64)
        reflection.units = self._array([surface.unit or 1.0 for surface in optics], wp.float64)
        # If ``surface.unit`` is None, the colours of the picture are relative to the reflectance R(0) of its surface at
        # normal incidence. The light of the pigment is then divided by R(0), too.
        units = [surface.unit or surface.normal_reflectance for surface in optics]
        pigments = [surface.pigment / unit for surface, unit in zip(optics, units, strict=True)]
        reflection.pigments = self._array(pigments if self.is_pigmented else [], wp.float64)
        reflection.per_light_cosine = self._array([surface.coherence.kind == "source" for surface in optics], wp.bool)
        reflection.masking = self.surfaces[0].masking
        through = np.zeros((0, 0, 3), dtype=np.float32)
        if self.is_pigmented:
            tables = [
                np.ones_like(table) if surface.is_plain else table
                for surface, finish in zip(optics, self.finishes, strict=True)
                for table in [transmittances(surface.normal_reflectance, finish.material)]
            ]
            through = np.asarray(tables, dtype=np.float32)
        reflection.transmittances = wp.empty(through.shape[:2], dtype=wp.vec3f, device=self._device)
        reflection.transmittances.assign(through)
        energy = np.zeros((0, 0, 0), dtype=np.float32)
        if self.surfaces[0].energy is not None:
            energy = np.stack([np.asarray(surface.energy) for surface in self.surfaces])
        reflection.energy = self._array(energy, wp.float32)
        return reflection

    @property
    def device(self) -> wp.Device:
        """Warp device of the rays."""
        return self._device

    @property
    def has_finishes(self) -> bool:
        """Whether faces have different finishes; a finish is a surface with one of its materials."""
        return len(self.finish_of_faces) > 0

    @property
    def casts_shadows(self) -> bool:
        """Whether shadow rays are required: the mesh may occlude a light from a point that is visible in this view."""
        return self.surfaces[0].shadows and self.rays.may_be_occluded

    def finishes_of_hits(self) -> NDArray[np.int32] | None:
        """Return the index of the finish (surface and material) at the hit of each ray; None for a single finish.

        The index of a ray without a hit has no meaning.
        """
        if not self.has_finishes:
            return None
        faces = self.rays.gbuffer.pixels.face.numpy()
        return np.asarray(self.finish_of_faces.numpy()[np.maximum(faces, 0)])

    def gains_on(self, surface: int, gains: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the geometry factors of all rays (factors of their colours), with 0 for hits on other surfaces."""
        finishes = self.finishes_of_hits()
        if finishes is None or len(self.surfaces) == 1:
            return gains
        surfaces = np.array([finish.surface for finish in self.finishes])
        return np.where(surfaces[finishes] == surface, gains, np.float32(0.0))

    def pigment_white(self, illuminant: str | Spectrum, *, is_of_sky: bool) -> NDArray[np.float64]:
        """Return the linear sRGB of a white pigment (base colour), relative to the mirror that is the unit of colours.

        ``is_of_sky`` states whether ``illuminant`` is the spectral radiance of a sky divided by λ².
        """
        return colorimetry.xyz_to_rgb(self.white_xyz(illuminant, is_of_sky=is_of_sky))

    def white_xyz(self, illuminant: str | Spectrum, *, is_of_sky: bool) -> NDArray[np.float64]:
        """Return the XYZ of a white pigment (base colour), relative to the mirror that defines the picture's unit."""
        return reflectance_factors.pigment_white(illuminant, *self._unit, is_of_sky=is_of_sky)


@dataclass(frozen=True)
class LightSamples:
    """Arrays for one lobe of a light at n hits of rays. The next lobe overwrites the values.

    A lobe is a Gaussian of directions, or a single direction. If a light's directions are drawn at random, a lobe
    stands for one direction that each ray draws.

    Attributes:
        occluded: Whether the mesh occludes the lobe at each hit, (n,).
        scattering_vectors: Scattering vectors (u, v, w), (n,) of ``wp.vec3d``.
        to_lights: Directions to the light in the local frame, (n,) of ``wp.vec3f``.
        gains: Geometry factors, (n,); 0 where no light arrives. For a sky, they are 1 at hits.
        spectral_gains: Geometry factors times the sky's radiance by spectrum, (3, n); the shape is (0, 0) unless each
            ray has its own direction to the light.
        towards: Direction to the light of each ray, world frame, and its weight, (n,) of ``wp.vec4f``. The array is
            empty unless directions are drawn at random or a light has an emission profile.
        footprints: Changes of (u, v) over the filter of each ray, (n,); empty if pixels show points.
        finish_gains: Geometry factors at faces with the finish (surface and material) that is evaluated, and 0 at other
            faces, (n,); empty for a single finish.
        of_dots: Samples in the frames of dots; None without a grating map.
    """

    occluded: wp.array
    scattering_vectors: wp.array
    to_lights: wp.array
    gains: wp.array
    spectral_gains: wp.array
    towards: wp.array
    footprints: wp.array
    finish_gains: wp.array
    of_dots: DotSamples | None = None

    @classmethod
    def allocate(
        cls, rays: int, *, means: bool, has_finishes: bool, has_directions: bool, has_dots: bool, device: wp.Device
    ) -> LightSamples:
        """Return uninitialised arrays for a number of rays. If ``means`` is False, the array of footprints is empty."""

        def empty(dtype: type, size: int = rays) -> wp.array:
            return wp.empty(size, dtype=dtype, device=device)

        return cls(
            empty(wp.bool), empty(wp.vec3d), empty(wp.vec3f), empty(wp.float32),
            wp.empty((3 * has_directions, rays * has_directions), dtype=wp.float32, device=device),
            empty(wp.vec4f, rays * has_directions),
            empty(Footprint, rays * means), empty(wp.float32, rays * has_finishes),
            DotSamples.allocate(rays, means=means, device=device) if has_dots else None,
        )  # fmt: skip

    @property
    def signals(self) -> wp.array:
        """Vectors of the rays. Where they change unevenly from pixel to pixel, refinement expects that colours do, too.

        They are the scattering vectors. With a grating map, a number that differs from dot to dot is added.
        """
        return self.scattering_vectors if self.of_dots is None else self.of_dots.scattering_vectors

    @property
    def directions(self) -> list[wp.array]:
        """The arrays of scattering vectors, of directions to the light and of geometry factors."""
        return [self.scattering_vectors, self.to_lights, self.gains]


@dataclass(frozen=True)
class RayBatch:
    """Batch of n rays that are shaded together, with the sums to which their colours are added.

    Attributes:
        gbuffer: Hits of the rays.
        samples: Samples of one lobe of a light at the hits; the samples of the next lobe overwrite them.
        xyz: Sums of colours, (n,).
        coverage: Sums of hits, (n,); an empty array is not written.
        illuminated: Whether light reached the ray's hit, (n,); an empty array is not written.
        unserved_gain: Geometry factors of directions that the colour table does not contain, (n,). Their colours are
            summed over wavelengths instead. Empty if the table contains all directions.
        tiles: Indices of the pixels whose subpixel cells are the rays; −1 is no pixel. If empty, there is one ray for
            each pixel of the picture.
        level: Level of the cells; 0 is one ray per pixel.
        deviation: Standard deviation of the filter of a ray [pixels]; 0 without footprints.
    """

    gbuffer: GBuffer
    samples: LightSamples
    xyz: wp.array
    coverage: wp.array
    illuminated: wp.array
    unserved_gain: wp.array
    tiles: wp.array
    level: int
    deviation: float

    @property
    def sums(self) -> list[wp.array]:
        """The arrays to which the values of a ray are added: colours, number of hits, and marks of illuminated rays."""
        return [self.xyz, self.coverage, self.illuminated]


@dataclass(frozen=True)
class Counting:
    """Rule by which the samples of a light's lobe (direction) are added to the sums of a batch of rays.

    Attributes:
        weight: Weight of the lobe's colours in the sum of colours.
        counted: Weight of a hit in the sum of coverage; 0 if the same hits were added for an earlier lobe.
        begins: Whether all sums are set to zero before this lobe is added.
        resets: Whether the sum of colours is set to zero before this lobe is added.
    """

    weight: float = 1.0
    counted: float = 0.0
    begins: bool = False
    resets: bool = False


class LightPass(ABC):
    """Base class of passes: a pass adds the light of one part of a light to the colours of a picture's rays.

    Passes are made before the plan (the numbers of the computation), which is chosen for the directions of their lobes.

    Attributes:
        is_sampled: Whether directions to the light are drawn at random, so that colours have noise.
        has_directions: Whether each ray has its own direction or weight, for random directions or emission profiles.
        first_level: Level of the first subdivision of pixels; level n has 2ⁿ × 2ⁿ cells. It is higher for random
            directions, because four cells are too few to estimate noise.
        context: Context that all passes of the picture share.
        lobe_count: Number of lobes (Gaussians of directions), which are processed one after the other; for sampled
            lights, number of directions per pixel in a picture whose pixels are not subdivided.
        illuminated: Illuminants with materials (``IlluminatedMaterial``) by lobe, finish and spectrum.
    """

    is_sampled = has_directions = False
    first_level = 1

    def __init__(self, context: PassContext, spectra_of_lobes: Sequence[Sequence[str | Spectrum]]) -> None:
        self.context, self.lobe_count = context, len(spectra_of_lobes)
        self.illuminated = [
            tuple(
                tuple(IlluminatedMaterial(spectrum, finish.looked_up) for spectrum in spectra)
                for finish in context.finishes
            )
            for spectra in spectra_of_lobes
        ]
        self._no_occlusion = wp.empty(0, dtype=wp.bool, device=context.device)
        self._lights = light_samples.Lights()
        self._lights.rgb_to_xyz = wp.mat33d(*colorimetry.RGB_TO_XYZ.ravel())

    def of_surface(self, surface: int) -> tuple[tuple[IlluminatedMaterial, ...], ...]:
        """Return the illuminants of the light's first lobe with a surface's materials, by material and spectrum."""
        return tuple(
            spectra
            for finish, spectra in zip(self.context.finishes, self.illuminated[0], strict=True)
            if finish.surface == surface
        )

    @property
    def first_lobes(self) -> range:
        """Lobes (Gaussians of directions) that are evaluated with one ray per pixel, before pixels are subdivided."""
        return range(self.lobe_count)

    @property
    def measured_lobes(self) -> range:
        """Lobes of the light whose directions are measured, before a plan (numbers of the computation) is chosen."""
        return range(self.lobe_count)

    def cell_lobes(self, level: int) -> range:
        """Return the light's lobes, or indices of random directions, that are evaluated for subpixel cells of a level.

        Some lights are sampled in random directions. In a refined picture, each cell then draws one direction. In a
        picture without refinement, the cells of a pixel share its directions.
        """
        if not self.is_sampled:
            return range(self.lobe_count)
        return range(1 if self.context.refines else -(-self.lobe_count // rays_at(level)))

    @property
    @abstractmethod
    def graph_key(self) -> tuple[Hashable, ...]:
        """Values on which kernel launches of this pass depend, as a part of the key of a recorded CUDA graph.

        A replayed launch uses the scalar arguments of the recording. A scalar that may differ in the next picture must
        therefore be in this key, or in an array that :meth:`begin` fills.
        """

    @abstractmethod
    def begin(self, previous: LightPass | None) -> None:
        """Fill the arrays of this pass, and reuse arrays of the previous pass that have the same size.

        A recorded CUDA graph reads the arrays that existed when it was recorded, and therefore requires this reuse.

        Args:
            previous: The pass of the same part of the light in the previous picture; None if there is none.
        """

    @property
    def is_prepared(self) -> bool:
        """Whether shadow rays can be traced now: occluder grids (lists of faces) exist, or the pass uses none."""
        return True

    def prepare_shadow_rays(self, count: Callable[[], int]) -> None:  # noqa: B027 (nothing is the usual case)
        """Make the occluder grids (lists of the faces that may block a light), which save time for many shadow rays.

        ``count()`` returns the number of shadow rays to each lobe. It reads the number of hits from the device, which
        is slow, and is called only where grids are possible.
        """

    @property
    def white_luminance(self) -> float:
        """Luminance of a white matte surface that faces the brightest lobe (Gaussian of directions) of the light."""
        return 0.0

    @abstractmethod
    def scatter(self, lobe: int, batch: RayBatch, counting: Counting) -> list[KernelCall]:
        """Return the kernel calls that sample a light's lobe at a batch of hits, and add the light of the pigment."""

    @abstractmethod
    def colour(self, lobe: int, batch: RayBatch, lookups: Lookups) -> list[KernelCall]:
        """Return the kernel calls that look up colours at the samples of a batch of rays, and add them to its sums."""

    def look_up(
        self, lobe: int, gains: Sequence[wp.array], footprints: wp.array | None, batch: RayBatch, lookups: Lookups,
        surface: int | None = None,
    ) -> list[KernelCall]:  # fmt: skip
        """Return the kernel calls that look up the colours under a lobe of the light, and add them to the batch's sums.

        Args:
            lobe: Index of the lobe.
            gains: Geometry factors for each spectrum of the lobe.
            footprints: Footprints of the rays; None for pixels that show points.
            batch: The rays and their sums.
            lookups: Look-ups of the surfaces.
            surface: The only surface whose colours are added; None stands for all surfaces.
        """
        samples, context = batch.samples, self.context
        dots, of_dots = context.dots, samples.of_dots
        calls: list[KernelCall] = []
        of_rays = LookupSamples(samples.scattering_vectors, samples.to_lights, footprints)
        for index, finish in enumerate(context.finishes):
            lookup = lookups[finish.surface] if finish.surface < len(lookups) else None
            if lookup is None or surface not in (None, finish.surface):
                continue
            if dots is None or of_dots is None or not dots.has_map(finish.surface):
                calls += self._look_up_finish(lobe, index, gains, of_rays, batch, lookup)
                continue
            calls.append(dots.find(finish.surface, batch.gbuffer, of_dots, batch.level))
            # A subpixel cell may overlap up to four dots of a grating map. The colour of each dot is looked up, and
            # multiplied by the share of the subpixel cell in the dot.
            for part in range(MOST_DOTS if batch.level else 1):
                own, transform = dots.transform(finish.surface, batch.gbuffer, of_rays, of_dots, part)
                calls += [transform, *self._look_up_finish(lobe, index, gains, own, batch, lookup, part)]
        if dots is not None and of_dots is not None and context.refines and batch.level == 0:
            calls += dots.signal_calls(batch.gbuffer, samples.scattering_vectors, of_dots)
        return calls

    def _look_up_finish(
        self, lobe: int, index: int, gains: Sequence[wp.array], own: LookupSamples, batch: RayBatch,
        lookup: ColourLookup, part: int | None = None,
    ) -> list[KernelCall]:  # fmt: skip
        """Return the kernel calls that look up the colours of a finish (a surface with one of its materials).

        Args:
            lobe: Index of the lobe.
            index: Index of the finish.
            gains: Geometry factors for each spectrum of the lobe.
            own: Samples from which colours are looked up. On a grating map, they are in the frames of dots.
            batch: The rays and their sums.
            lookup: Look-up of the surface.
            part: Index of the dot among those that each subpixel cell overlaps, from 0 to 3; None without a grating
                map.
        """
        samples, context = batch.samples, self.context
        calls: list[KernelCall] = []
        for gain, illuminated in zip(gains, self.illuminated[lobe][index], strict=True):
            used = gain
            if context.has_finishes:
                inputs = [gain, batch.gbuffer.pixels.face, context.finish_of_faces, index]
                used = samples.finish_gains
                calls.append(KernelCall(light_samples.select_finish, inputs, [used], in_runs=True))
            if context.dots is not None and samples.of_dots is not None and part is not None:
                material = context.finishes[index].looked_up
                calls.append(
                    context.dots.scaled_gains(material, samples.scattering_vectors, used, samples.of_dots, part)
                )
                used = samples.of_dots.gains
            calls += lookup.kernel_calls(
                own.scattering_vectors, own.to_lights, used, illuminated, batch.xyz,
                own.footprints if lookup.plan.uses_footprints else None, batch.unserved_gain,
            )  # fmt: skip
        return calls

    def shade(self, batch: RayBatch, lookups: Lookups) -> list[KernelCall]:
        """Return the kernel calls that compute the colours of subpixel cells, added over all lobes of the light."""
        calls = []
        for lobe in self.cell_lobes(batch.level):
            calls += [*self.scatter(lobe, batch, Counting()), *self.colour(lobe, batch, lookups)]
        return calls

    def occlusion(self, samples: LightSamples) -> wp.array:
        """Return the array that marks hits where the mesh occludes the current lobe; empty if nothing casts shadows."""
        return samples.occluded if self.context.casts_shadows else self._no_occlusion

    def filter_footprints(self, batch: RayBatch) -> KernelCall:
        """Return the kernel call that computes the change of the scattering vector (u, v) over the filter of a ray."""
        rays, samples = self.context.rays, batch.samples
        inputs = [rays.camera, rays.scene.bare, batch.gbuffer.pixels, samples.scattering_vectors, batch.deviation]
        return KernelCall(light_samples.pixel_footprints, inputs, [samples.footprints], in_runs=True)
