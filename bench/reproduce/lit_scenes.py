"""Errors and times of pictures under skies, disc lights and many lights, on bodies that shadow themselves.

Each row is a scene, a surface and a light, such as ``whole_scan_sun``. The reference is a sum over directions with
shadows (``bench/truth/sky_sums.py``). A row has: the number of compared pixels; the processor time of the picture
relative to that of a picture with one directional light; percentiles of the errors relative to the tolerance; the sum
of Y relative to the reference; the number of pixels whose error exceeds the tolerance; the number of those pixels whose
estimated error ``image.error`` exceeds the tolerance, too; and the share of pixels whose error is at most the estimate.
The reference of pictures with many lights, such as ``tube_scan_16lights``, is the sum of pictures with one light each,
at an eighth of the tolerance.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import trimesh

import warpdiff as wd
from bench import inputs
from bench.reproduce.lights import converged_means, distances, sky
from bench.truth.sky_sums import SkySums

SIZE = {"width": 240, "height": 130}
# Direction to the disc lights of all scenes except the scene of a plate above a floor.
TOWARDS = (0.6, 1.0, -0.1)
CASES = [
    *(f"{scene}_scan_{light}" for scene in ("whole", "close", "coils", "tube") for light in ("sun", "nosun", "room")),
    *(f"{scene}_scan_{light}" for scene in ("whole", "close", "tube", "plate") for light in ("3", "10")),
    "tube_scan_30", "tube_fingers_3", "tube_fingers_10", "tube_scan_16lights", "close_scan_16lights",
]  # fmt: skip


def plate() -> trimesh.Trimesh:
    """Return a mesh of a horizontal plate above a larger floor; the plate casts a shadow on the floor."""
    parts = []
    for half, height in ((1.0, 0.0), (0.3, 0.4)):
        corners = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]], dtype=float)
        vertices = np.column_stack([half * corners[:, 0], np.full(4, height), half * corners[:, 1]])
        uv = 0.5 + 0.5 * corners
        visual = trimesh.visual.TextureVisuals(uv=uv)
        parts.append(trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False))
    return trimesh.util.concatenate(parts)


def room() -> np.ndarray:
    """Return an environment of a dark room with three bright areas (windows and light bulbs) of different colours."""
    height = 128
    elevation = 90.0 - (np.arange(height)[:, None] + 0.5) * 180.0 / height
    around = (np.arange(2 * height) + 0.5) * 180.0 / height
    result = (
        np.where(elevation < -50.0, 0.07, 0.03)[..., None] * np.array([1.0, 0.9, 0.8]) * np.ones((1, 2 * height, 1))
    )
    for azimuth, middle, width, tall, rgb in (
        (40.0, 25.0, 15.0, 12.0, (3.0, 3.2, 4.0)), (150.0, 10.0, 8.0, 14.0, (2.0, 2.1, 2.6)),
        (260.0, 55.0, 5.0, 5.0, (9.0, 6.0, 3.0)),
    ):  # fmt: skip
        away = (around - azimuth + 180.0) % 360.0 - 180.0
        inside = (np.abs(elevation - middle) < tall) & (np.abs(away) < width)
        result = np.where(inside[..., None], np.array(rgb), result)
    return result


SCENES: dict[str, tuple[Any, wd.View]] = {
    "whole": (wd.meshes.snake, wd.View((0, 3.4, 4), (0, 0, 0), fov_y_deg=13, **SIZE)),
    "close": (wd.meshes.snake, wd.View((-1.6, 2.2, 2.6), (-0.56, 0.06, 0.07), fov_y_deg=3.5, **SIZE)),
    "coils": (wd.meshes.snake, wd.View((-1.2, 2.6, 2.6), (-0.1, 0.02, 0.12), fov_y_deg=2.5, **SIZE)),
    "tube": (wd.meshes.tube, wd.View((0, 1.5, 4), (0, 0, 0), fov_y_deg=14, **SIZE)),
    "plate": (plate, wd.View((0, 2.2, 2.4), (-0.1, 0.1, 0), fov_y_deg=34, width=160, height=120)),
}
SKIES: dict[str, Any] = {"sun": lambda: sky(4.0, 128), "nosun": lambda: sky(0.0, 128), "room": room}


def many_lights(count: int) -> list[wd.DirectionalLight]:
    """Return directional lights that are evenly distributed over the upper hemisphere."""
    index = np.arange(count) + 0.5
    up, turn = 0.05 + 0.95 * index / count, index * np.pi * (3.0 - np.sqrt(5.0))
    level = np.sqrt(1.0 - up**2)
    return [
        wd.DirectionalLight(towards) for towards in zip(level * np.cos(turn), up, level * np.sin(turn), strict=True)
    ]


def scene_of(case: str, tolerance: float) -> tuple[Any, wd.HeightField, list[Any], wd.View, dict[str, Any]]:
    """Return mesh function, height field, lights, view and options of a case, such as "tube_scan_sun"."""
    scene, surface, name = case.split("_")
    make, view = SCENES[scene]
    if surface == "scan":
        heightfield = inputs.levelled_scan()
        if heightfield is None:
            raise SystemExit("error: the scan is missing in the folder that WARPDIFF_DATA names")
    else:
        heightfield = wd.gratings.fingers(size_um=12.8, pitch_um=0.08)
    lights: list[Any]
    if name in SKIES:
        lights = [wd.Environment(SKIES[name]())]
    elif name.endswith("lights"):
        lights = many_lights(int(name.removesuffix("lights")))
    else:
        towards = TOWARDS if scene != "plate" else (0.5, 1.0, -0.6)
        lights = [wd.DirectionalLight(towards, angular_diameter_deg=float(name))]
    window = wd.Coherence(sigma_um=16.25 if surface == "scan" else 8.0)
    return make, heightfield, lights, view, {
        "coherence": window, "tolerance": tolerance, "pigment": 0.0, "strict": False
    }  # fmt: skip


def reference(
    sums: SkySums, light: wd.DirectionalLight | np.ndarray, pixels: int, across: int, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return random interior pixels, their reference XYZ under a disc light or sky, and a mask.

    Interior pixels are those that the body covers completely. The mask selects pixels that are not black and whose
    reference has a standard error below a third of the tolerance.
    """
    places = np.random.default_rng(1).permutation(sums.interior())[:pixels]

    def summed(chosen: np.ndarray, across: int, seed: int) -> np.ndarray:
        if isinstance(light, np.ndarray):
            return sums.under_sky(chosen, light, across, seed)
        return sums.under_disc(chosen, light, across, seed)

    exact, spread, _ = converged_means(summed, places, across, 0, tolerance / 3.0)
    return places, exact, (spread < tolerance / 3.0) & (exact[:, 1] > 0.0)


def judge(case: str, *, tolerance: float, pixels: int, across: int) -> None:
    """Render a case such as "tube_scan_sun", compare the picture with sums over directions, and print a table row."""
    name = case.split("_")[2]
    make, heightfield, lights, view, options = scene_of(case, tolerance)
    body, window = make(), options["coherence"]
    renderer = wd.Renderer(body, heightfield, lights, view, **options)
    one = wd.Renderer(body, heightfield, wd.DirectionalLight(TOWARDS), view, **options)
    ratios = []
    for _ in range(3):
        seconds = []
        for timed in (one, renderer):
            begin = time.process_time()
            timed.draw()
            seconds.append(time.process_time() - begin)
        ratios.append(seconds[1] / seconds[0])
    image = renderer.image()
    if name.endswith("lights"):
        fine = wd.Renderer(body, heightfield, lights[0], view, plan=replace(renderer.plan, tolerance=tolerance / 8.0),
                           pigment=0.0)  # fmt: skip
        total = np.zeros(image.xyz.shape)
        for light in lights:
            fine.draw(light)
            total += fine.image().xyz
        places = np.argwhere(image.illuminated & (image.coverage > 0.999))
        exact = total[tuple(places.T)]
        converged = np.ones(len(exact), dtype=bool)
    else:
        light = SKIES[name]() if name in SKIES else lights[0]
        places, exact, converged = reference(SkySums(body, heightfield, view, window), light, pixels, across, tolerance)
    at = tuple(places[converged].T)
    bright = float(np.percentile(image.xyz[image.illuminated][:, 1], 99.0))
    errors = distances(image.xyz[at], exact[converged], bright) / tolerance
    reported = image.error[at] / tolerance
    p50, p90, p99 = np.percentile(errors, [50.0, 90.0, 99.0])
    share = image.xyz[at][:, 1].sum() / exact[converged][:, 1].sum()
    print(
        f"| {case} | {converged.sum()} | {statistics.median(ratios):.1f} | {p50:.2f} / {p90:.2f} / {p99:.2f} | "
        f"{share:.3f} | {np.count_nonzero(errors > 1.0)} | {np.count_nonzero(reported[errors > 1.0] > 1.0)} | "
        f"{np.mean(errors <= reported):.2f} |", flush=True,
    )  # fmt: skip


def flicker(case: str, *, tolerance: float, frames: int) -> None:
    """Print the flicker of a sequence of frames, relative to the tolerance.

    Flicker is the error of the change of a pixel's colour from one frame to the next. The reference is the change
    between the same frames at a fifth of the tolerance. Only pixels that the body covers completely in both frames are
    included. The camera moves by 1/48 of a turn around the body per frame.
    """
    make, heightfield, lights, view, options = scene_of(case, tolerance)
    body, differences = make(), []
    renderers = [
        wd.Renderer(body, heightfield, lights, view, **{**options, "tolerance": tolerance * share})
        for share in (1.0, 0.2)
    ]
    before = None
    for shot in wd.turntable(lights, view, count=48)[:frames]:
        images = []
        for renderer in renderers:
            renderer.draw(shot.lights, view=shot.view)
            images.append(renderer.image())
        inside = images[1].illuminated & (images[1].coverage > 0.999)
        xyz = [image.xyz.astype(np.float64) for image in images]
        if before is not None:
            chosen = inside & before[1]
            scale = np.maximum(np.linalg.norm(xyz[1], axis=2), np.linalg.norm(before[0][1], axis=2))[chosen]
            scale = np.maximum(scale, 1e-3 * np.percentile(xyz[1][chosen][:, 1], 99.0))
            wrong = (xyz[0] - before[0][0]) - (xyz[1] - before[0][1])
            differences.append(np.linalg.norm(wrong[chosen], axis=1) / scale / tolerance)
        before = xyz, inside
    shares = np.percentile(np.concatenate(differences), [50.0, 90.0, 99.0])
    print(f"| {case} | {frames} | {' / '.join(f'{share:.2f}' for share in shares)} |", flush=True)


def main() -> int:
    """Print a table with the errors and times of the pictures of all cases."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--cases", nargs="+", default=CASES, metavar="SCENE_SURFACE_LIGHT", help="cases to render (default: all)"
    )
    parser.add_argument("--tolerance", type=float, default=1e-1, help="tolerance of the pictures (default: 0.1)")
    parser.add_argument("--pixels", type=int, default=100, help="number of pixels per case (default: 100)")
    parser.add_argument(
        "--across", type=int, default=128, help="rays of the reference along each axis of a pixel (default: 128)"
    )
    parser.add_argument(
        "--flicker", type=int, metavar="FRAMES", help="print the flicker of this many turntable frames instead"
    )
    options = parser.parse_args()
    if options.flicker:
        print("| case | frames | flicker, P50 / P90 / P99 |\n" + 3 * "| --- " + "|")
        for case in options.cases:
            flicker(case, tolerance=options.tolerance, frames=options.flicker)
        return 0
    print(
        "| case | pixels | time ratio | P50 / P90 / P99 | sum of Y | above | reported | bounded |\n"
        + 8 * "| --- "
        + "|"
    )
    for case in options.cases:
        judge(case, tolerance=options.tolerance, pixels=options.pixels, across=options.across)
    return 0


if __name__ == "__main__":
    sys.exit(main())
