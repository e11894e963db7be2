"""Periods of a height field by harmonic fits: waves of any frequency, fitted to the known samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField

# Fewest cycles of a wave over the field that are searched for.
_LEAST_CYCLES = 0.5
# Waves with fewer cycles over the field count as waviness, because they may belong to the form of the surface.
FEWEST_PERIODS = 3.0
# Limit on the number of harmonics of a wave.
_MOST_HARMONICS = 16
# Largest frequency of a harmonic relative to the Nyquist limit, at which a sine may vanish on all samples.
_OF_NYQUIST = 0.9
# Samples per period of the shortest harmonic; more are averaged over blocks, which saves time. With two, harmonics
# alias.
_SAMPLES_PER_PERIOD = 4
# Limit on the number of elements of the matrix of a fit, which limits time and memory.
_MOST_ELEMENTS = 4_000_000
# Largest number of samples of a field for which the first guess comes from a transform padded four times; others are
# padded twice.
_MOST_FINER = 2**18
# Correction of the variance of a frequency for strong noise, relative to the ratio of noise to signal, as measured.
_NOISE_CORRECTION = 24.0
# Smallest significant amplitude of a harmonic, in standard deviations of the amplitude of noise.
_OVER_NOISE = 4.0
# Limit on the steps of a fit.
_MOST_STEPS = 12
# Change of frequency [cycles over the field] that ends a fit.
_CONVERGED = 1e-6
# Share of the variance below which a wave is not reported.
_LEAST_SHARE = 1e-3


@dataclass(frozen=True)
class Period:
    """Periodic wave in a height field, with its harmonics.

    Attributes:
        period_um: Length of the period [µm].
        standard_error_um: Standard error of the period [µm], from the power of the residual near its frequency. It is
            the error of the mean period of the field and assumes random noise. For waviness it excludes the error due
            to the form of the wave.
        direction_deg: Direction of the wave vector [degrees], from x towards y, above −90 and at most 90.
        harmonics_um: Amplitudes of the fundamental and its harmonics [µm], at most sixteen, as the pitch allows; 0 for
            harmonics below the noise. Waviness has only the fundamental.
        share: Share of the variance of the heights, without tilt, that the wave explains with its harmonics.
        frequency: Wave vector (y, x) [cycles per µm].
        is_waviness: Whether the field contains fewer than three periods, so that the wave may belong to the form of the
            surface.

    Examples:
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> x = np.arange(730) * 0.02
        >>> ripples = 0.1 * np.cos(np.pi * x) + np.random.default_rng(0).normal(0.0, 0.01, (40, 730))
        >>> period = wd.HeightField(ripples, pitch_um=0.02).periods()[0]
        >>> isinstance(period, wd.Period), round(period.period_um, 2), round(period.direction_deg)
        (True, 2.0, 0)
    """

    period_um: float
    standard_error_um: float
    direction_deg: float
    harmonics_um: tuple[float, ...]
    share: float
    frequency: tuple[float, float]
    is_waviness: bool

    def __str__(self) -> str:
        """Return the period with its error, and its direction."""
        # The error is printed with one digit, and the period to the same decimal place.
        digits = max(-math.floor(math.log10(max(self.standard_error_um, 1e-6 * self.period_um))), 0)
        length = f"{self.period_um:.{digits}f} ± {self.standard_error_um:.{digits}f} µm"
        return f"{length} at {round(self.direction_deg)}°{' (waviness)' if self.is_waviness else ''}"

    def __repr__(self) -> str:
        return f"Period({self}, share {self.share:.3g})"


def fit(heightfield: HeightField, count: int) -> tuple[Period, ...]:
    """Fit the strongest periods, see `HeightField.periods`."""
    field = heightfield.levelled(1)
    known = ~field.missing
    heights = np.where(known, field.heights_um, 0.0)
    scale = max(float(np.max(np.abs(heightfield.heights_um[known]))), 1e-300)
    variance = float(np.mean(heights[known] ** 2))
    result: list[Period] = []
    for _ in range(count):
        if variance <= (1e-10 * scale) ** 2 or np.mean(heights[known] ** 2) <= _LEAST_SHARE * variance:
            break
        with single_threaded_blas():
            period, wave = _strongest(heights, known, heightfield.pitch_um, variance)
        if period.share < _LEAST_SHARE:
            break
        result.append(period)
        heights = np.where(known, heights - wave, 0.0)
    return tuple(sorted(result, key=lambda period: -period.share))


def _strongest(
    heights: NDArray[np.float64], known: NDArray[np.bool_], pitch: tuple[float, float], variance: float
) -> tuple[Period, NDArray[np.float64]]:
    """Fit the strongest wave of heights without tilt; return it and its heights."""
    means = _Means.of(heights, known, pitch, _peak(heights, pitch))
    fit = means.fitted()
    residual = np.where(known, heights - fit.heights(means), 0.0)
    # Harmonics below the noise would change the frequency; they are removed and the fit is repeated.
    amplitude_variance = 2.0 * float(np.mean(residual[known] ** 2)) / np.count_nonzero(known)
    significant = fit.amplitudes > _OVER_NOISE * math.sqrt(amplitude_variance)
    significant[0] = True
    if not significant.all():
        means.q, means.orders = fit.q, means.orders[significant]
        fit = means.fitted()
        residual = np.where(known, heights - fit.heights(means), 0.0)
    # The covariance is in units of a cycle over the field. Only noise near a frequency changes its estimate.
    free = means.free
    normal = np.stack(fit.columns, axis=1)
    covariance = np.linalg.pinv((normal * means.weights[:, None]).T @ normal)[-len(free) :, -len(free) :]
    noise = _noise(residual, fit.q, means.sizes) * heights.size / np.count_nonzero(known)
    # If the power of the wave is hardly above the noise, the maximum may be a neighbouring peak.
    power = float(np.sum((means.orders * fit.amplitudes) ** 2)) * np.count_nonzero(known) / 4.0
    covariance *= noise * (1.0 + _NOISE_CORRECTION * noise / max(power, 1e-300))
    frequency = float(np.hypot(*fit.q))
    along = np.array([fit.q[axis] / means.sizes[axis] for axis in free]) / frequency
    harmonics = np.zeros(means.orders[-1])
    harmonics[means.orders - 1] = fit.amplitudes
    qy, qx = fit.q.tolist()
    if qx < 0.0 or (qx == 0.0 and qy < 0.0):
        qy, qx = -qy, -qx
    return Period(
        period_um=1.0 / frequency,
        standard_error_um=math.sqrt(max(float(along @ covariance @ along), 0.0)) / frequency**2,
        direction_deg=math.degrees(math.atan2(qy, qx)) + 0.0, harmonics_um=tuple(harmonics.tolist()),
        share=max(float(np.mean(heights[known] ** 2) - np.mean(residual[known] ** 2)) / variance, 0.0),
        frequency=(qy, qx), is_waviness=math.hypot(qy * means.sizes[0], qx * means.sizes[1]) < FEWEST_PERIODS,
    ), heights - residual  # fmt: skip


@dataclass
class _Means:
    """Means of heights over blocks of samples, to which waves with frequencies near ``q`` are fitted.

    Attributes:
        y: Centres of the blocks along y, relative to the centre of the field [µm], shape (k,).
        x: Centres of the blocks along x, relative to the centre of the field [µm], shape (k,).
        values: Means of the known samples of the blocks [µm], shape (k,).
        weights: Numbers of the known samples of the blocks, shape (k,).
        shape: Number of samples (ny, nx).
        pitch: Distance of the samples (dy, dx) [µm].
        blocks: Number of samples of a block along y and x.
        q: Initial frequency (y, x) of a fit [1/µm].
        orders: Harmonics to fit; 1 is the fundamental.
    """

    y: NDArray[np.float64]
    x: NDArray[np.float64]
    values: NDArray[np.float64]
    weights: NDArray[np.float64]
    shape: tuple[int, ...]
    pitch: tuple[float, float]
    blocks: list[int]
    q: NDArray[np.float64]
    orders: NDArray[np.int64]

    @classmethod
    def of(
        cls, heights: NDArray[np.float64], known: NDArray[np.bool_], pitch: tuple[float, float], q: NDArray[np.float64]
    ) -> _Means:
        """Average over blocks that are small enough for a wave of frequency ``q`` and its harmonics."""
        orders, blocks = _orders_and_blocks(q, heights.shape, pitch)
        shape = [n // block for n, block in zip(heights.shape, blocks, strict=True)]
        whole = tuple(slice(n * block) for n, block in zip(shape, blocks, strict=True))
        total, number = (
            array[whole].reshape(shape[0], blocks[0], shape[1], blocks[1]).sum(axis=(1, 3))
            for array in (heights, known)
        )
        filled = number > 0
        places = [
            (np.arange(n) * block + (block - 1) / 2.0 - size / 2.0) * step
            for n, block, size, step in zip(shape, blocks, heights.shape, pitch, strict=True)
        ]
        y, x = (grid[filled] for grid in np.meshgrid(*places, indexing="ij"))
        weights = number[filled].astype(np.float64)
        return cls(y, x, total[filled] / weights, weights, heights.shape, pitch, blocks, q, orders)

    @property
    def sizes(self) -> list[float]:
        """Extents along y and x [µm]."""
        return [n * step for n, step in zip(self.shape, self.pitch, strict=True)]

    @property
    def free(self) -> list[int]:
        """Axes with more than one sample."""
        return [axis for axis in (0, 1) if self.shape[axis] > 1]

    def fitted(self) -> _Fit:
        """Fit a wave with its harmonics and a tilt by the Gauss-Newton method; each step solves for all amplitudes.

        In strong noise a step can increase the residual, so that the best step is returned.
        """
        q, root, count = self.q.copy(), np.sqrt(self.weights), len(self.orders)
        best, least = None, math.inf
        relative = [(self.y, self.x)[axis] / self.sizes[axis] for axis in self.free]
        for _ in range(_MOST_STEPS):
            angles = 2.0 * np.pi * np.outer(q[0] * self.y + q[1] * self.x, self.orders)
            fades = np.prod(
                [_fade(self.orders * q[axis] * self.pitch[axis], self.blocks[axis]) for axis in (0, 1)], axis=0
            )
            cosines, sines = fades * np.cos(angles), fades * np.sin(angles)
            columns = [*cosines.T, *sines.T, np.ones_like(self.values), *relative]
            linear = _solved(columns, self.values, root)
            residual = float(np.sum((root * (self.values - np.stack(columns, axis=1) @ linear)) ** 2))
            slope = 2.0 * np.pi * ((cosines * linear[count : 2 * count] - sines * linear[:count]) @ self.orders)
            # Derivatives of the heights by the frequency, per cycle over the field.
            columns += [slope * place for place in relative]
            if residual < least:
                best, least = _Fit(q.copy(), linear, columns, count), residual
            step = np.clip(_solved(columns, self.values, root)[-len(relative) :], -0.5, 0.5)
            if np.max(np.abs(step)) < _CONVERGED:
                break
            for axis, change in zip(self.free, step, strict=True):
                q[axis] += change / self.sizes[axis]
            if math.hypot(*(q * self.sizes)) < _LEAST_CYCLES:
                # Less than half a cycle cannot be distinguished from a tilt.
                break
        assert best is not None  # noqa: S101 - for mypy; the first step sets it
        return best


@dataclass
class _Fit:
    """Fitted wave.

    Attributes:
        q: Frequency (y, x) [1/µm].
        linear: Amplitudes of the cosines, amplitudes of the sines, and the coefficients of offset and tilt.
        columns: Columns of the matrix of the fit, and the derivatives by the frequency.
        count: Number of harmonics.
    """

    q: NDArray[np.float64]
    linear: NDArray[np.float64]
    columns: list[NDArray[np.float64]]
    count: int

    @property
    def amplitudes(self) -> NDArray[np.float64]:
        """Amplitudes of the harmonics [µm]."""
        return np.hypot(self.linear[: self.count], self.linear[self.count : 2 * self.count])

    def heights(self, means: _Means) -> NDArray[np.float64]:
        """Heights of all samples, shape (ny, nx), with the tilt, which the next fit would otherwise find as a wave."""
        places = [(np.arange(n) - n / 2.0) * step for n, step in zip(means.shape, means.pitch, strict=True)]
        result = np.full(means.shape, self.linear[2 * self.count])
        for axis, tilt in zip(means.free, self.linear[2 * self.count + 1 :], strict=True):
            run = tilt * places[axis] / means.sizes[axis]
            result += run[:, None] if axis == 0 else run
        amplitudes = self.linear[: self.count] - 1j * self.linear[self.count : 2 * self.count]
        for order, amplitude in zip(means.orders, amplitudes, strict=True):
            along_y, along_x = (np.exp(2j * np.pi * order * self.q[axis] * places[axis]) for axis in (0, 1))
            result += np.outer(along_y, amplitude * along_x).real
        return result


def _orders_and_blocks(
    q: NDArray[np.float64], shape: tuple[int, ...], pitch: tuple[float, float]
) -> tuple[NDArray[np.int64], list[int]]:
    """Return the harmonics to fit, and the number of samples of a block along y and x."""
    cycles = [abs(float(q[axis])) * pitch[axis] if shape[axis] > 1 else 0.0 for axis in (0, 1)]
    most = max(1, min(_MOST_HARMONICS, math.floor(0.5 * _OF_NYQUIST / max(cycles))))
    if math.hypot(*(cycle * n for cycle, n in zip(cycles, shape, strict=True))) < FEWEST_PERIODS:
        # With harmonics, so few periods could be fitted to any surface.
        most = 1
    while True:
        # The number of blocks along an axis suffices for at least one period.
        density = [_SAMPLES_PER_PERIOD * most * max(cycle, 1.0 / n) for cycle, n in zip(cycles, shape, strict=True)]
        blocks = [max(1, math.floor(1.0 / samples)) for samples in density]
        elements = math.prod(n // block for n, block in zip(shape, blocks, strict=True)) * (2 * most + 5)
        if most == 1 or elements <= _MOST_ELEMENTS:
            return np.arange(1, most + 1), blocks
        most -= 1


def _fade(cycles: NDArray[np.float64], block: int) -> NDArray[np.float64]:
    """Transfer function of means over blocks of samples, for frequencies in cycles per sample."""
    turn = np.sin(np.pi * cycles)
    tiny = np.abs(turn) < 1e-9
    return np.where(tiny, 1.0, np.sin(np.pi * cycles * block) / (block * np.where(tiny, 1.0, turn)))


def _peak(heights: NDArray[np.float64], pitch: tuple[float, float]) -> NDArray[np.float64]:
    """Frequency (y, x) [1/µm] of the largest Fourier coefficient, on a grid of a quarter or half of a cycle."""
    ny, nx = heights.shape
    # A Hann window reduces the leakage of a strong wave into others.
    faded = heights * np.outer(*(np.hanning(n + 2)[1:-1] if n > 1 else np.ones(1) for n in heights.shape))
    finer = 4 if heights.size <= _MOST_FINER else 2
    padded = [finer * n if n > 1 else 1 for n in heights.shape]
    power = np.abs(np.fft.rfft2(faded, padded))
    along_y, along_x = np.fft.fftfreq(padded[0], pitch[0]), np.fft.rfftfreq(padded[1], pitch[1])
    cycles = np.hypot(along_y[:, None] * ny * pitch[0], along_x * nx * pitch[1])
    fastest = np.maximum(np.abs(along_y[:, None]) * pitch[0], along_x * pitch[1])
    power[(cycles < _LEAST_CYCLES) | (fastest > 0.5 * _OF_NYQUIST)] = 0.0
    row, column = np.unravel_index(int(np.argmax(power)), power.shape)
    return np.array([along_y[row], along_x[column]])


def _solved(
    columns: list[NDArray[np.float64]], values: NDArray[np.float64], root: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Weighted least squares by the normal equations, which are well conditioned, as waves are nearly orthogonal."""
    matrix = np.stack(columns, axis=1) * root[:, None]
    return np.asarray(np.linalg.lstsq(matrix.T @ matrix, matrix.T @ (values * root), rcond=1e-12)[0], dtype=np.float64)


def _noise(residual: NDArray[np.float64], q: NDArray[np.float64], sizes: list[float]) -> float:
    """Variance per sample of white noise with the power that the residual has near a frequency."""
    ny, nx = residual.shape
    power = np.abs(np.fft.fft2(residual)) ** 2 / residual.size
    cycles_y, cycles_x = np.fft.fftfreq(ny, 1.0 / ny), np.fft.fftfreq(nx, 1.0 / nx)
    away = np.hypot(cycles_y[:, None] - q[0] * sizes[0], cycles_x - q[1] * sizes[1])
    # Within one cycle of the frequency, the fit itself has removed power.
    nearby = power[(away > 1.0) & (away < 4.0)]
    return float(np.mean(nearby)) if nearby.size else float(np.mean(residual**2))


def cut_whole(heightfield: HeightField) -> HeightField:
    """Crop to the largest part of whole periods, see `HeightField.whole_periods`."""
    periods = [period for period in fit(heightfield, 3) if not period.is_waviness]
    if not periods:
        raise ArgumentValueError(
            f"{ref('whole_periods()')} needs a period that repeats at least three times, and this field has none; use "
            f"{ref('periodic()')}, or a larger patch"
        )
    size = []
    for axis in (0, 1):
        frequency = abs(periods[0].frequency[axis])
        number = math.floor(frequency * heightfield.size_um[axis] + 1e-6)
        # Along its grooves a wave shifts by less than a period, and the axis stays unchanged.
        size.append(number / frequency if number else heightfield.size_um[axis])
    return heightfield.cropped((size[0], size[1]), offset_um=(0.0, 0.0))
