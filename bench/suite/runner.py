"""``python -m bench``: every chart in one run, with its numbers, and what two runs differ in."""

from __future__ import annotations

import csv
import functools
import importlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import subprocess
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import warpdiff as wd
from warpdiff.core.files import atomic_write, check_folder
from warpdiff.device.devices import resolve_device, resolve_threads

# Modules with measure(setting), numbers(found) and chart(found, folder), in the order of the report.
PARTS = ("previews", "pareto", "frames", "rays", "scaling", "stability", "validity")
PACKAGES = (
    "warp-lang", "numpy", "trimesh", "colour-science", "OpenImageIO", "matplotlib", "numba", "drjit", "mitsuba",
    "embreex", "gratinglab", "meent",
)  # fmt: skip
# A figure has moved if it did by more than the rounds of both runs spread, and by more than this.
LEAST_CHANGE = 0.1


@dataclass(frozen=True)
class Setting:
    """How a run is made.

    Attributes:
        quick: Every figure, with few points.
        device: ``"cpu"`` (None) or a CUDA device.
        threads: On the CPU, for ours and for peers.
        data: Folder with real inputs; None is where they are found by default.
        rounds: Timed rounds, in which everything takes turns.
    """

    quick: bool
    device: str | None
    threads: int
    data: Path | None
    rounds: int

    @staticmethod
    def say(what: str) -> None:
        """Say what is being done."""
        print(f"[{time.strftime('%H:%M:%S')}] {what}", flush=True)


def run(
    folder: Path,
    *,
    quick: bool = False,
    parts: list[str] | None = None,
    device: str | None = None,
    threads: int | None = None,
    data: Path | None = None,
) -> Path:
    """Measure, write ``results.json`` and ``results.csv``, draw, and report.

    Args:
        folder: Where to.
        quick: Some two minutes, with few points.
        parts: Which of ``PARTS``; None is all.
        device: ``"cpu"`` (None) or a CUDA device.
        threads: Threads on the CPU; None is one a core.
        data: Folder with real inputs.

    Returns:
        The report, a Markdown file with the figures and a finding below each.
    """
    unknown = sorted(set(parts or ()) - set(PARTS))
    if unknown:
        raise ValueError(f"filter must name some of {', '.join(PARTS)}, got {', '.join(unknown)}")
    if importlib.util.find_spec("matplotlib") is None:
        raise ValueError("charts require matplotlib, which is not installed: pip install -e '.[bench]'")
    resolve_device(device)
    # What is kept on disk would hide what comes before a first frame.
    os.environ["WARPDIFF_CACHE_DIR"] = ""
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    setting = Setting(quick, device, resolve_threads(threads), data, 3 if quick else 5)
    results: dict[str, Any] = {"machine": machine(setting), "seconds": {}, "figures": {}, "findings": {}}
    folder.mkdir(parents=True, exist_ok=True)
    check_folder(folder, "output")
    for name in PARTS:
        if parts and name not in parts:
            continue
        module = importlib.import_module(f"bench.suite.{name}")
        begin = time.perf_counter()
        found = module.measure(setting)
        results["figures"] |= module.numbers(found)
        results["findings"] |= module.chart(found, folder)
        results["seconds"][name] = round(time.perf_counter() - begin, 1)
        # After each part, or a later one that fails would take all with it.
        write(folder / "results.json", json.dumps(results, indent=1, default=_plain) + "\n")
        write_csv(folder / "results.csv", results["figures"])
        write(folder / "report.md", report(results))
    return folder / "report.md"


def machine(setting: Setting) -> dict[str, Any]:
    """Where and with what a run was made."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "absent"
    return {
        "warpdiff": wd.__version__,
        "commit": commit(),
        "processor": processor(),
        "cores": os.cpu_count(),
        "device": str(resolve_device(setting.device)),
        "threads": setting.threads,
        "system": platform.system(),
        "python": platform.python_version(),
        "packages": versions,
        "quick": setting.quick,
        "date": time.strftime("%Y-%m-%d %H:%M"),
    }


def processor() -> str:
    """Its name."""
    info = Path("/proc/cpuinfo")
    names = [line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")] \
        if info.is_file() else []  # fmt: skip
    return names[0] if names else platform.processor() or platform.machine()


def commit() -> str:
    """The checkout's commit, with a plus if it was changed; an empty string without git."""
    git = functools.partial(
        subprocess.run, cwd=Path(__file__).parent, capture_output=True, text=True, check=False, timeout=20
    )
    try:
        head = git(["git", "rev-parse", "--short", "HEAD"]).stdout.strip()
        changed = git(["git", "status", "--porcelain", "--untracked-files=no"]).stdout.strip()
    except OSError:
        return ""
    return head + ("+" if changed and head else "")


def write(path: Path, text: str) -> None:
    """Write a file under another name until it is whole."""
    with atomic_write(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def write_csv(path: Path, numbers: dict[str, list[Any]]) -> None:
    """One figure a line."""
    with atomic_write(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("figure", "value", "least", "most", "unit"))
        writer.writerows((name, *each) for name, each in numbers.items())


def report(results: dict[str, Any]) -> str:
    """Figures with their findings."""
    held = results["machine"]
    seconds = ", ".join(f"{name} {s:.0f} s" for name, s in results["seconds"].items())
    made_by = f"warpdiff {held['warpdiff']}" + (f" at {held['commit']}" if held["commit"] else "")
    where = f"{held['processor']}, {held['device']}, {held['threads']} threads"
    lines = ["# Speed against accuracy", "", f"{made_by}, {where}, {held['date']}. It took {seconds}."]
    for name, finding in results["findings"].items():
        lines += ["", f"![{name}]({name}.png)", "", finding]
    return "\n".join(lines) + "\n"


def compare(old: Path, new: Path) -> list[str]:
    """Which figures of two runs differ by more than their noise, the most changed first.

    Args:
        old: A ``results.json``.
        new: Another.

    Returns:
        Lines, the first a summary.
    """
    before, after = (_read(path) for path in (old, new))
    moved, both = [], [name for name in before if name in after]
    for name in both:
        (value, least, most, unit), (value2, least2, most2, _) = before[name], after[name]
        if value <= 0.0 or value2 <= 0.0:
            change, noise = (0.0, 1.0) if value == value2 else (float("inf"), 0.0)
        else:
            change = abs(np.log(value2 / value))
            noise = np.log(max(most, value) / min(least, value)) + np.log(max(most2, value2) / min(least2, value2))
        if change > max(noise, np.log1p(LEAST_CHANGE)):
            ratio = value2 / value if value else float("inf")
            moved.append((change, f"{name}: {value:.3g} to {value2:.3g} {unit}, {ratio:.2f} times"))
    moved.sort(key=lambda each: -each[0])
    missing = [f"no longer there: {name}" for name in before if name not in after]
    added = [f"new: {name}" for name in after if name not in before]
    summary = f"{len(moved)} of {len(both)} figures moved by more than their noise and {100 * LEAST_CHANGE:.0f} %."
    return [summary, *(line for _, line in moved), *missing, *added]


def _read(path: Path) -> dict[str, list[Any]]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8"))["figures"])
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} does not exist: give the results.json of two runs") from None
    except (json.JSONDecodeError, KeyError, TypeError):
        raise ValueError(f"{path} is not the results.json of a run of python -m bench") from None


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not written")
