"""Diagnostics of a height field: summary, slopes and aliasing."""

from __future__ import annotations

import math
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.heightfield.theory_verdict import verdict_on
from warpdiff.optics.colorimetry import LAMBDA_MIN_NM

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.heightfield.periods import Period
    from warpdiff.heightfield.theory_verdict import TheoryVerdict

# A summary of a height field lists only periods that are certain and strong enough. `_MOST_STANDARD_ERROR` is the
# largest standard error relative to the period; if doubled, less certain periods are listed. `_LEAST_SHARE` is the
# smallest fraction of the variance of the heights that the period explains; if doubled, fewer periods are listed. Both
# values are conventions.
_MOST_STANDARD_ERROR, _LEAST_SHARE = 0.1, 0.01

# Aliasing is estimated for the phase 2πκh of light that a height h reflects, where κ is |w|/λ. This is the largest κ
# [1/µm]: it belongs to the wavelength 380 nm, with light and view along the normal.
_KAPPA = 2.0 / 0.38
# Aliasing is estimated from the power spectrum of exp(2πiκh) for heights h. This is the largest number of samples along
# each axis from which the spectrum is computed. In larger fields, only the first samples are used.
_SAMPLES = 512
# Aliasing is estimated from mean powers over rings of the frequency plane. A ring contains the frequencies (y, x) with
# about the same magnitude. The number is its half width, relative to the Nyquist limit of the samples.
_RING = 0.1
# Number of samples whose slopes are computed at once. The value is limited by memory: if doubled, the computation of
# slopes requires twice the memory.
_SAMPLES_AT_ONCE = 2**18
_spectra: weakref.WeakKeyDictionary[HeightField, tuple[np.ndarray, np.ndarray]] = weakref.WeakKeyDictionary()


@dataclass(frozen=True)
class HeightFieldSummary:
    """Summary of a height field and of its reliability; ``print`` shows it as a few lines.

    Attributes:
        shape: Number of samples (ny, nx).
        size_um: Extent (Ly, Lx) [µm].
        pitch_um: Distance of the samples (dy, dx) [µm].
        height_range_um: Highest minus lowest height [µm].
        rms_um: Standard deviation of the heights [µm].
        rms_slope: Root mean square of the slope (a ratio).
        mean_slope: Mean absolute slope (a ratio). It does not depend on the sampling of vertical walls.
        periods: Periods that repeat at least three times, have a standard error of at most 10 %, and explain at least
            1 % of the variance of the heights, see `HeightField.periods`. The tuple is empty for a field that is a
            single period.
        max_uv: Largest magnitude of the components u and v of the scattering vector −ωi − ωr that the pitch supports
            without aliasing at λ = 380 nm: λ / (2 · pitch). If the value is at least 2, no pair of directions to light
            and view suffers from aliasing.
        verdict: Verdict on the accuracy of scalar diffraction at 550 nm, as far as it follows from the heights alone.
        missing: Number of missing samples.
        orientation: Position of row 0 of the file or array, in words.
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
    verdict: TheoryVerdict
    missing: int
    orientation: str

    @property
    def scalar_error(self) -> float:
        """Expected error of scalar diffraction at 550 nm, relative to the reflected power; equals ``verdict.error``."""
        return self.verdict.error

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
                f"pitch             {1e3 * self.pitch_um[1]:.4g} × {1e3 * self.pitch_um[0]:.4g} nm (x × y)",
                f"orientation       {self.orientation}", *gaps,
                f"height range      {self.height_range_um:.4g} µm, rms {self.rms_um:.4g} µm",
                f"slope             rms {self.rms_slope:.3g} ({slope_deg:.1f}°), mean {self.mean_slope:.3g}",
                f"periods           {periods}", f"supports          {supported} at {LAMBDA_MIN_NM} nm",
                f"scalar theory     {self.verdict}",
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
            if period.standard_error_um <= _MOST_STANDARD_ERROR * period.period_um
            and period.share >= _LEAST_SHARE
        ),
        max_uv=1e-3 * LAMBDA_MIN_NM / (2.0 * pitch) if pitch else math.inf,
        verdict=verdict_on(heightfield), missing=int(np.count_nonzero(heightfield.missing)),
        orientation=_orientation(heightfield),
    )  # fmt: skip


def _orientation(heightfield: HeightField) -> str:
    """Return the position of row 0 of the file or array of a height field, in words."""
    source = heightfield.source
    if source is None:
        return "row 0 at y = 0, z towards the viewer"
    which = repr(Path(source.path).name) if source.path else "the topography"
    place = "at the top, the largest y" if source.rows == "up" else "at y = 0"
    return f"row 0 of the picture in {which} {place} (rows={source.rows!r})"


def rms_slope(heights_um: NDArray[np.float64], pitch_um: tuple[float, float]) -> float:
    """Return the root mean square slope between neighbouring samples, without slopes across the edges of the field."""
    total = 0.0
    for axis in (0, 1):
        if heights_um.shape[axis] > 1:
            squares = (np.diff(heights_um, axis=axis) / pitch_um[axis]) ** 2
            known = squares[~np.isnan(squares)]
            total += float(np.mean(known)) if known.size else 0.0
    return math.sqrt(total)


def mean_slope(heights_um: NDArray[np.float64], pitch_um: tuple[float, float]) -> float:
    """Return the mean absolute slope between neighbouring samples of a periodic field, also across its edges."""
    ny, (dy, dx) = heights_um.shape[0], pitch_um
    total, count = 0.0, 0
    # Slopes are computed for one part of the rows after the other, which limits memory. The field is periodic: along an
    # axis of one sample, the neighbour of a sample is the sample itself, so that the slope is 0.
    for rows in np.array_split(np.arange(ny), -(-heights_um.size // _SAMPLES_AT_ONCE)):
        block = heights_um[rows]
        along_y, along_x = heights_um[(rows + 1) % ny] - block, np.roll(block, -1, axis=1) - block
        slopes = np.sqrt((along_y / dy) ** 2 + (along_x / dx) ** 2)
        known = slopes[~np.isnan(slopes)]
        total, count = total + float(np.sum(known)), count + known.size
    return total / count if count else 0.0


def coarsest_pitch_um(heightfield: HeightField) -> float:
    """Return the larger pitch [µm] of the axes that have more than one sample; 0 if no axis has several samples."""
    return max((pitch for n, pitch in zip(heightfield.shape, heightfield.pitch_um, strict=True) if n > 1), default=0.0)


def folded_power(heightfield: HeightField, frequency: float) -> float:
    """Return the power that aliases to a frequency [1/µm], relative to the power at this frequency, at most 1.

    The powers are those of Fourier coefficients of exp(2πiκh), with heights h and a fixed κ [1/µm]. Power at
    frequencies above the Nyquist limit of the samples aliases, and cannot be measured from the samples. The estimate is
    the power just below the limit. This estimate is an upper bound if the power decreases with the frequency.
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
    """Return frequencies [1/µm] and powers of the Fourier coefficients of exp(2πiκh) for heights h, as flat arrays."""
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
