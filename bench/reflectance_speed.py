"""Speed against accuracy of ``reflectance``: µs a direction and error of XYZ, by coherence and tolerance.

Every setting is timed in one interleaved run on the same random directions; the figure is the median of the rounds and
the spread their range. The error is the design's: ‖ΔXYZ‖ / max(‖XYZ‖, 1e-3 · P99(Y)) against the float64 reference
of the tests, on a subset of the directions; it runs from a checkout, which holds them.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from pathlib import Path

import numpy as np

import warpdiff as wd
from warpdiff import demo
from warpdiff.bench import reference

TOLERANCES = (1e-1, 1e-2, 1e-3)
FORMS = (wd.Coherence(), wd.Coherence("centred"), wd.Coherence("source"), wd.Coherence("replicas", copies=(1, 10)))


def directions(count: int, seed: int) -> np.ndarray:
    """Random unit vectors on the hemisphere, at least 3° above the horizon, uniform in z."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.05, 1.0, count)
    phi = rng.uniform(0.0, 2.0 * np.pi, count)
    s = np.sqrt(1.0 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)


def settings(hf: wd.HeightField, lights: np.ndarray, views: np.ndarray) -> dict[str, wd.Plan]:
    """The automatic plans of each form."""
    return {
        f"{coherence}, {tolerance:g}": wd.plan(hf, lights, views, tolerance=tolerance, coherence=coherence)
        for coherence in FORMS
        for tolerance in TOLERANCES
    }


def run(
    name: str, hf: wd.HeightField, *, count: int, truth: int, rounds: int, device: str, threads: int | None
) -> None:
    """Measure one height field and print its table."""
    lights, views = directions(count, 1), directions(count, 2)
    plans = settings(hf, lights, views)
    times: dict[str, list[float]] = {key: [] for key in plans}
    values = {}
    for _ in range(rounds + 1):
        for key, plan in plans.items():
            started = time.perf_counter()
            values[key] = wd.reflectance(hf, lights, views, plan=plan, device=device, threads=threads)
            times[key].append((time.perf_counter() - started) / count * 1e6)
    print(f"\n{name}: {hf!r}")
    print(
        f"{'coherence, tolerance':44s} {'µs/direction':>12s} {'spread':>15s} {'error P50':>10s} {'P99':>8s} "
        f"{'planned':>8s}  terms, wavelengths"
    )
    exact = {each: reference.reference_reflectance(hf, lights[:truth], views[:truth], each) for each in FORMS}
    for key, plan in plans.items():
        warm = times[key][1:]  # the first round compiles and builds the table
        true = exact[plan.coherence]
        scale = np.maximum(np.linalg.norm(true, axis=1), 1e-3 * np.percentile(true[:, 1], 99.0))
        error = np.linalg.norm(values[key][:truth] - true, axis=1) / scale
        print(
            f"{key:44s} {np.median(warm):12.2f} {min(warm):7.2f}-{max(warm):<7.2f} {np.median(error):10.1e} "
            f"{np.percentile(error, 99.0):8.1e} {plan.error:8.1e}  {plan.terms}, {plan.wavelengths}"
        )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--directions", type=int, default=4000, help="directions timed (default: 4000)")
    parser.add_argument("--truth", type=int, default=500, help="of these compared with the truth (default: 500)")
    parser.add_argument("--rounds", type=int, default=5, help="timed rounds (default: 5)")
    parser.add_argument("--device", default="cpu", help="cpu (default) or cuda")
    parser.add_argument("--threads", type=int, help="threads on the CPU (default: one a core)")
    parser.add_argument("--data", type=Path, help="folder with the scan (default: $WARPDIFF_DATA, ../shared/data)")
    options = parser.parse_args()
    print(
        f"warpdiff {wd.__version__}, NumPy {np.__version__}, Python {platform.python_version()}, {os.cpu_count()} cores"
    )
    surfaces = {"synthetic fingers": wd.gratings.fingers(size_um=12.8, pitch_um=0.08)}
    data = demo.data_folder(options.data)
    if data is not None and (data / demo.SCAN).is_file():
        surfaces["scan, 12.5 µm crop"] = demo.cleaned_scan(data / demo.SCAN).cropped(12.5)
    else:
        print(f"{demo.SCAN} is not at hand: synthetic surfaces only")
    for name, hf in surfaces.items():
        run(
            name, hf, count=options.directions, truth=options.truth, rounds=options.rounds, device=options.device,
            threads=options.threads,
        )  # fmt: skip


if __name__ == "__main__":
    main()
