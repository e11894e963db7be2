"""Least-squares fit of a wave of unknown frequency and its harmonics, with the covariance of the fitted frequency.

Frequencies q are pairs (y, x) in 1/µm. Some functions count a frequency in cycles over the length of the field instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# A wave counts as a period of the surface only if the field contains at least this number of its cycles. Slower waves
# may belong to the overall form of the surface. The value is a convention; if doubled, periods that repeat three to
# five times are not reported.
FEWEST_PERIODS = 3.0
# Largest number of harmonics of a wave that are fitted, including the fundamental.
MOST_HARMONICS = 16
# Largest frequency of a fitted harmonic, relative to the Nyquist limit of the samples. A sine at the Nyquist limit may
# be 0 at all samples.
OF_NYQUIST = 0.9
# Before a fit, neighbouring samples are averaged over blocks, which saves time. The number is that of blocks per period
# of the shortest harmonic of the fitted wave. With two blocks per period, harmonics would alias.
_SAMPLES_PER_PERIOD = 4
# Largest number of elements of the matrix in a least-squares fit of a wave. The value is limited by time and memory: if
# doubled, the largest fits require twice as much of both.
_MOST_ELEMENTS = 2_000_000
# A harmonic of a wave is significant if its amplitude is at least this value, in standard deviations of the amplitudes
# that noise causes.
_OVER_NOISE = 4.0
# Largest number of Gauss-Newton steps in the least-squares fit of a wave.
_MOST_STEPS = 12
# The fit of a wave ends if its frequency changes by less than this value in one step [cycles over the field].
_CONVERGED = 1e-6


def fit_wave(
    heights: NDArray[np.float64], known: NDArray[np.bool_], pitch: tuple[float, float], q: NDArray[np.float64],

) -> HarmonicFit:  # fmt: skip
    """Fit a wave with a frequency near ``q`` [1/µm], its significant harmonics and a tilt to the known heights."""
    means = _Means.of(heights, known, pitch, q, MOST_HARMONICS)
    fit = means.fitted()
    residual = np.where(known, heights - fit.heights(), 0.0)
    # Harmonics with amplitudes below the noise would change the fitted frequency of the wave. These harmonics are
    # removed, and the fit is repeated without them.
    amplitude_variance = 2.0 * float(np.mean(residual[known] ** 2)) / np.count_nonzero(known)
    significant = fit.amplitudes > _OVER_NOISE * math.sqrt(amplitude_variance)
    significant[0] = True
    if not significant.all():
        means.q, means.orders = fit.q, means.orders[significant]
        fit = means.fitted()
    return fit


def fit_sine(
    heights: NDArray[np.float64], known: NDArray[np.bool_], cycles: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a sine with a frequency near ``cycles`` [over the field]; return its fitted frequency and its heights.

    The fitted frequency maximises the Fourier integral of the heights with a Hann window. The frequency is exact to
    0.01 cycles. `fit_wave` is more precise and takes several times as long.
    """
    shape = heights.shape
    places = [np.arange(n) / n - 0.5 for n in shape]
    windows = [np.hanning(n + 2)[1:-1] if n > 1 else np.ones(1) for n in shape]
    faded = np.where(known, heights, 0.0) * windows[0][:, None] * windows[1]
    best = np.asarray(cycles, dtype=np.float64)
    for step in (0.5, 0.1, 0.02):
        steps = [step * np.arange(-2, 3) if n > 1 else np.zeros(1) for n in shape]
        waves = [
            np.exp(-2j * np.pi * np.outer(c + offsets, place))
            for c, offsets, place in zip(best, steps, places, strict=True)
        ]
        power = np.abs(waves[0] @ faded @ waves[1].T)
        row, column = np.unravel_index(int(np.argmax(power)), power.shape)
        best = best + np.array([steps[0][row], steps[1][column]])
    along_y, along_x = (np.exp(2j * np.pi * c * place) for c, place in zip(best, places, strict=True))
    # Amplitudes of the cosine and the sine at the fitted frequency, by least squares over the samples with known
    # heights.
    weight = known.astype(np.float64)
    twice = np.conj(along_y) ** 2 @ weight @ np.conj(along_x) ** 2 / np.sum(weight)
    once = 2.0 * (np.conj(along_y) @ np.where(known, heights, 0.0) @ np.conj(along_x)) / np.sum(weight)
    amplitude = (once - twice * np.conj(once)) / max(1.0 - abs(twice) ** 2, 1e-3)
    return best, np.outer(along_y, amplitude * along_x).real


@dataclass
class _Means:
    """Means of the heights in k rectangular blocks of samples, to which a wave of a frequency near ``q`` is fitted.

    Attributes:
        y: Centres of the blocks along y, relative to the centre of the field [µm], shape (k,).
        x: Centres of the blocks along x, relative to the centre of the field [µm], shape (k,).
        values: Means of the known samples in the blocks [µm], shape (k,).
        weights: Numbers of known samples in the blocks, shape (k,).
        shape: Number of samples of the field (ny, nx).
        pitch: Distance of the samples (dy, dx) [µm].
        blocks: Numbers of samples of a block along y and x.
        q: Frequency (y, x) of the wave at which the fit begins [1/µm].
        orders: Numbers of the harmonics of the wave that are fitted; 1 is the fundamental.
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
        cls, heights: NDArray[np.float64], known: NDArray[np.bool_], pitch: tuple[float, float],
        q: NDArray[np.float64], most: int,
    ) -> _Means:  # fmt: skip
        """Average heights over blocks of samples; the blocks suit a wave of frequency ``q`` and its harmonics."""
        orders, blocks = _orders_and_blocks(q, heights.shape, pitch, most)
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
        """Extents of the field along y and x [µm]."""
        return [n * step for n, step in zip(self.shape, self.pitch, strict=True)]

    @property
    def free(self) -> list[int]:
        """Axes along which the height field has more than one sample: 0 for y, 1 for x."""
        return [axis for axis in (0, 1) if self.shape[axis] > 1]

    def fitted(self) -> HarmonicFit:
        """Fit a wave, its harmonics and a tilt by the Gauss-Newton method; each step solves for all amplitudes.

        In strong noise a step can increase the residual of the fit. The step with the smallest residual is therefore
        returned.
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
            # Derivatives of the fitted wave with respect to its frequency [cycles over the field] along each axis.
            columns += [slope * place for place in relative]
            if residual < least:
                normal = np.stack(columns, axis=1)
                covariance = np.linalg.pinv((normal * self.weights[:, None]).T @ normal)[-len(relative) :]
                best = HarmonicFit(
                    q.copy(), self.orders, linear, covariance[:, -len(relative) :], self.shape, self.pitch, self.free
                )
                least = residual
            step = np.clip(_solved(columns, self.values, root)[-len(relative) :], -0.5, 0.5)
            if np.max(np.abs(step)) < _CONVERGED:
                break
            for axis, change in zip(self.free, step, strict=True):
                q[axis] += change / self.sizes[axis]
            if math.hypot(*(q * self.sizes)) < 1.0:
                # The fit ends, because a wave of less than one cycle over the field is indistinguishable from a bow.
                break
        assert best is not None  # noqa: S101 - for mypy; the first step sets it
        return best


@dataclass
class HarmonicFit:
    """Wave with harmonics and a tilt that are fitted to the heights of a field.

    Attributes:
        q: Fitted frequency (y, x) [1/µm].
        orders: Numbers of the fitted harmonics; 1 is the fundamental.
        linear: Amplitudes of the cosines, amplitudes of the sines, and the coefficients of offset and tilt [µm].
        covariance: Covariance matrix of the fitted frequency along the axes of ``free``, for heights with white noise
            of variance 1. The frequency is in cycles over the field.
        shape: Number of samples (ny, nx).
        pitch: Distance of the samples (dy, dx) [µm].
        free: Axes along which the field has more than one sample: 0 for y, 1 for x.
    """

    q: NDArray[np.float64]
    orders: NDArray[np.int64]
    linear: NDArray[np.float64]
    covariance: NDArray[np.float64]
    shape: tuple[int, ...]
    pitch: tuple[float, float]
    free: list[int]

    @property
    def amplitudes(self) -> NDArray[np.float64]:
        """Amplitudes of the fitted harmonics [µm], in the order of ``orders``."""
        count = len(self.orders)
        return np.hypot(self.linear[:count], self.linear[count : 2 * count])

    def _places(self) -> list[NDArray[np.float64]]:
        """Return the coordinates of the samples along y and x, relative to the centre of the field [µm]."""
        return [
            (np.arange(n, dtype=np.float64) - n / 2.0) * step for n, step in zip(self.shape, self.pitch, strict=True)
        ]

    def heights(self) -> NDArray[np.float64]:
        """Return the heights of the fitted wave at all samples [µm], shape (ny, nx).

        The heights include the fitted tilt. The caller subtracts them from the field before it fits the next wave; a
        remaining tilt would be mistaken for a wave.
        """
        places, count = self._places(), len(self.orders)
        result = np.full(self.shape, self.linear[2 * count])
        for axis, tilt in zip(self.free, self.linear[2 * count + 1 :], strict=True):
            run = tilt * places[axis] / (self.shape[axis] * self.pitch[axis])
            result += run[:, None] if axis == 0 else run
        return result + self._sum(np.ones(count))

    def slopes(self) -> NDArray[np.float64]:
        """Return the derivatives of the fitted wave with respect to its phase at all samples [µm], shape (ny, nx)."""
        return self._sum(np.asarray(1j * self.orders, dtype=np.complex128))

    def _sum(self, factors: NDArray[np.complex128] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sum of the fitted harmonics at all samples [µm], shape (ny, nx).

        Each harmonic is first multiplied by its element of ``factors``, a complex number.
        """
        places, count = self._places(), len(self.orders)
        amplitudes = factors * (self.linear[:count] - 1j * self.linear[count : 2 * count])
        result = np.zeros(self.shape)
        for order, amplitude in zip(self.orders, amplitudes, strict=True):
            along_y, along_x = (np.exp(2j * np.pi * order * self.q[axis] * places[axis]) for axis in (0, 1))
            result += np.outer(along_y, amplitude * along_x).real
        return result


def _orders_and_blocks(
    q: NDArray[np.float64], shape: tuple[int, ...], pitch: tuple[float, float], most: int
) -> tuple[NDArray[np.int64], list[int]]:
    """Return the numbers of the harmonics to fit, and how many samples are averaged along y and x before a fit."""
    cycles = [abs(float(q[axis])) * pitch[axis] if shape[axis] > 1 else 0.0 for axis in (0, 1)]
    most = max(1, min(most, math.floor(0.5 * OF_NYQUIST / max(cycles))))
    while True:
        # Samples are averaged over blocks before a fit. Along an axis where the wave hardly changes, blocks are as
        # short as for a wave with one period over the field.
        density = [_SAMPLES_PER_PERIOD * most * max(cycle, 1.0 / n) for cycle, n in zip(cycles, shape, strict=True)]
        blocks = [max(1, math.floor(1.0 / samples)) for samples in density]
        elements = math.prod(n // block for n, block in zip(shape, blocks, strict=True)) * (2 * most + 5)
        if most == 1 or elements <= _MOST_ELEMENTS:
            return np.arange(1, most + 1), blocks
        most -= 1


def _fade(cycles: NDArray[np.float64], block: int) -> NDArray[np.float64]:
    """Return the factor by which averaging over blocks of samples weakens a wave, for each frequency.

    Args:
        cycles: Frequencies of waves [cycles per sample].
        block: Number of samples of a block along one axis.
    """
    turn = np.sin(np.pi * cycles)
    tiny = np.abs(turn) < 1e-9
    return np.where(tiny, 1.0, np.sin(np.pi * cycles * block) / (block * np.where(tiny, 1.0, turn)))


def _solved(
    columns: list[NDArray[np.float64]], values: NDArray[np.float64], root: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the weighted least-squares solution by the normal equations.

    The normal equations are well conditioned here, because waves of different frequencies are nearly orthogonal.
    """
    matrix = np.stack(columns, axis=1) * root[:, None]
    return np.asarray(np.linalg.lstsq(matrix.T @ matrix, matrix.T @ (values * root), rcond=1e-12)[0], dtype=np.float64)
