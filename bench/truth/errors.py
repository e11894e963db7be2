"""Error measures of colours (n, 3) relative to exact colours."""

from __future__ import annotations

import math
import warnings

import numpy as np

# Floor f of relative errors, as a share of the reference luminance Y*. For colours that are darker than the floor, the
# error is relative to the floor. If the share is doubled, the errors of more dim directions appear too small.
FLOOR = 1e-3


def reference_luminance(luminance: np.ndarray, weights: np.ndarray | None = None) -> float:
    """Return the reference luminance Y*: the larger of the 99th percentile of Y and the median of Y weighted by Y."""
    weights = np.ones(len(luminance)) if weights is None else weights
    return max(percentile(luminance, weights, 0.99), percentile(luminance, weights * luminance, 0.5))


def percentile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """Return a weighted percentile: the value below which the share ``share`` of the weights lies; 0 without values."""
    if not len(values) or not weights.sum() > 0.0:
        return 0.0
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][min(np.searchsorted(total, share * total[-1] * (1.0 - 1e-12)), len(values) - 1)])


def relative(xyz: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Return relative errors (n,): ‖ΔXYZ‖ / max(‖XYZ‖, f), with the luminance f as the floor of the divisor."""
    size = np.maximum(np.linalg.norm(exact, axis=1), FLOOR * reference_luminance(exact[:, 1]))
    return np.asarray(np.linalg.norm(xyz - exact, axis=1) / size)


def colour_difference(xyz: np.ndarray, exact: np.ndarray, brightest: float | None = None) -> float:
    """Return the 99th percentile of the colour differences ΔE2000 from exact colours, under D65.

    Colours with Y > ``brightest`` are excluded. Colours are divided by ``brightest``, so that this luminance is white.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
    brightest = float(np.percentile(exact[:, 1], 99.0)) if brightest is None else brightest
    inside = exact[:, 1] <= brightest
    if not brightest or not inside.any():
        return math.nan
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    labs = [colour.XYZ_to_Lab(np.float64(colours[inside]) / brightest, white) for colours in (xyz, exact)]
    return float(np.percentile(colour.delta_E(*labs, method="CIE 2000"), 99.0))
