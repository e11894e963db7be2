"""Comparison of computing times of two wheels: frames, points, plans, cold starts, import and help.

::

    python -m bench.dev.baseline --folder before
    python -m bench.dev.baseline --folder after --commit HEAD --versions-of before
    python -m bench.dev.wheel_times --before before/bin/python --after after/bin/python --output times.json

The printed table has one row per task. Each round starts a new process for each wheel. For every task, the two
processes execute the same call in turns; the wheel that begins alternates. Each pair of calls gives a ratio: the time
of the wheel ``--after`` divided by the time of the wheel ``--before``. The ratio of a round is the median over its
pairs. Tasks that start a process per call (cold start, import, help) are timed in the same manner. The ratio of a task
is the median over rounds. The confidence interval of this median, of at least 95 %, is that of order statistics, which
assumes no distribution. Rounds are added until the interval of each task is within ±``--half-width``, or until their
number is ``--most-rounds``.

First, the wheel ``--before`` is compared with itself by the same procedure. The deviation of these ratios from 1 is the
noise of the measurement. Kernels are compiled in advance, into a folder in each wheel's environment. Nothing else is
cached on disk.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    Call = Callable[[int], object]
    Timed = Callable[[int], "Seconds"]

ROOT = Path(__file__).resolve().parents[2]
CLOCKS = ("wall", "cpu")
# Least number of rounds of timing for which order statistics give a confidence interval of 95 %. The number follows
# from probability: all of 6 values lie on the same side of the true median with the probability 2 · 0.5⁶, which is less
# than 5 %.
FEWEST_ROUNDS = 6
# Time that the calls of one task with one wheel should take together in a round [s], and the smallest and largest
# number of these calls.
SECONDS_PER_ROW, FEWEST_CALLS, MOST_CALLS = 0.6, 3, 25
# Number of directions of a timed call.
DIRECTIONS = 100_000

COLD_START = """
import warpdiff as wd
surface = wd.gratings.fingers(size_um=25.6, pitch_um=0.09, seed=2)
view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=320, height=240)
image = wd.shade(wd.meshes.tube(), surface, wd.DirectionalLight((0.1, 0.9, 1.2)), view, tolerance=1e-1)
image.save("first.png")
"""


class Seconds(NamedTuple):
    """Wall-clock time and processor time of one call [s]."""

    wall: float
    cpu: float


# Tasks that are timed in a worker process, one per row of the printed table.


def worker_rows(threads: int | None) -> dict[str, Callable[[], Call]]:
    """Return functions that prepare the timed calls of the tasks, by name of the task.

    A prepared call is a function. Its argument counts the calls of the task.

    Frames have 640 × 480 pixels unless the task's name states another size. Light and camera move from frame to frame.
    """
    from bench.dev.public_names import wd

    def surface() -> Any:
        return wd.gratings.fingers(size_um=25.6, pitch_um=0.09, seed=2)

    def moving(body: Any, *, width: int = 640, diameter_deg: float = 0.0) -> Callable[[int], tuple[Any, Any]]:
        low, high = body.bounds
        centre, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0

        def at(k: int) -> tuple[Any, Any]:
            towards = np.array([3.1 * np.sin(0.1 * k), 1.6, 3.1 * np.cos(0.1 * k)])
            eye = centre + towards / np.linalg.norm(towards) * 2.6 * radius
            view = wd.View(tuple(eye), tuple(centre), fov_y_deg=24.0, width=width, height=3 * width // 4)
            to_light = (0.1 + 0.05 * np.sin(k), 0.9, 1.2)
            return wd.DirectionalLight(to_light, angular_diameter_deg=diameter_deg), view

        return at

    def frames(
        make_body: Callable[[], Any], *, width: int = 640, diameter_deg: float = 0.0, **options: Any
    ) -> Callable[[], Call]:
        def prepare() -> Call:
            body = make_body()
            at = moving(body, width=width, diameter_deg=diameter_deg)
            renderer = wd.Renderer(body, surface(), *at(0), threads=threads, **options)
            return lambda k: renderer.draw(*at(k))

        return prepare

    def moving_light() -> Call:
        body = wd.meshes.tube()
        at = moving(body)
        renderer = wd.Renderer(body, surface(), *at(0), threads=threads, tolerance=1e-1)
        return lambda k: renderer.draw(at(k)[0])

    def sky() -> Call:
        body = wd.meshes.tube()
        at = moving(body, width=64)
        up = np.linspace(1.0, -1.0, 32)[:, None, None]
        environment = wd.Environment(np.broadcast_to(1.2 + up, (32, 64, 3)), directions=200)
        options = {"threads": threads, "tolerance": 1e-1, "refine": False}
        renderer = wd.Renderer(body, surface(), environment, at(0)[1], **options)
        return lambda k: renderer.draw(environment, at(k)[1])

    def points() -> Call:
        rng = np.random.default_rng(0)
        vectors = rng.normal(size=(2, DIRECTIONS, 3))
        vectors[..., 2] = np.abs(vectors[..., 2]) + 0.1
        heights = surface()
        return lambda _: wd.reflectance(heights, *vectors, threads=threads)

    def plans(coherence: Any, heights: Any, **options: Any) -> Callable[[], Call]:
        # The package caches the plan (numbers of wavelengths and terms) of a height field. Each call therefore makes a
        # new height field.
        return lambda: (
            lambda _: wd.plan(
                wd.HeightField(heights.heights_um, heights.pitch_um), coherence=coherence, threads=threads, **options
            )
        )

    def picture() -> Call:
        body, heights = wd.meshes.tube(), surface()
        light, view = moving(body, width=160)(0)
        return lambda _: wd.shade(
            body, wd.HeightField(heights.heights_um, heights.pitch_um), light, view, tolerance=3e-2, threads=threads
        )

    small = wd.gratings.fingers(size_um=12.8, pitch_um=0.09, seed=5)
    return {
        "frame: snake, unrefined": frames(wd.meshes.snake, tolerance=3e-2, refine=False),
        "frame: snake at 1e-1": frames(wd.meshes.snake, tolerance=1e-1),
        "frame: snake at 3e-2, 320 × 240": frames(wd.meshes.snake, width=320, tolerance=3e-2),
        "frame: tube at 1e-1": frames(wd.meshes.tube, tolerance=1e-1),
        "frame: tube, disc light of 3°, 320 × 240": frames(wd.meshes.tube, width=320, tolerance=1e-1, diameter_deg=3.0),
        "frame: tube, moving light": moving_light, "frame: tube under a sky, 64 × 48": sky,
        "points: 100,000 directions": points, "plan: averaged": plans(wd.Coherence(), surface()),
        "plan: averaged at 1e-1": plans(wd.Coherence(), small, tolerance=1e-1),
        "plan: centred": plans(wd.Coherence("centred"), small, tolerance=3e-2),
        "plan: source": plans(wd.Coherence("source"), small, tolerance=3e-2),
        "plan: periods": plans(wd.Coherence("replicas", periods=(4, 4)), small, tolerance=3e-2),
        "picture of a new height field": picture,
    }  # fmt: skip


# Tasks whose calls start a process, with the number of calls per round and the arguments of Python.

PROCESS_ROWS: dict[str, tuple[int, list[str]]] = {
    "process: first picture": (2, ["-c", COLD_START]),
    "process: import warpdiff": (5, ["-c", "import warpdiff"]),
    "process: from warpdiff import *": (3, ["-c", "from warpdiff import *"]),
    "process: warpdiff --help": (5, ["-m", "warpdiff", "--help"]),
}


def timed(call: Call, k: int) -> Seconds:
    """Return the wall-clock time and the processor time of one call."""
    wall, cpu = time.perf_counter(), time.process_time()
    call(k)
    return Seconds(time.perf_counter() - wall, time.process_time() - cpu)


def work(threads: int | None) -> None:
    """Run the worker process: write the names of its tasks, then time one call for each line of stdin.

    Each line is the name of a task to prepare, or the number of the next call of the prepared task.
    """
    # This process writes its answers to its stdout. Output of libraries is discarded, because it would mix with the
    # answers.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    rows = worker_rows(threads)
    print(json.dumps(list(rows)), file=answers, flush=True)
    call: Call = print
    for line in sys.stdin:
        text = line.strip()
        if text in rows:
            call = rows[text]()
            # The first call of a task is not timed, because this call also makes tables and loads compiled kernels.
            call(0)
            answer = timed(call, 1)
        else:
            answer = timed(call, int(text))
        print(json.dumps(answer), file=answers, flush=True)


# Functions of the parent process, which compares the wheels.


@dataclass(frozen=True)
class Wheel:
    """A wheel that is installed in a virtual environment.

    Attributes:
        python: Path of the Python program of the environment.
        threads: Number of threads of all calls; None means one per core.
    """

    python: Path
    threads: int | None

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables of the wheel's processes.

        The wheel has its own cache folder for compiled kernels, and nothing else is cached on disk.
        """
        cache = self.python.parent.parent / "kernel_cache"
        return os.environ | {"WARP_CACHE_PATH": str(cache), "WARPDIFF_CACHE_DIR": "", "PYTHONPATH": ""}

    def run(self, arguments: Sequence[str]) -> Seconds:
        """Return the times of a Python process from its start to its end; the process runs in an empty folder."""
        with tempfile.TemporaryDirectory() as folder:
            wall, cpu = time.perf_counter(), _children_cpu()
            subprocess.run(
                [self.python, *arguments], cwd=folder, env=self.environment, check=True, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )  # fmt: skip
            return Seconds(time.perf_counter() - wall, _children_cpu() - cpu)


class Worker:
    """A process that times calls of the library from one wheel, until the ``with`` block ends.

    Attributes:
        rows: Names of the tasks that the process can time.
    """

    def __init__(self, wheel: Wheel) -> None:
        command = [str(wheel.python), "-W", "ignore", "-m", "bench.dev.wheel_times", "--worker"]
        command += [] if wheel.threads is None else ["--threads", str(wheel.threads)]
        self._python = wheel.python
        self._process = subprocess.Popen(
            command, cwd=ROOT, env=wheel.environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self.rows: list[str] = self._answer()

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def ask(self, text: object) -> None:
        """Send a request to the process: the name of a task to prepare, or the number of a call to time."""
        print(text, file=self._process.stdin, flush=True)

    def receive(self) -> Seconds:
        """Return the times of the last requested call."""
        return Seconds(*self._answer())

    def run(self, k: int) -> Seconds:
        """Return the times of one call of the prepared task; ``k`` is the number of the call."""
        self.ask(k)
        return self.receive()

    def _answer(self) -> Any:
        assert self._process.stdout is not None  # noqa: S101
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"error: the worker of {self._python} ended; its messages are above")
        return json.loads(line)


def _children_cpu() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


@dataclass
class Row:
    """Times of one task, which is a row of the printed table.

    Attributes:
        name: Name of the task.
        pairs: For each round, a list of pairs of times. A pair has the times of two successive calls: one of the wheel
            ``before``, one of the wheel ``after``.
    """

    name: str
    pairs: list[list[tuple[Seconds, Seconds]]] = field(default_factory=list)

    def ratios(self, clock: str) -> list[float]:
        """Return one ratio per round: the task's time with the wheel ``after`` over that with the wheel ``before``."""
        return [
            float(np.median([getattr(after, clock) / getattr(before, clock) for before, after in pairs]))
            for pairs in self.pairs
        ]

    def interval(self, clock: str) -> tuple[float, float, float]:
        """Return the ratio of times (after / before), as median over rounds, and its 95 % confidence interval."""
        ratios = sorted(self.ratios(clock))
        count = len(ratios)
        if count < FEWEST_ROUNDS:
            return float(np.median(ratios)), -math.inf, math.inf
        # There are n ratios, one per round. The true median of the ratios lies outside of the interval from the i-th
        # smallest to the i-th largest ratio with the probability 2 · Σ C(n, k) / 2ⁿ, a sum over k < i.
        outside, i = 0.0, 0
        while 2.0 * (outside + math.comb(count, i) * 0.5**count) <= 0.05:
            outside += math.comb(count, i) * 0.5**count
            i += 1
        return float(np.median(ratios)), ratios[i - 1], ratios[count - i]

    def is_precise(self, clock: str, half_width: float) -> bool:
        """Return whether the confidence interval of the median ratio is at most twice ``half_width`` wide."""
        _, low, high = self.interval(clock)
        return high - low <= 2.0 * half_width

    def milliseconds(self, clock: str) -> tuple[float, float]:
        """Return the median times of the task with both wheels [ms]: before, after."""
        both = [[getattr(which, clock) for which in pair] for pairs in self.pairs for pair in pairs]
        before, after = 1e3 * np.median(np.array(both), axis=0)
        return float(before), float(after)


def in_turns(calls: tuple[Timed, Timed], first: int, count: int) -> list[tuple[Seconds, Seconds]]:
    """Call two functions alternately; return pairs of times, one time of each function.

    Each function is called ``count`` times, with the number of the call as its argument.
    """
    pairs = []
    for k in range(count):
        begins = (first + k) % 2
        times = {which: calls[which](k) for which in (begins, 1 - begins)}
        pairs.append((times[0], times[1]))
    return pairs


def add_round(before: Wheel, after: Wheel, rows: Sequence[Row], number: int) -> None:
    """Time each task once more for both wheels, and append the times to ``rows``."""
    first = number % 2
    by_workers = [row for row in rows if row.name not in PROCESS_ROWS]
    if by_workers:
        with contextlib.ExitStack() as stack:
            started = {which: stack.enter_context(Worker((before, after)[which])) for which in (first, 1 - first)}
            for row in by_workers:
                # The processes of both wheels prepare the task at the same time. The timed calls alternate between
                # them.
                for worker in started.values():
                    worker.ask(row.name)
                seconds = min([worker.receive().wall for worker in started.values()])
                count = min(max(math.ceil(SECONDS_PER_ROW / seconds), FEWEST_CALLS), MOST_CALLS)
                row.pairs.append(in_turns((started[0].run, started[1].run), first, count))
    for row in rows:
        if row.name in PROCESS_ROWS:
            row.pairs.append(_process_pairs(before, after, row.name, first))


def _process_pairs(before: Wheel, after: Wheel, name: str, first: int) -> list[tuple[Seconds, Seconds]]:
    count, arguments = PROCESS_ROWS[name]
    return in_turns((lambda _: before.run(arguments), lambda _: after.run(arguments)), first, count)


def compare(before: Wheel, after: Wheel, title: str, names: Sequence[str], options: argparse.Namespace) -> list[Row]:
    """Compare two wheels until the confidence interval of every task is narrow enough, and print the table."""
    rows = [Row(name) for name in names]
    for number in range(max(options.most_rounds, options.rounds)):
        measured = rows
        if number >= options.rounds:
            measured = [row for row in rows if not row.is_precise(options.clock, options.half_width)]
        if not measured:
            break
        begin = time.perf_counter()
        add_round(before, after, measured, number)
        print(f"{title}: round {number + 1} took {time.perf_counter() - begin:.0f} s", file=sys.stderr, flush=True)
    other = CLOCKS[1 - CLOCKS.index(options.clock)]
    print(f"\n| {title} | before [ms] | after [ms] | {options.clock} ratio | 95 % | {other} ratio | 95 % | rounds |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for row in rows:
        first, second = row.milliseconds(options.clock)
        ratios = []
        for clock in (options.clock, other):
            ratio, low, high = row.interval(clock)
            ratios.append(f"{ratio:.3f} | {low:.3f} to {high:.3f}")
        if not row.is_precise(options.clock, options.half_width):
            ratios[0] += f", wider than ± {options.half_width:g}"
        print(f"| {row.name} | {first:.1f} | {second:.1f} | {' | '.join(ratios)} | {len(row.pairs)} |", flush=True)
    return rows


def raw(rows: Iterable[Row]) -> dict[str, Any]:
    """Return all times [s] by task and round: for each pair of calls, wall-clock and processor time of both wheels."""
    return {row.name: [[[*before, *after] for before, after in pairs] for pairs in row.pairs] for row in rows}


def warm(wheel: Wheel, text: str) -> list[str]:
    """Compile the kernels for all tasks whose names contain a text. Return the names of these tasks."""
    with Worker(wheel) as worker:
        names = [name for name in (*worker.rows, *PROCESS_ROWS) if text in name]
        for name in names:
            if name in PROCESS_ROWS:
                wheel.run(PROCESS_ROWS[name][1])
            else:
                worker.ask(name)
                worker.receive()
    return names


def main() -> None:
    """Compare the wheel ``before`` with itself, then with the wheel ``after``."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--before", type=Path, help="Python of the environment with the baseline wheel")
    parser.add_argument("--after", type=Path, help="Python of the environment with the wheel to compare")
    parser.add_argument(
        "--rounds", type=int, default=9, help=f"rounds of every row, at least {FEWEST_ROUNDS} (default: 9)"
    )
    parser.add_argument(
        "--most-rounds", type=int, default=41, help="rounds of rows whose interval is too wide (default: 41)"
    )
    parser.add_argument(
        "--half-width", type=float, default=0.03, help="half-width of the intervals to reach (default: 0.03)"
    )
    parser.add_argument(
        "--clock", choices=CLOCKS, default="wall", help="time whose intervals must be narrow (default: wall)"
    )
    parser.add_argument("--threads", type=int, help="threads of all calls in workers (default: one per core)")
    parser.add_argument("--only", metavar="TEXT", default="", help="measure only rows whose name contains this text")
    parser.add_argument("--output", type=Path, metavar="FILE", help="write all times to this .json file")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        work(options.threads)
        return
    if options.before is None or options.after is None or options.rounds < FEWEST_ROUNDS:
        parser.error(f"--before and --after must be given, and --rounds must be at least {FEWEST_ROUNDS}")
    # The Python program of an environment is a link to the Python program of the system. If the link were resolved,
    # Python would not find the packages of the environment.
    before, after = (Wheel(python.absolute(), options.threads) for python in (options.before, options.after))
    names = warm(before, options.only)
    warm(after, options.only)
    results: dict[str, Any] = {"before": str(before.python), "after": str(after.python), "threads": options.threads}
    for title, wheel in {"baseline and itself": before, "before and after": after}.items():
        results[title] = raw(compare(before, wheel, title, names, options))
        if options.output is not None:
            options.output.write_text(json.dumps(results), encoding="utf-8")


if __name__ == "__main__":
    main()
