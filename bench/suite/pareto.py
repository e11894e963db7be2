"""Speed against accuracy on a scene's pixels: methods and peers (other programs) at several settings.

The charts also show the method that the library chooses automatically. Errors are relative to the float64 reference:
‖ΔXYZ‖ / max(‖XYZ‖, f), where f is a thousandth of the reference luminance (``bench.truth.errors``), and ΔE2000 with an
exposure that maps the 99th percentile of Y to 1. Timed calls have arrays as inputs and outputs, and repeat an earlier
call, so that they include neither compilation nor preparation. A call has so many pixels that it takes about a tenth of
a second. The preparation for a new height field is timed separately, without compilation. It computes a plan, Fourier
coefficients and a colour table. A plan is a method with its numbers of wavelengths, series terms and so on.

A coherence is the limit within which light interferes, for example a Gaussian window on the surface.
"""

from __future__ import annotations

import contextlib
import importlib
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

import warpdiff as wd
from bench.suite import figures
from bench.suite.scenes import FRAME_PIXELS, Directions, Scene, scenes
from bench.suite.timing import interleaved
from bench.truth import errors, reference
from warpdiff.device.devices import resolve_device
from warpdiff.optics.materials import IlluminatedMaterial
from warpdiff.request.directions import DirectionRange
from warpdiff.tables.lookup import ColourLookup

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bench.suite.runner import Setting

    Shade = Callable[[np.ndarray, np.ndarray, int], np.ndarray]

# Number of directions for which errors are measured; a quarter of this number with ``--quick``. The value is limited by
# the time of the reference.
JUDGED = 300
# Approximate duration of a timed call [s], and least number of pixels of a timed call.
TARGET_S, FEWEST = 0.08, 1000
TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4)
# Numbers of frames n for which the charts show the time per frame: the time of a frame plus one n-th of the time of the
# preparation.
FRAMES = (1, 10, 100, 1000)
AUTOMATIC = "automatic"
# Methods of warpdiff that the charts compare, by kind of coherence.
METHODS = {
    "averaged": ("low-rank, table", "low-rank", "power", "jacobi-anger", "taylor"),
    "centred": ("low-rank, table", "low-rank", "jacobi-anger", "taylor"),
    "source": ("low-rank, table", "low-rank", "jacobi-anger"),
}
PEERS = {"drjit_peer": "Dr.Jit", "numpy_peer": "NumPy", "numba_published": "Numba"}
STYLES = {
    AUTOMATIC: (figures.BLACK, "*", "automatic"), "low-rank, table": (figures.BLUE, "o", "low-rank, table"),
    "low-rank": (figures.SKY, "o", "low-rank, sampled"), "power": (figures.GREEN, "o", "power, sampled"),
    "jacobi-anger": (figures.PURPLE, "o", "Jacobi–Anger, sampled"), "taylor": (figures.ORANGE, "o", "Taylor, sampled"),
    "Numba": (figures.VERMILION, "s", "published, Numba"), "Dr.Jit": (figures.BROWN, "s", "published, Dr.Jit"),
    "NumPy": (figures.GREY, "s", "published, NumPy"), "Stam, rainbow": ("#999999", "D", "analytic (Stam), rainbow"),
    "Stam, CIE": ("#777777", "^", "analytic (Stam), CIE"),
}  # fmt: skip


def ours(heightfield: wd.HeightField, plan: wd.Plan, directions: Directions, device: Any) -> Shade:
    """Return a function that computes colours by a plan of warpdiff (method, number of wavelengths and so on).

    The function has the same arguments as the functions ``shade`` of ``bench.peers``.
    """
    import warp as wp

    direction_range = DirectionRange.of(
        heightfield, plan.coherence, directions.scattering_vectors, directions.to_lights, directions.gains > 0.0
    )
    lights: dict[int, Any] = {}
    lookups: dict[int, ColourLookup] = {}

    def shade(scattering_vectors: np.ndarray, gains: np.ndarray, threads: int) -> np.ndarray:
        if threads not in lookups:
            lookups[threads] = ColourLookup(heightfield, plan, direction_range, device=device, threads=threads)
        count = len(gains)
        if count not in lights:
            lights[count] = wp.array(np.float32(directions.subset(count).to_lights), dtype=wp.vec3f, device=device)
        xyz = wp.zeros(count, dtype=wp.vec3f, device=device)
        arrays = wp.array(scattering_vectors, dtype=wp.vec3d, device=device), lights[count]
        lookups[threads].accumulate(
            *arrays, wp.array(np.float32(gains), dtype=wp.float32, device=device), IlluminatedMaterial("D65"), xyz
        )
        return np.asarray(xyz.numpy())

    return shade


def style(method: str) -> tuple[str, str, str]:
    """Return the colour, marker and title of a method in charts."""
    return STYLES.get(method, ("#CC00CC", "P", method))


def peers(coherence: wd.Coherence, setting: Setting) -> dict[str, tuple[Any, list[dict[str, Any]]]]:
    """Return the available peers (other programs) for a coherence (how far light interferes), with settings of each."""
    result: dict[str, tuple[Any, list[dict[str, Any]]]] = {
        name: (SimpleNamespace(__name__=name, prepare=prepare), [{}]) for name, prepare in setting.user_peers.items()
    }
    names = ["drjit_peer", "numpy_peer", "numba_published"] if coherence.kind in ("averaged", "centred") else []
    for name in names + ["stam_analytic"] * (coherence.kind == "averaged"):
        try:
            peer = importlib.import_module(f"bench.peers.{name}")
            reason = peer.available()
        except ImportError as error:
            reason = str(error)
        if reason is not None:
            print(f"{name} is excluded from the charts: {reason}.")
        elif name == "stam_analytic":
            result |= {"Stam, rainbow": (peer, peer.SETTINGS[:1]), "Stam, CIE": (peer, peer.SETTINGS[1:])}
        else:
            # The program in NumPy requires a hundred times the time of the other programs, so that only two of its
            # settings are measured.
            settings = [peer.SETTINGS[2], peer.SETTINGS[-2]] if name == "numpy_peer" else peer.SETTINGS
            result[PEERS[name]] = peer, [peer.PUBLISHED, *settings]
    return result


def best(peer: Any, settings: list[dict[str, Any]], heightfield: wd.HeightField, coherence: wd.Coherence) -> Shade:
    """Return the function by which a peer (another program) computes colours most accurately."""
    for setting in reversed(settings):
        with contextlib.suppress(ValueError):
            return cast("Shade", peer.prepare(heightfield, coherence, **setting))
    raise ValueError(f"{peer.__name__} supports none of its settings")


def label(setting: dict[str, Any]) -> str:
    """Return a short description of a setting of a peer (another program)."""
    if not setting:
        return "default"
    if "colours" in setting:
        return str(setting["colours"])
    side = 2 * setting["neighbour_extent"] + 1
    how = "rounding" if setting["rounded"] else "floor"
    return f"{setting['wavelengths']} λ, {setting['terms']} terms, {side} × {side} by {how}"


def plans(
    scene: Scene, coherence: wd.Coherence, directions: Directions, setting: Setting
) -> dict[tuple[str, str], wd.Plan]:
    """Return plans (method, number of wavelengths and so on) for the illuminated pixels of a scene.

    The keys of the dictionary are pairs (method, tolerance).
    """
    result = {}
    pairs = directions.to_lights, -directions.scattering_vectors - directions.to_lights
    options: dict[str, Any] = {"coherence": coherence, "device": setting.device, "threads": setting.threads}
    tolerances = TOLERANCES[:2] if setting.quick else TOLERANCES
    for method in (AUTOMATIC, *METHODS[coherence.kind]):
        for tolerance in tolerances:
            name, _, integration = ("auto" if method == AUTOMATIC else method).partition(", ")
            chosen = {"method": name, "integration": integration or "auto"}
            try:
                plan = wd.plan(scene.heightfield, *pairs, tolerance=tolerance, **chosen, **options)
            except ValueError:
                # If a method cannot meet the tolerance, its curve has no point at this tolerance.
                continue
            result[method, f"{tolerance:g}"] = plan
    return result


def measure_scene(scene: Scene, coherence: wd.Coherence, setting: Setting) -> dict[str, Any]:
    """Measure all curves of one chart: a scene with one coherence (how far light interferes)."""
    directions, _ = scene.directions(coherence)
    device = resolve_device(setting.device)
    few = directions.subset(JUDGED // 4 if setting.quick else JUDGED)
    exact = few.gains[:, None] * reference.colours(
        scene.heightfield, few.scattering_vectors, few.to_lights, coherence, tolerance=1e-3 if setting.quick else 3e-4
    )
    shades: dict[tuple[str, str], Shade] = {
        key: ours(scene.heightfield, plan, directions, device)
        for key, plan in plans(scene, coherence, directions, setting).items()
    }
    before = dict(_before(scene, coherence, directions, setting))
    for name, (peer, settings) in peers(coherence, setting).items():
        for options in settings if not setting.quick else settings[:1] + settings[1::2]:
            begin = time.perf_counter()
            try:
                shades[name, label(options)] = peer.prepare(scene.heightfield, coherence, **options)
            except ValueError as error:
                print(f"{name}, {label(options)}: {error}")
                continue
            before.setdefault(name, time.perf_counter() - begin)
    curves: dict[str, dict[str, Any]] = {}
    calls, counts = {}, {}
    for key, shade in shades.items():
        xyz = shade(few.scattering_vectors, few.gains, setting.threads)
        first = directions.subset(FEWEST)
        shade(first.scattering_vectors, first.gains, setting.threads)
        begin = time.perf_counter()
        shade(first.scattering_vectors, first.gains, setting.threads)
        per_pixel = (time.perf_counter() - begin) / len(first.gains)
        counts[key] = int(np.clip(TARGET_S / per_pixel, FEWEST, len(directions.gains)))
        timed = directions.subset(counts[key])
        calls[" | ".join(key)] = lambda s=shade, t=timed: s(t.scattering_vectors, t.gains, setting.threads)
        error = errors.relative(xyz, exact)
        columns = ("setting", "median", "p99", "delta_e", "us", "pixels")
        curve = curves.setdefault(key[0], {column: [] for column in columns})
        curve["setting"].append(key[1])
        curve["median"].append(float(np.median(error)))
        curve["p99"].append(float(np.percentile(error, 99.0)))
        curve["delta_e"].append(errors.colour_difference(xyz, exact))
        curve["pixels"].append(counts[key])
    seconds = interleaved(calls, setting.rounds)
    for key, count in counts.items():
        times = seconds[" | ".join(key)]
        curves[key[0]]["us"].append([1e6 * t / count for t in times[:3]])
    return {"scene": scene.title, "coherence": str(coherence), "curves": curves, "before_s": before}


def _before(scene: Scene, coherence: wd.Coherence, directions: Directions, setting: Setting) -> Any:
    """Yield methods of warpdiff with the time [s] to prepare a new height field; kernels are already compiled."""
    few = directions.subset(FEWEST)
    for method in ("low-rank, table", "low-rank"):
        if method in METHODS[coherence.kind]:
            heightfield = scene.make()
            begin = time.perf_counter()
            options: dict[str, Any] = {"device": setting.device, "threads": setting.threads, "strict": False}
            name, _, integration = method.partition(", ")
            plan = wd.plan(heightfield, coherence=coherence, method=name, integration=integration or "auto", **options)
            ours(heightfield, plan, few, resolve_device(setting.device))(
                few.scattering_vectors, few.gains, setting.threads
            )
            yield method, time.perf_counter() - begin


def measure(setting: Setting) -> dict[str, Any]:
    """Measure one chart per scene and coherence (how far light interferes). A quick run has only one chart."""
    results = {}
    for scene in scenes(setting.data):
        for coherence in scene.coherences:
            name = f"{coherence.kind}_{scene.name}"
            if setting.quick and name != "averaged_fingers":
                continue
            setting.say(f"pareto: {scene.title}, {coherence}")
            results[name] = measure_scene(scene, coherence, setting)
    return results


def numbers(results: dict[str, Any]) -> dict[str, list[Any]]:
    """Return times and errors by the name of the quantity, each a list [median, minimum, maximum, unit].

    Median, minimum and maximum are over the rounds of the timing.
    """
    result: dict[str, list[Any]] = {}
    for chart_name, scene in results.items():
        for method, curve in scene["curves"].items():
            for k, setting in enumerate(curve["setting"]):
                key = f"pareto/{chart_name}/{method}/{setting}"
                result[f"{key}/time"] = [*curve["us"][k], "µs per pixel"]
                for name, unit in (("median", "error"), ("p99", "error"), ("delta_e", "ΔE2000")):
                    result[f"{key}/{name}"] = [curve[name][k]] * 3 + [unit]
        for method, seconds in scene["before_s"].items():
            result[f"pareto/{chart_name}/{method}/before"] = [seconds] * 3 + ["s"]
    return result


def chart(results: dict[str, Any], folder: Path) -> dict[str, str]:
    """Draw one chart per scene and coherence. Return each chart's name and a sentence about its methods."""
    return {f"pareto_{name}": _draw(f"pareto_{name}", result, folder) for name, result in results.items()}


def _draw(name: str, result: dict[str, Any], folder: Path) -> str:
    plt = figures.pyplot()
    figure, axes = plt.subplots(1, 3, figsize=(17.0, 5.6), width_ratios=(1.0, 1.0, 0.7))
    curves = result["curves"]
    for axis, quantity, least in zip(axes, ("p99", "delta_e"), (1e-7, 1e-5), strict=False):
        ends = []
        for method, curve in curves.items():
            colour, marker, title = style(method)
            top = method == AUTOMATIC
            # The first setting of each program with the published algorithm is that of the publication (Single 2014).
            # It is drawn as a separate point, outside of the program's curve.
            begin = int(method in PEERS.values())
            us = np.array(curve["us"])
            order = [*range(begin), *(begin + np.argsort(us[begin:, 0]))]
            x, spread = us[order, 0], np.abs(us[order, 1:] - us[order, :1]).T
            y, median = (np.maximum(np.array(curve[name])[order], least) for name in (quantity, "median"))
            axis.plot(x[:begin], y[:begin], color=colour, marker=marker, markersize=7, fillstyle="none", zorder=3)
            axis.errorbar(
                x[begin:], y[begin:], xerr=spread[:, begin:], color=colour, marker=marker, markersize=13 if top else 5,
                linewidth=0.0 if top else 1.6, elinewidth=0.8, zorder=5 if top else 3, markeredgewidth=0.0,
            )  # fmt: skip
            if quantity == "p99" and not top:
                axis.plot(x[begin:], median[begin:], color=colour, linewidth=0.8, linestyle=(0, (1, 1.5)))
            if top:
                for at, height, k in zip(x, y, order, strict=True):
                    axis.annotate(
                        f"{float(curve['setting'][k]):.0e}".replace("e-0", "e-"), (at, height), xytext=(7, 6),
                        textcoords="offset points", fontsize=8, color=colour, zorder=6,
                    )  # fmt: skip
            last = int(np.argmin(y))
            ends.append((x[last], y[last], title, colour))
        axis.set(xscale="log", yscale="log", xlabel="time per pixel [µs]", xlim=(1e-2, 1e3))
        axis.set_ylim(least if min(e[1] for e in ends) <= least else None, 30.0 if quantity == "p99" else 300.0)
        figures.label_ends(axis, ends)
        axis.grid(color="#00000014", linewidth=0.8)
        axis.set_axisbelow(True)
    axes[0].set_title("error of XYZ: P99 (dotted: median, hollow: published setting)")
    axes[0].set_ylabel("error against the float64 reference")
    axes[1].set_title("colour difference: P99")
    axes[1].set_ylabel("ΔE2000")
    ends = []
    for method, before in result["before_s"].items():
        curve = curves.get(method)
        if curve is None or method.startswith("Stam"):
            continue
        best = _at(curve, 1e-2)
        if best is None:
            continue
        colour, marker, title = style(method)
        per_frame = [before / n + FRAME_PIXELS * 1e-6 * curve["us"][best][0] for n in FRAMES]
        axes[2].plot(FRAMES, per_frame, color=colour, marker=marker, markersize=4, linewidth=1.6)
        ends.append((FRAMES[-1], per_frame[-1], title, colour))
    axes[2].set(
        xscale="log", yscale="log", xlabel="frames of 150,000 illuminated pixels",
        ylabel="time per frame [s], with preparation", ylim=(1e-2, 1e2),
    )  # fmt: skip
    axes[2].set_title("at an error of 1e-2")
    figures.label_ends(axes[2], ends, gap=0.06)
    axes[2].grid(color="#00000014", linewidth=0.8)
    figure.suptitle(f"{result['scene']}: {result['coherence']}", x=0.01, ha="left", fontsize=12)
    figure.tight_layout(rect=(0.0, 0.0, 0.995, 0.97), w_pad=2.0)
    figures.save(figure, folder, name)
    return finding(result)


def _at(curve: dict[str, Any], error: float) -> int | None:
    """Return the index of a curve's fastest setting whose 99th percentile of errors is at most ``error``, or None."""
    good = [k for k, p99 in enumerate(curve["p99"]) if p99 <= error]
    return min(good, key=lambda k: curve["us"][k][0]) if good else None


def finding(result: dict[str, Any]) -> str:
    """Return a sentence that compares the method chosen by warpdiff with the fastest peer (other program).

    Both have errors of at most 1e-2.
    """
    curves = result["curves"]
    ours_at = _at(curves[AUTOMATIC], 1e-2)
    if ours_at is None:
        return "The automatic choice does not reach an error of 1e-2 here."
    mine = curves[AUTOMATIC]["us"][ours_at][0]
    text = f"At an error of 1e-2 the automatic choice requires {mine:.2g} µs per pixel"
    others = {
        name: curves[name]["us"][at][0]
        for name in curves
        if name != AUTOMATIC and (at := _at(curves[name], 1e-2)) is not None
    }
    rivals = {name: us for name, us in others.items() if style(name)[1] in "s^DP"}
    if rivals:
        best = min(rivals, key=lambda name: rivals[name])
        text += (
            f". The best peer ({style(best)[2]}) requires {rivals[best]:.2g} µs, {rivals[best] / mine:.2g} times that"
        )
    return text + "."
