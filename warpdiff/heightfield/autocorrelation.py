"""Autocorrelation of heights with missing samples, and the lags at which it has decayed to a fifth of its maximum."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.blocks import Block

# The autocorrelation counts as decayed below this value, relative to its value at lag 0. The value is the default of
# ISO 25178-3. If doubled, decay lengths are shorter.
THRESHOLD = 0.2
# Largest lag (shift of the field against itself) along an axis at which the autocorrelation is computed, relative to
# the length of the field. The value is limited by the number of pairs of samples at this distance: at a lag of half of
# the field along both axes, a quarter of the pairs remains. If doubled, a lag may have a single pair of samples.
MOST_LAG = 0.5
# Least number of pairs of samples at a lag, relative to the number of measured samples; lags with fewer pairs are
# ignored. The value is limited by noise: averages over fewer pairs are noise. If doubled, the autocorrelation of more
# fields with gaps is unknown at the lags where it decays, and the texture aspect ratio Str of these fields is unknown.
_LEAST_PAIRS = 0.05
# Step between the points at which the autocorrelation is evaluated on a straight line from the origin [samples]. The
# value was chosen because a minimum of the autocorrelation that is narrower than half a sample is noise. If doubled,
# narrow minima are missed.
_STEP = 0.5
# A decay length is the lag at which the autocorrelation falls to `THRESHOLD`; it depends on the azimuth. `_AZIMUTHS` is
# the number of azimuths over half a turn at which decay lengths are computed first. The azimuths of the shortest and
# the longest decay length are then refined `_LEVELS` times, with `_AZIMUTHS_OF_LEVEL` closer azimuths each time. The
# numbers were chosen so that the last azimuths are 0.001° apart. The texture aspect ratio Str, if it is at least 0.001,
# is then exact to 1 %. If the numbers of azimuths are doubled, the time doubles.
_AZIMUTHS, _LEVELS, _AZIMUTHS_OF_LEVEL = 360, 3, 17
# The standard errors of decay lengths come from a jackknife: decay lengths are computed again without one block
# (rectangular part) of the field at a time. Each of these computations begins with this number of azimuths over half a
# turn; closer azimuths follow. With fewer azimuths, the shortest or the longest decay length would be missed. If
# doubled, the time doubles.
AZIMUTHS_OF_PART = 60
# Number of steps of the secant method that finds where the autocorrelation crosses the threshold on a straight line
# from the origin. The value was chosen so that the remaining error of the crossing is far below the error of the
# interpolating spline.
_SECANTS = 4


@dataclass(frozen=True)
class Decay:
    """Distances from lag 0 at which an autocorrelation falls to `THRESHOLD`; azimuths are from x towards y.

    Attributes:
        fastest_um: Shortest distance over all azimuths [µm]; NaN if the autocorrelation does not fall to the threshold
            at any azimuth.
        slowest_um: Longest distance over all azimuths [µm]; a lower bound if ``is_closed`` is False.
        slowest_deg: Azimuth of the longest distance [degrees], 0 to 180.
        is_closed: Whether the autocorrelation falls to the threshold at all azimuths, within the computed lags.
        extents: Largest lags (y, x) of the region around the origin where the autocorrelation exceeds the threshold
            [samples].
    """

    fastest_um: float
    slowest_um: float
    slowest_deg: float
    is_closed: bool
    extents: tuple[float, float]


def lag_sums(
    heights: NDArray[np.float64], known: NDArray[np.bool_], block: Block, reach: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """For each lag, sum the products of heights of all pairs of samples in a block of the field, and count the pairs.

    A pair of samples counts half in the block of each of its samples, so that the sums of all blocks add up to the sum
    over the whole field.

    Args:
        heights: Heights of the field minus their mean, 0 where a sample is missing, shape (ny, nx).
        known: Mask of the measured samples, shape (ny, nx).
        block: Slices of the rows and columns of the field that the block contains.
        reach: Largest lags (y, x) [samples].

    Returns:
        Sums of products, and numbers of pairs, shape (2 · reach_y + 1, 2 · reach_x + 1) each, with lag 0 in the centre.
    """
    from scipy import fft

    own = tuple(part.stop - part.start for part in block)
    around, inner = [], []
    for part, n, most in zip(block, heights.shape, reach, strict=True):
        low, high = max(part.start - most, 0), min(part.stop + most, n)
        around.append(slice(low, high))
        inner.append(slice(low - part.start + most, high - part.start + most))
    size = tuple(n + 2 * most for n, most in zip(own, reach, strict=True))
    padded = tuple(fft.next_fast_len(n, real=True) for n in size)

    def correlated(values: NDArray[np.float64]) -> NDArray[np.float64]:
        large = np.zeros(size)
        large[inner[0], inner[1]] = values[around[0], around[1]]
        spectrum = fft.rfft2(large, padded) * np.conj(fft.rfft2(values[block], padded))
        sums = np.asarray(fft.irfft2(spectrum, padded))[: 2 * reach[0] + 1, : 2 * reach[1] + 1]
        return np.asarray(0.5 * (sums + sums[::-1, ::-1]))

    if known.all():
        overlaps = []
        for part, n, most in zip(block, heights.shape, reach, strict=True):
            lags = np.arange(-most, most + 1)
            count = np.minimum(part.stop + lags, n) - np.maximum(part.start + lags, 0)
            overlaps.append(np.maximum(count, 0).astype(np.float64))
        pairs = np.outer(*overlaps)
        pairs = 0.5 * (pairs + pairs[::-1, ::-1])
    else:
        pairs = np.rint(2.0 * correlated(known.astype(np.float64))) / 2.0
    return correlated(heights), pairs


def decay_of(
    products: NDArray[np.float64], pairs: NDArray[np.float64], pitch_um: tuple[float, float], samples: float,
    azimuths: int = _AZIMUTHS,
) -> Decay:  # fmt: skip
    """Return the distances at which the autocorrelation falls to `THRESHOLD`.

    The distance at an azimuth is the length of the straight line from the origin, at this azimuth, to the first point
    where the autocorrelation crosses the threshold.

    Args:
        products: Sums of the products of heights by lag, as `lag_sums` returns them.
        pairs: Numbers of pairs of samples by lag.
        pitch_um: Distance of the samples (dy, dx) [µm].
        samples: Number of measured samples in the field.
        azimuths: Number of azimuths over half a turn at which distances are computed first. Closer azimuths around the
            shortest and the longest distance follow.
    """
    rays = _Rays(products, pairs, pitch_um, _LEAST_PAIRS * samples)
    angles = np.linspace(0.0, math.pi, azimuths + 1) if min(products.shape) > 1 else np.zeros(1)
    if products.shape[1] == 1:
        angles = np.full(1, math.pi / 2.0)
    lengths, crosses = rays.lengths(angles)
    extents = (
        float(np.max(lengths * np.abs(np.sin(angles)))), float(np.max(lengths * np.abs(np.cos(angles)))),
    )  # fmt: skip
    distances = lengths * rays.scale(angles)
    is_closed = bool(crosses.all())
    fastest = float(np.min(distances[crosses])) if crosses.any() else math.nan
    place = int(np.argmax(distances))
    slowest, slowest_angle = float(distances[place]), float(angles[place])
    if len(angles) > 1:
        step = float(angles[1])
        if crosses.any():
            angle = float(angles[np.argmin(np.where(crosses, distances, np.inf))])
            fastest = min(fastest, _extreme(rays, angle, step, sign=-1.0)[0])
        slowest, slowest_angle, closes = _extreme(rays, slowest_angle, step, sign=1.0)
        is_closed = is_closed and closes
    dy, dx = pitch_um
    directions = np.arctan2(dy * np.sin(angles), dx * np.cos(angles))
    if crosses.all():
        azimuth = math.atan2(dy * math.sin(slowest_angle), dx * math.cos(slowest_angle))
    else:
        # Along the grooves of a surface, the autocorrelation does not fall to the threshold. The direction of the
        # grooves is therefore the mean of the azimuths at which the threshold is not reached. The angles are doubled
        # before averaging, because a direction of grooves is the same after half a turn.
        azimuth = 0.5 * float(np.angle(np.sum(np.exp(2j * directions[~crosses]))))
    return Decay(fastest, slowest, math.degrees(azimuth) % 180.0, is_closed, extents)


def _extreme(rays: _Rays, angle: float, step: float, *, sign: float) -> tuple[float, float, bool]:
    """Refine the azimuth with the longest (``sign`` 1) or the shortest (−1) decay length, near an angle.

    The decay length at an angle is the distance from lag 0, along a straight line (ray), at which the autocorrelation
    falls to `THRESHOLD`. Return the decay length, its angle, and whether the autocorrelation falls to the threshold on
    all rays.
    """
    best, closes = -math.inf, True
    for _ in range(_LEVELS):
        angles = angle + np.linspace(-step, step, _AZIMUTHS_OF_LEVEL)
        lengths, crosses = rays.lengths(angles)
        distances = sign * lengths * rays.scale(angles)
        if sign < 0.0:
            distances[~crosses] = -math.inf
        closes = closes and bool(crosses.all())
        place = int(np.argmax(distances))
        best, angle = max(best, float(distances[place])), float(angles[place])
        step *= 2.0 / (_AZIMUTHS_OF_LEVEL - 1)
    return sign * best, angle, closes


class _Rays:
    """Interpolated autocorrelation on rays, which are straight lines from lag 0.

    Angles and lengths are measured on a grid of lags whose pitch is 1 along both axes.
    """

    def __init__(
        self, products: NDArray[np.float64], pairs: NDArray[np.float64], pitch_um: tuple[float, float], least: float
    ) -> None:
        from scipy import ndimage

        self._pitch = pitch_um
        self._centre = np.array([n // 2 for n in products.shape], dtype=np.float64)
        self._usable = pairs >= max(least, 1.0)
        self._has_gaps = not self._usable.all()
        zero = tuple(n // 2 for n in products.shape)
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.where(self._usable, products / pairs, 0.0) / (products[zero] / pairs[zero])
        # The interpolating spline continues the autocorrelation beyond the largest lags as a mirror image. This affects
        # only values near the largest lags.
        self._spline = ndimage.spline_filter(values, order=3, mode="mirror") if min(values.shape) > 1 else values
        self._line = values.ravel()

    def scale(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the length on the surface [µm] of one unit on the grid of lags (pitch 1), in each direction."""
        dy, dx = self._pitch
        return np.hypot(dy * np.sin(angles), dx * np.cos(angles))

    def lengths(self, angles: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return where the autocorrelation on each ray first falls to `THRESHOLD`, and whether it does.

        A ray is a straight line from lag 0, and the results are distances from lag 0. If the autocorrelation on a ray
        does not fall to the threshold, the result is the distance of the last point of the ray at which the
        autocorrelation is known.
        """
        units = np.stack([np.sin(angles), np.cos(angles)])
        count = math.ceil(float(np.hypot(*self._centre)) / _STEP) + 1
        distances = _STEP * np.arange(count)
        values, usable = self._at(units[:, :, None] * distances)
        ends = ~usable | (values < THRESHOLD)
        ends[:, -1] = True
        first = np.argmax(ends, axis=1)
        rows = np.arange(len(angles))
        crosses = usable[rows, first] & (values[rows, first] < THRESHOLD)
        low, high = distances[np.maximum(first - 1, 0)], distances[first]
        at_low, at_high = values[rows, np.maximum(first - 1, 0)], values[rows, first]
        for _ in range(_SECANTS):
            # The autocorrelation falls to the threshold inside an interval of the ray, which a secant divides at each
            # step. The point of division stays away from both ends, so that the interval becomes shorter at every step.
            with np.errstate(divide="ignore", invalid="ignore"):
                share = np.clip((at_low - THRESHOLD) / (at_low - at_high), 0.1, 0.9)
            middle = np.where(crosses, low + share * (high - low), low)
            at_middle, _ = self._at(units * middle)
            above = at_middle >= THRESHOLD
            low, at_low = np.where(above, middle, low), np.where(above, at_middle, at_low)
            high, at_high = np.where(above, high, middle), np.where(above, at_high, at_middle)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = low + (at_low - THRESHOLD) / (at_low - at_high) * (high - low)
        return np.where(crosses, crossing, distances[np.maximum(first - 1, 0)]), crosses

    def _at(self, lags: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the autocorrelation at lags by interpolation, and whether the autocorrelation is known at each lag.

        The lags have the shape (2, …). The autocorrelation is known at a lag if enough pairs of samples at this
        distance were measured.
        """
        from scipy import ndimage

        # The autocorrelation at a lag is interpolated from values at lags of whole samples. The interpolated value
        # counts as known if the values at the nearest whole lags on both sides are known. Along an axis where the lag
        # itself is a whole number, up to rounding, only the value at this lag counts.
        roundings = (np.floor, 1e-9), (np.ceil, -1e-9)
        places = lags + self._centre.reshape(2, *[1] * (lags.ndim - 1))
        usable = np.ones(lags.shape[1:], dtype=bool)
        for axis, n in enumerate(self._usable.shape):
            usable &= (places[axis] > -1e-9) & (places[axis] < n - 1 + 1e-9)
        if self._has_gaps:
            ends = [
                [np.clip(whole(place + shift).astype(np.intp), 0, n - 1) for whole, shift in roundings]
                for place, n in zip(places, self._usable.shape, strict=True)
            ]
            for row in ends[0]:
                for column in ends[1]:
                    usable &= self._usable[row, column]
        if min(self._usable.shape) > 1:
            values = ndimage.map_coordinates(self._spline, places, order=3, mode="mirror", prefilter=False)
        else:
            axis = int(np.argmax(self._usable.shape))
            values = ndimage.map_coordinates(self._line, places[axis][None], order=3, mode="mirror")
        return np.asarray(values), usable
