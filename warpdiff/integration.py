"""Colours of deflections on a device, by the integration that a plan names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from warpdiff import polar, tables
from warpdiff.device import launch

if TYPE_CHECKING:
    import warp as wp

    from warpdiff.heightfield import HeightField
    from warpdiff.planning import Plan
    from warpdiff.scope import Scope


class Integrator:
    """The kernel of a plan with what it reads, made or found again."""

    def __init__(self, hf: HeightField, plan: Plan, scope: Scope, *, device: wp.Device, threads: int) -> None:
        self._hf, self._plan, self._device, self._threads = hf, plan, device, threads
        self._colours: dict[str, Any] = {}
        if plan.nodes:
            self._kernel, self._arguments = polar.table_for(hf, plan, scope, device=device, threads=threads)
        else:
            table = tables.table_for(hf, plan, scope, device=device, threads=threads)
            self._kernel, self._arguments = table.integrate, table.arguments

    def add(
        self,
        deflections: wp.array,
        to_lights: wp.array,
        gains: wp.array,
        illuminant: str,
        xyz: wp.array,
        **options: Any,
    ) -> None:
        """Add the XYZ of deflections (n,) to those in ``xyz``; ``options`` are those of ``launch``."""
        if illuminant not in self._colours:
            make = polar.weights_for if self._plan.nodes else tables.quadrature_for
            self._colours[illuminant] = make(self._hf, self._plan, illuminant, device=self._device)
        seen = [deflections, gains] if self._plan.nodes else [deflections, to_lights, gains]
        inputs = [self._arguments, *seen, self._colours[illuminant]]
        launch(self._kernel, len(gains), inputs, [xyz], device=self._device, threads=self._threads, **options)
