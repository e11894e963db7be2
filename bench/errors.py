"""The errors that charts and frames are judged by, of colours (n, 3) against exact ones."""

from __future__ import annotations

import warnings

import numpy as np


def relative(found: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """The design's, (n,): ‖ΔXYZ‖ / max(‖XYZ‖, f), f a thousandth of the 99th percentile of Y."""
    size = np.maximum(np.linalg.norm(exact, axis=1), 1e-3 * np.percentile(exact[:, 1], 99.0))
    return np.asarray(np.linalg.norm(found - exact, axis=1) / size)


def colour_difference(found: np.ndarray, exact: np.ndarray) -> float:
    """99th percentile of ΔE2000 against D65, of what is at most 1 exposed so that the 99th percentile of Y is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour
    exposure = 1.0 / np.percentile(exact[:, 1], 99.0)
    inside = exact[:, 1] * exposure <= 1.0
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    labs = [colour.XYZ_to_Lab(np.float64(each[inside]) * exposure, white) for each in (found, exact)]
    return float(np.percentile(colour.delta_E(*labs, method="CIE 2000"), 99.0))
