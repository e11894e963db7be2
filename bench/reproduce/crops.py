"""Pictures against their truth: crops of many subjects, by a regular grid of points in every pixel, under the filter.

A crop is a picture of 24 × 18 pixels of the size that one of 640 × 480 has, around a lit pixel of that, which a seed
draws. Its truth is a picture of points as many times as fine, under the pixels' Gaussian filter (half a pixel, cut at
one and a half); a coarser one shows how far it has settled. Errors are the design's, f of the whole picture, over
interior pixels: every point of their own square hits and is lit, edges between parts of a body among them. The
outermost pixels are judged as all others. Take a seed that was not worked with.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import time
import warnings
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import trimesh

import warpdiff as wd
from bench import inputs
from bench.truth import reference
from bench.truth.brute_force import intersect, pixel_rays
from bench.truth.errors import FLOOR, colour_difference, reference_luminance
from bench.truth.pictures import finer, scaled
from warpdiff import meshes
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

# Of a crop, and what the filter of its outermost pixels reaches into.
WIDTH, HEIGHT, MARGIN = 24, 18, 2
WHOLE = (640, 480)
# Points along a side of a pixel: of the truth, and of what shows that it has settled.
POINTS, FEWER = 96, 64
DEVIATION, CUT = 0.5, 1.5
# What the points of a truth may err by, in tolerances of the picture.
OF_POINTS = 1.0 / 3.0
LIGHTS = (wd.DirectionalLight((0.1, 0.9, 1.2)), wd.DirectionalLight((-0.7, 0.8, 0.4)))
# Towards the eye, from above and grazing, and its distance in radii of the body.
EYES = ((0.0, 1.6, 3.1), (2.4, 0.5, 1.9))
FOV_DEG, RADII = 27.0, 4.6
# The share of pixels of the whole picture that may clip where colours are compared.
CLIPPED = 1e-3
# As many times as far from what is looked at.
DISTANCES = (1.0, 2.0, 0.25)


class Crop(NamedTuple):
    """A few pixels of a picture."""

    name: str
    mesh: Any
    heightfield: wd.HeightField
    light: wd.DirectionalLight
    view: wd.View
    white: float  # Y* of the whole picture
    brightest: float  # Y that a thousandth of its pixels exceed, for the exposure of colour differences


class Truth(NamedTuple):
    """What the pixels of a crop are; all of shape (HEIGHT, WIDTH)."""

    xyz: np.ndarray  # (…, 3)
    interior: np.ndarray
    silhouette: np.ndarray  # some of its own square is missed
    shadowed: np.ndarray  # all of it hit, some of it lit
    settled: np.ndarray  # how far fewer points are from as many, ‖ΔXYZ‖


class Errors(NamedTuple):
    """Of pixels, one after the other."""

    interior: np.ndarray
    silhouette: np.ndarray
    shadowed: np.ndarray
    settled: np.ndarray  # of interior ones
    told: np.ndarray  # what ``image.error`` has for these


def bodies(data: str | None, given: list[Path]) -> dict[str, Callable[[], Any]]:
    """Bodies to look at, made when they are needed."""
    made: dict[str, Callable[[], Any]] = {
        "snake": meshes.snake,
        "tube": meshes.tube,
        "disc": meshes.disc,
        "low-poly": lambda: lumpy(3),
        "327,680 faces": lambda: lumpy(7),
    }
    bottle = inputs.folder(data) / "fuze.obj"
    if bottle.is_file():
        made["bottle"] = lambda: trimesh.load(bottle, force="mesh")
    return made | {path.stem: lambda path=path: trimesh.load(path, force="mesh") for path in given}


def lumpy(subdivisions: int) -> Any:
    """A ball with lumps, of 20 · 4ⁿ faces."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y, z = mesh.vertices.T
    mesh.vertices *= (1.0 + 0.12 * np.sin(5.0 * x + 1.0) * np.sin(4.0 * y) + 0.08 * np.cos(6.0 * z))[:, None]
    return _unwrapped(mesh, np.column_stack([np.arctan2(y, x) / (2.0 * math.pi) + 0.5, 0.5 + 0.5 * z]))


def _unwrapped(mesh: Any, uv: np.ndarray) -> Any:
    """A mesh with texture coordinates whose u goes around: faces across the seam get corners of their own."""
    faces, vertices = np.array(mesh.faces), np.asarray(mesh.vertices)
    across = np.ptp(uv[faces, 0], axis=1) > 0.5
    beyond = across[:, None] & (uv[faces, 0] < 0.5)
    moved, where = np.unique(faces[beyond], return_inverse=True)
    faces[beyond] = len(vertices) + where
    uv = np.concatenate([uv, uv[moved] + [1.0, 0.0]])
    visual = trimesh.visual.TextureVisuals(uv=uv)
    return trimesh.Trimesh(np.concatenate([vertices, vertices[moved]]), faces, visual=visual, process=False)


def surfaces(data: str | None) -> dict[str, Callable[[], wd.HeightField]]:
    """Height fields, made when they are needed."""
    made: dict[str, Callable[[], wd.HeightField]] = {
        f"fingers {size:g} µm": lambda size=size: wd.gratings.fingers(size_um=size, pitch_um=0.09, seed=5)
        for size in (5.0, 12.8, 25.6, 65.0)
    }
    made["blazed"] = lambda: wd.gratings.blazed(2.5, 0.25)
    scan = inputs.levelled_scan(data)
    return made if scan is None else made | {"scan": lambda: scan}


def crop(
    name: str, mesh: Any, heightfield: wd.HeightField, distance: float, rng: np.random.Generator, least: float = 0.0
) -> Crop:
    """A crop around a lit pixel of a picture, of this share of its white or more."""
    low, high = mesh.bounds
    centre, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
    light, towards = LIGHTS[rng.integers(len(LIGHTS))], np.array(EYES[rng.integers(len(EYES))])
    eye = centre + towards / np.linalg.norm(towards) * RADII * radius
    width, height = WHOLE
    whole = wd.View(tuple(eye), tuple(centre), fov_y_deg=FOV_DEG, width=width, height=height)
    image = wd.shade(mesh, heightfield, light, whole, tolerance=0.1, pigment=0.0)
    luminance = image.xyz[..., 1].astype(np.float64)
    white, brightest = reference_luminance(luminance[image.illuminated]), float(np.quantile(luminance, 1.0 - CLIPPED))
    # Rays through the centres of pixels that are covered in part may miss the body.
    pixel = rng.choice(np.flatnonzero(image.illuminated & (image.coverage > 0.999) & (luminance >= least * white)))
    size = {"width": width, "height": height, "fov_y_deg": FOV_DEG, "extent_y": None}
    origins, directions = (each[[pixel]] for each in pixel_rays(whole.eye, whole.target, whole.up, **size))
    body = reference.Body.of(prepare_surface(mesh))
    away = intersect(origins, directions, body.vertices, body.faces, 1)[0]
    target = (origins + away[:, None] * directions)[0]
    eye = target + distance * (eye - target)
    fov = scaled(FOV_DEG, HEIGHT / height)
    view = wd.View(tuple(eye), tuple(target), fov_y_deg=fov, width=WIDTH, height=HEIGHT)
    return Crop(name, mesh, heightfield, light, view, white, brightest)


def truth(given: Crop, tolerance: float) -> Truth:
    """The truth of a crop."""
    found, few = (filtered(given, tolerance, points) for points in (POINTS, FEWER))
    return found._replace(settled=np.linalg.norm(found.xyz - few.xyz, axis=2))


def filtered(given: Crop, tolerance: float, points: int) -> Truth:
    """A crop by so many points along a side of a pixel."""
    view = finer(given.view, points, MARGIN)
    image = wd.shade(
        given.mesh, given.heightfield, given.light, view, tolerance=max(OF_POINTS * tolerance, 1e-5), footprint=False,
        pigment=0.0,
    )  # fmt: skip
    rows, columns = (_filter(size, points) for size in (HEIGHT, WIDTH))
    hit = image.mask.astype(np.float32)
    weight = rows @ hit @ columns.T
    xyz = np.stack([rows @ image.xyz[..., c] @ columns.T for c in range(3)], axis=-1)
    xyz /= np.maximum(weight, 1e-6)[..., None]

    def all_of(mask: np.ndarray) -> np.ndarray:
        inner = mask[MARGIN * points : -MARGIN * points, MARGIN * points : -MARGIN * points]
        return np.asarray(inner.reshape(HEIGHT, points, WIDTH, points).all(axis=(1, 3)))

    illuminated, hit_all = all_of(image.illuminated), all_of(image.mask)
    some_lit, some_hit = ~all_of(~image.illuminated), ~all_of(~image.mask)
    return Truth(xyz, illuminated, some_hit & ~hit_all, hit_all & some_lit & ~illuminated, np.zeros((HEIGHT, WIDTH)))


def _filter(size: int, points: int) -> np.ndarray:
    """Weights of points along a side, (size, (size + 2 MARGIN) · points), that sum to 1."""
    places = (np.arange((size + 2 * MARGIN) * points) + 0.5) / points
    away = places - (np.arange(size)[:, None] + MARGIN + 0.5)
    weights = np.where(np.abs(away) <= CUT, np.exp(-0.5 * (away / DEVIATION) ** 2), 0.0)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), dtype=np.float32)


def validation_size(given: Crop, exact: Truth, image: wd.Image) -> Errors:
    """The errors of a picture of a crop."""
    xyz, covered = image.xyz.astype(np.float64), np.maximum(image.coverage, 1e-6)[..., None]
    size = np.maximum(np.linalg.norm(exact.xyz, axis=2), FLOOR * given.white)
    error = np.linalg.norm(xyz / covered - exact.xyz, axis=2) / size
    # Relative to what the crop's own white tells.
    own = np.maximum(
        np.linalg.norm(xyz, axis=2), FLOOR * reference_luminance(image.xyz[image.illuminated][:, 1].astype(np.float64))
    )
    return Errors(
        error[exact.interior],
        error[exact.silhouette],
        error[exact.shadowed],
        (exact.settled / size)[exact.interior],
        (image.error * own / size)[exact.interior],
    )


def crops(names: dict[str, Any], fields: dict[str, Any], seed: int) -> Iterator[Crop]:
    """A crop of each body with each surface at each distance."""
    for body, make in names.items():
        mesh = make()
        for surface, field in fields.items():
            heightfield = field()
            for distance in DISTANCES:
                name = f"{body} | {surface} | {distance:g}"
                yield crop(name, mesh, heightfield, distance, np.random.default_rng([seed, zlib.crc32(name.encode())]))


def pictured(given: Crop, view: wd.View, tolerance: float, samples: int = 1) -> tuple[wd.Image, bool]:
    """A picture of what a crop is of, and whether it warns."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", wd.WarpdiffWarning)
        image = wd.shade(
            given.mesh,
            given.heightfield,
            given.light,
            view,
            tolerance=tolerance,
            samples_per_pixel=samples,
            pigment=0.0,
        )
    return image, any(issubclass(one.category, wd.WarpdiffWarning) for one in caught)


def print_warned(names: dict[str, Any], fields: dict[str, Any], seed: int, tolerances: list[float]) -> None:
    """Print which whole pictures, that look at what crops do, warn."""
    print("| body | surface | distance | tolerance | unsettled | at edges | warns |\n" + "| --- " * 7 + "|")
    found: list[bool] = []
    for each in crops(names, fields, seed):
        view = dataclasses.replace(each.view, fov_y_deg=FOV_DEG, width=WHOLE[0], height=WHOLE[1])
        for tolerance in tolerances:
            image, warns = pictured(each, view, tolerance)
            found.append(warns)
            shares = f"{100.0 * image.plan.unconverged_share:.2f} % | {100.0 * image.plan.unconverged_edge_share:.2f} %"
            print(f"| {each.name} | {tolerance:g} | {shares} | {warns:d} |", flush=True)
    print(f"\n{sum(found)} of {len(found)} whole pictures warn; seed {seed}.")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bodies", nargs="+", help="these alone, by name")
    parser.add_argument("--surfaces", nargs="+", help="these alone, by name")
    parser.add_argument("--mesh", nargs="+", type=Path, default=[], help="files of further bodies")
    parser.add_argument("--tolerances", nargs="+", type=float, default=[1e-1, 3e-2])
    parser.add_argument("--samples", nargs="+", type=int, default=[1, 4, 9], help="rays a pixel (1 4 9)")
    parser.add_argument("--seed", type=int, default=0, help="of where crops lie (0)")
    parser.add_argument("--whole", action="store_true", help="whole pictures around crops instead: which of them warn")
    parser.add_argument("--data", help=inputs.HELP)
    options = parser.parse_args()
    names, fields = bodies(options.data, options.mesh), surfaces(options.data)
    names = {each: names[each] for each in options.bodies or names}
    fields = {each: fields[each] for each in options.surfaces or fields}
    if options.whole:
        print_warned(names, fields, options.seed, options.tolerances)
        return
    heads = (
        "body | surface | distance | tolerance | rays | interior | settled | P50 / tolerance | P99 | silhouettes, P95 "
        "| shadow edges, P95 | ΔE2000, P99 | bounded | rank correlation | told / true | means | warned"
    )
    print(f"| {heads} |\n{'| --- ' * (heads.count('|') + 1)}|")
    within, everything, begin = 0, 0, time.perf_counter()
    for each in crops(names, fields, options.seed):
        exact = truth(each, min(options.tolerances))
        for tolerance in options.tolerances:
            for samples in options.samples:
                image, told = pictured(each, each.view, tolerance, samples)
                found = validation_size(each, exact, image)
                p50, p99 = _percentiles(found.interior, 50.0, 99.0) / tolerance
                everything += 1
                within += bool(not len(found.interior) or (p99 <= 1.0 and p50 <= 0.25))
                inner = image.xyz[exact.interior]
                colours = math.nan
                if len(inner) > 1:
                    colours = colour_difference(inner, exact.xyz[exact.interior], each.brightest)
                edges = [_percentiles(some, 95.0)[0] / tolerance for some in (found.silhouette, found.shadowed)]
                print(
                    f"| {each.name} | {tolerance:g} | {samples} | {100.0 * exact.interior.mean():.0f} % "
                    f"| {_percentiles(found.settled, 99.0)[0] / tolerance:.2f} | {p50:.3f} | {p99:.2f} "
                    f"| {edges[0]:.2f} | {edges[1]:.2f} | {colours:.1f} | {_estimates(found)} "
                    f"| {'blurs' if image.plan.uses_footprints else 'points'} | {told:d} |",
                    flush=True,
                )
    print(
        f"\n{within} of {everything} pictures have P99 <= 1 and P50 <= 1/4 of their tolerance over interior pixels; "
        f"{time.perf_counter() - begin:.0f} s, seed {options.seed}."
    )


def _estimates(found: Errors) -> str:
    """How well errors are told: the share that is bounded, the correlation of ranks, and the ratio of sums."""
    true, told = found.interior, found.told
    if len(true) < 3:
        return "| | "
    ranks = [np.argsort(np.argsort(each)) for each in (true, told)]
    bounded, ratio = 100.0 * np.mean(true <= told), told.sum() / max(true.sum(), 1e-30)
    return f"{bounded:.0f} % | {np.corrcoef(*ranks)[0, 1]:.2f} | {ratio:.1f}"


def _percentiles(values: np.ndarray, *which: float) -> np.ndarray:
    return np.percentile(values, which) if len(values) else np.full(len(which), math.nan)


if __name__ == "__main__":
    main()
