"""Look-up of colours by scattering vector on a device, in colour tables or by sums over wavelengths.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import warp as wp

from warpdiff.core.caching import LruCache
from warpdiff.device.kernel_calls import ELEMENTS_OF_SLICE, KernelCall, launch_pipeline
from warpdiff.kernels import colour_lookup
from warpdiff.kernels.structs import Footprint
from warpdiff.tables import coefficient_table, colour_table
from warpdiff.tables.footprint_weights import footprint_taps
from warpdiff.tables.spectrum_source import source_type

if TYPE_CHECKING:
    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.materials import IlluminatedMaterial
    from warpdiff.request.directions import DirectionRange
    from warpdiff.request.plan import Plan

# Number of multiply-add operations of one look-up for each function of w in a colour table; w is the normal component
# of the scattering vector. The number was derived as three colour channels times 3 × 3 spline coefficients.
MULTIPLY_ADDS_OF_FUNCTION = 27.0
# Number of tables that a `ColourLookup` caches for its callers, who compute them by look-ups. The colours under a sky
# are such a table. A cache of two tables suffices for two skies that alternate.
_MOST_DERIVED = 2
# Number of directions that a CPU thread looks up in one launch. The value was chosen so that the arrays of these
# directions fit into the cache of a core.
_LOOK_UPS_OF_SLICE = 2048


class Lookups(tuple["ColourLookup | None", ...]):
    """Colour look-ups of the surfaces of a picture: one per height field, None for a surface without a height field."""

    __slots__ = ()

    @property
    def uses_footprints(self) -> bool:
        """Whether the colours of any surface are means over the footprints of pixels."""
        return any(lookup is not None and lookup.plan.uses_footprints for lookup in self)

    @property
    def overwrites_gains(self) -> bool:
        """Whether the look-up of any surface overwrites an array of geometry factors, see `kernel_calls`."""
        return any(lookup is not None and lookup.overwrites_gains for lookup in self)

    @property
    def slice_size(self) -> int:
        """Number of directions that a CPU thread processes in one launch."""
        return max(lookup.slice_size for lookup in self if lookup is not None)


class ColourLookup:
    """Look-up of XYZ by scattering vector, with the kernels of a plan, and with its tables from the cache if possible.

    Attributes:
        heightfield: Height field whose colours are looked up.
        plan: Plan (the numbers of a computation) that determines the kernels and tables.
        device: Warp device on which the tables are and the kernels run.
        derived: Cache of tables that callers compute by this look-up. The callers choose the keys.
    """

    def __init__(
        self, heightfield: HeightField, plan: Plan, direction_range: DirectionRange, *, zeroth_order: bool = True,
        pitch_scales: bool = False, device: wp.Device, threads: int,
    ) -> None:  # fmt: skip
        """Prepare the look-up for a range of directions; tables are computed at the first use.

        ``pitch_scales`` states that the length of a direction to the light is a pitch scale: the factor by which the
        grating of a small area (dot) of a grating map is stretched. It is only for light sources of finite size
        (coherence of the kind "source").
        """
        self.heightfield, self.plan, self.device, self._threads = heightfield, plan, device, threads
        self._range, self._zeroth_order, self._pitch_scales = direction_range, zeroth_order, pitch_scales
        self._colours: dict[IlluminatedMaterial, colour_table.ColourTable] = {}
        self._quadratures: dict[IlluminatedMaterial, Any] = {}
        self.derived: LruCache[Any] = LruCache(most=_MOST_DERIVED)
        self._table: coefficient_table.Table | None = None
        self._no_footprints = wp.empty(0, dtype=Footprint, device=device)
        if plan.rings_per_octave:
            self._taps = footprint_taps(device.alias, source_type(plan.coherence).tap_rule)

    def accumulate(
        self, scattering_vectors: wp.array, to_lights: wp.array, gains: wp.array, illuminated: IlluminatedMaterial,
        xyz: wp.array, *, footprints: wp.array | None = None, among: range | None = None, **options: Any,
    ) -> None:  # fmt: skip
        """Add the XYZ of scattering vectors to the array ``xyz``.

        Args:
            scattering_vectors: Scattering vectors (u, v, w), shape (n,).
            to_lights: Directions to the light in the local frame, shape (n,).
            gains: Geometry factor (gain) by which the XYZ of each scattering vector is multiplied, shape (n,).
            illuminated: Illuminant, and the material of the surface.
            xyz: Array to which the XYZ are added, shape (n,).
            footprints: Footprint of the pixel around each scattering vector, shape (n,), for a plan with footprints.
            among: Range of the indices of the directions to evaluate; its start is a multiple of ``BATCH``, the
                number of directions that the kernels process together. None is all directions.
            options: Options ``slice_size`` and ``progress`` of ``launch_pipeline``.
        """
        options.setdefault("slice_size", self.slice_size)
        calls = self.kernel_calls(scattering_vectors, to_lights, gains, illuminated, xyz, footprints)
        launch_pipeline(
            calls, len(gains) if among is None else among, device=self.device, threads=self._threads, **options
        )

    def copy_with(self, plan: Plan) -> ColourLookup:
        """Return a look-up for the same range of directions by another plan (the numbers of a computation).

        The new look-up has its own colour tables.
        """
        return ColourLookup(
            self.heightfield, plan, self._range, zeroth_order=self._zeroth_order, pitch_scales=self._pitch_scales,
            device=self.device, threads=self._threads,
        )  # fmt: skip

    @property
    def slice_size(self) -> int:
        """Number of directions that a CPU thread processes in one launch."""
        return _LOOK_UPS_OF_SLICE if self.plan.rings_per_octave and not self.needs_sampling else ELEMENTS_OF_SLICE

    @property
    def needs_sampling(self) -> bool:
        """Whether the table excludes some directions, whose colours are then integrated over sampled wavelengths."""
        return bool(self.plan.rings_per_octave) and source_type(self.plan.coherence).has_lines

    @property
    def overwrites_gains(self) -> bool:
        """Whether `kernel_calls` overwrites its array ``unserved_gain``."""
        return self.needs_sampling

    def kernel_calls(
        self, scattering_vectors: wp.array, to_lights: wp.array, gains: wp.array, illuminated: IlluminatedMaterial,
        xyz: wp.array, footprints: wp.array | None = None, unserved_gain: wp.array | None = None,
    ) -> list[KernelCall]:  # fmt: skip
        """Return the kernel calls that :meth:`accumulate` launches.

        The look-up writes the geometry factors (gains) of directions that the table excludes into the array
        ``unserved_gain``, which has at least n entries. The colours of these directions are then integrated over
        sampled wavelengths. If ``unserved_gain`` is None, the array is allocated.
        """
        directions = [scattering_vectors, to_lights]
        if not self.plan.rings_per_octave:
            return [self._sample([*directions, gains, self._no_footprints], illuminated, xyz)]
        if unserved_gain is None:
            unserved_gain = wp.empty(len(gains) * self.needs_sampling, dtype=wp.float32, device=self.device)
        spreads = self._no_footprints if footprints is None else footprints
        calls = [self._look_up([*directions, gains, spreads], illuminated, xyz, unserved_gain)]
        if self.needs_sampling:
            calls.append(self._sample([*directions, unserved_gain, spreads], illuminated, xyz))
        return calls

    def _look_up(
        self, directions: list[wp.array], illuminated: IlluminatedMaterial, xyz: wp.array, unserved_gain: wp.array
    ) -> KernelCall:
        """Return the kernel call that looks up colours in the table and adds them to ``xyz``."""
        if illuminated not in self._colours:
            table = colour_table.table_for(
                self.heightfield, self.plan, self._range, illuminated, device=self.device, threads=self._threads
            )
            table = table if self._zeroth_order else table.without_zeroth_order()
            self._colours[illuminated] = table.with_pitch_scales() if self._pitch_scales else table
        table = self._colours[illuminated]
        batch = colour_lookup.BATCH if self.device.is_cpu else 1
        inputs = [table.struct, *directions, self._taps, batch]
        return KernelCall(table.kernels.integrate, inputs, [unserved_gain, xyz], block=batch)

    def _sample(self, directions: list[wp.array], illuminated: IlluminatedMaterial, xyz: wp.array) -> KernelCall:
        """Return the kernel call that integrates over sampled wavelengths and adds the colours to ``xyz``."""
        heightfield, plan, device = self.heightfield, self.plan, self.device
        # The coefficient table is stored in an attribute of this object, because the shared cache may discard the table
        # between two calls.
        if self._table is None:
            self._table = coefficient_table.table_for(
                heightfield, plan, self._range, device=device, threads=self._threads
            )
            if not self._zeroth_order:
                self._table = coefficient_table.without_zeroth_order(self._table)
            self._table.arguments.has_pitch_scales = self._pitch_scales
        if illuminated not in self._quadratures:
            self._quadratures[illuminated] = coefficient_table.quadrature_for(
                heightfield, plan, illuminated, device=device
            )
        inputs = [self._table.arguments, *directions, self._quadratures[illuminated]]
        return KernelCall(self._table.integrate, inputs, [xyz])
