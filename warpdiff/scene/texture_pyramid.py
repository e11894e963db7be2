"""Texture pyramids: an image and its reductions to half the size, for look-ups that are filtered by footprints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def sizes(height: int, width: int) -> list[tuple[int, int]]:
    """Return height and width of each level of a texture pyramid: half of the previous level, rounded up, down to 1."""
    result = [(height, width)]
    while max(result[-1]) > 1:
        height, width = result[-1]
        result.append(((height + 1) // 2, (width + 1) // 2))
    return result


def pyramid(texels: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Return all levels of the texture pyramid of an image, shape (h, w, channels); the first level is the image.

    A texel is the mean of the previous level over the texel's area. Every level therefore has the same mean.
    """
    levels = [texels]
    for height, width in sizes(*texels.shape[:2])[1:]:
        levels.append(_reduced(_reduced(levels[-1], height, 0), width, 1))
    return levels


def mean_products(one: NDArray[np.float32], two: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the mean over each texel of the product of two images, shape (h, w).

    Both images are interpolated bilinearly, and are repeated beyond their edges.
    """
    # At the distance x from a texel's centre, with 0 < x < 1/2 inside the texel, linear interpolation has the weight
    # 1 − x for this texel and the weight x for its neighbour. The three numbers are the means of the products of these
    # weights, (1 − x)², x (1 − x) and x², over 0 < x < 1/2.
    own, mixed, other = 7.0 / 12.0, 1.0 / 6.0, 1.0 / 12.0

    def along_rows(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.float32]:
        result = own * first * second
        for step in (-1, 1):
            near1, near2 = np.roll(first, step, axis=1), np.roll(second, step, axis=1)
            result += 0.5 * (mixed * (first * near2 + near1 * second) + other * near1 * near2)
        return result

    result = own * along_rows(one, two)
    for step in (-1, 1):
        near1, near2 = np.roll(one, step, axis=0), np.roll(two, step, axis=0)
        result += 0.5 * mixed * (along_rows(one, near2) + along_rows(near1, two))
        result += 0.5 * other * along_rows(near1, near2)
    return result


def _reduced(texels: NDArray[np.float32], size: int, axis: int) -> NDArray[np.float32]:
    """Reduce an image to ``size`` texels along an axis.

    The axis is divided into ``size`` equal parts, and each new texel is the mean over one part. A texel of the image
    that is only partly in a part has a smaller weight, proportional to the overlap.
    """
    before = texels.shape[axis]
    if before == size:
        return texels
    lines = np.moveaxis(texels, axis, 0)
    if before == 2 * size:
        reduced = 0.5 * (lines[0::2] + lines[1::2])
    else:
        # The number of texels is odd: 2 n − 1 texels become n equal parts. Each part overlaps two texels, or three
        # texels if it begins near the middle of a texel.
        edges = np.arange(size + 1) * (before / size)
        first = np.minimum(edges[:-1].astype(np.int64), before - 1)
        reduced = np.zeros((size, *lines.shape[1:]), np.float32)
        for step in range(3):
            at = first + step
            overlap = np.clip(np.minimum(edges[1:], at + 1.0) - np.maximum(edges[:-1], at), 0.0, None)
            share = (overlap * (size / before)).astype(np.float32).reshape(-1, *[1] * (lines.ndim - 1))
            reduced += share * lines[np.minimum(at, before - 1)]
    return np.ascontiguousarray(np.moveaxis(reduced, 0, axis))
