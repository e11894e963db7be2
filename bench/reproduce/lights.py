"""Errors of pictures under disc lights and environments, relative to sums over directions, with shadows.

``--sizes`` compares pictures under disc lights in random cases with sums over points of the discs. ``--skies`` compares
pictures under environments with sums over all directions. The sums (``bench/truth/sky_sums.py``) share no code with the
library's lights. ``--picture`` saves the README's picture of a snake under a sky.
"""

from __future__ import annotations

import argparse
import functools
import math
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

import warpdiff as wd
from bench import inputs
from bench.reproduce import crops
from bench.truth.sky_sums import SkySums

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

# Angular diameters of the disc lights [degrees].
DIAMETERS = (1.0, 5.0, 10.0, 20.0, 60.0)
COLUMNS = (
    "| {} | body, surface | pixels | by | median | P90 | P99 | estimated | reported | frame |\n" + 10 * "| --- " + "|"
)


def sky(sun: float = 0.0, height: int = 64, elevation_deg: float = 55.0, azimuth_deg: float = 1.0) -> np.ndarray:
    """Return an environment map of a clear sky, brighter towards the horizon, above dark ground.

    The sun is one pixel with the power ``sun``, which is its radiance times its solid angle.
    """
    polar = (np.arange(height) + 0.5) / height * math.pi
    up = np.maximum(np.cos(polar), 0.0)[:, None, None]
    colour = np.array([0.25, 0.45, 1.0]) + (np.array([0.9, 0.95, 1.0]) - [0.25, 0.45, 1.0]) * (1.0 - up) ** 3
    radiance = np.where(np.cos(polar)[:, None, None] > 0.0, colour, [0.12, 0.1, 0.08]) * np.ones((1, 2 * height, 1))
    row = int((90.0 - elevation_deg) / 180.0 * height)
    solid = math.sin(polar[row]) * (math.pi / height) ** 2
    radiance[row, int((azimuth_deg / 180.0 + 1.0) * height)] += sun / solid * np.array([1.0, 0.9, 0.75])
    return radiance


def random_sky(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Return a random grey environment: a sky with a low or a high sun, a room with a window, or an overcast sky."""
    height = 128
    azimuth_deg = rng.uniform(-180.0, 180.0)
    if kind in ("low sun", "high sun"):
        elevation_deg = rng.uniform(5.0, 25.0) if kind == "low sun" else rng.uniform(35.0, 75.0)
        return sky(rng.uniform(1.0, 8.0), height, elevation_deg, azimuth_deg).mean(axis=2)
    elevation = 90.0 - (np.arange(height)[:, None] + 0.5) * 180.0 / height
    around = (np.arange(2 * height) + 0.5) * 180.0 / height
    away = (around - azimuth_deg) % 360.0 - 180.0
    if kind == "window":
        size, middle = rng.uniform(6.0, 25.0, 2), rng.uniform(-5.0, 45.0)
        inside = (np.abs(elevation - middle) < size[0]) & (np.abs(away) < size[1])
        return np.where(inside, rng.uniform(1.0, 4.0), np.where(elevation < -50.0, 0.07, 0.03))
    bright = (1.0 + 2.0 * np.sin(np.radians(np.maximum(elevation, 0.0)))) / 3.0
    bright = bright * (1.0 + rng.uniform(0.3, 0.8) * np.cos(np.radians(away)))
    return np.where(elevation > 0.0, bright, rng.uniform(0.05, 0.3))


def random_cases(seed: int) -> Iterator[tuple[str, np.ndarray, Any, wd.HeightField, wd.View, float]]:
    """Yield random cases: name, environment, mesh, height field, view, and σ of the Gaussian coherence window [µm]."""
    rng = np.random.default_rng(seed)
    scan = inputs.levelled_scan()
    bodies: dict[str, Callable[[], Any]] = {
        "disc": wd.meshes.disc,
        "tube": wd.meshes.tube,
        "low-poly snake": lambda: wd.meshes.snake(scale_rows=5, ventrals=8, segments=2),
        "lumps": lambda: crops.lumpy(4),
    }
    if (bottle := inputs.folder() / "fuze.obj").is_file():
        bodies["bottle"] = lambda: trimesh.load(bottle, force="mesh")
    surfaces: dict[str, Callable[[], wd.HeightField]] = {
        "fingers": lambda: wd.gratings.fingers(size_um=12.8, pitch_um=0.08, seed=int(rng.integers(1 << 30))),
        "blazed": lambda: wd.gratings.blazed(rng.uniform(1.2, 4.0), rng.uniform(0.1, 0.4)),
        "pits": lambda: wd.gratings.disc(
            "DVD", tracks=16, length_um=12.8, pitch_um=0.06, seed=int(rng.integers(1 << 30))
        ),
    }
    if scan is not None:
        surfaces["scan"] = lambda: scan
    kinds = ["window", "low sun", "overcast", "window", "high sun"] * 2
    names = [rng.permutation(list(makers)) for makers in (bodies, surfaces)]
    for index, kind in enumerate(kinds):
        body, surface = (of_kind[index % len(of_kind)] for of_kind in names)
        mesh = bodies[body]()
        middle, radius = mesh.bounds.mean(axis=0), 0.5 * float(np.linalg.norm(np.ptp(mesh.bounds, axis=0)))
        towards = rng.normal(size=3)
        towards[1], towards[2] = abs(towards[1]), abs(towards[2]) + 0.3
        eye = middle + 5.0 * radius * towards / np.linalg.norm(towards)
        view = wd.View(tuple(eye), tuple(middle), fov_y_deg=16.0, width=96, height=72)
        name = f"{kind} | {body}, {surface}"
        yield name, random_sky(kind, rng), mesh, surfaces[surface](), view, 16.25 if surface == "scan" else 8.0


def distances(xyz: np.ndarray, exact: np.ndarray, bright: float = 0.0) -> np.ndarray:
    """Return errors ‖ΔXYZ‖ of colours ``xyz`` (n, 3) relative to ‖XYZ‖ of the exact colours ``exact``.

    ``bright`` is the 99th percentile of Y over the whole picture. If ‖XYZ‖ is less than a thousandth of ``bright``, the
    error is relative to this thousandth.
    """
    floor = 1e-3 * max(np.percentile(exact[:, 1], 99.0), bright, 1e-30)
    return np.asarray(np.linalg.norm(xyz - exact, axis=1) / np.maximum(np.linalg.norm(exact, axis=1), floor))


def percentiles(errors: np.ndarray, between: str = " | ") -> str:
    """Return a text with the median and the 90th and 99th percentiles of errors."""
    return between.join(f"{100.0 * value:.1f} %" for value in np.percentile(errors, [50.0, 90.0, 99.0]))


def against_sums(kind: str, seed: int, pixels: int, across: int, tolerances: list[float]) -> None:
    """Print errors of pictures in random cases relative to sums over directions, for disc lights or environments.

    The sums have at least 32 times ``across`` rays along each axis of a pixel. The errors of the sums themselves are in
    a separate row. Columns are: percentiles of the errors and of the estimated errors ``image.error``; the time of a
    frame; the number of pixels whose error exceeds the tolerance; and the number of those pixels whose estimated error
    exceeds the tolerance, too.
    """
    rng = np.random.default_rng(seed + (2 if kind == "light" else 1))
    print(COLUMNS.format(kind))
    for index, (name, grey, mesh, heightfield, view, sigma_um) in enumerate(random_cases(seed)):
        window = wd.Coherence(sigma_um=sigma_um)
        options = {"mesh": mesh, "heightfield": heightfield, "view": view, "coherence": window}
        sums = SkySums(mesh, heightfield, view, window)
        inside = rng.permutation(sums.interior())[:pixels]
        if kind == "sky":
            options["lights"] = wd.Environment(np.repeat(grey[..., None], 3, axis=2))
            summed = functools.partial(sums.under_sky, sky=grey)
            _judge(name, inside, summed, 32 * across, seed, tolerances, options=options)
            continue
        # The direction to the light is the direction to the eye plus a random vector with components from −0.7 to 0.7.
        towards = np.asarray(view.eye) - np.asarray(view.target)
        towards = towards / np.linalg.norm(towards) + rng.uniform(-0.7, 0.7, 3)
        degrees = DIAMETERS[index % len(DIAMETERS)]
        light = options["lights"] = wd.DirectionalLight(tuple(towards), angular_diameter_deg=degrees)
        title, summed = f"{degrees:g}° | {name.split(' | ')[1]}", functools.partial(sums.under_disc, light=light)
        _judge(title, inside, summed, 32 * across, seed, tolerances, options=options)


def _judge(
    name: str, chosen: np.ndarray, summed: Callable[..., np.ndarray], across: int, seed: int, tolerances: list[float],
    *, options: dict[str, Any],
) -> None:  # fmt: skip
    """Render a case at several tolerances; print the errors relative to sums over directions, and estimated errors."""
    if not len(chosen):
        print(f"| {name} | 0 | no pixel is completely covered by the mesh |" + " |" * 6)
        return
    exact, spread, rays = converged_means(summed, chosen, across, seed, min(tolerances) / 3.0)
    converged = (spread <= min(tolerances) / 3.0) & (exact[:, 1] > 0.0)
    note = (
        f"sums of at least {rays:,} rays; {np.count_nonzero(~converged)} pixels are black or not converged (excluded)"
    )
    print(f"| {name} | {len(chosen)} | {note} | {percentiles(spread)} | | | |", flush=True)
    if not converged.any():
        return
    exact, at = exact[converged], tuple(chosen[converged].T)
    for tolerance in tolerances:
        begin = time.perf_counter()
        image = wd.shade(**options, tolerance=tolerance, pigment=0.0, strict=False)
        seconds = time.perf_counter() - begin
        # Errors of dark pixels are relative to a luminance floor. The floor is derived from the luminance of the whole
        # picture, because the chosen pixels may all be dark.
        bright = float(np.percentile(image.xyz[image.illuminated][:, 1], 99.0))
        errors, expected = distances(image.xyz[at], exact, bright), image.error[at]
        wrong = errors > tolerance
        reported = f"{np.count_nonzero(expected[wrong] > tolerance)} of {np.count_nonzero(wrong)}"
        print(
            f"| {name} | {len(exact)} | {tolerance:g}, {image.report.light_sample_count:,} | {percentiles(errors)} | "
            f"{percentiles(expected, ' / ')} | {reported} | {seconds:.1f} s |", flush=True,
        )  # fmt: skip


def converged_means(
    summed: Callable[..., np.ndarray], chosen: np.ndarray, across: int, seed: int, bound: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the mean colours of pixels, the standard errors of these means, and the least number of rays per pixel.

    The function ``summed`` computes a pixel's colour as a sum over directions, four times with different seeds. The
    mean and the standard error are those of the four results.

    For pixels with a standard error above ``bound``, the sums are repeated with four and sixteen times as many rays.
    """
    sets = np.zeros((4, len(chosen), 3))
    spread = np.zeros(len(chosen))
    active = np.arange(len(chosen))
    for more in (1, 2, 4):
        sets[:, active] = [summed(chosen[active], across=more * across, seed=4 * seed + number) for number in range(4)]
        exact = sets.mean(axis=0)
        spread = np.sqrt(sum(distances(means, exact) ** 2 for means in sets) / 12.0)
        active = np.flatnonzero(spread > bound)
    return exact, spread, len(sets) * across**2


def picture(path: str) -> None:
    """Save a picture of a snake with the scan as its surface, under a clear sky with a sun."""
    scan = inputs.levelled_scan()
    if scan is None:
        raise FileNotFoundError("--picture requires the scan, which is missing in the folder that WARPDIFF_DATA names")
    view = wd.View((-1.6, 2.2, 2.6), (-0.56, 0.06, 0.07), fov_y_deg=12.2, width=480, height=288)
    above = wd.Environment(sky(sun=10.0, height=128, elevation_deg=50.0, azimuth_deg=95.0))
    image = wd.shade(wd.meshes.snake(), scan, above, view, tolerance=1e-1, pigment=0.05)
    image.save(path, background=(1.0, 1.0, 1.0), exposure_stops=-0.7)


def main() -> int:
    """Print the tables of errors under disc lights and environments that the options select, or both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", action="store_true", help="compare disc lights with sums over points of the disc")
    parser.add_argument("--skies", action="store_true", help="compare random environments with sums over directions")
    parser.add_argument("--picture", metavar="FILE", help="save a picture of a snake under a sky")
    parser.add_argument("--seed", type=int, default=0, help="random seed of --sizes and --skies (default: 0)")
    parser.add_argument("--pixels", type=int, default=150, help="number of pixels per case (default: 150)")
    parser.add_argument(
        "--across", type=int, default=3, help="a 32nd of the rays along each axis of a pixel (default: 3)"
    )
    parser.add_argument(
        "--tolerances",
        type=float,
        nargs="+",
        default=[1e-1, 3e-2],
        help="tolerances of the pictures (default: 0.1 0.03)",
    )
    options = parser.parse_args()
    if options.picture:
        picture(options.picture)
        return 0
    every = not (options.sizes or options.skies)
    for kind, wanted in (("light", options.sizes), ("sky", options.skies)):
        if wanted or every:
            against_sums(kind, options.seed, options.pixels, options.across, options.tolerances)
    return 0


if __name__ == "__main__":
    sys.exit(main())
