"""Plan from bounds: numbers that suffice for any surface and for all directions of a range.

Bounds are conservative. Calls with few directions are computed by them; a search starts from them and judges
its results by finer ones.
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

# Series remainder allowed per amplitude, as a share of the tolerance. Derived: errors are relative to at least 1e-3 of
# a picture's brightness (FLOOR), whose amplitude is 0.03 of the bright one's, and orders are weaker than the mirror by
# as much again. Twice the share shows on surfaces with weak orders alone.
AMPLITUDE_MARGIN = 1e-3
# Least Gaussian weight of a neighbour, as a share of the tolerance, by whether powers add. Derived: the zeroth order
# has power 1, a call that does not show it may be darker by 1e-5 and has a floor of 1e-3 of that; amplitudes require
# the square root of the ratio, here with a margin of 100. Twice the share adds its tail to the darkest calls.
_WEIGHT_MARGINS = {True: 1e-8, False: 1e-6}
# The same for plans that no trial has seen. Derived: a call may be as dark as DARK.
_DARKEST = trial.NEGLIGIBLE_SHARE * trial.DARK
# Samples per unit of 1/λ [µm] for the colour curves and the illuminant. Fitted: D65, FL11 and HP1 from 1e-1 to 1e-4
# (docs/decisions/plans_and_tolerance.md). Half of it exceeds the quadrature share under lines of an illuminant.
_COLOUR_BANDWIDTH_UM = 48.0
# Samples per standard deviation of the Gaussian of 1/λ as which an order passes, at a tolerance of 1. Fitted: the same
# illuminants, Gaussians of 1/18 to 1/222 per µm, 0.95 at a tolerance of 1e-2.
_SAMPLES_PER_DEVIATION = 0.441
# Samples per cycle of the interference of two levels of a tall surface in the mirror direction, at a tolerance of 1, in
# addition to those for the colours. Fitted: two levels 3 and 5.5 µm high under HP2 and FL12, 6 at 1e-2.
_SAMPLES_PER_CYCLE = 2.785
# Order of the error in the sample distance. Derived: quintics through six samples for windows and sources, cubics
# through four for the power of a replicated patch.
_QUINTIC_ORDER, _CUBIC_ORDER = 6.0, 4.0
# Typical error of a plan from bounds, of the integral over λ and of the neighbours each, as a share of the tolerance.
# Fitted: 99th percentile of the errors with the samples above. It is reported only.
_TYPICAL_SHARE = 0.05
# Samples of a replicated patch's power per order that passes, at a tolerance of 1. Fitted: random patches of fingers
# under D65 to HP1, 25 at 1e-2. Half of it has 16 times the error.
_SAMPLES_PER_ORDER = 8.0
# Largest number of wavelengths of a colour. Limit: seconds per direction.
MOST_WAVELENGTHS = 65_536
# Largest number of wavelengths for a source at the horizon. Limit: a source is foreshortened without end there; 16,384
# wavelengths suffice for a foreshortening of fifty.
_MOST_GRAZING = 16_384


def upper_bound_plan(request: Evaluation, direction_range: DirectionRange, *, method: str, tolerance: float) -> Plan:
    """The plan that follows from bounds alone, for a method and a tolerance that may differ from the request's."""
    heightfield, coherence, colour = request.heightfield, request.coherence, request.integrates
    series = AUTOMATIC if method in ("auto", "direct") else method
    # A fitted basis is made from the Jacobi-Anger series.
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
    """The plan with the neighbours that a call requires which no trial has seen and which may be dark."""
    return replace(plan, least_weight=plan.tolerance * _DARKEST) if plan.coherence.adds_powers else plan


def bandwidth_um(heightfield: HeightField, coherence: Coherence, tolerance: float) -> tuple[float, float, float]:
    """Samples per unit of 1/λ that a direction requires, as a, b, c [µm] of a·rate + b·|w| + c.

    Products of two points of the surface oscillate as w(h − h') + (u, v)·(x − x'), exp(−|x − x'|²/4σ²) weighs their
    distance, so that orders pass as Gaussians, and the colour curves add a constant. No number exceeds the limit of a
    plan; plans near it are refused by their number of wavelengths.
    """
    if coherence.kind == "replicas":
        # |mean over the patch|² has orders between −|u|Lx − |v|Ly and the same above, in samples of cubics.
        per_order = _SAMPLES_PER_ORDER * tolerance ** (-1.0 / _CUBIC_ORDER)
        return per_order, per_order * heightfield.height_range_um, _COLOUR_BANDWIDTH_UM
    quintic = tolerance ** (-1.0 / _QUINTIC_ORDER)
    per_deviation, cycles = quintic * _SAMPLES_PER_DEVIATION, quintic * _SAMPLES_PER_CYCLE
    if coherence.sigma_um is not None:
        order_rate = per_deviation * 2.0 * math.sqrt(2.0) * math.pi * coherence.sigma_um
        return min(order_rate, MOST), cycles * heightfield.height_range_um, _COLOUR_BANDWIDTH_UM
    # Equal ratios from 380 to 780 nm are, at 380 nm, further apart than equal steps by this factor. The window of
    # van Cittert and Zernike is in proportion to λ, unchanged.
    log_band = math.log(LAMBDA_MAX_NM / LAMBDA_MIN_NM)
    wider = log_band * NM_PER_UM / LAMBDA_MIN_NM / cost_model.SPAN
    order_rate = per_deviation / coherence.spread * log_band / cost_model.SPAN
    return min(order_rate, MOST), wider * cycles * heightfield.height_range_um, wider * _COLOUR_BANDWIDTH_UM


def _with_wavelengths(plan: Plan) -> Plan:
    """The plan with as many wavelengths as its bandwidth requires, or for a source at the horizon the largest set."""
    count = coefficient_table.wavelength_set_size(cost_model.wavelength_count(plan, plan.max_order_rate, plan.max_w))
    periods = plan.coherence.periods
    divisions = 1
    if periods is not None:
        # The squared sine ratio of the periods has two samples per lobe.
        divisions = math.ceil(2.0 * math.sqrt(2.0) * max(periods) / plan.bandwidth_um[0])
    facing = cost_model.wavelength_count(plan, plan.max_uv, plan.max_w)
    if plan.coherence.kind == "source" and facing <= _MOST_GRAZING < count:
        count = coefficient_table.wavelength_set_size(_MOST_GRAZING)
        per_rate, per_w, constant = plan.bandwidth_um
        order_rate = (count / cost_model.SPAN - per_w * plan.max_w - constant) / per_rate
        plan = replace(plan, max_order_rate=max(order_rate, plan.max_uv))
    return replace(plan, wavelengths=count, subdivisions=divisions)
