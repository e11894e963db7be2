"""Error model: estimates the error of a pixel from the error that the plan predicts and from its subpixel cells.

The constants were fitted such that the estimates bound 95 % of the errors of pictures, relative to pictures with many
rays per pixel: see docs/decisions/error_estimates.md.

The plan holds the numbers of a computation, such as wavelengths, and predicts the error that they cause. Y* is the
luminance to which errors are relative, about that of the brightest pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff.kernels.thresholds import FLOOR, PERCENTILE, TINY

if TYPE_CHECKING:
    from numpy.typing import NDArray

# The estimated relative error of a pixel is the error that the plan (numbers of the computation) predicts at the 99th
# percentile of directions, times a (c/‖XYZ‖)^(1/8). Here c is the largest ‖ΔXYZ‖ between the pixel and its four
# neighbours, and a is this number. It is below 1, because a pixel averages many directions. The number was fitted as
# the module's docstring describes.
_MEAN_ERROR_PER_PLAN_ERROR = 0.32
# A pixel has two independent errors: the error of the colours, and the error of the subdivision into subpixel cells.
# The root of the sum of their squares is multiplied by this factor, so that the product bounds 95 % of all errors. The
# factor was fitted as the module's docstring describes.
_BOUND_OF_BOTH = 1.1

# `_FILTER_OF_TEXTURES` is the relative error that the filtering of textures causes in a pixel. `_MOST_OF_TOLERANCE` is
# the largest fraction of the tolerance that counts as this error. The error does not depend on the tolerance: pictures
# at tolerances of 0.1 and 0.03 have the same errors, because nearly all of their pixels with distant textures have
# equally many subpixel cells. The error was fitted to bound 90 % of the errors of pixels with distant textures
# (docs/decisions/textures.md).
_FILTER_OF_TEXTURES, _MOST_OF_TOLERANCE = 0.01, 0.33

# Model of the probability that the true error of a pixel exceeds the tolerance. Its odds are `_ODDS_AT_TOLERANCE` · rᵖ.
# Here r is the estimated error divided by the tolerance, and p is `_ODDS_POWER`. Both values were fitted as the
# module's docstring describes.
_ODDS_AT_TOLERANCE, _ODDS_POWER = 0.01, 4.0


@dataclass(frozen=True)
class ErrorParts:
    """Quantities from which the errors ‖ΔXYZ‖ of n pixels are estimated.

    Attributes:
        xyz: Colours of the pixels, shape (n, 3).
        contrasts: Largest difference ‖ΔXYZ‖ from a neighbouring pixel, shape (n,). None for colours of single
            directions, which are not averages over a pixel.
        cells: Error ‖ΔXYZ‖ that remains after the subdivision into subpixel cells, shape (n,). None without
            subdivision.
        textures: Relative error that the filtering of textures causes; 0 without textures.
    """

    xyz: NDArray[np.float32]
    contrasts: NDArray[np.float32] | None = None
    cells: NDArray[np.float32] | None = None
    textures: float = 0.0


@np.errstate(under="ignore")
def combined_errors(parts: ErrorParts, plan_error: float) -> NDArray[np.float64]:
    """Return the estimated errors ‖ΔXYZ‖ of pixels. ``plan_error`` is the relative error that the plan predicts."""
    # The relative error that the plan predicts is an error of colours, from tables or from sums over wavelengths. This
    # error is proportional to the colour.
    size = lengths(parts.xyz).astype(np.float64)
    errors = plan_error * size
    if parts.contrasts is not None:
        errors = _MEAN_ERROR_PER_PLAN_ERROR * plan_error * np.sqrt(np.sqrt(np.sqrt(size**7 * parts.contrasts)))
    if parts.cells is not None:
        # The errors of the colours and of the subpixel cells are independent of each other, so that their squares add.
        errors = _BOUND_OF_BOTH * np.hypot(errors, parts.cells)
    if parts.textures > 0.0:
        errors = np.hypot(errors, parts.textures * size)
    return errors


def texture_error(tolerance: float) -> float:
    """Return the relative error that the filtering of textures causes in a picture with the given tolerance."""
    return min(_FILTER_OF_TEXTURES, _MOST_OF_TOLERANCE * tolerance)


def lengths(xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return ‖XYZ‖ of colours (…, 3); ``np.linalg.norm`` is three times as slow for a last axis of length 3."""
    return np.asarray(np.sqrt(np.einsum("...c,...c->...", xyz, xyz)))


def relative_errors(errors: NDArray[np.floating[Any]], xyz: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the relative errors of illuminated points: ‖ΔXYZ‖ (n,) divided by max(‖XYZ‖, f · Y*), for XYZ (n, 3).

    The function :func:`luminance_floor` returns f · Y*.
    """
    return np.asarray(errors / np.maximum(lengths(xyz), luminance_floor(xyz[:, 1])), dtype=np.float32)


def luminance_floor(luminance: NDArray[np.floating[Any]]) -> float:
    """Return f · Y*, the luminance to which errors of illuminated points are relative if the points are darker.

    Here f is 1e-3, and Y* is the 99th percentile of the luminances Y (n,), or the median of Y weighted by Y if this
    median is larger.
    """
    ordered = np.sort(luminance)
    white: float = 0.0
    if len(ordered):
        total = np.cumsum(ordered, dtype=np.float64)
        median = ordered[min(np.searchsorted(total, 0.5 * total[-1]), len(total) - 1)]
        white = max(float(ordered[math.ceil(PERCENTILE * len(ordered)) - 1]), float(median))
    return float(max(FLOOR * white, TINY))


def share_beyond(error: NDArray[np.float32], tolerance: float) -> float:
    """Return the expected fraction of pixels whose true error exceeds a tolerance, by the estimated errors (n,)."""
    if not error.size:
        return 0.0
    odds = _ODDS_AT_TOLERANCE * (error.astype(np.float64) / tolerance) ** _ODDS_POWER
    return float(np.mean(odds / (1.0 + odds)))
