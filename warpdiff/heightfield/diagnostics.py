"""Diagnostics of a height field: summary, units, aliasing, and the error of scalar diffraction itself."""

from __future__ import annotations

import math
import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.warnings import warn
from warpdiff.core.wording import ref
from warpdiff.optics.colorimetry import LAMBDA_MIN_NM

if TYPE_CHECKING:
    from warpdiff.heightfield.field import HeightField
    from warpdiff.heightfield.periods import Period

# Limits of a period that a summary lists: its standard error, relative to the period, and its share of the variance.
_MOST_STANDARD_ERROR, _LEAST_SHARE = 0.01, 0.01

# Height range [µm] below that of an atom, and the rounding of a flat field's heights, which is no range.
LEAST_RANGE_UM = 1e-4
_ROUNDING = 1e-12
# Mean absolute slope.
MOST_SLOPE = 5.0
# In µm; and typical heights, nearest to which a unit is chosen.
_UNITS = {"metres": 1e6, "millimetres": 1e3, "nanometres": 1e-3, "ångströms": 1e-4}
_TYPICAL_RANGE_UM, _MOST_RANGE_UM, _TYPICAL_PITCH_UM = 0.3, 20.0, 0.05

# |κ| at which aliasing is estimated: normal incidence and view at 380 nm [1/µm].
_KAPPA = 2.0 / 0.38
# A part of a large scan stands for it; its edges are faded out.
_SAMPLES = 512
_RING = 0.1
_spectra: weakref.WeakKeyDictionary[HeightField, tuple[np.ndarray, np.ndarray]] = weakref.WeakKeyDictionary()

# Green light stands for the visible.
WAVELENGTH_NM = 550.0
# Below it, 356 of 357 gratings were right within a tenth of the light.
SCALAR_RELIABLE = 0.1
# Of 100 gratings of this bound or more, 97 had an order that was wrong by more than a tenth of the light.
SCALAR_INVALID = 3.0
# Error of normalised efficiencies, relative to that of Stam's.
_NORMALISED_SHARE = 0.5


@dataclass(frozen=True)
class HeightFieldSummary:
    """Contents of a height field, and how far it can be trusted; `str` of it is a few lines to print.

    Attributes:
        shape: Number of samples (ny, nx).
        size_um: Extent (Ly, Lx) [µm].
        pitch_um: Distance of the samples (dy, dx) [µm].
        height_range_um: Highest minus lowest height [µm].
        rms_um: Standard deviation of the heights [µm].
        rms_slope: Root mean square of the slope (a ratio).
        mean_slope: Mean absolute slope (a ratio). The sampling of a wall does not change it.
        periods: Periods that repeat at least three times, have a standard error of at most 1 % and explain at least
            1 % of the variance, see `HeightField.periods`. A field that is a single period has none.
        max_uv: Largest component of the scattering vector (u, v) = −ωi − ωr that the pitch supports at 380 nm:
            λ / (2 · pitch). From 2 on, no light and view on the hemisphere alias.
        scalar_error: Bound of the error of scalar diffraction at 550 nm, relative to the reflected power, see
            `scalar_error_bound`.
        missing: Number of missing samples.
    """

    shape: tuple[int, int]
    size_um: tuple[float, float]
    pitch_um: tuple[float, float]
    height_range_um: float
    rms_um: float
    rms_slope: float
    mean_slope: float
    periods: tuple[Period, ...]
    max_uv: float
    scalar_error: float
    missing: int

    def __str__(self) -> str:
        """Return the summary as lines of text."""
        ny, nx = self.shape
        periods = ", ".join(map(str, self.periods)) or "no feature repeats at least three times (field is one period)"
        slope_deg = math.degrees(math.atan(self.rms_slope))
        supported = "the whole hemisphere" if self.max_uv >= 2.0 else f"|u|, |v| up to {self.max_uv:.2f}"
        share = 100.0 * self.missing / (nx * ny)
        gaps = [f"missing           {self.missing} samples ({share:.2g} %)"] if self.missing else []
        return "\n".join(
            [
                f"size              {self.size_um[1]:.4g} × {self.size_um[0]:.4g} µm (x × y), {nx} × {ny} samples",
                f"pitch             {1e3 * self.pitch_um[1]:.4g} × {1e3 * self.pitch_um[0]:.4g} nm (x × y)", *gaps,
                f"height range      {self.height_range_um:.4g} µm, rms {self.rms_um:.4g} µm",
                f"slope             rms {self.rms_slope:.3g} ({slope_deg:.1f}°), mean {self.mean_slope:.3g}",
                f"periods           {periods}", f"supports          {supported} at {LAMBDA_MIN_NM} nm",
                f"scalar theory     {scalar_error_text(self.scalar_error)}",
            ]
        )  # fmt: skip


def summarise(heightfield: HeightField) -> HeightFieldSummary:
    """Return the summary of a height field, see `HeightField.summary`."""
    pitch = coarsest_pitch_um(heightfield)
    return HeightFieldSummary(
        shape=heightfield.shape, size_um=heightfield.size_um, pitch_um=heightfield.pitch_um,
        height_range_um=heightfield.height_range_um, rms_um=heightfield.rms_um, rms_slope=heightfield.rms_slope,
        mean_slope=heightfield.mean_slope,
        periods=tuple(
            period
            for period in heightfield.periods()
            if not period.is_waviness
            and period.standard_error_um <= _MOST_STANDARD_ERROR * period.period_um
            and period.share >= _LEAST_SHARE
        ),
        max_uv=1e-3 * LAMBDA_MIN_NM / (2.0 * pitch) if pitch else math.inf,
        scalar_error=scalar_error_bound(heightfield.rms_um, heightfield.mean_slope),
        missing=int(np.count_nonzero(heightfield.missing)),
    )  # fmt: skip


def warn_of_scale(heightfield: HeightField) -> None:
    """Warn of a scale that no diffracting surface has: a mirror, or all walls, by a wrong unit."""
    height = heightfield.height_range_um
    extents = [size for size, n in zip(heightfield.size_um, heightfield.shape, strict=True) if n > 1]
    if height <= _ROUNDING * max(float(np.nanmax(np.abs(heightfield.heights_um))), 1.0) or not extents:
        return
    size = max(extents)
    if height < LEAST_RANGE_UM:
        symptom = f"has a range of {height:.2g} µm, less than an atom"
    elif height > size:
        symptom = f"has a range of {height:.4g} µm, more than the size of {size:.4g} µm"
    elif height > MOST_SLOPE * min(heightfield.pitch_um) and heightfield.mean_slope > MOST_SLOPE:
        symptom = f"has a mean slope of {heightfield.mean_slope:.3g}"
    else:
        return
    warn(
        f"{ref('heights_um')} {symptom}; {_likely_unit(heightfield)}. If the scale is right, make the field with "
        "HeightField.of_known_scale()"
    )


def _likely_unit(heightfield: HeightField) -> str:
    """The unit that a length is likely to be in."""
    pitch = max(heightfield.pitch_um)
    heights = heightfield.height_range_um
    if LEAST_RANGE_UM <= heights <= _MOST_RANGE_UM and pitch < LEAST_RANGE_UM:
        return f"is the pitch in {_nearest_unit(pitch, _TYPICAL_PITCH_UM)}? It must be in µm"
    unit = _nearest_unit(heights, _TYPICAL_RANGE_UM)
    as_well = ", and the pitch as well" if pitch < LEAST_RANGE_UM else ""
    return f"are heights in {unit}{as_well}? Multiply them by {_UNITS[unit]:g}"


def _nearest_unit(value: float, typical: float) -> str:
    """The unit in which a value comes nearest to a typical one [µm]."""
    return min(_UNITS, key=lambda name: abs(math.log(value * _UNITS[name] / typical)))


def coarsest_pitch_um(heightfield: HeightField) -> float:
    """The larger pitch of the axes that vary [µm]; an axis of one sample is constant, and 0 if both are."""
    return max((pitch for n, pitch in zip(heightfield.shape, heightfield.pitch_um, strict=True) if n > 1), default=0.0)


def folded_power(heightfield: HeightField, frequency: float) -> float:
    """Power that aliases onto coefficients at a frequency [1/µm], relative to theirs, at most 1.

    Power of exp(2πiκh) beyond half a cycle per sample folds back. It cannot be measured; it is taken to be as strong
    as the power just within the limit, which holds for spectra that fall.
    """
    pitch = coarsest_pitch_um(heightfield)
    if pitch == 0.0 or heightfield.height_range_um == 0.0:
        return 0.0
    limit = 1.0 / (2.0 * pitch)
    if frequency >= limit:
        return 1.0
    radius, power = _spectrum(heightfield)
    at_limit = (radius >= (1.0 - _RING) * limit) & (radius <= limit)
    at_frequency = np.abs(radius - frequency) <= _RING * limit
    if not at_limit.any() or not at_frequency.any() or power[at_frequency].mean() <= 0.0:
        return 0.0
    return float(min(1.0, power[at_limit].mean() / power[at_frequency].mean()))


@np.errstate(under="ignore")
def _spectrum(heightfield: HeightField) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [1/µm] and powers of the coefficients of a part of the height field, flat arrays."""
    if heightfield not in _spectra:
        part = heightfield.heights_um[:_SAMPLES, :_SAMPLES]
        field = np.exp(2j * math.pi * _KAPPA * part)
        for axis, n in enumerate(part.shape):
            if n < heightfield.shape[axis]:
                fade = np.hanning(n + 2)[1:-1]
                field = field * (fade[:, None] if axis == 0 else fade)
        q = [np.fft.fftfreq(n, pitch) for n, pitch in zip(part.shape, heightfield.pitch_um, strict=True)]
        power = np.abs(np.fft.fft2(field)) ** 2
        _spectra[heightfield] = np.hypot(q[0][:, None], q[1]).ravel(), power.ravel()
    return _spectra[heightfield]


def scalar_error_bound(
    rms_um: float, mean_slope: float, wavelength_nm: float = WAVELENGTH_NM, *, normalised: bool = False
) -> float:
    """Bound of the error of an order's efficiency by scalar diffraction, relative to a flat surface's reflected power.

    (4πs/λ)² · min(1, λ/P), with s the standard deviation of the heights and P = 4√2 s/slope the period of the sine that
    shares it and the mean slope. The first factor is the power that scalar theory removes from the zeroth order of a
    slightly rough surface; where the period is too short for other orders, all of it is wrong. The mean slope does not
    depend on how finely a wall is sampled, as its mean square does, nor on the waviness that makes a scan's strongest
    period.

    The rule was found against rigorous solutions (bench/suite/validity) and is no theorem. Of 748 gratings 357 were
    within 0.1 by it, of which one was wrong by more, by 0.12; up to 0.5 no error exceeded it by more than a factor of
    1.8. Sines of long periods are right far beyond it. Normalised efficiencies of mirrors have half the error: of 561
    gratings 313 were within 0.1 by that half, of which three were wrong by more, by up to 0.22, and 95 of 100 errors
    were no more than 1.1 times it.

    Args:
        rms_um: Standard deviation of the heights [µm].
        mean_slope: Mean absolute slope (a ratio).
        wavelength_nm: Wavelength [nm].
        normalised: Whether efficiencies are normalised, as with ``order_efficiencies(..., energy="normalised")``.

    Returns:
        The bound; 0 for a flat surface. From 1 on, no efficiency can be trusted.
    """
    rms = rms_um / (wavelength_nm * 1e-3)
    if rms == 0.0:
        return 0.0
    bound = (4.0 * math.pi * rms) ** 2 * min(1.0, mean_slope / (4.0 * math.sqrt(2.0) * rms))
    return bound * (_NORMALISED_SHARE if normalised else 1.0)


def scalar_error_text(bound: float) -> str:
    """Return a `scalar_error_bound` as a risk, graded as reliable, qualitative or invalid."""
    grade = "invalid" if bound >= SCALAR_INVALID else "reliable" if bound < SCALAR_RELIABLE else "qualitative"
    text = f"{grade} at {WAVELENGTH_NM:g} nm:"
    if grade == "invalid":
        return (
            f"{text} the surface is too deep and too steep (error bound {bound:.3g}; reliable below {SCALAR_RELIABLE})"
        )
    percent = float(f"{100.0 * min(bound, 1.0):.2g}")
    text = f"{text} order efficiencies may be off by up to {percent:g} % of the reflected power"
    return text if grade == "reliable" else f"{text}: do not trust brightness"
