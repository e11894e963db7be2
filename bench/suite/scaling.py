"""Scaling of time and memory with the numbers of pixels, samples, lights, faces and threads, and with lengths.

The lengths are the size of the patch, the range of the heights and the width of the coherence window. Each point of the
chart is measured in its own process. The process renders a tube whose height field has nano-fingers, with one parameter
changed. The measured quantities are the time of the preparation before the first frame (plan, Fourier coefficients,
colour table), the times of frames under a moving light, and the increase of the process's peak memory.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from bench.suite import figures

if TYPE_CHECKING:
    from bench.suite.runner import Setting

BASE: dict[str, Any] = {
    "width": 320, "pitch_um": 0.1, "size_um": 25.6, "height_um": 0.3, "sigma_um": 16.25, "lights": 1, "along": 64,
}  # fmt: skip
# Curves of the scaling chart by name: varied parameter, its values, and title of the x axis.
SERIES: dict[str, tuple[str, tuple[Any, ...], str]] = {
    "pixels": ("width", (80, 160, 320, 640, 1280), "pixels of the picture"),
    "samples": ("pitch_um", (0.13, 0.1, 0.05, 0.025), "samples of the height field"),
    "patch": ("size_um", (6.4, 12.8, 25.6, 51.2, 102.4), "side of the patch [µm]"),
    "heights": ("height_um", (0.1, 0.3, 1.0, 3.0), "height range [µm]"),
    "window": ("sigma_um", (2.0, 4.0, 8.0, 16.25, 32.5), "σ of the window [µm]"),
    "lights": ("lights", (1, 2, 4, 8), "lights"),
    "faces": ("along", (16, 64, 256, 512), "faces of the mesh"),
    "threads": ("threads", (1, 2, 4, 8, 16), "threads"),
}
# Number of timed frames per point of the chart.
FRAMES = 5


def x_of(series: str, value: float) -> float:
    """Return the position on the x axis for a value of the parameter that the curve ``series`` varies."""
    if series == "pixels":
        return value * value * 0.75
    if series == "samples":
        return (BASE["size_um"] / value) ** 2
    if series == "faces":
        return 2.0 * (value - 1) * (value / 2)
    return value


def most_memory() -> float:
    """Return the peak memory of this process [MB]."""
    status = Path("/proc/self/status")
    if status.is_file():
        # The function getrusage is used only where /proc/self/status is missing, because its result includes the memory
        # of the parent process.
        return float(status.read_text().split("VmHWM:")[1].split()[0]) / 1024.0
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def point(parameters: dict[str, Any], device: str | None) -> dict[str, Any]:
    """Measure times and memory for one point of the chart in this process."""
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    p = BASE | parameters
    heightfield = wd.gratings.fingers(size_um=p["size_um"], pitch_um=p["pitch_um"], height_um=p["height_um"], seed=2)
    mesh = wd.meshes.tube(segments_along=p["along"], segments_around=max(p["along"] // 2, 3))
    view = wd.View((0.0, 0.6, 1.15), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=p["width"], height=3 * p["width"] // 4)
    options = {"device": device, "threads": p["threads"]}
    small = wd.gratings.fingers(size_um=6.4, pitch_um=0.1)
    few = wd.View((0.0, 0.6, 1.15), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=32, height=24)
    # A first small picture loads the libraries and most kernels. The time and the memory of this picture are not
    # included.
    tiny = wd.meshes.tube(segments_along=16, segments_around=8)
    wd.shade(tiny, small, wd.DirectionalLight((0.0, 1.0, 1.0)), few, **options)
    before = most_memory()
    begin = time.perf_counter()
    # If no colour table meets the tolerance, as for patches that are small compared with the coherence window, the plan
    # samples wavelengths. Frames then have no footprints, which are averages of the colour over the area of a pixel:
    # only a table can compute them.
    plan = wd.plan(heightfield, coherence=wd.Coherence(sigma_um=p["sigma_um"]), **options)

    def frame(k: int) -> float:
        lights = [wd.DirectionalLight((0.1 + 0.02 * k + 0.1 * i, 0.9, 1.2)) for i in range(p["lights"])]
        start = time.perf_counter()
        wd.shade(mesh, heightfield, lights, view, plan=plan, footprint=plan.rings_per_octave > 0, **options)
        return time.perf_counter() - start

    frame(0)
    prepared = time.perf_counter() - begin
    seconds = [frame(k + 1) for k in range(FRAMES)]
    return {
        "before_s": prepared - float(np.median(seconds)),
        "frame_s": [float(np.median(seconds)), min(seconds), max(seconds)],
        "megabytes": most_memory() - before,
    }


def measure(setting: Setting) -> dict[str, Any]:
    """Measure all curves of the chart. A quick run has three values of two curves."""
    results = {}
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for name, (parameter, values, _) in SERIES.items():
        if setting.quick and name not in ("pixels", "lights"):
            continue
        chosen: tuple[Any, ...] = values[:: max(len(values) // 2, 1)] if setting.quick else values
        if name == "threads":
            chosen = tuple(value for value in values if value <= cores)
            if setting.device not in (None, "cpu") or len(chosen) < 2:
                continue
        setting.say(f"scaling: {name}")
        points = []
        for value in chosen:
            # Some parameters change the number of terms of the Taylor series, so that other kernels must be compiled.
            # Such points are measured twice, and the second measurement is used.
            for _ in range(2 if name in ("heights", "window", "patch") else 1):
                result = _in_process({"threads": setting.threads} | {parameter: value}, setting)
            points.append({"x": x_of(name, value), **result})
        results[name] = points
    return results


def _in_process(parameters: dict[str, Any], setting: Setting) -> dict[str, Any]:
    code = "import sys, json; from bench.suite import scaling; "
    code += "print(json.dumps(scaling.point(json.loads(sys.argv[1]), json.loads(sys.argv[2]))))"
    command = [sys.executable, "-W", "ignore", "-c", code, json.dumps(parameters), json.dumps(setting.device)]
    made = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=os.environ)
    return dict(json.loads(made.stdout.splitlines()[-1]))


def exponent(x: list[float], y: list[float]) -> float:
    """Return the exponent of a power law fitted to y over x, the slope of log y over log x."""
    return float(np.polyfit(np.log(x), np.log(np.maximum(y, 1e-9)), 1)[0])


def numbers(results: dict[str, Any]) -> dict[str, list[Any]]:
    """Return times and memory by name, each a list [median, minimum, maximum over the rounds, unit]."""
    result: dict[str, list[Any]] = {}
    for name, points in results.items():
        for point in points:
            key = f"scaling/{name}/{point['x']:.4g}"
            result[f"{key}/frame"] = [*point["frame_s"], "s"]
            result[f"{key}/before"] = [point["before_s"]] * 3 + ["s"]
            result[f"{key}/memory"] = [point["megabytes"]] * 3 + ["MB"]
    return result


def chart(results: dict[str, Any], folder: Path) -> dict[str, str]:
    """Draw times and memory over each varied parameter, with fitted exponents.

    Return the chart's name and a sentence about the exponents.
    """
    plt = figures.pyplot()
    columns = min(len(results), 4)
    rows = -(-len(results) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(4.4 * columns, 3.7 * rows), squeeze=False)
    slopes = {}
    for axis in axes.flat[len(results) :]:
        axis.set_axis_off()
    for axis, (name, points) in zip(axes.flat, results.items(), strict=False):
        x = [point["x"] for point in points]
        curves = {
            "frame [s]": ([point["frame_s"][0] for point in points], figures.BLUE, "o"),
            "preparation [s]": ([point["before_s"] for point in points], figures.VERMILION, "s"),
            "memory [GB]": ([point["megabytes"] / 1024.0 for point in points], figures.GREEN, "^"),
        }
        for title, (y, colour, marker) in curves.items():
            y_drawn = np.maximum(y, 1e-3)
            slope = exponent(x, list(y_drawn))
            slopes[name, title] = slope
            axis.plot(x, y_drawn, color=colour, marker=marker, markersize=5, label=f"{title}: x^{slope:.2f}")
        spread = np.array([point["frame_s"] for point in points])
        axis.fill_between(x, spread[:, 1], spread[:, 2], color=figures.BLUE, alpha=0.2, linewidth=0.0)
        axis.set(xscale="log", yscale="log", xlabel=SERIES[name][2])
        axis.set_xticks(x, [f"{value:.3g}" if value < 1e3 else f"{value:,.0f}" for value in x], fontsize=8.5)
        axis.minorticks_off()
        low, high = axis.get_ylim()
        axis.set_ylim(low, high * (high / low) ** 0.45)
        axis.legend(frameon=False, fontsize=8.5, loc="upper left")
        axis.grid(color="#00000014", linewidth=0.8)
        axis.set_title(name)
    figure.tight_layout()
    figures.save(figure, folder, "scaling")
    frame = {name: slopes[name, "frame [s]"] for name in results}
    text = "The time of a frame is proportional to " + ", ".join(f"{name}^{slope:.2f}" for name, slope in frame.items())
    costly = max(results, key=lambda name: max(point["before_s"] for point in results[name]))
    most = max(point["before_s"] for point in results[costly])
    return {"scaling": f"{text}. Preparation takes at most {most:.1f} s, at the last point of {costly}."}
