"""Honoured tolerance, out of sample: random calls against the float64 reference, on directions their plans never read.

A stratum is a coherence form at a tolerance, or a kind of call: a list of directions (few, some, many), a grid in row
order, a BRDF map, a frame. A call's error is the design's: the larger of the 99th percentiles of e over all its
directions and over the bright ones. An exception in place of a result is a miss. Take a seed that was not worked with.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import os
import platform
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

# The bar: shares of calls within the tolerance, in all and in every stratum, how far beyond any may be, how many may
# warn, and how many predicted errors lie between these multiples of the measured ones, which count from this share of
# the tolerance on.
SHARE, STRATUM_SHARE, BEYOND, WARNED = 0.99, 0.95, 3.0, 0.02
PREDICTED, PREDICTED_SHARE, COUNTS_FROM = (0.5, 10.0), 0.95, 0.01


class Outcome(NamedTuple):
    """What became of a call."""

    index: int
    stratum: tuple[str, float]
    layout: str
    words: str
    whole: float  # error over tolerance, of all directions; infinite without a result
    bright: float  # of those with Y >= f
    dim: float  # and of those with Y < f
    share_dim: float
    predicted: float  # predicted error over tolerance; 0 without a plan
    white: float  # Y*
    refusal: str
    warned: str
    tabled: bool
    validation_size: int
    seconds: float
    truth_seconds: float

    @property
    def ratio(self) -> float:
        """Error over tolerance."""
        return max(self.whole, self.bright)

    @property
    def margin(self) -> float | None:
        """Predicted over measured, where the latter counts."""
        measured = max(self.bright, self.dim)
        return self.predicted / measured if COUNTS_FROM <= measured < np.inf else None


def run(index: int, seed: int, scan: wd.HeightField | None, layouts: tuple[str, ...]) -> Outcome:
    """Make a call and judge it."""
    case = configurations.configuration(index, seed, scan, layouts)
    begin = time.perf_counter()
    try:
        result = judge.evaluate(case, threads=1)
    except Exception as error:
        spent = time.perf_counter() - begin
        return Outcome(
            index, case.stratum, case.layout, str(case), np.inf, np.inf, np.inf, 0.0, 0.0, 0.0,
            f"{type(error).__name__}: {error}", "", False, 0, spent, 0.0,
        )  # fmt: skip
    seconds = time.perf_counter() - begin
    chosen, weights = judge.drawn(result, np.random.default_rng([seed, index, 1]))
    begin = time.perf_counter()
    exact = judge.truth(case, result, chosen)
    found = judge.figure(result.xyz[chosen], exact, weights, white=result.white)
    t = case.tolerance
    return Outcome(
        index, case.stratum, case.layout, str(case), found.whole / t, found.bright / t, found.dim / t, found.share_dim,
        result.plan.error / t, found.white, "", result.warned, result.plan.rings_per_octave > 0, len(chosen), seconds,
        time.perf_counter() - begin,
    )  # fmt: skip


_worker: dict[str, object] = {}


def start_worker(seed: int, data: str | None, layouts: tuple[str, ...]) -> None:
    """Give a process what all its calls share."""
    _worker.update(seed=seed, scan=inputs.levelled_scan(data), layouts=layouts)


def work(index: int) -> Outcome:
    """One call in a process."""
    return run(index, **_worker)  # type: ignore[arg-type]


def strata(outcomes: list[Outcome]) -> list[tuple[str, list[Outcome]]]:
    """All of them by name: forms at tolerances, kinds of call, and all."""
    by_form = [
        (f"{k} at {t:g}", [each for each in outcomes if each.stratum == (k, t)]) for k, t in configurations.STRATA
    ]
    layouts = dict.fromkeys(configurations.LAYOUTS)
    by_layout = [(name, [each for each in outcomes if each.layout == name]) for name in layouts]
    return [each for each in [*by_form, *by_layout, ("all", outcomes)] if each[1]]


def within(outcomes: list[Outcome]) -> float:
    """The share within the tolerance."""
    return float(np.mean([each.ratio <= 1.0 for each in outcomes]))


def told_well(outcomes: list[Outcome]) -> float:
    """The share of predicted errors that are near enough to the measured ones."""
    margins = [each.margin for each in outcomes if each.margin is not None]
    return float(np.mean([PREDICTED[0] <= each <= PREDICTED[1] for each in margins])) if margins else 1.0


def table(outcomes: list[Outcome]) -> list[str]:
    """Rows by stratum and one of all, in Markdown."""
    low, high = PREDICTED
    columns = (
        "stratum", "calls", "within", "refused", "warned", "worst error / tolerance: all", "bright", "dim",
        "median", f"predicted / measured {low:g} to {high:g}", "median", "tables",
    )  # fmt: skip
    rows = [f"| {' | '.join(columns)} |", "| --- " * len(columns) + "|"]
    for name, given in strata(outcomes):
        done = [each for each in given if not each.refusal]
        worst = [max((getattr(each, part) for each in done), default=np.nan) for part in ("whole", "bright", "dim")]
        margins = [each.margin for each in done if each.margin is not None]
        rows.append(
            f"| {name} | {len(given)} | {100.0 * within(given):.1f} % | {len(given) - len(done)} "
            f"| {sum(bool(each.warned) for each in done)} | {' | '.join(f'{each:.2f}' for each in worst)} "
            f"| {np.median([each.ratio for each in done] or [np.nan]):.2f} | {100.0 * told_well(done):.0f} % "
            f"| {np.median(margins or [np.nan]):.1f} | {sum(each.tabled for each in done)} |"
        )
    return rows


def failures(outcomes: list[Outcome]) -> list[str]:
    """What is not within its tolerance, refused or warned of, with all its parameters."""
    rows = []
    for each in outcomes:
        if each.ratio <= 1.0 and not each.warned:
            continue
        what = each.refusal or (
            f"error / tolerance: all {each.whole:.2f}, bright {each.bright:.2f}, dim {each.dim:.2f}, predicted "
            f"{each.predicted:.2f}; Y* {each.white:.1e}, {100.0 * each.share_dim:.0f} % below f"
        )
        warned = f"; warned: {each.warned}" if each.warned else ""
        rows.append(f"- `--index {each.index}`: {each.words}: {what}{warned}")
    return rows


def badly_told(outcomes: list[Outcome]) -> list[str]:
    """Calls whose predicted error is far from the measured one."""
    low, high = PREDICTED
    return [
        f"- `--index {each.index}`: predicted / measured {each.margin:.2g}, measured / tolerance: bright "
        f"{each.bright:.2g}, dim {each.dim:.2g}: {each.words}"
        for each in outcomes
        if each.margin is not None and not low <= each.margin <= high
    ]


def falls_short(outcomes: list[Outcome]) -> list[str]:
    """What the bar asks for and does not get."""
    short = []
    for name, given in strata(outcomes):
        least = SHARE if name == "all" else STRATUM_SHARE
        if within(given) < least:
            short.append(f"{name}: {100.0 * within(given):.1f} % within the tolerance, not {100.0 * least:g} %")
    if beyond := sum(each.ratio > BEYOND for each in outcomes):
        short.append(f"{beyond} beyond {BEYOND:g} times the tolerance, or refused")
    if (share := np.mean([bool(each.warned) for each in outcomes])) > WARNED:
        short.append(f"{100.0 * share:.1f} % warned")
    if (share := told_well(outcomes)) < PREDICTED_SHARE:
        short.append(f"{100.0 * share:.1f} % of the predicted errors are near the measured ones")
    return short


def explain(index: int, seed: int, scan: wd.HeightField | None, layouts: tuple[str, ...]) -> None:
    """Print one call, its worst directions, and what its error becomes if a number is as fine as can be."""
    case = configurations.configuration(index, seed, scan, layouts)
    print(case)
    try:
        result = judge.evaluate(case)
    except Exception as error:
        print(f"{type(error).__name__}: {error}")
        result = judge.evaluate(case, strict=False)
    chosen, weights = judge.drawn(result, np.random.default_rng([seed, index, 1]))
    exact = judge.truth(case, result, chosen)
    moved = (
        judge.figure(judge.truth(case, result, chosen, closer=10.0), exact, weights, white=result.white).value
        / case.tolerance
    )
    found, t, settings = (
        judge.figure(result.xyz[chosen], exact, weights, white=result.white),
        case.tolerance,
        result.plan,
    )
    print(settings)
    print(
        f"error / tolerance: all {found.whole / t:.3g}, bright {found.bright / t:.3g}, dim {found.dim / t:.3g}, "
        f"{100.0 * found.share_dim:.0f} % dim, predicted {settings.error / t:.3g}; Y* {found.white:.2e}; "
        f"{len(chosen)} judged of {len(result.xyz)}, {np.count_nonzero(result.read)} read; a ten times finer truth "
        f"moves by {moved:.1e}; warned: {result.warned or 'no'}"
    )
    finer = {
        "twice the wavelengths, all for all": {"adaptive": False, "wavelengths": 2 * settings.wavelengths - 1},
        "all terms of the low-rank basis": {"method": "low-rank", "terms": 128},
        "all neighbours": {"least_weight": 1e-10 * t},
        "sampled wavelengths": {"nodes": 0, "footprint": False},
    }
    everything = {name: value for change in finer.values() for name, value in change.items()}
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    lights, views = result.to_light[chosen], result.to_view[chosen]
    for name, change in {**finer, "all of these": everything}.items():
        changed = dataclasses.replace(settings, **change)
        again = wd.reflectance(case.heightfield, lights, views, illuminant=case.illuminant, plan=changed)
        each = judge.figure(again, exact, weights, white=result.white)
        print(f"  with {name}: all {each.whole / t:.3g}, bright {each.bright / t:.3g}, dim {each.dim / t:.3g}")
    print("| direction | cos θi | cos θr | (u, v) | w | Y / Y* | error / tolerance | XYZ | truth |")
    print("| --- " * 9 + "|")
    for at in np.argsort(found.errors)[::-1][:8]:
        light, view = lights[at], views[at]
        colours = " | ".join(" ".join(f"{c:.5g}" for c in each[at]) for each in (result.xyz[chosen], exact))
        print(
            f"| {chosen[at]} | {light[2]:.4f} | {view[2]:.4f} | {(light + view)[0]:.4f} {(light + view)[1]:.4f} "
            f"| {light[2] + view[2]:.4f} | {exact[at, 1] / found.white:.2e} | {found.errors[at] / t:.3g} | {colours} |"
        )


def main() -> int:
    """Print the table, and write it to a file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=420, help="calls (420, which is 30 a form and tolerance)")
    parser.add_argument("--seed", type=int, default=0, help="seed of all that is drawn (0)")
    parser.add_argument("--only", choices=configurations.KINDS, help="one form of coherence")
    parser.add_argument("--layouts", nargs="+", choices=set(configurations.LAYOUTS), help="these kinds of call alone")
    parser.add_argument("--index", type=int, nargs="+", help="explain these calls, one after the other")
    parser.add_argument("--output", type=Path, help="file for the table, Markdown")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes, each of one thread (one a core)")
    parser.add_argument("--data", help=inputs.HELP)
    options = parser.parse_args()
    layouts = tuple(options.layouts or configurations.LAYOUTS)
    scan = inputs.levelled_scan(options.data)
    if scan is None:
        print("the scan is not there: synthetic fingers stand in for its crops")
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
    # Processes share the cores among them: each one's linear algebra keeps to one.
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
    short = falls_short(outcomes)
    library, truth = (sum(getattr(each, name) for each in outcomes) for name in ("seconds", "truth_seconds"))
    bar = (
        f"Bar ({100.0 * SHARE:g} % within the tolerance, {100.0 * STRATUM_SHARE:g} % in every stratum, none beyond "
        f"{BEYOND:g} times, {100.0 * WARNED:g} % warned, {100.0 * PREDICTED_SHARE:g} % predicted within "
        f"{PREDICTED[0]:g} to {PREDICTED[1]:g}): {'not met: ' + '; '.join(short) if short else 'met'}."
    )
    circumstances = (
        f"{'With' if scan else 'Without'} crops of the scan. {sum(each.validation_size for each in outcomes)} directions "
        f"judged, all of calls of fewer than {configurations.FEW}, else {judge.COUNT} and more that no plan read. "
        f"{time.perf_counter() - begin:.0f} s. {options.jobs} processes on {platform.machine()}; calls "
        f"{library:.0f} s, truths {truth:.0f} s."
    )
    lines = [
        f"# Honoured tolerance: {len(indices)} random calls, seed {options.seed}", "", bar, "", circumstances, "",
        *table(outcomes), "", "## Not within the tolerance, refused, or warned of", "", *failures(outcomes), "",
        "## Predicted errors far from the measured ones", "", *badly_told(outcomes),
    ]  # fmt: skip
    text = "\n".join(lines) + "\n"
    print("\n" + text)
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    return 1 if short else 0


if __name__ == "__main__":
    sys.exit(main())
