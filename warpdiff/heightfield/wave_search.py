"""Search for the periodic waves of a height field, which cause narrow maxima (lines) of its spectrum.

Heights are scaled to a variance of 1, and lengths by the larger extent of the field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.heightfield import cleaning
from warpdiff.heightfield.harmonic_fit import FEWEST_PERIODS, MOST_HARMONICS, HarmonicFit, fit_sine, fit_wave
from warpdiff.heightfield.spectral_lines import Line, WindowedSpectrum

if TYPE_CHECKING:
    from numpy.typing import NDArray

# A wave must repeat at least three times over the field, minus this number of periods. The margin is necessary because
# the fitted frequency of a wave has an error.
_ROUNDED_PERIODS = 0.02
# The power of a wave is measured in a band of frequencies around its line (maximum) in the spectrum. `_BAND` is the
# radius of this band relative to the frequency of the line. `_LEAST_BAND` is the smallest radius of a band [cycles over
# the field].
_BAND, _LEAST_BAND = 0.35, 3.0
# A wavering wave, whose phase varies over the field, causes several lines of the spectrum. A weaker line belongs to
# such a wave if its distance from the mean frequency of the wave, relative to this frequency, is at most this value.
# The value was fitted to simulated waves whose phase varies as a sine with an amplitude of 2.4 radians: nearly all of
# their power is in lines within this distance. If doubled, lines of other waves are discarded.
_SIDE_LINES = 0.55
# Once a wave is found, bands of frequencies around its harmonics are excluded from the search for further waves. This
# is the radius of such a band, relative to the frequency of the wave.
_HARMONIC_BAND = 0.5
# Harmonics above the Nyquist limit alias to lower frequencies. The aliases of harmonics up to this number are excluded
# from the search for further waves. Higher harmonics have little power, and the excluded bands around all aliases would
# cover the spectrum.
_MOST_ALIASED = 5
# The power of a wavering wave, whose phase varies over the field, is spread over a band of frequencies. This is the
# radius of the band, in standard deviations of the frequencies in it, which are weighted by power.
_BAND_IN_DEVIATIONS = 2.5
# A wavering wave is one whose phase varies over the field. The search for its mean frequency begins with a band of
# frequencies of at most this radius [cycles over the field]. The value is the width of the widest boxes over which the
# spectrum is averaged to search lines. If doubled, the bands of periods that are short compared with the field contain
# neighbouring lines, which move the mean frequency.
_FIRST_BAND = 31.0
# Two spectral lines count as one if their distance is below this value [cycles over the field], because both are within
# one main lobe of the Hann window.
_RESOLUTION = 2.5
# A wave counts as coherent if a single sine explains most of its power. This sine is subtracted from the heights. The
# power that remains around its frequency must be less than this fraction of the power of the sine.
_COHERENT = 0.5
# After a sine is subtracted from the heights, a second sine counts as another wave if it explains at least this share
# of the power that remains near the first sine. Otherwise this power belongs to the first wave, which then counts as a
# wavering wave: its phase varies over the field.
_SECOND = 0.7
# Variations of the phase of a coherent wave cause pairs of side lines in the spectrum. A line near the wave counts as a
# side line if the mirrored frequency on the other side of the wave has more than this fraction of the power of the
# line.
_TWIN = 0.25
# Search for the mean frequency of a wavering wave, whose phase varies over the field. `_MOST_STEPS` is the largest
# number of steps. `_LARGEST_STEP` is the largest step, relative to the radius of the wave's band of frequencies. The
# search ends at a step below `_CONVERGED` [cycles over the field].
_MOST_STEPS, _LARGEST_STEP, _CONVERGED = 12, 0.3, 1e-3
# The standard error of a wave's frequency follows from the spectrum of its phase error, the deviation of its phase from
# that of a perfect grating. The powers at the lowest frequencies of this spectrum are extrapolated to a still lower
# frequency. A coherent wave has nearly the phase of a perfect grating: the lowest `_COHERENT_ORDINATES` frequencies
# along each axis are extrapolated to `_COHERENT_AT`. The phase of a wavering wave varies more: the frequencies below
# `_WAVERING_ORDINATES` are extrapolated to `_WAVERING_AT`. Frequencies are in cycles over the field. In a pair, the
# first number is for fields with several samples along both axes, and the second for single rows or columns. The values
# were fitted by bench/reproduce/periods.py. In theory, `_COHERENT_AT` and `_WAVERING_AT` are 0.5 if the phase error is
# an endless random walk.
_COHERENT_ORDINATES, _WAVERING_ORDINATES = 24, (5.0, 3.2)
_COHERENT_AT, _WAVERING_AT = (0.43, 0.32), (0.4, 0.7)
# The spectrum of the phase error of a wave is modelled as white noise plus a random walk. The tuple contains the ratios
# that are tried: power of the random walk to power of the white noise, at one cycle over the field. The weight of a
# ratio is the likelihood of the measured spectrum at this ratio (`_low_power`).
_WALKS = (0.0, *(10.0 ** np.arange(-0.5, 5.1, 0.5)).tolist())


@dataclass(frozen=True)
class Wave:
    """Periodic wave in a scaled field, whose heights have a variance of 1 and whose larger extent is 1.

    Attributes:
        q: Wave vector (y, x) [cycles per larger extent].
        error: Standard error of the frequency along the wave vector [cycles per larger extent].
        harmonics: Amplitudes of the fundamental and its harmonics, in standard deviations of the heights.
        share: Fraction of the variance of the heights that the wave explains.
        is_coherent: Whether the phase is nearly that of a perfect grating, see `warpdiff.Period`.
    """

    q: NDArray[np.float64]
    error: float
    harmonics: tuple[float, ...]
    share: float
    is_coherent: bool


class WaveSearch:
    """Search for the waves of a height field, one after the other.

    Coherent waves have nearly the phase of a perfect grating; they are fitted and subtracted with their harmonics.
    Wavering waves, whose phase varies over the field, cannot be subtracted. Bands of frequencies around wavering waves,
    and around the harmonics of all waves, are not searched again.

    Attributes:
        heights: Heights of the field, scaled to unit variance, without the waves found so far, gaps filled, shape
            (ny, nx).
        known: Mask of the samples that are not missing.
        sizes: Extents of the field along y and x, relative to the larger extent.
        excluded: Mask of the Fourier coefficients that are not searched, zero frequency in the centre.
        bands: Frequency and radius of the band of each coherent wave found so far [cycles over the field].
        wavering: Mean frequencies of the wavering waves found so far [cycles over the field].
    """

    def __init__(self, heights: NDArray[np.float64], known: NDArray[np.bool_], sizes: tuple[float, float]) -> None:
        self.heights, self.known, self.sizes = heights, known, np.array(sizes)
        self.pitch = sizes[0] / heights.shape[0], sizes[1] / heights.shape[1]
        self.excluded: NDArray[np.bool_] = np.zeros(heights.shape, dtype=bool)
        self.bands: list[tuple[NDArray[np.float64], float]] = []
        self.wavering: list[NDArray[np.float64]] = []

    @property
    def is_plane(self) -> bool:
        """Whether the field has more than one sample along both axes."""
        return bool(min(self.heights.shape) > 1)

    def strongest(self, count: int) -> list[Wave]:
        """Find at most ``count`` waves, beginning with the strongest line (narrow maximum) of the spectrum."""
        waves: list[Wave] = []
        spectrum = WindowedSpectrum(self.heights)
        # More spectral lines are examined than waves are requested, because lines that belong to earlier waves are
        # rejected.
        for _ in range(2 * count + 2):
            line = spectrum.strongest_line(self.excluded, self.sizes)
            if line is None:
                break
            wave, spectrum = self._measured(spectrum, line)
            if wave is not None and math.hypot(*(wave.q * self.sizes)) >= FEWEST_PERIODS - _ROUNDED_PERIODS:
                waves.append(wave)
                if len(waves) == count:
                    break
        return waves

    def _measured(self, spectrum: WindowedSpectrum, line: Line) -> tuple[Wave | None, WindowedSpectrum]:
        """Return the wave that causes a spectral line, and the spectrum in which the next line is searched.

        The wave is None if the line belongs to a wave that was found before, or has no power above the background of
        the spectrum. For a coherent wave, which is subtracted from the heights, the second result is the spectrum of
        the remaining heights. Otherwise it is ``spectrum``.
        """
        line = self._fundamental(spectrum, line)
        length = float(np.hypot(*line.cycles))
        band = max(_BAND * length, _LEAST_BAND)
        before = spectrum.excess(line, band)
        peak = spectrum.strongest_within(line.cycles, band)
        cycles, residual = self._without_sine(self.heights, peak)
        rest = WindowedSpectrum(residual)
        after = rest.excess(line, band)
        has_strayed = _distance(cycles, peak) > 2.0
        close = [centre for centre, radius in self.bands if _distance(line.cycles, centre) <= radius]
        is_part = bool(close) and (
            has_strayed
            or before - after < _SECOND * before
            or min(_distance(cycles, centre) for centre in close) < _RESOLUTION + 1.5
        )
        if is_part or self._is_side_line(spectrum, peak) or self._is_beside_wavering(peak):
            self._exclude(line.cycles, _LEAST_BAND)
            return None, spectrum
        if not has_strayed and self._is_coherent(line, band, before, after, rest, residual, cycles):
            return self._coherent(cycles, band)
        wave = self._wavering(line, band)
        self._exclude(line.cycles, band)
        if wave is None or self._is_beside_wavering(wave.q * self.sizes):
            return None, spectrum
        self._exclude_harmonics(wave.q * self.sizes, band)
        self.wavering.append(wave.q * self.sizes)
        return wave, spectrum

    def _is_side_line(self, spectrum: WindowedSpectrum, cycles: NDArray[np.float64]) -> bool:
        """Return whether a frequency is that of a side line of a coherent wave that was found before.

        Variations of the phase of a wave cause pairs of side lines in the spectrum, at mirrored frequencies on both
        sides of the frequency of the wave.
        """
        power = spectrum.around(cycles)
        return any(
            _distance(cycles, centre) < float(np.hypot(*centre))
            and spectrum.around(2.0 * centre - cycles) > _TWIN * power
            for centre, _ in self.bands
        )

    def _is_beside_wavering(self, cycles: NDArray[np.float64]) -> bool:
        """Return whether a spectral line at this frequency belongs to a nearby wave whose phase varies."""
        return any(_distance(cycles, other) <= _SIDE_LINES * float(np.hypot(*other)) for other in self.wavering)

    def _fundamental(self, spectrum: WindowedSpectrum, line: Line) -> Line:
        """Return the strongest of the spectral lines at 1, 1/2, 1/3, 1/4 and 1/5 of the frequency of a line.

        If the line is that of a harmonic of a wave, the result is the line of the wave's fundamental.
        """
        best, power = line, spectrum.around(line.cycles)
        for order in (2, 3, 4, 5):
            guess = line.cycles / order
            place = spectrum.strongest_within(guess, 1.0 + 0.05 * float(np.hypot(*guess)))
            if np.hypot(*place) < FEWEST_PERIODS:
                break
            if spectrum.around(place) > power:
                lower = spectrum.line_at(place, self.sizes)
                if lower is not None:
                    best, power = lower, spectrum.around(place)
        return best

    def _is_coherent(
        self, line: Line, band: float, before: float, after: float, rest: WindowedSpectrum,
        residual: NDArray[np.float64], cycles: NDArray[np.float64],
    ) -> bool:  # fmt: skip
        """Return whether one sine explains the power of the spectrum around a line (maximum).

        The result is also True if most of the power that remains without this sine is in a second sine, with a
        frequency that differs by more than 2 cycles over the field. The second sine is then another wave.
        """
        coefficients = math.pi * band**2 / 2.25 if self.is_plane else band / 0.75
        noise = 2.0 * line.background * math.sqrt(coefficients)
        if after - noise < _COHERENT * (before - after):
            return True
        second, without_both = self._without_sine(residual, rest.strongest_within(line.cycles, band))
        left = WindowedSpectrum(without_both).excess(line, band)
        return after - left > _SECOND * after and _distance(second, cycles) > 2.0

    def _without_sine(
        self, heights: NDArray[np.float64], cycles: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Fit a sine near a frequency [cycles over the field]; return its frequency, and the heights minus the sine."""
        fitted, sine = fit_sine(heights, self.known, cycles)
        return fitted, np.where(self.known, heights - sine, 0.0)

    def _coherent(self, cycles: NDArray[np.float64], band: float) -> tuple[Wave, WindowedSpectrum]:
        """Fit a wave of nearly constant frequency, and subtract it; return it and the spectrum of the other heights."""
        fit = fit_wave(self.heights, self.known, self.pitch, cycles / self.sizes)
        residual = np.where(self.known, self.heights - fit.heights(), 0.0)
        frequency = float(np.hypot(*fit.q))
        along = np.array([fit.q[axis] / self.sizes[axis] for axis in fit.free]) / frequency
        noise = self._noise(fit, residual)
        covariance = fit.covariance * np.sqrt(np.outer(noise, noise))
        harmonics = np.zeros(fit.orders[-1])
        harmonics[fit.orders - 1] = fit.amplitudes
        known = self.known
        wave = Wave(
            fit.q, math.sqrt(max(float(along @ covariance @ along), 0.0)), tuple(harmonics.tolist()),
            max(float(np.mean(self.heights[known] ** 2) - np.mean(residual[known] ** 2)), 0.0), is_coherent=True,
        )  # fmt: skip
        self.heights = residual
        self.bands.append((fit.q * self.sizes, band))
        self._exclude_harmonics(fit.q * self.sizes, _RESOLUTION)
        return wave, WindowedSpectrum(residual)

    def _noise(self, fit: HarmonicFit, residual: NDArray[np.float64]) -> list[float]:
        """Return, for each axis, the variance of white noise that changes the fitted frequency as ``residual`` does.

        ``residual`` is the heights minus the fitted wave. It is multiplied by the derivative of the wave with respect
        to its phase. In the spectrum of this product, only the lowest spatial frequencies cause an error of the wave's
        fitted frequency. The power at these frequencies comes from noise, from steps between scan lines or from
        variations of the phase.
        """
        slopes = np.where(self.known, fit.slopes(), 0.0)
        power = np.abs(np.fft.fft2(residual * slopes)) ** 2 / float(np.sum(slopes**2))
        beside = np.array([-1, 0, 1] if self.is_plane else [0])
        result = []
        for axis in fit.free:
            most = max(min(_COHERENT_ORDINATES, power.shape[axis] // 4), 1)
            along, across = np.meshgrid(np.arange(1, most + 1), beside, indexing="ij")
            index = (along, across) if axis == 0 else (across, along)
            result.append(_low_power(power[index], along**2 + across**2, _COHERENT_AT[not self.is_plane]))
        return result

    def _wavering(self, line: Line, band: float) -> Wave | None:
        """Measure the mean frequency of a wavering wave; return None if no power in its band is above the background.

        The phase of a wavering wave varies over the field. The mean frequency is the centroid of the power within a
        disc of frequencies (band) that is centred on the mean frequency, and is found by iteration. The standard error
        of the mean frequency follows from the slow variation of the local frequency over the field.
        """
        from scipy import fft, special

        periodic = self.heights - cleaning.smooth_part(self.heights)
        centres = [n // 2 for n in periodic.shape]
        places = [
            np.arange(max(math.ceil(c - 1.6 * band - 2.0), -centre), min(int(c + 1.6 * band + 3.0), n - centre))
            for c, n, centre in zip(line.cycles, periodic.shape, centres, strict=True)
        ]
        coefficients = fft.fft2(periodic)[np.ix_(*places)] / math.sqrt(periodic.size)
        rows, columns = places[0][:, None], places[1][None, :]
        power = np.abs(coefficients) ** 2
        above = power - line.background_at(rows, columns)
        centre, radius = line.cycles, min(band, _FIRST_BAND)
        for _ in range(_MOST_STEPS):
            dy, dx = rows - centre[0], columns - centre[1]
            inside = np.hypot(dy, dx) <= radius
            excess = float(np.sum(above[inside]))
            if excess <= 0.0:
                return None
            shift = np.array([np.sum((above * dy)[inside]), np.sum((above * dx)[inside])]) / excess
            variance = max(float(np.sum((above * (dy**2 + dx**2))[inside])) / excess, 0.0)
            centre = centre + np.clip(shift, -_LARGEST_STEP * radius, _LARGEST_STEP * radius)
            radius = min(_BAND_IN_DEVIATIONS * math.sqrt(variance), _BAND * float(np.hypot(*centre)))
            radius = max(radius, _LEAST_BAND)
            if np.max(np.abs(shift)) < _CONVERGED:
                break
        q = centre / self.sizes
        frequency = float(np.hypot(*q))
        if not frequency > 0.0:
            return None
        # The Fourier coefficients in the band of the wave give a complex wave z, with the derivative ∂z along the wave
        # vector. The local frequency of the wave is the imaginary part of z*∂z over 2π|z|², where z* is the complex
        # conjugate of z.
        part = np.where(inside, coefficients, 0.0)
        offset = (q[0] * (rows - centre[0]) / self.sizes[0] + q[1] * (columns - centre[1]) / self.sizes[1]) / frequency
        grid = [n if n == 1 else 2 * n for n in part.shape]
        wave, derivative = fft.ifft2(part, grid), fft.ifft2(part * offset, grid)
        density = np.abs(wave) ** 2
        score = (np.conj(wave) * derivative).real
        score -= density * float(np.sum(score) / np.sum(density))
        spectrum = np.abs(fft.fft2(score)) ** 2
        distance = np.hypot(*np.meshgrid(*(np.fft.fftfreq(n, 1.0 / n) for n in grid), indexing="ij"))
        low = (distance > 0.0) & (distance < _WAVERING_ORDINATES[not self.is_plane])
        variance = _low_power(spectrum[low], distance[low] ** 2, _WAVERING_AT[not self.is_plane])
        # The square root of `variance` over the sum of `density` is the standard error of the mean frequency over all
        # power in the band. Only the power above the background determines the mean frequency. The standard error is
        # therefore multiplied by the ratio of all power to the power above the background.
        error = math.sqrt(variance) / float(np.sum(density)) * float(np.sum(power[inside])) / excess
        degrees = np.count_nonzero(low)
        error *= float(special.stdtrit(degrees, special.ndtr(2.0))) / 2.0
        # The band of frequencies contains half of the power of the wave. The other half is at opposite frequencies.
        share = 2.0 * excess / periodic.size
        return Wave(q, error, (math.sqrt(2.0 * share),), min(share, 1.0), is_coherent=False)

    def _exclude_harmonics(self, cycles: NDArray[np.float64], radius: float) -> None:
        """Exclude bands around a frequency, its harmonics and their aliases from the search for spectral lines."""
        self._exclude(cycles, radius)
        shape = np.array(self.heights.shape)
        for order in range(2, MOST_HARMONICS + 1):
            place = order * cycles
            alias = place - shape * np.round(place / shape)
            if np.array_equal(place, alias):
                self._exclude(place, max(radius, _HARMONIC_BAND * float(np.hypot(*cycles))))
            elif order <= _MOST_ALIASED:
                self._exclude(alias, radius)

    def _exclude(self, cycles: NDArray[np.float64], radius: float) -> None:
        """Exclude bands around a frequency and around the opposite frequency from the search for spectral lines."""
        ny, nx = self.excluded.shape
        for centre in (cycles, -cycles):
            rows, columns = (
                np.arange(max(math.ceil(c - radius), -(n // 2)), min(math.floor(c + radius) + 1, n - n // 2))
                for c, n in zip(centre, (ny, nx), strict=True)
            )
            inside = np.hypot(rows[:, None] - centre[0], columns[None, :] - centre[1]) <= radius
            self.excluded[np.ix_(rows + ny // 2, columns + nx // 2)] |= inside


def _distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the distance of two frequencies (y, x) in the frequency plane [cycles over the field]."""
    return float(np.hypot(*(a - b)))


def _low_power(power: NDArray[np.float64], squares: NDArray[np.float64], at: float) -> float:
    """Extrapolate a power spectrum to a low frequency k, as the sum a + b/k² of white noise and a random walk.

    Args:
        power: Powers at the lowest frequencies, which are exponentially distributed.
        squares: Squares of the frequencies k of these powers.
        at: Frequency to which the spectrum is extrapolated.

    Returns:
        The geometric mean of the extrapolated powers for many ratios b/a, weighted by the likelihoods of these ratios.
        The most likely ratio alone is not used: it is often 0, even for a random walk, because the measured powers are
        few.
    """
    values = np.maximum(power, 1e-300)
    likelihoods, results = [], []
    for walk in _WALKS:
        shape = 1.0 + walk / squares
        white = float(np.mean(values / shape))
        likelihoods.append(-float(np.sum(np.log(white * shape))))
        results.append(math.log(white * (1.0 + walk / at**2)))
    weights = np.exp(np.array(likelihoods) - max(likelihoods))
    return math.exp(float(np.average(results, weights=weights)))
