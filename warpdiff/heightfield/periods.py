"""Periods of a height field: significant lines of its spectrum, their mean frequency, and its standard error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield import cleaning
from warpdiff.heightfield.harmonic_fit import FEWEST_PERIODS, MOST_HARMONICS, HarmonicFit, fit_sine, fit_wave
from warpdiff.heightfield.spectral_lines import Line, WindowedSpectrum

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField

# Share of the variance below which a wave is not reported.
_LEAST_SHARE = 1e-3
# Radius of the band around a line, relative to its frequency, and at least [cycles].
_BAND, _LEAST_BAND = 0.35, 3.0
# Power that a fit may leave in the band, relative to that of the fitted wave, for the wave to count as coherent.
_COHERENT = 0.5
# Share of that power that a second wave must explain, to be no part of a wavering line.
_SECOND = 0.7


@dataclass(frozen=True)
class Period:
    period_um: float
    standard_error_um: float
    direction_deg: float
    harmonics_um: tuple[float, ...]
    share: float
    frequency: tuple[float, float]
    debug: object = None

    def __str__(self) -> str:
        digits = max(-math.floor(math.log10(max(self.standard_error_um, 1e-6 * self.period_um))), 0)
        length = f"{self.period_um:.{digits}f} ± {self.standard_error_um:.{digits}f} µm"
        return f"{length} at {round(self.direction_deg)}°"

    def __repr__(self) -> str:
        return f"Period({self}, share {self.share:.3g})"


def fit(heightfield: HeightField, count: int) -> tuple[Period, ...]:
    field = heightfield.levelled(1)
    known = ~field.missing
    values = field.heights_um[known]
    scale = float(np.max(np.abs(heightfield.heights_um[known])))
    deviation = float(np.std(values))
    if deviation <= 1e-10 * scale or heightfield.heights_um.size < 8:
        return ()
    search = _Search(field.filled().heights_um / deviation, known, heightfield.size_um)
    with single_threaded_blas():
        waves = search.waves(count)
    result = [wave.period(deviation) for wave in waves]
    return tuple(sorted((p for p in result if p.share >= _LEAST_SHARE), key=lambda period: -period.share))


@dataclass
class _Wave:
    q: NDArray[np.float64]
    error: float
    harmonics: tuple[float, ...]
    share: float
    debug: object

    def period(self, deviation: float) -> Period:
        frequency = float(np.hypot(*self.q))
        qy, qx = self.q.tolist()
        if qx < 0.0 or (qx == 0.0 and qy < 0.0):
            qy, qx = -qy, -qx
        return Period(
            1.0 / frequency, self.error / frequency**2, math.degrees(math.atan2(qy, qx)) + 0.0,
            tuple(deviation * a for a in self.harmonics), self.share, (qy, qx), self.debug
        )  # fmt: skip


class _Search:
    """Search for waves one after the other, in heights of standard deviation 1."""

    def __init__(self, heights, known, sizes):
        self.heights, self.known, self.sizes = heights, known, np.array(sizes)
        self.pitch = tuple(s / n for s, n in zip(sizes, heights.shape))
        self.excluded = np.zeros(heights.shape, dtype=bool)
        self.variance = float(np.mean(heights[known] ** 2))
        self.found = []

    def waves(self, count):
        result = []
        spectrum = WindowedSpectrum(self.heights, self.sizes)
        for _ in range(3 * count + 2):
            line = spectrum.strongest_line(self.excluded)
            if line is None:
                break
            wave, spectrum = self._measured(spectrum, line)
            if wave is not None:
                result.append(wave)
                if len(result) == count:
                    break
        return result

    def _measured(self, spectrum, line):
        line = self._fundamental(spectrum, line)
        length = float(np.hypot(*line.cycles))
        band = max(_BAND * length, _LEAST_BAND)
        before = spectrum.excess(line, band)
        cycles, residual, after_spectrum = self._without_sine(self.heights, line.cycles)
        strayed = np.hypot(*(cycles - line.cycles)) > max(2.0, 0.1 * length)
        after = after_spectrum.excess(line, band)
        spread = 2.0 * line.background * math.sqrt(np.pi * band**2 / 2.25 if min(self.heights.shape) > 1 else 2 * band / 1.5)
        ratio = (after - spread) / max(before - after, 1e-300)
        near = [o for o in self.found if self._near(line.cycles, o)]
        if near and (strayed or (before - after) / max(before, 1e-300) < _SECOND or any(np.hypot(*(cycles - o[0])) < 4 for o in near)):
            # A part of the band of a stronger line.
            self._exclude(line.cycles, 3.0, harmonics=False)
            return None, spectrum
        coherent = not strayed and ratio < _COHERENT
        if not coherent and not strayed:
            # A second wave of a similar frequency explains nearly all of the rest; a wavering line is more than two.
            place = after_spectrum.strongest_within(line.cycles, band)
            spectrum2 = self._without_sine(residual, place)[2]
            after2 = spectrum2.excess(line, band)
            coherent = 1.0 - after2 / max(after, 1e-300) > _SECOND and np.hypot(*(place - cycles)) > 2
        if coherent:
            fit = fit_wave(self.heights, self.known, self.pitch, cycles / self.sizes)
            residual = np.where(self.known, self.heights - fit.heights(), 0.0)
            after_spectrum = WindowedSpectrum(residual, self.sizes)
            cycles = fit.q * self.sizes
            wave = self._coherent(fit, residual, ratio)
            self._exclude(cycles, 2.5)
            self.found.append((cycles, band))
            self.heights = residual
            return wave, after_spectrum
        wave = self._wavering(line, band)
        self._exclude(line.cycles, band, harmonics=False)
        if wave is not None:
            self._exclude(wave.q * self.sizes, band)
        return wave, spectrum

    def _fundamental(self, spectrum, line):
        best = line
        power = spectrum.around(line.cycles)
        for order in (2, 3, 4, 5):
            place = spectrum.strongest_within(line.cycles / order, 1.0 + 0.05 * np.hypot(*line.cycles) / order)
            if np.hypot(*place) < FEWEST_PERIODS: break
            if spectrum.around(place) > power:
                candidate = spectrum.line_at(place)
                if candidate is not None:
                    power, best = spectrum.around(place), candidate
        return best

    def _without_sine(self, heights, cycles):
        cycles, wave = fit_sine(heights, self.known, cycles)
        residual = np.where(self.known, heights - wave, 0.0)
        return cycles, residual, WindowedSpectrum(residual, self.sizes)

    def _near(self, cycles, other):
        return np.hypot(*(cycles - other[0])) <= other[1]

    def _exclude(self, cycles, radius, harmonics=True):
        shape = np.array(self.heights.shape)
        if np.hypot(*cycles) == 0: return
        for order in range(1, (MOST_HARMONICS if harmonics else 1) + 1):
            for sign in (1.0, -1.0):
                # Harmonics beyond the Nyquist limit alias.
                place = sign * order * np.asarray(cycles)
                place = place - shape * np.round(place / shape)
                self._mask(place, radius if order == 1 else max(radius, 0.5 * np.hypot(*cycles)))

    def _mask(self, cycles, radius):
        parts = [np.arange(max(math.ceil(c - radius), -(n // 2)), min(math.floor(c + radius) + 1, (n + 1) // 2)) for c, n in zip(cycles, self.heights.shape)]
        if all(p.size for p in parts):
            y, x = parts
            self.excluded[y[0] + self.heights.shape[0] // 2 : y[-1] + 1 + self.heights.shape[0] // 2, x[0] + self.heights.shape[1] // 2 : x[-1] + 1 + self.heights.shape[1] // 2] |= np.hypot(y[:, None] - cycles[0], x[None] - cycles[1]) <= radius

    def _coherent(self, fit, residual, ratio):
        score = np.where(self.known, residual * fit.slopes(), 0.0)
        normal = float(np.mean(np.where(self.known, fit.slopes() ** 2, 0.0)))
        power = np.abs(np.fft.fft2(score)) ** 2 / score.size / normal
        noise = [
            _extrapolated(power, axis, self.heights.shape, 0.503)[0] for axis in fit.free
        ]
        cov = fit.covariance * np.sqrt(np.outer(noise, noise))
        q = fit.q
        frequency = float(np.hypot(*q))
        along = np.array([q[a] / self.sizes[a] for a in fit.free]) / frequency
        error = math.sqrt(max(float(along @ cov @ along), 0.0))
        harmonics = np.zeros(fit.orders[-1]); harmonics[fit.orders - 1] = fit.amplitudes
        k = self.known
        share = max(float(np.mean(self.heights[k] ** 2) - np.mean(residual[k] ** 2)) / self.variance, 0.0)
        dbg = []
        for axis in fit.free:
            ny, nx = self.heights.shape
            ks, js = np.meshgrid(np.arange(1, 1 + min(24, ny * nx // max(ny, nx) and max(ny, nx) // 4)), [-1, 0, 1] if min(ny, nx) > 1 else [0], indexing="ij")
            v = power[ks % ny, js % nx] if axis == 0 else power[js % ny, ks % nx]
            dbg.append((ks, js, v))
        return _Wave(q, error, tuple(harmonics.tolist()), share, ("coherent", ratio, noise, dbg, fit.covariance, along, frequency))

    def _wavering(self, line, band):
        from scipy import fft, special
        periodic = self.heights - cleaning.smooth_part(self.heights)
        coefficients = np.fft.fftshift(fft.fft2(periodic)) / math.sqrt(periodic.size)
        ny, nx = self.heights.shape
        rows = (np.arange(ny) - float(ny // 2))[:, None]; columns = (np.arange(nx) - float(nx // 2))[None]
        centre = line.cycles.copy()
        radius = band
        window = np.ix_(*(np.abs(a.ravel() - c) <= 1.6 * band + 2 for a, c in zip((rows, columns), centre)))
        rows, columns = rows[window[0].ravel()], columns[:, window[1].ravel()]
        coefficients = coefficients[window]
        spectrum = np.abs(coefficients) ** 2
        excess_power = spectrum - line.background_at(rows, columns)
        for step in range(12):
            dy, dx = rows - centre[0], columns - centre[1]
            away = np.hypot(dy, dx)
            inside = away <= radius
            power = np.where(inside, excess_power, 0.0)
            excess = float(np.sum(power))
            if excess <= 0.0:
                return None
            shift = np.array([float(np.sum(power * dy)), float(np.sum(power * dx))]) / excess
            rms = math.sqrt(max(float(np.sum(power * away**2)), 0.0) / excess)
            centre = centre + np.clip(shift, -0.3 * radius, 0.3 * radius)
            radius = max(min(2.5 * rms, _BAND * float(np.hypot(*centre))), _LEAST_BAND)
            if np.max(np.abs(shift)) < 1e-3:
                break
        q = centre / self.sizes
        frequency = float(np.hypot(*q))
        unit = q / frequency
        # local
        reach = int(radius) + 1
        part = np.where(inside, coefficients, 0.0)
        rr, cc = rows.ravel(), columns.ravel()
        off = (rr - centre[0])[:, None] * unit[0] / self.sizes[0] + (cc - centre[1])[None] * unit[1] / self.sizes[1]
        grid = [1 if n == 1 else max(4 * reach + 4, m) for n, m in zip((ny, nx), part.shape)]
        z = np.fft.ifft2(part, grid); zo = np.fft.ifft2(part * off, grid)
        u = (np.conj(z) * zo).real
        d = np.abs(z) ** 2
        delta = float(np.sum(u) / np.sum(d))
        u = u - delta * d
        spec = np.abs(np.fft.fft2(u)) ** 2
        ky = np.fft.fftfreq(grid[0], 1 / grid[0])[:, None]; kx = np.fft.fftfreq(grid[1], 1 / grid[1])[None]
        kk = np.hypot(ky, kx)
        half = (kx > 0) | ((kx == 0) & (ky > 0))
        use = half & (kk > 0) & (kk < (2.4 if min(ny, nx) > 1 else 4.5))
        ordinates = spec[use]
        dof = 2 * ordinates.size
        s0 = float(np.mean(ordinates))
        total = float(np.sum(np.where(inside, spectrum, 0.0)))
        error = math.sqrt(s0) / float(np.sum(d)) * total / max(excess, 1e-300)
        error *= float(special.stdtrit(dof, 0.97725)) / 2.0
        share = 2.0 * excess / periodic.size / self.variance
        return _Wave(q, error, (math.sqrt(max(4.0 * excess / periodic.size, 0.0)),), share, ("wavering", radius, line, rms, kk[half & (kk > 0) & (kk < 12)], spec[half & (kk > 0) & (kk < 12)], float(np.sum(d)) * max(excess, 1e-300) / total, frequency))


def _extrapolated(power, axis, shape, at):
    """Noise power at ``at`` cycles along an axis from ordinates: a + b / k²."""
    ny, nx = shape
    other = [-1, 0, 1] if min(shape) > 1 else [0]
    ks, js = np.meshgrid(np.arange(1, 7), other, indexing="ij")
    n = shape[axis]
    ok = ks < n // 2
    ks, js = ks[ok], js[ok]
    values = power[ks % ny, js % nx] if axis == 0 else power[js % ny, ks % nx]
    k2 = (ks**2 + js**2).astype(float)
    values = np.maximum(values, 1e-300)
    best = []
    for r in [0.0, *(10.0 ** np.arange(-0.5, 2.6, 0.25))]:
        shape_ = 1.0 + r / k2
        a = float(np.mean(values / shape_))
        loglik = -float(np.sum(np.log(a * shape_))) - values.size
        best.append((loglik, a * (1.0 + r / at**2)))
    l = np.array([b[0] for b in best]); v = np.array([b[1] for b in best])
    w = np.exp(l - l.max()); w /= w.sum()
    return float(np.sum(w * v)), float(v[np.argmax(l)])


def cut_whole(heightfield: HeightField) -> HeightField:
    periods = fit(heightfield, 3)
    if not periods:
        raise ArgumentValueError(
            f"{ref('whole_periods()')} needs a period that repeats at least three times, and this field has none; use "
            f"{ref('periodic()')}, or a larger patch"
        )
    size = []
    for axis in (0, 1):
        frequency = abs(periods[0].frequency[axis])
        number = math.floor(frequency * heightfield.size_um[axis] + 1e-6)
        size.append(number / frequency if number else heightfield.size_um[axis])
    return heightfield.cropped((size[0], size[1]), offset_um=(0.0, 0.0))
