"""Errors of pictures on small crops of many bodies, relative to means over a grid of points in each pixel.

A crop has 24 × 18 pixels with the pixel size of a 640 × 480 picture, around a random illuminated pixel. Its reference
is the mean of 96 × 96 points per pixel under the Gaussian pixel filter (σ = 0.5 pixels, truncated at 1.5). A second
reference with 64 × 64 points shows whether the first reference has converged. The error of a pixel is relative to its
‖XYZ‖, or to a floor f if that is larger. The floor is that of the whole picture. Errors are evaluated on interior
pixels, whose points all hit the body and are illuminated. Such pixels may contain edges between parts of a body, and
may lie at the border of the crop. Use a seed that was not used to develop the code.

Y* is the reference luminance of the whole picture, about the luminance of its brightest pixels.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import time
import warnings
import zlib
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import trimesh

import warpdiff as wd
from bench import inputs
from bench.truth import pixel_reference
from bench.truth.brute_force import intersect, pixel_rays
from bench.truth.errors import FLOOR, colour_difference, reference_luminance
from bench.truth.pictures import finer, scaled
from warpdiff import meshes
from warpdiff.scene.mesh_import import prepare_surface

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

# Width and height of a crop, and width of the margin around the crop that the pixel filter requires [pixels].
WIDTH, HEIGHT, MARGIN = 24, 18, 2
# Width and height of the whole picture [pixels], of which a crop is a part.
WHOLE = (640, 480)
# Number of points along each axis of a pixel in the reference, and in the coarser reference that shows whether the
# first one has converged.
POINTS, FEWER = 96, 64
# Standard deviation σ of the pixel filter, and radius at which the filter is truncated [pixels].
DEVIATION, CUT = 0.5, 1.5
# Tolerance of the colours at the points that are averaged for the reference, relative to the tolerance of the picture.
OF_POINTS = 1.0 / 3.0
LIGHTS = (wd.DirectionalLight((0.1, 0.9, 1.2)), wd.DirectionalLight((-0.7, 0.8, 0.4)))
# Directions from the body to the camera (eye), at elevations of 27° and 9°. `FOV_DEG` is the vertical field of view
# [degrees], and `RADII` is the distance of the camera from the centre of the body [radii of the body].
EYES = ((0.0, 1.6, 3.1), (2.4, 0.5, 1.9))
FOV_DEG, RADII = 27.0, 4.6
# Share of the picture's pixels that are brighter than white after exposure, and are clipped. Pictures are exposed in
# this way before colour differences ΔE2000 are computed.
CLIPPED = 1e-3
# Distances from the eye to the middle of the crop (a part of a picture), for the cameras that render crops. They are
# relative to the distance of the camera that shows the whole body.
DISTANCES = (1.0, 2.0, 0.25)


class Crop(NamedTuple):
    """A crop: mesh, height field, light and camera of a picture that shows a few pixels of a whole picture."""

    name: str
    mesh: Any
    heightfield: wd.HeightField
    light: wd.DirectionalLight
    view: wd.View
    white: float  # reference luminance Y* of the whole picture
    brightest: float  # luminance that 0.1 % of the picture's pixels exceed, for the exposure of colour differences


class Truth(NamedTuple):
    """Reference colours and masks of the pixels of a crop; masks have the shape (HEIGHT, WIDTH)."""

    xyz: np.ndarray  # mean colour of the points of each pixel, shape (HEIGHT, WIDTH, 3)
    interior: np.ndarray
    silhouette: np.ndarray  # whether some but not all points of the pixel hit the mesh
    shadowed: np.ndarray  # whether all points of the pixel hit the mesh, and some but not all are illuminated
    settled: np.ndarray  # difference ‖ΔXYZ‖ between this reference and the coarser reference


class Errors(NamedTuple):
    """Errors of a small picture (crop), for three kinds of pixels: interior, at the silhouette, at edges of shadows.

    Interior pixels are completely covered by the body and completely illuminated.
    """

    interior: np.ndarray
    silhouette: np.ndarray
    shadowed: np.ndarray
    settled: np.ndarray  # differences ‖ΔXYZ‖ between the two references (96 and 64 points), of interior pixels
    estimated: np.ndarray  # estimated errors of interior pixels, from ``image.error``


def bodies(data: str | None) -> dict[str, Callable[[], Any]]:
    """Return functions that make the meshes of the rendered bodies, by name of the body."""
    result: dict[str, Callable[[], Any]] = {
        "snake": meshes.snake, "tube": meshes.tube, "disc": meshes.disc, "low-poly": lambda: lumpy(3),
        "327,680 faces": lambda: lumpy(7),
    }  # fmt: skip
    bottle = inputs.folder(data) / "fuze.obj"
    if bottle.is_file():
        result["bottle"] = lambda: trimesh.load(bottle, force="mesh")
    return result


def lumpy(subdivisions: int) -> Any:
    """Return a ball with lumps and 20 · 4ⁿ faces, where n is ``subdivisions``."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y, z = mesh.vertices.T
    mesh.vertices *= (1.0 + 0.12 * np.sin(5.0 * x + 1.0) * np.sin(4.0 * y) + 0.08 * np.cos(6.0 * z))[:, None]
    return _unwrapped(mesh, np.column_stack([np.arctan2(y, x) / (2.0 * math.pi) + 0.5, 0.5 + 0.5 * z]))


def _unwrapped(mesh: Any, uv: np.ndarray) -> Any:
    """Return a mesh with texture coordinates, where u increases by 1 around the z-axis.

    The seam is the line where u jumps from 1 to 0. Faces that cross the seam get separate corners, with u beyond 1.
    """
    faces, vertices = np.array(mesh.faces), np.asarray(mesh.vertices)
    across = np.ptp(uv[faces, 0], axis=1) > 0.5
    beyond = across[:, None] & (uv[faces, 0] < 0.5)
    moved, where = np.unique(faces[beyond], return_inverse=True)
    faces[beyond] = len(vertices) + where
    uv = np.concatenate([uv, uv[moved] + [1.0, 0.0]])
    visual = trimesh.visual.TextureVisuals(uv=uv)
    return trimesh.Trimesh(np.concatenate([vertices, vertices[moved]]), faces, visual=visual, process=False)


def surfaces(data: str | None) -> dict[str, Callable[[], wd.HeightField]]:
    """Return functions that make the height fields of the rendered surfaces, by name of the surface."""
    result: dict[str, Callable[[], wd.HeightField]] = {
        f"fingers {size:g} µm": lambda size=size: wd.gratings.fingers(size_um=size, pitch_um=0.09, seed=5)
        for size in (5.0, 12.8, 25.6, 65.0)
    }
    result["blazed"] = lambda: wd.gratings.blazed(2.5, 0.25)
    scan = inputs.levelled_scan(data)
    return result if scan is None else result | {"scan": lambda: scan}


def crop(
    name: str, mesh: Any, heightfield: wd.HeightField, distance: float, rng: np.random.Generator, least: float = 0.0
) -> Crop:
    """Return the part of a picture around a random illuminated pixel, as a mesh, a height field, a light and a view.

    The luminance of the pixel is at least ``least`` times the reference luminance Y* of the picture.
    """
    low, high = mesh.bounds
    centre, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
    light, towards = LIGHTS[rng.integers(len(LIGHTS))], np.array(EYES[rng.integers(len(EYES))])
    eye = centre + towards / np.linalg.norm(towards) * RADII * radius
    width, height = WHOLE
    view = wd.View(tuple(eye), tuple(centre), fov_y_deg=FOV_DEG, width=width, height=height)
    image = wd.shade(mesh, heightfield, light, view, tolerance=0.1, pigment=0.0)
    luminance = image.xyz[..., 1].astype(np.float64)
    white, brightest = reference_luminance(luminance[image.illuminated]), float(np.quantile(luminance, 1.0 - CLIPPED))
    # A pixel is chosen only if the body covers it completely. The ray through the centre of a partly covered pixel may
    # miss the body.
    pixel = rng.choice(np.flatnonzero(image.illuminated & (image.coverage > 0.999) & (luminance >= least * white)))
    size = {"width": width, "height": height, "fov_y_deg": FOV_DEG, "extent_y": None}
    origins, directions = (vectors[[pixel]] for vectors in pixel_rays(view.eye, view.target, view.up, **size))
    body = pixel_reference.Body.of(prepare_surface(mesh))
    away = intersect(origins, directions, body.vertices, body.faces, 1)[0]
    target = (origins + away[:, None] * directions)[0]
    eye = target + distance * (eye - target)
    fov = scaled(FOV_DEG, HEIGHT / height)
    view = wd.View(tuple(eye), tuple(target), fov_y_deg=fov, width=WIDTH, height=HEIGHT)
    return Crop(name, mesh, heightfield, light, view, white, brightest)


def truth(area: Crop, tolerance: float) -> Truth:
    """Return the reference of a small picture (crop), and its difference from a reference with fewer points."""
    fine, coarse = (filtered(area, tolerance, points) for points in (POINTS, FEWER))
    return fine._replace(settled=np.linalg.norm(fine.xyz - coarse.xyz, axis=2))


def filtered(area: Crop, tolerance: float, points: int) -> Truth:
    """Return the reference colours of a small picture's pixels: means over ``points``² points per pixel.

    The pixel filter determines the weights of the points.
    """
    view = finer(area.view, points, MARGIN)
    image = wd.shade(
        area.mesh, area.heightfield, area.light, view, tolerance=max(OF_POINTS * tolerance, 1e-5), footprint=False,
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
    """Return weights of the pixel filter for points along one axis, shape (size, (size + 2 MARGIN) · points).

    Row i has the weights for pixel i; their sum is 1.
    """
    places = (np.arange((size + 2 * MARGIN) * points) + 0.5) / points
    away = places - (np.arange(size)[:, None] + MARGIN + 0.5)
    weights = np.where(np.abs(away) <= CUT, np.exp(-0.5 * (away / DEVIATION) ** 2), 0.0)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True), dtype=np.float32)


def measured(area: Crop, exact: Truth, image: wd.Image) -> Errors:
    """Return the errors of a small picture (crop) relative to its reference."""
    xyz, covered = image.xyz.astype(np.float64), np.maximum(image.coverage, 1e-6)[..., None]
    size = np.maximum(np.linalg.norm(exact.xyz, axis=2), FLOOR * area.white)
    error = np.linalg.norm(xyz / covered - exact.xyz, axis=2) / size
    # In ``image.error``, errors of dark pixels are relative to a share of the reference luminance of the crop. They
    # are converted here, so that they are relative to the same share of that of the whole picture.
    own = np.maximum(
        np.linalg.norm(xyz, axis=2), FLOOR * reference_luminance(image.xyz[image.illuminated][:, 1].astype(np.float64))
    )
    return Errors(
        error[exact.interior], error[exact.silhouette], error[exact.shadowed], (exact.settled / size)[exact.interior],
        (image.error * own / size)[exact.interior],
    )  # fmt: skip


def crops(names: dict[str, Any], fields: dict[str, Any], seed: int) -> Iterator[Crop]:
    """Yield a crop (part of a picture) of each body with each surface, at each distance of the camera."""
    for body, make in names.items():
        mesh = make()
        for surface, field in fields.items():
            heightfield = field()
            for distance in DISTANCES:
                name = f"{body} | {surface} | {distance:g}"
                yield crop(name, mesh, heightfield, distance, np.random.default_rng([seed, zlib.crc32(name.encode())]))


def pictured(area: Crop, view: wd.View, tolerance: float, samples: int = 1) -> tuple[wd.Image, bool]:
    """Render the scene of a crop (part of a picture); return the picture, and whether the library gave a warning."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", wd.WarpdiffWarning)
        # Warnings about the limits of scalar diffraction are ignored, because here only errors of the computation are
        # measured.
        warnings.filterwarnings("ignore", "scalar diffraction is", wd.WarpdiffWarning)
        image = wd.shade(
            area.mesh, area.heightfield, area.light, view, tolerance=tolerance, samples_per_pixel=samples, pigment=0.0,
        )  # fmt: skip
    return image, any(issubclass(one.category, wd.WarpdiffWarning) for one in caught)


def print_warned(names: dict[str, Any], fields: dict[str, Any], seed: int, tolerances: list[float]) -> None:
    """Print whether pictures of whole bodies, from the directions of the crops' cameras, cause a warning.

    Warnings that scalar diffraction is inaccurate do not count.
    """
    print("| body | surface | distance | tolerance | unconverged | at edges | warns |\n" + "| --- " * 7 + "|")
    warned: list[bool] = []
    for area in crops(names, fields, seed):
        view = dataclasses.replace(area.view, fov_y_deg=FOV_DEG, width=WHOLE[0], height=WHOLE[1])
        for tolerance in tolerances:
            image, warns = pictured(area, view, tolerance)
            warned.append(warns)
            shares = (
                f"{100.0 * image.report.unconverged_share:.2f} % | {100.0 * image.report.unconverged_edge_share:.2f} %"
            )
            print(f"| {area.name} | {tolerance:g} | {shares} | {warns:d} |", flush=True)
    print(f"\n{sum(warned)} of {len(warned)} whole pictures warn; seed {seed}.")


def main() -> None:
    """Print a table with the errors of crops, which are small parts of pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bodies", nargs="+", help="use only these bodies")
    parser.add_argument("--surfaces", nargs="+", help="use only these surfaces")
    parser.add_argument("--tolerances", nargs="+", type=float, default=[1e-1, 3e-2])
    parser.add_argument(
        "--samples", nargs="+", type=int, default=[1, 4, 9], help="camera rays per pixel (default: 1 4 9)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the crops' positions (default: 0)")
    parser.add_argument("--whole", action="store_true", help="list instead which whole pictures around crops warn")
    parser.add_argument("--data", help=inputs.HELP)
    options = parser.parse_args()
    names, fields = bodies(options.data), surfaces(options.data)
    names = {name: names[name] for name in options.bodies or names}
    fields = {name: fields[name] for name in options.surfaces or fields}
    if options.whole:
        print_warned(names, fields, options.seed, options.tolerances)
        return
    heads = (
        "body | surface | distance | tolerance | rays | interior | convergence | P50 / tolerance | P99 "
        "| silhouettes, P95 | shadow edges, P95 | ΔE2000, P99 | bounded | estimated / actual | method | warned"
    )
    print(f"| {heads} |\n{'| --- ' * (heads.count('|') + 1)}|")
    within, everything, begin = 0, 0, time.perf_counter()
    for area in crops(names, fields, options.seed):
        exact = truth(area, min(options.tolerances))
        for tolerance in options.tolerances:
            for samples in options.samples:
                image, warns = pictured(area, area.view, tolerance, samples)
                errors = measured(area, exact, image)
                p50, p99 = _percentiles(errors.interior, 50.0, 99.0) / tolerance
                everything += 1
                within += bool(not len(errors.interior) or (p99 <= 1.0 and p50 <= 0.25))
                inner = image.xyz[exact.interior]
                colours = math.nan
                if len(inner) > 1:
                    colours = colour_difference(inner, exact.xyz[exact.interior], area.brightest)
                edges = [_percentiles(values, 95.0)[0] / tolerance for values in (errors.silhouette, errors.shadowed)]
                print(
                    f"| {area.name} | {tolerance:g} | {samples} | {100.0 * exact.interior.mean():.0f} % "
                    f"| {_percentiles(errors.settled, 99.0)[0] / tolerance:.2f} | {p50:.3f} | {p99:.2f} "
                    f"| {edges[0]:.2f} | {edges[1]:.2f} | {colours:.1f} | {_estimates(errors)} "
                    f"| {'footprints' if image.plan.uses_footprints else 'points'} | {warns:d} |",
                    flush=True,
                )
    print(
        f"\n{within} of {everything} pictures have P99 <= 1 and P50 <= 1/4 of their tolerance over interior pixels; "
        f"{time.perf_counter() - begin:.0f} s, seed {options.seed}."
    )


def _estimates(errors: Errors) -> str:
    """Return a text about estimated errors of interior pixels, for two columns of the table.

    The columns are the share of pixels whose error is at most its estimate, and the sum of the estimates divided by the
    sum of the errors.
    """
    actual, estimated = errors.interior, errors.estimated
    bounded = 100.0 * np.mean(actual <= estimated) if len(actual) else math.nan
    return f"{bounded:.0f} % | {estimated.sum() / max(actual.sum(), 1e-30):.1f}"


def _percentiles(values: np.ndarray, *which: float) -> np.ndarray:
    return np.percentile(values, which) if len(values) else np.full(len(which), math.nan)


if __name__ == "__main__":
    main()
