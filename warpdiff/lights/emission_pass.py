"""Pass of the light that plain surfaces emit: it is added once to a picture, after the lights."""

from __future__ import annotations

from typing import TYPE_CHECKING

import warp as wp

from warpdiff.device.kernel_calls import KernelCall
from warpdiff.kernels import plain_reflection
from warpdiff.lights.light_pass import LightPass

if TYPE_CHECKING:
    from collections.abc import Hashable

    from warpdiff.lights.light_pass import Counting, PassContext, RayBatch
    from warpdiff.lights.plain_materials import PlainFaces
    from warpdiff.tables.lookup import Lookups


class EmissionPass(LightPass):
    """Pass of the light that plain surfaces (surfaces without a height field) emit.

    An emission of 1 has the luminance of a white matte surface that faces the brightest light of the picture.
    """

    def __init__(self, context: PassContext, plain: PlainFaces, brightness: float) -> None:
        """Make the pass for faces without a height field. ``brightness`` is the luminance of an emission of 1."""
        super().__init__(context, [[]])
        self._plain, self._luminance = plain, brightness
        self._brightness = wp.empty(1, dtype=wp.float32, device=context.device)

    @property
    def graph_key(self) -> tuple[Hashable, ...]:
        """Type of this pass, as a part of the key of a recorded CUDA graph.

        The luminance of an emission of 1 is no part of the key, because recorded launches read it from an array.
        """
        return (type(self),)

    def begin(self, previous: LightPass | None) -> None:
        """Write the luminance of an emission of 1 into the array of the previous emission pass, or into a new array."""
        if isinstance(previous, EmissionPass):
            self._brightness = previous._brightness
        self._brightness.fill_(self._luminance)

    def scatter(self, lobe: int, batch: RayBatch, counting: Counting) -> list[KernelCall]:  # noqa: ARG002 (one lobe)
        """Return the kernel call that adds the light that surfaces emit to the colours of a batch of rays."""
        inputs = [
            batch.gbuffer.pixels, self._plain.struct, self._brightness, self._lights.rgb_to_xyz, counting.weight,
            counting.resets,
        ]  # fmt: skip
        outputs = [batch.samples.scattering_vectors, batch.samples.gains, batch.xyz, batch.illuminated]
        return [KernelCall(plain_reflection.add_emission, inputs, outputs, in_runs=True)]

    def colour(self, lobe: int, batch: RayBatch, lookups: Lookups) -> list[KernelCall]:  # noqa: ARG002 (no look-ups)
        """Return no kernel calls, because height fields emit no light."""
        return []
