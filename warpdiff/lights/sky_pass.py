"""Pass of a sky: sums over cells of the hemisphere, without shadow grids and without scattering vectors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import octahedral_maps, sky_sum
from warpdiff.lights import sky_cells
from warpdiff.lights.light_pass import LightPass
from warpdiff.lights.sky_maps import FIRST_BLUR, SIDES

if TYPE_CHECKING:
    from collections.abc import Hashable

    from warpdiff.lights.light_pass import Counting, PassContext, RayBatch
    from warpdiff.lights.sky_maps import SkyMaps
    from warpdiff.tables.lookup import ColourLookup


class SkyPass(LightPass):
    """Pass of a sky, whose maps the environment caches together with their arrays on devices.

    Attributes:
        maps: The maps.
    """

    def __init__(self, maps: SkyMaps, context: PassContext) -> None:
        super().__init__(context, [maps.spectra])
        self.maps = maps
        self._map: Any = None

    @property
    def graph_key(self) -> tuple[Hashable, ...]:
        """The maps, whose arrays the launches read."""
        return type(self), self.maps

    def begin(self, previous: LightPass | None) -> None:
        """Upload the maps, unless the environment or the pass before has their arrays."""
        context = self.context
        if isinstance(previous, SkyPass) and previous.maps is self.maps:
            self._lights, self._map = previous._lights, previous._map
            return
        # Kernels read the strength of the pigment from where that of lobes stands.
        self._lights.strengths = wp.array([(1.0, context.pigment_strength)], dtype=wp.vec2d, device=context.device)
        self._map = octahedral_maps.SkyMap()
        self._map.texels, self._map.sides, self._map.firsts = self.maps.device_arrays.get_or_make(
            context.device.alias, lambda: upload_maps(self.maps, context.device)
        )
        self._map.variance = FIRST_BLUR**2
        self._map.turn = wp.vec2f(math.cos(self.maps.turn), math.sin(self.maps.turn))
        whites = [context.pigment_white(spectrum) for spectrum in self.maps.spectra]
        self._map.whites = wp.mat33f(*np.ravel(whites))

    def scatter(self, lobe: int, batch: RayBatch, counting: Counting) -> list[KernelCall]:  # noqa: ARG002 (of lobes)
        """Return the calls that find the mirror directions of a batch."""
        inputs = [batch.gbuffer.pixels, counting.counted, counting.begins, counting.resets]
        outputs = [*batch.samples.directions, *batch.sums]
        return [KernelCall(sky_sum.mirror_directions, inputs, outputs, in_runs=True)]

    def colour(self, lobe: int, batch: RayBatch, lookup: ColourLookup) -> list[KernelCall]:
        """Return the calls that add the sky's colours over the footprints of a batch."""
        samples, directions = batch.samples, self.maps.directions
        occluded = self.occlusion(samples)
        mesh_id = self.context.rays.scene.with_hierarchy().mesh_id if len(occluded) else 0
        table = sky_cells.table_for(lookup, self.illuminated[lobe], directions)
        inputs = [
            self._map, table, batch.gbuffer.pixels, samples.gains, samples.footprints, self._lights, lobe,
            self.context.reflection, mesh_id, directions,
        ]  # fmt: skip
        outputs = [occluded, batch.sky_errors, batch.xyz]
        return [self.filter_footprints(batch), KernelCall(sky_sum.add_sky, inputs, outputs, in_runs=True)]

    def unevenness(self, batch: RayBatch) -> Any:
        """Return what differs between pixels: the mirror directions, and what the colours err by over footprints."""
        result = super().unevenness(batch)
        result.estimates = batch.sky_errors
        return result


def upload_maps(maps: SkyMaps, device: wp.Device) -> tuple[wp.array, wp.array, wp.array]:
    """Upload the texels of a sky's maps, their sides, and the index of each map's first texel."""
    firsts = np.cumsum([0, *((side + 2) ** 2 for side in SIDES[:-1])])
    return (
        wp.array(maps.texels, dtype=wp.vec4f, device=device),
        wp.array(SIDES, dtype=wp.int32, device=device),
        wp.array(firsts, dtype=wp.int32, device=device),
    )
