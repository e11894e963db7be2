"""Weights with which look-ups add azimuths and rings of a mip level, and the parts of a long footprint.

Azimuths are the samples along a ring of the table's polar grid. The footprint of a pixel is the Gaussian over (u, v)
over which its colour is averaged. Taps are the samples that a look-up adds.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from warpdiff.kernels import colour_lookup, quadratic_spline
from warpdiff.tables.colour_curves import spline

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

# A mip level is blurred less than the footprint of a pixel. The look-up adds the remaining blur by tabulated weights.
# `_REMAINING_BLURS` is the number of variances of this blur for which weights are tabulated. `_MOST_REMAINING_VARIANCE`
# is the largest of these variances [squared distances of neighbouring samples]. It was derived from the blur of a
# level, whose standard deviation b doubles from level to level. The remaining variance is therefore less than (2b)² −
# b² = 3b². Because b is at most 1.2 distances of samples, the value must exceed 3 · 1.2².
_REMAINING_BLURS, _MOST_REMAINING_VARIANCE = 96, 4.4
# Typical standard deviation of the blur of the power spectrum in a mip level (copy of the table), in distances of
# azimuth samples. In level 0, it is at least 0.9, the smallest number of samples per standard deviation. The weights
# for spectra under a window are fitted to this blur.
_OWN_BLUR_SPACINGS = 1.1
# Weights of the filter that converts sampled values to coefficients of quadratic splines; the outermost are about 1e-6.
_PREFILTER = np.array(quadratic_spline.prefilter(8))
# Number of positions between two neighbouring samples of a colour table for which the weights of taps (the samples that
# a look-up adds) are tabulated.
_TAP_POSITIONS = 64
# A long footprint is represented by a sum of n narrower Gaussians, its parts. The variance of a part is the variance of
# the whole footprint, times this number divided by n. If the number is doubled, parts become 1.4 times as wide, and
# polar coordinates, which are linearised within a part, become less accurate.
_VARIANCE_WITHIN_PARTS = 1.2


@dataclass(frozen=True)
class TapRule:
    """Rule for the weights of taps: the samples of a table of which a Gaussian blur computes the weighted sum.

    Attributes:
        radius_sigmas: Smallest extent of the taps on either side, in standard deviations of the blur.
        weigh: Function that returns the weights of samples, shape (n, m). Its arguments are the positions of the
            samples relative to the centre of the Gaussian, shape (n, m), and the variance of the Gaussian. Their unit
            is the distance of neighbouring samples.
    """

    radius_sigmas: float
    weigh: Callable[[NDArray[np.float64], float], NDArray[np.float64]]


@functools.cache
def footprint_taps(device: str, rule: TapRule) -> Any:
    """Return the struct ``FootprintTaps``: weights with which look-ups add samples of a table around a position."""
    result = colour_lookup.FootprintTaps()
    weights, lengths = _tap_weights(2 * colour_lookup.HALF_TAPS, rule)
    result.weights = wp.array(weights, dtype=wp.float32, device=device)
    result.lengths = wp.array(lengths, dtype=wp.int32, device=device)
    result.per_variance = (_REMAINING_BLURS - 1) / _MOST_REMAINING_VARIANCE
    result.parts = wp.array(_parts(colour_lookup.MOST_PARTS), dtype=wp.float32, device=device)
    return result


@functools.cache
def _parts(most: int) -> NDArray[np.float64]:
    """Return approximations of the standard normal distribution by sums of 1 … ``most`` narrower Gaussians.

    The result has the shape (most, 3, most). The entry for a number of Gaussians has three rows: the variance of these
    Gaussians, their positions and their weights.
    """
    result = np.zeros((most, 3, most))
    for count in range(1, most + 1):
        within = min(1.0, _VARIANCE_WITHIN_PARTS / count)
        places, weights = np.polynomial.hermite_e.hermegauss(count)
        result[count - 1, 0] = within
        result[count - 1, 1, :count] = math.sqrt(1.0 - within) * places
        result[count - 1, 2, :count] = weights / weights.sum()
    return result


def _tap_weights(most: int, rule: TapRule) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the weights of taps (samples that a look-up adds), and the number of taps for each tabulated variance.

    The shape of the weights is (variances, positions, most). A tabulated position is the centre of the Gaussian
    relative to the centre of the taps, from −1/2 to 1/2 distances of neighbouring samples.
    """
    fractions = (np.arange(_TAP_POSITIONS) + 0.5) / _TAP_POSITIONS - 0.5
    weights = np.zeros((_REMAINING_BLURS, _TAP_POSITIONS, most))
    lengths = np.zeros(_REMAINING_BLURS, dtype=np.int32)
    for index in range(_REMAINING_BLURS):
        variance = index / (_REMAINING_BLURS - 1) * _MOST_REMAINING_VARIANCE
        count = min(math.ceil(2.0 * rule.radius_sigmas * math.sqrt(variance + 0.25)), most)
        weights[index, :, :count] = rule.weigh(np.arange(count) - (count - 1) / 2.0 - fractions[:, None], variance)
        lengths[index] = count
    return weights.astype(np.float32), lengths


@np.errstate(under="ignore")
def _cut_off(places: NDArray[np.float64], variance: float) -> NDArray[np.float64]:
    """Return the weights of spline coefficients whose weighted sum is the value of the spline, blurred by a Gaussian.

    The Gaussian is truncated at the outermost coefficient.
    """
    # The blur is computed by a discrete Fourier transform, which treats the blurred spline as periodic. The period
    # extends to 16 sample distances from the centre. There even the widest Gaussian is negligible, so that its periodic
    # copies do not overlap.
    fine = np.arange(-1024, 1024) / 64.0
    square = (2.0 * math.pi * np.fft.rfftfreq(len(fine), fine[1] - fine[0])) ** 2
    blurred = np.fft.irfft(np.fft.rfft(spline(fine)) * np.exp(-0.5 * square * variance), len(fine))
    weights = np.interp(places, fine, blurred)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _closest(places: NDArray[np.float64], variance: float) -> NDArray[np.float64]:
    """Return the weights of spline coefficients whose weighted sum best approximates a blurred spectrum.

    ``places`` are the positions of the coefficients. The spectrum before the blur is a Gaussian with the standard
    deviation ``_OWN_BLUR_SPACINGS``. The weighted sum is fitted to the blurred Gaussian by least squares over all
    positions of the Gaussian. The fitted sum has the exact area, mean and variance.
    """
    # The weights solve the normal equations of the fit. The right-hand side of these equations contains the products of
    # each spline coefficient and the blurred Gaussian, integrated over all positions of the Gaussian.
    inverse = _inverse_products(places.shape[1])
    weights = _filtered(places, _PREFILTER, 2.0 * _OWN_BLUR_SPACINGS**2 + variance) @ inverse
    powers = places[:, None, :] ** np.arange(3)[:, None]
    lacking = np.array([1.0, 0.0, variance + 0.25]) - np.einsum("nm,nkm->nk", weights, powers)
    changes = powers @ inverse
    multipliers = np.linalg.solve(changes @ powers.transpose(0, 2, 1), lacking[..., None])
    return np.asarray(weights + np.einsum("nk,nkm->nm", multipliers[..., 0], changes))


@functools.cache
def _inverse_products(count: int) -> NDArray[np.float64]:
    """Return the inverse matrix of the normal equations by which :func:`_closest` fits ``count`` weights.

    An element of the matrix is the product of two coefficients of the spline through a Gaussian, integrated over the
    position of the Gaussian.
    """
    order = np.arange(float(count))
    products = _filtered(order[:, None] - order, np.convolve(_PREFILTER, _PREFILTER), 2.0 * _OWN_BLUR_SPACINGS**2)
    return np.asarray(np.linalg.inv(products), dtype=np.float64)


def _filtered(at: NDArray[np.float64], filters: NDArray[np.float64], variance: float) -> NDArray[np.float64]:
    """Return a Gaussian with the area 1, convolved with the discrete filter ``filters``, at the positions ``at``."""
    away = at[..., None] - (np.arange(len(filters)) - len(filters) // 2)
    gaussian = np.exp(-0.5 * away**2 / variance)
    return np.asarray(gaussian @ filters / math.sqrt(2.0 * math.pi * variance))


# Taps are the samples that a look-up adds. For spectral lines they extend further than for a smooth spectrum under a
# coherence window, because the tails of single lines are visible.
SPECTRUM_TAPS, LINE_TAPS = TapRule(2.5, _closest), TapRule(3.1, _cut_off)
