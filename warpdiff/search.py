"""The cheapest numbers that keep a tolerance, found by trying them on a sample of a call's directions.

Bounds hold for the worst surface and the worst direction, and ask for ten to a hundred times the work that a scene
needs. A hundred of its own directions, computed a few dozen times over, tell how much that is: less than a hundredth of
a picture's time. Each source of error is measured by itself against what the bounds ask for, twice as fine, and the
plan that results once more as a whole.
"""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from warpdiff import coefficients, colour_table, polar, tables
from warpdiff.coefficients import holds_powers
from warpdiff.device import load
from warpdiff.expansions import EXPANSIONS
from warpdiff.integration import Integrator
from warpdiff.launches import launch
from warpdiff.scope import Scope, lateral
from warpdiff.spectrum import LAMBDA_MAX_NM, LAMBDA_MIN_NM

if TYPE_CHECKING:
    from collections.abc import Iterator

    import warp as wp
    from numpy.typing import NDArray

    from warpdiff.coherence import Coherence
    from warpdiff.heightfield import HeightField
    from warpdiff.plans import Plan
    from warpdiff.scope import Pilots

_SPAN = 1e3 / LAMBDA_MIN_NM - 1e3 / LAMBDA_MAX_NM
# The sample stands for the call, whose error may be this much larger.
SAFETY = 1.6
# Light that is this weak against a mirror's is darkness, whatever else a call sees.
DARK = 1e-10
# Shares of what is left of the tolerance.
_NEIGHBOUR_SHARE, _TERMS_SHARE, _QUADRATURE_SHARE = 0.25, 0.3, 0.45
# The exponent of the least weight is tried in these steps, and is at least one of them.
_EXPONENT_STEP = 0.5
# Factors on the parts of the bandwidth, as powers of two.
_LATERAL_STEPS = np.arange(1.0, -4.01, -0.25)
_HEIGHT_STEPS = np.arange(0.0, -3.01, -1.0)
_COLOUR_STEPS = np.arange(2.5, -4.01, -0.5)
_TRIES = 6
# A table is made for each try: of those that are expected to err by about the target, the next larger one.
_LIKELY = 0.85
_WIDENINGS = 3
# Functions of w that tables have at these tolerances, of most surfaces. Kernels of more terms take long to compile.
_LIKELY_FUNCTIONS, _AT_TOLERANCES, _MOST_GUESSED = 8, (3e-3, 2e-2), 32
# Its amplitudes lose nothing in float32, however dim a coefficient is where κ is small.
_TRUTH = "jacobi-anger"
# A set's errors scatter: a whole plan may exceed its share by this factor, which the safety covers.
_SLACK = 1.2
_SUBDIVISION_SHARE = 0.3
# Error of a fitted basis in float32, measured against the direct sum.
_ROUNDING_OF_POWERS, _ROUNDING_OF_AMPLITUDES = 3e-6, 5e-6
# Sets of wavelengths that err by so many tolerances in the median end the search for smaller ones.
_HOPELESS = 10.0
_SPECTRAL_SAMPLES = 64
# Pilots are few and dear: a launch is cut into slices that keep every thread busy.
_SLICE = 8
# What a wavelength costs besides its multiply-adds, in as many of them: by itself, for each term of the basis, for each
# neighbour, and for the copies' factor. Fitted to times on two cores, of which they explain all but a factor of 1.5.
_A_WAVELENGTH, _A_TERM, _A_NEIGHBOUR, _A_FACTOR = 340.0, 16.0, 20.0, 280.0


def begin_to_load(
    hf: HeightField,
    method: str,
    coherence: Coherence,
    max_w: float,
    *,
    footprint: bool,
    tolerance: float,
    device: wp.Device,
) -> None:
    """Begin to load what a search for a fitted basis is likely to take, before its directions are known.

    A wrong guess is compiled in vain, a second of one thread, once; what is needed in its place comes that much later.

    Args:
        hf: The height field.
        method: That of plans.
        coherence: The window, source or copies.
        max_w: An estimate of the largest |w|.
        footprint: Whether pixels show means, which takes a table.
        tolerance: Of the plan.
        device: Where.
    """
    terms = coefficients.series_terms(hf, Scope(0.0, 0.0, 0.0, max_w).kappas)
    if terms > _MOST_GUESSED:
        return
    needed = [each.integrate for each in _kernels(terms, method, tables.LANES, coherence)]
    if footprint and coherence.kind == "averaged" and _AT_TOLERANCES[0] <= tolerance <= _AT_TOLERANCES[1]:
        # It takes the longest; the table's others are asked for behind those that come first.
        needed.append(colour_table.kernel_of_look_ups(_LIKELY_FUNCTIONS, coherence))
    load(needed, device)


def _kernels(series_terms: int, method: str, terms: int, coherence: Coherence) -> list[Any]:
    """The kernels of the truth and of a plan."""
    return [tables.kernels_for(_TRUTH, coherence, series_terms), tables.kernels_for(method, coherence, terms)]


def wavelength_count(plan: Plan, lateral_reach: float, w: float) -> float:
    """How many wavelengths a direction takes."""
    per_lateral, per_w, constant = plan.bandwidth_um
    return _SPAN * (per_lateral * lateral_reach + per_w * w + constant) + 1.0


def refined(plan: Plan, trial: Trial, *, automatic: bool) -> Plan:
    """The cheapest plan found that keeps the tolerance on the pilots, its errors as measured.

    Args:
        plan: The plan from bounds.
        trial: Some of the call's directions.
        automatic: Whether the method may change.
    """
    target = plan.tolerance / SAFETY
    plan = dataclasses.replace(plan, least_weight=trial.finest.least_weight)
    fewer, truncation, rounding = _fewer_terms(plan, trial, _TERMS_SHARE * target)
    if rounding > target and automatic:
        # Powers of coefficients that vanish with a high power of κ cancel in float32; amplitudes do not.
        plan = dataclasses.replace(plan, method=trial.finest.method, terms=trial.finest.terms)
        fewer, truncation, rounding = _fewer_terms(plan, trial, _TERMS_SHARE * target)
    plan, neighbourhood = _fewer_neighbours(fewer, trial, _NEIGHBOUR_SHARE * target)
    quadrature = 0.0
    if trial.integrates:
        plan, quadrature = _fewer_wavelengths(plan, trial, _QUADRATURE_SHARE * target)
    grown, whole = _enough_of_all(plan, trial, target)
    if grown is not plan:
        # Both were measured before there was more of either.
        plan, neighbourhood, quadrature = grown, min(neighbourhood, whole), min(quadrature, whole)
    # Directions that err by one source and by another add up to more of them: the whole is what counts.
    rest = max(0.0, SAFETY * whole - SAFETY * (truncation + neighbourhood + quadrature) - rounding)
    return dataclasses.replace(
        plan,
        truncation=SAFETY * truncation,
        neighbourhood=SAFETY * neighbourhood + rest / 2.0,
        quadrature=SAFETY * quadrature + rest / 2.0,
        rounding=rounding,
        multiply_adds=mean_cost(trial.hf, plan, trial.lateral, trial.w),
        searched=True,
    )


def tabled(plan: Plan, trial: Trial, *, footprint: bool) -> Plan | None:
    """The smallest polar table that keeps the tolerance on the pilots, or the best of those within reach.

    A table is made for each attempt and found again by the call that follows, which adds the levels for footprints.
    None where all are too large.
    """
    target = plan.tolerance / SAFETY
    exact = trial.run(dataclasses.replace(plan, method=trial.finest.method, terms=trial.finest.terms))
    plan, truncation = _likely_terms(plan, trial, _TERMS_SHARE * target, exact)
    rounding = _rounding(plan)
    few = polar.stand_apart(trial.hf, plan.coherence)
    sizes = polar.rungs(plan.coherence)
    likely = [rung for rung in sizes if polar.expected_error(rung[0], few=few) <= _LIKELY * target]
    rungs = likely or [sizes[-1]]
    best = None
    while rungs:
        nodes, rays_per_width = rungs.pop(0)
        tried = dataclasses.replace(plan, nodes=nodes, rays_per_width=rays_per_width)
        if polar.megabytes(tried) > polar.MOST_MEGABYTES:
            break
        trial.begin_to_load(dataclasses.replace(tried, footprint=footprint))
        # Where bounds were cut short for a source at the horizon, the table is right and the truth is not.
        error = trial.error(trial.run(tried), trial.exact, resolved=trial.lateral <= plan.max_lateral)
        best = dataclasses.replace(
            tried,
            footprint=footprint,
            truncation=SAFETY * truncation,
            neighbourhood=0.0,
            quadrature=max(0.0, SAFETY * (error - truncation) - rounding),
            rounding=rounding,
            multiply_adds=polar.multiply_adds(tried),
            searched=True,
        )
        if error <= target:
            break
        # The next one is the smallest that may do by what this one errs.
        needed = _LIKELY * polar.expected_error(nodes) * target / error
        rungs = [rung for rung in rungs if polar.expected_error(rung[0]) <= needed]
    return best


def _likely_terms(plan: Plan, trial: Trial, share: float, exact: NDArray[np.float64]) -> tuple[Plan, float]:
    """The fewest terms within their share and what they leave out, by one try and the residuals of the fitted basis.

    More terms are another kernel, which a table does not need.
    """
    if plan.method in EXPANSIONS:
        return _fewest_terms(plan, trial, share, exact)
    left_out = trial.fitted(plan).left_out
    most = len(left_out) - 1
    if most <= tables.LANES:
        return dataclasses.replace(plan, terms=most), 0.0
    tried = dataclasses.replace(plan, terms=tables.LANES)
    error = trial.error(trial.run(tried), exact)
    for terms in range(tables.LANES, most):
        expected = error * float(left_out[terms] / left_out[tables.LANES])
        if expected <= share:
            return dataclasses.replace(plan, terms=terms), expected
    return dataclasses.replace(plan, terms=most), 0.0


def _enough_of_all(plan: Plan, trial: Trial, target: float) -> tuple[Plan, float]:
    """The plan with so much more of everything that it keeps the target as a whole, and its error."""
    best, least = plan, trial.error(trial.run(plan), trial.exact)
    for _ in range(_TRIES):
        if least <= target:
            break
        a, b, c = (math.sqrt(2.0) * part for part in plan.bandwidth_um)
        plan = dataclasses.replace(plan, least_weight=plan.least_weight * math.exp(-2.0 * _EXPONENT_STEP))
        if plan.wavelengths:
            more = tables.set_size(math.sqrt(2.0) * plan.wavelengths)
            plan = dataclasses.replace(plan, bandwidth_um=(a, b, c), wavelengths=more)
        error = trial.error(trial.run(plan), trial.exact)
        if error < least:
            best, least = plan, error
    return best, least


class Trial:
    """Some directions of a call on a device, and what the finest plan makes of them.

    Args of its constructor: the plan from bounds, the height field, the range of the call, some of its directions, its
    illuminants, of which the worst counts, given wavelengths in place of an integral, and where to try.
    """

    def __init__(
        self,
        plan: Plan,
        hf: HeightField,
        scope: Scope,
        pilots: Pilots,
        illuminants: tuple[str, ...],
        wavelengths_nm: NDArray[np.float64] | None,
        *,
        device: wp.Device,
        threads: int,
    ) -> None:
        import warp as wp

        self.hf, self._scope, self._device, self._threads = hf, scope, device, threads
        self._illuminants = illuminants
        self._wavenumbers = None
        self.integrates = wavelengths_nm is None
        if wavelengths_nm is not None:
            some = np.linspace(0, len(wavelengths_nm) - 1, min(_SPECTRAL_SAMPLES, len(wavelengths_nm))).astype(int)
            self._wavenumbers = wp.array(1e3 / wavelengths_nm[some], dtype=wp.float64, device=device)
        self._crowd, pilots = pilots, pilots.fewer()
        self._pilots = pilots
        self.lateral = lateral(hf, plan.coherence, pilots.deflections, pilots.to_lights)
        self.w = np.abs(pilots.deflections[:, 2])
        low, high = scope.kappas
        terms = coefficients.series_terms(hf, (low, high))
        self.finest = dataclasses.replace(plan, method=_TRUTH, terms=terms, adaptive=False)
        kernels = _kernels(terms, plan.method, min(plan.terms, tables.LANES), plan.coherence)
        load([each.integrate if self.integrates else each.sample for each in kernels], device)
        self.sharpen(plan)

    def sharpen(self, plan: Plan) -> None:
        """Judge by twice the wavelengths of a plan."""
        # How bright the call is, from more directions and fewer wavelengths.
        self._load(self._crowd)
        coarse = self.finest
        if self.integrates:
            coarse = dataclasses.replace(coarse, wavelengths=plan.wavelengths // 2 + 1)
        brightness = np.percentile(_luminance(self.run(coarse)), 99.0, axis=1, keepdims=True)
        floor = np.maximum(1e-3 * brightness, DARK)
        if plan.coherence.adds_powers:
            # The mirror's coefficient, of power 1, must not show in what is far darker.
            gain = float(np.percentile(self._crowd.gains, 99.0))
            needed = _NEIGHBOUR_SHARE * plan.tolerance * float(floor.min()) / gain
            self.finest = dataclasses.replace(self.finest, least_weight=min(self.finest.least_weight, needed))
        self._load(self._pilots)
        if self.integrates:
            self.finest = dataclasses.replace(self.finest, wavelengths=2 * plan.wavelengths - 1)
        self.exact = self.run(self.finest)
        # The error of a picture, as the README defines it; a spectrum's points are its pixels.
        luminance, size = _luminance(self.exact), np.linalg.norm(self.exact, axis=2)
        self._above = luminance >= floor
        self._scale = np.where(self._above, np.maximum(size, floor), floor)
        self.any_light = bool(np.any(self.exact > DARK))

    def _load(self, pilots: Pilots) -> None:
        """Bring directions to the device."""
        import warp as wp

        self._count = len(pilots)
        self._deflections = wp.array(pilots.deflections, dtype=wp.vec3d, device=self._device)
        self._to_lights = wp.array(pilots.to_lights.astype(np.float32), dtype=wp.vec3f, device=self._device)
        self._gains = wp.array(pilots.gains.astype(np.float32), dtype=wp.float32, device=self._device)

    def run(self, plan: Plan) -> NDArray[np.float64]:
        """What a plan makes of the pilots: XYZ, shape (illuminants, n, 3), or ρ, shape (1, n·m, 1)."""
        import warp as wp

        if self._wavenumbers is not None:
            table = tables.table_for(self.hf, plan, self._scope, device=self._device, threads=self._threads)
            inputs = [table.arguments, self._deflections, self._to_lights, self._gains, self._wavenumbers]
            values = wp.empty((self._count, len(self._wavenumbers)), dtype=wp.float32, device=self._device)
            launch(
                table.sample, self._count, inputs, [values], device=self._device, threads=self._threads,
                slice_size=_SLICE,
            )  # fmt: skip
            return np.asarray(values.numpy(), dtype=np.float64).reshape(1, -1, 1)
        integrator = Integrator(self.hf, plan, self._scope, device=self._device, threads=self._threads)
        results = []
        for illuminant in self._illuminants:
            xyz = wp.zeros(self._count, dtype=wp.vec3f, device=self._device)
            integrator.add(self._deflections, self._to_lights, self._gains, illuminant, xyz, slice_size=_SLICE)
            results.append(xyz.numpy())
        return np.asarray(results, dtype=np.float64)

    def begin_to_load(self, plan: Plan) -> None:
        """Begin to load what a plan's table takes."""
        colour_table.begin_to_load(
            self.hf, plan, self._scope, self._illuminants[0], device=self._device, threads=self._threads
        )

    def fitted(self, plan: Plan) -> coefficients.Coefficients:
        """The coefficients of a plan with a fitted basis."""
        found, _, _ = tables.coefficients_for(
            self.hf, plan.method, plan.coherence, self._scope, tables.reach(plan, self.hf), terms=plan.terms,
            threads=self._threads,
        )  # fmt: skip
        return found

    def errors(self, values: NDArray[np.float64], against: NDArray[np.float64]) -> NDArray[np.float64]:
        """The error of each pilot, shape (illuminants, n)."""
        return np.asarray(np.linalg.norm(values - against, axis=2) / self._scale)

    def error(
        self, values: NDArray[np.float64], against: NDArray[np.float64], *, resolved: NDArray[np.bool_] | None = None
    ) -> float:
        """Percentile 99 of the errors, of bright pilots or of dim ones, whichever is larger; of some, if any are."""
        some = slice(None) if resolved is None or not resolved.any() else resolved
        return float(self.worst(self.errors(values, against)[:, some], self._above[:, some]))

    def worst(self, errors: NDArray[np.float64], above: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
        """The same of errors (..., illuminants, n), shape (...), of which some are of bright pilots."""
        bright = self._above if above is None else above
        groups = [
            np.percentile(errors[..., index, mask], 99.0, axis=-1)
            for index in range(errors.shape[-2])
            for mask in (bright[index], ~bright[index])
            if mask.any()
        ]
        return np.asarray(np.max(groups, axis=0))


def _luminance(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Y of XYZ (..., 3), or ρ of (..., 1)."""
    return np.asarray(values[..., 1 if values.shape[-1] == 3 else 0])


def mean_cost(hf: HeightField, plan: Plan, lateral_reaches: NDArray[np.float64], w: NDArray[np.float64]) -> float:
    """Predicted multiply-adds of a direction, in the mean over directions of some lateral and |w|."""
    from warpdiff.kernels import spectral

    lanes = tables.lanes_of(plan.terms)
    parts = 1 if holds_powers(plan.method, adds_powers=plan.coherence.adds_powers) else 2
    samples: NDArray[np.float64] = np.full(len(w), max(plan.wavelengths, 1.0))
    if plan.adaptive and plan.wavelengths:
        needed = [
            wavelength_count(plan, float(reach), float(each)) for reach, each in zip(lateral_reaches, w, strict=True)
        ]
        samples = np.minimum(samples, np.asarray(needed) * 2.0 ** (0.5 / 4.0))
    if plan.coherence.kind == "replicas":
        neighbours: float = spectral.TAPS**2 if hf.shape[0] > 1 else spectral.TAPS
    else:
        radius = math.sqrt(-math.log(plan.least_weight) / tables.falloff_um2(plan.coherence, 0.5))
        widths = [2.0 * radius * length if n > 1 else 1.0 for n, length in zip(hf.shape, hf.size_um, strict=True)]
        neighbours = math.prod(widths)
    each = _A_WAVELENGTH + _A_TERM * lanes * min(1.0, neighbours) + neighbours * (_A_NEIGHBOUR + parts * lanes)
    if plan.coherence.kind == "replicas":
        each += _A_FACTOR * plan.subdivisions
    return float(np.mean(samples) * each)


def _fewer_neighbours(plan: Plan, trial: Trial, share: float) -> tuple[Plan, float]:
    """The least exponent whose neighbourhood is within its share, by bisection, and the error that it leaves."""
    if plan.coherence.kind == "replicas":
        return plan, 0.0
    whole = trial.run(plan)

    def attempt(steps: int) -> tuple[Plan, float]:
        tried = dataclasses.replace(plan, least_weight=math.exp(-steps * _EXPONENT_STEP))
        return tried, trial.error(trial.run(tried), whole)

    most = math.floor(-math.log(plan.least_weight) / _EXPONENT_STEP)
    best, error = plan, 0.0
    low, high = 0, most
    while high - low > 1:
        middle = (low + high) // 2
        tried, left_out = attempt(middle)
        if left_out <= share:
            high, best, error = middle, tried, left_out
        else:
            low = middle
    return best, error


def _fewer_terms(plan: Plan, trial: Trial, share: float) -> tuple[Plan, float, float]:
    """The fewest terms within their share, in whole SIMD registers; what they leave out, and float32's error."""
    exact = trial.run(dataclasses.replace(plan, method=trial.finest.method, terms=trial.finest.terms))
    found, truncation = _fewest_terms(plan, trial, share, exact)
    rounding = _rounding(plan)
    if not truncation:
        # As many terms as there are leave out nothing that shows: the rest is float32's.
        rounding = max(rounding, trial.error(trial.run(found), exact))
    return found, truncation, rounding


def _rounding(plan: Plan) -> float:
    """Error of a basis in float32 as a rule."""
    return _ROUNDING_OF_POWERS if plan.coherence.adds_powers else _ROUNDING_OF_AMPLITUDES


def _fewest_terms(plan: Plan, trial: Trial, share: float, exact: NDArray[np.float64]) -> tuple[Plan, float]:
    """The fewest terms within their share, in whole SIMD registers, and what they leave out: all that there are, 0."""
    most = plan.terms if plan.method in EXPANSIONS else trial.fitted(plan).terms
    for registers in range(1, math.ceil(most / tables.LANES)):
        tried = dataclasses.replace(plan, terms=registers * tables.LANES)
        error = trial.error(trial.run(tried), exact)
        if error <= share:
            return tried, error
    return dataclasses.replace(plan, terms=most), 0.0


def _fewer_wavelengths(plan: Plan, trial: Trial, share: float) -> tuple[Plan, float]:
    """The least bandwidth whose integral is within its share, and the error that it leaves."""
    plan = _fewer_subdivisions(plan, trial, share)
    plan, exact = _wide_enough(plan, trial, share)
    per_sample = plan.subdivisions * plan.wavelengths
    for bandwidth in _bandwidths(plan, trial, share, exact):
        adapted = dataclasses.replace(plan, bandwidth_um=bandwidth)
        most = wavelength_count(adapted, adapted.max_lateral, adapted.max_w)
        adapted = dataclasses.replace(adapted, wavelengths=tables.set_size(min(most, 2.0 * plan.wavelengths)))
        if plan.subdivisions > 1:
            adapted = dataclasses.replace(adapted, subdivisions=math.ceil(per_sample / adapted.wavelengths))
        error = trial.error(trial.run(adapted), exact)
        if error <= share * _SLACK:
            return adapted, error
    return plan, trial.error(trial.run(plan), exact)


def _wide_enough(plan: Plan, trial: Trial, share: float) -> tuple[Plan, NDArray[np.float64]]:
    """The plan, widened where its bounds do not suffice, and what twice its wavelengths make of all pilots.

    Bounds are for what oscillates; a surface much higher than a wavelength may take a little more than they say.
    """

    def against_twice(tried: Plan) -> tuple[NDArray[np.float64], float]:
        tried = dataclasses.replace(tried, adaptive=False)
        exact = trial.run(dataclasses.replace(tried, wavelengths=2 * tried.wavelengths - 1))
        return exact, trial.error(trial.run(tried), exact)

    exact, error = against_twice(plan)
    # For a source at the horizon bounds were cut short: what is too sparse to see an order need not err less at once.
    bound = wavelength_count(plan, float(trial.lateral.max()), float(trial.w.max()))
    for _ in range(_WIDENINGS):
        if error <= share:
            break
        a, b, c = (2.0 * part for part in plan.bandwidth_um)
        more = tables.set_size(2.0 * plan.wavelengths)
        wider = dataclasses.replace(plan, bandwidth_um=(a, b, c), wavelengths=more)
        values, left = against_twice(wider)
        if left > error / 2.0 and wider.wavelengths >= bound:
            # What does not fall is float32's.
            break
        plan, exact, error = wider, values, left
    if plan.wavelengths > 1.5 * trial.finest.wavelengths:
        trial.sharpen(plan)
    return plan, exact


def _bandwidths(
    plan: Plan, trial: Trial, share: float, exact: NDArray[np.float64]
) -> Iterator[tuple[float, float, float]]:
    """Bandwidths to try: the cheapest that gives each pilot enough wavelengths, and wider ones."""
    per_sample = plan.subdivisions * plan.wavelengths
    sizes: list[int] = []
    errors: list[NDArray[np.float64]] = []
    size = tables.set_size(plan.wavelengths)
    while not sizes or (size < sizes[-1] and np.median(errors[-1]) < _HOPELESS * plan.tolerance):
        divisions = math.ceil(per_sample / size) if plan.subdivisions > 1 else 1
        values = trial.run(dataclasses.replace(plan, wavelengths=size, subdivisions=divisions, adaptive=False))
        sizes.append(size)
        errors.append(trial.errors(values, exact))
        size = tables.set_size(size * 2.0 ** (-1.0 / tables.SETS_AN_OCTAVE))

    factors = np.stack(np.meshgrid(_LATERAL_STEPS, _HEIGHT_STEPS, _COLOUR_STEPS, indexing="ij"), axis=-1)
    parts = 2.0 ** factors.reshape(-1, 3) * plan.bandwidth_um
    counts = 1.0 + _SPAN * (np.outer(parts[:, 0], trial.lateral) + np.outer(parts[:, 1], trial.w) + parts[:, 2:])
    # Rounded down to a size that was tried; nothing below the smallest was.
    which = len(sizes) - np.searchsorted(sizes[::-1], counts, side="right")
    known = which.max(axis=1) < len(sizes)
    parts, counts, which = parts[known], counts[known], which[known]
    by_size = np.stack(errors)
    worst = trial.worst(np.moveaxis(by_size[which, :, np.arange(counts.shape[1])], 2, 1))
    fit = worst <= share
    if fit.any():
        a, b, c = parts[fit][np.argmin(counts[fit].mean(axis=1))].tolist()
        for factor in 2.0 ** (np.arange(_TRIES) / tables.SETS_AN_OCTAVE):
            yield float(factor) * a, float(factor) * b, float(factor) * c


def _fewer_subdivisions(plan: Plan, trial: Trial, share: float) -> Plan:
    """Fewer samples of the copies' factor, as long as they leave a small part of the share."""
    if plan.subdivisions == 1:
        return plan
    whole = trial.run(plan)
    while plan.subdivisions > 1:
        tried = dataclasses.replace(plan, subdivisions=math.floor(plan.subdivisions / 1.2))
        if trial.error(trial.run(tried), whole) > _SUBDIVISION_SHARE * share:
            break
        plan = tried
    return plan
