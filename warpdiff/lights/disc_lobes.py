"""Lobes of a disc light: rings of Gaussians whose rim, under windows, is as sharp as the disc's."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Rings: so much wider each further in, up to a limit.
_RING_GROWTH, _WIDEST_RING_DEG = 1.5, 3.5
# Lobes blur the disc as the window does at this wavelength, but no less than by this, nor by more, a blur or a share of
# the radius: shadows are soft without a window.
_BLUR_NM, _LEAST_BLUR_DEG = 450.0, 0.13
_MOST_BLUR_DEG, _MOST_BLUR = 0.4, 0.1
# The ring at the rim in such blurs; deviations of lobes in what they are apart; of the middle one in its radius.
_RIM_BLURS, _LOBE_WIDTH, _MIDDLE_WIDTH = 1.8, 0.6, 0.8
# A lobe of a ring of radius r and width w is √(b r w) long.
_BEND = 0.7
_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
_FEWEST_OF_RING = 6
# Where lobes are made even together: so many radii within and at the rim, and angles around. Errors count relative to
# the blurred disc, down to so much of it.
_EVEN_RADII, _EVEN_RIM, _EVEN_AROUND, _DARKEST = 96, 96, 16, 1e-3


@functools.lru_cache(maxsize=64)
def lobes_of_disc(diameter_deg: float, sigma_um: float | None) -> tuple[tuple[float, float, float, float, float], ...]:
    """Rings of lobes that add up to a blurred disc: thin ones at its rim, each as long as its ring's curvature allows.

    Windows blur a light, too, so that lobes are thinner than their distance, and at the rim may be lines. Lengths are
    those of a plane in which equal areas are equal solid angles. Least squares against the blurred disc give the share
    of the light that each ring's lobes have.

    Args:
        diameter_deg: Angular diameter of the disc.
        sigma_um: Standard deviation of the windows; None does not blur.

    Returns:
        Of each lobe, the angle from the disc's centre, the azimuth around it, the standard deviations outwards and
        around [all in radians], and the share of the light.
    """
    edge = 2.0 * math.sin(math.radians(diameter_deg) / 4.0)
    window_blur = 0.0 if sigma_um is None else 1e-3 * _BLUR_NM / (math.sqrt(8.0) * math.pi * sigma_um)
    blur = min(max(window_blur, math.radians(_LEAST_BLUR_DEG)), max(math.radians(_MOST_BLUR_DEG), _MOST_BLUR * edge))
    rings = _rings(edge, blur)
    radii = np.sort(np.concatenate([
        edge * np.sqrt((np.arange(_EVEN_RADII) + 0.5) / _EVEN_RADII), edge + blur * np.linspace(-4.0, 5.0, _EVEN_RIM)
    ]))  # fmt: skip
    radii = radii[radii > 0.0]
    azimuths = 2.0 * math.pi * np.arange(_EVEN_AROUND) / _EVEN_AROUND
    radius, angle = (grid.ravel() for grid in np.meshgrid(radii, azimuths))
    angle = angle + _GOLDEN_ANGLE * np.searchsorted(radii, radius)
    target = np.tile(_blurred_disc(radii, edge, blur), _EVEN_AROUND)
    weights = 1.0 / np.sqrt(np.maximum(target, _DARKEST))
    densities = np.column_stack([_density(ring, radius, angle) for ring in rings])
    powers = np.linalg.lstsq(weights[:, None] * densities, weights * target, rcond=None)[0]
    shares = np.concatenate([np.full(len(ring), power) for ring, power in zip(rings, powers, strict=True)])
    middles, around, *blurred_widths = np.concatenate(rings).T
    across, along = (np.sqrt(np.maximum(width**2 - min(window_blur, blur) ** 2, 0.0)) for width in blurred_widths)
    polar = 2.0 * np.arcsin(middles / 2.0)
    stretch = np.cos(polar / 2.0)
    lobes = np.column_stack([polar, around, across / stretch, along * stretch, shares / shares.sum()])
    return tuple(map(tuple, lobes.tolist()))


def _rings(edge: float, blur: float) -> list[NDArray[np.float64]]:
    """Rings of blurred lobes: distance from the centre, azimuth around it, deviations outwards and around."""
    rings, outer, turn = [], edge, 0.0
    *widths, core_radius = _widths(edge, _RIM_BLURS * blur)
    for width in widths:
        middle = outer - width / 2.0
        longest = max(width, math.sqrt(_BEND * middle * width))
        count = max(math.ceil(2.0 * math.pi * middle / longest), _FEWEST_OF_RING)
        across, along = (max(_LOBE_WIDTH * spacing, blur) for spacing in (width, 2.0 * math.pi * middle / count))
        # Both ends of a straight lobe lie further out than the ring.
        distance = middle - (along**2 - across**2) / (2.0 * middle)
        around = turn + 2.0 * math.pi * np.arange(count) / count
        rings.append(np.column_stack([np.full(count, distance), around, np.full(count, across), np.full(count, along)]))
        outer, turn = outer - width, turn + _GOLDEN_ANGLE
    core_width = max(_MIDDLE_WIDTH * core_radius, blur)
    return [*rings, np.array([[0.0, 0.0, core_width, core_width]])]


def _widths(edge: float, rim: float) -> list[float]:
    """Widths of rings from the rim inwards, and the radius of what is left in the middle, which fill a radius."""
    widths = [rim]
    while sum(widths[:-1]) + _MIDDLE_WIDTH * widths[-1] < edge:
        widths.append(max(rim, min(_RING_GROWTH * widths[-1], math.radians(_WIDEST_RING_DEG))))
    widths[-1] *= _MIDDLE_WIDTH
    return [width * edge / sum(widths) for width in widths]


def _blurred_disc(radii: NDArray[np.float64], edge: float, blur: float) -> NDArray[np.float64]:
    """A disc of brightness 1 under a Gaussian, along a radius: a sum over its chords."""
    count = math.ceil(6.0 * math.pi * edge / blur)
    angle = math.pi * ((np.arange(count) + 0.5) / count - 0.5)
    x, half = edge * np.sin(angle), edge * np.cos(angle)
    chords = [math.erf(length) for length in half / (math.sqrt(2.0) * blur)]
    weights = np.exp(-0.5 * ((radii[:, None] - x) / blur) ** 2) / (math.sqrt(2.0 * math.pi) * blur)
    return np.asarray(weights @ (chords * half) * math.pi / count)


def _density(ring: NDArray[np.float64], radius: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sum of a ring's lobes, of power 1 each, in the plane, shape of ``radius``."""
    middle, around, across, along = ring[:, :, None].transpose(1, 0, 2)
    outwards = radius * np.cos(angle - around) - middle
    sideways = radius * np.sin(angle - around)
    exponents = (outwards / across) ** 2 + (sideways / along) ** 2
    return np.asarray((np.exp(-0.5 * exponents) / (2.0 * math.pi * across * along)).sum(axis=0))
