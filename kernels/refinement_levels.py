"""Refinement levels: subpixel cells, the pixel filter, and the error model of refinement.

The module does not import Warp, so that the host can use its numbers without loading Warp.
"""

import math

from warpdiff.kernels.thresholds import PERCENTILE

# Standard deviation of the pixel filter, a Gaussian, and its truncation along each axis [pixels]. Choices: with twice
# the deviation, pictures are blurred; with twice the truncation, a cell would contribute to more than nine pixels.
FILTER_SIGMA, FILTER_CUT = 0.5, 1.5
# Integrals of a pixel's filter over the previous pixel, the pixel itself and the next pixel of a row. Derived from
# FILTER_SIGMA and FILTER_CUT.
_MIDDLE = math.erf(0.5 / (FILTER_SIGMA * math.sqrt(2.0))) / math.erf(FILTER_CUT / (FILTER_SIGMA * math.sqrt(2.0)))
FILTER_SHARES = (0.5 - 0.5 * _MIDDLE, _MIDDLE, 0.5 - 0.5 * _MIDDLE)
# The finest level of refinement, with 4,096 cells per pixel. Limit: each level has four times as many cells as the
# level before, and takes four times as long.
MOST_LEVEL = 6
LEVELS = range(1, MOST_LEVEL + 1)
# Tolerance at and above which the finest level of subpixel cells is MOST_LEVEL − 1. Limit: errors that remain at that
# level are smaller than this tolerance.
COARSE_TOLERANCE = 0.05
# Least level of refinement of pictures without footprints. Limit: with one ray per pixel, the variation of colours
# within a pixel is unknown.
LEAST_LEVEL_OF_POINTS = 2
# Estimated error of a pixel with one ray, divided by the contrast with its neighbours: CONTRAST_BASE +
# CONTRAST_PER_UNEVENNESS · unevenness + CONTRAST_PER_CHANGE · change. The unevenness is the relative difference between
# successive changes of (u, v); the change is that of (u, v) per pixel relative to |(u, v)|. Fitted to bound 95 of 100
# pixels (docs/decisions/adaptive_sampling.md); twice as much refines more pixels.
CONTRAST_BASE, CONTRAST_PER_UNEVENNESS, CONTRAST_PER_CHANGE = 0.008, 0.52, 0.55
# Estimated error of the filter of textures in a pixel with one ray, divided by the contrast that textures cause with
# its neighbours. Fitted to bound 95 of 100 pixels (docs/decisions/textures.md); twice as much refines more pixels.
CONTRAST_OF_TEXTURE = 0.2
# The level of a tile is selected from the predicted change of its colour if its cells were finer. This change is
# multiplied by the first number, and at edges also by the second. A tile is at an edge if it and its neighbours have
# both illuminated cells and dark or empty ones. Fitted to the snake, tested on other bodies and surfaces
# (docs/decisions/adaptive_sampling.md); twice as large factors require 1.4 times as many cells per axis.
CAUTION, EDGE_FACTOR = 2.0, 1.5
# A refined pixel is a weighted sum over the cells of nine tiles: itself and its neighbours. Its estimated error is
# ERROR_PER_CHANGES times the root sum of squares of the errors of these tiles. The error of a tile is assumed to
# decrease as n^−ERROR_ORDER, where n is the number of its cells along an axis. Fitted: 95 of 100 pixels have a smaller
# error.
ERROR_ORDER, ERROR_PER_CHANGES = 1.75, 0.6
# Estimated error of a mean over random samples, divided by the standard deviation of the mean. Limit: with twice the
# value, pictures under sampled lights require four times as many samples.
SCATTER_FACTOR = 1.5
# Safety factor on the scatter that one tile contributes to the error of a pixel, when the level of the tile is raised.
# Derived: the error is the root sum of squares of up to four equal contributions. Tested on a snake and a tube
# (docs/decisions/adaptive_sampling.md).
SCATTER_CAUTION = 2.0
# Share of the illuminated pixels that are brighter than the reference luminance Y* of refinement, the 99th percentile
# of Y. Derived: one minus the percentile. The Y* of reported errors may be larger, because it is also at least the
# luminance-weighted median of Y. Refinement is then stricter than the report.
BRIGHTEST_SHARE = 1.0 - PERCENTILE


def rays_at(level: int) -> int:
    """Return the number of subpixel cells of a pixel at a level of refinement, each with its own ray."""
    return 1 << 2 * level
