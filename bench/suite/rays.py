"""Ray tracing compared with Embree and Mitsuba: rays per second with equal numbers of threads, and errors of hits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from bench.suite import figures
from bench.suite.timing import interleaved
from warpdiff import meshes

if TYPE_CHECKING:
    from pathlib import Path

    from bench.suite.runner import Setting

# Number of random rays whose hits are compared with the brute-force reference. The value is limited by the time and the
# memory of the reference.
JUDGED = 1000


def measure(setting: Setting) -> dict[str, Any]:
    """Return the rays per second and the errors of the hits of all programs, with one thread and with all threads."""
    from bench.peers import raycasters

    setting.say("rays")
    for reason in raycasters.missing():
        print(f"A program is excluded from the chart of rays: {reason}.")
    width = 320 if setting.quick else 640
    view = wd.View((0.0, 0.8, 1.55), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=width, height=3 * width // 4)
    rays = raycasters.rays_of(meshes.tube(segments_along=128, segments_around=64), view)
    casters = raycasters.casters(rays)
    count = len(rays.origins)
    chosen = np.sort(np.random.default_rng(0).choice(count, JUDGED, replace=False))
    exact, sure = raycasters.truth(rays, chosen)
    threads = tuple({1: 0, setting.threads: 0})
    calls = {
        f"{name} | {number}": lambda c=caster, t=number: c.trace(t)
        for name, caster in casters.items()
        for number in threads
    }
    times = interleaved(calls, setting.rounds)
    results: dict[str, Any] = {"rays": count, "faces": len(rays.surface.faces), "casters": {}}
    for name, caster in casters.items():
        for number in threads:
            caster.trace(number)
        hits = caster.hits()
        hit, normal = hits.hit[chosen], hits.normal[chosen]
        both = sure & hit & exact.hit
        side = np.sign(np.einsum("ij,ij->i", normal[both], exact.normal[both]))
        away = np.linalg.norm(side[:, None] * normal[both] - exact.normal[both], axis=1)
        rates = {number: [1e-6 * count / t for t in times[f"{name} | {number}"][:3]] for number in threads}
        results["casters"][name] = {
            "mrays": {str(number): [rate[0], rate[2], rate[1]] for number, rate in rates.items()},
            "wrong_hits": float(np.mean(hit[sure] != exact.hit[sure])),
            "normal_off": float(away.max()),
        }
    return results


def numbers(results: dict[str, Any]) -> dict[str, list[Any]]:
    """Return ray rates and errors by name, each a list [median, minimum, maximum over the rounds, unit]."""
    result: dict[str, list[Any]] = {}
    for name, figure in results["casters"].items():
        for threads, rate in figure["mrays"].items():
            result[f"rays/{name}/{threads} threads"] = [*rate, "M rays/s"]
        result[f"rays/{name}/wrong hits"] = [figure["wrong_hits"]] * 3 + ["share"]
        result[f"rays/{name}/normal"] = [figure["normal_off"]] * 3 + ["largest difference"]
    return result


def chart(results: dict[str, Any], folder: Path) -> dict[str, str]:
    """Draw one bar per program and number of threads. Return the chart's name and a sentence about the rates."""
    plt = figures.pyplot()
    casters = results["casters"]
    figure, axis = plt.subplots(figsize=(9.5, 0.62 * len(casters) + 1.7))
    threads = list(next(iter(casters.values()))["mrays"])
    for k, count in enumerate(threads):
        y = np.arange(len(casters)) + (k - (len(threads) - 1) / 2) * 0.36
        rates = np.array([caster["mrays"][count] for caster in casters.values()])
        colour = figures.SKY if k == 0 else figures.BLUE
        axis.barh(y, rates[:, 0], 0.34, color=colour, xerr=np.abs(rates[:, 1:] - rates[:, :1]).T, ecolor=figures.GREY)
        for at, (rate, _, most) in zip(y, rates, strict=True):
            axis.text(most + 0.4, at, f"{rate:.1f}, {count} thread{'s' * (count != '1')}", va="center", fontsize=8.5)
    axis.set_yticks(range(len(casters)), casters, fontsize=9)
    axis.invert_yaxis()
    axis.set_xlim(right=1.22 * max(caster["mrays"][threads[-1]][2] for caster in casters.values()))
    axis.set_xlabel("million rays per second")
    axis.set_title(f"{results['rays']:,} rays of a picture, {results['faces']:,} faces")
    figure.tight_layout()
    figures.save(figure, folder, "rays")
    most = {name: caster["mrays"][threads[-1]][0] for name, caster in casters.items()}
    own = most.pop("warpdiff, face by face")
    theirs = {name: rate for name, rate in most.items() if not name.startswith("warpdiff")}
    off = max(caster["wrong_hits"] for caster in casters.values())
    text = f"By rasterization, as in pictures, warpdiff fills the G-buffer of {own:.0f} M pixels per second"
    if theirs:
        best = max(theirs, key=lambda name: theirs[name])
        text += f". {best}: {theirs[best]:.0f} M rays per second; warpdiff with its hierarchy: "
        text += f"{most['warpdiff, bare hits']:.0f} M"
    wrong = "no hit is" if off == 0.0 else f"{off:.1e} of the hits are"
    return {"rays": f"{text}. Compared with brute force, {wrong} wrong."}
