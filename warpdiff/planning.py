"""The plan: from a height field, a window, a range of directions and a tolerance to the numbers the kernels get.

Every number follows from a bound that holds for all directions of the range, so a plan errs on the side of accuracy.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff import checks
from warpdiff.coherence import Coherence
from warpdiff.errors import WarpdiffWarning
from warpdiff.expansions import EXPANSIONS, MAX_TERMS, check_cycles
from warpdiff.fourier import axis_lengths_um
from warpdiff.heightfield import HeightField
from warpdiff.spectrum import LAMBDA_MAX_NM, LAMBDA_MIN_NM

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

METHODS = ("auto", *EXPANSIONS, "direct")

# A tolerance is relative to a pixel that may be a thousandth of the frame's bright ones, and orders are weaker than the
# mirror by as much again: what is left out of an amplitude must be smaller by this factor, ...
_AMPLITUDE_MARGIN = 1e-3
# ... and what is left out of a power by this one. On the scan, 3 × 3, 5 × 5 and 7 × 7 coefficients err by 3.7 %, 2e-4
# and 6e-8 in the median; the margin asks for the second at a tolerance of 1e-2 and for the third at 1e-4.
_POWER_MARGIN = 1e-4
# A colour changes as fast as the colour curves and the illuminant do: their share of the samples, at a tolerance of
# 1e-2, in samples per unit of 1/λ [µm]; cubic interpolation between samples errs as the fourth power of their distance.
_COLOUR_BANDWIDTH_UM = 48.0
# The integral's share of the tolerance.
_QUADRATURE_SHARE = 0.25
# A wider neighbourhood is a mistake in the units or a patch much larger than the window.
_MOST_NEIGHBOURS = 40_000
_PATCH_IN_SIGMAS = 20.0
_MOST_WAVELENGTHS = 20_000
# Float32 rounds each term of the series to half a unit in the last place.
_FLOAT32_ROUNDING = 2.0**-24


@dataclass(frozen=True)
class Plan:
    """What is computed, and why. ``dataclasses.replace(plan, terms=9)`` changes a number; pass it as ``plan=``.

    Attributes:
        method: A series, a key of ``expansions.EXPANSIONS``, or ``"direct"``.
        coherence: The window.
        tolerance: What was asked for.
        terms: Terms of the series, n = 0 … terms − 1.
        reach: Coefficients (y, x) on either side of the nearest one; the neighbourhood is 2·reach + 1 wide.
        wavelengths: Samples over 380 to 780 nm, equally spaced in 1/λ; 0 where the caller gives wavelengths.
        adaptive: Whether directions with less than the largest |(u, v)| and |w| take fewer of them.
        max_uv: Largest |(u, v)| of the directions that the numbers hold for.
        max_w: Largest |w| of these.
        lambda_min_nm: Shortest wavelength that the numbers hold for [nm].
        height_range_um: Largest height range that the numbers hold for [µm].
        truncation: Bound of the error of exp(2πiκh) from the terms left out.
        neighbourhood: Weight of the nearest coefficient that is left out.
        quadrature: Predicted relative error of the integral over λ; 0 without one.
        rounding: Bound of the error of exp(2πiκh) from float32 arithmetic.
        multiply_adds: Predicted cost of the dearest direction.
    """

    method: str
    coherence: Coherence
    tolerance: float
    terms: int
    reach: tuple[int, int]
    wavelengths: int
    adaptive: bool
    max_uv: float
    max_w: float
    lambda_min_nm: float
    height_range_um: float
    truncation: float
    neighbourhood: float
    quadrature: float
    rounding: float
    multiply_adds: int

    def __post_init__(self) -> None:
        checks.choice(self.method, "method", METHODS[1:])
        checks.instance(self.coherence, Coherence, "coherence")
        check_tolerance(self.tolerance)
        if not 1 <= checks.count(self.terms, "terms") <= MAX_TERMS:
            raise ValueError(f"terms must be 1 to {MAX_TERMS}, got {self.terms}")
        if not isinstance(self.reach, Sequence) or len(self.reach) != 2:
            raise ValueError(f"reach must be a pair (y, x), got {self.reach!r}")
        object.__setattr__(self, "reach", tuple(self.reach))
        for name in ("max_uv", "max_w", "lambda_min_nm", "height_range_um"):
            checks.number(getattr(self, name), name, least=0.0)
        for axis, value in enumerate(self.reach):
            checks.count(value, f"reach[{axis}]", least=0)
        checks.flag(self.adaptive, "adaptive")
        if self.wavelengths != 0:
            checks.count(self.wavelengths, "wavelengths", least=2)

    def __str__(self) -> str:
        window = f"{self.coherence.kind} window with σ = {self.coherence.sigma_um:g} µm"
        scope = f"for |(u, v)| up to {self.max_uv:.3g} and |w| up to {self.max_w:.3g}"
        if self.method == "direct":
            return f"Direct sum over the height samples in float64, {window}: no approximation but the integral over λ."
        rows, columns = (2 * n + 1 for n in self.reach)
        text = (
            f"{EXPANSIONS[self.method].label} series, {window}, tolerance {self.tolerance:g}, {scope}: "
            f"{self.terms} terms leave out {self.truncation:.1e} of exp(2πiκh), and float32 rounds it by up to "
            f"{self.rounding:.1e}; {rows} × {columns} coefficients leave out neighbours of weight "
            f"{self.neighbourhood:.1e}; "
        )
        if self.wavelengths:
            fewer = ", fewer where |(u, v)| is smaller," if self.adaptive else ""
            text += f"{self.wavelengths} wavelengths equally spaced in 1/λ{fewer} "
            text += f"integrate to about {self.quadrature:.1e}; "
        return text + f"some {self.multiply_adds / 1e3:.3g} thousand multiply-adds a direction at most."


def plan(
    hf: HeightField,
    to_light: ArrayLike | None = None,
    to_view: ArrayLike | None = None,
    *,
    tolerance: float = 1e-2,
    method: str = "auto",
    coherence: Coherence | None = None,
    strict: bool = True,
) -> Plan:
    """What an evaluation of these directions would compute.

    Args:
        hf: The height field.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3); None is the whole hemisphere.
        to_view: Directions to the viewer; None is the whole hemisphere.
        tolerance: Error of XYZ that is asked for, in 1e-5 to 0.5.
        method: ``"auto"``, ``"jacobi-anger"``, ``"taylor"``, ``"taylor-uncentred"`` or ``"direct"``.
        coherence: The window; the default is averaged with σ = 16.25 µm.
        strict: Raise a ``ValueError`` where the tolerance cannot be met; otherwise warn.

    Returns:
        The plan; ``print(plan)`` explains it.
    """
    check_request(hf, tolerance=tolerance, method=method, coherence=coherence, strict=strict)
    if to_light is None and to_view is None:
        max_uv, max_w = 2.0, 2.0
    elif to_light is None or to_view is None:
        given, _ = checks.directions(*((to_view, "to_view") if to_light is None else (to_light, "to_light")))
        above = given[given[:, 2] > 0.0]
        max_uv = min(2.0, 1.0 + float(np.max(np.hypot(above[:, 0], above[:, 1]), initial=0.0)))
        max_w = 1.0 + float(np.max(above[:, 2], initial=0.0))
    else:
        lights, views, _ = broadcast_directions(to_light, to_view)
        max_uv, max_w = deflection_range(-lights - views, (lights[:, 2] > 0.0) & (views[:, 2] > 0.0))
    return plan_for_range(
        hf, max_uv, max_w, tolerance=tolerance, method=method, coherence=coherence or Coherence(), strict=strict
    )


def check_tolerance(tolerance: Any) -> float:
    """Return a tolerance within the range that float32 and a picture make sense of."""
    return checks.number(tolerance, "tolerance", least=1e-5, most=0.5)


def check_request(hf: Any, *, tolerance: Any, method: Any, coherence: Any, strict: Any) -> None:
    """Refuse what no plan can be made for, before anything is computed."""
    checks.instance(hf, HeightField, "hf")
    check_tolerance(tolerance)
    checks.choice(method, "method", METHODS)
    checks.instance(coherence, Coherence, "coherence", optional=True)
    checks.flag(strict, "strict")


def broadcast_directions(
    to_light: ArrayLike, to_view: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Unit directions, both of shape (n, 3), and whether both were single."""
    lights, one_light = checks.directions(to_light, "to_light")
    views, one_view = checks.directions(to_view, "to_view")
    if len(lights) != len(views) and 1 not in (len(lights), len(views)):
        raise ValueError(
            f"to_light and to_view must hold the same number of directions, or one, got {len(lights)} and {len(views)}"
        )
    shape = (max(len(lights), len(views)) if len(lights) and len(views) else 0, 3)
    return np.broadcast_to(lights, shape), np.broadcast_to(views, shape), one_light and one_view


def deflection_range(deflections: NDArray[np.float64], lit: NDArray[np.bool_]) -> tuple[float, float]:
    """Largest |(u, v)| and |w| of the lit ones of the deflections, shape (n, 3)."""
    used = deflections[lit]
    if not len(used):
        return 0.0, 0.0
    return float(np.max(np.hypot(used[:, 0], used[:, 1]))), float(np.max(np.abs(used[:, 2])))


def plan_for_range(
    hf: HeightField,
    max_uv: float,
    max_w: float,
    *,
    tolerance: float,
    method: str,
    coherence: Coherence,
    strict: bool,
    wavelengths_nm: NDArray[np.float64] | None = None,
) -> Plan:
    """The plan for all directions with |(u, v)| <= ``max_uv`` and |w| <= ``max_w``.

    With ``wavelengths_nm`` there is no integral over λ, and only those wavelengths need be served.
    """
    tolerance = check_tolerance(tolerance)
    lambda_min_nm = float(LAMBDA_MIN_NM if wavelengths_nm is None else wavelengths_nm.min())
    check_cycles(hf, max_w / (lambda_min_nm * 1e-3))
    _warn_of_aliasing(hf, max_uv, lambda_min_nm)
    series = "jacobi-anger" if method in ("auto", "direct") else method
    expansion = EXPANSIONS[series]
    argument = 2.0 * math.pi * max_w / (lambda_min_nm * 1e-3) * expansion.offset_and_scale(hf)[1]
    terms = expansion.term_count(argument, tolerance * _AMPLITUDE_MARGIN)
    rounding = _FLOAT32_ROUNDING * expansion.growth(argument)
    truncation = expansion.remainder(argument, terms)
    if method != "direct":
        _check_series(hf, expansion.label, truncation, rounding, tolerance, strict=strict)

    leave_out = tolerance * (_POWER_MARGIN if coherence.kind == "averaged" else _AMPLITUDE_MARGIN)
    cut_um = math.sqrt(math.log(1.0 / leave_out) / coherence.falloff_um2)
    lengths = axis_lengths_um(hf)
    reach_y, reach_x = (max(0, math.ceil(cut_um * length - 0.5)) for length in lengths)
    neighbours = (2 * reach_y + 1) * (2 * reach_x + 1)
    if method != "direct" and neighbours > _MOST_NEIGHBOURS:
        raise ValueError(
            f"sigma_um={coherence.sigma_um:g} is too short for a patch of {hf.size_um[0]:g} × {hf.size_um[1]:g} µm: "
            f"{2 * reach_y + 1} × {2 * reach_x + 1} coefficients lie in its window's reach; crop the height field to "
            f"some {_PATCH_IN_SIGMAS * coherence.sigma_um:.3g} µm, which the window cannot tell from the whole"
        )
    nearest = min((n + 0.5) / length for n, length in zip((reach_y, reach_x), lengths, strict=True))
    neighbourhood = math.exp(-min(coherence.falloff_um2 * nearest**2, 700.0))

    wavelengths = 0
    if wavelengths_nm is None:
        per_uv, per_w, constant = bandwidth_um(hf, coherence, tolerance)
        span = 1e3 / LAMBDA_MIN_NM - 1e3 / LAMBDA_MAX_NM
        wavelengths = math.ceil(span * (per_uv * max_uv + per_w * max_w + constant)) + 1
        if wavelengths > _MOST_WAVELENGTHS:
            raise ValueError(
                f"sigma_um={coherence.sigma_um:g} and a height range of {hf.height_range_um:.3g} µm make spectra so "
                f"fine that a colour takes {wavelengths} wavelengths; the most are {_MOST_WAVELENGTHS}: take a smaller "
                "sigma_um or a larger tolerance, or spectral_reflectance at wavelengths of your own"
            )

    return Plan(
        method="direct" if method == "direct" else series,
        coherence=coherence,
        tolerance=tolerance,
        terms=terms,
        reach=(reach_y, reach_x),
        wavelengths=wavelengths,
        adaptive=True,
        max_uv=max_uv,
        max_w=max_w,
        lambda_min_nm=lambda_min_nm,
        height_range_um=hf.height_range_um,
        truncation=truncation,
        neighbourhood=neighbourhood,
        quadrature=tolerance * _QUADRATURE_SHARE if wavelengths else 0.0,
        rounding=rounding,
        multiply_adds=2 * terms * neighbours * max(wavelengths, 1),
    )


def warn_outside(plan: Plan, hf: HeightField, max_uv: float, max_w: float, lambda_min_nm: float) -> None:
    """Warn where a call with an explicit plan goes beyond what the plan's numbers hold for."""
    beyond = [
        f"{name} {value:.3g}, planned {planned:.3g}"
        for name, value, planned in (
            ("|(u, v)| up to", max_uv, plan.max_uv),
            ("|w| up to", max_w, plan.max_w),
            ("1/λ [1/µm] up to", 1e3 / lambda_min_nm, 1e3 / plan.lambda_min_nm),
            ("a height range [µm] of", hf.height_range_um, plan.height_range_um),
        )
        if value > planned * (1.0 + 1e-6) + 1e-9
    ]
    if beyond and plan.method != "direct":
        warnings.warn(
            f"plan= is used beyond what it holds for: {'; '.join(beyond)}; make one for these directions and this "
            "height field with warpdiff.plan()",
            WarpdiffWarning,
            stacklevel=4,
        )


def bandwidth_um(hf: HeightField, coherence: Coherence, tolerance: float) -> tuple[float, float, float]:
    """Samples per unit of 1/λ that a direction takes, as a, b, c [µm] of a·|(u, v)| + b·|w| + c.

    A trapezoidal sum in 1/λ sees what oscillates slower than its samples. Products of two points of the surface
    oscillate as w(h − h') + (u, v)·(x − x'), exp(−|x − x'|²/4σ²) weighs their distance, and the colour curves add a
    constant.
    """
    separation_um = 2.0 * coherence.sigma_um * math.sqrt(math.log(2.0 / (tolerance * _QUADRATURE_SHARE)))
    return separation_um, hf.height_range_um, _COLOUR_BANDWIDTH_UM * (1e-2 / tolerance) ** 0.25


def _check_series(
    hf: HeightField, label: str, truncation: float, rounding: float, tolerance: float, *, strict: bool
) -> None:
    """Refuse, or warn of, a series that cannot reach the tolerance in float32."""
    # The bound on rounding adds all terms up in the worst way and at one height; what a coefficient sees of it is
    # smaller by more than the margin that an amplitude needs.
    if rounding <= tolerance and truncation <= tolerance * _AMPLITUDE_MARGIN:
        return
    if rounding > tolerance:
        why = (
            f"its terms grow to {rounding / _FLOAT32_ROUNDING:.1e} and cancel, leaving an error of up to {rounding:.1e}"
        )
        if rounding >= 1.0:
            why += ", so that no digit need be right"
    else:
        why = f"{MAX_TERMS} terms, the most there are, leave out {truncation:.1e}"
    message = (
        f"the {label} series cannot reach tolerance={tolerance:g} in float32 for a height range of "
        f"{hf.height_range_um:.3g} µm: {why}; reduce the range with levelled(), despiked() or cropped(), ask for a "
        "larger tolerance, or use method='direct', or 'auto' in place of a Taylor series"
    )
    if strict:
        raise ValueError(message + "; strict=False computes it all the same")
    warnings.warn(message, WarpdiffWarning, stacklevel=4)


def _warn_of_aliasing(hf: HeightField, max_uv: float, lambda_min_nm: float) -> None:
    """Warn where the directions ask for frequencies beyond what the pitch can carry."""
    # An axis of one sample is constant, not sampled.
    coarsest = max((pitch for n, pitch in zip(hf.shape, hf.pitch_um, strict=True) if n > 1), default=0.0)
    if coarsest == 0.0:
        return
    supported = lambda_min_nm * 1e-3 / (2.0 * coarsest)
    if max_uv > supported * (1.0 + 1e-9):
        warnings.warn(
            f"a pitch of {coarsest:.3g} µm supports |(u, v)| up to {supported:.3g} at {lambda_min_nm:g} nm, and "
            f"directions up to {max_uv:.3g} are asked for: orders beyond repeat those within; scan at a finer pitch, "
            "or use HeightField.resampled() where the surface is known to be smooth",
            WarpdiffWarning,
            stacklevel=4,
        )
