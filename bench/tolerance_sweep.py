"""Honoured tolerance: random calls of ``reflectance`` against the float64 reference, as a table by stratum.

A configuration is a call with 128 directions, a stratum a coherence form at a tolerance. Its error is the design's, of
directions for pixels: the larger of the 99th percentiles of ‖ΔXYZ‖ / max(‖XYZ‖, f) where Y >= f and of ‖ΔXYZ‖ / f
elsewhere, f a thousandth of the 99th percentile of Y. An exception or a warning in place of a result is a miss. Dark
configurations, whose f would lie below the 1e-10 of a mirror that the reference resolves, are judged with that for f,
and told apart.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import itertools
import math
import os
import platform
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np

import warpdiff as wd
from warpdiff import demo, planning
from warpdiff.bench import configurations, inputs, reference

# Where f, a thousandth of this, is less than what the reference settles to.
DARK = 1e3 * configurations.LEAST
# The bar: shares of configurations within the tolerance, in all and in every stratum, and how far beyond any may be.
SHARE, STRATUM_SHARE, BEYOND = 0.99, 0.95, 3.0
# A predicted error is at most so many times the measured one.
PREDICTED = 10.0


class Outcome(NamedTuple):
    """What became of a configuration."""

    index: int
    stratum: tuple[str, float]
    words: str
    ratio: float  # error over tolerance; infinite without a result
    bright: float  # the same of directions with Y >= f
    dim: float  # and of those with Y < f
    share_dim: float
    predicted: float  # predicted error over tolerance; 0 without a plan
    white: float  # percentile 99 of Y
    refusal: str  # the exception or the warning in place of a result
    tabled: bool  # whether a table was taken
    seconds: float
    truth_seconds: float

    @property
    def is_dark(self) -> bool:
        """Whether next to no light is seen."""
        return self.white < DARK


def load_scan(data: str | None) -> wd.HeightField | None:
    """The levelled scan, where it is present."""
    folder = demo.data_folder(data)
    if folder is None or not (folder / demo.SCAN).is_file():
        return None
    scan = wd.HeightField.load(
        folder / demo.SCAN, extent_um=demo.SCAN_EXTENT_UM, height_range_um=demo.SCAN_HEIGHT_RANGE_UM
    )
    return scan.levelled(order=2)


def true_colours(case: configurations.Configuration, tolerance: float, kept: Path | None) -> np.ndarray:
    """XYZ by the reference, from a folder where it is kept there."""
    key = hashlib.sha256(Path(reference.__file__).read_bytes())
    for part in (case.hf.heights_um, np.array(case.hf.pitch_um), case.to_light, case.to_view):
        key.update(np.ascontiguousarray(part).tobytes())
    key.update(repr((case.coherence, case.illuminant, tolerance)).encode())
    file = kept / f"{key.hexdigest()[:32]}.npy" if kept else None
    if file and file.is_file():
        return np.asarray(np.load(file))
    found = reference.reference_reflectance(
        case.hf, case.to_light, case.to_view, case.coherence, tolerance=tolerance, illuminant=case.illuminant
    )
    if file:
        np.save(file, found)
    return np.asarray(found)


def run(index: int, seed: int, scan: wd.HeightField | None, kept: Path | None) -> Outcome:
    """Compute a configuration and its truth."""
    case = configurations.configuration(index, seed, scan)
    refusal, predicted, xyz, tabled = "", 0.0, None, False
    begin = time.perf_counter()
    warnings.simplefilter("error", wd.WarpdiffWarning)
    try:
        xyz = wd.reflectance(**case.arguments, threads=1)
    except Exception as error:
        refusal = f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - begin
    if xyz is not None:
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        plan = wd.plan(**case.arguments, threads=1, strict=False)
        predicted, tabled = plan.error / case.tolerance, plan.nodes > 0
    begin = time.perf_counter()
    truth = true_colours(case, configurations.truth_tolerance(case.tolerance), kept)
    truth_seconds = time.perf_counter() - begin
    found = configurations.figure(np.full_like(truth, np.inf) if xyz is None else xyz, truth)
    return Outcome(
        index, case.stratum, str(case), found.value / case.tolerance, found.bright / case.tolerance,
        found.dim / case.tolerance, found.share_dim, predicted, found.white, refusal, tabled, seconds, truth_seconds,
    )  # fmt: skip


_worker: dict[str, object] = {}


def start_worker(seed: int, data: str | None, kept: Path | None, many: bool) -> None:
    """Give a process what all its configurations share."""
    if many:
        planning._REPEATS = math.inf
    _worker.update(seed=seed, scan=load_scan(data), kept=kept)


def work(index: int) -> Outcome:
    """One configuration in a process."""
    return run(index, **_worker)  # type: ignore[arg-type]


def table(outcomes: list[Outcome]) -> list[str]:
    """Rows by stratum and one of all, in Markdown."""
    columns = (
        "coherence", "tolerance", "configurations", "within", "refused", "worst error / tolerance", "median",
        "predicted / measured: median", "P10 to P90", "1 to 10", "dark: configurations, within, refused",
    )  # fmt: skip
    rows = [f"| {' | '.join(columns)} |", "| --- " * len(columns) + "|"]
    for stratum in [*configurations.STRATA, None]:
        given = [each for each in outcomes if stratum in (None, each.stratum)]
        if not given:
            continue
        used = [each for each in given if not each.is_dark]
        dark = [each for each in given if each.is_dark]
        done = [each for each in used if not each.refusal]
        name = f"{stratum[0]} | {stratum[1]:g}" if stratum else "all | "
        dark_within = sum(each.ratio <= 1.0 for each in dark)
        dark_cell = f"{len(dark)}, {dark_within}, {sum(bool(each.refusal) for each in dark)}"
        if not done:
            rows.append(f"| {name} | {len(used)} | 0.0 % | {len(used)} | | | | | | {dark_cell} |")
            continue
        ratios = np.array([each.ratio for each in done])
        within = np.count_nonzero(ratios <= 1.0) / len(used)
        margins = np.array([each.predicted / max(each.ratio, 1e-12) for each in done])
        tight = np.mean((margins >= 1.0) & (margins <= PREDICTED))
        low, middle, high = np.percentile(margins, [10.0, 50.0, 90.0])
        rows.append(
            f"| {name} | {len(used)} | {100.0 * within:.1f} % | {len(used) - len(done)} | {ratios.max():.2f} "
            f"| {np.median(ratios):.2f} | {middle:.1f} | {low:.1f} to {high:.1f} | {100.0 * tight:.0f} % "
            f"| {dark_cell} |"
        )
    return rows


def failures(outcomes: list[Outcome]) -> list[str]:
    """What is not within its tolerance, with all its parameters."""
    rows = []
    for each in outcomes:
        if each.ratio <= 1.0 and not each.refusal:
            continue
        what = each.refusal or (
            f"error / tolerance {each.ratio:.2f} (bright {each.bright:.2f}, dim {each.dim:.2f}), predicted "
            f"{each.predicted:.2f}"
        )
        dark = "dark, " if each.is_dark else ""
        rows.append(
            f"- `--index {each.index}` ({dark}percentile 99 of Y {each.white:.1e}, {100.0 * each.share_dim:.0f} % "
            f"below f): {each.words}: {what}"
        )
    return rows


def meets_bar(outcomes: list[Outcome]) -> list[str]:
    """What the bar asks for and does not get."""
    used = [each for each in outcomes if not each.is_dark]
    short = []
    share = np.mean([each.ratio <= 1.0 for each in used])
    if share < SHARE:
        short.append(f"{100.0 * share:.2f} % within the tolerance, not {100.0 * SHARE:g} %")
    if beyond := sum(each.ratio > BEYOND for each in used):
        short.append(f"{beyond} beyond {BEYOND:g} times the tolerance, or refused")
    for stratum in configurations.STRATA:
        inside = [each.ratio <= 1.0 for each in used if each.stratum == stratum]
        if inside and np.mean(inside) < STRATUM_SHARE:
            short.append(f"{stratum[0]} at {stratum[1]:g}: {100.0 * np.mean(inside):.1f} %")
    return short


def explain(index: int, seed: int, scan: wd.HeightField | None, kept: Path | None) -> None:
    """Print one configuration, its worst directions, and what its error becomes if a number is as fine as can be."""
    case = configurations.configuration(index, seed, scan)
    print(case)
    asked = configurations.truth_tolerance(case.tolerance)
    truth = true_colours(case, asked, kept)
    moved = configurations.figure(true_colours(case, 0.1 * asked, kept), truth).value / case.tolerance
    try:
        warnings.simplefilter("error", wd.WarpdiffWarning)
        xyz = wd.reflectance(**case.arguments)
        settings = wd.plan(**case.arguments)
    except Exception as error:
        print(f"{type(error).__name__}: {error}")
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        xyz = wd.reflectance(**case.arguments, strict=False)
        settings = wd.plan(**case.arguments, strict=False)
    found = configurations.figure(xyz, truth)
    print(settings)
    print(
        f"error / tolerance {found.value / case.tolerance:.3g} (bright {found.bright / case.tolerance:.3g}, dim "
        f"{found.dim / case.tolerance:.3g}, {100.0 * found.share_dim:.0f} % dim), predicted "
        f"{settings.error / case.tolerance:.3g}; percentile 99 of Y {found.white:.2e}; a ten times finer truth moves "
        f"by {moved:.1e}"
    )
    finer = {
        "twice the wavelengths, all for all": {"adaptive": False, "wavelengths": 2 * settings.wavelengths - 1},
        "all terms of the low-rank basis": {"method": "low-rank", "terms": 128},
        "all neighbours": {"least_weight": 1e-10 * case.tolerance},
    }
    everything = {name: value for change in finer.values() for name, value in change.items()}
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    for name, change in {**finer, "all of these": everything}.items():
        again = wd.reflectance(
            case.hf, case.to_light, case.to_view, illuminant=case.illuminant,
            plan=dataclasses.replace(settings, **change),
        )  # fmt: skip
        print(f"  with {name}: {configurations.figure(again, truth).value / case.tolerance:.3g}")
    print("| direction | cos θi | cos θr | (u, v) | w | Y / percentile 99 | error / tolerance | XYZ | truth |")
    print("| --- " * 9 + "|")
    for at in np.argsort(found.errors)[::-1][:8]:
        light, view = case.to_light[at], case.to_view[at]
        across = np.hypot(*(light + view)[:2])
        colours = " | ".join(" ".join(f"{c:.5g}" for c in each[at]) for each in (xyz, truth))
        print(
            f"| {at} | {light[2]:.4f} | {view[2]:.4f} | {across:.4f} | {light[2] + view[2]:.4f} "
            f"| {truth[at, 1] / found.white:.2e} | {found.errors[at] / case.tolerance:.3g} | {colours} |"
        )


def main() -> int:
    """Print the table, and write it to a file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=588, help="configurations (588, which is 42 a stratum)")
    parser.add_argument("--seed", type=int, default=0, help="seed of all that is drawn (0)")
    parser.add_argument("--only", choices=configurations.KINDS, help="one form of coherence")
    parser.add_argument("--index", type=int, nargs="+", help="explain these configurations, one after the other")
    parser.add_argument("--output", type=Path, help="file for the table, Markdown")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes, each of one thread (one a core)")
    parser.add_argument("--data", help=inputs.HELP)
    parser.add_argument("--truths", type=Path, help="folder that keeps what the reference computed for the next run")
    parser.add_argument("--many", action="store_true", help="plan as for so many directions that a table pays")
    options = parser.parse_args()
    if options.truths:
        options.truths.mkdir(parents=True, exist_ok=True)
    scan = load_scan(options.data)
    if scan is None:
        print(f"{demo.SCAN} is not there: synthetic fingers stand in for its crops")
    if options.index is not None:
        for index in options.index:
            print(f"--index {index}: ", end="")
            explain(index, options.seed, scan, options.truths)
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
        options.jobs, get_context("spawn"), start_worker, (options.seed, options.data, options.truths, options.many)
    ) as pool:
        for done in pool.map(work, indices):
            outcomes.append(done)
            if done.ratio > 1.0 or done.refusal or len(outcomes) % 50 == 0:
                result = f"refused, {done.refusal[:70]}…" if done.refusal else f"error / tolerance {done.ratio:.2f}"
                print(
                    f"{len(outcomes)} of {len(indices)}, {time.perf_counter() - begin:.0f} s: --index {done.index}, "
                    f"{done.stratum[0]} at {done.stratum[1]:g}: {result}",
                    flush=True,
                )
    short = meets_bar(outcomes)
    verdict = "not met: " + "; ".join(short) if short else "met"
    library, truth = (sum(getattr(each, name) for each in outcomes) for name in ("seconds", "truth_seconds"))
    bar = (
        f"Bar ({100.0 * SHARE:g} % within the tolerance, {100.0 * STRATUM_SHARE:g} % in every stratum, none beyond "
        f"{BEYOND:g} times): {verdict}."
    )
    circumstances = (
        f"{'With' if scan else 'Without'} crops of the scan. Directions a configuration: {configurations.DIRECTIONS}. "
        f"Dark: percentile 99 of Y below {DARK:g}, and no part of the bar. {time.perf_counter() - begin:.0f} s. "
        f"{sum(each.tabled for each in outcomes)} took a table. "
        f"{options.jobs} processes on {platform.machine()}; calls {library:.0f} s, truths {truth:.0f} s."
    )
    lines = [
        f"# Honoured tolerance: {len(indices)} random configurations, seed {options.seed}",
        "",
        bar,
        "",
        circumstances,
        "",
        *table(outcomes),
        "",
        "## Not within the tolerance",
        "",
        *failures(outcomes),
    ]
    text = "\n".join(lines) + "\n"
    print("\n" + text)
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    return 1 if short else 0


if __name__ == "__main__":
    sys.exit(main())
