"""Accumulators: sums of colours over the lights of a picture, and their estimated errors, with one entry per pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import warp as wp

# Names of the fields of :class:`Accumulators` that a picture with several lights stores twice: as sums over all lights,
# and as values for the light that is rendered at the moment.
_OF_ONE_LIGHT = ("xyz", "illuminated", "errors")


@dataclass(frozen=True)
class Accumulators:
    """Sums of colours, coverage and errors of a picture, or of one of its lights.

    The computation of each light and the refinement of pixels (division into cells) fill these arrays. Pixels show
    either means over the pixel filter or points (single directions).

    Attributes:
        xyz: Sums of colours, ``wp.vec3f``.
        coverage: Fraction of each pixel that the mesh covers; all lights use the same array.
        coverage_levels: Sum of the subdivision levels of the nine tiles (the pixel and its eight neighbours, each
            divided into cells) from which the coverage was computed. If the sum is larger for a later light, the cells
            for this light are smaller, and their more accurate coverage replaces the stored coverage. Empty if pixels
            show points. All lights use the same array.
        illuminated: Whether any light reached the pixel.
        errors: Estimated errors ‖ΔXYZ‖ of means over pixels; empty if pixels show points.
        edges: Whether an edge of the mesh or of a shadow passes through the pixel; all lights use the same array.
    """

    xyz: wp.array
    coverage: wp.array
    coverage_levels: wp.array
    illuminated: wp.array
    errors: wp.array
    edges: wp.array

    @classmethod
    def allocate(cls, pixels: int, *, means: bool, device: wp.Device) -> Accumulators:
        """Return arrays of sums for a number of pixels, all of them 0.

        If ``means`` is False, pixels show points (single directions) instead of means over filters, and the arrays of
        errors and edges are empty.
        """

        def zeros(dtype: type, size: int = pixels) -> wp.array:
            return wp.zeros(size, dtype=dtype, device=device)

        return cls(
            zeros(wp.vec3f), zeros(wp.float64), zeros(wp.uint8, pixels * means), zeros(wp.bool),
            zeros(wp.float32, pixels * means), zeros(wp.bool, pixels * means),
        )  # fmt: skip

    def of_one_light(self, previous: Accumulators | None) -> Accumulators:
        """Return the sums for a single light. The arrays of coverage and edges are those of the sums over all lights.

        ``previous`` is an earlier result of this method, of which the arrays of colours, illuminated pixels and errors
        are reused. None makes new arrays.
        """
        own = {
            name: wp.zeros_like(getattr(self, name)) if previous is None else getattr(previous, name)
            for name in _OF_ONE_LIGHT
        }
        return replace(self, **own)

    def clear_errors(self) -> None:
        """Set all errors and edges, and the subdivision levels of the coverage, to zero."""
        for array in (self.errors, self.coverage_levels, self.edges):
            array.zero_()
