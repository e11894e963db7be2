"""Frames with footprints: their time, their error against many rays a pixel, and what other ways of that error cost.

The scene is the tube at 640 × 480 with a surface of one's choice. Times are of whole calls of ``shade``, rays and
frames included, medians of rounds in which everything takes turns; light, view and mesh change in every frame, but for
those whose mesh stays where it is, and the plan is one for the whole hemisphere, which depends on none of them. Errors
are the design's, against the mean of many rays a pixel under the same filter, over pixels that lie wholly inside the
lit surface. The bar counts those whose |(u, v)| is above four deviations of their footprint and whose light stands
higher than cos θi = 0.3; the rest is tabled beside them.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import warpdiff as wd
from warpdiff import meshes
from warpdiff.bench import errors as judged
from warpdiff.bench import inputs, mean_bounds, multiply_adds, numba_published
from warpdiff.device import resolve_device, resolve_threads
from warpdiff.frame import Frame
from warpdiff.integration import Integrator
from warpdiff.launches import launch
from warpdiff.surface import prepare_surface

BAR = 3e-2
LIGHT = wd.DirectionalLight((0.1, 0.9, 1.2))
# The published algorithm where it errs by 5e-3 at a point: see bench/published.py. Patches that are small against the
# window have one coefficient in sight.
PUBLISHED = {"wavelengths": 272, "terms": 16, "reach": 2, "centred": True, "rounded": False}
SMALL_UM, SMALL = 40.0, {"reach": 1, "rounded": True}
ROUNDS = 7
RATE_ROUNDS = 2_000_000


def surface_of(name: str, data: Path) -> wd.HeightField:
    """The scan, or synthetic fingers of a size [µm]."""
    if name == "scan":
        scan = wd.HeightField.load(data / "elaphe_65um.png", extent_um=65.0, height_range_um=0.375)
        return scan.levelled(order=2)
    return wd.gratings.fingers(size_um=float(name), pitch_um=0.09, seed=2)


def camera(distance: float = 1.0, angle: float = 0.0, size: tuple[int, int] = (640, 480)) -> wd.View:
    """The tube from above, an orbit's angle on."""
    eye = np.array([3.1 * np.sin(angle), 1.6, 3.1 * np.cos(angle)]) * distance
    return wd.View(tuple(eye), (0.0, 0.0, 0.0), fov_y_deg=27.0, width=size[0], height=size[1])


class Scene:
    """A frame's geometry: what its pixels see."""

    def __init__(self, hf: wd.HeightField, mesh: Any, view: wd.View, threads: int, device: Any) -> None:
        window = wd.Coherence()
        frame = Frame(prepare_surface(mesh), view, means=True, device=device, threads=threads)
        frame.light_up([LIGHT], window, 1.0, normal=0.04)
        self.scope, self.lit, _ = frame.survey(hf, window)
        self.deflections, self.to_lights, self.gains = frame.directions()
        self.frame, self.spread = frame, frame.spread(0)
        x, y = (self.spread.numpy()[:, k:4:2] for k in (0, 1))
        xx, yy, xy = (x * x).sum(axis=1), (y * y).sum(axis=1), (x * y).sum(axis=1)
        deviation = np.sqrt((xx + yy + np.sqrt((xx - yy) ** 2 + 4.0 * xy * xy)) / 2.0)
        uv = np.hypot(self.deflections[:, 0], self.deflections[:, 1])
        self.barred = ((uv > 4.0 * deviation) & (self.to_lights[:, 2] > 0.3)).reshape(view.height, view.width)


def taken_ms(calls: dict[str, Any], rounds: int, device: Any) -> dict[str, tuple[float, float]]:
    """Median and least times of calls that take a round's number, in turns [ms]."""
    import warp as wp

    taken: dict[str, list[float]] = {name: [] for name in calls}
    for k in range(rounds + 1):
        for name, call in calls.items():
            begin = time.perf_counter()
            call(k)
            wp.synchronize_device(device)
            taken[name].append(1e3 * (time.perf_counter() - begin))
    return {name: (float(np.median(each[1:])), min(each[1:])) for name, each in taken.items()}


def errors(image: wd.Image, exact: wd.Image, where: Any) -> Any:
    """The design's error of the pixels wholly inside the lit surface, of those among them."""
    inside = (exact.coverage == 1.0) & image.lit
    floor = judged.FLOOR * judged.brightness(exact.xyz[inside][:, 1])
    chosen = inside & where
    size = np.maximum(np.linalg.norm(exact.xyz[chosen], axis=1), floor)
    return np.linalg.norm(image.xyz[chosen] - exact.xyz[chosen], axis=1) / size


def colour_difference(image: wd.Image, exact: wd.Image) -> float:
    """99th percentile of ΔE2000 of the pixels wholly inside the lit surface."""
    inside = (exact.coverage == 1.0) & image.lit
    return judged.colour_difference(image.xyz[inside], exact.xyz[inside])


def accuracy(hf: wd.HeightField, mesh: Any, scene: Scene, samples: list[int], options: dict[str, Any]) -> None:
    """Errors of frames with footprints, and of frames of few rays a pixel."""
    view = camera()
    made = {t: wd.shade(mesh, hf, LIGHT, view, tolerance=t, **options) for t in (3e-2, 1e-2)}
    fine = dataclasses.replace(made[1e-2].plan, nodes=64, rays_per_width=2.1, footprint=False)
    exact, before = None, None
    for count in samples:
        before, exact = exact, wd.shade(mesh, hf, LIGHT, view, plan=fine, samples_per_pixel=count, **options)
    inside = (exact.coverage == 1.0) & made[1e-2].lit
    share = np.mean(scene.barred[inside])
    print(f"\n{100.0 * share:.0f} % of {np.count_nonzero(inside)} pixels inside the lit surface count for the bar.")
    if before is not None:
        left = np.percentile(errors(before, exact, scene.barred), 99.0)
        print(f"From {samples[-2]} to {samples[-1]} rays a pixel 99 % of them change by less than {left:.1e}.")
    print("\n| picture | nodes | median | P95 | P99 | P99 of the rest | ΔE2000, P99 |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for tolerance, image in made.items():
        row(f"footprints, tolerance {tolerance:g}", image, exact, scene)
    for count in (1, 16, 64):
        few = wd.shade(mesh, hf, LIGHT, view, plan=fine, samples_per_pixel=count, **options)
        row(f"{count} rays a pixel, points", few, exact, scene)


def row(name: str, image: wd.Image, exact: wd.Image, scene: Scene) -> None:
    """Print a picture's errors."""
    found, rest = errors(image, exact, scene.barred), errors(image, exact, ~scene.barred)
    figures = " | ".join(f"{v:.1e}" for v in (np.median(found), *np.percentile(found, [95, 99])))
    difference = colour_difference(image, exact)
    print(
        f"| {name} | {image.plan.nodes} | {figures} | {np.percentile(rest, 99.0):.1e} | {difference:.2f} |", flush=True
    )


def speed(hf: wd.HeightField, mesh: Any, rounds: int, threads: int, device: Any) -> None:
    """Times of whole frames, near and far, large and small, and on one thread."""
    plans = {t: wd.plan(hf, tolerance=t, method="low-rank/table") for t in (3e-2, 1e-2)}
    # More than are kept, and lights that are never the same: no frame finds what another one has made ready.
    poses = [mesh.copy() for _ in range(16)]
    for k, each in enumerate(poses):
        each.apply_translation((1e-3 * k, 0.0, 0.0))
    moved, lit = itertools.cycle(poses), itertools.count()
    still = mesh.copy()

    def light(k: int) -> wd.DirectionalLight:
        return wd.DirectionalLight((0.1 + 0.02 * k + 1e-6 * next(lit), 0.9, 1.2))

    whole: dict[str, Any] = {}
    shares: dict[str, float] = {}

    def frame(
        name: str,
        tolerance: float,
        distance: float,
        size: tuple[int, int] = (640, 480),
        workers: int = threads,
        moves: bool = True,
    ) -> None:
        plan = dataclasses.replace(plans[tolerance], footprint=True)

        def call(k: int) -> wd.Image:
            body = next(moved) if moves else still
            view = camera(distance, 0.03 * k, size)
            return wd.shade(body, hf, light(k), view, plan=plan, threads=workers, device=device)

        whole[name] = call
        shares[name] = float(call(0).mask.mean())

    def drawn(name: str, tolerance: float, size: tuple[int, int] = (640, 480)) -> None:
        plan = dataclasses.replace(plans[tolerance], footprint=True)
        view = camera(0.25, 0.0, size)
        renderer = wd.Renderer(still, hf, LIGHT, view, plan=plan, threads=threads, device=device)
        whole[name] = lambda k: renderer.draw(light(k), camera(0.25, 0.03 * k, size))
        shares[name] = float(renderer.image().mask.mean())

    def print_times() -> None:
        """Time these frames together, and forget them."""
        print("\n| frame, 640 × 480 or as told | share filled | ms, median | least |\n| --- | --- | --- | --- |")
        for name, (median, least) in taken_ms(whole, rounds, device).items():
            print(f"| {name} | {shares[name]:.2f} | {median:.0f} | {least:.0f} |", flush=True)
        whole.clear()

    for tolerance in plans:
        for distance in (0.25, 0.5, 1.0, 2.0, 4.0):
            frame(f"tolerance {tolerance:g}, distance {distance:g}", tolerance, distance)
    for tolerance in plans:
        name = f"tolerance {tolerance:g}, distance 0.25"
        frame(f"{name}, a mesh that stays", tolerance, 0.25, moves=False)
        if device.is_cpu:
            frame(f"{name}, one thread", tolerance, 0.25, workers=1)
            frame(f"{name}, a mesh that stays, one thread", tolerance, 0.25, workers=1, moves=False)
    # A GPU's frames are recorded, and stay there.
    for tolerance in plans:
        drawn(f"tolerance {tolerance:g}, distance 0.25, a Renderer", tolerance)
    print_times()
    # By themselves, as memory of large frames goes back to the system: the next frame would wait for its pages.
    for size in ((320, 240), (1280, 960)) if device.is_cpu else ((1920, 1080), (3840, 2160)):
        name = f"tolerance 0.01, distance 0.25, {size[0]} × {size[1]}"
        frame(name, 1e-2, 0.25, size)
        drawn(f"{name}, a Renderer", 1e-2, size)
        print_times()


def kernels(hf: wd.HeightField, scene: Scene, rounds: int, threads: int, device: Any) -> None:
    """Times of the shading kernels alone on a frame's lit pixels, beside the published algorithm's; their bound."""
    import warp as wp

    lit = np.flatnonzero(scene.gains > 0.0)
    xyz = wp.zeros(len(lit), dtype=wp.vec3f, device=device)
    to_lights = wp.array(scene.to_lights[lit], dtype=wp.vec3f, device=device)
    gains = wp.array(scene.gains[lit], dtype=wp.float32, device=device)
    spread = wp.array(scene.spread.numpy()[lit], dtype=scene.spread.dtype, device=device)

    def look_up(made: Integrator, deflections: Any, footprints: Any = None) -> Any:
        on_device = wp.array(deflections, dtype=wp.vec3d, device=device)
        return lambda _: made.add(on_device, to_lights, gains, "D65", xyz, footprints=footprints)

    seen = scene.deflections[lit]
    calls: dict[str, Any] = {}
    for tolerance in (3e-2, 1e-2):
        plan = dataclasses.replace(wd.plan(hf, tolerance=tolerance, method="low-rank/table"), footprint=True)
        for workers in (threads, 1) if device.is_cpu else (1,):
            made = Integrator(hf, plan, scene.scope, device=device, threads=workers)
            for name, footprints in (("points", None), ("footprints", spread)):
                label = f"table of {plan.nodes} nodes, tolerance {tolerance:g}, {name}, {workers} threads"
                calls[label] = look_up(made, seen, footprints)
        sampled = wd.plan(hf, tolerance=tolerance, method="low-rank")
        of_samples = Integrator(hf, sampled, scene.scope, device=device, threads=threads)
        calls[f"sampled, tolerance {tolerance:g}, points, {threads} threads"] = look_up(of_samples, seen)
    calls["the last table, points in random order, 1 threads"] = look_up(
        made, np.random.default_rng(0).permutation(seen)
    )
    calls["the last table, all points alike, 1 threads"] = look_up(made, np.tile(seen[len(seen) // 2], (len(seen), 1)))
    frequency = float(np.max(np.hypot(seen[:, 0], seen[:, 1]))) / 0.38
    setting = PUBLISHED | (SMALL if max(hf.size_um) < SMALL_UM else {})
    series = numba_published.tables(hf, terms=setting.pop("terms"), centred=setting.pop("centred"), frequency=frequency)
    some = lit[:: max(1, len(lit) // 8000)]
    calls["published, 272 λ, 16 terms"] = lambda _: numba_published.shade(
        series, scene.deflections[some], scene.gains[some], powers=True, **setting
    )
    sums = wp.zeros(threads, dtype=wp.float32, device=device)
    # What is measured of a core says nothing of a GPU.
    if device.is_cpu:
        on_device = wp.array(seen, dtype=wp.vec3d, device=device)
        bounds = mean_bounds.MeanBounds(made.steps(on_device, to_lights, gains, "D65", xyz, spread)[0])
        calls["the last footprints' rows, found alone, 1 threads"] = lambda _: bounds.find()
        calls["the last footprints' rows, summed alone, 1 threads"] = lambda _: bounds.add()
        rate: dict[str, Any] = {"device": device, "slice_size": 1}
        for name, workers in (("rate of all", threads), ("rate", 1)):
            calls[name] = lambda _, workers=workers: launch(
                multiply_adds.multiply_add_rate, workers, [RATE_ROUNDS], [sums], threads=workers, **rate
            )
    times = taken_ms(calls, rounds, device)
    print("\n| kernel | µs a lit pixel, median | least |\n| --- | --- | --- |")
    for name, (median, least) in times.items():
        if not name.startswith("rate"):
            count = len(some) if name.startswith("published") else len(lit)
            print(f"| {name} | {1e3 * median / count:.3f} | {1e3 * least / count:.3f} |")
    if device.is_cpu:
        (_, of_one), (_, of_all) = times["rate"], times["rate of all"]
        per_second = multiply_adds.SUMS * RATE_ROUNDS / (1e-3 * of_one)
        a_row = 1e9 * bounds.numbers / 16 / per_second
        a_pixel = bounds.entries[:, 2].sum() / len(lit)
        print(
            f"\nA core does {per_second / 1e9:.1f} G multiply-adds of 16 floats a second: the 9 rows of "
            f"{bounds.numbers} numbers that a point takes are {9 * a_row:.1f} ns, the {a_pixel:.0f} of the last "
            f"footprints {a_pixel * a_row:.1f} ns. {threads} cores do {threads * of_one / of_all:.2f} times as many."
        )


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--surface", default="scan", help="scan, or the size of synthetic fingers in µm (scan)")
    parser.add_argument("--data", type=Path, help=inputs.HELP)
    parser.add_argument(
        "--samples", type=int, nargs="*", default=[256, 512], help="rays a pixel of the truth (256 512)"
    )
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"timed rounds ({ROUNDS})")
    parser.add_argument("--threads", type=int, help="threads on the CPU (default: one a core)")
    parser.add_argument("--device", help="a CUDA device (default: the CPU)")
    given = parser.parse_args()
    device = resolve_device(given.device)
    data = inputs.folder(given.data)
    threads = resolve_threads(given.threads)
    hf = surface_of(given.surface, data)
    mesh = meshes.tube(segments_along=128, segments_around=64)
    # Plans of a hemisphere are used a little beyond the sample that they were made from.
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    speed(hf, mesh, given.rounds, threads, device)
    kernels(hf, Scene(hf, mesh, camera(0.25), threads, device), given.rounds, threads, device)
    if given.samples:
        scene = Scene(hf, mesh, camera(), threads, device)
        accuracy(hf, mesh, scene, given.samples, {"threads": threads, "device": device})


if __name__ == "__main__":
    main()
