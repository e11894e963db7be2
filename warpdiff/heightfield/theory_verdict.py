"""Verdict on scalar diffraction: how wrong the efficiency of an order may be on a height field, and why.

Five properties of a surface may make scalar diffraction wrong. Each of them alone gives an estimate of the error, and
the largest estimate is the verdict:

- steep: 0.22 times the root mean square slope, computed in the frequency domain with frequencies above 1/λ counted as
  1/λ.
- deep: 0.05 (4πs/λ)² min(1, λ/d) for the wavelength λ. Here s is the standard deviation of the heights, g is the mean
  absolute slope, and d = 4√2 s/g is the period of a sine with the same s and g.
- narrow: the fraction of the light that features with periods below two wavelengths diffract, divided by 0.7. It is
  computed from the spectrum of exp(2πih/λ). For heights h, this is the reflected wave at |w| = 1, where w is the
  component of the scattering vector along the normal.
- energy: 1.1 times the deviation of the sum of Stam's efficiencies (Stam 1999) over all orders from the power that a
  flat surface reflects; 0.4 times this deviation if the efficiencies are normalised. Without a direction to the light,
  the largest of the deviations for light from 0°, 30° and 60° counts.
- undersampled: twice the fraction of undersampled steps in the sum of all height differences |Δh| between neighbouring
  samples. An undersampled step and the next step change the phase by more than half a cycle each, in the same
  direction.

The first four estimates were fitted to rigorous solutions (bench/reproduce/theory_verdict.py). These estimates are not
upper bounds.
"""

from __future__ import annotations

import math
import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np

from warpdiff.core.threads import single_threaded_blas
from warpdiff.optics.reflectance_factors import schlick

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from warpdiff.heightfield.field import HeightField

_T = TypeVar("_T")
Reason = Literal["steep", "deep", "narrow", "energy", "undersampled"]
Grade = Literal["reliable", "qualitative", "invalid"]

# Wavelength of a verdict on scalar diffraction, if the caller states no wavelengths [nm]: green, the middle of the
# visible range.
WAVELENGTH_NM = 550.0
# The verdict on scalar diffraction is "qualitative" instead of "reliable" if the estimated error of order efficiencies
# is at least this value, a tenth of the reflected power. If doubled, gratings with larger errors are graded reliable.
QUALITATIVE = 0.1
# The verdict on scalar diffraction is "invalid" if the estimated error of order efficiencies is at least this value. In
# 99 % of the gratings with such an estimate, the efficiency of an order is wrong by more than a tenth of the reflected
# power. If halved, shallow patterns with features of two wavelengths are graded invalid.
INVALID = 0.9
# Factors from the properties of a surface to the estimated errors, as this module's docstring lists them. They were
# fitted to rigorous solutions for gratings with two thirds of the periods and depths; the others test the factors
# (bench/reproduce/theory_verdict.py).
_PER_SLOPE, _PER_DEPTH, _PER_NARROW_SHARE, _PER_ENERGY, _PER_NORMALISED_ENERGY = 0.22, 0.05, 1.0 / 0.7, 1.1, 0.4
# Ratio of the estimated error to the fraction of undersampled steps, whose height changes the phase too much for the
# samples. If half of the relief is undersampled, the estimated error is 1, and the results are meaningless.
_PER_UNDERSAMPLED = 2.0
# Features of a surface count as narrow if the product of their spatial frequency and the wavelength is above this
# value: their period is less than two wavelengths. The value was fitted to rigorous solutions, as the factors of the
# estimated errors were.
_NARROW = 0.5
# Largest number of wavelengths for which the estimated errors of a height field are cached. The value is limited by
# memory. The evaluation of a spectrum requires a verdict at three of its wavelengths.
_MOST_CACHED = 16
# Largest number of samples from which a verdict on scalar diffraction is computed: for a single row or column of
# samples, and along each axis of other height fields. The values are limited by time, so that a verdict takes at most
# 30 ms.
_MOST_OF_PROFILE, _MOST_OF_FIELD = 4096, 192
# In finely sampled height fields, only every n-th sample is used. This is the least number of used samples per
# wavelength. If halved, orders near the horizon suffer from aliasing.
_PER_WAVELENGTH = 8.0
# To test energy conservation, the efficiencies of all orders are summed for these angles of incidence [degrees]. They
# are the angles of the rigorous solutions to which the estimated errors were fitted.
_ANGLES_DEG = (0.0, 30.0, 60.0)
# The efficiencies of all orders are not summed if the height range exceeds this number of wavelengths. The value is
# limited by time: larger ranges require so many Fourier transforms that a verdict takes more than 30 ms.
_MOST_RANGE = 6.0
# Least cosine of the angle between an order and the normal for which the order counts in the sum of efficiencies.
# Orders with a smaller cosine are within 5.7° of the horizon. At the horizon the efficiency of an order diverges, so
# that an order that happens to be near it would dominate the sum.
_LEAST_COSINE = 0.1
# Reflectances at normal incidence of a perfect mirror and of glass (n = 1.5). The efficiencies of orders are summed for
# both materials, because the reflectance of glass also depends on the direction of an order.
_MIRROR, _GLASS = 1.0, 0.04

# Caches by height field and wavelength [nm]. The first cache contains the estimated errors by their reason, except the
# reason "energy". The second cache contains the sums of efficiencies over all orders, as deviations from 1; the error
# for the reason "energy" follows from them.
_errors: weakref.WeakKeyDictionary[HeightField, dict[float, dict[Reason, float]]] = weakref.WeakKeyDictionary()
_deviations: weakref.WeakKeyDictionary[HeightField, dict[float, tuple[float, float]]] = weakref.WeakKeyDictionary()


@dataclass(frozen=True)
class TheoryVerdict:
    """Verdict on scalar diffraction for a height field; ``print`` shows it as a sentence.

    Attributes:
        error: Expected error of the efficiency of an order, relative to the power that a flat surface reflects. In
            comparisons with rigorous solutions, the true error was at most twice this error for 19 of 20 gratings.
        reason: Property of the surface with the largest estimated error: ``"steep"`` or ``"deep"`` relief; ``"narrow"``
            features; ``"energy"``, if the orders do not sum to the power that a flat surface reflects;
            ``"undersampled"``, if the samples are too far apart for the phase.
        wavelength_nm: Wavelength of the verdict [nm].

    Examples:
        >>> import warpdiff as wd
        >>> print(wd.gratings.sinusoidal(period_um=5.0, depth_um=0.1).summary().verdict)
        reliable at 550 nm: orders may be wrong by ... % of the reflected power
        >>> wd.gratings.lamellar(period_um=1.0, depth_um=0.5).summary().verdict.grade
        'invalid'
    """

    error: float
    reason: Reason
    wavelength_nm: float = WAVELENGTH_NM

    @property
    def grade(self) -> Grade:
        """Grade of accuracy: "reliable"; "qualitative", if only the positions of colours are reliable; or "invalid"."""
        return "invalid" if self.error >= INVALID else "reliable" if self.error < QUALITATIVE else "qualitative"

    @property
    def remedy(self) -> str:
        """Advice in an error or a warning about scalar diffraction; it depends on the reason of the verdict."""
        if self.reason == "undersampled":
            return "scan at a finer pitch, or use HeightField.resampled() if the surface is smooth"
        energy = "energy='normalised' for mirrors and metals, or " if self.reason == "energy" else ""
        rigorous = "a rigorous solver (rigorous_order_efficiencies() for one-dimensional gratings)"
        return f"use positions of colours, not their brightness; or use {energy}{rigorous}"

    @property
    def explanation(self) -> str:
        """Reason of the verdict in words, as a part of a sentence."""
        return _REASONS[self.reason]

    def __str__(self) -> str:
        percent = float(f"{100.0 * min(self.error, 1.0):.2g}")
        text = (
            f"{self.grade} at {self.wavelength_nm:.4g} nm: orders may be wrong by {percent:g} % of the reflected power"
        )
        return text if self.grade == "reliable" else f"{text}, because {self.explanation}"


# Explanations in printed verdicts on scalar diffraction, by the reason of the verdict.
_REASONS: dict[Reason, str] = {
    "steep": "the relief is steep",
    "deep": "the relief is deep",
    "narrow": "features are narrower than two wavelengths",
    "energy": "the orders do not sum to the reflected power",
    "undersampled": "the phase changes by more than half a cycle between samples",
}


def theory_wavelength_nm(shortest_nm: float, longest_nm: float) -> float:
    """Return the wavelength of a verdict [nm]: the one nearest to 550 nm between the shortest and the longest one."""
    return min(max(WAVELENGTH_NM, shortest_nm), longest_nm)


def verdict_on(
    heightfield: HeightField, wavelength_nm: float = WAVELENGTH_NM, *, conserves: bool = False,
    energy_sum: float | None = None,
) -> TheoryVerdict:  # fmt: skip
    """Return the verdict on scalar diffraction for a height field; the estimated errors of the field are cached.

    Args:
        heightfield: Height field; missing samples count as the mean height.
        wavelength_nm: Wavelength of the verdict [nm].
        conserves: Whether efficiencies are normalised, and the surface transmits no light.
        energy_sum: Sum of Stam's efficiencies over all orders that were evaluated, relative to the reflectance of a
            flat surface; None uses the sums of a mirror and of glass for light from 0°, 30° and 60°.
    """
    estimates = _cached(_errors, heightfield, wavelength_nm, errors_of)
    errors = dict(estimates)
    if energy_sum is not None:
        deviation = abs(energy_sum - 1.0)
    else:
        of_mirror, of_glass = _cached(_deviations, heightfield, wavelength_nm, energy_deviations)
        deviation = of_mirror if conserves else max(of_mirror, of_glass)
    errors["energy"] = (_PER_NORMALISED_ENERGY if conserves else _PER_ENERGY) * deviation
    reason = max(errors, key=errors.__getitem__)
    if reason == "deep" and errors["steep"] >= QUALITATIVE:
        # The estimated error for deep relief increases with the slope, too. If it is the largest, but the error for
        # steep relief alone is at least `QUALITATIVE`, the slope is the reported reason.
        reason = "steep"
    if errors["undersampled"] >= INVALID:
        # If the samples are too far apart, the estimated errors for all other reasons are wrong too, because they use
        # the same samples.
        reason = "undersampled"
    return TheoryVerdict(max(errors.values()), reason, wavelength_nm)


def _cached(
    cache: weakref.WeakKeyDictionary[HeightField, dict[float, _T]], heightfield: HeightField, wavelength_nm: float,
    make: Callable[[HeightField, float], _T],
) -> _T:  # fmt: skip
    """Return ``make(heightfield, wavelength in µm)``, or its cached result for this height field and wavelength."""
    cached = cache.setdefault(heightfield, {})
    if wavelength_nm not in cached:
        if len(cached) >= _MOST_CACHED:
            cached.clear()
        cached[wavelength_nm] = make(heightfield, 1e-3 * wavelength_nm)
    return cached[wavelength_nm]


@single_threaded_blas()
@np.errstate(under="ignore")
def errors_of(heightfield: HeightField, wavelength_um: float) -> dict[Reason, float]:
    """Return the estimated errors of an order's efficiency, by the reason of the error, without the reason "energy"."""
    if heightfield.height_range_um == 0.0:
        return {"steep": 0.0, "deep": 0.0, "narrow": 0.0, "undersampled": 0.0}
    heights, pitch_um, window = _part(heightfield, wavelength_um)
    radius = np.hypot(*_orders(heights.shape, pitch_um, wavelength_um))
    scale = heights.size * float(np.sum(window**2))
    power = np.abs(np.fft.fft2(window * (heights - np.average(heights, weights=window)))) ** 2
    slope = 2.0 * math.pi / wavelength_um * math.sqrt(float(np.sum(power * np.minimum(radius, 1.0) ** 2)) / scale)
    light = np.abs(np.fft.fft2(window * np.exp(2j * math.pi / wavelength_um * heights))) ** 2 / scale
    return {
        "steep": _PER_SLOPE * slope,
        "deep": _PER_DEPTH * _lost_power(heightfield, wavelength_um),
        "narrow": _PER_NARROW_SHARE * float(np.sum(light[radius > _NARROW])),
        "undersampled": _PER_UNDERSAMPLED * _undersampled_share(heightfield, wavelength_um),
    }


def _orders(
    shape: tuple[int, ...], pitch_um: tuple[float, float], wavelength_um: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the frequencies (y, x) of a discrete Fourier transform times the wavelength (no unit), (ny, nx) each."""
    rates = (wavelength_um * np.fft.fftfreq(n, pitch) for n, pitch in zip(shape, pitch_um, strict=True))
    v, u = np.meshgrid(*rates, indexing="ij")
    return v, u


def _part(
    heightfield: HeightField, wavelength_um: float
) -> tuple[NDArray[np.float64], tuple[float, float], NDArray[np.float64]]:
    """Return the heights of the middle of a field, at most as finely sampled as the wavelength requires.

    Also return the pitch of the part [µm] and a window function. If the part is smaller than the field along an axis,
    the window function falls to 0 at both ends of the part along this axis. Otherwise it is 1.
    """
    most = _MOST_OF_PROFILE if 1 in heightfield.shape else _MOST_OF_FIELD
    steps, parts, fades = [], [], []
    for n, pitch in zip(heightfield.shape, heightfield.pitch_um, strict=True):
        finest = max(int(wavelength_um / (_PER_WAVELENGTH * pitch)), 1)
        # Every ``step``-th sample is used, which limits the number of samples but leaves enough samples per wavelength.
        # If the whole period of the field is used, ``step`` must divide the number of samples of the period, so that
        # the used samples are periodic, too.
        step = next(step for step in range(min(finest, -(-n // most)), 0, -1) if n % step == 0 or n > step * most)
        count = min(n // step, most)
        first = (n - count * step) // 2
        steps.append(step)
        parts.append(slice(first, first + count * step, step))
        fades.append(np.ones(count) if count * step == n else np.hanning(count + 2)[1:-1])
    part = heightfield.heights_um[parts[0], parts[1]]
    if np.isnan(part).any():
        part = np.where(np.isnan(part), np.nanmean(heightfield.heights_um), part)
    dy, dx = heightfield.pitch_um
    return part, (dy * steps[0], dx * steps[1]), np.outer(*fades)


def _lost_power(heightfield: HeightField, wavelength_um: float) -> float:
    """Return the estimated power that leaves the zeroth order and that no other order carries.

    The power is (4πs/λ)² min(1, λ/d). Here λ is the wavelength, s is the standard deviation of the heights, and d is
    the period of a sine with this s and the mean slope of the surface.
    """
    rms = heightfield.rms_um / wavelength_um
    if rms == 0.0:
        return 0.0
    return (4.0 * math.pi * rms) ** 2 * min(1.0, heightfield.mean_slope / (4.0 * math.sqrt(2.0) * rms))


def _undersampled_share(heightfield: HeightField, wavelength_um: float) -> float:
    """Return the fraction of undersampled steps in the sum of all height differences |Δh| between neighbouring samples.

    The larger of the fractions along x and along y counts. A step is the height difference Δh of two neighbouring
    samples. It is undersampled if it and the next step change the phase of the light by more than half a cycle each,
    both upwards or both downwards. A single large step is not counted, because it is a vertical wall, which two samples
    represent correctly.
    """
    worst = 0.0
    limit = wavelength_um / 4.0
    if heightfield.height_range_um <= 2.0 * limit:
        return worst
    heights = heightfield.heights_um[: _MOST_OF_FIELD if heightfield.shape[1] > 1 else None, :_MOST_OF_PROFILE]
    for axis in (0, 1):
        steps = np.nan_to_num(np.diff(heights, axis=axis))
        total = float(np.sum(np.abs(steps)))
        if steps.shape[axis] < 2 or total == 0.0:
            continue
        first, second = (np.take(steps, range(k, steps.shape[axis] - 1 + k), axis) for k in (0, 1))
        in_row = (np.minimum(np.abs(first), np.abs(second)) > limit) & (first * second > 0.0)
        worst = max(worst, float(np.sum(np.abs(first[in_row]))) / total)
    return worst


@single_threaded_blas()
@np.errstate(under="ignore")
def energy_deviations(heightfield: HeightField, wavelength_um: float) -> tuple[float, float]:
    """Return the relative error of the sum of Stam's efficiencies over all orders, for a mirror and for glass.

    Energy conservation requires that the sum equals the reflectance of a flat surface. The results are the largest
    deviations from it, relative to this reflectance, for several directions to the light.
    """
    heights, pitch_um, window = _part(heightfield, wavelength_um)
    heights = heights / wavelength_um
    if heightfield.height_range_um == 0.0 or np.ptp(heights) > _MOST_RANGE:
        return 0.0, 0.0
    v, u = _orders(heights.shape, pitch_um, wavelength_um)
    reachable = np.hypot(u, v) <= 1.0 + math.sin(math.radians(max(_ANGLES_DEG)))
    orders = np.stack([u[reachable], v[reachable]], axis=1)
    # The phase of the reflected wave is 2πκ times the height in wavelengths. Here κ = cos θi + cos θr differs between
    # orders. The amplitudes of all orders are computed at a few values of κ. Chebyshev polynomials interpolate the
    # amplitude of an order to its own κ.
    low, high = math.cos(math.radians(max(_ANGLES_DEG))), 2.0
    argument = math.pi * (high - low) / 2.0 * float(np.ptp(heights))
    count = math.ceil(argument + 4.0 * math.cbrt(argument)) + 4
    nodes = np.cos(math.pi * (np.arange(count) + 0.5) / count)
    centred = heights - (heights.max() + heights.min()) / 2.0
    scale = math.sqrt(heights.size * float(np.sum(window**2)))
    kappas = (high + low) / 2.0 + (high - low) / 2.0 * nodes
    amplitudes = [np.fft.fft2(window * np.exp(2j * math.pi * kappa * centred))[reachable] / scale for kappa in kappas]
    chebvander = np.polynomial.chebyshev.chebvander
    coefficients = np.linalg.solve(chebvander(nodes, count - 1), np.stack(amplitudes))
    worst = [0.0, 0.0]
    for light in _lights(heights.shape):
        tangential = orders - light[:2]
        upward = 1.0 - np.sum(tangential**2, axis=1)
        live = upward > _LEAST_COSINE**2
        cosines = np.sqrt(upward[live])
        w = light[2] + cosines
        polynomials = chebvander((2.0 * w - high - low) / (high - low), count - 1)
        powers = np.abs(np.einsum("nk,kn->n", polynomials, coefficients[:, live])) ** 2
        overlap = 1.0 + light[2] * cosines + tangential[live] @ light[:2]
        efficiencies = powers * overlap**2 / (light[2] * cosines * w**2)
        for place, normal in enumerate((_MIRROR, _GLASS)):
            reflectances = schlick(np.sqrt(overlap / 2.0), normal) / schlick(light[2], normal)
            worst[place] = max(worst[place], abs(float(efficiencies @ reflectances) - 1.0))
    return worst[0], worst[1]


def _lights(shape: tuple[int, ...]) -> list[NDArray[np.float64]]:
    """Return the directions to the light for which efficiencies are summed: on both sides of the normal, along x and y.

    There are no directions along an axis on which the height field has a single sample.
    """
    lights = []
    for angle in np.radians(_ANGLES_DEG):
        for axis in (0, 1):
            if shape[1 - axis] > 1:
                for sign in (1.0, -1.0) if angle > 0.0 else (1.0,):
                    light = np.array([0.0, 0.0, math.cos(angle)])
                    light[axis] = sign * math.sin(angle)
                    lights.append(light)
    return lights
