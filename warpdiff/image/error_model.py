"""Error model: the estimated error of a pixel from that of its colours and its cells.

The constants bound 95 of 100 errors of pictures against many rays per pixel: see docs/decisions/error_estimates.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.kernels.thresholds import FLOOR, PERCENTILE, TINY

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Error of a mean over a pixel over the 99th percentile of a plan's errors, where the contrast to the neighbours is as
# large as the colour. Fitted: the error of a table grows with the eighth root of the change of colour.
_MEAN_ERROR_PER_PLAN_ERROR = 0.32
# Bound of 95 of 100 errors over the root sum of squares of the errors of cells and of the table (fitted).
_BOUND_OF_BOTH = 1.1

# Odds that a pixel exceeds the tolerance where its estimated error is the tolerance, and the power of the ratio of both
# that they grow by (fitted).
_ODDS_AT_TOLERANCE, _ODDS_POWER = 0.01, 4.0


@dataclass(frozen=True)
class ErrorParts:
    """Parts of the errors ‖ΔXYZ‖ of pixels, each of shape (n,); None is a part that a picture has not.

    Attributes:
        xyz: The colours, (n, 3).
        contrasts: Largest difference from a neighbouring pixel; None for points, which are no means.
        cells: Error that remains after subdivision.
    """

    xyz: NDArray[np.float32]
    contrasts: NDArray[np.float32] | None = None
    cells: NDArray[np.float32] | None = None


@np.errstate(under="ignore")
def combined_errors(parts: ErrorParts, plan_error: float) -> NDArray[np.float64]:
    """Return the estimated errors ‖ΔXYZ‖ of pixels from their parts and the predicted relative error of the plan."""
    # The error of a table, or of sums over wavelengths, is in proportion to the colour.
    size = lengths(parts.xyz).astype(np.float64)
    errors = plan_error * size
    if parts.contrasts is not None:
        errors = _MEAN_ERROR_PER_PLAN_ERROR * plan_error * np.sqrt(np.sqrt(np.sqrt(size**7 * parts.contrasts)))
    if parts.cells is not None:
        # Neither depends on the other.
        errors = _BOUND_OF_BOTH * np.hypot(errors, parts.cells)
    return errors


def lengths(xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return ‖XYZ‖ of colours (…, 3); ``np.linalg.norm`` takes three times as long where the last axis is short."""
    return np.asarray(np.sqrt(np.einsum("...c,...c->...", xyz, xyz)))


def relative_errors(errors: NDArray[np.floating[Any]], xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return errors ‖ΔXYZ‖ (n,) of illuminated points over max(‖XYZ‖, f · Y*), from their XYZ (n, 3)."""
    return np.asarray(errors / np.maximum(lengths(xyz), luminance_floor(xyz[:, 1])), dtype=np.float32)


def luminance_floor(luminance: NDArray[np.floating[Any]]) -> float:
    """Return f · Y* of illuminated points: Y* is a percentile of Y (n,), or its median weighted by Y if larger."""
    ordered = np.sort(luminance)
    white: float = 0.0
    if len(ordered):
        total = np.cumsum(ordered, dtype=np.float64)
        median = ordered[min(np.searchsorted(total, 0.5 * total[-1]), len(total) - 1)]
        white = max(float(ordered[math.ceil(PERCENTILE * len(ordered)) - 1]), float(median))
    return float(max(FLOOR * white, TINY))


def share_beyond(error: NDArray[np.float32], tolerance: float) -> float:
    """Return the share of pixels that are expected to err by more than a tolerance, from their estimated errors."""
    if not error.size:
        return 0.0
    odds = _ODDS_AT_TOLERANCE * (error.astype(np.float64) / tolerance) ** _ODDS_POWER
    return float(np.mean(odds / (1.0 + odds)))
