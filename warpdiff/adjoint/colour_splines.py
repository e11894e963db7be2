"""Weights with which values on the rings of a polar grid are summed to a colour: splines fitted to colour curves.

λ is the wavelength. A ring of the grid is a circle of constant frequency |(u, v)|/λ, where (u, v) are the tangential
components of the scattering vector. For one direction, a ring therefore stands for one wavelength. A colour curve is
the product of illuminant and colour-matching function over the wavelength.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.threads import single_threaded_blas
from warpdiff.optics import colorimetry
from warpdiff.optics.colorimetry import VISIBLE_NM
from warpdiff.tables.colour_curves import spline

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Number of intervals into which the distance of two neighbouring rings of the polar grid is divided. A ring is a circle
# of constant |(u, v)|/λ. The weights of the rings in a colour depend on the position of the longest wavelength between
# two rings. They are tabulated at the ends of the intervals and interpolated linearly. The error is 1/(8 · 64²) = 3e-5
# of the second difference of the weights.
_INTERVALS = 64
# Number of samples of the colour curves (illuminant times colour-matching function) in each of the `_INTERVALS` parts
# of the distance of two neighbouring rings of the polar grid. A ring is a circle of constant |(u, v)|/λ.
_SAMPLES = 4
# Width of the range of visible wavelengths in ln λ.
_SPAN = math.log(colorimetry.LAMBDA_MAX_NM / colorimetry.LAMBDA_MIN_NM)


def ring_count(rings_per_octave: int) -> int:
    """Return the number of rings (circles of constant |(u, v)|/λ) that a colour sums: the visible ones, and four."""
    return math.ceil(_SPAN * rings_per_octave / math.log(2.0)) + 4


@functools.lru_cache(maxsize=16)
@single_threaded_blas()
def curve_weights(illuminant: colorimetry.Illuminant, rings_per_octave: int) -> NDArray[np.float64]:
    """Return the coefficients of quadratic splines over ln λ that are fitted to the colour curves by least squares.

    Args:
        illuminant: Illuminant. A colour curve is the product of illuminant and colour-matching function.
        rings_per_octave: Number of rings (circles of constant |(u, v)|/λ) per factor of 2 in the frequency. Each ring
            stands for a wavelength of a direction, and is a knot of the splines.

    Returns:
        Weights of the values at consecutive rings in X, Y and Z, shape (intervals + 1, rings, 3). The first axis is the
        fractional position f of the rings, 0 to 1: ring m lies m + f − 2 ring spacings from the longest visible
        wavelength, towards shorter wavelengths. The value at a ring is the integral over ln λ of the reflectance
        spectrum times the spline of this ring.
    """
    step, count = math.log(2.0) / rings_per_octave, ring_count(rings_per_octave)
    per_ring = _INTERVALS * _SAMPLES
    positions = (np.arange((count + 4) * per_ring) + 0.5) / per_ring - 4.0
    wavelengths = colorimetry.LAMBDA_MAX_NM * np.exp(-positions * step)
    products = colorimetry.colour_products(illuminant)
    # The splines are functions of ln λ. The colour curves are multiplied by λ, because dλ = λ d ln λ.
    curves = wavelengths[:, None] * np.stack(
        [np.interp(wavelengths, VISIBLE_NM, column, left=0.0, right=0.0) for column in products.T], axis=1
    )
    gram = _gram(count)
    result = np.empty((_INTERVALS + 1, count, 3))
    for interval in range(_INTERVALS + 1):
        centres = np.arange(count) + interval / _INTERVALS - 2.0
        first = np.rint((centres - 1.5 + 4.0) * per_ring).astype(int)
        samples = np.arange(3 * per_ring)
        weights = spline((samples + 0.5) / per_ring - 1.5) / per_ring
        moments = np.einsum("s,msc->mc", weights, curves[first[:, None] + samples])
        result[interval] = np.linalg.solve(gram, moments)
    # The weights of the rings (circles of constant |(u, v)|/λ) are scaled so that a constant spectrum has exactly the
    # colour of white.
    result *= products.sum(axis=0) / (step * result.sum(axis=1, keepdims=True))
    result.setflags(write=False)
    return result


def _gram(count: int) -> NDArray[np.float64]:
    """Return the integrals of the products of quadratic splines at ``count`` consecutive knots, (count, count)."""
    distances = np.abs(np.arange(count)[:, None] - np.arange(count))
    values = np.array([11.0 / 20.0, 13.0 / 60.0, 1.0 / 120.0])
    return np.where(distances < len(values), values[np.minimum(distances, 2)], 0.0)
