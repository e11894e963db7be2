"""What long sequences take, from measured parts: start, renderer, tables, frame, files, transfer.

``python -m bench.studies.frames_on_paper`` draws frames of the snake at a size, and those of 3840 × 2160 by
their pixels; ``--workers`` runs 36 frames of a turntable by one and two workers of Dask of one thread each, from caches
that are filled. It prints JSON.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import pickle
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import warpdiff as wd

LIGHT = wd.DirectionalLight((0.6, 1.0, -0.1))
VIEW = wd.View((0.0, 3.4, 4.0), (0.0, 0.0, 0.0), fov_y_deg=13.0)


# What a worker does before its second frame, with kernels compiled.
WORKER = """
import sys, time
begin = time.perf_counter()
import warpdiff
from warpdiff.render import renderer
imported = time.perf_counter()
import pickle
made = pickle.load(open(sys.argv[1], "rb"))
unpickled = time.perf_counter()
made.draw()
print(imported - begin, unpickled - imported, time.perf_counter() - unpickled)
"""


def scene(tolerance: float, width: int, height: int, threads: int | None) -> wd.Renderer:
    """The snake with synthetic fingers."""
    view = dataclasses.replace(VIEW, width=width, height=height)
    return wd.Renderer(
        wd.meshes.snake(), wd.gratings.fingers(), LIGHT, view, tolerance=tolerance, pigment=0.1, threads=threads
    )


def parts(tolerance: float, width: int, height: int, count: int) -> dict:
    """Seconds of each part of a frame on one thread."""
    begin = time.perf_counter()
    renderer = scene(tolerance, width, height, 1)
    made = time.perf_counter() - begin
    pickled = pickle.dumps(renderer)
    drawn, saved, sizes = [], {".png": [], ".exr": []}, {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "renderer.pickle"
        path.write_bytes(pickled)
        worker = subprocess.run([sys.executable, "-c", WORKER, path], capture_output=True, text=True, check=True)
        imported, unpickled, first = map(float, worker.stdout.splitlines()[-1].split())
        for shot in wd.turntable(LIGHT, dataclasses.replace(VIEW, width=width, height=height), count=count):
            begin = time.perf_counter()
            renderer.draw(shot.light, shot.view)
            image = renderer.image()
            drawn.append(time.perf_counter() - begin)
            for suffix, times in saved.items():
                begin = time.perf_counter()
                path = image.save(Path(folder) / f"frame{suffix}")
                times.append(time.perf_counter() - begin)
                sizes[suffix] = path.stat().st_size
    pixels = width * height
    lit = float(np.mean(image.lit))
    return {
        "size": [width, height], "tolerance": tolerance, "share of pixels lit": lit,
        "renderer made [s]": made, "a worker's imports [s]": imported, "its renderer, with tables [s]": unpickled,
        "its first frame [s]": first,
        "renderer pickled [MB]": len(pickled) / 1e6,
        "drawn [s]": float(np.median(drawn)), "drawn [µs a pixel]": 1e6 * float(np.median(drawn)) / pixels,
        "saved [s]": {name: float(np.median(each)) for name, each in saved.items()},
        "saved [MB]": {name: each / 1e6 for name, each in sizes.items()},
    }  # fmt: skip


def by_workers(tolerance: float, width: int, height: int, count: int) -> dict:
    """Seconds of a turntable by one and by two workers, and by none."""
    from distributed import Client, LocalCluster

    renderer = scene(tolerance, width, height, 1)
    shots = wd.turntable(LIGHT, dataclasses.replace(VIEW, width=width, height=height), count=count)
    found, frames = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        for workers in (0, 1, 2):
            times: list[tuple[float, float]] = []
            begin = time.perf_counter()

            def tell(share: float, begin: float = begin, times: list = times) -> None:
                times.append((share, time.perf_counter() - begin))

            target = Path(folder) / str(workers)
            if workers:
                options = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": None}
                with LocalCluster(**options) as cluster, Client(cluster) as client:
                    paths = wd.sequence(renderer, shots, target, client=client, progress=tell)
            else:
                paths = wd.sequence(renderer, shots, target, progress=tell)
            frames[workers] = [path.read_bytes() for path in paths]
            # Once every worker has made its tables.
            (before, first), (after, last) = times[1 + 2 * max(workers, 1)], times[-1]
            found[workers] = {"total [s]": times[-1][1], "frames a second": (after - before) * count / (last - first)}
    found["two workers over one"] = found[2]["frames a second"] / found[1]["frames a second"]
    found["identical"] = frames[0] == frames[1] == frames[2]
    return found


def main() -> None:
    """Print figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tolerance", type=float, default=3e-2)
    parser.add_argument("--size", type=int, nargs=2, default=(960, 540), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--count", type=int, default=3, help="frames whose median counts (default: 3)")
    parser.add_argument("--workers", action="store_true")
    options = parser.parse_args()
    if options.workers:
        print(json.dumps(by_workers(options.tolerance, *options.size, 36), indent=1))
    else:
        print(json.dumps(parts(options.tolerance, *options.size, options.count), indent=1, ensure_ascii=False))


if __name__ == "__main__":
    main()
