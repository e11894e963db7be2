"""Pixel filters: where the cells of a pixel lie, what they weigh for the pixels around, and how many go together.

A pixel begins as one ray whose filter is the pixel's. Level n splits pixels into squares of 2ⁿ × 2ⁿ cells, each a ray
with a filter of its own, and a pixel is a weighted sum over its own cells and those of the eight pixels around it. So a
cell serves nine pixels. Second differences of 2 × 2 cells tell which level a pixel's cells need.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpdiff.core.threads import slices_of
from warpdiff.image.error_model import lengths
from warpdiff.kernels import structs
from warpdiff.kernels.refinement_levels import (
    BRIGHTEST_SHARE,
    FILTER_CUT,
    FILTER_SHARES,
    FILTER_SIGMA,
    LEAST_LEVEL_OF_POINTS,
    LEVELS,
    MOST_LEVEL,
    rays_at,
)
from warpdiff.kernels.thresholds import FLOOR, TINY

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

# Deviation of a cell's filter over the cells' distance. Fitted: on the snake 0.5 has up to 1.5 times the error.
_CELL_SIGMA_PER_SPACING = 0.4
# Where a pixel is covered in part, it is split to this level at least, into 4 × 4 cells.
SILHOUETTE_LEVEL = 2
# Rays at a time: worth what comes before their launches, and bounded by their memory.
_LEAST_RAYS, MOST_RAYS = 8192, 32_768
# Rays whose faces are found together, eight bytes each.
_MOST_RASTERIZED = 1 << 24


def level_of(samples: int, *, means: bool) -> int:
    """The least level of at least so many rays a pixel."""
    least = 0 if means else LEAST_LEVEL_OF_POINTS
    return int(min(max(math.ceil(math.log(samples, 4) - 1e-9), least), MOST_LEVEL))


def deviation_at(level: int, *, means: bool) -> float:
    """Deviation of the filter of a ray [pixels]: the pixel's, or a cell's; points have none."""
    if not means:
        return 0.0
    # Cut, a Gaussian is narrower: by a hundredth.
    return _CELL_SIGMA_PER_SPACING / 2**level if level else _cut_deviation()


def _cut_deviation() -> float:
    end = FILTER_CUT / FILTER_SIGMA
    beyond = math.sqrt(2.0 / math.pi) * end * math.exp(-0.5 * end * end) / math.erf(end / math.sqrt(2.0))
    return float(FILTER_SIGMA * math.sqrt(1.0 - beyond))


@functools.cache
def places_at(level: int, device: str) -> wp.array:
    """Where the cells of a pixel lie, (right, down) of its centre [pixels], on the device of a name."""
    across = 2**level
    places = (np.arange(across) + 0.5) / across - 0.5
    down, right = np.meshgrid(places, places, indexing="ij")
    return wp.array(np.column_stack([right.ravel(), down.ravel()]), dtype=wp.vec2d, device=device)


@functools.cache
def weights_at(level: int, means: bool, device: str) -> wp.array:
    """Weights along one axis of the cells of three pixels in a row, for the one in the middle; their sum is 1.

    Together with the cells' own filters they are the pixel's.
    """
    return wp.array(weights_of(level, means=means), dtype=wp.float32, device=device)


def weights_of(level: int, *, means: bool) -> NDArray[np.float64]:
    """Weights of cells along one axis, (3 · 2ⁿ,): see :func:`weights_at`."""
    across = 2**level
    away = (np.arange(3 * across) + 0.5) / across - 1.5
    variance = FILTER_SIGMA**2 - deviation_at(level, means=means) ** 2
    weights = np.exp(-0.5 * away**2 / variance)
    return np.asarray(weights / weights.sum())


@functools.cache
def filter_normalisation_on(means: bool, device: str) -> wp.array:
    """By level, from 0 on, what the filter has in each of three pixels in a row over what weights have there, (n, 3).

    On the device of a name.
    """
    filter_normalisation = [
        np.array(FILTER_SHARES) / weights_of(level, means=means).reshape(3, -1).sum(axis=1) for level in LEVELS
    ]
    # There are no weights of pixels that are not split.
    return wp.array([np.ones(3), *filter_normalisation], dtype=wp.float32, device=device)


def parts(pixels: NDArray[np.int32], level: int) -> Iterator[NDArray[np.int32]]:
    """Pixels in parts whose cells take no more memory than there is to be."""
    size = _MOST_RASTERIZED // rays_at(level)
    for first in range(0, len(pixels), size):
        yield pixels[first : first + size]


def slices(count: int, level: int, threads: int) -> Iterator[range]:
    """Ranges of so many pixels whose cells are met at a time."""
    rays = rays_at(level)
    return slices_of(count, least=-(-_LEAST_RAYS // rays), most=MOST_RAYS // rays, threads=threads)


def most_threads(pixels: int) -> int:
    """How many threads the cells of so many pixels are worth, at most."""
    return int(-(-pixels * rays_at(MOST_LEVEL) // _LEAST_RAYS))


def around(pixels: NDArray[np.integer], width: int, height: int) -> NDArray[np.bool_]:
    """Pixels and the eight around each, as a mask of the picture, (height, width)."""
    wide = np.zeros((height + 2, width + 2), dtype=np.bool_)
    wide[pixels // width + 1, pixels % width + 1] = True
    rows = wide[:-2] | wide[1:-1] | wide[2:]
    return np.asarray(rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:])


def grid_of(pixels: NDArray[np.int32], level: int, width: int, height: int, device: wp.Device) -> structs.Cells:
    """The struct ``Cells`` of the kernels for pixels of a picture of this size, one after the other."""
    # Rows begin with words of their own.
    marks = np.zeros((height, -(-width // 64) * 64), dtype=np.bool_)
    marks[pixels // width, pixels % width] = True
    ranks = np.empty(width * height, dtype=np.int32)
    ranks[pixels] = np.arange(len(pixels), dtype=np.int32)
    result = structs.Cells()
    words = np.packbits(marks, bitorder="little").view(np.uint64)
    result.marks = wp.array(words, dtype=wp.uint64, device=device, copy=False)
    result.ranks = wp.array(ranks, dtype=wp.int32, device=device, copy=False)
    result.across = 2**level
    return result


def floor_of(colours: wp.array, illuminated: wp.array) -> float:
    """The least luminance that errors are relative to, from how bright what is lit is."""
    bright = colours.numpy()[:, 1][illuminated.numpy()]
    if not len(bright):
        return float(TINY)
    rank = len(bright) - 1 - int(BRIGHTEST_SHARE * len(bright))
    return float(max(FLOOR * float(np.partition(bright, rank)[rank]), TINY))


def contrasts(xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    """‖ΔXYZ‖ between pixels and those of the four neighbours that differ most, (height, width)."""
    result = np.zeros(xyz.shape[:2], dtype=np.float32)
    for axis in range(2):
        steps, most = lengths(np.diff(xyz, axis=axis)), np.moveaxis(result, axis, 0)
        steps = np.moveaxis(steps, axis, 0)
        np.maximum(most[1:], steps, out=most[1:])
        np.maximum(most[:-1], steps, out=most[:-1])
    return result
