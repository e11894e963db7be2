"""Designs of gratings that vary along y, as gratings that vary along x: both have equal efficiencies and colours."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from warpdiff.heightfield.field import HeightField
from warpdiff.profiles.sampled_profiles import Pixels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from warpdiff.inverse_design.targets import Target

# Index that exchanges the components x and y of a vector.
_EXCHANGED = [1, 0, 2]


def transposed_field(surface: HeightField) -> HeightField:
    """Return a height field with x and y exchanged."""
    dy, dx = surface.pitch_um
    return HeightField.of_known_scale(surface.heights_um.T, (dx, dy))


def transposed_targets(targets: Sequence[Target]) -> list[Target]:
    """Return targets with x and y exchanged, in their directions and orders."""
    return [
        replace(
            target, to_light=target.to_light[_EXCHANGED], to_view=target.to_view[_EXCHANGED],
            pairs=target.pairs[:, ::-1],
        )
        for target in targets
    ]  # fmt: skip


def transposed_column(pixels: Pixels) -> Pixels:
    """Return a single row of pixels with the heights of a single column, in the same sequence."""
    return Pixels(pixels.pixel_um, pixels.start[None, :], pixels.samples)


def is_column(profile: object) -> bool:
    """Whether a profile is a single column of pixels."""
    return isinstance(profile, Pixels) and profile.pixels[1] == 1 < profile.pixels[0]
