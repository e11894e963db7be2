"""Upper-bound plan: numbers of terms, coefficients and wavelengths that suffice for any surface and all directions.

A plan holds the method and the numbers of a computation. The terms are those of the series in which each Fourier
coefficient is expanded. The coefficients are the Fourier coefficients whose sum is the light of a direction. "Patch"
means the area of the height field. "Source" means a light source of finite size (coherence of the kind "source").

A call is one call of a public function, such as ``wd.reflectance``. "All directions" are those within the range of the
directions of a call. Calls with few directions use the upper-bound plan directly. For calls with many directions, a
search for a cheaper plan starts from the upper-bound plan. The search measures errors against a plan with more
wavelengths than the upper-bound plan.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from warpdiff.core.validation import MOST
from warpdiff.diffraction.phase_series import EXPANSIONS
from warpdiff.heightfield.theory_verdict import theory_wavelength_nm, verdict_on
from warpdiff.optics.colorimetry import LAMBDA_MAX_NM, LAMBDA_MIN_NM, NM_PER_UM
from warpdiff.planner import cost_model, trial
from warpdiff.request.plan import AUTOMATIC, Plan
from warpdiff.tables import coefficient_table

if TYPE_CHECKING:
    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.request.directions import DirectionRange
    from warpdiff.request.evaluation import Evaluation

# Largest error that the truncation of a series may cause in the amplitude of a Fourier coefficient, as a share of the
# tolerance. The number was derived as the product of two factors of 0.03. First, errors of luminance are relative to at
# least 1e-3 of a picture's luminance (FLOOR), which is a factor of 0.03 in amplitude. Second, the amplitudes of all
# diffraction orders may be only 0.03 of the amplitude of the mirror reflection. If the number was doubled, surfaces
# that have only weak orders could exceed the tolerance.
AMPLITUDE_MARGIN = 1e-3
# Smallest Gaussian weight, as a share of the tolerance, of a Fourier coefficient in the sum of the light of a
# direction. Coefficients with a smaller weight are excluded. The key of an entry is True if the powers of Fourier
# coefficients add, and False if their amplitudes add. The entry for powers was derived from the zeroth order, whose
# peak has the power 1. If all directions of a call are far from this peak, they may be darker than the peak by a factor
# of 1e-5. Errors are relative to at least 1e-3 of the luminance of these directions. The product of both factors is
# 1e-8. The entry for amplitudes was derived as the square root of the entry for powers, 1e-4, divided by 100 as a
# margin. If the entries were doubled, the errors of calls with only dark directions would exceed the tolerance, because
# tails of the zeroth order would be missing.
_WEIGHT_MARGINS = {True: 1e-8, False: 1e-6}
# Least Gaussian weight of Fourier coefficients, as a share of the tolerance, for plans (numbers of computations) that
# were not tested on sampled directions. The number was derived from calls with only dark directions, whose luminance
# may be as small as 1e-10 of that of a mirror (DARK).
_DARKEST = trial.NEGLIGIBLE_SHARE * trial.DARK
# Number of wavelength samples per unit of 1/λ [µm] that the colour-matching functions and the illuminant require. The
# number was fitted for the illuminants D65, FL11 and HP1 at tolerances from 1e-1 to 1e-4
# (docs/decisions/plans_and_tolerance.md). If the number was halved, the error of the integral over the wavelength would
# exceed the tolerance under illuminants with spectral lines, even without any other error.
_COLOUR_BANDWIDTH_UM = 48.0
# Number of wavelength samples per standard deviation of a diffraction order, whose light is a Gaussian over 1/λ. The
# number is for a tolerance of 1. It increases for smaller tolerances, to 0.95 at 1e-2. It was fitted for the
# illuminants D65, FL11 and HP1 with standard deviations of 1/18 to 1/222 per µm.
_SAMPLES_PER_DEVIATION = 0.441
# In the mirror direction, the interference of the light from two height levels of a surface oscillates as a function of
# 1/λ. This number of wavelength samples is required per cycle of this oscillation, in addition to the samples of
# `_COLOUR_BANDWIDTH_UM`. The number is for a tolerance of 1. It increases for smaller tolerances, to 6 at 1e-2. It was
# fitted for levels 3 and 5.5 µm apart under the illuminants HP2 and FL12.
_SAMPLES_PER_CYCLE = 2.785
# Orders p of convergence of the integral over the wavelength λ: for n samples, the error of the integral is
# proportional to n^−p. The orders were derived from the interpolations over λ. For coherence windows and light sources,
# quintic polynomials through six samples interpolate the reflectance. For replicated patches, cubic polynomials through
# four samples interpolate the power of one patch.
_QUINTIC_ORDER, _CUBIC_ORDER = 6.0, 4.0
# Typical error of an upper-bound plan, as a share of the tolerance. The number is used twice: for the error of the
# integral over the wavelength λ, and for the error by excluded Fourier coefficients. It was fitted to the 99th
# percentile of the errors of such plans. Plans report the number; no decision depends on it.
_TYPICAL_SHARE = 0.05
# While λ runs over the visible range, diffraction orders pass a direction. This number of wavelength samples per order
# resolves the power of one patch of a replicated surface. The number is for a tolerance of 1. It increases for smaller
# tolerances, to 25 at 1e-2. It was fitted for random patches of ``gratings.fingers`` (a synthetic snake skin) under
# illuminants from D65 to HP1. If it was halved, the error would be 16 times as large.
_SAMPLES_PER_ORDER = 8.0
# Largest number of wavelengths that are sampled to compute a colour. The value is limited by computing time, which is
# proportional to it. With this number, one direction already requires seconds.
MOST_WAVELENGTHS = 65_536
# Largest number of wavelengths for a light source of finite size near the horizon. The foreshortening of the source
# near the horizon increases the required number without bound. This number suffices for a foreshortening by a factor of
# 50.
_MOST_GRAZING = 16_384


def upper_bound_plan(request: Evaluation, direction_range: DirectionRange, *, method: str, tolerance: float) -> Plan:
    """Return the upper-bound plan for ``method`` and ``tolerance``, which may differ from those of ``request``.

    An upper-bound plan holds numbers of terms, coefficients and wavelengths that suffice for any surface.
    """
    heightfield, coherence, colour = request.heightfield, request.coherence, request.integrates
    series = AUTOMATIC if method in ("auto", "direct") else method
    # The methods ``"power"`` and ``"low-rank"`` have no series of their own. The basis functions of both methods are
    # fitted to the Jacobi-Anger series, so that they use the number of terms of this series.
    expansion = EXPANSIONS.get(series, EXPANSIONS["jacobi-anger"])
    argument = 2.0 * math.pi * direction_range.kappas[1] * expansion.offset_and_scale(heightfield)[1]
    terms = expansion.term_count(argument, tolerance * AMPLITUDE_MARGIN)
    theory = verdict_on(
        heightfield, theory_wavelength_nm(direction_range.lambda_min_nm, direction_range.lambda_max_nm),
        conserves=request.conserves_energy,
    )  # fmt: skip
    plan = Plan(
        method="direct" if method == "direct" else series, coherence=coherence, tolerance=tolerance, terms=terms,
        least_weight=tolerance * _WEIGHT_MARGINS[coherence.adds_powers], wavelengths=0, subdivisions=1,
        bandwidth_um=bandwidth_um(heightfield, coherence, tolerance), adaptive=True, rings_per_octave=0,
        azimuths_per_width=0.0, w_basis_size=0, footprint=False, energy_spread=0.0,
        max_uv=direction_range.max_uv, max_order_rate=direction_range.max_order_rate, min_w=direction_range.min_w,
        max_w=direction_range.max_w, lambda_min_nm=direction_range.lambda_min_nm,
        lambda_max_nm=direction_range.lambda_max_nm, height_range_um=heightfield.height_range_um,
        truncation=expansion.remainder(argument, terms),
        neighbourhood=0.0 if coherence.kind == "replicas" else _TYPICAL_SHARE * tolerance,
        quadrature=_TYPICAL_SHARE * tolerance if colour else 0.0,
        rounding=float(np.finfo(np.float32).eps) / 2.0 * expansion.growth(argument), aliasing=0.0,
        scalar_error=theory.error, scalar_reason=theory.reason, multiply_adds=0.0, is_measured=False, validation_size=0,
        table_multiply_adds=0.0,
    )  # fmt: skip
    if colour:
        plan = _with_wavelengths(plan)
    dearest = cost_model.sampling_multiply_adds(
        heightfield, plan, np.array([direction_range.max_order_rate]), np.array([direction_range.max_w])
    )
    return replace(plan, multiply_adds=dearest)


def with_neighbours_of_darkness(plan: Plan) -> Plan:
    """Return the plan with a smaller least weight of Fourier coefficients if their powers add: more are then included.

    This is for plans that were not tested on sampled directions. All directions of the call may be very dark, and the
    tails of bright diffraction orders then matter.
    """
    return replace(plan, least_weight=plan.tolerance * _DARKEST) if plan.coherence.adds_powers else plan


def bandwidth_um(heightfield: HeightField, coherence: Coherence, tolerance: float) -> tuple[float, float, float]:
    """Return a, b and c: a direction requires a · rate + b · |w| + c wavelength samples per unit of 1/λ.

    ``rate`` is the order rate: how fast orders pass the direction as 1/λ changes. w is the component of the scattering
    vector (u, v, w) along the normal. The unit of a, b and c is µm; only for replicas, whose order rate is in µm, a has
    no unit.

    The interference of two surface points x and x' with heights h and h' has the phase 2π/λ times
    w(h − h') + (u, v)·(x − x'). A coherence window weights this interference by exp(−|x − x'|²/4σ²). Orders are
    therefore Gaussians over 1/λ, and their width determines a. The range of heights determines b, and the
    colour-matching functions determine c. The factor a is limited to the largest number that a plan accepts; a plan at
    that limit is refused later, because it has too many wavelengths.
    """
    if coherence.kind == "replicas":
        # As 1/λ changes, the power of one patch with the sides Lx and Ly oscillates with at most |u|Lx + |v|Ly cycles
        # per unit of 1/λ. This number is at most proportional to the order rate, which is |(u Lx, v Ly)|.
        per_order = _SAMPLES_PER_ORDER * tolerance ** (-1.0 / _CUBIC_ORDER)
        return per_order, per_order * heightfield.height_range_um, _COLOUR_BANDWIDTH_UM
    quintic = tolerance ** (-1.0 / _QUINTIC_ORDER)
    per_deviation, cycles = quintic * _SAMPLES_PER_DEVIATION, quintic * _SAMPLES_PER_CYCLE
    if coherence.sigma_um is not None:
        order_rate = per_deviation * 2.0 * math.sqrt(2.0) * math.pi * coherence.sigma_um
        return min(order_rate, MOST), cycles * heightfield.height_range_um, _COLOUR_BANDWIDTH_UM
    # For coherence windows and replicated patches, the wavelengths have equal steps of 1/λ. For a source, neighbouring
    # wavelengths have equal ratios. The largest of the resulting steps of 1/λ, at 380 nm, is ``wider`` times as large
    # as if the same number of wavelengths had equal steps. The results b and c are therefore multiplied by ``wider``.
    # The result a is not multiplied: the coherence window of a source is proportional to λ (van Cittert-Zernike), so
    # that orders have a constant width in ln λ.
    log_band = math.log(LAMBDA_MAX_NM / LAMBDA_MIN_NM)
    wider = log_band * NM_PER_UM / LAMBDA_MIN_NM / cost_model.SPAN
    order_rate = per_deviation / coherence.spread * log_band / cost_model.SPAN
    return min(order_rate, MOST), wider * cycles * heightfield.height_range_um, wider * _COLOUR_BANDWIDTH_UM


def _with_wavelengths(plan: Plan) -> Plan:
    """Return the plan with the number of wavelengths that its bandwidth (samples per unit of 1/λ) requires.

    For a source (light of finite size) near the horizon, the number is limited, and the plan is valid only up to a
    smaller order rate.
    """
    count = coefficient_table.wavelength_set_size(cost_model.wavelength_count(plan, plan.max_order_rate, plan.max_w))
    periods = plan.coherence.periods
    divisions = 1
    if periods is not None:
        # As a function of 1/λ, the interference factor of N replicated periods has N maxima from one diffraction order
        # to the next. It requires two samples per maximum, which subdivide the steps between wavelengths.
        divisions = math.ceil(2.0 * math.sqrt(2.0) * max(periods) / plan.bandwidth_um[0])
    facing = cost_model.wavelength_count(plan, plan.max_uv, plan.max_w)
    if plan.coherence.kind == "source" and facing <= _MOST_GRAZING < count:
        count = coefficient_table.wavelength_set_size(_MOST_GRAZING)
        per_rate, per_w, constant = plan.bandwidth_um
        order_rate = (count / cost_model.SPAN - per_w * plan.max_w - constant) / per_rate
        plan = replace(plan, max_order_rate=max(order_rate, plan.max_uv))
    return replace(plan, wavelengths=count, subdivisions=divisions)
