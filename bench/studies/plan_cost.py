"""Time that watching and judging take of a call and of a first picture: all of a plan but the search on pilots.

Rows are calls of random directions and first pictures of a height field, whose coefficients and tables are made anew;
kernels are compiled before. Medians of several, each of directions of its own. With ``--plain`` nothing is watched, so
that the file also times another version of the package: ``PYTHONPATH=<its folder>
python -m bench.studies.plan_cost --plain``.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

import warpdiff as wd
from bench import inputs
from warpdiff import meshes

COUNTS = (128, 1000, 20_000, 200_000)
TOLERANCES = (1e-2, 1e-3)
LIGHT = wd.DirectionalLight((0.1, 0.9, 1.2))
VIEW = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=640, height=480)


class Clock:
    """Seconds that watching and judging have taken."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def timed(self, function: Any) -> Any:
        """The function, on this clock."""

        def run(*arguments: Any, **options: Any) -> Any:
            begin = time.perf_counter()
            result = function(*arguments, **options)
            self.seconds += time.perf_counter() - begin
            return result

        return run


def watch(clock: Clock) -> None:
    """Put what watches and judges on a clock."""
    from warpdiff.planning import pilot_directions, trial

    pilot_directions.watched = clock.timed(pilot_directions.watched)  # type: ignore[assignment]
    pilot_directions.drawn = clock.timed(pilot_directions.drawn)  # type: ignore[assignment]
    plain = trial.Trial.run

    def run(self: trial.Trial, plan: Any, on: Any = None) -> Any:
        if on is None or on is getattr(self, "pilots", None):
            return plain(self, plan, on)
        if plan.nodes:
            # A table that is new is made for the call, not for its judges.
            plain(self, plan, on)
        return clock.timed(plain)(self, plan, on)

    trial.Trial.run = run  # type: ignore[method-assign]


def hemisphere(rng: np.random.Generator, count: int) -> np.ndarray:
    """Unit vectors up to 84° from the normal."""
    z, phi = rng.uniform(0.1, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    s = np.sqrt(1.0 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)


def row(name: str, clock: Clock, calls: list[Any]) -> None:
    """Print the medians of some calls after the first, whose kernels are new."""
    found = []
    for call in calls:
        clock.seconds, begin = 0.0, time.perf_counter()
        call()
        found.append((time.perf_counter() - begin, clock.seconds))
    whole, own = np.median(np.array(found[1:]), axis=0)
    print(f"| {name} | {1e3 * whole:.0f} | {1e3 * own:.1f} | {100.0 * own / (whole - own):.0f} % |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="calls a row (7)")
    parser.add_argument("--plain", action="store_true", help="time whole calls alone")
    parser.add_argument("--seed", type=int, default=0, help="of the directions (0)")
    parser.add_argument("--data", help=inputs.HELP)
    options = parser.parse_args()
    rng, clock = np.random.default_rng(options.seed), Clock()
    if not options.plain:
        watch(clock)
    fields = {
        "fingers 25.6 µm": wd.gratings.fingers(size_um=25.6, pitch_um=0.09),
        "blazed": wd.gratings.blazed(2.5, 0.25),
    }
    scan = inputs.scan(options.data)
    if scan is not None:
        fields["scan 65 µm"] = scan.levelled(order=2)
    print("| what | whole [ms] | watching and judging [ms] | of the rest |\n| --- | --- | --- | --- |")
    for name, hf in fields.items():
        for count in COUNTS:
            for tolerance in TOLERANCES:
                pairs = [(hemisphere(rng, count), hemisphere(rng, count)) for _ in range(options.rounds)]
                calls = [lambda p=p, hf=hf, t=tolerance: wd.reflectance(hf, *p, tolerance=t) for p in pairs]
                row(f"{name}, {count} directions at {tolerance:g}", clock, calls)
    tube = meshes.tube()
    for name, hf in fields.items():
        for tolerance in (3e-2, 1e-2):

            def first(hf: wd.HeightField = hf, tolerance: float = tolerance) -> None:
                wd.shade(tube, wd.HeightField(hf.heights_um, hf.pitch_um), LIGHT, VIEW, tolerance=tolerance)

            row(f"{name}, first picture of a tube at {tolerance:g}", clock, [first] * options.rounds)


if __name__ == "__main__":
    main()
