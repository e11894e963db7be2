"""The ray-casting part beside Embree and Mitsuba: rays a second at equal threads, and whether they are right."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

import warpdiff as wd
from bench.suite import figures
from bench.suite.timing import in_turns
from warpdiff import meshes

if TYPE_CHECKING:
    from pathlib import Path

    from bench.suite.runner import Setting

JUDGED = 1000


def measure(setting: Setting) -> dict[str, Any]:
    """Rays a second of all casters, one thread and all, and what they are off by."""
    from bench.peers import raycasters

    setting.say("rays")
    for reason in raycasters.missing():
        print(f"Left out of the rays: {reason}.")
    width = 320 if setting.quick else 640
    view = wd.View((0.0, 0.8, 1.55), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=width, height=3 * width // 4)
    rays = raycasters.rays_of(meshes.tube(segments_along=128, segments_around=64), view)
    made = raycasters.casters(rays)
    count = len(rays.origins)
    chosen = np.sort(np.random.default_rng(0).choice(count, JUDGED, replace=False))
    exact, sure = raycasters.truth(rays, chosen)
    threads = tuple({1: 0, setting.threads: 0})
    calls = {
        f"{name} | {each}": lambda c=caster, t=each: c.trace(t) for name, caster in made.items() for each in threads
    }
    taken = in_turns(calls, setting.rounds)
    found: dict[str, Any] = {"rays": count, "faces": len(rays.surface.faces), "casters": {}}
    for name, caster in made.items():
        for each in threads:
            caster.trace(each)
        seen = caster.found()
        hit, normal = seen.hit[chosen], seen.normal[chosen]
        both = sure & hit & exact.hit
        side = np.sign(np.einsum("ij,ij->i", normal[both], exact.normal[both]))
        away = np.linalg.norm(side[:, None] * normal[both] - exact.normal[both], axis=1)
        rates = {each: [1e-6 * count / t for t in taken[f"{name} | {each}"][:3]] for each in threads}
        found["casters"][name] = {
            "finds": caster.finds,
            "mrays": {str(each): [rate[0], rate[2], rate[1]] for each, rate in rates.items()},
            "wrong_hits": float(np.mean(hit[sure] != exact.hit[sure])),
            "normal_off": float(away.max()),
        }
    return found


def numbers(found: dict[str, Any]) -> dict[str, list[Any]]:
    """Figures by name: [value, least, most, unit]."""
    result: dict[str, list[Any]] = {}
    for name, each in found["casters"].items():
        for threads, rate in each["mrays"].items():
            result[f"rays/{name}/{threads} threads"] = [*rate, "M rays/s"]
        result[f"rays/{name}/wrong hits"] = [each["wrong_hits"]] * 3 + ["share"]
        result[f"rays/{name}/normal"] = [each["normal_off"]] * 3 + ["largest difference"]
    return result


def chart(found: dict[str, Any], folder: Path) -> dict[str, str]:
    """Bars, by threads."""
    plt = figures.pyplot()
    casters = found["casters"]
    figure, axis = plt.subplots(figsize=(9.5, 0.62 * len(casters) + 1.7))
    threads = list(next(iter(casters.values()))["mrays"])
    for k, count in enumerate(threads):
        y = np.arange(len(casters)) + (k - (len(threads) - 1) / 2) * 0.36
        rates = np.array([each["mrays"][count] for each in casters.values()])
        colour = figures.SKY if k == 0 else figures.BLUE
        axis.barh(y, rates[:, 0], 0.34, color=colour, xerr=np.abs(rates[:, 1:] - rates[:, :1]).T, ecolor=figures.GREY)
        for at, (rate, _, most) in zip(y, rates, strict=True):
            axis.text(most + 0.4, at, f"{rate:.1f}, {count} thread{'s' * (count != '1')}", va="center", fontsize=8.5)
    axis.set_yticks(range(len(casters)), [f"{name}\n({each['finds']})" for name, each in casters.items()], fontsize=9)
    axis.invert_yaxis()
    axis.set_xlim(right=1.22 * max(each["mrays"][threads[-1]][2] for each in casters.values()))
    axis.set_xlabel("million rays a second")
    axis.set_title(f"{found['rays']:,} rays of a picture, {found['faces']:,} faces; in brackets what is found")
    figure.tight_layout()
    figures.save(figure, folder, "rays")
    most = {name: each["mrays"][threads[-1]][0] for name, each in casters.items()}
    own = most.pop("warpdiff, face by face")
    theirs = {name: rate for name, rate in most.items() if not name.startswith("warpdiff")}
    off = max(each["wrong_hits"] for each in casters.values())
    text = f"Face by face, as pictures are made, ours finds {own:.0f} M pixels a second with all that shading takes"
    if theirs:
        best = max(theirs, key=lambda name: theirs[name])
        text += f"; {best} {theirs[best]:.0f}, and its rays are the faster ones: ours through the hierarchy do "
        text += f"{most['warpdiff, bare hits']:.0f}"
    return {"rays": f"{text}. Against brute force {'no hit is' if off == 0.0 else f'{off:.1e} of the hits are'} wrong."}
