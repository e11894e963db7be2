"""Checks of the scale of heights and pitch: codes for missing data, and units other than µm."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ref

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

# Size of an atom [µm]. A smaller pitch or height range is probably not in µm but in another unit.
_ATOM_UM = 1e-4
# Height range [µm] and mean slope. If the height range and the mean slope of a field are both smaller, its unit is
# doubtful. Such flat and smooth surfaces exist, so that a warning follows only if another unit gives usual values.
_SUSPICIOUS_RANGE_UM, _SUSPICIOUS_SLOPE = 5e-4, 1e-3
# Largest usual pitch [µm]. Samples at this pitch resolve the diffraction of green light up to an angle of 8°.
_MOST_PITCH_UM = 2.0
# Half of the shortest visible wavelength [µm]. A grating of a smaller period has only the zeroth diffraction order.
_LEAST_SIZE_UM = 0.19
# A field gets a warning if its mean and its median slope exceed `_STEEP`, or if its mean slope exceeds `_TOO_STEEP`. An
# echelle grating of 76° has a mean slope of 8 but a median slope of 4, and gets no warning.
_STEEP, _TOO_STEEP = 5.0, 10.0
# A field counts as flat up to this height range, relative to the largest absolute height: such a range consists of
# rounding errors. Flat fields get no warning about their unit.
_ROUNDING = 1e-12
# Units of length that users may have meant instead of µm, with their sizes in µm, from the most to the least usual
# unit.
_UNITS = {"nanometres": 1e-3, "metres": 1e6, "millimetres": 1e3, "ångströms": 1e-4}
# Usual height ranges [µm], pitches [µm] and mean slopes of scans. A warning proposes another unit only if this unit
# brings all three quantities into their usual ranges.
_RANGES_UM, _PITCHES_UM, _SLOPES = (5e-4, 20.0), (1e-3, _MOST_PITCH_UM), (1e-4, _STEEP)
# Middle of the usual height ranges [µm]. If several units of the heights are possible, a warning proposes the unit that
# brings the height range nearest to this middle, on a logarithmic scale.
_TYPICAL_RANGE_UM = 0.3
# A warning asks for the unit of a synthetic grating if its period [µm], or the ratio of its depth to its period,
# exceeds these values. Both are conventions; if doubled, fewer wrong units are noticed.
_MOST_PERIOD_UM, _MOST_ASPECT = 1000.0, 50.0
# Largest number of slopes along each axis from which the mean and the median slope are computed. The value is limited
# by time: if doubled, the check takes twice as long.
_MOST_SLOPES = 200_000
# Codes for missing data: numbers that instruments and programs write for samples without a height.
_CODES = (
    -99.0, -999.0, -9999.0, -99999.0, -999999.0, 999.0, 9999.0, 99999.0, 999999.0, -32767.0, -32768.0, 32767.0, 32768.0,
    65535.0, -2147483648.0, 2147483647.0, 1e10, -1e10, 1e20, 1e30,
)  # fmt: skip
# A height far from all other heights may be a code for missing data. Its distance from them is relative to their range.
# A height in the list `_CODES` counts as a code from the distance `_FAR` on. A height that is not in the list counts as
# a code from the distance `_FARTHER` on, if at least `_REPEATED` samples are equal to it.
_FAR, _FARTHER, _REPEATED = 3.0, 20.0, 3
# Magnitude [µm] that no height has, whatever its unit. Larger numbers are codes for missing data, such as 1e20 and the
# largest float32.
_MOST_HEIGHT = 1e9


def check_magnitude(heights: NDArray[np.float64], most: float) -> None:
    """Raise an error if the magnitude of a height exceeds ``most``; such heights are codes for missing data."""
    beyond = (heights > most) | (heights < -most)
    if count := int(np.count_nonzero(beyond)):
        raise ArgumentValueError(
            f"{ref('heights_um')} must lie within ±{most:g}, got {heights[beyond][0]:g} at {count} sample(s), probably "
            "a code for missing data: replace it with NaN"
        )


def warn_of_scale(heights: NDArray[np.float64], pitch_um: tuple[float, float]) -> None:
    """Warn of codes for missing data among heights [µm], and of a size or slope that no diffracting surface has."""
    code = _missing_code(heights)
    if code is not None:
        value, count = code
        warn(
            f"{ref('heights_um')} has {count} sample(s) of exactly {value:.10g}, far from all others, probably a code "
            f"for missing data: replace them with NaN, as by numpy.where(heights == {value:.10g}, numpy.nan, heights)"
        )
        heights = np.where(heights == value, np.nan, heights)
    scale = _Scale.of(heights, pitch_um)
    if scale is None:
        return
    symptom = scale.symptom()
    if symptom:
        warn(f"{symptom}; {scale.remedy()}. If the scale is right, make the field with HeightField.of_known_scale()")


def warn_of_grating(period_um: float, **depths_um: float) -> None:
    """Warn of a synthetic grating whose period or depth is probably in another unit."""
    for name, value in {"period_um": period_um, **depths_um}.items():
        if 0.0 < value < _ATOM_UM:
            ratios = {unit: value * _UNITS[unit] / _TYPICAL_RANGE_UM for unit in ("metres", "millimetres")}
            unit = min(ratios, key=lambda unit: abs(math.log(ratios[unit])))
            warn(
                f"{ref(name)} of {value:.4g} µm is less than an atom; is it in {unit}? Multiply it by {_UNITS[unit]:g}"
            )
            return
    if period_um > _MOST_PERIOD_UM:
        warn(f"{ref('period_um')} of {period_um:.4g} µm is very long; is it in nanometres? Multiply it by 0.001")
        return
    for name, value in depths_um.items():
        if value > _MOST_ASPECT * period_um:
            warn(
                f"{ref(name)} of {value:.4g} µm is more than {_MOST_ASPECT:g} periods of {period_um:.4g} µm; is it in "
                "nanometres? Multiply it by 0.001"
            )


def _missing_code(heights: NDArray[np.float64]) -> tuple[float, int] | None:
    """Return a height that is probably a code for missing data, and how many samples have it; None if no height is."""
    for value, others in ((float(np.nanmin(heights)), np.nanmin), (float(np.nanmax(heights)), np.nanmax)):
        count = int(np.count_nonzero(heights == value))
        rest = heights[(heights != value) & ~np.isnan(heights)]
        if not rest.size:
            return None
        spread, gap = float(np.ptp(rest)), abs(float(others(rest)) - value)
        known = abs(value) >= _MOST_HEIGHT or any(math.isclose(value, code, rel_tol=1e-6) for code in _CODES)
        # A binary grating has only two heights: all samples without the first height are equal to the second. One of
        # both heights counts as a code for missing data only if it is in the list of codes, and its magnitude is at
        # least 1e4 µm.
        if (known and gap > _FAR * spread and (spread > 0.0 or abs(value) >= 1e4)) or (
            gap > _FARTHER * spread > 0.0 and count >= _REPEATED and 2 * count < heights.size
        ):
            return value, count
    return None


@dataclass(frozen=True)
class _Scale:
    """Height range, pitch, size and slopes of a height field, by which its units are checked.

    Attributes:
        height: Height range [µm].
        pitch: Smallest and largest pitch of the axes with more than one sample [µm].
        size: Largest extent of the axes with more than one sample [µm].
        slope: Mean absolute slope.
        median_slope: Median of the absolute slopes along an axis; the larger median of both axes.
    """

    height: float
    pitch: tuple[float, float]
    size: float
    slope: float
    median_slope: float

    @classmethod
    def of(cls, heights: NDArray[np.float64], pitch_um: tuple[float, float]) -> _Scale | None:
        """Measure a height field; return None if the field is flat, has one sample, or if all values are usual."""
        known = heights[~np.isnan(heights)]
        height = float(np.ptp(known))
        free = [axis for axis in (0, 1) if heights.shape[axis] > 1]
        if not free or height <= _ROUNDING * max(float(np.max(np.abs(known))), 1.0):
            return None
        pitch = min(pitch_um[axis] for axis in free), max(pitch_um[axis] for axis in free)
        size = max(heights.shape[axis] * pitch_um[axis] for axis in free)
        if _is_within(pitch, size) and _SUSPICIOUS_RANGE_UM <= height <= _STEEP * pitch[0]:
            # Neighbouring samples differ at most by the height range. This range is so small that no slope exceeds the
            # limit for a warning.
            return None
        slopes = []
        for axis in free:
            along = np.abs(np.diff(heights, axis=axis)).ravel() / pitch_um[axis]
            along = along[:: 1 + along.size // _MOST_SLOPES]
            slopes.append(along[~np.isnan(along)])
        means = [float(np.mean(along)) for along in slopes if along.size]
        medians = [float(np.median(along)) for along in slopes if along.size]
        return cls(height, pitch, size, math.hypot(*means) if means else 0.0, max(medians, default=0.0))

    def symptom(self) -> str:
        """Return in words what is unusual about the scale of the field; an empty string if nothing is."""
        is_steep = self.slope > _TOO_STEEP or min(self.slope, self.median_slope) > _STEEP
        proposed = self._proposal() is not None
        symptoms = (
            (self.pitch[0] < _ATOM_UM, f"{ref('pitch_um')} of {self.pitch[0]:.2g} µm is less than an atom"),
            (self.height < _ATOM_UM, f"{ref('heights_um')} has a range of {self.height:.2g} µm, less than an atom"),
            (self.pitch[1] > _MOST_PITCH_UM,
             f"{ref('pitch_um')} of {self.pitch[1]:.4g} µm is too coarse for the diffraction of light"),
            (is_steep and self.height > self.size,
             f"{ref('heights_um')} has a range of {self.height:.4g} µm, more than the size of {self.size:.4g} µm"),
            (is_steep, f"{ref('heights_um')} has a mean slope of {self.slope:.3g}"),
            (proposed and self.size < _LEAST_SIZE_UM,
             f"the field has a size of {self.size:.2g} µm, less than half a wavelength"),
            (proposed and self.height < _SUSPICIOUS_RANGE_UM and self.slope < _SUSPICIOUS_SLOPE,
             f"{ref('heights_um')} has a range of {self.height:.2g} µm, hardly more than an atom"),
        )  # fmt: skip
        return next((words for is_unusual, words in symptoms if is_unusual), "")

    def remedy(self) -> str:
        """Return advice: the probable units of heights and pitch as a question, and the factors that convert to µm."""
        proposal = self._proposal()
        if proposal is None:
            return "check the units: heights and pitch must be in µm"
        of_heights, of_pitch = proposal
        if of_heights and of_pitch:
            if of_heights == of_pitch:
                return f"are heights and pitch in {of_heights}? Multiply both by {_UNITS[of_heights]:g}"
            return (
                f"are heights in {of_heights} and the pitch in {of_pitch}? Multiply heights by "
                f"{_UNITS[of_heights]:g} and the pitch by {_UNITS[of_pitch]:g}"
            )
        if of_pitch:
            return f"is the pitch in {of_pitch}? Multiply it by {_UNITS[of_pitch]:g}"
        return f"are heights in {of_heights}? Multiply them by {_UNITS[of_heights]:g}"

    def _proposal(self) -> tuple[str, str] | None:
        """Return the units of heights and pitch that make the field usual, "" for µm; None if there are no such units.

        Another unit for heights or pitch alone, or the same unit for both, is preferred to two different units.
        Ångströms are proposed last.
        """
        usual = [pair for pair in self._changes() if self._is_usual(*pair)]
        if not usual:
            return None

        def order(pair: tuple[str, str]) -> tuple[bool, bool, float]:
            heights, pitch = pair
            height = self.height * _UNITS.get(heights, 1.0)
            differing = bool(heights and pitch and heights != pitch)
            return "ångströms" in pair, differing, abs(math.log(height / _TYPICAL_RANGE_UM))

        return min(usual, key=order)

    @staticmethod
    def _changes() -> Iterator[tuple[str, str]]:
        """Yield all pairs of a unit of the heights and a unit of the pitch, except the pair of µm and µm."""
        for heights in ("", *_UNITS):
            for pitch in ("", *_UNITS):
                if heights or pitch:
                    yield heights, pitch

    def _is_usual(self, heights: str, pitch: str) -> bool:
        """Return whether the field is a usual scan if its heights and its pitch are in the given units."""
        of_heights, of_pitch = _UNITS.get(heights, 1.0), _UNITS.get(pitch, 1.0)
        return (
            _RANGES_UM[0] <= self.height * of_heights <= _RANGES_UM[1]
            and _is_within((self.pitch[0] * of_pitch, self.pitch[1] * of_pitch), self.size * of_pitch)
            and _SLOPES[0] <= self.slope * of_heights / of_pitch <= _SLOPES[1]
        )


def _is_within(pitch: tuple[float, float], size: float) -> bool:
    """Return whether the smallest pitch, the largest pitch and the size [µm] of a field are usual for scans."""
    return _PITCHES_UM[0] <= pitch[0] and pitch[1] <= _PITCHES_UM[1] and size >= _LEAST_SIZE_UM
