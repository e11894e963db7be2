"""Accumulators: sums over the lights of a picture, and the parts of their errors, one entry per pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import warp as wp

# Fields that each light has for itself.
_OF_ONE_LIGHT = ("xyz", "illuminated", "errors")


@dataclass(frozen=True)
class Accumulators:
    """Sums of a picture, or of one of its lights; passes of lights and their refinement fill them.

    Attributes:
        xyz: Sums of colours, ``wp.vec3f``.
        coverage: Sums of hits; all lights share this array.
        coverage_levels: Sum of the levels of the tiles that the coverage is from; empty for points, shared likewise.
        illuminated: Whether any light reached the pixel.
        errors: Estimated errors ‖ΔXYZ‖ of means over pixels; empty for points.
        edges: Whether an edge passes through the pixel, as its cells show; all lights share this array.
    """

    xyz: wp.array
    coverage: wp.array
    coverage_levels: wp.array
    illuminated: wp.array
    errors: wp.array
    edges: wp.array

    @classmethod
    def allocate(cls, pixels: int, *, means: bool, device: wp.Device) -> Accumulators:
        """Return the sums of a number of pixels, for means or for points."""

        def zeros(dtype: type, size: int = pixels) -> wp.array:
            return wp.zeros(size, dtype=dtype, device=device)

        return cls(
            zeros(wp.vec3f), zeros(wp.float64), zeros(wp.uint8, pixels * means), zeros(wp.bool),
            zeros(wp.float32, pixels * means), zeros(wp.bool, pixels * means),
        )  # fmt: skip

    def of_one_light(self, previous: Accumulators | None) -> Accumulators:
        """Return sums of a single light, in arrays of previous ones, that share what belongs to the pixels."""
        own = {
            name: wp.zeros_like(getattr(self, name)) if previous is None else getattr(previous, name)
            for name in _OF_ONE_LIGHT
        }
        return replace(self, **own)

    def clear_errors(self) -> None:
        """Set all errors, edges and levels to zero."""
        for array in (self.errors, self.coverage_levels, self.edges):
            array.zero_()
