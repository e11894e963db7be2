"""Pass of lobes: shadow rays, scattering vectors, footprints and look-ups for directional, disc and point lights."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.core.wording import ArgumentValueError
from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import light_samples
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

# Largest ratio of a point light's power to the square of the mesh's radius. Limit: colours increase near the light, and
# their squares must remain below the largest float32.
_MOST_NEARBY = 1e9


class LobePass(LightPass):
    """Pass of lobes, which are processed one after the other.

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
        """Write the lobes into arrays. Arrays of the previous pass are reused if it had equally many lobes.

        Its occluder grids are reused if the directions are the same, too.
        """
        lobes, context = self.part.lobes, self.context
        reused = previous if isinstance(previous, LobePass) and len(previous.part.lobes) == len(lobes) else None
        if reused is not None and not any(grid.mesh_id for grid in reused._grids):
            before = [lobe.to_light for lobe in reused.part.lobes]
            self._grids = reused._grids if before == [lobe.to_light for lobe in lobes] else []
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

    def _source(self, lobe: Lobe) -> tuple[tuple[float, ...], NDArray[np.float64], float]:
        """Return the place, the deviations and the power of a lobe in mesh coordinates.

        The place is homogeneous: a direction and 0, or a position and 1. The power of a position is that at a distance
        of one mesh radius; users specify it at one mesh unit.
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
    def graph_key(self) -> tuple[Hashable, ...]:
        """Values on which the launches depend: illuminants, profiles, and which lobes have an extent or a position.

        They are a part of the key of a recorded CUDA graph.
        """
        kinds = tuple((lobe.deviations is None, lobe.position is None, lobe.profile) for lobe in self.part.lobes)
        return type(self), self.part.spectra, kinds

    @property
    def is_prepared(self) -> bool:
        """Whether the occluder grids of all lobes have been prepared. Before that, no shadow ray can be traced."""
        return len(self._grids) == len(self.part.lobes)

    def prepare_shadow_rays(self, count: Callable[[], int]) -> None:
        """Prepare one occluder grid per lobe.

        The grids of point lights and of lobes with an emission profile are empty, because a grid serves only one
        direction; their shadow rays use the hierarchy.
        """
        rays = self.context.rays
        to_lights = [
            lobe.to_light if lobe.position is None and lobe.profile is None else None for lobe in self.part.lobes
        ]
        # The previous grids are deleted before new ones are made, because the memory may not suffice for both.
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
        self, towards: wp.array, lobe: int, share: float, batch: RayBatch, counting: Counting
    ) -> list[KernelCall]:
        """Return the kernel calls that compute occlusion, scattering vectors and geometry factors of a lobe.

        ``share`` is the weight of the lobe's colours. ``towards`` has a direction to the light for each ray; if it is
        empty, all rays use the direction of the lobe.
        """
        samples, pixels = batch.samples, batch.gbuffer.pixels
        occluded = self.occlusion(samples)
        inputs = [
            pixels, self._lights, lobe, towards, self.context.reflection, share * counting.weight, counting.counted,
            counting.begins, counting.resets, occluded,
        ]  # fmt: skip
        outputs = [*samples.directions, *batch.sums]
        calls = []
        if len(occluded):
            scene, light_inputs = self.context.rays.scene, [self._lights.places, lobe, towards, pixels]
            kernel, of_mesh = trace_shadow_rays, [self._grids[lobe]]
            if not scene.is_opaque:
                kernel, of_mesh = trace_shadow_rays_through, [scene.bare, scene.textures, scene.transparency]
            calls.append(KernelCall(kernel, [*of_mesh, *light_inputs], [occluded], in_runs=True))
        calls.append(KernelCall(light_samples.scattering_vectors, inputs, outputs, in_runs=True))
        if len(self.context.reflection.energy):
            inputs = [pixels, samples.scattering_vectors, samples.to_lights, self.context.reflection]
            calls.append(KernelCall(light_samples.balance_energy, inputs, [samples.gains], in_runs=True))
        return calls

    def footprint_calls(self, lobe: int, batch: RayBatch) -> list[KernelCall]:
        """Return kernel calls that compute footprints: the pixel filter's, widened by the extent of the light.

        For a point light, the direction to the light also changes across a footprint.
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
        """Return the kernel calls that look up the colours of a lobe, separately for the faces of each finish."""
        calls, footprints = [], None
        if lookups.uses_footprints:
            calls, footprints = self.footprint_calls(lobe, batch), batch.samples.footprints
        return [*calls, *self.look_up(lobe, [batch.samples.gains], footprints, batch, lookups)]
