"""Refinement levels: subpixel cells, the pixel filter, and error factors between levels.

The module has plain numbers without Warp, for kernels and for the code that launches them.
"""

import math

from warpdiff.kernels.thresholds import PERCENTILE

# Standard deviation of the pixel filter, a Gaussian, and its cut along each axis [pixels]. Choices: with twice the
# deviation, pictures are blurred; with twice the cut, cells reach more than the eight pixels that splats serve.
FILTER_SIGMA, FILTER_CUT = 0.5, 1.5
# Shares of the filter in three pixels in a row, derived from the two numbers above.
_MIDDLE = math.erf(0.5 / (FILTER_SIGMA * math.sqrt(2.0))) / math.erf(FILTER_CUT / (FILTER_SIGMA * math.sqrt(2.0)))
FILTER_SHARES = (0.5 - 0.5 * _MIDDLE, _MIDDLE, 0.5 - 0.5 * _MIDDLE)
# The finest level: 4,096 cells per pixel, 36,864 in the nine pixels of the filter. Limit: each level has four times the
# cells, and time, of the one before.
MOST_LEVEL = 6
LEVELS = range(1, MOST_LEVEL + 1)
# Tolerance from which on the finest level is one lower. Limit: the remaining error is within such a tolerance.
COARSE_TOLERANCE = 0.05
# Base level of pictures without footprints. Limit: one ray per pixel does not show how much the pixel varies.
LEAST_LEVEL_OF_POINTS = 2
# Errors of pixels that are not subdivided, relative to the contrast with their neighbours: a bound for 95 of 100
# pixels. The base share applies where (u, v) is even and changes slowly. Unevenness is the difference between the
# changes of (u, v) from one pixel to the next, relative to the larger one. The last share is proportional to that
# change relative to |(u, v)|. Fitted: see docs/decisions/adaptive_sampling.md.
CONTRAST_BASE, CONTRAST_PER_UNEVENNESS, CONTRAST_PER_CHANGE = 0.008, 0.52, 0.55
# When the level of a tile is selected, its predicted change is multiplied by CAUTION. It is multiplied by EDGE_FACTOR,
# too, where the tile and those around have both cells that are lit and cells that are not. Fitted to the snake; judged
# on other bodies and surfaces (docs/decisions/adaptive_sampling.md).
CAUTION, EDGE_FACTOR = 2.0, 1.5
# Estimated errors fall with this power of the number of cells along an axis, and are so many times the root sum of
# squares over the nine tiles. Fitted: 95 of 100 pixels have a smaller error.
ERROR_ORDER, ERROR_PER_CHANGES = 1.75, 0.6
# Estimated error of a mean over samples [standard deviations]. Limit: twice as much requires four times the samples.
SCATTER_FACTOR = 1.5
# Share of the illuminated pixels that are brighter than Y*; errors are relative to at least FLOOR · Y*. Reported
# errors use the median of Y, weighted by Y, where it is larger. Refinement does not, and is at least as strict.
BRIGHTEST_SHARE = 1.0 - PERCENTILE


def rays_at(level: int) -> int:
    """Return the number of cells of a pixel at a level."""
    return 1 << 2 * level
