"""Colours of deflections on a device, by the integration that a plan names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import warp as wp

from warpdiff.compute.pipeline import ELEMENTS_OF_SLICE, KernelCall, launch_pipeline
from warpdiff.kernels import colour_lookup
from warpdiff.kernels.structs import Footprint
from warpdiff.tables import coefficient_table, colour_table, polar_layout
from warpdiff.tables.footprint_taps import footprint_taps
from warpdiff.tables.sky_table import sky_table

if TYPE_CHECKING:
    from warpdiff.optics.materials import LitMaterial
    from warpdiff.plans.direction_range import DirectionRange
    from warpdiff.plans.plan import Plan
    from warpdiff.surface.heightfield import HeightField

# Look-ups of a slice.
_LOOK_UPS_OF_SLICE = 2048


class Integrator:
    """The kernel of a plan with what it reads, made or found again."""

    def __init__(
        self,
        hf: HeightField,
        plan: Plan,
        scope: DirectionRange,
        *,
        zeroth_order: bool = True,
        device: wp.Device,
        threads: int,
    ) -> None:
        """What a plan computes for a range of directions, with or without the zeroth order, where powers add."""
        self._hf, self._plan, self._device, self._threads = hf, plan, device, threads
        self._scope, self._zeroth_order = scope, zeroth_order
        self._colours: dict[LitMaterial, Any] = {}
        self._quadratures: dict[LitMaterial, Any] = {}
        self._sky_tables: dict[Any, Any] = {}
        self._table: coefficient_table.Table | None = None
        if plan.nodes:
            self._taps = footprint_taps(device.alias, is_lines=plan.coherence.kind == "source")
            self._no_footprints = wp.empty(0, dtype=Footprint, device=device)

    def add(
        self,
        deflections: wp.array,
        to_lights: wp.array,
        gains: wp.array,
        lit: LitMaterial,
        xyz: wp.array,
        *,
        footprints: wp.array | None = None,
        left_out: wp.array | None = None,
        among: range | None = None,
        **options: Any,
    ) -> None:
        """Add the XYZ of deflections (n,) to those in ``xyz``.

        Args:
            deflections: (u, v, w).
            to_lights: Directions to the light in the local frame.
            gains: Their factors.
            lit: The illuminant, and the material that it falls on.
            xyz: What is added to.
            footprints: What each pixel's filter does to (u, v), for a plan with footprints.
            left_out: Where a table that leaves directions out puts their gains, (n,) or more; None makes it.
            among: Which of them, from a whole run on; None is all.
            options: Of ``launch_pipeline``, ``slice_size`` and ``progress``.
        """
        options.setdefault("slice_size", self.slice_size)
        steps = self.steps(deflections, to_lights, gains, lit, xyz, footprints, left_out)
        launch_pipeline(
            steps, len(gains) if among is None else among, device=self._device, threads=self._threads, **options
        )

    def sky_table(self, lit: tuple[tuple[LitMaterial, ...], ...], directions: int) -> Any:
        """The struct ``SkyTable`` for so many directions, of spectra by material, made or found again."""
        key = lit, directions
        if key not in self._sky_tables:
            # Of their own: colours of an environment's spectra are asked for here alone, and are far larger.
            with_all, without = (
                Integrator(
                    self._hf, self._plan, self._scope, zeroth_order=each, device=self._device, threads=self._threads
                )
                for each in (True, False)
            )
            lobe_uv = polar_layout.blur(self._plan.coherence) * polar_layout.MIDDLE_UM
            self._sky_tables[key] = sky_table(
                (with_all, without), lit, directions, self._hf.height_range_um, lobe_uv, device=self._device
            )
        return self._sky_tables[key]

    @property
    def slice_size(self) -> int:
        """How many directions of a picture or a call go through the kernels together."""
        return _LOOK_UPS_OF_SLICE if self._plan.nodes and not self.leaves_out else ELEMENTS_OF_SLICE

    @property
    def leaves_out(self) -> bool:
        """Whether a table leaves out some directions, as those of a source do."""
        return bool(self._plan.nodes) and self._plan.coherence.kind == "source"

    @property
    def blurs(self) -> bool:
        """Whether a table takes means over footprints."""
        return self._plan.blurs

    def steps(
        self,
        deflections: wp.array,
        to_lights: wp.array,
        gains: wp.array,
        lit: LitMaterial,
        xyz: wp.array,
        footprints: wp.array | None = None,
        left_out: wp.array | None = None,
    ) -> list[KernelCall]:
        """The kernel calls of ``add``."""
        if not self._plan.nodes:
            return [self._sample(deflections, to_lights, gains, lit, xyz)]
        if left_out is None:
            left_out = wp.empty(len(gains) * self.leaves_out, dtype=wp.float32, device=self._device)
        steps = [self._look_up(deflections, to_lights, gains, lit, xyz, footprints, left_out)]
        if self.leaves_out:
            steps.append(self._sample(deflections, to_lights, left_out, lit, xyz))
        return steps

    def _look_up(
        self,
        deflections: wp.array,
        to_lights: wp.array,
        gains: wp.array,
        lit: LitMaterial,
        xyz: wp.array,
        footprints: wp.array | None,
        left_out: wp.array,
    ) -> KernelCall:
        """Add what a table serves."""
        if lit not in self._colours:
            kernel, table = colour_table.table_for(
                self._hf, self._plan, self._scope, lit, device=self._device, threads=self._threads
            )
            self._colours[lit] = (
                kernel,
                table if self._zeroth_order else colour_table.without_zeroth_order(table, self._plan.coherence),
            )
        kernel, table = self._colours[lit]
        seen = self._no_footprints if footprints is None else footprints
        run = colour_lookup.RUN if self._device.is_cpu else 1
        inputs = [table, deflections, to_lights, gains, seen, self._taps, run]
        return KernelCall(kernel, inputs, [left_out, xyz], block=run)

    def _sample(
        self, deflections: wp.array, to_lights: wp.array, gains: wp.array, lit: LitMaterial, xyz: wp.array
    ) -> KernelCall:
        """Add the sums over wavelengths."""
        given: dict[str, Any] = {"device": self._device}
        # Others may have taken its place among those that are kept.
        if self._table is None:
            self._table = coefficient_table.table_for(self._hf, self._plan, self._scope, threads=self._threads, **given)
            if not self._zeroth_order:
                self._table = coefficient_table.without_zeroth_order(self._table)
        if lit not in self._quadratures:
            self._quadratures[lit] = coefficient_table.quadrature_for(self._hf, self._plan, lit, **given)
        inputs = [self._table.arguments, deflections, to_lights, gains, self._quadratures[lit]]
        return KernelCall(self._table.integrate, inputs, [xyz])
