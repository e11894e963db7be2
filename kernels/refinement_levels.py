"""Refinement levels: subpixel cells, the pixel filter, and error factors between levels.

Plain numbers, without Warp, for kernels and for those who launch them.
"""

import math

from warpdiff.kernels.thresholds import PERCENTILE

# The pixel's filter, a Gaussian: its deviation, and where it is cut, along each axis [pixels].
FILTER_SIGMA, FILTER_CUT = 0.5, 1.5
# Share of the filter in each of three pixels in a row.
_MIDDLE = math.erf(0.5 / (FILTER_SIGMA * math.sqrt(2.0))) / math.erf(FILTER_CUT / (FILTER_SIGMA * math.sqrt(2.0)))
FILTER_SHARES = (0.5 - 0.5 * _MIDDLE, _MIDDLE, 0.5 - 0.5 * _MIDDLE)
# The finest level: 4,096 cells per pixel, so that the filter covers 36,864 with the eight pixels around.
MOST_LEVEL = 6
LEVELS = range(1, MOST_LEVEL + 1)
# From this tolerance on, the finest level is one lower: the error that remains is within the tolerance.
COARSE_TOLERANCE = 0.05
# Points, which have no filters, begin at this level: nothing else indicates how much they differ.
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
# The error of a mean over samples is taken to be so many of its standard deviations.
SCATTER_FACTOR = 1.5
# Share of the illuminated pixels that are brighter than Y*; errors are relative to at least FLOOR · Y*. Reported
# errors use the median of Y, weighted by Y, where it is larger. Refinement does not, and is at least as strict.
BRIGHTEST_SHARE = 1.0 - PERCENTILE


def rays_at(level: int) -> int:
    """Cells of a pixel at a level."""
    return 1 << 2 * level
