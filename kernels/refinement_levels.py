"""Refinement levels: subpixel cells, the pixel filter, and the error model of refinement.

Level n divides a pixel into 2ⁿ × 2ⁿ subpixel cells, each with its own ray. A tile is a pixel that is divided into
cells.

The module does not import Warp, so that Python code can use these numbers without loading Warp.

(u, v) are the tangential components of the scattering vector −ωi − ωr, where ωi and ωr are the unit vectors to the
light and to the viewer.
"""

import math

from warpdiff.kernels.thresholds import PERCENTILE

# Standard deviation of the pixel filter, a Gaussian, and distance at which it is truncated along each axis [pixels].
# The values were chosen freely. With twice the deviation, pictures are blurred; with twice the truncation, a cell would
# contribute to more than nine pixels.
FILTER_SIGMA, FILTER_CUT = 0.5, 1.5
# Integrals of the Gaussian filter of a pixel over the previous pixel, the pixel itself and the next pixel of a row.
# They are derived from FILTER_SIGMA and FILTER_CUT.
_MIDDLE = math.erf(0.5 / (FILTER_SIGMA * math.sqrt(2.0))) / math.erf(FILTER_CUT / (FILTER_SIGMA * math.sqrt(2.0)))
FILTER_SHARES = (0.5 - 0.5 * _MIDDLE, _MIDDLE, 0.5 - 0.5 * _MIDDLE)
# The finest level of refinement, with 4,096 subpixel cells per pixel. The value is limited by time: each level has four
# times as many cells as the level before, and requires four times the time.
MOST_LEVEL = 6
LEVELS = range(1, MOST_LEVEL + 1)
# Tolerance at and above which the finest level of subpixel cells is MOST_LEVEL − 1. The value was chosen because errors
# that remain at that level are smaller than this tolerance.
COARSE_TOLERANCE = 0.05
# Least level of refinement if rays show the colours of points, not means over parts of a pixel (footprints). At level
# n, a pixel has 2ⁿ × 2ⁿ subpixel cells with one ray each. The value exceeds 0, because one ray per pixel shows nothing
# of the variation of colours within the pixel.
LEAST_LEVEL_OF_POINTS = 2
# Estimated error of a pixel with one ray, divided by the contrast between the colours of the pixel and its neighbours:
# CONTRAST_BASE + CONTRAST_PER_UNEVENNESS · unevenness + CONTRAST_PER_CHANGE · change. The unevenness is the relative
# difference between successive changes of (u, v); the change is the difference of (u, v) from pixel to pixel, relative
# to |(u, v)|. The numbers were fitted so that the error of 95 of 100 pixels is smaller than estimated
# (docs/decisions/adaptive_sampling.md). If the numbers are doubled, more pixels are refined.
CONTRAST_BASE, CONTRAST_PER_UNEVENNESS, CONTRAST_PER_CHANGE = 0.008, 0.52, 0.55
# Estimated error of the filter of textures in a pixel with one ray, divided by the contrast that textures cause between
# the pixel and its neighbours. The value was fitted so that the error of 95 of 100 pixels is smaller than estimated
# (docs/decisions/textures.md). If the value is doubled, more pixels are refined.
CONTRAST_OF_TEXTURE = 0.2
# The level of a tile (a pixel that is divided into cells) is selected from the predicted change of its colour if its
# cells were smaller. This change is multiplied by CAUTION, and at edges also by EDGE_FACTOR. A tile is at an edge if it
# and its neighbours have both illuminated cells and dark or empty cells. Both factors were fitted to the mesh of a
# snake, and tested on other bodies and surfaces (docs/decisions/adaptive_sampling.md). If CAUTION is doubled, tiles
# require 1.4 times as many cells per axis.
CAUTION, EDGE_FACTOR = 2.0, 1.5
# A refined pixel is a weighted sum over the cells of nine tiles (pixels that are divided into cells): its own tile and
# the tiles of its neighbours. The estimated error of the pixel is ERROR_PER_CHANGES times the root sum of squares of
# the errors of these tiles. The error of a tile is assumed to decrease as n^−ERROR_ORDER, where n is the number of its
# cells along an axis. Both numbers were fitted so that the error of 95 of 100 pixels is smaller than estimated.
ERROR_ORDER, ERROR_PER_CHANGES = 1.75, 0.6
# Estimated error of a mean over random samples, divided by the standard deviation of the mean. The value is limited by
# computing time: if it is doubled, pictures with lights whose directions are drawn at random require four times as many
# samples.
SCATTER_FACTOR = 1.5
# Safety factor for the random scatter that one tile (a pixel that is divided into cells) contributes to the error of a
# pixel, when the level of the tile is raised. The factor was derived from an error to which four tiles contribute
# equally, as a root sum of squares. It was tested on the meshes of a snake and a tube
# (docs/decisions/adaptive_sampling.md).
SCATTER_CAUTION = 2.0
# The reference luminance Y* of refinement is the luminance that this share of the illuminated pixels exceeds. It is the
# 99th percentile of Y, so that the share is one minus this percentile. The Y* of reported errors may be larger, because
# it is also at least the luminance-weighted median of Y. Refinement is then stricter than the report.
BRIGHTEST_SHARE = 1.0 - PERCENTILE


def share_beyond(distance: float) -> float:
    """Return the share of the pixel filter's weight beyond a distance from its centre [pixels], on one side of it."""
    scale = FILTER_SIGMA * math.sqrt(2.0)
    return 0.5 - 0.5 * math.erf(distance / scale) / math.erf(FILTER_CUT / scale)


def rays_at(level: int) -> int:
    """Return the number of subpixel cells of a pixel at a level of refinement, each with its own ray."""
    return 1 << 2 * level
