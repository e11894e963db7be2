"""Comparison of automatic plans with the cheapest settings: times, and predicted relative to actual errors.

A plan has the numbers of a computation, such as wavelengths and terms of a series. The library makes an automatic plan
for a call, which predicts the error of the call. A configuration is a surface, a kind of coherence, a tolerance and a
call of 40,000 directions. Errors are evaluated on the first 128 of these directions. The automatic plan of a
configuration is compared with all settings of a grid, which varies four things:

- the method
- the number of terms of the series, in multiples of the vector width of the processor
- the number of neighbouring Fourier coefficients in a sum, by the least weight exp(−n/2) that a coefficient must have,
  with integers n. For replicated patches, the number of subdivisions is varied instead, in steps of a factor 2^(1/4):
  the number of samples per wavelength of the factor by which the periods interfere
- the number of wavelengths per direction: equal for all directions, or dependent on the scattering vector (u, v, w) by
  the bandwidth of a plan (number of wavelengths per unit of 1/λ), in steps of a factor 2^(1/4)

A setting is a candidate if its errors on these 128 directions, relative to the float64 reference, meet the tolerance
without a safety factor. Errors are relative to the brightness of all 40,000 directions. The candidates with the lowest
predicted cost are timed: the best of all, and the best of each method. The fastest candidate is the cheapest setting.

Times are processor times divided by the number of threads, as medians of rounds in which all plans are timed once.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import warpdiff as wd
from bench import inputs
from bench.dev.cheapest_settings import DIRECTIONS, SPAN, Call, measure, settings
from bench.dev.plan_configurations import KINDS, TOLERANCES, configurations
from bench.truth.errors import reference_luminance
from warpdiff.diffraction.coefficient_basis import METHODS
from warpdiff.planner import cost_model

if TYPE_CHECKING:
    from bench.dev.plan_configurations import Configuration

# Number of settings (candidates) with the lowest predicted cost that are timed. The cheapest candidate of each method
# is timed, too.
TIMED = 4


class Result(NamedTuple):
    """Comparison of an automatic plan with the cheapest setting, and of predicted with actual errors, as ratios.

    The automatic plan has the numbers of wavelengths and terms that the library selects for a call.

    Attributes:
        ratio: Time of the automatic plan over the time of the cheapest setting.
        predicted: Error that the automatic plan predicts, divided by its actual error on directions for which it was
            made.
        fresh: Like ``predicted``, with the actual error on 128 other directions of the call.
        samples: Predicted mean number of wavelengths per direction, divided by that of the cheapest setting.
        kernel: Predicted cost per wavelength and direction, divided by that of the cheapest setting.
    """

    ratio: float
    predicted: float
    fresh: float
    samples: float
    kernel: float


def compare(case: Configuration, *, rounds: int, threads: int | None) -> tuple[str, Result | None]:
    """Make the library's plan for a call, find and time the cheapest setting; return a table row and the ratios."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            automatic = wd.plan(
                case.heightfield, case.lights, case.views, tolerance=case.tolerance, coherence=case.coherence,
                method="low-rank" if case.coherence.kind != "replicas" else "auto", threads=threads,
            )  # fmt: skip
        except ValueError as error:
            return f"| {case} | refused: {error} |", None
        xyz = wd.reflectance(
            case.heightfield, case.lights, case.views, plan=automatic, coherence=case.coherence, threads=threads
        )
        luminance = reference_luminance(xyz[:, 1].astype(np.float64))
        call, fresh = (
            Call(case, case.lights[part], case.views[part], luminance, threads=threads)
            for part in (slice(0, DIRECTIONS), slice(DIRECTIONS, 2 * DIRECTIONS))
        )
        error, error_fresh = call.error(automatic), fresh.error(automatic)
        candidates = sorted(settings(call, automatic), key=lambda setting: setting.cost)
        if not candidates:
            return (
                f"| {case} | no setting of the grid meets the tolerance; the error of the plan is {error:.1e} |",
                None,
            )
        chosen = candidates[:TIMED]
        for method in METHODS:
            chosen += [setting for setting in candidates if setting.plan.method == method][:1]
        plans = list({id(setting): setting.plan for setting in chosen}.values())
        times = measure(call, [automatic, *plans], rounds)
    at = int(np.argmin(times[1:]))
    best = plans[at]
    # The predicted cost of the automatic plan is divided by that of the cheapest setting. This ratio is a product of
    # two ratios: that of the mean numbers of wavelength samples, and that of the costs per sample.
    costs = [
        cost_model.sampling_multiply_adds(case.heightfield, plan, call.order_rate, call.w) for plan in (automatic, best)
    ]
    kernel = call.cost_per_wavelength(automatic) / call.cost_per_wavelength(best)
    result = Result(
        times[0] / min(times), automatic.error / max(error, 1e-9), automatic.error / max(error_fresh, 1e-9),
        costs[0] / costs[1] / kernel, kernel,
    )  # fmt: skip
    row = (
        f"| {case} | {times[0]:.2f} | {times[1 + at]:.2f} | {result.ratio:.2f} | {result.samples:.2f} "
        f"| {result.kernel:.2f} | {_numbers(automatic)} | {_numbers(best)} | {error:.1e} | {call.error(best):.1e} "
        f"| {result.predicted:.1f} | {error_fresh:.1e} | {result.fresh:.1f} |"
    )
    return row, result


def _numbers(plan: wd.Plan) -> str:
    share = plan.bandwidth_um[2] * SPAN / plan.wavelengths
    text = f"{plan.method}, {plan.terms}, {plan.wavelengths} λ"
    text += f" from {100.0 * share:.0f} %" if plan.adaptive else " for all"
    if plan.coherence.kind == "replicas":
        return text + f", {plan.subdivisions} each"
    return text + f", e^{math.log(plan.least_weight):.1f}"


def quartiles(values: list[float]) -> str:
    """Return a text with the median, the quartiles and the range of ratios that compare plans."""
    low, first, median, third, high = np.percentile(values, [0, 25, 50, 75, 100])
    return f"median {median:.2f}, quartiles {first:.2f} and {third:.2f}, range {low:.2f} to {high:.2f}"


def main() -> None:
    """Compare the automatic plan with the cheapest setting for random configurations; print a table and a summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=40, help="number of configurations (default: 40)")
    parser.add_argument("--only", type=int, help="run only the configuration with this index")
    parser.add_argument("--seed", type=int, default=0, help="random seed (default: 0)")
    parser.add_argument("--rounds", type=int, default=7, help="number of timed rounds (default: 7)")
    parser.add_argument("--threads", type=int, help="threads on the CPU (default: one per core)")
    parser.add_argument("--data", type=Path, help=inputs.HELP)
    options = parser.parse_args()
    data = inputs.folder(options.data)
    every = configurations(data, options.count, options.seed)
    if options.only is not None:
        every = [every[options.only]]
    print(
        "| surface | coherence | tolerance | µs, plan | µs, cheapest | time ratio | samples ratio | per sample | plan "
        "| cheapest | error, plan | error, cheapest | predicted / actual | error, fresh | predicted / actual |"
    )
    print("|" + " --- |" * 15)
    results: list[tuple[Configuration, Result]] = []
    missing = 0
    begin = time.perf_counter()
    for case in every:
        row, result = compare(case, rounds=options.rounds, threads=options.threads)
        print(row, flush=True)
        if result is None:
            missing += 1
        else:
            results.append((case, result))
    print(f"\n{len(results)} configurations in {time.perf_counter() - begin:.0f} s, {missing} without a result")
    if not results:
        return
    print(f"plan's time over the cheapest setting's: {quartiles([r.ratio for _, r in results])} (target: median 2)")
    for kind in KINDS:
        ratios = [r.ratio for case, r in results if case.coherence.kind == kind]
        if ratios:
            print(f"- {kind}: {quartiles(ratios)}")
    for tolerance in TOLERANCES:
        ratios = [r.ratio for case, r in results if case.tolerance == tolerance]
        if ratios:
            print(f"- tolerance {tolerance:g}: {quartiles(ratios)}")
    print(f"predicted samples, plan over cheapest: {quartiles([r.samples for _, r in results])}")
    print(f"predicted cost per sample, plan over cheapest: {quartiles([r.kernel for _, r in results])}")
    for label, values in (
        ("planned directions", [r.predicted for _, r in results]),
        ("fresh directions", [r.fresh for _, r in results]),
    ):
        within = sum(1.0 <= ratio <= 10.0 for ratio in values)
        below = sum(ratio < 1.0 for ratio in values)
        count = f"{within} of {len(values)} within 1 to 10, {below} below 1"
        print(f"predicted error over the measured one, {label}: {quartiles(values)}; {count}")


if __name__ == "__main__":
    main()
