"""Pixel filter: positions of subpixel cells, weights of cells for nine pixels, and sizes of batches.

A pixel begins as one ray with the pixel filter. Level n divides pixels into 2ⁿ × 2ⁿ cells. Each cell is a ray with a
narrower filter. A pixel's colour is a weighted sum over its cells and the cells of the eight pixels around it. Each
cell therefore contributes to nine pixels.
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

# Standard deviation of the filter of a subpixel cell, relative to the distance of neighbouring cells. The value was
# fitted (docs/decisions/adaptive_sampling.md): with 0.5, errors in pictures of a snake mesh are 1.1 to 2 times as
# large.
_CELL_SIGMA_PER_SPACING = 0.4
# Smallest level of subdivision of pixels at silhouettes of the mesh; level 2 has 4 × 4 cells. The next level would
# require four times as many cells there.
SILHOUETTE_LEVEL = 2
# Smallest and largest number of rays that a thread shades in one launch. With fewer rays, the overhead of launches is a
# larger part of the time. With more rays, buffers require more memory.
_LEAST_RAYS, MOST_RAYS = 8192, 32_768
# Largest number of rays whose faces are found in one rasterization. The value is limited by memory: a ray requires
# eight bytes.
_MOST_RASTERIZED = 1 << 24


def level_of(samples: int, *, means: bool) -> int:
    """Return the lowest level of subdivision that has at least ``samples`` cells per pixel."""
    least = 0 if means else LEAST_LEVEL_OF_POINTS
    return int(min(max(math.ceil(math.log(samples, 4) - 1e-9), least), MOST_LEVEL))


def deviation_at(level: int, *, means: bool) -> float:
    """Return the standard deviation of the filter of a ray at a level [pixels].

    Level 0 is one ray per pixel with the pixel filter. Higher levels are subpixel cells with narrower filters. Rays
    have no filter if pixels show points (single directions), and the result is then 0.
    """
    if not means:
        return 0.0
    # The pixel filter is truncated, which makes its standard deviation 1 % smaller than that of the Gaussian.
    return _CELL_SIGMA_PER_SPACING / 2**level if level else _cut_deviation()


def _cut_deviation() -> float:
    end = FILTER_CUT / FILTER_SIGMA
    beyond = math.sqrt(2.0 / math.pi) * end * math.exp(-0.5 * end * end) / math.erf(end / math.sqrt(2.0))
    return float(FILTER_SIGMA * math.sqrt(1.0 - beyond))


@functools.cache
def places_at(level: int, device: str) -> wp.array:
    """Return the positions (right, down) of a pixel's subpixel cells relative to its centre [pixels], on a device."""
    across = 2**level
    places = (np.arange(across) + 0.5) / across - 0.5
    down, right = np.meshgrid(places, places, indexing="ij")
    return wp.array(np.column_stack([right.ravel(), down.ravel()]), dtype=wp.vec2d, device=device)


@functools.cache
def weights_at(level: int, means: bool, device: str) -> wp.array:
    """Return the weights with which the subpixel cells of three neighbouring pixels contribute to the middle pixel.

    The three pixels are along one axis. Each cell has a narrow filter. With these weights, the narrow filters add up to
    the wider pixel filter. The sum of the weights is 1.
    """
    return wp.array(weights_of(level, means=means), dtype=wp.float32, device=device)


def weights_of(level: int, *, means: bool) -> NDArray[np.float64]:
    """Return the weights of :func:`weights_at` as a NumPy array, shape (3 · 2ⁿ,) for level n."""
    across = 2**level
    away = (np.arange(3 * across) + 0.5) / across - 1.5
    variance = FILTER_SIGMA**2 - deviation_at(level, means=means) ** 2
    weights = np.exp(-0.5 * away**2 / variance)
    return np.asarray(weights / weights.sum())


@functools.cache
def filter_normalisation_on(means: bool, device: str) -> wp.array:
    """Return correction factors for the weights of subpixel cells, one row per level and three columns.

    The columns are for three pixels along an axis: the neighbour of a pixel on one side, the pixel itself, and the
    neighbour on the other side. The filter of the pixel has a certain part of its weight in each of them. The weights
    of the cells there add up to a slightly different sum. The correction factor is that part divided by this sum.
    """
    filter_normalisation = [
        np.array(FILTER_SHARES) / weights_of(level, means=means).reshape(3, -1).sum(axis=1) for level in LEVELS
    ]
    # Each row of the result has the factors of one level of subdivision. The first row is for level 0, where pixels are
    # not divided into cells. It is never read, and makes the index of each row equal to its level.
    return wp.array([np.ones(3), *filter_normalisation], dtype=wp.float32, device=device)


def parts(pixels: NDArray[np.int32], level: int) -> Iterator[NDArray[np.int32]]:
    """Divide a list of pixels into parts. One rasterization finds the faces for all subpixel cells of a part."""
    size = _MOST_RASTERIZED // rays_at(level)
    for first in range(0, len(pixels), size):
        yield pixels[first : first + size]


def slices(count: int, level: int, threads: int) -> Iterator[range]:
    """Divide ``count`` pixels into ranges. One thread shades the cells of one range in one launch."""
    rays = rays_at(level)
    return slices_of(count, least=-(-_LEAST_RAYS // rays), most=MOST_RAYS // rays, threads=threads)


def most_threads(pixels: int) -> int:
    """Return the largest useful number of threads. With more threads, a thread would have too few rays per launch."""
    return int(-(-pixels * rays_at(MOST_LEVEL) // _LEAST_RAYS))


def around(pixels: NDArray[np.integer], width: int, height: int) -> NDArray[np.bool_]:
    """Return a mask of the given pixels and the eight pixels around each, shape (height, width)."""
    wide = np.zeros((height + 2, width + 2), dtype=np.bool_)
    wide[pixels // width + 1, pixels % width + 1] = True
    rows = wide[:-2] | wide[1:-1] | wide[2:]
    return np.asarray(rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:])


def grid_of(pixels: NDArray[np.int32], level: int, width: int, height: int, device: wp.Device) -> structs.Cells:
    """Return the struct ``Cells``, by which kernels find the cells of certain pixels of a picture.

    Level n divides a pixel into 2ⁿ × 2ⁿ cells.
    """
    # The mask of the subdivided pixels has one bit per pixel. Each row of the picture begins with a new word of 64
    # bits.
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
    """Return the smallest divisor of relative errors: 1e-3 of the 99th percentile of illuminated pixels' luminances."""
    bright = colours.numpy()[:, 1][illuminated.numpy()]
    if not len(bright):
        return float(TINY)
    rank = len(bright) - 1 - int(BRIGHTEST_SHARE * len(bright))
    return float(max(FLOOR * float(np.partition(bright, rank)[rank]), TINY))


def contrasts(xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the largest ‖ΔXYZ‖ between each pixel and its four direct neighbours, shape (height, width)."""
    result = np.zeros(xyz.shape[:2], dtype=np.float32)
    for axis in range(2):
        steps, most = lengths(np.diff(xyz, axis=axis)), np.moveaxis(result, axis, 0)
        steps = np.moveaxis(steps, axis, 0)
        np.maximum(most[1:], steps, out=most[1:])
        np.maximum(most[:-1], steps, out=most[:-1])
    return result
