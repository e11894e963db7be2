"""Periods of a height field: waves that cause narrow maxima (lines) of its spectrum, with standard errors."""

from __future__ import annotations

import math
import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.table import Table, save_table
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.wording import ArgumentValueError, ref
from warpdiff.heightfield.wave_search import WaveSearch

if TYPE_CHECKING:
    from warpdiff.heightfield.field import HeightField
    from warpdiff.heightfield.wave_search import Wave

# A wave is reported as a period only if it explains at least this fraction of the variance of the heights.
_LEAST_SHARE = 1e-3
# Least number of samples per period, along x and along y, of a resolved period. The value is limited by artefacts: a
# scan that was rotated or scaled has copies of its spectral lines near the sampling limit of two samples per period.
LEAST_SAMPLES = 3.0
# A field counts as flat if the standard deviation of its heights, relative to the largest absolute height, is below
# this value.
_ROUNDING = 1e-10
# Cache of the periods that were found in each height field: tuples of periods, by the argument ``count`` of
# `HeightField.periods`.
_found: weakref.WeakKeyDictionary[HeightField, dict[int, tuple[Period, ...]]] = weakref.WeakKeyDictionary()


@dataclass(frozen=True)
class Period:
    """Periodic wave in a height field, with its harmonics.

    A period causes a narrow maximum (line) of the spectrum. The line must be significantly higher than the spectrum at
    lower and at higher frequencies of the same direction. Noise causes no such line, whatever its autocorrelation is.

    Attributes:
        period_um: Mean length of the period [µm]: the inverse of the mean frequency of the wave, which is weighted by
            power.
        standard_error_um: Standard error of the period [µm], as an estimate for the whole surface of which the field is
            a part. It includes noise and the variation of the period over the field. Two standard errors contain the
            mean of the surface in about 95 % of fields.
        direction_deg: Direction of the wave vector [degrees], from x towards y, above −90 and at most 90.
        harmonics_um: Amplitudes of the fundamental and its harmonics [µm], at most sixteen, fewer if the pitch is too
            coarse; 0 for harmonics below the noise. If the phase of a wave varies by more than a fraction of a period
            over the field, only its fundamental is listed, with the root mean square amplitude.
        share: Fraction of the variance of the heights, without tilt, that the wave explains.
        frequency: Wave vector (y, x) [cycles per µm].
        is_coherent: Whether the phase of the wave is nearly that of a perfect grating over the whole field.
        is_resolved: Whether the wave has at least three samples per period along x and along y. A shorter period may be
            an artefact of sampling.

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
    is_coherent: bool
    is_resolved: bool = True

    def __str__(self) -> str:
        """Return the period, its standard error and its direction as text."""
        # The standard error is printed with one significant digit, and the period to the same decimal place.
        digits = max(-math.floor(math.log10(max(self.standard_error_um, 1e-6 * self.period_um))), 0)
        length = f"{self.period_um:.{digits}f} ± {self.standard_error_um:.{digits}f} µm"
        return f"{length} at {round(self.direction_deg)}°"

    def __repr__(self) -> str:
        return f"Period({self}, share {self.share:.3g})"


class Periods(tuple[Period, ...]):
    """Periods of a height field: a tuple of :class:`warpdiff.Period`, strongest first, which can be printed and saved.

    Examples:
        >>> import numpy as np
        >>> import warpdiff as wd
        >>> x = np.arange(730) * 0.02
        >>> ripples = 0.1 * np.cos(np.pi * x) + np.random.default_rng(0).normal(0.0, 0.01, (40, 730))
        >>> periods = wd.HeightField(ripples, pitch_um=0.02).periods()
        >>> isinstance(periods, wd.Periods), len(periods)
        (True, 1)
    """

    __slots__ = ()

    def table(self) -> Table:
        """Return a table with a row per period; the columns are attributes of :class:`warpdiff.Period`.

        ``amplitude_um`` is the amplitude of the fundamental.

        Examples:
            >>> x = np.arange(730) * 0.02
            >>> ripples = 0.1 * np.cos(np.pi * x) + np.random.default_rng(0).normal(0.0, 0.01, (40, 730))
            >>> print(wd.HeightField(ripples, pitch_um=0.02).periods().table())
            period_um  standard_error_um  direction_deg  amplitude_um    share  is_coherent  is_resolved
               2.0001 ...
        """
        return Table(
            {
                "period_um": np.array([period.period_um for period in self]),
                "standard_error_um": np.array([period.standard_error_um for period in self]),
                "direction_deg": np.array([period.direction_deg for period in self]),
                "amplitude_um": np.array([period.harmonics_um[0] for period in self]),
                "share": np.array([period.share for period in self]),
                "is_coherent": np.array([period.is_coherent for period in self], dtype=bool),
                "is_resolved": np.array([period.is_resolved for period in self], dtype=bool),
            }
        )

    save = save_table


def fit(heightfield: HeightField, count: int) -> tuple[Period, ...]:
    """Find the strongest periods of a height field, see `HeightField.periods`; the results are cached per field."""
    cached = _found.setdefault(heightfield, {})
    if count not in cached:
        cached[count] = _fit(heightfield, count)
    return cached[count]


def _fit(heightfield: HeightField, count: int) -> tuple[Period, ...]:
    """Find the strongest periods of a height field, without the cache."""
    field = heightfield.levelled(1)
    known = ~field.missing
    deviation = field.rms_um
    if deviation <= _ROUNDING * float(np.max(np.abs(heightfield.heights_um[known]))):
        return ()
    # Heights are scaled to a variance of 1, and lengths by the larger extent of the field, so that results do not
    # depend on the unit.
    extent = max(field.size_um)
    size = field.size_um[0] / extent, field.size_um[1] / extent
    search = WaveSearch(np.where(known, field.heights_um, field.filled().heights_um) / deviation, known, size)
    with single_threaded_blas():
        waves = search.strongest(count)
    periods = [_period_of(wave, deviation, extent, search.pitch) for wave in waves if wave.share >= _LEAST_SHARE]
    return tuple(sorted(periods, key=lambda period: -period.share))


def _period_of(wave: Wave, deviation: float, extent: float, pitch: tuple[float, float]) -> Period:
    """Return a wave of a scaled field as a `Period`, with lengths in µm.

    Args:
        wave: Wave of the scaled field.
        deviation: Standard deviation of the heights [µm].
        extent: Larger extent of the field [µm].
        pitch: Distances (y, x) of the samples, relative to ``extent``.
    """
    frequency = float(np.hypot(*wave.q))
    qy, qx = (wave.q / extent).tolist()
    if qx < 0.0 or (qx == 0.0 and qy < 0.0):
        qy, qx = -qy, -qx
    return Period(
        period_um=extent / frequency, standard_error_um=extent * wave.error / frequency**2,
        direction_deg=math.degrees(math.atan2(qy, qx)) + 0.0,
        harmonics_um=tuple(deviation * amplitude for amplitude in wave.harmonics), share=wave.share,
        frequency=(qy, qx), is_coherent=wave.is_coherent,
        is_resolved=bool(LEAST_SAMPLES * np.max(np.abs(wave.q) * pitch) <= 1.0),
    )  # fmt: skip


def cut_whole(heightfield: HeightField) -> tuple[HeightField, Period]:
    """Crop a field to whole periods, see `HeightField.whole_periods`; return the cropped field and the period."""
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
        # If the field contains less than one period of the wave along an axis, for example along the grooves of a
        # grating, the field is not cropped along this axis.
        size.append(number / frequency if number else heightfield.size_um[axis])
    return heightfield.cropped((size[0], size[1]), offset_um=(0.0, 0.0)), periods[0]
