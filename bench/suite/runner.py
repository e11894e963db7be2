"""The run of ``python -m bench``, which makes all charts and their numbers, and the comparison of two such runs."""

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
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from warpdiff.core.files import atomic_write, check_folder
from warpdiff.device.devices import resolve_device, resolve_threads

if TYPE_CHECKING:
    from collections.abc import Callable

# Modules of the charts in the order of the report. Each module has the functions measure(setting), numbers(results) and
# chart(results, folder).
PARTS = ("previews", "pareto", "frames", "rays", "scaling", "stability", "validity")
PACKAGES = (
    "warp-lang", "numpy", "trimesh", "colour-science", "OpenImageIO", "matplotlib", "numba", "drjit", "mitsuba",
    "embreex", "gratinglab",
)  # fmt: skip
# Smallest relative change of a benchmark result between two runs at which the comparison lists the result. The change
# must also exceed the spread over the timed rounds of both runs. The value was chosen because smaller changes are noise
# of the machine.
LEAST_CHANGE = 0.1


@dataclass(frozen=True)
class Setting:
    """Settings of a run of ``python -m bench``.

    Attributes:
        quick: Whether charts have few points, so that a run takes about two minutes.
        device: ``"cpu"`` (None) or a CUDA device.
        threads: Number of CPU threads, for warpdiff and for peers (other programs).
        data: Folder of the measured height fields; None means the default folder.
        rounds: Number of timed rounds, in each of which every call is timed once.
        user_peers: Methods that the user supplies, by name: functions ``prepare(heightfield, coherence)``, see
            ``user_peer``.
    """

    quick: bool
    device: str | None
    threads: int
    data: Path | None
    rounds: int
    user_peers: dict[str, Callable[..., Any]] = field(default_factory=dict)

    @staticmethod
    def say(what: str) -> None:
        """Print a message with the time of day."""
        print(f"[{time.strftime('%H:%M:%S')}] {what}", flush=True)


def run(
    folder: Path, *, quick: bool = False, parts: list[str] | None = None, device: str | None = None,
    threads: int | None = None, data: Path | None = None, peer: str | None = None,
) -> Path:  # fmt: skip
    """Measure the numbers of all charts, write ``results.json`` and ``results.csv``, draw charts, and write a report.

    Args:
        folder: Folder of the results.
        quick: Whether charts have few points; a run then takes about two minutes.
        parts: Names of the charts to make, from ``PARTS``; None makes all.
        device: ``"cpu"`` (None) or a CUDA device.
        threads: Number of CPU threads; None means one per core.
        data: Folder of the measured height fields; None means the default folder.
        peer: Method that the user supplies, as ``"module:function"``; see ``user_peer``.

    Returns:
        The path of the report, a Markdown file with the charts and a sentence about the result below each.
    """
    unknown = sorted(set(parts or ()) - set(PARTS))
    if unknown:
        raise ValueError(f"--filter must name parts out of {', '.join(PARTS)}, got {', '.join(unknown)}")
    if importlib.util.find_spec("matplotlib") is None:
        raise ValueError("charts require matplotlib, which is not installed: pip install -e '.[bench]'")
    resolve_device(device)
    # The disk cache of the library is disabled, because it would shorten the preparation of a first frame.
    os.environ["WARPDIFF_CACHE_DIR"] = ""
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    setting = Setting(quick, device, resolve_threads(threads), data, 3 if quick else 5, user_peer(peer))
    results: dict[str, Any] = {"machine": machine(setting), "seconds": {}, "figures": {}, "findings": {}}
    folder.mkdir(parents=True, exist_ok=True)
    check_folder(folder, "output")
    for name in PARTS:
        if parts and name not in parts:
            continue
        module = importlib.import_module(f"bench.suite.{name}")
        begin = time.perf_counter()
        part_results = module.measure(setting)
        results["figures"] |= module.numbers(part_results)
        results["findings"] |= module.chart(part_results, folder)
        results["seconds"][name] = round(time.perf_counter() - begin, 1)
        # Files are written after each chart, so that a later exception loses no results.
        write(folder / "results.json", json.dumps(results, indent=1, default=_plain) + "\n")
        write_csv(folder / "results.csv", results["figures"])
        write(folder / "report.md", report(results))
    return folder / "report.md"


def user_peer(text: str | None) -> dict[str, Callable[..., Any]]:
    """Import a method that the user supplies, for comparison with the peers (other programs).

    Args:
        text: ``"module:function"``. The function takes a height field and a coherence, and returns a function
            ``shade(scattering_vectors, gains, threads)``. The arguments of ``shade`` are scattering vectors (u, v, w)
            of shape (n, 3), geometry factors (gains) of shape (n,) and the number of threads. ``shade`` returns linear
            XYZ (n, 3): ``gains`` times the colours that ``warpdiff.reflectance`` would return for gains of 1. The
            function raises ``ValueError`` for an unsupported coherence.

    Returns:
        The function by its name.
    """
    if text is None:
        return {}
    module, _, name = text.partition(":")
    try:
        function = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"--peer must be module:function, such as mine:prepare, got {text}: {error}") from error
    if not callable(function):
        raise ValueError(  # noqa: TRY004 (of the command line)
            f"--peer must name a function, got {text}, a {type(function).__name__}"
        )
    return {f"{module}:{name}": function}


def machine(setting: Setting) -> dict[str, Any]:
    """Return a description of the machine and the versions of the packages."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "absent"
    return {
        "warpdiff": wd.__version__, "commit": commit(), "processor": processor(), "cores": os.cpu_count(),
        "device": str(resolve_device(setting.device)), "threads": setting.threads, "system": platform.system(),
        "python": platform.python_version(), "packages": versions, "quick": setting.quick,
        "date": time.strftime("%Y-%m-%d %H:%M"),
    }  # fmt: skip


def processor() -> str:
    """Return the name of the processor."""
    info = Path("/proc/cpuinfo")
    names = [line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")] \
        if info.is_file() else []  # fmt: skip
    return names[0] if names else platform.processor() or platform.machine()


def commit() -> str:
    """Return the commit of the checkout, with a plus sign if files have changed.

    Without git, return an empty string.
    """
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
    """Write a file atomically."""
    with atomic_write(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def write_csv(path: Path, numbers: dict[str, list[Any]]) -> None:
    """Write the numbers of a run to a CSV file, one number per line."""
    with atomic_write(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("figure", "value", "least", "most", "unit"))
        writer.writerows((name, *values) for name, values in numbers.items())


def report(results: dict[str, Any]) -> str:
    """Return the text of the report: the charts, with a sentence about the result below each chart."""
    machine = results["machine"]
    seconds = ", ".join(f"{name} {s:.0f} s" for name, s in results["seconds"].items())
    made_by = f"warpdiff {machine['warpdiff']}" + (f" at {machine['commit']}" if machine["commit"] else "")
    where = f"{machine['processor']}, {machine['device']}, {machine['threads']} threads"
    lines = ["# Speed against accuracy", "", f"{made_by}, {where}, {machine['date']}. Duration: {seconds}."]
    for name, finding in results["findings"].items():
        lines += ["", f"![{name}]({name}.png)", "", finding]
    return "\n".join(lines) + "\n"


def compare(old: Path, new: Path) -> list[str]:
    """Return the numbers that differ between two runs by more than the noise, the largest change first.

    Args:
        old: Path of the first ``results.json``.
        new: Path of the second ``results.json``.

    Returns:
        Lines of text: a summary, then one line per changed, removed or new number.
    """
    before, after = (_read(path) for path in (old, new))
    changed, both = [], [name for name in before if name in after]
    for name in both:
        (value, least, most, unit), (value2, least2, most2, _) = before[name], after[name]
        if value <= 0.0 or value2 <= 0.0:
            change, noise = (0.0, 1.0) if value == value2 else (float("inf"), 0.0)
        else:
            change = abs(np.log(value2 / value))
            noise = np.log(max(most, value) / min(least, value)) + np.log(max(most2, value2) / min(least2, value2))
        if change > max(noise, np.log1p(LEAST_CHANGE)):
            ratio = value2 / value if value else float("inf")
            changed.append((change, f"{name}: {value:.3g} to {value2:.3g} {unit}, {ratio:.2f} times"))
    changed.sort(key=lambda change: -change[0])
    missing = [f"removed: {name}" for name in before if name not in after]
    added = [f"new: {name}" for name in after if name not in before]
    summary = f"{len(changed)} of {len(both)} figures changed by more than their noise and {100 * LEAST_CHANGE:.0f} %."
    return [summary, *(line for _, line in changed), *missing, *added]


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
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")
