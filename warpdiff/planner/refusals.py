"""Errors and warnings of the planner, with remedies, for calls that it cannot plan or that may be inaccurate.

A plan holds the numbers of a computation, such as the number of wavelengths, and its predicted errors. An upper-bound
plan suffices for any surface.

(u, v, w) is the scattering vector −ωi − ωr in the frame of the surface, where ωi and ωr are the unit vectors to the
light and to the viewer. The component w is along the normal.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ToleranceError, ref
from warpdiff.diffraction.phase_series import EXPANSIONS
from warpdiff.heightfield import diagnostics
from warpdiff.optics.colorimetry import LAMBDA_MAX_NM, NM_PER_UM
from warpdiff.planner import bounds
from warpdiff.planner.trial import SEARCH_SAFETY
from warpdiff.request.plan import LABELS
from warpdiff.tables import coefficient_table, polar_grid

if TYPE_CHECKING:
    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.request.directions import DirectionRange
    from warpdiff.request.evaluation import Evaluation
    from warpdiff.request.plan import Plan

# Largest number of Fourier coefficients that contribute to a direction. A call that needs more raises an error. Such a
# call indicates a wrong unit, or a patch (area of the height field) that is much larger than the coherence window.
_MOST_NEIGHBOURS = 40_000
# Size to which an error message recommends to crop a patch, in standard deviations σ of the coherence window. The
# number was derived from a window whose results are averaged over its positions. Two points at the distance r then
# interfere with the weight exp(−r²/4σ²). It is 1e-11 at r = 10σ, half of the size, beyond which the repeated patch is
# nearer.
_PATCH_IN_SIGMAS = 20.0
# Largest number of samples of the interference factor of replicated patches: the number of wavelengths times the number
# of samples per wavelength. The value is limited by the memory of the integral over wavelengths, which is proportional
# to it.
_MOST_SAMPLES = 2_000_000
# The directions of a call may exceed the range of a plan that the caller passes by this relative amount without a
# warning. Such an excess is harmless, because Fourier coefficients are computed for a range that exceeds the range of
# the plan by more than this amount.
_RANGE_MARGIN = 0.03
_LESS_COHERENT = {
    "averaged": f"a smaller {ref('sigma_um')}",
    "centred": f"a smaller {ref('sigma_um')}",
    "source": f"a larger {ref('angular_diameter_deg')}",
    "replicas": f"fewer {ref('periods')}",
}


def check_integration(request: Evaluation) -> None:
    """Raise an error if a call for a spectrum requests ``integration="table"``, because tables contain colours only."""
    if not request.integrates and request.integration == "table":
        raise ArgumentValueError(
            f"{ref('integration')} must not be 'table' for a spectrum, which is not integrated over λ"
        )


def check_size(heightfield: HeightField, plan: Plan) -> None:
    """Raise an error if an upper-bound plan requires more Fourier coefficients or wavelengths than are supported."""
    if plan.method != "direct" and plan.coherence.kind != "replicas":
        _check_neighbours(heightfield, plan)
    if plan.wavelengths > bounds.MOST_WAVELENGTHS or plan.wavelengths * plan.subdivisions > _MOST_SAMPLES:
        coherence = plan.coherence
        what = {
            "source": ref("angular_diameter_deg", coherence.angular_diameter_deg),
            "replicas": f"{ref('periods', coherence.periods)} of {heightfield.size_um[0]:g} × "
            f"{heightfield.size_um[1]:g} µm",
        }.get(coherence.kind, ref("sigma_um", coherence.sigma_um))
        raise ToleranceError(
            f"{what} and a height range of {heightfield.height_range_um:.3g} µm make spectra so fine that a colour "
            f"requires {plan.wavelengths * plan.subdivisions} wavelengths; at most {bounds.MOST_WAVELENGTHS} are "
            f"supported, {_MOST_SAMPLES} for replicas: use {_LESS_COHERENT[coherence.kind]}, a larger "
            f"{ref('tolerance')}, or warpdiff.spectral_reflectance"
        )


def _check_neighbours(heightfield: HeightField, plan: Plan) -> None:
    """Raise an error if more than ``_MOST_NEIGHBOURS`` Fourier coefficients contribute to a direction."""
    rows, columns = (2 * n + 1 for n in coefficient_table.neighbour_extent(plan, heightfield))
    if rows * columns <= _MOST_NEIGHBOURS:
        return
    coherence = plan.coherence
    if coherence.sigma_um is None:
        what = f"{ref('angular_diameter_deg', coherence.angular_diameter_deg)} is too wide"
    else:
        what = f"{ref('sigma_um', coherence.sigma_um)} is too short"
    raise ArgumentValueError(
        f"{what} for a patch of {heightfield.size_um[0]:g} × {heightfield.size_um[1]:g} µm, as it covers {rows} × "
        f"{columns} coefficients: crop the height field to about {_PATCH_IN_SIGMAS * _longest_sigma_um(coherence):.3g} "
        "µm, which looks the same under this coherence"
    )


def _longest_sigma_um(coherence: Coherence) -> float:
    """Return the standard deviation σ [µm] of the coherence window.

    For a source (light source of finite size), it is σ of the equivalent window at the longest visible wavelength.
    """
    if coherence.sigma_um is not None:
        return coherence.sigma_um
    return LAMBDA_MAX_NM / NM_PER_UM / (2.0 * math.sqrt(2.0) * math.pi * coherence.spread)


def check_error(request: Evaluation, plan: Plan) -> None:
    """Raise an error if a plan cannot meet its tolerance; only warn if the caller has set ``strict=False``."""
    heightfield = request.heightfield
    # If errors were measured, ``plan.error`` is the error on the validation set (sampled directions) times a safety
    # factor of at least SEARCH_SAFETY. A plan is also accepted if it meets the tolerance only without this factor.
    if plan.error <= plan.tolerance * (SEARCH_SAFETY if plan.is_measured else 1.0):
        return
    fewer = f"reduce the height range with {ref('levelled()')}, {ref('despiked()')} or {ref('cropped()')}"
    other = "" if request.method == "auto" else f"{ref('method', 'auto')} or "
    lower = f"{fewer}, or use {other}{ref('method', 'direct')}"
    height_range = f"for a height range of {heightfield.height_range_um:.3g} µm"
    rings = plan.rings_per_octave
    samples = f"{rings} rings per octave" if rings else f"{plan.wavelengths} wavelengths"
    directional = f"use {ref('method', 'auto')}, in pictures with lights of {ref('angular_diameter_deg', 0)}"
    sources = {
        "rounding": (f"float32 rounds terms that grow and cancel {height_range}", lower),
        "truncation": (f"{plan.terms} terms are too few {height_range}", lower),
        "neighbourhood": (
            f"neighbours of a weight below {plan.least_weight:.1e} are excluded", f"use {ref('method', 'direct')}"
        ),
        "quadrature": (
            f"{samples} are too few", directional if rings else f"use {_LESS_COHERENT[plan.coherence.kind]}"
        ),
    }  # fmt: skip
    largest = max(sources, key=plan.predicted_errors.__getitem__)
    (why, remedy), error = sources[largest], plan.predicted_errors[largest]
    risk = ", so the result may be meaningless" if error >= 1.0 else ""
    how = f"measured on {plan.validation_size} directions" if plan.is_measured else "by its bound"
    message = (
        f"the {LABELS[plan.method]} cannot meet {ref('tolerance', plan.tolerance)}: {why}, an error of {error:.1e} "
        f"{how}{risk}; {remedy}, or a larger {ref('tolerance')}"
    )
    if request.strict:
        raise ToleranceError(f"{message}; {ref('strict', False)} computes it anyway")
    warn(message)


def table_too_large(tolerance: float) -> ToleranceError:
    """Return the error for a call that requests a colour table, if even the smallest sufficient table is too large.

    The table is sufficient if it is expected to meet the tolerance.
    """
    return ToleranceError(
        f"{ref('integration', 'table')} requires more than {polar_grid.MOST_MEGABYTES:g} MB for "
        f"{ref('tolerance', tolerance)}: use {ref('integration', 'auto')}, or in pictures lights of "
        f"{ref('angular_diameter_deg', 0)}; or a smaller {ref('sigma_um')}, or a larger {ref('tolerance')}"
    )


def warn_of_theory(plan: Plan) -> None:
    """Warn if scalar diffraction is invalid on the surface of a plan, according to the verdict ``plan.theory``."""
    if plan.theory.grade == "invalid":
        warn(f"scalar diffraction is {plan.theory}: {plan.theory.remedy}")


def warn_of_darkness() -> None:
    """Warn that all results are 0, because the light or the viewer is below the horizon for each pair of directions."""
    warn(
        f"no pair of {ref('to_light')} and {ref('to_view')} is above the horizon (z > 0), so that all results are 0: "
        "directions are vectors away from the surface, in its frame with z along the normal"
    )


def warn_of_aliasing(heightfield: HeightField, plan: Plan, direction_range: DirectionRange) -> None:
    """Warn if the directions of a call require spatial frequencies beyond the Nyquist limit of the field's pitch.

    Fourier coefficients beyond this limit are copies (aliases) of coefficients within it, up to a phase. The phase
    matters for a coherence window with its centre between samples. For such a window, all Fourier coefficients that
    contribute to a direction must be within the limit.
    """
    pitch_um = diagnostics.coarsest_pitch_um(heightfield)
    if pitch_um == 0.0:
        return
    is_between = plan.coherence.centre_um is not None and plan.method != "direct"
    radius = coefficient_table.radius(plan) if is_between else 0.0
    supported = max(0.0, direction_range.lambda_min_nm / NM_PER_UM * (1.0 / (2.0 * pitch_um) - radius))
    if direction_range.max_uv > supported and not math.isclose(direction_range.max_uv, supported):
        warn(
            f"a pitch of {pitch_um:.3g} µm supports |(u, v)| up to {supported:.3g} at "
            f"{direction_range.lambda_min_nm:g} nm, but directions reach {direction_range.max_uv:.3g}: higher orders "
            "alias onto lower ones; scan at a finer pitch, or use HeightField.resampled() if the surface is smooth"
        )


def warn_outside(
    plan: Plan, heightfield: HeightField, direction_range: DirectionRange, *, compares_rates: bool = True
) -> None:
    """Warn if the directions, wavelengths or heights of a call are outside of the range of the user's ``plan``.

    ``compares_rates`` states whether the order rate of the call is compared, too: how fast orders pass a direction as
    1/λ changes. Spectra do not depend on it. Under a light source of finite size, the rate has no limit towards the
    horizon, so that no plan covers all directions of the hemisphere.
    """
    shortest, longest = NM_PER_UM / plan.lambda_min_nm, NM_PER_UM / plan.lambda_max_nm
    numbers = [
        ("|(u, v)| up to", direction_range.max_uv, plan.max_uv, 1.0),
        ("|w| up to", direction_range.max_w, plan.max_w, 1.0),
        ("1/λ [1/µm] up to", NM_PER_UM / direction_range.lambda_min_nm, shortest, 1.0),
        ("a height range [µm] of", heightfield.height_range_um, plan.height_range_um, 1.0),
    ]
    if compares_rates and plan.wavelengths and not plan.rings_per_octave and plan.coherence.sigma_um is None:
        # For coherence windows, the order rate (how fast orders pass as 1/λ changes) need not be compared: it equals
        # |(u, v)|, and the lines above compare |(u, v)|.
        numbers.append(("an order rate up to", direction_range.max_order_rate, plan.max_order_rate, 1.0))
    if plan.method not in EXPANSIONS:
        # Basis functions that are fitted to Fourier coefficients are valid only if |w|/λ is at least the product of the
        # smallest |w| and the smallest 1/λ of its plan. A call must therefore not have a smaller 1/λ than the plan. The
        # smallest |w| of the call is not compared with that of the plan, because renderers always report 0 for it.
        numbers.append(("1/λ [1/µm] down to", NM_PER_UM / direction_range.lambda_max_nm, longest, -1.0))
    beyond = [
        f"{name} {value:.3g}, planned {planned:.3g}"
        for name, value, planned, sign in numbers
        if sign * (value - planned) > _RANGE_MARGIN * planned + float(np.finfo(np.float32).eps)
    ]
    if beyond and plan.method != "direct":
        warn(
            f"{ref('plan')} is used beyond its valid range: {'; '.join(beyond)}; results may be wrong: make a plan for "
            "these directions and this height field with warpdiff.plan()"
        )
