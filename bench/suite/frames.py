"""Frames: their time against their error, by points, by means and by means that are refined, on every subject.

A frame is 640 × 480, and light and view move from one to the next. Its error is that of crops of it, see ``crops``: the
design's, against 96 × 96 points in every pixel under the filter, over interior pixels of all crops together. Points are
the best of them: on one table, with the filter, 1 to 64 rays a pixel.
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from bench.reproduce import crops
from bench.suite import figures
from bench.suite.timing import in_turns

if TYPE_CHECKING:
    from pathlib import Path

    from bench.suite.runner import Setting

SURFACE = "fingers 25.6 µm"
SUBJECTS = ("snake", "tube", "low-poly", "disc", "bottle")
SEED, CROPS = 90, 4
TABLE = 1e-2


def measure(setting: Setting) -> dict[str, Any]:
    """Milliseconds a frame and errors, by subject and way."""
    names = crops.bodies(setting.data and str(setting.data), [])
    found: dict[str, Any] = {}
    for body in ("tube",) if setting.quick else SUBJECTS:
        if body not in names:
            print(f"Left out of the frames: the {body}, which is not in the data.")
            continue
        setting.say(f"frames of the {body}")
        found[body] = _measured(names[body](), body, setting)
    return found


def ways(quick: bool) -> dict[str, dict[str, Any]]:
    """What of ``Renderer`` each way takes."""
    result: dict[str, dict[str, Any]] = {"means": {"tolerance": 3e-2, "refine": False}}
    for tolerance in (1e-1, 3e-2) if quick else (2e-1, 1e-1, 5e-2, 3e-2, 2e-2):
        result[f"refined to {tolerance:g}"] = {"tolerance": tolerance}
    for count in (1, 4) if quick else (1, 4, 16, 64):
        result[f"points, {count}"] = {"tolerance": TABLE, "footprint": False, "samples_per_pixel": count}
    return result


def _measured(mesh: Any, body: str, setting: Setting) -> dict[str, Any]:
    heightfield = crops.surfaces(None)[SURFACE]()
    options = {"device": setting.device, "threads": setting.threads, "pigment": 0.0}
    made, validation_size = ways(setting.quick), []
    for index in range(1 if setting.quick else CROPS):
        rng = np.random.default_rng([SEED, index, zlib.crc32(body.encode())])
        crop = crops.crop(body, mesh, heightfield, 1.0, rng)
        validation_size.append((crop, crops.truth(crop, TABLE)))
    low, high = mesh.bounds
    centre, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0

    def moved(k: int) -> tuple[wd.DirectionalLight, wd.View]:
        towards = np.array([3.1 * np.sin(0.1 * k), 1.6, 3.1 * np.cos(0.1 * k)])
        eye = centre + towards / np.linalg.norm(towards) * 2.6 * radius
        view = wd.View(tuple(eye), tuple(centre), fov_y_deg=crops.FOV_DEG, width=640, height=480)
        return wd.DirectionalLight((0.1 + 0.05 * np.sin(k), 0.9, 1.2)), view

    drawn = {name: wd.Renderer(mesh, heightfield, *moved(0), **way, **options) for name, way in made.items()}
    number = iter(range(1, 10_000))
    taken = in_turns(
        {name: lambda r=each: r.draw(*moved(next(number))) for name, each in drawn.items()}, setting.rounds
    )
    result = {}
    for name, way in made.items():
        errors = []
        for crop, exact in validation_size:
            plan = {"plan": drawn[name].plan, "samples_per_pixel": way.get("samples_per_pixel", 1)}
            image = wd.shade(
                mesh, heightfield, crop.light, crop.view, **plan, refine=way.get("refine", True), **options
            )
            errors.append(crops.validation_size(crop, exact, image).interior)
        every = np.concatenate(errors)
        result[name] = {
            "ms": [1e3 * each for each in taken[name][:3]],
            "p50": float(np.median(every)),
            "p99": float(np.percentile(every, 99.0)),
        }
    return result


def numbers(found: dict[str, Any]) -> dict[str, list[Any]]:
    """Figures by name: [value, least, most, unit]."""
    result: dict[str, list[Any]] = {}
    for body, of_ways in found.items():
        for name, each in of_ways.items():
            middle, least, most = each["ms"]
            result[f"frames/{body}/{name}/time"] = [middle, least, most, "ms"]
            result[f"frames/{body}/{name}/P99"] = [each["p99"]] * 3 + ["error"]
    return result


def chart(found: dict[str, Any], folder: Path) -> dict[str, str]:
    """One panel a subject."""
    plt = figures.pyplot()
    figure, axes = plt.subplots(1, len(found), figsize=(3.4 * len(found) + 0.6, 3.9), sharey=True, squeeze=False)
    kinds = (("points", figures.GREY, "s"), ("refined", figures.BLUE, "o"), ("means", figures.SKY, "^"))
    for axis, (body, of_ways) in zip(axes[0], found.items(), strict=True):
        for kind, colour, marker in kinds:
            some = [each for name, each in of_ways.items() if name.startswith(kind)]
            ms, p99, p50 = ([each[k] if k != "ms" else each[k][0] for each in some] for k in ("ms", "p99", "p50"))
            axis.plot(ms, p99, color=colour, marker=marker, label=f"{kind}, P99")
            axis.plot(ms, p50, color=colour, marker=marker, linestyle=":", markersize=4, label=f"{kind}, median")
        axis.set(xscale="log", yscale="log", title=body, xlabel="ms a frame, 640 × 480")
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("error of interior pixels")
    axes[0][-1].legend(fontsize=7)
    figure.tight_layout()
    figures.save(figure, folder, "frames")
    return {"frames": f"Against the most points, 64 a pixel, frames refined to 1e-1 take and err {_beside(found)}."}


def _beside(found: dict[str, Any]) -> str:
    """How many times less time frames that are refined take than points, and how many times less they err."""
    told = []
    for body, of_ways in found.items():
        ours, points = of_ways["refined to 0.1"], [each for name, each in of_ways.items() if name.startswith("points")]
        most = max(points, key=lambda each: each["ms"][0])
        told.append(f"{most['ms'][0] / ours['ms'][0]:.0f} and {most['p99'] / ours['p99']:.1f} times less ({body})")
    return ", ".join(told)
