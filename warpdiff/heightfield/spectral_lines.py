"""Search for lines in the power spectrum of a height field that rise significantly above its background.

Frequencies are in cycles over the field, pairs in the order (y, x). The background is never assumed to be white: a line
must exceed the spectrum at lower and at higher frequencies of the same direction, so that waviness, roughness of any
correlation, steps between scan lines and grinding marks are not mistaken for periods.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.heightfield.harmonic_fit import FEWEST_PERIODS, OF_NYQUIST

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Widths [cycles] of the boxes over which the spectrum is averaged: narrow lines need 1, lines of wavering waves more.
_WIDTHS = (1, 3, 7, 15, 31)
# Probability that noise exceeds the threshold anywhere in the spectrum, for each width.
_FALSE_ALARM = 5e-4
# Smallest power of a line that is wider than the resolution, relative to the background: this much the estimate of
# the background may be wrong.
_LEAST_CONTRAST = 4.0
# Largest number of maxima of each width that are examined. Limit: time.
_MOST_CANDIDATES = 60
# Half width of the main lobe of the Hann window [cycles].
_MAIN_LOBE = 1.8
# Bins of the coarse background: rings per octave, and sectors of the half plane.
_RINGS, _SECTORS = 8, 12
# Directions of the straight lines through a maximum.
_FAN = np.arange(24) * (math.pi / 24.0)
_FAN_COSINES, _FAN_SINES = np.cos(_FAN), np.sin(_FAN)
# Number of coefficients from which the coarse background is estimated. Limit: time.
_MOST_SAMPLED = 200_000
# Factor of the mean of exponentially distributed powers over their median.
_MEAN_OF_MEDIAN = 1.0 / math.log(2.0)
_MEAN_OF_QUARTILE = -1.0 / math.log(0.75)


@dataclass(frozen=True)
class Line:
    """Significant maximum of a spectrum.

    Attributes:
        cycles: Frequency (y, x) [cycles over the field].
        background: Power per coefficient around the line.
        excess: Power of the line above the background.
    """

    cycles: NDArray[np.float64]
    background: float
    exponent: float
    excess: float

    def background_at(self, rows, columns):
        """Background at frequencies (broadcast)."""
        length = float(np.hypot(*self.cycles))
        along = np.abs(rows * self.cycles[0] + columns * self.cycles[1]) / length**2
        return self.background * np.clip(along, 0.3, 3.0) ** -self.exponent


class WindowedSpectrum:
    """Power spectrum of heights (ny, nx) with a Hann window, with the zero frequency in the centre.

    Attributes:
        power: Powers, shape (ny, nx).
        extents: Extents of the field along y and x, relative to the larger one.
        centre: Index of the zero frequency.
    """

    def __init__(self, heights: NDArray[np.float64], extents: tuple[float, float]) -> None:
        from scipy import fft

        window = [np.hanning(n + 2)[1:-1] if n > 1 else np.ones(1) for n in heights.shape]
        scale = math.prod(float(np.sum(w**2)) for w in window)
        self.power = np.fft.fftshift(np.abs(fft.fft2(heights * np.outer(*window))) ** 2) / scale
        largest = max(extents)
        self.extents = (extents[0] / largest, extents[1] / largest)
        self.centre = tuple(n // 2 for n in heights.shape)
        self._radius: NDArray[np.float64] | None = None

    @property
    def cycles(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Cycles of the rows, shape (ny, 1), and of the columns, shape (1, nx)."""
        ny, nx = self.power.shape
        return (np.arange(ny) - float(self.centre[0]))[:, None], (np.arange(nx) - float(self.centre[1]))[None, :]

    def excess(self, line: Line, radius: float) -> float:
        """Power above the background within ``radius`` cycles around a line."""
        rows, columns = self._window(line.cycles, radius)
        power = self.power[np.ix_(rows + self.centre[0], columns + self.centre[1])]
        rows, columns = rows[:, None], columns[None, :]
        inside = np.hypot(rows - line.cycles[0], columns - line.cycles[1]) <= radius
        return float(np.sum((power - line.background_at(rows, columns))[inside]))

    def around(self, cycles):
        """Power within the main lobe around a frequency."""
        row, column = (round(float(c)) + centre for c, centre in zip(cycles, self.centre, strict=True))
        return float(np.sum(self.power[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]))

    def line_at(self, cycles):
        """Line at a frequency that is significant by itself, without regard to the number of frequencies."""
        place = tuple(np.intp(round(float(c)) + centre) for c, centre in zip(cycles, self.centre, strict=True))
        return self._examined(place, (1, 1), 1.0, 1e-2)

    def strongest_within(self, cycles: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
        """Frequency of the largest power within ``radius`` cycles around another frequency."""
        rows, columns = self._window(cycles, radius)
        power = self.power[np.ix_(rows + self.centre[0], columns + self.centre[1])].copy()
        power[np.hypot(rows[:, None] - cycles[0], columns[None, :] - cycles[1]) > radius] = 0.0
        row, column = np.unravel_index(int(np.argmax(power)), power.shape)
        return np.array([float(rows[row]), float(columns[column])])

    def _window(self, cycles: NDArray[np.float64], radius: float) -> list[NDArray[np.int64]]:
        """Rows and columns within ``radius`` cycles around a frequency."""
        return [
            np.arange(max(math.ceil(c - radius), -centre), min(math.floor(c + radius) + 1, n - centre))
            for c, n, centre in zip(cycles, self.power.shape, self.centre, strict=True)
        ]

    def strongest_line(self, excluded: NDArray[np.bool_]) -> Line | None:
        """Return the significant line of the largest power outside of a mask of the shape of ``power``, or None."""
        white = self.power / self._coarse_background()
        allowed = self._allowed() & ~excluded
        best: Line | None = None
        for width in _WIDTHS:
            line = self._strongest_of_width(white, allowed, width)
            if line is not None and (best is None or line.excess > best.excess):
                best = line
        return best

    def _allowed(self) -> NDArray[np.bool_]:
        """One half plane of the frequencies that the samples support and that repeat often enough."""
        rows, columns = self.cycles
        ny, nx = self.power.shape
        half = (columns > 0) | ((columns == 0) & (rows > 0))
        supported = (np.abs(rows) <= 0.5 * OF_NYQUIST * ny) & (np.abs(columns) <= 0.5 * OF_NYQUIST * nx)
        return np.asarray(half & supported & (np.hypot(rows, columns) >= FEWEST_PERIODS - 0.5))

    def _distance(self) -> NDArray[np.float64]:
        """Frequency [cycles over the longer side]."""
        rows, columns = self.cycles
        return np.hypot(rows / self.extents[0], columns / self.extents[1])

    def _coarse_background(self) -> NDArray[np.float64]:
        """Background by quartiles over rings and sectors, and along both axes, where steps between lines have power."""
        rows, columns = self.cycles
        frequency = np.maximum(self._distance(), 1.0)
        ring = np.floor(_RINGS * np.log2(frequency)).astype(np.int32)
        angle = np.arctan2(rows / self.extents[0], columns / self.extents[1])
        sector = np.floor((_SECTORS / np.pi) * angle).astype(np.int32) % _SECTORS
        count, is_plane = int(ring.max()) + 1, min(self.power.shape) > 1
        # One half plane suffices, and of high frequencies a part.
        subset = np.broadcast_to(columns >= 0 if self.power.shape[1] > 1 else rows >= 0, self.power.shape)
        step = self.power.size // _MOST_SAMPLED
        if step > 1:
            subset = subset & ((frequency < 64.0) | ((np.arange(self.power.size) % step == 0).reshape(self.power.shape)))
        power, rings, sectors = self.power[subset], ring[subset], sector[subset]
        by_ring = _ring_background(power, rings, count, reach=_RINGS // 2 if is_plane else _RINGS)
        result = by_ring[ring]
        if not is_plane:
            return np.maximum(result, 1e-300)
        by_sector = np.stack([
            _ring_background(power[sectors == s], rings[sectors == s], count, reach=_RINGS // 2)
            for s in range(_SECTORS)
        ])
        result = np.maximum(result, by_sector[sector, ring])
        for axis in (0, 1):
            for offset in (-1, 0, 1):
                line = (slice(None),) * axis + (self.centre[axis] + offset,)
                along = _ring_background(self.power[line], ring[line], count, reach=_RINGS)
                result[line] = np.maximum(result[line], along[ring[line]])
        return np.maximum(result, 1e-300)

    def _strongest_of_width(
        self, white: NDArray[np.float64], allowed: NDArray[np.bool_], width: int
    ) -> Line | None:
        """Return the strongest significant line of the spectrum averaged over boxes."""
        from scipy import ndimage, special

        sides = tuple(width if n > 1 else 1 for n in white.shape)
        if width > 1:
            if min(n for n in white.shape if n > 1) < 4 * width:
                return None
            white = ndimage.uniform_filter(white, sides, mode="wrap")
            allowed = allowed & (np.hypot(*self.cycles) >= max(FEWEST_PERIODS, width))
        # Neighbouring coefficients of a Hann window are correlated.
        independent = math.prod(max(side / 1.5, 1.0) for side in sides)
        trials = max(np.count_nonzero(allowed) / independent, 1.0)
        level = _FALSE_ALARM / trials
        peaks = allowed & (white == ndimage.maximum_filter(white, tuple(min(n, s + 2) for n, s in zip(white.shape, sides)), mode="wrap"))
        values = np.where(peaks, white, 0.0)
        best: Line | None = None
        for _ in range(_MOST_CANDIDATES):
            place = np.unravel_index(int(np.argmax(values)), values.shape)
            value = float(values[place])
            if special.gammaincc(independent, independent * value) > level or (width > 1 and value < _LEAST_CONTRAST):
                break
            values[place] = 0.0
            line = self._examined(place, sides, independent, level)
            if line is not None and (best is None or line.excess > best.excess):
                best = line
        return best

    def _examined(
        self, place: tuple[np.intp, ...], sides: tuple[int, ...], independent: float, level: float
    ) -> Line | None:
        """Compare the power of a box with that at lower and at higher frequencies of the same direction, and with that
        along any straight line through it.
        """
        box = tuple(
            slice(max(int(i) - side // 2, 0), int(i) + side // 2 + 1) for i, side in zip(place, sides, strict=True)
        )
        power = self.power[box]
        mean = float(np.mean(power))
        cycles = np.array([float(i) - c for i, c in zip(place, self.centre, strict=True)])
        background, count, local, exponent = self._of_same_direction(cycles, max(sides))
        if not count or not _is_significant(mean / background, independent, count, level, max(sides)):
            return None
        offsets = [np.arange(s.start, s.start + n) - c for s, n, c in zip(box, power.shape, self.centre, strict=True)]
        weight = np.maximum(power - background, 0.0)
        centroid = np.array([np.sum(weight * offsets[0][:, None]), np.sum(weight * offsets[1][None, :])])
        centroid /= max(float(np.sum(weight)), 1e-300)
        if min(self.power.shape) > 1:
            ratio, inside, outside = self._over_ridge(centroid, mean, max(sides))
            if not _is_significant(ratio, inside, outside, level, max(sides)):
                return None
        if max(sides) == 1:
            # All power of a narrow line is within the main lobe.
            power = self.power[tuple(slice(max(int(i) - 2, 0), int(i) + 3) for i in place)]
        return Line(centroid, local, exponent, float(np.sum(power - local)))

    def _of_same_direction(self, cycles: NDArray[np.float64], width: int) -> tuple[float, int, float, float]:
        """Return the larger background of both sides of a line along its wave vector, the number of coefficients (0 if
        there are none at lower frequencies), and the power law through both: its value at the line, and its exponent.
        """
        vector = cycles / self.extents
        length = float(np.hypot(*vector))
        unit = vector / length
        # Distances of neighbouring coefficients along the wave vector and across.
        along = 1.0 / float(np.max(np.abs(unit) * self.extents))
        across = 1.0 / float(np.max(np.abs(unit[::-1]) * self.extents))
        gap = (_MAIN_LOBE + (width - 1) / 2.0) * along
        reach = max(0.15 * length, 2.5 * across) if min(self.power.shape) > 1 else 0.0
        lowest = max(min(0.5 * length, length - gap - 1.5 * along), 0.8 * along)
        ranges = (
            (lowest, min(0.8 * length, length - gap)),
            (max(1.25 * length, length + gap), max(1.8 * length, length + gap + 3.0 * along)),
        )
        medians: list[float] = []
        distances: list[float] = []
        total = 0
        for low, high in ranges:
            if high < low:
                t = np.array([high]) if high >= 0.8 * along else np.zeros(0)
            else:
                t = np.linspace(low, high, min(int((high - low) / along) + 1, 40))
            s = np.linspace(-reach, reach, min(2 * int(reach / across) + 1, 15)) if reach else np.zeros(1)
            places = [
                np.round((t[:, None] * unit[axis] + s * sign * unit[1 - axis]) * self.extents[axis]).astype(np.int64)
                + self.centre[axis]
                for axis, sign in ((0, 1.0), (1, -1.0))
            ]
            ny, nx = self.power.shape
            inside = (places[0] >= 0) & (places[0] < ny) & (places[1] >= 0) & (places[1] < nx)
            distinct = np.unique(places[0][inside] * nx + places[1][inside])
            if distinct.size:
                medians.append(max(_MEAN_OF_MEDIAN * float(np.median(self.power.ravel()[distinct])), 1e-300))
                distances.append(float(np.mean(t)) / length)
                total += distinct.size
            elif not total:
                return 0.0, 0, 0.0, 0.0
        exponent = 0.0
        if len(medians) == 2:
            exponent = math.log(medians[0] / medians[1]) / math.log(distances[1] / distances[0])
            exponent = min(max(exponent, -4.0), 8.0)
        return max(medians), total, medians[0] * distances[0] ** exponent, exponent

    def _over_ridge(self, cycles: NDArray[np.float64], mean: float, width: int) -> tuple[float, float, int]:
        """Return the smallest power of a maximum relative to the rest of a straight line through it, and the numbers of
        independent coefficients of both. Grinding marks and steps between scan lines make ridges in the spectrum, which
        noise covers with maxima.
        """
        core = 0.5 * (width - 1) + _MAIN_LOBE
        reach = int(core + max(9, width // 2))
        middle = np.round(cycles).astype(np.int64)
        rows, columns = (np.arange(i - reach, i + reach + 1) for i in middle)
        power = self.power[
            np.ix_((rows + self.centre[0]) % self.power.shape[0], (columns + self.centre[1]) % self.power.shape[1])
        ]
        dy, dx = np.meshgrid(rows - cycles[0], columns - cycles[1], indexing="ij")
        distance = np.hypot(dy, dx)
        outside, inside = (distance > core) & (distance <= reach), distance <= max(0.5 * (width - 1), 0.7)
        across = [dy[mask][:, None] * _FAN_COSINES - dx[mask][:, None] * _FAN_SINES for mask in (outside, inside)]
        rest, core_power = power[outside], power[inside]
        best = (math.inf, 1.0, 1)
        for shift in (-0.7, 0.0, 0.7):
            strips = [np.abs(a - shift) <= 0.6 for a in across]
            for i in range(len(_FAN_COSINES)):
                values = rest[strips[0][:, i]]
                own = core_power[strips[1][:, i]] if width > 1 else None
                top = mean if own is None or not own.size else float(np.mean(own))
                ratio = top / max(_MEAN_OF_MEDIAN * float(np.median(values)), 1e-300)
                if ratio < best[0]:
                    best = ratio, 1.0 if own is None else max(own.size / 1.5, 1.0), values.size
        return best


def _is_significant(ratio: float, independent: float, background_count: float, level: float, width: int) -> bool:
    """Whether noise exceeds its background by a ratio with a probability below ``level``.

    Powers are distributed exponentially, and the background is itself an estimate from few of them.
    """
    from scipy import special

    few = max(0.5 * background_count, 1.0)
    # Survival function of Fisher's F distribution.
    probability = special.betainc(few, independent, few / (few + independent * ratio))
    return bool(probability <= level and (width == 1 or ratio >= _LEAST_CONTRAST))


def _ring_background(power: NDArray[np.float64], ring: NDArray[np.int64], count: int, reach: int) -> NDArray[np.float64]:
    """Estimate the mean power of each ring from the median over ``reach`` rings on both sides; rings without any
    coefficient take the value of the next one.
    """
    order = np.argsort(ring, kind="stable")
    power, begin = power[order], np.searchsorted(ring[order], np.arange(count + 1))
    result = np.full(count, np.nan)
    for i in range(count):
        part = power[begin[max(i - reach, 0)] : begin[min(i + reach + 1, count)]]
        if part.size:
            result[i] = _MEAN_OF_QUARTILE * float(np.quantile(part, 0.25))
    known = np.flatnonzero(~np.isnan(result))
    if not known.size:
        return np.zeros(count)
    return np.interp(np.arange(count), known, result[known])
