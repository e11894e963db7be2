"""Search for the cheapest settings of a call that meet its tolerance, for ``bench/dev/tight_plans.py``.

A setting is a plan: the numbers of a computation, such as wavelengths and terms of a series. Plans may use a different
number of wavelengths for each direction. The colour of a direction depends only on its own wavelengths. Colours are
therefore computed once for each number of wavelengths. The error of a plan follows from the colours for the numbers
that it uses.
"""

from __future__ import annotations

import dataclasses
import math
import time
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bench.truth import reference
from bench.truth.errors import FLOOR
from warpdiff.device.devices import resolve_device, resolve_threads
from warpdiff.device.kernel_calls import launch
from warpdiff.diffraction.coefficient_basis import METHODS, POWER_METHODS
from warpdiff.diffraction.phase_series import EXPANSIONS, MAX_TERMS
from warpdiff.kernels.structs import Footprint
from warpdiff.optics import reflectance_factors
from warpdiff.optics.colorimetry import LAMBDA_MAX_NM, LAMBDA_MIN_NM
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.planner import cost_model
from warpdiff.request.directions import DirectionRange, order_rate
from warpdiff.tables import coefficient_table

if TYPE_CHECKING:
    import warpdiff as wd
    from bench.dev.plan_configurations import Configuration

# Width of the visible range, as a difference of wavenumbers 1/λ [1/µm].
SPAN = 1e3 / LAMBDA_MIN_NM - 1e3 / LAMBDA_MAX_NM
# Number of directions of each call whose errors are evaluated.
DIRECTIONS = 128
# Numbers of wavelengths below 16 that are tried, in steps of about a factor 2^(1/4). A plan with one of these numbers
# uses it for all directions, because a plan with different numbers per direction has at least 16 wavelengths.
FEWER = (8, 10, 11, 13)
# The number of wavelengths of a direction is proportional to its bandwidth, which depends on the scattering vector (u,
# v, w). The bandwidth has a constant part, a part that is proportional to |(u, v)| (the order rate), and a part that is
# proportional to |w|. `CONSTANTS` are the tried shares of the constant part in the bandwidth, in steps of a factor
# 2^(1/4). `SPLITS` are the tried shares of the part for the order rate in the sum of the other two parts.
CONSTANTS = 2.0 ** (-np.arange(25) / 4.0)
SPLITS = (1.0, 0.95, 0.9, 0.8, 0.7, 0.5, 0.25, 0.0)
# For two numbers in a plan: how many values are tried, beginning with the smallest value that meets the tolerance.
# `MORE_TERMS` applies to the number of terms of the series. `MORE_EXPONENTS` applies to the exponent a of the least
# weight exp(−a) of neighbouring Fourier coefficients.
MORE_TERMS, MORE_EXPONENTS = 3, 5
# Step and upper limit of the exponent a in the least weight exp(−a) of neighbouring Fourier coefficients.
EXPONENT_STEP, MOST_EXPONENT = 0.5, 24.0
# A plan (numbers of wavelengths and terms) is tried only if its predicted cost is at most this number times the lowest
# predicted cost of the plans so far.
HOPELESS = 1.6
# Largest number of directions of one timed call. The value is limited by time: if it is doubled, the calls take twice
# as long.
MOST_TIMED = 4096
# Number of variants of a plan that are evaluated at once; the variants differ in the number of wavelengths per
# direction. The value is limited by memory.
CHUNK = 64


class Call:
    """Directions of one call, with the reference colours of these directions.

    Methods compute the colours and errors of these directions by a plan: the numbers of a computation, such as
    wavelengths and terms of a series.
    """

    def __init__(
        self, case: Configuration, lights: np.ndarray, views: np.ndarray, luminance: float, *, threads: int | None
    ) -> None:
        self.case, self.device, self.threads = case, resolve_device(None), resolve_threads(threads)
        coherence = case.coherence
        self.scattering_vectors, self.lights = -lights - views, lights
        normal = reflectance_factors.normal_reflectance(1.5)
        self.gains = reflectance_factors.gain(
            lights, views, normal=normal, masking=True, per_light_cosine=coherence.kind == "source"
        )
        self.direction_range = DirectionRange.of(
            case.heightfield, coherence, self.scattering_vectors, lights, self.gains > 0.0
        )
        self.order_rate = order_rate(case.heightfield, coherence, self.scattering_vectors, lights)
        self.w = np.abs(self.scattering_vectors[:, 2])
        exact = reference.reference_reflectance(
            case.heightfield, lights, views, coherence, tolerance=case.tolerance / 5.0
        )
        self.exact = exact
        # Errors of dim directions are relative to a floor f, which is a share of the luminance of all directions of the
        # call. This luminance is an argument, because the few directions of this object do not represent all
        # directions.
        floor = FLOOR * luminance
        self._above = exact[:, 1] >= floor
        self._scale = np.where(self._above, np.maximum(np.linalg.norm(exact, axis=1), floor), floor)
        self._arrays: dict[int, Any] = {}

    def cost_per_wavelength(self, plan: wd.Plan) -> float:
        """Return the predicted cost of one wavelength per direction [multiply-adds]."""
        many = dataclasses.replace(plan, wavelengths=1000, adaptive=False)
        return cost_model.sampling_multiply_adds(self.case.heightfield, many, self.order_rate, self.w) / 1000.0

    def load(self, repeats: int) -> list[Any]:
        """Return Warp arrays with the directions of the call, repeated ``repeats`` times, and an array for colours."""
        import warp as wp

        if repeats not in self._arrays:
            self._arrays[repeats] = [
                wp.array(np.tile(self.scattering_vectors, (repeats, 1)), dtype=wp.vec3d, device=self.device),
                wp.array(np.tile(self.lights, (repeats, 1)).astype(np.float32), dtype=wp.vec3f, device=self.device),
                wp.array(np.tile(self.gains, repeats).astype(np.float32), dtype=wp.float32, device=self.device),
                wp.empty(0, dtype=Footprint, device=self.device),
                wp.zeros(len(self.gains) * repeats, dtype=wp.vec3f, device=self.device),
            ]
        return self._arrays[repeats]

    def prepared(self, plan: wd.Plan, repeats: int = 1) -> Any:
        """Make tables of Fourier coefficients for a plan, and return a function that computes colours of directions."""
        heightfield, slices = self.case.heightfield, 8 if repeats == 1 else 64
        table = coefficient_table.table_for(
            heightfield, plan, self.direction_range, device=self.device, threads=self.threads
        )
        quadrature = coefficient_table.quadrature_for(heightfield, plan, IlluminatedMaterial("D65"), device=self.device)
        *inputs, xyz = self.load(repeats)

        def evaluate() -> None:
            xyz.zero_()
            launch(
                table.integrate, len(xyz), [table.arguments, *inputs, quadrature], [xyz], device=self.device,
                threads=self.threads, slice_size=slices,
            )  # fmt: skip

        return evaluate

    def errors(self, plan: wd.Plan) -> np.ndarray:
        """Return errors ‖ΔXYZ‖ of the directions' colours, computed by a plan, relative to the reference colours.

        For directions whose luminance Y is below the floor f, errors are relative to f.
        """
        self.prepared(plan)()
        xyz = self.load(1)[-1].numpy().astype(np.float64)
        return np.nan_to_num(np.linalg.norm(xyz - self.exact, axis=1) / self._scale, nan=1e9, posinf=1e9)

    def worst(self, errors: np.ndarray) -> np.ndarray:
        """Return the 99th percentile of errors (..., n) of bright or of dim directions, whichever is larger."""
        groups = [np.percentile(errors[..., mask], 99.0, axis=-1) for mask in (self._above, ~self._above) if mask.any()]
        return np.max(groups, axis=0)

    def error(self, plan: wd.Plan) -> float:
        """Compute colours by a plan; return the 99th percentile of errors of bright or dim directions (the larger)."""
        return float(self.worst(self.errors(plan)))


class Bandwidths:
    """Assignments of wavelengths to directions; an assignment states a number of wavelengths for every direction.

    The mean number of wavelengths of each assignment is stored, too.
    """

    def __init__(self, call: Call, most: int) -> None:
        first = len(FEWER)
        ladder = [coefficient_table.wavelength_set_size(16.0)]
        while ladder[-1] < most:
            ladder.append(coefficient_table.wavelength_set_size(ladder[-1] * 2.0**0.25))
        self.sizes = np.array([*FEWER, *ladder])
        lateral_share = call.order_rate / max(call.direction_range.max_order_rate, 1e-9)
        w_share = call.w / max(call.direction_range.max_w, 1e-9)
        self.shares: list[tuple[float, float, float]] = [(0.0, 0.0, 1.0)]
        for constant in CONSTANTS[1:]:
            self.shares += [((1.0 - constant) * s, (1.0 - constant) * (1.0 - s), constant) for s in SPLITS]
        a, b, c = np.array(self.shares).T[:, :, None]
        share = (a * lateral_share + b * w_share + c).astype(np.float32)
        step = np.floor(-4.0 * np.log2(share)).astype(int)
        step = np.clip(step, 0, np.floor(-4.0 * np.log2(c) + 1e-9).astype(int))
        tops = np.arange(len(self.sizes))
        which = [np.maximum(top - step, first) for top in tops[first:]]
        # Each number in ``FEWER`` makes one assignment, in which all directions have this number of wavelengths.
        which = [np.full((1, len(call.w)), top) for top in tops[:first]] + which
        self.which = np.concatenate(which)
        self.made = [(top, 0) for top in tops[:first]]
        self.made += [(top, index) for top in tops[first:] for index in range(len(self.shares))]
        self.counts = self.sizes[self.which].mean(axis=1)
        self.order = np.argsort(self.counts, kind="stable")

    def cheapest(self, call: Call, errors: np.ndarray, tolerance: float) -> int | None:
        """Return the index of the assignment with the fewest wavelengths that meets the tolerance, or None.

        An assignment states a number of wavelengths for every direction. ``errors`` has the errors of n directions for
        all numbers of wavelengths, shape (sizes, n).
        """
        columns = np.arange(errors.shape[1])
        for start in range(0, len(self.order), CHUNK):
            chunk = self.order[start : start + CHUNK]
            fit = call.worst(errors[self.which[chunk], columns]) <= tolerance
            if fit.any():
                return int(chunk[np.argmax(fit)])
        return None

    def plan(self, plan: wd.Plan, index: int) -> wd.Plan:
        """Return a plan whose numbers of wavelengths per direction are those of assignment ``index``."""
        top, shares = self.made[index]
        a, b, c = self.shares[shares]
        scale = self.sizes[top] / SPAN
        bandwidth = a * scale / max(plan.max_order_rate, 1e-9), b * scale / max(plan.max_w, 1e-9), c * scale
        count = int(self.sizes[top])
        return dataclasses.replace(plan, bandwidth_um=bandwidth, wavelengths=count, adaptive=c < 1.0)


class Setting(NamedTuple):
    """One of the compared settings: a plan that meets the tolerance, with its predicted cost."""

    cost: float
    plan: wd.Plan


def settings(call: Call, automatic: wd.Plan) -> list[Setting]:
    """Return, for each combination of method, terms and neighbours, the sufficient setting with the fewest wavelengths.

    A setting is sufficient if it meets the tolerance. A combination has a method, a number of terms of the series, and
    a number of neighbouring Fourier coefficients. For replicated patches, the number of subdivisions of a plan replaces
    the number of neighbouring coefficients. Combinations that are too costly even with few wavelengths are excluded.
    """
    case = call.case
    tolerance = case.tolerance
    bandwidths = Bandwidths(call, 2 * automatic.wavelengths)
    finest = dataclasses.replace(
        automatic, wavelengths=int(bandwidths.sizes[-1]), adaptive=False,
        least_weight=min(automatic.least_weight, math.exp(-MOST_EXPONENT)),
    )  # fmt: skip
    results: list[Setting] = []

    def is_promising(plan: wd.Plan) -> bool:
        """Return whether a plan may be among the cheapest plans.

        The number of wavelengths that the plan requires is not known yet. The smallest number among the settings so far
        is assumed.
        """
        if not results:
            return True
        best = min(setting.cost for setting in results)
        fewest = min(setting.cost / call.cost_per_wavelength(setting.plan) for setting in results)
        return call.cost_per_wavelength(plan) * fewest <= HOPELESS * best

    for method in METHODS:
        if method in POWER_METHODS and not case.coherence.adds_powers:
            continue
        enough = 0
        for terms in range(coefficient_table.LANES, MAX_TERMS + 1, coefficient_table.LANES):
            with_terms = dataclasses.replace(finest, method=method, terms=terms)
            bare = dataclasses.replace(with_terms, least_weight=math.exp(-EXPONENT_STEP), subdivisions=1)
            if enough == MORE_TERMS or not is_promising(bare):
                break
            # The series represents exp(ix) with the phase x = 2πwh/λ of heights h. It does not converge with fewer
            # terms than half of the largest x, and is then not evaluated.
            expansion = EXPANSIONS.get(method)
            if expansion is not None:
                argument = (
                    2.0 * math.pi * call.direction_range.kappas[1] * expansion.offset_and_scale(case.heightfield)[1]
                )
                if terms < 0.5 * argument:
                    continue
            if call.error(with_terms) > tolerance:
                continue
            enough += 1
            for kernel in _neighbourhoods(call, with_terms, automatic):
                if not is_promising(kernel):
                    continue
                errors = np.stack(
                    [call.errors(dataclasses.replace(kernel, wavelengths=int(size))) for size in bandwidths.sizes]
                )
                index = bandwidths.cheapest(call, errors, tolerance)
                if index is not None:
                    plan = bandwidths.plan(kernel, index)
                    if call.error(plan) <= tolerance * 1.001:
                        results.append(
                            Setting(call.cost_per_wavelength(kernel) * float(bandwidths.counts[index]), plan)
                        )
    return results


def _neighbourhoods(call: Call, plan: wd.Plan, automatic: wd.Plan) -> list[wd.Plan]:
    """Return variants of a plan that sum over different numbers of neighbouring Fourier coefficients.

    The first variant has the smallest number with which the plan meets the tolerance. If a finite number of periods of
    the patch interferes, the number of wavelengths between two interpolated powers (``subdivisions``) varies instead.
    """
    if plan.coherence.kind == "replicas":
        steps = 2.0 ** (np.arange(4, -13, -1) / 4.0)
        counts = sorted({max(1, round(automatic.subdivisions * step)) for step in steps})
        return [dataclasses.replace(plan, subdivisions=count) for count in counts]

    def weighed(steps: int) -> wd.Plan:
        return dataclasses.replace(plan, least_weight=math.exp(-EXPONENT_STEP * steps))

    low, high = 0, round(MOST_EXPONENT / EXPONENT_STEP)
    while high - low > 1:
        middle = (low + high) // 2
        if call.error(weighed(middle)) <= call.case.tolerance:
            high = middle
        else:
            low = middle
    return [weighed(high + more) for more in range(MORE_EXPONENTS)]


def measure(call: Call, plans: list[wd.Plan], rounds: int) -> list[float]:
    """Return the time per direction [µs] of each plan. The plans are timed alternately."""
    call.prepared(plans[0])()
    begin = time.perf_counter()
    call.prepared(plans[0])()
    once = max(time.perf_counter() - begin, 1e-5)
    repeats = int(np.clip(0.15 / once, 2, MOST_TIMED // DIRECTIONS))
    ready = [call.prepared(plan, repeats) for plan in plans]
    seconds: list[list[float]] = [[] for _ in plans]
    for _ in range(rounds + 1):
        for evaluate, times in zip(ready, seconds, strict=True):
            begin = time.process_time()
            evaluate()
            times.append(time.process_time() - begin)
    return [1e6 * float(np.median(times[1:])) / (repeats * DIRECTIONS * call.threads) for times in seconds]
