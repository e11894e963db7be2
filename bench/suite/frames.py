"""Frames: time and error of three methods to sample a pixel. The chart has one panel (diagram) per body.

A frame has 640 × 480 pixels, and the light and the camera move from frame to frame. Errors are those of interior pixels
of small parts (crops) of pictures, relative to means over 96 × 96 points per pixel (see ``bench.reproduce.crops``). The
compared methods are: point samples with 1 to 64 rays per pixel under the pixel filter; footprints ("means"), which
average colours over the area of a pixel without subdivision; and footprints that are refined by subdivision at several
tolerances.
"""

from __future__ import annotations

import functools
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

import warpdiff as wd
from bench.reproduce import crops
from bench.suite import figures
from bench.suite.timing import interleaved

if TYPE_CHECKING:
    from pathlib import Path

    from bench.suite.runner import Setting

SURFACE = "fingers 25.6 µm"
SUBJECTS = ("snake", "tube", "low-poly", "disc", "bottle")
# Seed of the random positions of crops (small parts of pictures), and number of crops per body.
SEED, CROPS = 90, 4
# Tolerance of frames that are rendered with point samples. The value was derived: it is half of the smallest tolerance
# of the refined frames. The reference is computed with a third of this value as its tolerance.
TABLE = 1e-2


def measure(setting: Setting) -> dict[str, Any]:
    """Return times per frame [ms] and errors, by body and method."""
    names = crops.bodies(setting.data and str(setting.data))
    results: dict[str, Any] = {}
    for body in ("tube",) if setting.quick else SUBJECTS:
        if body not in names:
            print(f"No frames of the {body}: its mesh is not in the data folder.")
            continue
        setting.say(f"frames of the {body}")
        results[body] = _measured(names[body](), body, setting)
    return results


def ways(quick: bool) -> dict[str, dict[str, Any]]:
    """Return the arguments of ``Renderer`` for each compared method to sample a pixel, by name."""
    result: dict[str, dict[str, Any]] = {"means": {"tolerance": 3e-2, "refine": False}}
    for tolerance in (1e-1, 3e-2) if quick else (2e-1, 1e-1, 5e-2, 3e-2, 2e-2):
        result[f"refined to {tolerance:g}"] = {"tolerance": tolerance}
    for count in (1, 4) if quick else (1, 4, 16, 64):
        result[f"points, {count}"] = {"tolerance": TABLE, "footprint": False, "samples_per_pixel": count}
    return result


def moved(mesh: Any, k: int) -> tuple[wd.DirectionalLight, wd.View]:
    """Return the light and the view of frame k. The camera moves around the mesh."""
    low, high = mesh.bounds
    centre, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
    towards = np.array([3.1 * np.sin(0.1 * k), 1.6, 3.1 * np.cos(0.1 * k)])
    eye = centre + towards / np.linalg.norm(towards) * 2.6 * radius
    view = wd.View(tuple(eye), tuple(centre), fov_y_deg=crops.FOV_DEG, width=640, height=480)
    return wd.DirectionalLight((0.1 + 0.05 * np.sin(k), 0.9, 1.2)), view


def _measured(mesh: Any, body: str, setting: Setting) -> dict[str, Any]:
    heightfield = crops.surfaces(None)[SURFACE]()
    options = {"device": setting.device, "threads": setting.threads, "pigment": 0.0}
    variants, cases = ways(setting.quick), []
    for index in range(1 if setting.quick else CROPS):
        rng = np.random.default_rng([SEED, index, zlib.crc32(body.encode())])
        crop = crops.crop(body, mesh, heightfield, 1.0, rng)
        cases.append((crop, crops.truth(crop, TABLE)))
    renderers = {
        name: wd.Renderer(mesh, heightfield, *moved(mesh, 0), **way, **options) for name, way in variants.items()
    }
    number = iter(range(1, 10_000))

    def draw(renderer: wd.Renderer) -> None:
        # A GPU works asynchronously. If the script did not wait for it, the measured time would end before the frame is
        # complete.
        wp.synchronize_device(renderer.draw(*moved(mesh, next(number))).device)

    times = interleaved({name: functools.partial(draw, one) for name, one in renderers.items()}, setting.rounds)
    result = {}
    for name, way in variants.items():
        plan = {"plan": renderers[name].plan, "samples_per_pixel": way.get("samples_per_pixel", 1)}
        refine, errors = way.get("refine", True), []
        for crop, exact in cases:
            image = wd.shade(mesh, heightfield, crop.light, crop.view, **plan, refine=refine, **options)
            errors.append(crops.measured(crop, exact, image).interior)
        p50, p99 = np.percentile(np.concatenate(errors), (50.0, 99.0)).tolist()
        result[name] = {"ms": [1e3 * seconds for seconds in times[name][:3]], "p50": p50, "p99": p99}
    return result


def numbers(results: dict[str, Any]) -> dict[str, list[Any]]:
    """Return times and errors by name, each a list [median, minimum, maximum over the rounds, unit]."""
    result: dict[str, list[Any]] = {}
    for body, by_method in results.items():
        for name, figure in by_method.items():
            middle, least, most = figure["ms"]
            result[f"frames/{body}/{name}/time"] = [middle, least, most, "ms"]
            result[f"frames/{body}/{name}/P99"] = [figure["p99"]] * 3 + ["error"]
    return result


def chart(results: dict[str, Any], folder: Path) -> dict[str, str]:
    """Draw one diagram per body. Return the chart's name and a sentence that compares refined frames with points."""
    plt = figures.pyplot()
    figure, axes = plt.subplots(1, len(results), figsize=(3.4 * len(results) + 0.6, 3.9), sharey=True, squeeze=False)
    kinds = (("points", figures.GREY, "s"), ("refined", figures.BLUE, "o"), ("means", figures.SKY, "^"))
    for axis, (body, by_method) in zip(axes[0], results.items(), strict=True):
        for kind, colour, marker in kinds:
            points = [figure for name, figure in by_method.items() if name.startswith(kind)]
            ms, p99, p50 = ([point[k] if k != "ms" else point[k][0] for point in points] for k in ("ms", "p99", "p50"))
            axis.plot(ms, p99, color=colour, marker=marker, label=f"{kind}, P99")
            axis.plot(ms, p50, color=colour, marker=marker, linestyle=":", markersize=4, label=f"{kind}, median")
        axis.set(xscale="log", yscale="log", title=body, xlabel="time per frame [ms], 640 × 480")
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("error of interior pixels")
    axes[0][-1].legend(fontsize=7)
    figure.tight_layout()
    figures.save(figure, folder, "frames")
    return {
        "frames": f"Frames refined to 1e-1, relative to 64 points per pixel: time and error are {_ratios(results)}."
    }


def _ratios(results: dict[str, Any]) -> str:
    """Return a text that compares frames refined to a tolerance of 0.1 with point samples, for each body.

    The text states two ratios: of times, and of 99th percentiles (P99) of errors. Each ratio divides the value with the
    largest number of point samples per pixel by the value of the refined frame.
    """
    texts = []
    for body, by_method in results.items():
        ours, points = by_method["refined to 0.1"], [by_method[name] for name in by_method if name.startswith("points")]
        most = max(points, key=lambda figure: figure["ms"][0])
        texts.append(f"{most['ms'][0] / ours['ms'][0]:.0f} and {most['p99'] / ours['p99']:.1f} times smaller ({body})")
    return ", ".join(texts)
