"""Lights of a size and environments: pictures against sums over directions, albedos, time a direction.

``--sizes`` compares lights of a size, of cases that ``--seed`` draws, with sums over points of their discs, ``--skies``
environments with sums over at least 16 times as many directions, which share no code with them
(``bench/truth/sky_sums.py``), ``--albedo`` an even sky with the reflectance summed over directions, and with a sphere
that is a perfect mirror, ``--mitsuba`` flat gold under a sky with Mitsuba's path tracer (``pip install
'warpdiff[bench]'``), ``--times`` tells frames by the number of directions, and ``--picture`` saves README's snake
under a sky.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import math
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

import warpdiff as wd
from bench import inputs
from bench.studies import crops
from bench.truth.sky_sums import SkySums
from warpdiff.optics import colorimetry

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

WINDOW = wd.Coherence(sigma_um=8.0)
DIAMETERS = (1.0, 5.0, 10.0, 20.0, 60.0)
SURFACES = {
    "fingers": lambda: wd.gratings.fingers(size_um=12.8, pitch_um=0.08),
    "blazed": lambda: wd.gratings.blazed(2.5, 0.25),
    "cd": lambda: wd.gratings.disc("CD", tracks=8, length_um=12.8, pitch_um=0.08),
}


def sky(sun: float = 0.0, height: int = 64, elevation_deg: float = 55.0, azimuth_deg: float = 1.0) -> np.ndarray:
    """A clear sky that grows whiter and brighter towards the horizon, over dark ground, with a sun of so much power."""
    polar = (np.arange(height) + 0.5) / height * math.pi
    up = np.maximum(np.cos(polar), 0.0)[:, None, None]
    colour = np.array([0.25, 0.45, 1.0]) + (np.array([0.9, 0.95, 1.0]) - [0.25, 0.45, 1.0]) * (1.0 - up) ** 3
    radiance = np.where(np.cos(polar)[:, None, None] > 0.0, colour, [0.12, 0.1, 0.08]) * np.ones((1, 2 * height, 1))
    row = int((90.0 - elevation_deg) / 180.0 * height)
    solid = math.sin(polar[row]) * (math.pi / height) ** 2
    radiance[row, int((azimuth_deg / 180.0 + 1.0) * height)] += sun / solid * np.array([1.0, 0.9, 0.75])
    return radiance


def drawn_sky(kind: str, rng: np.random.Generator) -> np.ndarray:
    """A grey sky by its kind: with a low or a high sun, a room with a window, overcast with a gradient."""
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


def drawn_cases(seed: int) -> Iterator[tuple[str, np.ndarray, Any, wd.HeightField, wd.View, float]]:
    """Name, sky, body, surface, view and the deviation of the window [µm] of cases."""
    rng = np.random.default_rng(seed)
    scan = inputs.scan()
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
        surfaces["scan"] = lambda: scan.levelled(order=2)
    kinds = ["window", "low sun", "overcast", "window", "high sun"] * 2
    names = [rng.permutation(list(each)) for each in (bodies, surfaces)]
    for index, kind in enumerate(kinds):
        body, surface = (each[index % len(each)] for each in names)
        mesh = bodies[body]()
        middle, radius = mesh.bounds.mean(axis=0), 0.5 * float(np.linalg.norm(np.ptp(mesh.bounds, axis=0)))
        towards = rng.normal(size=3)
        towards[1], towards[2] = abs(towards[1]), abs(towards[2]) + 0.3
        eye = middle + 5.0 * radius * towards / np.linalg.norm(towards)
        view = wd.View(tuple(eye), tuple(middle), fov_y_deg=16.0, width=96, height=72)
        name = f"{kind} | {body}, {surface}"
        yield name, drawn_sky(kind, rng), mesh, surfaces[surface](), view, 16.25 if surface == "scan" else 8.0


def distances(found: np.ndarray, exact: np.ndarray, bright: float = 0.0) -> np.ndarray:
    """Errors of colours (n, 3), as ``tolerance`` has them, of a picture of which so ``bright`` is P99 of Y."""
    floor = 1e-3 * max(np.percentile(exact[:, 1], 99.0), bright, 1e-30)
    return np.asarray(np.linalg.norm(found - exact, axis=1) / np.maximum(np.linalg.norm(exact, axis=1), floor))


def percentiles(errors: np.ndarray, between: str = " | ") -> str:
    """Their median, percentiles 90 and 99."""
    return between.join(f"{100.0 * value:.1f} %" for value in np.percentile(errors, [50.0, 90.0, 99.0]))


def sizes(seed: int, pixels: int, across: int, tolerances: list[float]) -> None:
    """Print errors of lights of a size, of cases that are drawn, against sums over rays from points of the disc."""
    rng = np.random.default_rng(seed + 2)
    print("| light | body, surface | pixels | by | median | P90 | P99 | told | seen | frame |\n" + "| --- " * 10 + "|")
    for index, (case, _, mesh, hf, view, sigma_um) in enumerate(drawn_cases(seed)):
        window = wd.Coherence(sigma_um=sigma_um)
        sums = SkySums(mesh, hf, view, window)
        inside = rng.permutation(sums.interior())[:pixels]
        # From where the eye is, or aside.
        towards = np.asarray(view.eye) - np.asarray(view.target)
        towards = towards / np.linalg.norm(towards) + rng.uniform(-0.7, 0.7, 3)
        degrees = DIAMETERS[index % len(DIAMETERS)]
        light = wd.DirectionalLight(tuple(towards), angular_diameter_deg=degrees)
        name = f"{degrees:g}° | {case.split(' | ')[1]}"
        _judge(name, inside, functools.partial(sums.under_disc, light=light), across, seed, tolerances, options={
            "mesh": mesh, "hf": hf, "light": light, "view": view, "coherence": window,
        })  # fmt: skip


def skies(seed: int, pixels: int, across: int, tolerances: list[float]) -> None:
    """Print errors of environments against sums over directions, of ``across``² rays a pixel or more, for some pixels.

    Beside them are what the sums may err by, what ``image.error`` tells at the same percentiles, for how many of the
    pixels that err by more than the tolerance it tells so, and a frame's time.
    """
    rng = np.random.default_rng(seed + 1)
    print("| sky | body, surface | pixels | by | median | P90 | P99 | told | seen | frame |\n" + "| --- " * 10 + "|")
    for name, grey, mesh, hf, view, sigma_um in drawn_cases(seed):
        window = wd.Coherence(sigma_um=sigma_um)
        sums = SkySums(mesh, hf, view, window)
        environment = wd.Environment(np.repeat(grey[..., None], 3, axis=2))
        inside = rng.permutation(sums.interior())[:pixels]
        _judge(name, inside, functools.partial(sums.under_sky, sky=grey), across, seed, tolerances, options={
            "mesh": mesh, "hf": hf, "light": environment, "view": view, "coherence": window,
        })  # fmt: skip


def _judge(
    name: str, chosen: np.ndarray, summed: Callable[..., np.ndarray], across: int, seed: int, tolerances: list[float],
    *, options: dict[str, Any],
) -> None:  # fmt: skip
    """Print what pixels of pictures with ``options`` err by against sums that settle, and what is told of it."""
    if not len(chosen):
        print(f"| {name} | 0 | no pixel lies within the mesh |" + " |" * 6)
        return
    exact, unsettled, rays = settled(summed, chosen, across, seed, min(tolerances) / 3.0)
    keeps = (unsettled <= min(tolerances) / 3.0) & (exact[:, 1] > 0.0)
    left_out = f"sums by {rays:,} rays or more, {np.count_nonzero(~keeps)} do not settle or are black, and are left out"
    print(f"| {name} | {len(chosen)} | {left_out} | {percentiles(unsettled)} | | | |", flush=True)
    if not keeps.any():
        return
    exact, at = exact[keeps], tuple(chosen[keeps].T)
    for tolerance in tolerances:
        begin = time.perf_counter()
        image = wd.shade(**options, tolerance=tolerance, pigment=0.0, shadows=False, strict=False)
        took = time.perf_counter() - begin
        # Pixels that are chosen may all be darker than what the picture's tolerance is relative to.
        bright = float(np.percentile(image.xyz[image.lit][:, 1], 99.0))
        found, expected = distances(image.xyz[at], exact, bright), image.error[at]
        wrong = found > tolerance
        seen = f"{np.count_nonzero(expected[wrong] > tolerance)} of {np.count_nonzero(wrong)}"
        print(
            f"| {name} | {len(exact)} | {tolerance:g}, {image.plan.lit_by:,} | {percentiles(found)} | "
            f"{percentiles(expected, ' / ')} | {seen} | {took:.1f} s |", flush=True,
        )  # fmt: skip


def settled(
    summed: Callable[..., np.ndarray], chosen: np.ndarray, across: int, seed: int, bound: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """Means of four sums each, what they may err by, and of how many rays they are at least.

    Where the four do not tell their mean well enough, there are four and sixteen times as many rays.
    """
    sets = np.zeros((4, len(chosen), 3))
    unsettled = np.zeros(len(chosen))
    again = np.arange(len(chosen))
    for more in (1, 2, 4):
        sets[:, again] = [summed(chosen[again], across=more * across, seed=4 * seed + each) for each in range(4)]
        exact = sets.mean(axis=0)
        unsettled = np.sqrt(sum(distances(each, exact) ** 2 for each in sets) / 12.0)
        again = np.flatnonzero(unsettled > bound)
    return exact, unsettled, len(sets) * across**2


def albedo(directions: int) -> None:
    """Print what an even sky shows on a flat square against the reflectance summed over all directions."""
    print("| surface | angle | picture, Y | sum of the BRDF, Y | normalised picture | its sum |")
    print("| --- | --- | --- | --- | --- | --- |")
    texture = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    corners = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    square = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=texture, process=False)
    even = wd.Environment(np.ones((4, 8, 3)), directions=directions)
    step = 1.0 / 90.0
    u, v = np.meshgrid(np.arange(-1.0 + step / 2.0, 1.0, step), np.arange(-1.0 + step / 2.0, 1.0, step))
    inside = u**2 + v**2 < 1.0
    views = np.stack([u[inside], v[inside], np.sqrt(1.0 - u[inside] ** 2 - v[inside] ** 2)], axis=-1)
    surfaces = {"flat": wd.HeightField(np.zeros((32, 32)), 0.09)} | _mirrors()
    for name, hf in surfaces.items():
        for degrees in (20.0, 45.0, 75.0):
            angle = math.radians(degrees)
            towards = (math.sin(angle) * 0.6, math.sin(angle) * 0.8, math.cos(angle))
            view = wd.View.orthographic(
                4.0 * np.array(towards), (0, 0, 0), up=(0, 1, 0.3), extent_y=0.3, width=4, height=3
            )
            # dω cos θ is du dv, and the BRDF is reciprocal; the sum is weighted by what the eye sees of D65.
            nm = np.arange(400.0, 701.0, 20.0)
            bright = np.exp(-0.5 * ((nm - 556.0) / 42.0) ** 2)
            told = []
            for energy in ("stam", "normalised"):
                image = wd.shade(
                    square, hf, even, view, coherence=WINDOW, tolerance=3e-2, ior=math.inf, masking=False,
                    energy=energy, refine=False,
                )  # fmt: skip
                brdf = wd.brdf(hf, towards, views, nm, coherence=WINDOW, ior=math.inf, energy=energy)
                total = step**2 * brdf.sum(axis=0) @ bright / bright.sum()
                told += [f"{image.xyz[1, 1, 1]:.3f} | {total:.3f}"]
            print(f"| {name} | {degrees:g}° | {' | '.join(told)} |", flush=True)


def _mirrors() -> dict[str, wd.HeightField]:
    """What is shown as a perfect mirror; the scan, where there is one."""
    scan = inputs.scan()
    return {name: make() for name, make in SURFACES.items()} | ({} if scan is None else {"scan": scan})


def furnace_picture(
    hf: wd.HeightField, energy: str, *, directions: int, tolerance: float, size: int
) -> tuple[wd.Image, np.ndarray]:
    """A sphere that is a perfect mirror under an even sky of 1, and how far pixels are from its middle, in radii."""
    ball = trimesh.creation.icosphere(4)
    radius = 1.01 * np.hypot(*np.meshgrid(*2 * [(2.0 * np.arange(size) + 1.0) / size - 1.0]))
    image = wd.shade(
        ball, hf, wd.Environment(np.ones((4, 8, 3)), directions=directions),
        wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=2.02, width=size, height=size), coherence=WINDOW,
        tolerance=tolerance, ior=math.inf, masking=False, energy=energy, refine=False, shadows=False,
        tangents=np.cross([0.0, 1.0, 0.01], ball.vertex_normals),
    )  # fmt: skip
    return image, radius


def furnace(directions: int) -> None:
    """Print how far a sphere that is a perfect mirror is from the even sky around it, with both forms of energy."""
    print("\n| sphere | energy | sin θr to 0.5 | to 0.8 | to 0.95 | to 0.985 | told |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name, hf in _mirrors().items():
        for energy in ("stam", "normalised"):
            image, radius = furnace_picture(hf, energy, directions=directions, tolerance=5e-2, size=48)
            rings = [
                (radius >= low) & (radius < high) for low, high in itertools.pairwise((0.0, 0.5, 0.8, 0.95, 0.985))
            ]
            off = [math.sqrt(np.mean((image.xyz[ring, 1] - 1.0) ** 2)) for ring in rings]
            told = " | ".join(f"{each:.3f}" for each in (*off, image.plan.energy_spread))
            print(f"| {name} | {energy} | {told} |", flush=True)


def against_mitsuba(counts: list[int]) -> None:
    """Print how far flat gold under a grey sky is from Mitsuba's path tracer, which is given the same n and k."""
    import mitsuba as mi

    mi.set_variant("scalar_spectral")
    gold = wd.Material.metal("Au")
    grey = np.repeat(sky().mean(axis=2, keepdims=True), 3, axis=2)
    told = {"eta": gold.n, "k": gold.k}
    spectra = {
        name: {"type": "irregular", "wavelengths": _listed(gold.wavelengths_nm), "values": _listed(values)}
        for name, values in told.items()
    }
    view = wd.View((0, 1.2, 2.0), (0, 0, 0), fov_y_deg=60, width=32, height=24)
    frame = mi.ScalarTransform4f()
    film = {"type": "hdrfilm", "width": view.width, "height": view.height, "pixel_format": "xyz"}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": {
            "type": "perspective", "fov": view.fov_y_deg, "fov_axis": "y",
            "to_world": frame.look_at(origin=list(view.eye), target=[0, 0, 0], up=[0, 1, 0]),
            "film": film | {"component_format": "float32", "rfilter": {"type": "box"}},
            "sampler": {"type": "stratified", "sample_count": 1024},
        },
        # Its first column lies where the middle one is here.
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(np.roll(grey, grey.shape[0], axis=1).astype(np.float32))},
        "plate": {
            "type": "rectangle", "bsdf": {"type": "conductor"} | spectra, "to_world": frame.rotate([1, 0, 0], -90),
        },
    }  # fmt: skip
    exact = np.array(mi.render(mi.load_dict(scene)), dtype=np.float64)
    texture = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    corners = [[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]]
    plate = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=texture, process=False)
    print("| directions | pixels | error of XYZ, median / P90 / P99 | ΔE2000, median / P99 |\n" + "| --- " * 4 + "|")
    for count in counts:
        environment = wd.Environment(grey, directions=count)
        image = wd.shade(
            plate, wd.HeightField(np.zeros((32, 32)), 0.09), environment, view, material=gold, masking=False,
            shadows=False, refine=False,
        )  # fmt: skip
        seen = image.mask
        inside = np.zeros_like(seen)
        inside[1:-1, 1:-1] = seen[1:-1, 1:-1] & seen[:-2, 1:-1] & seen[2:, 1:-1] & seen[1:-1, :-2] & seen[1:-1, 2:]
        found, right = image.xyz[inside], exact[inside]
        away = 100.0 * np.linalg.norm(found - right, axis=1) / np.linalg.norm(right, axis=1)
        errors_told = " / ".join(f"{each:.1f}" for each in np.percentile(away, [50.0, 90.0, 99.0]))
        shades = np.percentile(colorimetry.colour_difference(found, right), [50.0, 99.0])
        print(f"| {count} | {len(found)} | {errors_told} % | {shades[0]:.2f} / {shades[1]:.2f} |", flush=True)


def _listed(values: Any) -> str:
    """Numbers as Mitsuba reads them."""
    return ", ".join(f"{each:g}" for each in values)


def times(repeats: int) -> None:
    """Print the time of a frame against the number of directions."""
    print("| directions | frame, not refined | refined | a direction |\n| --- | --- | --- | --- |")
    hf, body, view = SURFACES["fingers"](), wd.meshes.tube(), wd.View((0, 2, 4), (0, 0, 0), width=640, height=480)
    for count in (256, 1024, 4096, 16384):
        environment = wd.Environment(sky(), directions=count)
        took = []
        for refine in (False, True):
            renderer = wd.Renderer(
                body, hf, environment, view, coherence=WINDOW, tolerance=1e-1, pigment=0.0, refine=refine
            )
            renderer.image()
            seconds = []
            for turn in range(repeats):
                turned = wd.Environment(sky(), directions=count, rotation_deg=3.0 * turn)
                begin = time.perf_counter()
                renderer.draw(turned)
                renderer.image()
                seconds.append(time.perf_counter() - begin)
            took.append(float(np.median(seconds)))
        print(f"| {count} | {took[0]:.2f} s | {took[1]:.2f} s | {1e3 * took[0] / count:.2f} ms |", flush=True)


def picture(path: str) -> None:
    """Save the scan on a snake under a clear sky with a sun."""
    scan = inputs.scan()
    if scan is None:
        raise FileNotFoundError("--picture takes the scan, which is not in the folder of WARPDIFF_DATA")
    view = wd.View((-1.6, 2.2, 2.6), (-0.56, 0.06, 0.07), fov_y_deg=12.2, width=480, height=288)
    above = wd.Environment(sky(sun=10.0, height=128, elevation_deg=50.0, azimuth_deg=95.0))
    image = wd.shade(wd.meshes.snake(), scan.levelled(order=2), above, view, tolerance=1e-1, pigment=0.05)
    image.save(path, background=(1.0, 1.0, 1.0), exposure_stops=-0.7)


def main() -> int:
    """Print the tables that are asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", action="store_true", help="lights of a size against sums over points of the disc")
    parser.add_argument("--skies", action="store_true", help="drawn environments against sums")
    parser.add_argument("--albedo", action="store_true", help="an even sky against sums over directions")
    parser.add_argument("--mitsuba", action="store_true", help="flat gold under a sky against Mitsuba")
    parser.add_argument("--times", action="store_true", help="time a frame by the number of directions")
    parser.add_argument("--picture", metavar="FILE", help="save a snake under a sky")
    parser.add_argument("--seed", type=int, default=0, help="of the cases of --sizes and --skies (0)")
    parser.add_argument("--pixels", type=int, default=150, help="that are judged of each such case (150)")
    parser.add_argument("--across", type=int, default=3, help="rays along a side of these (3)")
    parser.add_argument("--tolerances", type=float, nargs="+", default=[1e-1, 3e-2], help="of environments (0.1 0.03)")
    parser.add_argument("--repeats", type=int, default=3, help="frames of each kind (3)")
    options = parser.parse_args()
    if options.picture:
        picture(options.picture)
        return 0
    every = not (options.sizes or options.skies or options.albedo or options.mitsuba or options.times)
    if options.sizes or every:
        sizes(options.seed, options.pixels, 32 * options.across, options.tolerances)
    if options.skies or every:
        skies(options.seed, options.pixels, options.across, options.tolerances)
    if options.albedo or every:
        albedo(4096)
        furnace(1024)
    if options.mitsuba or every:
        against_mitsuba([256, 4096])
    if options.times or every:
        times(options.repeats)
    return 0


if __name__ == "__main__":
    sys.exit(main())
