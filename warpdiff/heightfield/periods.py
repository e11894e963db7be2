"""Periods of a height field by harmonic fits: waves of free frequency, fitted to the known samples."""

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

# Of a wave, over the field.
_LEAST_CYCLES = 0.5
# A wave of which the field holds fewer is waviness or form: it may as well be none.
FEWEST_PERIODS = 3.0
_MOST_HARMONICS = 16
# Of what half a cycle a sample can carry; there a sine is seen as nothing.
_OF_NYQUIST = 0.9
# Samples of the shortest harmonic that are kept, more are averaged over blocks; and numbers in a matrix.
_SAMPLES_A_PERIOD = 4
_MOST_NUMBERS = 4_000_000
# Samples up to which the first guess is on the finer grid.
_MOST_FINER = 2**18
# Of the variance of a frequency, in ratios of noise to signal: by how much linear theory is wrong, as measured.
_STRAYING = 24.0
# Amplitudes in standard deviations of what noise has.
_OVER_NOISE = 4.0
_STEPS = 12
# Steps of frequency, of a cycle over the field, that end the fit.
_CONVERGED = 1e-6
# A share of the variance below which nothing is looked for.
_LEAST_SHARE = 1e-3


@dataclass(frozen=True)
class Period:
    """Periodic wave in a height field, with its harmonics.

    Attributes:
        period_um: Length of the period [µm].
        standard_error_um: Standard error of the period [µm], from the power of the residual about its frequency. It is
            the error of the mean over the field, for noise without a period; for waviness it excludes the error due to
            the form of the wave.
        direction_deg: Direction of the wave vector, from x towards y, in (−90°, 90°].
        harmonics_um: Amplitudes of the fundamental and its harmonics [µm], at most sixteen, as the pitch allows; 0
            where noise hides a harmonic. Waviness has the fundamental alone.
        share: Share of the variance of the heights, without tilt, that the wave explains with its harmonics.
        frequency: Wave vector (y, x) [cycles per µm].
        is_waviness: Whether the field contains fewer than three periods, so that the wave may belong to the form of the
            surface.
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
        # As many digits as the error leaves, of which it has one.
        digits = max(-math.floor(math.log10(max(self.standard_error_um, 1e-6 * self.period_um))), 0)
        length = f"{self.period_um:.{digits}f} ± {self.standard_error_um:.{digits}f} µm"
        return f"{length} at {round(self.direction_deg)}°{' (waviness)' if self.is_waviness else ''}"

    def __repr__(self) -> str:
        return f"Period({self}, share {self.share:.3g})"


def fit(heightfield: HeightField, count: int) -> tuple[Period, ...]:
    """The strongest periods, see `HeightField.periods`."""
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
    """The strongest wave of heights without tilt, and its heights."""
    means = _Means.of(heights, known, pitch, _peak(heights, pitch))
    fit = means.fitted()
    residual = np.where(known, heights - fit.heights(means), 0.0)
    # Harmonics that are no more than noise carry the frequency away with them.
    amplitude_variance = 2.0 * float(np.mean(residual[known] ** 2)) / np.count_nonzero(known)
    significant = fit.amplitudes > _OVER_NOISE * math.sqrt(amplitude_variance)
    significant[0] = True
    if not significant.all():
        means.q, means.orders = fit.q, means.orders[significant]
        fit = means.fitted()
        residual = np.where(known, heights - fit.heights(means), 0.0)
    # In units of a cycle over the field; the noise that moves a frequency is that beside it.
    free = means.free
    normal = np.stack(fit.columns, axis=1)
    covariance = np.linalg.pinv((normal * means.weights[:, None]).T @ normal)[-len(free) :, -len(free) :]
    noise = _noise(residual, fit.q, means.sizes) * heights.size / np.count_nonzero(known)
    # Where the wave's power is not far above the noise, a peak may lie beside it.
    power = float(np.sum((means.orders * fit.amplitudes) ** 2)) * np.count_nonzero(known) / 4.0
    covariance *= noise * (1.0 + _STRAYING * noise / max(power, 1e-300))
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
    """Means of heights over blocks of samples, to which waves of frequencies near ``q`` are fitted.

    Attributes:
        y: Their centres along y, from the field's middle [µm], flat as all arrays.
        x: The same along x.
        values: The means of the samples that are known [µm].
        weights: How many these are.
        shape: Samples (ny, nx).
        pitch: Their distance (dy, dx) [µm].
        blocks: How many samples a block has along y and x.
        q: The frequency (y, x) that a fit begins with [1/µm].
        orders: Which harmonics are fitted.
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
        """Means over blocks of the size that a wave and its harmonics leave."""
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
        """The axes that have more than one sample."""
        return [axis for axis in (0, 1) if self.shape[axis] > 1]

    def fitted(self) -> _Fit:
        """Fit a wave with its harmonics and a tilt by Gauss and Newton's method, the amplitudes free at every step.

        In strong noise steps may lead away: it is the best of them that counts.
        """
        q, root, count = self.q.copy(), np.sqrt(self.weights), len(self.orders)
        best, least = None, math.inf
        relative = [(self.y, self.x)[axis] / self.sizes[axis] for axis in self.free]
        for _ in range(_STEPS):
            angles = 2.0 * np.pi * np.outer(q[0] * self.y + q[1] * self.x, self.orders)
            fades = np.prod(
                [_fade(self.orders * q[axis] * self.pitch[axis], self.blocks[axis]) for axis in (0, 1)], axis=0
            )
            cosines, sines = fades * np.cos(angles), fades * np.sin(angles)
            columns = [*cosines.T, *sines.T, np.ones_like(self.values), *relative]
            linear = _solved(columns, self.values, root)
            residual = float(np.sum((root * (self.values - np.stack(columns, axis=1) @ linear)) ** 2))
            slope = 2.0 * np.pi * ((cosines * linear[count : 2 * count] - sines * linear[:count]) @ self.orders)
            # What a cycle more over the field adds.
            columns += [slope * place for place in relative]
            if residual < least:
                best, least = _Fit(q.copy(), linear, columns, count), residual
            step = np.clip(_solved(columns, self.values, root)[-len(relative) :], -0.5, 0.5)
            if np.max(np.abs(step)) < _CONVERGED:
                break
            for axis, change in zip(self.free, step, strict=True):
                q[axis] += change / self.sizes[axis]
            if math.hypot(*(q * self.sizes)) < _LEAST_CYCLES:
                # So little of a wave, and a tilt, are any form.
                break
        assert best is not None  # noqa: S101 - for mypy; there is a first step
        return best


@dataclass
class _Fit:
    """A wave: its frequency, amplitudes of cosines and of sines with a tilt's three, and the last fit's columns."""

    q: NDArray[np.float64]
    linear: NDArray[np.float64]
    columns: list[NDArray[np.float64]]
    count: int

    @property
    def amplitudes(self) -> NDArray[np.float64]:
        """Amplitudes of the harmonics [µm]."""
        return np.hypot(self.linear[: self.count], self.linear[self.count : 2 * self.count])

    def heights(self, means: _Means) -> NDArray[np.float64]:
        """Heights of all samples, shape (ny, nx), with the tilt, of which a rest would be found as the next wave."""
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
    """Choose the harmonics that are fitted, and to means over blocks of how many samples along y and x."""
    cycles = [abs(float(q[axis])) * pitch[axis] if shape[axis] > 1 else 0.0 for axis in (0, 1)]
    most = max(1, min(_MOST_HARMONICS, math.floor(0.5 * _OF_NYQUIST / max(cycles))))
    if math.hypot(*(cycle * n for cycle, n in zip(cycles, shape, strict=True))) < FEWEST_PERIODS:
        # Harmonics of so few periods are any surface.
        most = 1
    while True:
        # As many blocks along each axis as if it held at least one period.
        density = [_SAMPLES_A_PERIOD * most * max(cycle, 1.0 / n) for cycle, n in zip(cycles, shape, strict=True)]
        blocks = [max(1, math.floor(1.0 / samples)) for samples in density]
        numbers = math.prod(n // block for n, block in zip(shape, blocks, strict=True)) * (2 * most + 5)
        if most == 1 or numbers <= _MOST_NUMBERS:
            return np.arange(1, most + 1), blocks
        most -= 1


def _fade(cycles: NDArray[np.float64], block: int) -> NDArray[np.float64]:
    """Transfer of means over blocks of samples: the share left of waves of so many cycles a sample."""
    turn = np.sin(np.pi * cycles)
    tiny = np.abs(turn) < 1e-9
    return np.where(tiny, 1.0, np.sin(np.pi * cycles * block) / (block * np.where(tiny, 1.0, turn)))


def _peak(heights: NDArray[np.float64], pitch: tuple[float, float]) -> NDArray[np.float64]:
    """The frequency (y, x) of the largest coefficient, at least half a cycle, on a grid of a quarter or half of one."""
    ny, nx = heights.shape
    # Hann's window keeps a strong wave from spilling over others.
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
    """Weighted least squares by the normal equations: there are few unknowns, and waves are nearly orthogonal."""
    matrix = np.stack(columns, axis=1) * root[:, None]
    return np.asarray(np.linalg.lstsq(matrix.T @ matrix, matrix.T @ (values * root), rcond=1e-12)[0], dtype=np.float64)


def _noise(residual: NDArray[np.float64], q: NDArray[np.float64], sizes: list[float]) -> float:
    """Variance a sample of white noise of the residual's power about a frequency."""
    ny, nx = residual.shape
    power = np.abs(np.fft.fft2(residual)) ** 2 / residual.size
    cycles_y, cycles_x = np.fft.fftfreq(ny, 1.0 / ny), np.fft.fftfreq(nx, 1.0 / nx)
    away = np.hypot(cycles_y[:, None] - q[0] * sizes[0], cycles_x - q[1] * sizes[1])
    # Nearer power is what the fit itself has removed.
    nearby = power[(away > 1.0) & (away < 4.0)]
    return float(np.mean(nearby)) if nearby.size else float(np.mean(residual**2))


def cut_whole(heightfield: HeightField) -> HeightField:
    """The largest part of whole periods, see `HeightField.whole_periods`."""
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
        # Along its grooves a wave drifts by less than a period: nothing to cut.
        size.append(number / frequency if number else heightfield.size_um[axis])
    return heightfield.cropped((size[0], size[1]), offset_um=(0.0, 0.0))
