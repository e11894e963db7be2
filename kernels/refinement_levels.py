"""Refinement levels: subpixel cells, the pixel filter, and the error model of refinement.

The module has plain numbers without Warp, which kernels and hosts share.
"""

import math

from warpdiff.kernels.thresholds import PERCENTILE

# Standard deviation of the pixel filter, a Gaussian, and its truncation along each axis [pixels]. Choices: with twice
# the deviation, pictures are blurred; with twice the cut, cells contribute to more than the nine pixels of a splat.
FILTER_SIGMA, FILTER_CUT = 0.5, 1.5
# Shares of the pixel filter in three pixels in a row. Derived from FILTER_SIGMA and FILTER_CUT.
_MIDDLE = math.erf(0.5 / (FILTER_SIGMA * math.sqrt(2.0))) / math.erf(FILTER_CUT / (FILTER_SIGMA * math.sqrt(2.0)))
FILTER_SHARES = (0.5 - 0.5 * _MIDDLE, _MIDDLE, 0.5 - 0.5 * _MIDDLE)
# The finest level, with 4,096 cells per pixel and 36,864 under a pixel's filter. Limit: each level has four times the
# cells of the level before, and takes four times the time.
MOST_LEVEL = 6
LEVELS = range(1, MOST_LEVEL + 1)
# Least tolerance at which the finest level is one lower. Limit: the remaining
# error is within tolerances of this size.
COARSE_TOLERANCE = 0.05
# Least level of pictures without footprints. Limit: one ray per pixel does not indicate how much the pixel varies.
LEAST_LEVEL_OF_POINTS = 2
# Estimated error of a pixel with one ray, relative to the contrast with its neighbours, as a sum of three terms. The
# first is constant. The second is proportional to the unevenness of (u, v). The third is proportional to the change of
# (u, v) per pixel relative to |(u, v)|. Unevenness is the relative difference between successive changes of (u, v).
# Fitted to bound 95 of 100 pixels (docs/decisions/adaptive_sampling.md); twice as much refines more pixels.
CONTRAST_BASE, CONTRAST_PER_UNEVENNESS, CONTRAST_PER_CHANGE = 0.008, 0.52, 0.55
# Safety factor on the predicted change of a tile when its level is selected, and a second factor at edges. A tile is at
# an edge if it and its neighbours have both illuminated cells and dark or empty ones. Fitted to the snake, tested on
# other bodies and surfaces (docs/decisions/adaptive_sampling.md); twice as much takes 1.4 times as many cells per axis.
CAUTION, EDGE_FACTOR = 2.0, 1.5
# The estimated error of a refined pixel is ERROR_PER_CHANGES times the root sum of squares over nine tiles. The error
# falls with the number of cells along an axis to the power ERROR_ORDER. Fitted: 95 of 100 pixels have a smaller error.
ERROR_ORDER, ERROR_PER_CHANGES = 1.75, 0.6
# Estimated error of a mean over random samples [standard deviations]. Limit: twice as much requires four times the
# samples.
SCATTER_FACTOR = 1.5
# Share of the illuminated pixels that are brighter than the reference luminance Y*. Derived: one minus the percentile.
# Reported errors replace Y* by the median of Y, weighted by Y, if that is larger. Refinement does not, and is at least
# as strict.
BRIGHTEST_SHARE = 1.0 - PERCENTILE


def rays_at(level: int) -> int:
    """Return the number of cells of a pixel at a level."""
    return 1 << 2 * level
