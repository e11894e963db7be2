"""The plan: from a height field, a coherence, a range of directions and a tolerance to the numbers the kernels get.

Bounds that hold for all directions of the range come first and err on the side of accuracy. Calls of few directions are
computed by them; for many, ``plan_search`` finds on a sample of the directions how much of them is needed.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

import numpy as np

from warpdiff.core import memory, validation
from warpdiff.core.threads import single_threaded_blas
from warpdiff.core.warnings import warn
from warpdiff.core.wording import ArgumentValueError, ToleranceError, ref
from warpdiff.diffraction.coefficient_basis import holds_powers
from warpdiff.diffraction.phase_series import EXPANSIONS, check_cycles
from warpdiff.heightfield import diagnostics
from warpdiff.kernels import refinement_levels
from warpdiff.optics import reflectance_factors
from warpdiff.optics.colorimetry import LAMBDA_MAX_NM, LAMBDA_MIN_NM
from warpdiff.planner import cost_model, plan_search, trial
from warpdiff.request.directions import DirectionRange, DirectionSample, hemisphere_pairs, order_rate, stratified
from warpdiff.request.evaluation import Evaluation
from warpdiff.request.plan import AUTOMATIC, LABELS, Plan, has_table
from warpdiff.request.settings import PlanSettings
from warpdiff.request.signatures import accepts
from warpdiff.tables import coefficient_table, polar_grid

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from warpdiff.heightfield.field import HeightField
    from warpdiff.optics.coherence import Coherence
    from warpdiff.optics.spectra import Spectrum
    from warpdiff.request.keywords import PlanKeywords

# A tolerance is relative to a pixel that may be a thousandth of the frame's bright ones, and orders are weaker than the
# mirror by as much again: what a series leaves out of an amplitude must be smaller by this factor.
_AMPLITUDE_MARGIN = 1e-3
# The mirror's coefficient is the brightest by far, and a frame need not show it, but its Gaussian's tail: weights, on
# powers or on amplitudes, are negligible below this share of the tolerance.
_WEIGHT_MARGINS = {True: 1e-8, False: 1e-6}
# Where nothing is tried, a call may be as dark as f is at least.
_DARKEST = 1e-12
# What a fitted basis may leave out of a coefficient's largest value, as a share of the tolerance: where κ is small, the
# coefficient is, too.
_BASIS_SHARE = 1e-2
# A colour changes as fast as the colour curves and the illuminant do: their share of the samples, per unit of 1/λ [µm].
_COLOUR_BANDWIDTH_UM = 48.0
# An order passes as a Gaussian of 1/λ: samples for each of its deviations at a tolerance of 1e-2. Quintics between
# samples, under curves with lines, err as the sixth power of their distance; measured from 1e-1 to 1e-4 for D65, FL11
# and HP1, for Gaussians of 1/18 to 1/222 per µm.
_SAMPLES_PER_DEVIATION = 0.95
# Two levels of a tall surface, seen from the mirror direction, oscillate: samples for each cycle, besides the colours'.
_SAMPLES_PER_CYCLE = 6.0
# What plans from bounds leave to the integral, as a rule, and of a mirror a thousand times as bright as the call to
# neighbours, as shares of the tolerance.
_QUADRATURE_SHARE, _NEIGHBOUR_SHARE = 0.08, 0.01
# Samples of a patch's power for each order that passes, at a tolerance of 1e-2, for the kernel's cubics between them.
_SAMPLES_PER_ORDER = 24.0
# Samples of the copies' factor for each of its lobes.
_SAMPLES_PER_LOBE = 2.0
# A wider neighbourhood is a mistake in the units or a patch much larger than the window.
_MOST_NEIGHBOURS = 40_000
_PATCH_IN_SIGMAS = 20.0
_MOST_WAVELENGTHS = 65_536
_MOST_SAMPLES = 2_000_000
# Of a source that grazes the surface: foreshortened fifty times and more.
_MOST_GRAZING = 16_384
_LESS_COHERENT = {
    "averaged": f"a smaller {ref('sigma_um')}",
    "centred": f"a smaller {ref('sigma_um')}",
    "source": f"a larger {ref('angular_diameter_deg')}",
    "replicas": f"fewer {ref('periods')}",
}
# Float32 rounds each term of a series to half a unit in the last place.
_FLOAT32_ROUNDING = 2.0**-24
# What a search makes of the cost of bounds: a fifth, or less.
_SEARCH_SAVES_FACTOR = 5.0
# A picture that is worth a table is rendered again, with another light or view.
_EXPECTED_REPEATS = 3.0
# Calls of fewer directions are computed by the bounds: to search would take longer than it saves. Of copies, for which
# it saves the most, fewer.
FEWEST_SEARCHED, _FEWEST_OF_COPIES = 32_768, 4096
# Of an explicit method that adds powers in float32.
_FEWEST_TRIED = 16
# Directions whose cost is counted where none are tried.
_DIRECTIONS_FOR_COST = 64
# A plan holds a little further than the directions that it was made for: its ranges are rounded up.
_RANGE_MARGIN = 0.03
_SEED = 0
# Directions that stand for the whole hemisphere.
_HEMISPHERE_DIRECTIONS = 8192
# A tolerance for which a plan only tells what is bright.
_COARSE_TOLERANCE = 0.5


@accepts(PlanSettings)
def plan(
    heightfield: HeightField, to_light: ArrayLike | None = None, to_view: ArrayLike | None = None, *,
    illuminant: str | Spectrum = "D65", **settings: Unpack[PlanKeywords],
) -> Plan:  # fmt: skip
    """Plan an evaluation of directions without computing it.

    Args:
        heightfield: The height field.
        to_light: Directions to the light in the local frame, shape (3,) or (n, 3); None is the whole hemisphere.
        to_view: Directions to the viewer, shape (3,) or (n, 3); None is the whole hemisphere.
        illuminant: Name in colour-science's ``SDS_ILLUMINANTS`` or ``SDS_LIGHT_SOURCES``, or a ``Spectrum``.

    Returns:
        The plan; ``print(plan)`` explains it.

    Raises:
        ToleranceError: The tolerance cannot be met, and ``strict`` is True.
    """
    request = Evaluation.of(heightfield, PlanSettings(**settings), illuminants=(illuminant,))
    with memory.as_memory_error("plan()", f"use a larger {ref('tolerance')}, or a smaller {ref('heightfield')}"):
        direction_range, sample, count = directions_of(request, to_light, to_view)
        result = plan_for(request, direction_range, sample, count)
    if result.scalar_error >= diagnostics.SCALAR_INVALID:
        warn(
            f"scalar diffraction is {diagnostics.scalar_error_text(result.scalar_error)}; {ref('heightfield')} has "
            f"a standard deviation of {heightfield.rms_um:.3g} µm and a mean slope of {heightfield.mean_slope:.3g}: "
            "use a rigorous solver, or interpret the colours only qualitatively"
        )
    return result


def directions_of(
    request: Evaluation, to_light: ArrayLike | None = None, to_view: ArrayLike | None = None
) -> tuple[DirectionRange, DirectionSample, float]:
    """The direction range of directions, some of them, and their number; None is the whole hemisphere.

    A plan for directions that are not yet known is made for many.
    """
    heightfield, coherence = request.heightfield, request.coherence
    some_lights, some_views = hemisphere_pairs(_HEMISPHERE_DIRECTIONS, _SEED)
    if to_light is not None and to_view is not None:
        lights, views, _ = validation.light_and_view(to_light, to_view)
    else:
        lights = some_lights if to_light is None else _some_of(to_light, "to_light")
        views = some_views if to_view is None else _some_of(to_view, "to_view")
    count = float(len(lights)) if to_light is not None and to_view is not None else math.inf
    scattering_vectors, illuminated = -lights - views, (lights[:, 2] > 0.0) & (views[:, 2] > 0.0)
    direction_range = DirectionRange.of(heightfield, coherence, scattering_vectors, lights, illuminated)
    if to_light is None or to_view is None:
        given = views if to_light is None else lights
        direction_range = _any_direction(
            heightfield, coherence, direction_range, None if to_light is None and to_view is None else given
        )
    gains = reflectance_factors.gain(
        lights, views, normal=request.normal_reflectance, masking=request.masking,
        per_light_cosine=coherence.kind == "source",
    )  # fmt: skip
    return direction_range, DirectionSample.among(scattering_vectors, lights, gains), count


def _some_of(directions: ArrayLike, name: str) -> NDArray[np.float64]:
    """As many of the given directions as there are for those that are not given, repeated where they are fewer."""
    given, _ = validation.directions(directions, name)
    if not len(given):
        return np.zeros((_HEMISPHERE_DIRECTIONS, 3))
    some = given[stratified(len(given), _HEMISPHERE_DIRECTIONS)]
    return np.asarray(some[np.arange(_HEMISPHERE_DIRECTIONS) % len(some)])


def _any_direction(
    heightfield: HeightField, coherence: Coherence, direction_range: DirectionRange, given: NDArray[np.float64] | None
) -> DirectionRange:
    """Return the range of the whole hemisphere on one side and of the given directions, or all, on the other."""
    max_uv = min_w = max_w = 0.0
    if given is None:
        max_uv, min_w, max_w = 2.0, 0.0, 2.0
    elif np.any(above := given[:, 2] > 0.0):
        z = given[above, 2]
        max_uv = 1.0 + float(np.max(np.hypot(given[above, 0], given[above, 1])))
        min_w, max_w = float(z.min()), 1.0 + float(z.max())
    # A grazing source has no largest bandwidth: what exceeds the sample's takes the largest set of wavelengths.
    most = {"source": max(direction_range.max_order_rate, max_uv), "replicas": max_uv * max(heightfield.size_um)}
    return DirectionRange(min(max_uv, 2.0), most.get(coherence.kind, min(max_uv, 2.0)), min_w, max_w)


def _expansion(request: Evaluation) -> tuple[str, str]:
    """Return method and integration; an explicit integration without a method is for the automatic expansion."""
    chosen = request.method == "auto" and request.integration != "auto"
    return (AUTOMATIC if chosen else request.method), request.integration


@single_threaded_blas()
def plan_for(request: Evaluation, direction_range: DirectionRange, sample: DirectionSample, count: float) -> Plan:
    """Return the plan for all directions of a range, searched for on a sample of them.

    There are ``count`` directions, or fewer where pixels show means. A table requires time to make: it is for many
    directions, and for footprints where powers add. A spectrum has no integral over λ, and only its wavelengths count.
    """
    heightfield, tolerance, coherence = request.heightfield, request.tolerance, request.coherence
    method, integration = _expansion(request)
    if not request.integrates and integration == "table":
        raise ArgumentValueError(
            f"{ref('integration')} must not be 'table' for a spectrum, which is not integrated over λ"
        )
    check_cycles(heightfield, direction_range.kappas[1])
    pitch = diagnostics.coarsest_pitch_um(heightfield)
    colour = request.integrates
    upper_bound_plan = _upper_bound_plan(
        heightfield, direction_range, tolerance=tolerance, method=method, coherence=coherence, colour=colour
    )
    between = coherence.centre_um is not None and method != "direct"
    _warn_of_aliasing(direction_range, pitch, coefficient_table.radius(upper_bound_plan) if between else 0.0)
    if method == "direct":
        return upper_bound_plan
    blurs = request.footprint and coherence.adds_powers and method == "auto"
    if request.footprint and not blurs:
        count *= refinement_levels.rays_at(refinement_levels.LEAST_LEVEL_OF_POINTS)
    affordable = math.inf if integration == "table" or blurs else 0.0
    if method == "auto" and colour and not affordable:
        affordable = affordable_table_cost(heightfield, upper_bound_plan, count)
    # Bounds that were cut short, for a source at the horizon, are none, and may miss what light there is.
    is_truncated = upper_bound_plan.max_order_rate < direction_range.max_order_rate
    # Powers of coefficients that vanish with κ cancel in float32, which only a trial tells.
    cancels = method != "auto" and holds_powers(upper_bound_plan.method, adds_powers=coherence.adds_powers)
    fewest = _FEWEST_TRIED if cancels else _fewest_searched(coherence)
    is_searched = len(sample) > 0 and (affordable > 0.0 or is_truncated or count >= fewest)
    if method == "auto" and not is_searched:
        # Amplitudes take no longer.
        upper_bound_plan = _upper_bound_plan(
            heightfield, direction_range, tolerance=tolerance, method=trial.REFERENCE_METHOD, coherence=coherence,
            colour=colour,
        )  # fmt: skip
    if not is_searched and coherence.adds_powers:
        upper_bound_plan = replace(upper_bound_plan, least_weight=tolerance * _DARKEST)
    found = upper_bound_plan
    if upper_bound_plan.method not in EXPANSIONS:
        basis, _, _ = coefficient_table.coefficients_for(
            heightfield, upper_bound_plan.method, coherence, direction_range,
            coefficient_table.neighbour_extent(upper_bound_plan, heightfield), terms=upper_bound_plan.terms,
            threads=request.threads,
        )  # fmt: skip
        terms = basis.terms_within(_BASIS_SHARE * tolerance)
        found = replace(upper_bound_plan, terms=terms, truncation=float(basis.truncation_errors[terms]))
    found = replace(
        found,
        aliasing=diagnostics.folded_power(heightfield, direction_range.max_uv * 1e3 / direction_range.lambda_min_nm),
    )
    if is_searched:
        found = search_plan(
            found, request, direction_range, sample, footprint=blurs, affordable=affordable, is_truncated=is_truncated
        )
    else:
        found = _with_cost(found, heightfield, sample)
    if upper_bound_plan.truncation > tolerance * _AMPLITUDE_MARGIN:
        # The series that all bases are made from, and judged by, ends too soon.
        found = replace(
            found, terms=upper_bound_plan.terms, truncation=max(found.truncation, upper_bound_plan.truncation)
        )
    _check_error(heightfield, found, strict=request.strict)
    return replace(found, footprint=request.footprint)


def search_plan(
    plan: Plan, request: Evaluation, direction_range: DirectionRange, sample: DirectionSample, *, footprint: bool,
    affordable: float, is_truncated: bool,
) -> Plan:  # fmt: skip
    """The plan that a search finds from that of bounds, which is left where all is dark.

    A table may take ``affordable`` multiply-adds to make; 0 is none.
    """
    heightfield, tolerance, colour = request.heightfield, plan.tolerance, request.integrates
    method, integration = _expansion(request)
    coarse = _upper_bound_plan(
        heightfield, direction_range, tolerance=_COARSE_TOLERANCE, method=method, coherence=plan.coherence,
        colour=colour,
    )  # fmt: skip
    # Half the wavelengths of bounds, which are ample, tell as well what is bright.
    coarse = replace(coarse, wavelengths=math.ceil(coarse.wavelengths / 2.0))
    coarse = replace(coarse, terms=min(coarse.terms, coefficient_table.LANES)) if method not in EXPANSIONS else coarse
    tried = trial.Trial(plan, request, direction_range, sample, coarse=coarse)
    if not tried.any_light and not is_truncated:
        return plan
    explicit = integration == "table"
    best = None
    if affordable:
        best = plan_search.search_table(plan, tried, footprint=footprint, needed=explicit, affordable=affordable)
    if best is None and explicit:
        raise ToleranceError(
            f"{ref('integration', 'table')} requires more than {polar_grid.MOST_MEGABYTES:g} MB for "
            f"{ref('tolerance', tolerance)}: use {ref('method', 'auto')}, or a larger {ref('tolerance')}"
        )
    # Points in place of means err by more than a table that keeps the tolerance without any safety.
    most = tolerance * (plan_search.SEARCH_SAFETY if footprint else 1.0)
    if best is None or (best.error > most and not explicit):
        best = plan_search.search_sampled(plan, tried, automatic=method == "auto")
    return best


def _with_cost(plan: Plan, heightfield: HeightField, sample: DirectionSample) -> Plan:
    """The plan with the mean cost of some directions, where there are any."""
    if not len(sample):
        return plan
    places = stratified(len(sample), _DIRECTIONS_FOR_COST)
    scattering_vectors, to_lights = sample.scattering_vectors[places], sample.to_lights[places]
    reaches = order_rate(heightfield, plan.coherence, scattering_vectors, to_lights)
    return replace(
        plan,
        multiply_adds=cost_model.sampling_multiply_adds(heightfield, plan, reaches, np.abs(scattering_vectors[:, 2])),
    )


def _fewest_searched(coherence: Coherence) -> int:
    """From how many directions on a search pays."""
    return _FEWEST_OF_COPIES if coherence.kind == "replicas" else FEWEST_SEARCHED


def affordable_table_cost(heightfield: HeightField, plan: Plan, count: float) -> float:
    """Multiply-adds that a table saves so many directions of a plan by bounds; 0 where none takes less to make."""
    table_size = polar_grid.smallest_sufficient_size(plan)
    if table_size is None or not has_table(plan.method, plan.coherence):
        return 0.0
    smallest = replace(plan, rings_per_octave=table_size[0], azimuths_per_width=table_size[1])
    saved = _EXPECTED_REPEATS * count * plan.multiply_adds / _SEARCH_SAVES_FACTOR
    return saved if saved > cost_model.table_multiply_adds(heightfield, smallest) else 0.0


def _upper_bound_plan(
    heightfield: HeightField, direction_range: DirectionRange, *, tolerance: float, method: str, coherence: Coherence,
    colour: bool,
) -> Plan:  # fmt: skip
    """The plan that follows from bounds alone."""
    series = AUTOMATIC if method in ("auto", "direct") else method
    # A fitted basis is made from the Jacobi-Anger series.
    expansion = EXPANSIONS.get(series, EXPANSIONS["jacobi-anger"])
    argument = 2.0 * math.pi * direction_range.kappas[1] * expansion.offset_and_scale(heightfield)[1]
    terms = expansion.term_count(argument, tolerance * _AMPLITUDE_MARGIN)
    least_weight = tolerance * _WEIGHT_MARGINS[coherence.adds_powers]
    result = Plan(
        method="direct" if method == "direct" else series, coherence=coherence, tolerance=tolerance, terms=terms,
        least_weight=least_weight, wavelengths=0, subdivisions=1,
        bandwidth_um=_bandwidth_um(heightfield, coherence, tolerance), adaptive=True, rings_per_octave=0,
        azimuths_per_width=0.0, w_basis_size=0, footprint=False, energy_spread=0.0,
        max_uv=direction_range.max_uv, max_order_rate=direction_range.max_order_rate, min_w=direction_range.min_w,
        max_w=direction_range.max_w, lambda_min_nm=direction_range.lambda_min_nm,
        lambda_max_nm=direction_range.lambda_max_nm, height_range_um=heightfield.height_range_um,
        truncation=expansion.remainder(argument, terms),
        neighbourhood=0.0 if coherence.kind == "replicas" else _NEIGHBOUR_SHARE * tolerance,
        quadrature=_QUADRATURE_SHARE * tolerance if colour else 0.0,
        rounding=_FLOAT32_ROUNDING * expansion.growth(argument), aliasing=0.0,
        scalar_error=diagnostics.scalar_error_bound(heightfield.rms_um, heightfield.mean_slope), multiply_adds=0.0,
        is_measured=False, validation_size=0, table_multiply_adds=0.0,
    )  # fmt: skip
    if method != "direct":
        _check_neighbours(heightfield, result)
    if colour:
        result = _with_wavelengths(heightfield, result)
    dearest = cost_model.sampling_multiply_adds(
        heightfield, result, np.array([direction_range.max_order_rate]), np.array([direction_range.max_w])
    )
    return replace(result, multiply_adds=dearest)


def _bandwidth_um(heightfield: HeightField, coherence: Coherence, tolerance: float) -> tuple[float, float, float]:
    """Samples per unit of 1/λ that a direction takes, as a, b, c [µm] of a·lateral + b·|w| + c.

    Products of two points of the surface oscillate as w(h − h') + (u, v)·(x − x'), exp(−|x − x'|²/4σ²) weighs their
    distance, so that orders pass as Gaussians, and the colour curves add a constant.
    """
    if coherence.kind == "replicas":
        # |mean over the patch|² has orders between −|u|Lx − |v|Ly and the same above, in samples of cubics.
        cubic = (1e-2 / tolerance) ** 0.25
        per_order = _SAMPLES_PER_ORDER * cubic
        return per_order, per_order * heightfield.height_range_um, _COLOUR_BANDWIDTH_UM * cubic
    quintic = (1e-2 / tolerance) ** (1.0 / 6.0)
    per_deviation, cycles = quintic * _SAMPLES_PER_DEVIATION, quintic * _SAMPLES_PER_CYCLE
    if coherence.sigma_um is not None:
        order_rate = per_deviation * math.sqrt(8.0) * math.pi * coherence.sigma_um
        return order_rate, cycles * heightfield.height_range_um, _COLOUR_BANDWIDTH_UM
    # Equal ratios from 380 to 780 nm are, at 380 nm, further apart than equal steps by this factor. The window of
    # van Cittert and Zernike is in proportion to λ, as they are.
    log_band = math.log(LAMBDA_MAX_NM / LAMBDA_MIN_NM)
    wider = log_band * 1e3 / LAMBDA_MIN_NM / cost_model.SPAN
    order_rate = per_deviation / coherence.spread * log_band / cost_model.SPAN
    return order_rate, wider * cycles * heightfield.height_range_um, wider * _COLOUR_BANDWIDTH_UM


def _check_neighbours(heightfield: HeightField, plan: Plan) -> None:
    """Refuse a neighbourhood that no one means."""
    rows, columns = (2 * n + 1 for n in coefficient_table.neighbour_extent(plan, heightfield))
    if plan.coherence.kind == "replicas" or rows * columns <= _MOST_NEIGHBOURS:
        return
    if plan.coherence.sigma_um is None:
        what = f"{ref('angular_diameter_deg', plan.coherence.angular_diameter_deg)} is too wide"
        sigma = LAMBDA_MAX_NM * 1e-3 / (2.0 * math.sqrt(2.0) * math.pi * plan.coherence.spread)
    else:
        what, sigma = f"{ref('sigma_um', plan.coherence.sigma_um)} is too short", plan.coherence.sigma_um
    raise ArgumentValueError(
        f"{what} for a patch of {heightfield.size_um[0]:g} × {heightfield.size_um[1]:g} µm, as it covers {rows} × "
        f"{columns} coefficients: crop the height field to about {_PATCH_IN_SIGMAS * sigma:.3g} µm, which looks the "
        "same under this coherence"
    )


def _with_wavelengths(heightfield: HeightField, plan: Plan) -> Plan:
    """The plan with as many wavelengths as its bandwidth asks for."""
    count = coefficient_table.wavelength_set_size(cost_model.wavelength_count(plan, plan.max_order_rate, plan.max_w))
    periods = plan.coherence.periods
    divisions = 1
    if periods is not None:
        divisions = math.ceil(_SAMPLES_PER_LOBE * math.sqrt(2.0) * max(periods) / plan.bandwidth_um[0])
    what = {
        "source": ref("angular_diameter_deg", plan.coherence.angular_diameter_deg),
        "replicas": f"{ref('periods', periods)} of {heightfield.size_um[0]:g} × {heightfield.size_um[1]:g} µm",
    }.get(plan.coherence.kind, ref("sigma_um", plan.coherence.sigma_um))
    facing = cost_model.wavelength_count(plan, plan.max_uv, plan.max_w)
    if plan.coherence.kind == "source" and facing <= _MOST_GRAZING < count:
        # Near the horizon a source is foreshortened without end; such directions take the largest set there is.
        count = coefficient_table.wavelength_set_size(_MOST_GRAZING)
        per_lateral, per_w, constant = plan.bandwidth_um
        order_rate = (count / cost_model.SPAN - per_w * plan.max_w - constant) / per_lateral
        plan = replace(plan, max_order_rate=max(order_rate, plan.max_uv))
    if count > _MOST_WAVELENGTHS or count * divisions > _MOST_SAMPLES:
        raise ToleranceError(
            f"{what} and a height range of {heightfield.height_range_um:.3g} µm make spectra so fine that a colour "
            f"requires {count * divisions} wavelengths; at most {_MOST_WAVELENGTHS} are supported, {_MOST_SAMPLES} for "
            f"replicas: use {_LESS_COHERENT[plan.coherence.kind]}, a larger {ref('tolerance')}, or "
            "warpdiff.spectral_reflectance"
        )
    return replace(plan, wavelengths=count, subdivisions=divisions)


def warn_outside(plan: Plan, heightfield: HeightField, direction_range: DirectionRange) -> None:
    """Warn where a call with an explicit plan goes beyond what the plan's numbers hold for."""
    beyond = [
        f"{name} {value:.3g}, planned {planned:.3g}"
        for name, value, planned in (
            ("|(u, v)| up to", direction_range.max_uv, plan.max_uv),
            ("|w| up to", direction_range.max_w, plan.max_w),
            ("1/λ [1/µm] up to", 1e3 / direction_range.lambda_min_nm, 1e3 / plan.lambda_min_nm),
            ("a height range [µm] of", heightfield.height_range_um, plan.height_range_um),
        )
        if value > planned * (1.0 + _RANGE_MARGIN) + 1e-9
    ]
    if beyond and plan.method != "direct":
        warn(
            f"{ref('plan')} is used beyond its valid range: {'; '.join(beyond)}; results may be wrong: make a plan for "
            "these directions and this height field with warpdiff.plan()"
        )


def _check_error(heightfield: HeightField, plan: Plan, *, strict: bool) -> None:
    """Refuse, or warn of, a plan that cannot reach its tolerance."""
    # Errors as measured; the safety in them is no reason to refuse.
    if plan.error <= plan.tolerance * (plan_search.SEARCH_SAFETY if plan.is_measured else 1.0):
        return
    fewer = f"reduce the height range with {ref('levelled()')}, {ref('despiked()')} or {ref('cropped()')}"
    lower = f"{fewer}, or use {ref('method', 'auto')} or {ref('method', 'direct')}"
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
    if strict:
        raise ToleranceError(f"{message}; {ref('strict', False)} computes it anyway")
    warn(message)


def _warn_of_aliasing(direction_range: DirectionRange, pitch_um: float, radius: float) -> None:
    """Warn where the directions ask for frequencies beyond what the pitch can carry.

    Neighbours beyond it repeat those within, but for the phase of a window that lies between samples: their radius
    [1/µm] must be within as well.
    """
    if pitch_um == 0.0:
        return
    supported = max(0.0, direction_range.lambda_min_nm * 1e-3 * (1.0 / (2.0 * pitch_um) - radius))
    if direction_range.max_uv > supported * (1.0 + 1e-9):
        warn(
            f"a pitch of {pitch_um:.3g} µm supports |(u, v)| up to {supported:.3g} at "
            f"{direction_range.lambda_min_nm:g} nm, but directions reach {direction_range.max_uv:.3g}: higher orders "
            "alias onto lower ones; scan at a finer pitch, or use HeightField.resampled() if the surface is smooth"
        )
