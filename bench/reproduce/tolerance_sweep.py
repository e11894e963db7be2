"""Errors of random calls relative to the float64 reference, on directions that did not influence their settings.

A call selects its numerical settings (a plan) with sampled directions, and predicts its error. Here, the error is
measured on other directions. Calls are grouped in strata: a stratum is a kind of coherence at one tolerance, or a kind
of call (a list of few, some or many directions; a grid of directions in row order; a reflectance map; a frame of a
picture). The error of a call is the larger of two 99th percentiles of the relative error: over all directions of the
call, and over its bright directions, whose luminance Y is at least the floor f. A call that raises an exception counts
as one that misses its tolerance. Use a seed that was not used to develop the code.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import os
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np

import warpdiff as wd
from bench import inputs
from bench.truth import configurations, judge

# Targets for random calls of the library. `SHARE` is the least share of all calls that must meet their tolerance, and
# `STRATUM_SHARE` the least share in each stratum (kind of call or coherence). `BEYOND` is the largest accepted ratio of
# error to tolerance, and `WARNED` the largest share of calls that warn. In at least `PREDICTED_SHARE` of the calls, the
# ratio of predicted to measured error must be between the two values of `PREDICTED`. Calls with an error below
# `COUNTS_FROM` times the tolerance are excluded from this share.
SHARE, STRATUM_SHARE, BEYOND, WARNED = 0.99, 0.95, 3.0, 0.02
PREDICTED, PREDICTED_SHARE, COUNTS_FROM = (0.5, 10.0), 0.95, 0.01


class Outcome(NamedTuple):
    """Outcome of a random call of the library: its parameters, its errors relative to the tolerance, its messages."""

    index: int
    stratum: tuple[str, float]
    layout: str
    words: str
    overall: float  # error over tolerance, of all directions; infinite if the call raised an exception
    bright: float  # error over tolerance, of directions with Y >= f
    dim: float  # error over tolerance, of directions with Y < f
    share_dim: float
    predicted: float  # predicted error over tolerance; 0 if the call raised an exception and made no plan
    white: float  # reference luminance Y*
    refusal: str
    warned: str
    tabled: bool
    validation_size: int

    @property
    def ratio(self) -> float:
        """Ratio of the call's error (the larger 99th percentile, over all or bright directions) to its tolerance."""
        return max(self.overall, self.bright)

    @property
    def margin(self) -> float | None:
        """Ratio of predicted to measured error; None if the latter is below ``COUNTS_FROM`` times the tolerance."""
        measured = max(self.bright, self.dim)
        return self.predicted / measured if COUNTS_FROM <= measured < np.inf else None


def run(index: int, seed: int, scan: wd.HeightField | None, layouts: tuple[str, ...]) -> Outcome:
    """Make one random call of the library, and return its errors relative to the float64 reference."""
    case = configurations.configuration(index, seed, scan, layouts)
    try:
        result = judge.evaluate(case, threads=1)
    except Exception as error:
        return Outcome(
            index, case.stratum, case.layout, str(case), np.inf, np.inf, np.inf, 0.0, 0.0, 0.0,
            f"{type(error).__name__}: {error}", "", False, 0,
        )  # fmt: skip
    chosen, weights = judge.sampled(result, np.random.default_rng([seed, index, 1]))
    exact = judge.truth(case, result, chosen)
    figure = judge.figure(result.xyz[chosen], exact, weights, white=result.white)
    t = case.tolerance
    return Outcome(
        index, case.stratum, case.layout, str(case), figure.overall / t, figure.bright / t, figure.dim / t,
        figure.share_dim, result.plan.error / t, figure.white, "", result.warned, result.plan.rings_per_octave > 0,
        len(chosen),
    )  # fmt: skip


_worker: dict[str, object] = {}


def start_worker(seed: int, data: str | None, layouts: tuple[str, ...]) -> None:
    """Store the inputs that all random calls of a worker process use."""
    _worker.update(seed=seed, scan=inputs.levelled_scan(data), layouts=layouts)


def work(index: int) -> Outcome:
    """Make one random call of the library in a worker process, and return its errors."""
    return run(index, **_worker)  # type: ignore[arg-type]


def strata(outcomes: list[Outcome]) -> list[tuple[str, list[Outcome]]]:
    """Return groups of random calls with the name of each group.

    There is a group for each kind of coherence at each tolerance, one for each kind of call, and one of all calls.
    """
    by_form = [
        (f"{k} at {t:g}", [outcome for outcome in outcomes if outcome.stratum == (k, t)])
        for k, t in configurations.STRATA
    ]
    layouts = dict.fromkeys(configurations.LAYOUTS)
    by_layout = [(name, [outcome for outcome in outcomes if outcome.layout == name]) for name in layouts]
    return [group for group in [*by_form, *by_layout, ("all", outcomes)] if group[1]]


def within(outcomes: list[Outcome]) -> float:
    """Return the share of the random calls whose error is at most their tolerance."""
    return float(np.mean([outcome.ratio <= 1.0 for outcome in outcomes]))


def share_predicted(outcomes: list[Outcome]) -> float:
    """Return the share of calls whose ratio of predicted to measured error is in the range ``PREDICTED``."""
    margins = [outcome.margin for outcome in outcomes if outcome.margin is not None]
    return float(np.mean([PREDICTED[0] <= margin <= PREDICTED[1] for margin in margins])) if margins else 1.0


def table(outcomes: list[Outcome]) -> list[str]:
    """Return the lines of a Markdown table with a row per stratum (group of calls) and a row for all calls."""
    low, high = PREDICTED
    columns = (
        "stratum", "calls", "within", "refused", "warned", "worst error / tolerance: all", "bright", "dim",
        "median", f"predicted / measured {low:g} to {high:g}", "median", "tables",
    )  # fmt: skip
    rows = [f"| {' | '.join(columns)} |", "| --- " * len(columns) + "|"]
    for name, group in strata(outcomes):
        done = [outcome for outcome in group if not outcome.refusal]
        worst = [
            max((getattr(outcome, part) for outcome in done), default=np.nan) for part in ("overall", "bright", "dim")
        ]
        margins = [outcome.margin for outcome in done if outcome.margin is not None]
        rows.append(
            f"| {name} | {len(group)} | {100.0 * within(group):.1f} % | {len(group) - len(done)} "
            f"| {sum(bool(outcome.warned) for outcome in done)} | {' | '.join(f'{error:.2f}' for error in worst)} "
            f"| {np.median([outcome.ratio for outcome in done] or [np.nan]):.2f} "
            f"| {100.0 * share_predicted(done):.0f} % | {np.median(margins or [np.nan]):.1f} "
            f"| {sum(outcome.tabled for outcome in done)} |"
        )
    return rows


def failures(outcomes: list[Outcome]) -> list[str]:
    """Return the failing calls with all parameters.

    A call fails if it misses the tolerance, is refused or warns, or if its ratio of predicted to measured error is
    outside of the range ``PREDICTED``.
    """
    rows = []
    for outcome in outcomes:
        is_far = outcome.margin is not None and not PREDICTED[0] <= outcome.margin <= PREDICTED[1]
        if outcome.ratio <= 1.0 and not outcome.warned and not is_far:
            continue
        what = outcome.refusal or (
            f"error / tolerance: all {outcome.overall:.2f}, bright {outcome.bright:.2f}, dim {outcome.dim:.2f}, "
            f"predicted {outcome.predicted:.2f}; Y* {outcome.white:.1e}, {100.0 * outcome.share_dim:.0f} % below f"
        )
        warned = f"; warned: {outcome.warned}" if outcome.warned else ""
        rows.append(f"- `--index {outcome.index}`: {outcome.words}: {what}{warned}")
    return rows


def shortfalls(outcomes: list[Outcome]) -> list[str]:
    """Return one line of text for each target of the sweep that the random calls do not meet."""
    short = []
    for name, group in strata(outcomes):
        least = SHARE if name == "all" else STRATUM_SHARE
        if within(group) < least:
            short.append(f"{name}: {100.0 * within(group):.1f} % within the tolerance, not {100.0 * least:g} %")
    if beyond := sum(outcome.ratio > BEYOND for outcome in outcomes):
        short.append(f"{beyond} beyond {BEYOND:g} times the tolerance, or refused")
    if (share := np.mean([bool(outcome.warned) for outcome in outcomes])) > WARNED:
        short.append(f"{100.0 * share:.1f} % warned")
    if (share := share_predicted(outcomes)) < PREDICTED_SHARE:
        short.append(f"{100.0 * share:.1f} % of the predicted errors are near the measured ones")
    return short


def explain(index: int, seed: int, scan: wd.HeightField | None, layouts: tuple[str, ...]) -> None:
    """Print one call with its settings (plan) and errors, and the errors of the same call with finer settings."""
    case = configurations.configuration(index, seed, scan, layouts)
    print(case)
    try:
        result = judge.evaluate(case)
    except Exception as error:
        print(f"{type(error).__name__}: {error}")
        result = judge.evaluate(case, strict=False)
    chosen, weights = judge.sampled(result, np.random.default_rng([seed, index, 1]))
    exact = judge.truth(case, result, chosen)
    t, settings = case.tolerance, result.plan
    moved, figure = (
        judge.figure(xyz, exact, weights, white=result.white)
        for xyz in (judge.truth(case, result, chosen, closer=10.0), result.xyz[chosen])
    )
    print(settings)
    print(
        f"error / tolerance: all {figure.overall / t:.3g}, bright {figure.bright / t:.3g}, dim {figure.dim / t:.3g}, "
        f"{100.0 * figure.share_dim:.0f} % dim, predicted {settings.error / t:.3g}; Y* {figure.white:.2e}; "
        f"{len(chosen)} evaluated of {len(result.xyz)}, {np.count_nonzero(result.read)} read; change of the error with "
        f"a ten times finer reference: {moved.value / t:.1e}; warned: {result.warned or 'no'}"
    )
    finer = {
        "twice the wavelengths for all directions": {"adaptive": False, "wavelengths": 2 * settings.wavelengths - 1},
        "all terms of the low-rank basis": {"method": "low-rank", "terms": 128},
        "all neighbours": {"least_weight": 1e-10 * t},
        "sampled wavelengths": {"rings_per_octave": 0, "footprint": False},
    }
    everything = {name: value for change in finer.values() for name, value in change.items()}
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    lights, views = result.to_light[chosen], result.to_view[chosen]
    for name, change in {**finer, "all of these": everything}.items():
        changed = dataclasses.replace(settings, **change)
        xyz = wd.reflectance(case.heightfield, lights, views, illuminant=case.illuminant, plan=changed)
        finer_figure = judge.figure(xyz, exact, weights, white=result.white)
        errors = ", ".join(f"{part} {getattr(finer_figure, part) / t:.3g}" for part in ("overall", "bright", "dim"))
        print(f"  with {name}: {errors}")


def main() -> int:
    """Make all random calls, print a table of their errors, and write it to a file. Return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--count", type=int, default=420, help="number of calls (default: 420, 30 per coherence and tolerance)"
    )
    parser.add_argument("--seed", type=int, default=0, help="random seed (default: 0)")
    parser.add_argument("--only", choices=configurations.KINDS, help="run only this kind of coherence")
    parser.add_argument(
        "--layouts", nargs="+", choices=set(configurations.LAYOUTS), help="run only these kinds of call"
    )
    parser.add_argument("--index", type=int, nargs="+", help="explain the calls with these indices")
    parser.add_argument("--output", type=Path, help="write the table to this Markdown file")
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count(),
        help="number of processes with one thread each (default: one per core)",
    )
    parser.add_argument("--data", help=inputs.HELP)
    options = parser.parse_args()
    layouts = tuple(options.layouts or configurations.LAYOUTS)
    scan = inputs.levelled_scan(options.data)
    if scan is None:
        print("the scan is not available: synthetic fingers replace its crops")
    if options.index is not None:
        for index in options.index:
            print(f"--index {index}: ", end="")
            explain(index, options.seed, scan, layouts)
        return 0

    kinds = itertools.cycle(kind for kind, _ in configurations.STRATA)
    those = (index for index, kind in enumerate(kinds) if options.only in (None, kind))
    indices = list(itertools.islice(those, options.count))
    outcomes: list[Outcome] = []
    begin = time.perf_counter()
    # Linear algebra uses one thread per process, because the processes share the cores.
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(
        options.jobs, get_context("spawn"), start_worker, (options.seed, options.data, layouts)
    ) as pool:
        for future in as_completed([pool.submit(work, index) for index in indices]):
            done = future.result()
            outcomes.append(done)
            if done.ratio > 1.0 or done.warned or len(outcomes) % 50 == 0:
                result = f"refused, {done.refusal[:90]}…" if done.refusal else f"error / tolerance {done.ratio:.2f}"
                print(
                    f"{len(outcomes)} of {len(indices)}, {time.perf_counter() - begin:.0f} s: --index {done.index}, "
                    f"{done.stratum[0]} at {done.stratum[1]:g}, {done.layout}: {result}"
                    f"{' (warned)' * bool(done.warned)}",
                    flush=True,
                )
    outcomes.sort()
    short = shortfalls(outcomes)
    bar = (
        f"Targets ({100.0 * SHARE:g} % within the tolerance, {100.0 * STRATUM_SHARE:g} % in every stratum, none beyond "
        f"{BEYOND:g} times, {100.0 * WARNED:g} % warned, {100.0 * PREDICTED_SHARE:g} % predicted within "
        f"{PREDICTED[0]:g} to {PREDICTED[1]:g}): {'not met: ' + '; '.join(short) if short else 'met'}."
    )
    circumstances = (
        f"{'With' if scan else 'Without'} crops of the scan. {sum(outcome.validation_size for outcome in outcomes)} "
        f"directions evaluated: all in calls of fewer than {configurations.FEW}, otherwise at least {judge.COUNT} that "
        f"no plan read. {time.perf_counter() - begin:.0f} s, {options.jobs} processes."
    )
    lines = [
        f"# Errors over tolerances: {len(indices)} random calls, seed {options.seed}", "", bar, "", circumstances, "",
        *table(outcomes), "", "## Calls that fail, are refused, warn, or have a wrong prediction", "",
        *failures(outcomes),
    ]  # fmt: skip
    text = "\n".join(lines) + "\n"
    print("\n" + text)
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    return 1 if short else 0


if __name__ == "__main__":
    sys.exit(main())
