"""Search for lines in the power spectrum of a height field: maxima that rise significantly above the background.

A periodic wave causes a line (a narrow maximum) of the spectrum, and roughness causes the background. Frequencies are
in cycles over the field, as pairs (y, x). The background is not assumed to be white: a line must exceed the spectrum at
lower and at higher frequencies of its own direction. Waviness, correlated roughness, steps between scan lines and
grinding marks are therefore not mistaken for periods.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.heightfield.harmonic_fit import FEWEST_PERIODS, OF_NYQUIST

if TYPE_CHECKING:
    from numpy.typing import NDArray

# The power spectrum is averaged over square boxes before its maxima are searched. `_WIDTHS` are the widths of the boxes
# [cycles over the field]: narrow lines need 1, and the broad lines of waves with a varying phase need more. At least
# `_LEAST_BOXES` boxes must fit along each axis of the spectrum; wider boxes are not used.
_WIDTHS, _LEAST_BOXES = (1, 3, 7, 15, 31), 4
# Accepted probabilities that noise alone is taken for a spectral line. `_FALSE_ALARM` is the probability that this
# happens anywhere in the spectrum, for each width of the boxes over which the spectrum is averaged.
# `_SINGLE_FALSE_ALARM` is the probability at a single known frequency.
_FALSE_ALARM, _SINGLE_FALSE_ALARM = 5e-4, 1e-2
# A broad spectral line must exceed the background around it by at least this factor. Estimates of the background are
# wrong by a smaller factor. If doubled, weak waves with a varying phase are lost.
_LEAST_CONTRAST = 4.0
# A maximum of the spectrum is examined further if noise alone causes it with at most this probability. The power of the
# noise is here the coarse background, which is estimated in rings and sectors of the frequency plane.
_EXAMINED = 1e-3
# Largest number of maxima of the spectrum that are examined for each width of the boxes over which it is averaged. The
# value is limited by time: if doubled, the search takes up to twice as long.
_MOST_CANDIDATES = 40
# The main lobe is the central maximum of the spectrum of the Hann window. The number is the distance from its centre
# [cycles over the field] at which its power is below 1 % of the maximum.
_MAIN_LOBE = 1.8
# The background of a spectral line is estimated from two strips of the spectrum, at lower and at higher frequencies of
# the same direction. `_STRIP` is the half width of each strip, relative to the frequency of the line. `_MOST_ALONG` is
# the largest number of positions along a strip at which the spectrum is read.
_STRIP, _MOST_ALONG = 0.15, 40
# The background of a spectral line is estimated at higher frequencies up to a multiple of the frequency of the line.
# The multiple is 1.8 for fields with several samples along both axes. It is 2.4 for single rows or columns of samples,
# which have fewer Fourier coefficients.
_HIGHEST = (1.8, 2.4)
# The coarse background is estimated in rings and sectors of the frequency plane. `_RINGS` is the number of rings per
# octave of frequency, and `_SECTORS` the number of sectors in half of the plane. At most about `_MOST_SAMPLED` Fourier
# coefficients are used in total: of a larger spectrum, every nth coefficient is used. This number is limited by time;
# if doubled, the estimate takes twice as long.
_RINGS, _SECTORS, _MOST_SAMPLED = 8, 12, 200_000
# At frequencies below this value [cycles over the longer side of the field], all Fourier coefficients are used to
# estimate the coarse background, also in large spectra.
_FEW_CYCLES = 64.0
# The power of the background is modelled as proportional to the frequency to the power −p. These are the smallest and
# the largest accepted exponent p. Values beyond these limits are errors of an estimate from few Fourier coefficients.
_EXPONENTS = (-4.0, 8.0)
# Straight lines in the frequency plane are laid through a maximum of the spectrum, and the power of the maximum is
# compared with the other powers on each line. These are the angles of the lines [rad].
_FAN = np.arange(24) * (math.pi / 24.0)
_FAN_COSINES, _FAN_SINES = np.cos(_FAN), np.sin(_FAN)
# Quantile of the powers in a ring or sector of the frequency plane from which the coarse background is estimated. The
# value is below the median, because at low frequencies a spectral line covers most of a ring.
_QUANTILE = 0.15
# The powers of noise are distributed exponentially. The factors convert the median of powers, and their quantile
# `_QUANTILE`, to the mean of this distribution.
_MEAN_OF_MEDIAN, _MEAN_OF_QUANTILE = 1.0 / math.log(2.0), -1.0 / math.log(1.0 - _QUANTILE)


@dataclass(frozen=True)
class Line:
    """Significant maximum of a power spectrum.

    Attributes:
        cycles: Frequency (y, x) [cycles over the field].
        background: Power of the background per Fourier coefficient at this frequency, estimated from neighbouring
            frequencies.
        exponent: Exponent p of the background, whose power is proportional to the frequency to the power −p.
        excess: Power of the line minus the background, summed over the Fourier coefficients of the line.
    """

    cycles: NDArray[np.float64]
    background: float
    exponent: float
    excess: float

    def background_at(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the background (power without the spectral line) per Fourier coefficient at frequencies near the line.

        Frequencies are in cycles over the field.
        """
        along = (rows * self.cycles[0] + columns * self.cycles[1]) / float(np.sum(self.cycles**2))
        return np.asarray(self.background * np.clip(np.abs(along), 0.3, 3.0) ** -self.exponent)


class WindowedSpectrum:
    """Power spectrum of heights that are multiplied by a Hann window, with the zero frequency in the centre.

    Attributes:
        power: Powers, shape (ny, nx). White noise of variance 1 has a mean power of 1.
        centre: Row and column of the zero frequency in ``power``.
    """

    def __init__(self, heights: NDArray[np.float64]) -> None:
        from scipy import fft

        windows = [np.hanning(n + 2)[1:-1] if n > 1 else np.ones(1) for n in heights.shape]
        scale = math.prod(float(np.sum(window**2)) for window in windows)
        spectrum = fft.fft2(heights * windows[0][:, None] * windows[1])
        self.power = np.fft.fftshift(spectrum.real**2 + spectrum.imag**2) / scale
        self.centre = tuple(n // 2 for n in heights.shape)

    @property
    def _cycles(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Frequencies [cycles over the field] of the rows of ``power``, (ny, 1), and of the columns, (1, nx)."""
        ny, nx = self.power.shape
        return np.arange(ny)[:, None] - self.centre[0], np.arange(nx)[None, :] - self.centre[1]

    def excess(self, line: Line, radius: float) -> float:
        """Return the power minus the background of a spectral line, summed over frequencies within ``radius`` of it."""
        rows, columns = self._window(line.cycles, radius)
        power = self.power[np.ix_(rows + self.centre[0], columns + self.centre[1])]
        rows, columns = rows[:, None], columns[None, :]
        inside = np.hypot(rows - line.cycles[0], columns - line.cycles[1]) <= radius
        return float(np.sum((power - line.background_at(rows, columns))[inside]))

    def around(self, cycles: NDArray[np.float64]) -> float:
        """Return the power around a frequency, summed over the coefficients to which the Hann window spreads a line."""
        place = self._place(cycles)
        return float(np.sum(self.power[self._main_lobe(place)])) if min(place) >= 0 else 0.0

    def line_at(self, cycles: NDArray[np.float64], sizes: NDArray[np.float64]) -> Line | None:
        """Return the narrow spectral line at a known frequency if this line is significant, otherwise None."""
        return self._examined(self._place(cycles), (1, 1), 1.0, _SINGLE_FALSE_ALARM, sizes, 1.0)

    def _place(self, cycles: NDArray[np.float64]) -> tuple[int, int]:
        """Return the row and column of the Fourier coefficient nearest to a frequency in the spectrum ``power``."""
        row, column = (round(float(c)) + centre for c, centre in zip(cycles, self.centre, strict=True))
        return row, column

    @staticmethod
    def _main_lobe(place: tuple[int, int]) -> tuple[slice, ...]:
        """Return slices of the rows and columns around a coefficient over which the Hann window spreads a line."""
        return tuple(slice(max(i - 2, 0), i + 3) for i in place)

    def strongest_within(self, cycles: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
        """Return the frequency [cycles over the field] of the largest power within ``radius`` of ``cycles``."""
        rows, columns = self._window(cycles, radius)
        power = self.power[np.ix_(rows + self.centre[0], columns + self.centre[1])].copy()
        power[np.hypot(rows[:, None] - cycles[0], columns[None, :] - cycles[1]) > radius] = 0.0
        row, column = np.unravel_index(int(np.argmax(power)), power.shape)
        return np.array([float(rows[row]), float(columns[column])])

    def _window(self, cycles: NDArray[np.float64], radius: float) -> list[NDArray[np.int64]]:
        """Return the frequencies [cycles over the field] of rows and columns within ``radius`` of ``cycles``."""
        return [
            np.arange(max(math.ceil(c - radius), -centre), min(math.floor(c + radius) + 1, n - centre))
            for c, n, centre in zip(cycles, self.power.shape, self.centre, strict=True)
        ]

    def strongest_line(self, excluded: NDArray[np.bool_], sizes: NDArray[np.float64]) -> Line | None:
        """Return the significant line with the largest power above its background, or None if no line is significant.

        A line is a maximum of the spectrum that a periodic wave causes. The spectrum is averaged over square boxes
        before lines are searched. This is repeated for several widths of the boxes, because waves with a varying phase
        have broad lines.

        Args:
            excluded: Mask of the Fourier coefficients that are not searched, of the shape of ``power``.
            sizes: Extents of the field along y and x.
        """
        white = self.power / self._coarse_background(sizes)
        rows, columns = self._cycles
        ny, nx = self.power.shape
        half = (columns > 0) | ((columns == 0) & (rows > 0))
        supported = (np.abs(rows) <= 0.5 * OF_NYQUIST * ny) & (np.abs(columns) <= 0.5 * OF_NYQUIST * nx)
        allowed = half & supported & ~excluded
        lines = (self._strongest_of_width(white, allowed, width, sizes) for width in _WIDTHS)
        return max((line for line in lines if line is not None), key=lambda line: line.excess, default=None)

    def _coarse_background(self, sizes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a coarse estimate of the background of the spectrum at each Fourier coefficient.

        The frequency plane is divided into rings and sectors, and the largest of several estimates counts. The
        coefficients on both axes of the plane have separate estimates, because steps between scan lines have their
        power on an axis.
        """
        rows, columns = (k / size for k, size in zip(self._cycles, sizes, strict=True))
        # Frequency of each Fourier coefficient [cycles over the longer side of the field].
        frequency = np.maximum(np.max(sizes) * np.hypot(rows, columns), 1.0)
        ring = np.floor(_RINGS * np.log2(frequency)).astype(np.int32)
        angle = np.arctan2(rows, columns)
        sector = np.floor((_SECTORS / np.pi) * angle).astype(np.int32) % _SECTORS
        count, is_plane = int(ring.max()) + 1, min(self.power.shape) > 1
        # Opposite frequencies have equal powers, so that half of the frequency plane suffices. At high frequencies of a
        # large spectrum only every n-th Fourier coefficient is used, which saves time.
        subset = np.broadcast_to(columns >= 0 if self.power.shape[1] > 1 else rows >= 0, self.power.shape)
        step = self.power.size // _MOST_SAMPLED
        if step > 1:
            sampled = (np.arange(self.power.size) % step == 0).reshape(self.power.shape)
            subset = subset & ((frequency < _FEW_CYCLES) | sampled)
        power, rings, sectors = self.power[subset], ring[subset], sector[subset]
        by_ring = _ring_background(power, rings, count, reach=_RINGS // 2 if is_plane else _RINGS)
        result = by_ring[ring]
        if not is_plane:
            return np.asarray(np.maximum(result, 1e-300))
        by_sector = np.stack(
            [
                _ring_background(power[sectors == s], rings[sectors == s], count, reach=_RINGS // 2)
                for s in range(_SECTORS)
            ]
        )
        result = np.maximum(result, by_sector[sector, ring])
        for axis in (0, 1):
            # The background has separate estimates at the frequencies −1, 0 and 1 [cycles over the field] along this
            # axis. If the field has two samples along the axis, the frequency 1 does not exist.
            for place in range(self.centre[axis] - 1, min(self.centre[axis] + 2, self.power.shape[axis])):
                line = (slice(None),) * axis + (place,)
                along = _ring_background(self.power[line], ring[line], count, reach=_RINGS)
                result[line] = np.maximum(result[line], along[ring[line]])
        return np.asarray(np.maximum(result, 1e-300))

    def _strongest_of_width(
        self, white: NDArray[np.float64], allowed: NDArray[np.bool_], width: int, sizes: NDArray[np.float64]
    ) -> Line | None:
        """Return the strongest significant line (maximum) of the spectrum averaged over square boxes, or None."""
        from scipy import ndimage, special

        sides = tuple(width if n > 1 else 1 for n in white.shape)
        if width > 1:
            if min(n for n in white.shape if n > 1) < _LEAST_BOXES * width:
                return None
            white = ndimage.uniform_filter(white, sides, mode="wrap")
        allowed = allowed & (np.hypot(*self._cycles) >= max(FEWEST_PERIODS - 0.5, width if width > 1 else 0.0))
        # The Hann window correlates neighbouring Fourier coefficients. A box of the spectrum therefore has fewer
        # independent powers than coefficients.
        independent = math.prod(max(side / 1.5, 1.0) for side in sides)
        tried = max(np.count_nonzero(allowed) / independent, 1.0)
        level = _FALSE_ALARM / tried
        around = tuple(min(n, side + 2) for n, side in zip(white.shape, sides, strict=True))
        values = np.where(allowed & (white == ndimage.maximum_filter(white, around, mode="wrap")), white, 0.0)
        best: Line | None = None
        for _ in range(_MOST_CANDIDATES):
            row, column = np.unravel_index(int(np.argmax(values)), values.shape)
            value = float(values[row, column])
            # The coarse background, estimated over rings and sectors, may contain the power of a spectral line. It only
            # decides which maxima are examined, and in which order.
            if special.gammaincc(independent, independent * value) > max(level, _EXAMINED):
                break
            values[row, column] = 0.0
            line = self._examined((int(row), int(column)), sides, independent, level, sizes, tried)
            if line is not None and (best is None or line.excess > best.excess):
                best = line
        return best

    def _examined(
        self, place: tuple[int, int], sides: tuple[int, ...], independent: float, level: float,
        sizes: NDArray[np.float64], tried: float,
    ) -> Line | None:  # fmt: skip
        """Return the line (maximum) in a box of the spectrum around a coefficient, or None if it is not significant.

        The mean power in the box must exceed the spectrum at lower and at higher frequencies of the same direction, and
        at the other points of each straight line through the box in the frequency plane.
        """
        width = max(sides)
        box = tuple(slice(max(i - side // 2, 0), i + side // 2 + 1) for i, side in zip(place, sides, strict=True))
        power = self.power[box]
        mean = float(np.mean(power))
        cycles = np.array([float(i - c) for i, c in zip(place, self.centre, strict=True)])
        medians, distances, count = self._of_same_direction(cycles, width, sizes)
        if not count or not _is_significant(mean / max(medians), independent, count, level, width):
            return None
        rows, columns = (
            np.arange(part.start, part.start + n) - centre
            for part, n, centre in zip(box, power.shape, self.centre, strict=True)
        )
        weight = np.maximum(power - max(medians), 0.0)
        centroid = np.array([np.sum(weight * rows[:, None]), np.sum(weight * columns)]) / float(np.sum(weight))
        if min(self.power.shape) > 1:
            ratio, inside, outside = self._over_ridge(centroid, mean, width)
            # Each straight line through the maximum contains only about √n of the n coefficients of the spectrum. Noise
            # therefore has fewer maxima on such a line than in the whole spectrum. The accepted probability that noise
            # causes a maximum is thus larger here than in the test above, by the factor √`tried`.
            if not _is_significant(ratio, inside, outside, level * math.sqrt(tried), width):
                return None
        exponent = 0.0
        if len(medians) == 2:
            exponent = math.log(medians[0] / medians[1]) / math.log(distances[1] / distances[0])
            exponent = min(max(exponent, _EXPONENTS[0]), _EXPONENTS[1])
        background = medians[0] * distances[0] ** exponent
        # The main lobe of the Hann window contains all power of a narrow line. A box of width 1 contains only a part of
        # this power.
        lobe = self.power[self._main_lobe(place)] if width == 1 else power
        return Line(centroid, background, exponent, float(np.sum(lobe - background)))

    def _of_same_direction(
        self, cycles: NDArray[np.float64], width: int, sizes: NDArray[np.float64]
    ) -> tuple[list[float], list[float], int]:
        """Return the mean power of the background of a line, at lower and at higher frequencies of the same direction.

        Also return the mean lower frequency and the mean higher frequency, relative to the frequency of the line, and
        the number of Fourier coefficients that were used. This number is 0 if no coefficient has a lower frequency.
        """
        vector = cycles / sizes
        length = float(np.hypot(*vector))
        unit = vector / length
        # Distances between neighbouring Fourier coefficients in the frequency plane: along the wave vector of the line,
        # and perpendicular to it.
        along = 1.0 / float(np.max(np.abs(unit) * sizes))
        across = 1.0 / float(np.max(np.abs(unit[::-1]) * sizes))
        gap = (_MAIN_LOBE + (width - 1) / 2.0) * along
        reach = max(_STRIP * length, 2.5 * across) if min(self.power.shape) > 1 else 0.0
        lowest = max(min(0.5 * length, length - gap - 1.5 * along), 0.8 * along)
        most = _HIGHEST[0 if reach else 1]
        medians, distances, total = [], [], 0
        for low, high in (
            (lowest, min(0.8 * length, length - gap)),
            (max(1.25 * length, length + gap), max(most * length, length + gap + 3.0 * along)),
        ):
            if high >= low:
                t = np.linspace(low, high, min(int((high - low) / along) + 1, _MOST_ALONG))
            else:
                t = np.array([high]) if high >= 0.8 * along else np.zeros(0)
            values = self._on_grid(t, np.linspace(-reach, reach, min(2 * int(reach / across) + 1, 15)), unit, sizes)
            if values.size:
                medians.append(max(_MEAN_OF_MEDIAN * float(np.median(values)), 1e-300))
                distances.append(float(np.mean(t)) / length)
                total += values.size
            elif not total:
                break
        return medians, distances, total

    def _on_grid(
        self, along: NDArray[np.float64], across: NDArray[np.float64], unit: NDArray[np.float64],
        sizes: NDArray[np.float64],
    ) -> NDArray[np.float64]:  # fmt: skip
        """Return the powers at the points of a grid in the frequency plane that is aligned with a unit vector (y, x).

        The power at a point is that of the nearest Fourier coefficient. A coefficient that is nearest to several points
        occurs once in the result.
        """
        ny, nx = self.power.shape
        vectors = along[:, None] * unit[0] + across * unit[1], along[:, None] * unit[1] - across * unit[0]
        row, column = (
            # In extremely long and narrow fields, indices of Fourier coefficients would exceed the range of integers.
            # The indices are therefore clipped.
            np.clip(np.round(vector * size), -n, n).astype(np.int64) + centre
            for vector, size, n, centre in zip(vectors, sizes, (ny, nx), self.centre, strict=True)
        )
        inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
        return np.asarray(self.power.ravel()[np.unique(row[inside] * nx + column[inside])])

    def _over_ridge(self, cycles: NDArray[np.float64], mean: float, width: int) -> tuple[float, float, int]:
        """Return the smallest ratio of a maximum's power to the other powers on a straight line through the maximum.

        Grinding marks and steps between scan lines make ridges in the spectrum, and noise makes many maxima along a
        ridge. Such a maximum hardly exceeds the other powers on its ridge. Also return the number of independent
        coefficients of the maximum, and of the other coefficients, for the straight line with the smallest ratio.
        """
        core = 0.5 * (width - 1) + _MAIN_LOBE
        reach = int(core + max(9, width // 2))
        rows, columns = (np.arange(round(float(c)) - reach, round(float(c)) + reach + 1) for c in cycles)
        ny, nx = self.power.shape
        power = self.power[np.ix_((rows + self.centre[0]) % ny, (columns + self.centre[1]) % nx)]
        dy, dx = np.meshgrid(rows - cycles[0], columns - cycles[1], indexing="ij")
        distance = np.hypot(dy, dx)
        outside, inside = (distance > core) & (distance <= reach), distance <= 0.5 * (width - 1)
        order = np.argsort(power[outside])
        rest, peak = power[outside][order], power[inside]
        shifts = np.array([-0.7, 0.0, 0.7])[:, None, None]
        on_rest, on_peak = (
            np.abs(dy[mask][:, None] * _FAN_COSINES - dx[mask][:, None] * _FAN_SINES - shifts) <= 0.6
            for mask in (outside, inside)
        )
        # Median power along each straight line, without the maximum itself. The powers are sorted already, so that
        # cumulative counts give all medians at once.
        number = np.cumsum(on_rest[:, order], axis=1, dtype=np.int32)
        middle = np.argmax(2 * number >= number[:, -1:], axis=1)
        medians = np.maximum(_MEAN_OF_MEDIAN * rest[middle], 1e-300)
        counts = np.sum(on_peak, axis=1)
        tops = np.where(counts > 0, np.einsum("spf,p->sf", on_peak, peak) / np.maximum(counts, 1), mean)
        if width == 1:
            tops, counts = np.full_like(medians, mean), np.zeros_like(counts)
        least = np.unravel_index(int(np.argmin(tops / medians)), medians.shape)
        return float(tops[least] / medians[least]), max(float(counts[least]) / 1.5, 1.0), int(number[:, -1][least])


def _is_significant(ratio: float, independent: float, background_count: float, level: float, width: int) -> bool:
    """Return whether noise reaches a ratio of a maximum to its background with a probability of at most ``level``.

    The powers of noise are distributed exponentially, and the background is estimated from few powers. The ratio of a
    power to the background therefore has Fisher's F distribution. If the spectrum was averaged over boxes of a
    ``width`` above 1, the ratio must also be at least `_LEAST_CONTRAST`.
    """
    from scipy import special

    few = max(0.5 * background_count, 1.0)
    # Probability that a number with Fisher's F distribution exceeds ``ratio`` (survival function).
    probability = special.betainc(few, independent, few / (few + independent * ratio))
    return bool(probability <= level and (width == 1 or ratio >= _LEAST_CONTRAST))


def _ring_background(
    power: NDArray[np.float64], ring: NDArray[np.int32], count: int, reach: int
) -> NDArray[np.float64]:
    """Estimate the mean power in each ring of the frequency plane from a quantile of powers.

    The quantile for a ring is that of the powers in this ring and in ``reach`` rings on both sides. Rings without any
    Fourier coefficient get interpolated values.
    """
    order = np.argsort(ring, kind="stable")
    power, begin = power[order], np.searchsorted(ring[order], np.arange(count + 1))
    result = np.full(count, np.nan)
    for i in range(count):
        part = power[begin[max(i - reach, 0)] : begin[min(i + reach + 1, count)]]
        if part.size:
            rank = int(_QUANTILE * part.size)
            result[i] = _MEAN_OF_QUANTILE * float(np.partition(part, rank)[rank])
    known = np.flatnonzero(~np.isnan(result))
    return np.interp(np.arange(count), known, result[known]) if known.size else np.zeros(count)
