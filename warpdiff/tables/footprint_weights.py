"""Weights of footprint look-ups: taps over azimuth samples and rings, and the parts of a long footprint."""

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

# Look-ups blur by what remains between two levels: its variance is at most 3 · 1.2² spacings squared.
_REMAINING_BLURS, _MOST_REMAINING_VARIANCE = 96, 4.4
# Blur of a spectrum under a window in a level, in distances of azimuth samples: about 1.1, and 0.9 to 2.1 in level 0.
_OWN_BLUR_SPACINGS = 1.1
# A spline's coefficients are sums of the values around them times these, which fall to 1e-6.
_PREFILTER = np.array(quadratic_spline.prefilter(8))
# Number of positions between two nodes for which tap weights are computed.
_TAP_POSITIONS = 64
# Variance within one of several parts of a footprint, times their number.
_VARIANCE_WITHIN_PARTS = 1.2


@dataclass(frozen=True)
class TapRule:
    """Choice of the taps that stand for a Gaussian between azimuth samples or rings.

    Attributes:
        radius_sigmas: Standard deviations of the blur that taps reach at least.
        weigh: Function of the samples' places from the Gaussian's middle, (n, m), and of its variance, both in
            distances of samples, that returns their weights, (n, m).
    """

    radius_sigmas: float
    weigh: Callable[[NDArray[np.float64], float], NDArray[np.float64]]


@functools.cache
def footprint_taps(device: str, rule: TapRule) -> Any:
    """The struct ``FootprintTaps`` of the kernels by a rule, on the device of a name."""
    result = colour_lookup.FootprintTaps()
    weights, lengths = _tap_weights(2 * colour_lookup.HALF_TAPS, rule)
    result.weights = wp.array(weights, dtype=wp.float32, device=device)
    result.lengths = wp.array(lengths, dtype=wp.int32, device=device)
    result.per_variance = (_REMAINING_BLURS - 1) / _MOST_REMAINING_VARIANCE
    result.parts = wp.array(_parts(colour_lookup.MOST_PARTS), dtype=wp.float32, device=device)
    return result


@functools.cache
def _parts(most: int) -> NDArray[np.float64]:
    """The normal distribution as 1 … ``most`` narrower ones: their variance, places and weights, (most, 3, most).

    Places and weights are those of Gauss and Hermite, so that moments up to 2 count − 1 are kept.
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
    """Weights of the azimuths around a place, (variances, fractions, most), and how many of them count.

    The fraction is how far the place lies from the middle of these.
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
    """Weights of the spline's coefficients under a Gaussian, which is cut off where they end."""
    # So far out that the widest does not come round, as transforms do.
    fine = np.arange(-1024, 1024) / 64.0
    square = (2.0 * math.pi * np.fft.rfftfreq(len(fine), fine[1] - fine[0])) ** 2
    blurred = np.fft.irfft(np.fft.rfft(spline(fine)) * np.exp(-0.5 * square * variance), len(fine))
    weights = np.interp(places, fine, blurred)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _closest(places: NDArray[np.float64], variance: float) -> NDArray[np.float64]:
    """Weights of these coefficients that make the best of a Gaussian of the spectrum's own blur, wherever it lies.

    Its sum with the weights, a function of where it lies, is the Gaussian that is blurred as closely as can be (least
    squares), and has its area, mean and variance.
    """
    # Products of a coefficient and of what is wanted, integrated over where the Gaussian lies.
    inverse = _inverse_products(places.shape[1])
    weights = _filtered(places, _PREFILTER, 2.0 * _OWN_BLUR_SPACINGS**2 + variance) @ inverse
    powers = places[:, None, :] ** np.arange(3)[:, None]
    lacking = np.array([1.0, 0.0, variance + 0.25]) - np.einsum("nm,nkm->nk", weights, powers)
    changes = powers @ inverse
    multipliers = np.linalg.solve(changes @ powers.transpose(0, 2, 1), lacking[..., None])
    return np.asarray(weights + np.einsum("nk,nkm->nm", multipliers[..., 0], changes))


@functools.cache
def _inverse_products(count: int) -> NDArray[np.float64]:
    """The inverse of the products of two of so many coefficients, integrated over where the Gaussian lies."""
    order = np.arange(float(count))
    products = _filtered(order[:, None] - order, np.convolve(_PREFILTER, _PREFILTER), 2.0 * _OWN_BLUR_SPACINGS**2)
    return np.asarray(np.linalg.inv(products), dtype=np.float64)


def _filtered(at: NDArray[np.float64], filters: NDArray[np.float64], variance: float) -> NDArray[np.float64]:
    """A Gaussian, once it has gone through filters."""
    away = at[..., None] - (np.arange(len(filters)) - len(filters) // 2)
    gaussian = np.exp(-0.5 * away**2 / variance)
    return np.asarray(gaussian @ filters / math.sqrt(2.0 * math.pi * variance))


# The flanks of a source's lines are visible on their own, so that taps reach further.
SPECTRUM_TAPS, LINE_TAPS = TapRule(2.5, _closest), TapRule(3.1, _cut_off)
