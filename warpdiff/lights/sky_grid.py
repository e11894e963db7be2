"""Grids of a sky: power by latitude and longitude, without suns, for three spectra that add up to any RGB colour."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from warpdiff.core.caching import LruCache
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.optics.spectra import Spectrum

# Number of rows of the latitude-longitude grid, 0.35° each. The value is limited by memory: twice as many rows require
# four times the memory.
ROWS = 512
# Angular radius within which bright pixels count as one sun [rad]. It is `_SUN_REACH`, or `_SUN_PIXELS` times the size
# of a pixel if that is larger. If this radius exceeds `_FARTHEST_SUN_REACH`, no suns are extracted from the image. The
# largest radius is limited because one Gaussian lobe is too coarse for larger lights.
_SUN_REACH, _SUN_PIXELS, _FARTHEST_SUN_REACH = math.radians(2.5), 1.5, math.radians(4.5)
# Conditions for a sun. `_AROUND_SUN` is the largest brightness of its surroundings relative to the sun, `_SUN_SHARE`
# the smallest fraction of the sky's light that it must have, and `_MOST_SUNS` the largest number of suns. Other values
# would change only the noise: a bright spot that does not count as a sun remains in the sky and causes more noise.
_AROUND_SUN, _SUN_SHARE, _MOST_SUNS = 0.1, 0.005, 4


class Sun(NamedTuple):
    """Bright and small part of a sky, which becomes a separate light."""

    towards: NDArray[np.float64]
    rgb: NDArray[np.float64]  # linear sRGB radiance of the sun, multiplied by its solid angle
    deviation: float  # standard deviation of the directions to the sun along one axis [rad]


@dataclass(frozen=True, eq=False)
class SkyGrid:
    """Powers of a sky on a latitude-longitude grid, for one rotation, scale and coherence window (Gaussian area).

    Attributes:
        spectra: Three illuminants, whose weighted sums have any colour.
        powers: Power per solid angle of each of the three spectra, in the directions of :func:`grid_directions`.
        turn: Rotation about +y [rad].
        directions: Number of random directions per pixel in pictures with ``refine=False``.
        device_arrays: Cache of the arrays of this grid on devices, by the name of the device.
    """

    spectra: tuple[Spectrum, Spectrum, Spectrum]
    powers: NDArray[np.float32]
    turn: float
    directions: int
    device_arrays: LruCache[tuple[wp.array, ...]] = field(default_factory=LruCache, repr=False)


def sample_grid(grid: NDArray[np.float64], along: NDArray[np.float64], turn: float) -> NDArray[np.float64]:
    """Return the values of a latitude-longitude grid in the directions ``along``, by bilinear interpolation.

    ``turn`` is the rotation of the grid about +y [rad].
    """
    height, width = grid.shape[:2]
    polar = np.arctan2(np.hypot(along[..., 0], along[..., 2]), along[..., 1])
    row = np.clip(polar / math.pi * height - 0.5, 0.0, height - 1.0)
    column = ((np.arctan2(along[..., 0], -along[..., 2]) + turn) / (2.0 * math.pi) + 0.5) * width - 0.5
    top, left = np.minimum(row.astype(int), height - 2), np.floor(column).astype(int)
    down, right = (row - top)[..., None], (column - left)[..., None]
    left, next_left = left % width, (left + 1) % width
    # NumPy's function ``take`` on the flattened grid takes a fifth of the time of indexing by rows and columns.
    flat, top = grid.reshape(height * width, -1), top * width
    upper = (1.0 - right) * np.take(flat, top + left, axis=0) + right * np.take(flat, top + next_left, axis=0)
    top += width
    lower = (1.0 - right) * np.take(flat, top + left, axis=0) + right * np.take(flat, top + next_left, axis=0)
    return np.asarray((1.0 - down) * upper + down * lower)


def extract_suns(radiance: NDArray[np.float32]) -> tuple[NDArray[np.float64], list[Sun]]:
    """Return the radiance of a sky without its suns on the latitude-longitude grid, and the suns as separate lights."""
    grid = _on_grid(radiance)
    height, width = radiance.shape[:2]
    sun_extent = max(_SUN_REACH, _SUN_PIXELS * max(math.pi / height, 2.0 * math.pi / width))
    suns: list[Sun] = []
    if sun_extent > _FARTHEST_SUN_REACH:
        return grid, suns
    for _ in range(_MOST_SUNS):
        split = _sun_in(grid, sun_extent)
        if split is None:
            break
        suns.append(split[0])
        grid = split[1]
    return grid, suns


def _sun_in(grid: NDArray[np.float64], sun_extent: float) -> tuple[Sun, NDArray[np.float64]] | None:
    """Return the brightest sun of a sky, and the sky without it; None if the brightest spot does not count as a sun."""
    height, width = grid.shape[:2]
    bright = grid @ colorimetry.RGB_TO_XYZ[1]
    solid = -np.diff(np.cos(np.arange(height + 1) / height * math.pi))[:, None] * 2.0 * math.pi / width
    least_power = _SUN_SHARE * (bright * solid).sum()
    brightest = bright.max()
    row, column = np.unravel_index(bright.argmax(), bright.shape)
    # Only a window around the brightest cell of the sky's grid is searched. It extends three angular radii of the sun
    # in each direction: one radius to the sun's centre, and two radii for the surroundings.
    reach = math.ceil(3.0 * sun_extent / math.pi * height) + 1
    rows = slice(max(int(row) - reach, 0), int(row) + reach + 1)
    bright, solid = bright[rows], np.broadcast_to(solid, bright.shape)[rows]
    along = grid_directions()[rows]
    towards = along[row - rows.start, column]
    for _ in range(2):
        away = np.arccos(np.clip(along @ towards, -1.0, 1.0))
        inside, around = away < sun_extent, (away >= sun_extent) & (away < 2.0 * sun_extent)
        background = np.average(bright[around], weights=solid[around])
        power = np.where(inside, np.maximum(bright - background, 0.0) * solid, 0.0)
        if power.sum() <= least_power:
            return None
        towards = (power[..., None] * along).sum(axis=(0, 1))
        towards /= np.linalg.norm(towards)
    if bright[around].max() > _AROUND_SUN * brightest:
        return None
    # Where the sun was extracted, the sky gets the brightness of the sun's surroundings.
    share = np.where(inside, np.minimum(background / np.maximum(bright, 1e-300), 1.0), 1.0)[..., None]
    rgb = ((1.0 - share) * grid[rows] * solid[..., None]).sum(axis=(0, 1))
    rest = grid.copy()
    rest[rows] *= share
    return Sun(towards, rgb, math.sqrt(0.5 * (power * away**2).sum() / power.sum())), rest


def grid_directions() -> NDArray[np.float64]:
    """Return unit vectors to the centres of the latitude-longitude grid's cells, shape (ROWS, 2 ROWS, 3)."""
    polar = (np.arange(ROWS) + 0.5) / ROWS * math.pi
    azimuth = ((np.arange(2 * ROWS) + 0.5) / ROWS - 1.0) * math.pi
    level = np.sin(polar)[:, None]
    along = [level * np.sin(azimuth), np.cos(polar)[:, None] + 0.0 * azimuth, -level * np.cos(azimuth)]
    return np.stack(along, axis=-1)


def _on_grid(radiance: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the radiance of an image on the latitude-longitude grid of the sky, shape (ROWS, 2 ROWS, 3).

    Along each axis, an image with smaller pixels than the grid is averaged over the cells of the grid, and an image
    with larger pixels is interpolated.
    """
    result = radiance.astype(np.float64)
    for axis, count in enumerate((ROWS, 2 * ROWS)):
        if result.shape[axis] < count:
            continue
        edges = np.linspace(0.0, 1.0, result.shape[axis] + 1)
        targets = np.linspace(0.0, 1.0, count + 1)
        if axis == 0:
            # Rows of pixels near the poles have smaller solid angles. The mean over rows is therefore weighted by solid
            # angle.
            edges, targets = (0.5 - 0.5 * np.cos(math.pi * places) for places in (edges, targets))
        result = np.moveaxis(result, axis, 0)
        sums = np.concatenate([np.zeros((1, *result.shape[1:])), np.cumsum(result * np.diff(edges)[:, None, None], 0)])
        place = np.interp(targets, edges, np.arange(len(edges)))
        first = np.minimum(place.astype(int), len(edges) - 2)
        sums = sums[first] + (place - first)[:, None, None] * (sums[first + 1] - sums[first])
        result = np.moveaxis(np.diff(sums, axis=0) / np.diff(targets)[:, None, None], 0, axis)
    # An axis along which the image was averaged already has the number of cells of the sky's grid, so that the
    # interpolation does not change values along it.
    return result if result.shape[:2] == (ROWS, 2 * ROWS) else sample_grid(result, grid_directions(), 0.0)
