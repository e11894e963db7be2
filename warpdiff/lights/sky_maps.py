"""Sky maps: octahedral maps of a sky at increasing blur, in three spectra that add up to any RGB."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from warpdiff.core.caching import LruCache
from warpdiff.core.threads import single_threaded_blas
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.optics.spectra import Spectrum

# Rows of the grid of directions, in steps of 0.35°. The first level is blurred by so much [rad], each next one by twice
# as much. From the second level on, steps of the grid are at most half the blur; texels of maps are about as wide as
# the blur, and narrower in the last two levels.
_ROWS, FIRST_BLUR, _LEVELS = 512, 0.00625, 8
_STEPS_A_BLUR, _LARGEST_SIDE, _SMALLEST_SIDE = 2.0, 576, 12
# Number of texels along a side of each level's map.
SIDES = tuple(max(_LARGEST_SIDE >> level, _SMALLEST_SIDE) for level in range(_LEVELS))
# Number of iterations that make a blur along meridians keep the power (Sinkhorn).
_TURNS = 40
# Weights along meridians farther than _BLUR_REACH standard deviations are below the rounding of float64. Blocks of
# _ROWS_AT_ONCE rows are blurred: few of their weights are 0, and they are large enough for fast matrix products.
_BLUR_REACH, _ROWS_AT_ONCE = 9.0, 64
# Suns: how far they reach [rad], or in pixels that the sky is given by, but no further than lights of a size are one
# Gaussian; how bright what lies around may be, of their brightest; which share of all light they are; how many.
_SUN_REACH, _SUN_PIXELS, _FARTHEST_SUN_REACH = math.radians(2.5), 1.5, math.radians(4.5)
_AROUND_SUN, _SUN_SHARE, _MOST_SUNS = 0.1, 0.005, 4


class Sun(NamedTuple):
    """A bright and small part of a sky."""

    towards: NDArray[np.float64]
    rgb: NDArray[np.float64]  # radiance times solid angle
    deviation: float  # of its directions along an axis [rad]


@dataclass(frozen=True, eq=False)
class SkyMaps:
    """A sky as a light, at one rotation, scale and window.

    Attributes:
        spectra: Three illuminants; any colour is a sum of them.
        texels: Power per solid angle by spectrum, and the standard deviation of their sum under the blur, shape (n, 4),
            level after level; a map has :data:`SIDES` texels along a side and one more on each side, and is stored row
            by row.
        turn: Rotation about +y [rad].
        directions: Number of directions that a pixel's colour is summed over.
        device_arrays: Arrays of these maps on devices, by the device's name; whoever uploads them puts them here.
    """

    spectra: tuple[Spectrum, Spectrum, Spectrum]
    texels: NDArray[np.float32]
    turn: float
    directions: int
    device_arrays: LruCache[Any] = field(default_factory=LruCache, repr=False)


def sample_grid(grid: NDArray[np.float64], along: NDArray[np.float64], turn: float) -> NDArray[np.float64]:
    """Values of a grid over latitude and longitude in directions, linear between its points."""
    height, width = grid.shape[:2]
    polar = np.arctan2(np.hypot(along[..., 0], along[..., 2]), along[..., 1])
    row = np.clip(polar / math.pi * height - 0.5, 0.0, height - 1.0)
    column = ((np.arctan2(along[..., 0], -along[..., 2]) + turn) / (2.0 * math.pi) + 0.5) * width - 0.5
    top, left = np.minimum(row.astype(int), height - 2), np.floor(column).astype(int)
    down, right = (row - top)[..., None], (column - left)[..., None]
    left, next_left = left % width, (left + 1) % width
    # Flat indices: np.take is five times as fast as a pair of index arrays.
    flat, top = grid.reshape(height * width, -1), top * width
    upper = (1.0 - right) * np.take(flat, top + left, axis=0) + right * np.take(flat, top + next_left, axis=0)
    top += width
    lower = (1.0 - right) * np.take(flat, top + left, axis=0) + right * np.take(flat, top + next_left, axis=0)
    return np.asarray((1.0 - down) * upper + down * lower)


def extract_suns(radiance: NDArray[np.float32]) -> tuple[NDArray[np.float64], list[Sun]]:
    """A sky on the grid that is blurred, without its suns, which are separate lights: the grid's cells are too wide."""
    grid = _on_grid(radiance)
    sun_extent = max(_SUN_REACH, _SUN_PIXELS * math.pi / len(radiance))
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
    """The sun of a sky, if its brightest part is small and far brighter than what is around, and the sky without it."""
    height, width = grid.shape[:2]
    bright = grid @ colorimetry.RGB_TO_XYZ[1]
    solid = -np.diff(np.cos(np.arange(height + 1) / height * math.pi))[:, None] * 2.0 * math.pi / width
    least_power = _SUN_SHARE * (bright * solid).sum()
    brightest = bright.max()
    row, column = np.unravel_index(bright.argmax(), bright.shape)
    # The surroundings reach twice as far as the sun, whose middle lies within its extent of its brightest cell.
    reach = math.ceil(3.0 * sun_extent / math.pi * height) + 1
    rows = slice(max(int(row) - reach, 0), int(row) + reach + 1)
    bright, solid = bright[rows], np.broadcast_to(solid, bright.shape)[rows]
    along = _grid_directions()[rows]
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
    # What is left of it is as bright as what is around.
    share = np.where(inside, np.minimum(background / np.maximum(bright, 1e-300), 1.0), 1.0)[..., None]
    rgb = ((1.0 - share) * grid[rows] * solid[..., None]).sum(axis=(0, 1))
    rest = grid.copy()
    rest[rows] *= share
    return Sun(towards, rgb, math.sqrt(0.5 * (power * away**2).sum() / power.sum())), rest


@single_threaded_blas()
def blurred_grids(grid: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """RGB, and the deviation of luminance from its mean, over latitude and longitude, blurred more and more."""
    before = 0.0
    grid = np.concatenate([grid, _luminance2(grid)], axis=2)
    result = []
    for level in range(_LEVELS):
        blur = FIRST_BLUR * 2.0**level
        while grid.shape[0] * blur >= 2.0 * _STEPS_A_BLUR * math.pi:
            grid = _halved(grid)
        grid = _blurred(grid, math.sqrt(blur**2 - before**2))
        before = blur
        deviation = np.sqrt(np.maximum(grid[..., 3:] - _luminance2(grid), 0.0))
        result.append(np.concatenate([grid[..., :3], deviation], axis=2))
    return result


def _luminance2(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squares of luminances, (height, width, 1)."""
    return np.asarray((grid[..., :3] @ colorimetry.RGB_TO_XYZ[1, :, None]) ** 2)


def maps_of(grids: list[NDArray[np.float64]]) -> NDArray[np.float32]:
    """Return the texels of :class:`SkyMaps` from blurred grids."""
    texels = [sample_grid(grid, _directions(side), 0.0).reshape(-1, 4) for grid, side in zip(grids, SIDES, strict=True)]
    return np.concatenate(texels).astype(np.float32)


def map_of(texels: NDArray[np.float32], level: int) -> NDArray[np.float32]:
    """Return the map of a level from the texels of all, (side + 2, side + 2, 4)."""
    first = sum((side + 2) ** 2 for side in SIDES[:level])
    side = SIDES[level] + 2
    return texels[first : first + side**2].reshape(side, side, 4)


def _grid_directions() -> NDArray[np.float64]:
    """Unit vectors to the middles of the grid's cells, (_ROWS, 2 _ROWS, 3)."""
    polar = (np.arange(_ROWS) + 0.5) / _ROWS * math.pi
    azimuth = ((np.arange(2 * _ROWS) + 0.5) / _ROWS - 1.0) * math.pi
    level = np.sin(polar)[:, None]
    along = [level * np.sin(azimuth), np.cos(polar)[:, None] + 0.0 * azimuth, -level * np.cos(azimuth)]
    return np.stack(along, axis=-1)


def _on_grid(radiance: NDArray[np.float32]) -> NDArray[np.float64]:
    """Radiance on a grid, (_ROWS, 2 _ROWS, 3): its means over cells, or linear between pixels that are larger."""
    result = radiance.astype(np.float64)
    if len(result) < _ROWS:
        rows, columns = len(result), result.shape[1]
        row = np.clip((np.arange(_ROWS) + 0.5) / _ROWS * rows - 0.5, 0.0, rows - 1.0)
        column = (np.arange(2 * _ROWS) + 0.5) / (2 * _ROWS) * columns - 0.5
        top, left = np.minimum(row.astype(int), rows - 2), np.floor(column).astype(int)
        down, right = (row - top)[:, None, None], (column - left)[:, None]
        result = (1.0 - down) * result[top] + down * result[top + 1]
        return np.asarray((1.0 - right) * result[:, left % columns] + right * result[:, (left + 1) % columns])
    for axis, count in enumerate((_ROWS, 2 * _ROWS)):
        edges = np.linspace(0.0, 1.0, result.shape[axis] + 1)
        targets = np.linspace(0.0, 1.0, count + 1)
        if axis == 0:
            # By solid angle.
            edges, targets = (0.5 - 0.5 * np.cos(math.pi * places) for places in (edges, targets))
        result = np.moveaxis(result, axis, 0)
        sums = np.concatenate([np.zeros((1, *result.shape[1:])), np.cumsum(result * np.diff(edges)[:, None, None], 0)])
        place = np.interp(targets, edges, np.arange(len(edges)))
        first = np.minimum(place.astype(int), len(edges) - 2)
        sums = sums[first] + (place - first)[:, None, None] * (sums[first + 1] - sums[first])
        result = np.moveaxis(np.diff(sums, axis=0) / np.diff(targets)[:, None, None], 0, axis)
    return result


def _halved(grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """A grid of half as many rows and columns, by solid angle."""
    solid = -np.diff(np.cos(np.arange(len(grid) + 1) / len(grid) * math.pi))[:, None, None]
    rows = (grid * solid)[::2] + (grid * solid)[1::2]
    rows /= solid[::2] + solid[1::2]
    return np.asarray(0.5 * (rows[:, ::2] + rows[:, 1::2]))


def _blurred(grid: NDArray[np.float64], blur: float) -> NDArray[np.float64]:
    """A grid blurred on the sphere: along circles of latitude, then along meridians, across the poles.

    Weights along meridians are scaled from both sides (Sinkhorn), so that the blur keeps means and the whole power.
    """
    height, width = grid.shape[:2]
    polar = (np.arange(height) + 0.5) / height * math.pi
    level = np.sin(polar)
    order = np.arange(width // 2 + 1)
    # Factors and weights are real: of waves, the real and the imaginary part are multiplied alike.
    waves = np.fft.rfft(grid, axis=1).view(np.float64).reshape(height, len(order), -1)
    waves *= np.exp(-0.5 * (order * blur / level[:, None]) ** 2)[:, :, None]
    scale = _scale_of_rows(height, blur)
    reach = math.ceil(_BLUR_REACH * blur / math.pi * height)
    result = np.empty_like(waves)
    for begin in range(0, height, _ROWS_AT_ONCE):
        rows, others = slice(begin, begin + _ROWS_AT_ONCE), slice(max(begin - reach, 0), begin + _ROWS_AT_ONCE + reach)
        near, over = _meridian_weights(polar[rows, None], polar[others], blur)
        for odd in (0, 1):
            # What has gone over a pole is half a turn further.
            weights = scale[rows, None] * (near + (-1.0) ** odd * over) * scale[others]
            part = np.ascontiguousarray(waves[others, odd::2]).reshape(weights.shape[1], -1)
            result[rows, odd::2] = (weights @ part).reshape(len(weights), -1, waves.shape[2])
    return np.asarray(np.fft.irfft(result.view(np.complex128), width, axis=1))


def _meridian_weights(
    polar: NDArray[np.float64], others: NDArray[np.float64], blur: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weights of ``others`` at polar angles [rad]: along the same half of a meridian, and over a pole."""

    def gaussian(distance: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.exp(-0.5 * (distance / blur) ** 2)

    level = np.sin(others)
    over = gaussian(polar + others) + gaussian(2.0 * math.pi - polar - others)
    return gaussian(polar - others) * level, over * level


@functools.cache
def _scale_of_rows(height: int, blur: float) -> NDArray[np.float64]:
    """Factors of rows and columns by which all weights along meridians add up to 1."""
    polar = (np.arange(height) + 0.5) / height * math.pi
    weights = np.add(*_meridian_weights(polar[:, None], polar, blur))
    scale = np.ones(height)
    for _ in range(_TURNS):
        scale = np.sqrt(scale / (weights @ scale))
    return scale


def _directions(side: int) -> NDArray[np.float64]:
    """Vectors to the texels of an octahedral map and to those beyond its sides, (side + 2, side + 2, 3)."""
    place = (2.0 * np.arange(-1, side + 1) + 1.0) / side - 1.0
    q, p = np.meshgrid(place, place, indexing="ij")
    # Beyond a side the map goes on at the same side, the other way round.
    for _ in range(2):
        beyond = np.abs(p) > 1.0
        p, q = np.where(beyond, np.sign(p) * 2.0 - p, p), np.where(beyond, -q, q)
        p, q = q, p
    up = 1.0 - np.abs(p) - np.abs(q)
    folded = (1.0 - np.abs(q)) * np.sign(p), (1.0 - np.abs(p)) * np.sign(q)
    return np.stack([np.where(up < 0.0, folded[0], p), up, np.where(up < 0.0, folded[1], q)], axis=-1)
