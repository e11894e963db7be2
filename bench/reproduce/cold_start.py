"""Cold start: time from the start of a process to the imported package, and to its first picture.

A process imports the package, makes a tube and a synthetic height field with nano-fingers on a patch of 25.6 µm,
renders and saves a picture of 640 × 480 pixels, and ends. The kernels are compiled programs for loops over pixels.
Processes that must compile them (empty kernel cache) and processes that load them from a filled cache are timed
alternately. Plotting libraries are hidden from the process, because colour-science would otherwise import them if they
are installed.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HIDE = "import sys; sys.modules['matplotlib'] = None; "
IMPORT = HIDE + "from warpdiff import *"
PICTURE = HIDE + (
    "import warpdiff as wd; from pathlib import Path; "
    "heightfield = wd.gratings.fingers(size_um=25.6, pitch_um=0.09, seed=2); "
    "view = wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=640, height=480); "
    "image = wd.shade(wd.meshes.tube(), heightfield, wd.DirectionalLight((0.1, 0.9, 1.2)), view); "
    "image.save(Path(sys.argv[1]) / 'first.png'); import time; print(time.monotonic())"
)

# Number of repetitions of each measurement.
ROUNDS = 5
PROCESSES = {
    "Python alone": "pass", "from warpdiff import *": IMPORT, "first picture, no kernel compiled": PICTURE,
    "first picture, kernels compiled before": PICTURE,
}  # fmt: skip
# Python program that makes the plan (numbers of wavelengths and terms) and the colour table for the scan of a surface,
# and prints the time and the peak memory. The imported libraries alone require about 240 MiB.
PRECOMPUTE = HIDE + (
    "import time, resource, warpdiff as wd; "
    "scan = wd.HeightField.load(sys.argv[1], extent_um=65.0, height_range_um=0.375).levelled(order=2); "
    "begin = time.perf_counter(); "
    "plan = wd.plan(scan, method='low-rank', integration='table', coherence=wd.Coherence(sys.argv[2])); "
    "taken = time.perf_counter() - begin; "
    "peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024; "
    "print(f'| {sys.argv[2]}: coefficients, search and table | {taken:.2f} | {peak:.0f} |')"
)


def precompute(scan: Path) -> None:
    """Print the time and the peak memory to make the plan and the colour table for the scan of a surface.

    The kernels are compiled before the timed process starts.
    """
    print("\n| scan | s | peak memory [MiB] |\n| --- | --- | --- |", flush=True)
    environment = os.environ | {"WARPDIFF_CACHE_DIR": ""}
    for kind in ("averaged", "centred"):
        command = [sys.executable, "-W", "ignore", "-c", PRECOMPUTE, str(scan), kind]
        subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
        subprocess.run(command, env=environment, check=True)


def seconds(code: str, cache: Path) -> tuple[float, float]:
    """Run ``code`` in a new Python process; return the times [s] from its start to its first result and to its end.

    The process prints the clock time at which the result was complete. If it prints nothing, both numbers are the time
    to its end. The folder ``cache`` contains the compiled kernels.
    """
    begin = time.monotonic()
    environment = os.environ | {"WARP_CACHE_PATH": str(cache), "WARPDIFF_CACHE_DIR": ""}
    result = subprocess.check_output([sys.executable, "-c", code, str(cache)], env=environment, text=True)
    end = time.monotonic()
    return float(result.split()[-1] if result else end) - begin, end - begin


def main() -> None:
    """Time processes with an empty and with a filled kernel cache, and print a table of the times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scan", type=Path, help="file of a scan with 1332 × 1332 samples to time")
    options = parser.parse_args()
    times: dict[str, list[tuple[float, float]]] = {}
    for _ in range(ROUNDS):
        with tempfile.TemporaryDirectory() as folder:
            cache = Path(folder)
            for name, code in PROCESSES.items():
                times.setdefault(name, []).append(seconds(code, cache))
    print("| process | time [s], median | least | most | to the end of the process |\n| --- | --- | --- | --- | --- |")
    for name, pairs in times.items():
        there, ended = zip(*pairs, strict=True)
        print(f"| {name} | {np.median(there):.2f} | {min(there):.2f} | {max(there):.2f} | {np.median(ended):.2f} |")
    if options.scan is not None:
        precompute(options.scan)


if __name__ == "__main__":
    main()
