"""Pass of the lobes of directional, disc and point lights: shadow rays, scattering vectors and look-ups.

A lobe is a Gaussian of directions or a single direction. An occluder grid lists the faces that may block light from one
direction. Shadow rays without a grid use the hierarchy of the faces' bounding boxes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core.wording import ArgumentValueError
from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import light_samples, plain_reflection
from warpdiff.kernels.shadow_rays import trace_shadow_rays
from warpdiff.kernels.transparency import trace_shadow_rays_through
from warpdiff.lights.light_pass import LightPass

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from numpy.typing import NDArray

    from warpdiff.kernels.shadow_rays import ShadowGrid
    from warpdiff.lights.base import Lobe, LobeSet
    from warpdiff.lights.light_pass import Counting, PassContext, RayBatch
    from warpdiff.tables.lookup import Lookups

# Largest ratio of a point light's power to the square of the radius of the mesh. The value is limited by float32:
# colours increase near the light, and the squares of colours must remain below the largest float32.
_MOST_NEARBY = 1e9


class LobePass(LightPass):
    """Pass of a light's lobes (Gaussians of directions), which are processed one after the other.

    Attributes:
        part: Set of lobes that this pass samples.
    """

    def __init__(self, part: LobeSet, context: PassContext) -> None:
        super().__init__(context, [[lobe.illuminant] for lobe in part.lobes])
        self.part = part
        self.has_directions = self.is_sampled or any(lobe.profile is not None for lobe in part.lobes)
        self._sources = [self._source(lobe) for lobe in part.lobes]
        self._grids: list[ShadowGrid] = []
        self._no_directions = wp.empty(0, dtype=wp.vec4f, device=context.device)

    def begin(self, previous: LightPass | None) -> None:
        """Write the light's lobes into arrays. Arrays of the previous pass are reused for the same number of lobes.

        A lobe is a Gaussian of directions. An occluder grid lists the faces that may block light from one direction.
        The grids of the previous pass are reused only if the directions of its lobes are the same, too.
        """
        lobes, context = self.part.lobes, self.context
        reused = previous if isinstance(previous, LobePass) and len(previous.part.lobes) == len(lobes) else None
        if reused is not None and not any(grid.mesh_id for grid in reused._grids):
            self._grids = reused._grids if self._grid_key == reused._grid_key else []
        self._lights = self._lights if reused is None else reused._lights
        places, deviations, powers = zip(*self._sources, strict=True)
        whites = [context.pigment_white(lobe.illuminant, is_of_sky=lobe.is_of_sky) for lobe in lobes]
        values: dict[str, tuple[type, list[Any]]] = {
            "places": (wp.vec4d, list(places)), "deviations": (wp.vec3f, list(deviations)),
            "strengths": (wp.float64, list(powers)),
            "white_rgb": (wp.vec3d, whites),
        }  # fmt: skip
        for name, (dtype, value) in values.items():
            if reused is None:
                setattr(self._lights, name, wp.array(np.array(value), dtype=dtype, device=context.device))
            else:
                getattr(self._lights, name).assign(np.array(value))

    @property
    def _grid_key(self) -> tuple[Hashable, ...]:
        """Values on which the occluder grids depend. A grid lists the faces that may block light from one direction.

        A disc light has no grid. A lobe (Gaussian of directions) with a position or an emission profile has an empty
        grid, even if its direction is that of another lobe.
        """
        lobes = self.part.lobes
        return type(self), *((lobe.to_light, lobe.position is None, lobe.profile is None) for lobe in lobes)

    def _source(self, lobe: Lobe) -> tuple[tuple[float, ...], NDArray[np.float64], float]:
        """Return position or direction, standard deviations and power of a light's lobe, in coordinates of the mesh.

        The first result has four homogeneous coordinates: a direction and 0, or a position and 1. For a position, the
        power is that at a distance of one mesh radius; users specify the power at a distance of one mesh unit.
        """
        deviations = np.zeros((2, 3)) if lobe.deviations is None else lobe.deviations
        if lobe.position is None:
            return (*lobe.to_light, 0.0), deviations, lobe.power
        centre, radius = self.context.rays.surface.centre, self.context.rays.surface.radius
        power = lobe.power * radius**-2.0
        if power > _MOST_NEARBY:
            raise ArgumentValueError(
                f"{lobe.name} has a power of {lobe.power:g} at one position, and must have at most {_MOST_NEARBY:g} "
                f"times the square of the mesh's radius, {radius:g}; give less power"
            )
        return (*((np.asarray(lobe.position) - centre) / radius), 1.0), deviations / radius, power

    @property
    def white_luminance(self) -> float:
        """Luminance of a white matte surface that faces the brightest lobe of the light.

        For a light at a position, the luminance is that at the centre of the mesh.
        """
        return max(
            power * float(self.context.white_xyz(lobe.illuminant, is_of_sky=lobe.is_of_sky)[1])
            / (float(np.dot(place[:3], place[:3])) + 1e-8 if place[3] else 1.0)
            for (place, _, power), lobe in zip(self._sources, self.part.lobes, strict=True)
        )  # fmt: skip

    @property
    def graph_key(self) -> tuple[Hashable, ...]:
        """Values on which kernel launches depend: illuminants, profiles, and which lobes have an extent or a position.

        These values are a part of the key of a recorded CUDA graph.
        """
        kinds = tuple((lobe.deviations is None, lobe.position is None, lobe.profile) for lobe in self.part.lobes)
        return type(self), self.part.spectra, kinds

    @property
    def is_prepared(self) -> bool:
        """Whether the occluder grids of all lobes of the light exist (some may be empty), for shadow rays."""
        return len(self._grids) == len(self.part.lobes)

    def prepare_shadow_rays(self, count: Callable[[], int]) -> None:
        """Prepare one occluder grid (list of faces that may block light) per lobe (Gaussian of directions).

        The grids of point lights and of lobes with an emission profile are empty, because a grid serves only one
        direction. Shadow rays to such lobes use the hierarchy of bounding boxes.
        """
        rays = self.context.rays
        to_lights = [
            lobe.to_light if lobe.position is None and lobe.profile is None else None for lobe in self.part.lobes
        ]
        # The previous occluder grids are deleted before new ones are made, because the memory may not suffice for the
        # previous and the new grids together.
        self._grids.clear()
        self._grids += rays.shadow_grids(to_lights, count)

    def scatter(self, lobe: int, batch: RayBatch, counting: Counting) -> list[KernelCall]:
        """Return the kernel calls that compute occlusion, scattering vectors and geometry factors of a lobe."""
        profile = self.part.lobes[lobe].profile
        if profile is None:
            return self.scatter_towards(self._no_directions, lobe, 1.0, batch, counting)
        emit = profile.kernel_call(self._lights, lobe, batch)
        return [emit, *self.scatter_towards(batch.samples.towards, lobe, 1.0, batch, counting)]

    def scatter_towards(
        self, towards: wp.array, light: int, share: float, batch: RayBatch, counting: Counting, lobe: int | None = None
    ) -> list[KernelCall]:
        """Return the kernel calls that compute occlusion, scattering vectors and geometry factors of a lobe.

        They also add the light that surfaces without a height field reflect.

        Args:
            towards: Direction to the light for each ray; if it is empty, all rays use the direction of the light.
            light: Index of the light in the struct ``Lights``.
            share: Factor by which the lobe's colours are multiplied.
            batch: The rays.
            counting: Rule by which samples are added.
            lobe: Index of the lobe for which the footprints of the rays were computed; None is the lobe of the light.
        """
        samples, pixels = batch.samples, batch.gbuffer.pixels
        occluded = self.occlusion(samples)
        inputs = [
            pixels, self._lights, light, towards, self.context.reflection, share * counting.weight, counting.counted,
            counting.begins, counting.resets, occluded,
        ]  # fmt: skip
        outputs = [*samples.directions, *batch.sums]
        calls = []
        if len(occluded):
            scene, light_inputs = self.context.rays.scene, [self._lights.places, light, towards, pixels]
            kernel, of_mesh = trace_shadow_rays, [self._grids[light]]
            if not scene.is_opaque:
                kernel, of_mesh = trace_shadow_rays_through, [scene.bare, scene.textures, scene.transparency]
            calls.append(KernelCall(kernel, [*of_mesh, *light_inputs], [occluded], in_runs=True))
        calls.append(KernelCall(light_samples.scattering_vectors, inputs, outputs, in_runs=True))
        if len(self.context.reflection.energy):
            inputs = [pixels, samples.scattering_vectors, samples.to_lights, self.context.reflection]
            calls.append(KernelCall(light_samples.balance_energy, inputs, [samples.gains], in_runs=True))
        plain = self.context.plain
        if plain is not None and plain.has_glossy_faces:
            if len(samples.footprints):
                calls += self.footprint_calls(light if lobe is None else lobe, batch)
            inputs = [
                pixels, self._lights, light, towards, share * counting.weight, plain.struct, samples.footprints,
                *samples.directions,
            ]  # fmt: skip
            calls.append(KernelCall(plain_reflection.add_plain_reflection, inputs, [batch.xyz], in_runs=True))
        return calls

    def footprint_calls(self, lobe: int, batch: RayBatch) -> list[KernelCall]:
        """Return kernel calls that compute footprints (changes of the scattering vector (u, v) within a pixel).

        They include the pixel filter and the extent of the light. For a point light, they also include the change of
        the direction to the light.
        """
        rays, pixels, source = self.context.rays, batch.gbuffer.pixels, self.part.lobes[lobe]
        kernels: list[tuple[wp.Kernel, list[Any]]] = []
        if source.position is not None:
            inputs = [rays.camera, rays.scene.bare, pixels, self._lights, lobe, batch.deviation]
            kernels.append((light_samples.add_light_rotation, inputs))
        if source.deviations is not None and source.position is not None:
            kernels.append((light_samples.add_source_extent, [self._lights, lobe, pixels]))
        elif source.deviations is not None:
            kernels.append((light_samples.add_light_extent, [self._lights, lobe, self._no_directions, 0.0, pixels]))
        widen = [KernelCall(kernel, inputs, [batch.samples.footprints], in_runs=True) for kernel, inputs in kernels]
        return [self.filter_footprints(batch), *widen]

    def colour(self, lobe: int, batch: RayBatch, lookups: Lookups) -> list[KernelCall]:
        """Return the kernel calls that look up the colours under a lobe of the light, for each surface and material."""
        calls, footprints = [], None
        if lookups.uses_footprints:
            calls, footprints = self.footprint_calls(lobe, batch), batch.samples.footprints
        return [*calls, *self.look_up(lobe, [batch.samples.gains], footprints, batch, lookups)]
