"""Figures of grating maps: exactness of the transforms, errors and times of pictures, and a card of hidden pictures.

::

    python -m bench.reproduce.grating_maps --transforms
    python -m bench.reproduce.grating_maps --pictures --seed 0
    python -m bench.reproduce.grating_maps --bodies --seed 0
    python -m bench.reproduce.grating_maps --pitches --seed 0
    python -m bench.reproduce.grating_maps --times
    python -m bench.reproduce.grating_maps --card

A grating map is an array of dots. All dots have the same height field, the cell. In each dot, the cell is turned, its
heights are multiplied by a depth scale, and its periods by a pitch scale.

``--transforms`` compares two direct sums in float64. One is over the heights of a dot, that is, of the turned and
scaled cell. The other is over the heights of the cell, at transformed scattering vectors. The heights are a sine on a
square patch; its turned copy runs along a diagonal and has whole periods in the patch.

``--pictures`` compares refined pictures with reference pictures. The reference is an unrefined picture with 16 × 16
pixels for each pixel, to which the pixel filter is applied with NumPy. Each of its pixels shows a single dot, so that
it does not use the division of cells between dots. The camera is rolled, because edges that are parallel to pixels
would be resolved to 1/16 pixel only. P99 of the reference's own error is 0.005 to 0.013. The maps are on a rectangular
mesh, the card. Errors are those of illuminated pixels that are not next to the edge of a mesh or shadow. ``P99 est`` is
the 99th percentile of ``image.error``. "Bounded" is the share of bright pixels whose error is at most ``image.error``.

``--bodies`` does the same on close views of a tube and a snake, with 24 × 24 pixels for each pixel of the reference.

``--pitches`` compares dots with pitch scales from 0.7 to 1.4 under averaged windows, of which colours are interpolated
between tables, with pictures in which all dots have the pitch scale of one column. These pictures interpolate nothing.
Pixels show points, and the card fills a wide field of view.

``--times`` measures processor times of ``Renderer.draw`` with a new light, alternately with and without a map; the
result is the ratio of the medians. Dots are about ten pixels wide.

``--card`` renders a card of 256 × 192 dots that shows a different picture to each eye. Half of the dots belong to each
eye. The luminance of a dot is that of one ray, through the pixel at the dot's middle. "Own" is the correlation of the
luminances of an eye's dots with the picture of this eye. "Other" is the correlation with the picture of the other eye.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import time
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage

import warpdiff as wd
from bench.truth.errors import FLOOR, reference_luminance, relative
from warpdiff.diffraction.direct_sum import window_power

if TYPE_CHECKING:
    from numpy.typing import NDArray

VIEW = wd.View((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), fov_y_deg=12.0, width=48, height=36)
LIGHT = wd.DirectionalLight((0.0, 0.5, 1.0))
SINE = wd.gratings.sinusoidal(1.2, 0.15)
# Wavelengths at which two direct sums of the diffracted power are compared [µm]; any visible wavelengths can be used.
WAVELENGTHS_UM = np.array([0.42, 0.5, 0.58, 0.7])


def transforms(rng: np.random.Generator) -> None:
    """Print the largest difference between two direct sums of the diffracted power, relative to the largest power.

    One sum is over turned and scaled heights. The other is over the original heights, at transformed scattering
    vectors.
    """
    z, azimuth = rng.uniform(0.5, 1.0, (2, 60)), rng.uniform(0.0, 2.0 * np.pi, (2, 60))
    side = np.sqrt(1.0 - z * z)
    lights, views = np.stack([side * np.cos(azimuth), side * np.sin(azimuth), z], axis=-1)
    # Half of the views are near the specular reflection, where the height field diffracts most light.
    views[:30] = lights[:30] * [-1.0, -1.0, 1.0] + rng.normal(0.0, 0.2, (30, 3)) * [1.0, 1.0, 0.0]
    views[:, 2] = np.abs(views[:, 2])
    views /= np.linalg.norm(views, axis=1)[:, None]
    vectors = -(lights + views)
    size, count, depth_scale, turn = 5.2, 96, 0.6, np.arctan2(4.0, 3.0)
    y, x = np.indices((count, count)) * size / count
    diagonal = 0.075 * np.sin(2.0 * np.pi * (3.0 * x + 4.0 * y) / size)
    straight = 0.075 * np.sin(2.0 * np.pi * 5.0 * x / size)
    cosine, sine = np.cos(turn), np.sin(turn)
    back = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    for kind, scale in (("averaged", 1.0), ("source", 1.0), ("source", 1.3)):
        coherence = scaled = wd.Coherence(sigma_um=2.0)
        if kind == "source":
            coherence, scaled = (wd.Coherence("source", angular_diameter_deg=2.0 * factor) for factor in (1.0, scale))
        field = wd.HeightField(depth_scale * diagonal, scale * size / count)
        cell = wd.HeightField(straight, size / count)
        exact = window_power(field, coherence, vectors, WAVELENGTHS_UM, to_lights=lights)
        # A light source of finite size blurs the scattering vectors by its spread s. A dot of a grating map with the
        # pitch scale p has p times as large lengths, so that the blur at the transformed vectors is p·s.
        mapped = (vectors @ back.T) * [scale, scale, depth_scale]
        result = window_power(cell, scaled, mapped, WAVELENGTHS_UM, to_lights=lights @ back.T)
        difference = np.abs(result - exact).max() / np.abs(exact).max()
        print(
            f"{kind}, turn 53.13°, depth scale {depth_scale:g}, pitch scale {scale:g}: {difference:.1e} of the largest"
        )


def made(cell: wd.HeightField, shape: tuple[int, int], rng: np.random.Generator, *, pitch: bool) -> wd.GratingMap:
    """Return a grating map: an array of small gratings (dots) with random directions, depths and pitches.

    The directions of the grooves are chosen so that many dots diffract light towards the camera.
    """
    turn = rng.uniform(85.0, 95.0, shape)
    scale = rng.uniform(0.7, 1.4, shape) if pitch else 1.0
    return wd.GratingMap(cell, turn_deg=turn, depth_scale=rng.uniform(0.2, 1.0, shape), pitch_scale=scale)


def filtered(
    mesh: Any, surface: wd.GratingMap, light: wd.Light, view: wd.View, factor: int, **options: Any
) -> NDArray[np.float64]:
    """Return the XYZ of a picture whose pixels are means over unrefined pixels, by the pixel filter.

    Each pixel is divided into ``factor`` × ``factor`` unrefined pixels.
    """
    margin = 2
    width, height = view.width + 2 * margin, view.height + 2 * margin
    half_height = math.tan(0.5 * math.radians(view.fov_y_deg)) * height / view.height
    wide = dataclasses.replace(
        view, width=factor * width, height=factor * height, fov_y_deg=2.0 * math.degrees(math.atan(half_height))
    )
    xyz = wd.shade(mesh, surface, light, wide, refine=False, tolerance=1e-3, **options).xyz.astype(np.float64)
    places = (np.arange(3 * factor) + 0.5) / factor - 1.5
    weights = np.exp(-0.5 * (places / 0.5) ** 2)
    for axis in (0, 1):
        lines = np.lib.stride_tricks.sliding_window_view(xyz, 3 * factor, axis=axis)
        lines = lines[(slice(None),) * axis + (slice(None, None, factor),)]
        xyz = lines @ (weights / weights.sum())
    return xyz[margin - 1 : 1 - margin, margin - 1 : 1 - margin]


def compare(
    name: str, mesh: Any, surface: wd.GratingMap, light: wd.Light, view: wd.View, factor: int, **options: Any
) -> None:
    """Print the errors of two refined pictures of a grating map, at tolerances of 0.1 and 0.03."""
    exact = filtered(mesh, surface, light, view, factor, **options)
    for tolerance in (0.1, 0.03):
        image = wd.shade(mesh, surface, light, view, tolerance=tolerance, **options)
        inside = ndimage.binary_erosion(image.illuminated & (image.coverage > 0.999), np.ones((3, 3)))
        own, true = image.xyz[inside].astype(float), exact[inside]
        size = np.linalg.norm(true, axis=1)
        floor = 1e-3 * np.percentile(true[:, 1], 99.0)
        error = np.linalg.norm(own - true, axis=1) / np.maximum(size, floor)
        bright = true[:, 1] >= floor
        estimated = image.error[inside]
        print(
            f"{name}, {surface.shape[0]} × {surface.shape[1]} dots, tolerance {tolerance:g}: "
            f"P99 {np.percentile(error, 99):.1e}, bright {np.percentile(error[bright], 99):.1e}, "
            f"P99 est {np.percentile(estimated, 99):.1e}, bounded {np.mean((error <= estimated)[bright]):.2f}",
            flush=True,
        )


def pictures(rng: np.random.Generator) -> None:
    """Print errors of refined pictures of flat grating maps (arrays of small gratings)."""
    rolled = dataclasses.replace(VIEW, up=(math.sin(math.radians(7.0)), math.cos(math.radians(7.0)), 0.0))
    fingers = wd.gratings.fingers(size_um=6.4, pitch_um=0.1)
    for name, cell, coherence in (
        ("sine, source of 1°", SINE, wd.Coherence("source", angular_diameter_deg=1.0)),
        ("fingers, source of 2°", fingers, wd.Coherence("source", angular_diameter_deg=2.0)),
        ("fingers, averaged", fingers, wd.Coherence(sigma_um=5.0)),
    ):
        for shape in ((3, 4), (12, 16), (48, 64)):
            grating_map = made(cell, shape, rng, pitch=coherence.kind == "source")
            compare(name, wd.meshes.card(), grating_map, LIGHT, rolled, 16, coherence=coherence, strict=False)


def bodies(rng: np.random.Generator) -> None:
    """Print errors of refined pictures of grating maps on close views of curved bodies."""
    fingers, blazed = wd.gratings.fingers(size_um=6.4, pitch_um=0.1), wd.gratings.blazed(1.6, 0.3)
    light, coherence = wd.DirectionalLight((0.3, 0.5, 1.0)), wd.Coherence(sigma_um=5.0)
    tube = wd.View((0.79, -1.25, 2.35), (0.88, 0.25, -0.12), fov_y_deg=8.0, width=64, height=48)
    snake = wd.View((0.54, -0.87, 1.95), (0.43, 0.41, 0.03), fov_y_deg=5.0, width=64, height=48)
    for name, mesh, view, cell, shape in (
        ("tube, fingers", wd.meshes.tube(), tube, fingers, (24, 60)),
        ("tube, fingers", wd.meshes.tube(), tube, fingers, (100, 400)),
        ("tube, sine", wd.meshes.tube(), tube, SINE, (24, 60)),
        ("snake, fingers", wd.meshes.snake(), snake, fingers, (20, 200)),
        ("snake, blazed", wd.meshes.snake(), snake, blazed, (40, 300)),
    ):
        turn, depth = rng.uniform(0.0, 180.0, shape), rng.uniform(0.2, 1.0, shape)
        grating_map = wd.GratingMap(cell, turn_deg=turn, depth_scale=depth)
        compare(name, mesh, grating_map, light, view, 24, coherence=coherence, strict=False, pigment=0.0)


def pitches(rng: np.random.Generator) -> None:
    """Print errors of pictures of grating maps whose dots (small gratings) differ in pitch scale.

    A pitch scale is the factor by which the grating periods of a dot are multiplied. The colours of a dot are
    interpolated between tables for several pitch scales.
    """
    columns = 24
    card, view = wd.meshes.card(), wd.View((0.1, 0.0, 0.6), (0.0, 0.0, 0.0), fov_y_deg=70.0, width=96, height=72)
    cells = {
        "sine": SINE, "lamellar": wd.gratings.lamellar(1.6, 0.15), "blazed": wd.gratings.blazed(2.0, 0.25),
        "fingers": wd.gratings.fingers(size_um=12.8), "bumps": wd.gratings.bumps(),
    }  # fmt: skip
    scales = rng.uniform(0.7, 1.4, (1, columns))
    scales[0, :2] = 0.7, 1.4
    # Position of each pixel along the columns of dots, which depends on card and view alone.
    plain = wd.shade(card, SINE, LIGHT, view, layers=["uv"], tolerance=0.3, footprint=False)
    along = columns * plain.layers["uv"][..., 0]
    for name, cell in cells.items():
        for sigma_um in (5.0, 16.25):
            for tolerance in (0.1, 1e-2):
                common: dict[str, Any] = {"coherence": wd.Coherence(sigma_um=sigma_um), "footprint": False}
                light = wd.DirectionalLight((rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), 1.0))
                image = wd.shade(
                    card, wd.GratingMap(cell, pitch_scale=scales), light, view, tolerance=tolerance, strict=False,
                    **common,
                )  # fmt: skip
                pairs = []
                for column, scale in enumerate(scales[0]):
                    single = wd.GratingMap(cell, pitch_scale=scale)
                    exact = wd.shade(card, single, light, view, tolerance=1e-3, strict=False, **common)
                    among = image.mask & (np.floor(along) == column)
                    pairs.append((image.xyz[among].astype(float), exact.xyz[among].astype(float)))
                own, true = (np.concatenate(values) for values in zip(*pairs, strict=True))
                error, bright = relative(own, true), true[:, 1] >= FLOOR * reference_luminance(true[:, 1])
                print(
                    f"{name}, sigma {sigma_um:g} µm, tolerance {tolerance:g}: bright directions P99 "
                    f"{np.percentile(error[bright], 99):.1e}, all P99 {np.percentile(error, 99):.1e}, "
                    f"{np.mean(bright):.0%} of {len(error)} pixels are bright",
                    flush=True,
                )


def times(rng: np.random.Generator) -> None:
    """Print the ratio of the times of frames with a grating map and with a single grating, without the first frame."""
    view = wd.View((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), fov_y_deg=12.0, width=320, height=240)
    fingers = wd.gratings.fingers(size_um=6.4, pitch_um=0.1)
    shape = (24, 32)
    for name, cell, coherence, pitch in (
        ("turn and depth, sine, source of 0.53°", SINE, wd.Coherence("source"), False),
        ("pitch 0.7 to 1.4, sine, source of 0.53°", SINE, wd.Coherence("source"), True),
        ("turn and depth, fingers, averaged, σ = 5 µm", fingers, wd.Coherence(sigma_um=5.0), False),
        ("pitch 0.7 to 1.4, fingers, averaged, σ = 5 µm", fingers, wd.Coherence(sigma_um=5.0), True),
        ("pitch 0.7 to 1.4, sine, averaged, σ = 5 µm", SINE, wd.Coherence(sigma_um=5.0), True),
    ):
        surfaces = {"plain": cell, "map": made(cell, shape, rng, pitch=pitch)}
        # The heights of the grating without a map vary along y, as in most dots of the map.
        tangents = {"plain": (0.0, 1.0, 0.0), "map": None}
        for refine in (False, True):
            options: dict[str, Any] = {
                "coherence": coherence, "tolerance": 0.1, "strict": False, "threads": 1, "refine": refine,
            }  # fmt: skip
            renderers = {
                key: wd.Renderer(wd.meshes.card(), surface, LIGHT, view, tangents=tangents[key], **options)
                for key, surface in surfaces.items()
            }
            spent: dict[str, list[float]] = {key: [] for key in renderers}
            for turn in range(7):
                light = wd.DirectionalLight((0.01 * turn, 0.5, 1.0))
                for key, renderer in renderers.items():
                    start = time.process_time()
                    renderer.draw(light)
                    spent[key].append(time.process_time() - start)
            plain, with_map = (float(np.median(spent[key][1:])) for key in ("plain", "map"))
            print(
                f"{name}, {'refined' if refine else 'not refined'}: {plain:.3f} s without, {with_map:.3f} s with a map,"
                f" ratio {with_map / plain:.2f}",
                flush=True,
            )


def card() -> None:
    """Render a card that shows a different hidden picture to each eye, as two pictures from the places of the eyes.

    Print the correlations of the rendered luminances with both hidden pictures.
    """
    rows, columns, width = 192, 256, 60.0
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, rows), np.linspace(-1.0, 1.0, columns), indexing="ij")
    first = 0.1 + 0.4 * (1.0 + np.sin(7.0 * np.pi * y) * np.sign(x + 1e-9))
    second = 0.1 + 0.35 * (1.0 + np.sign(np.sin(4.0 * np.pi * (x + 1.0) + 1e-9)))
    eyes = [(0.0, -55.7, 396.1), (166.5, -29.4, 362.5)]
    to_light = (0.0, 0.5736, 0.8192)
    foil = wd.hidden_pictures(first, second, eyes, to_light, cell=wd.gratings.sinusoidal(1.3, 0.2), width=width)
    print(foil)
    row, column = np.indices((rows, columns))
    is_first = (row + column) % 2 == 0
    side = width / columns
    middle = np.stack([(column + 0.5 - columns / 2) * side, (rows / 2 - row - 0.5) * side, 0.0 * row], axis=-1)
    for index, eye in enumerate(eyes):
        view = wd.View(eye, (0.0, 0.0, 0.0), fov_y_deg=8.4, width=1280, height=960)
        image = wd.shade(
            wd.meshes.card(width, width * rows / columns), foil, wd.DirectionalLight(to_light), view, footprint=False,
            refine=False, tolerance=0.02, ior=np.inf,
        )  # fmt: skip
        frame = view.frame()
        towards = middle - frame.origin
        depth = -(towards @ frame.back)
        at_x = ((towards @ frame.right) / depth / frame.half_width + 1.0) / 2.0 * view.width
        at_y = (1.0 - (towards @ frame.up) / depth / frame.half_height) / 2.0 * view.height
        seen = image.xyz[at_y.astype(int), at_x.astype(int), 1]
        own = is_first if index == 0 else ~is_first
        picture, other = (first, second) if index == 0 else (second, first)
        print(
            f"eye {index + 1}: own {np.corrcoef(seen[own], picture[own])[0, 1]:.4f}, other "
            f"{np.corrcoef(seen[own], other[own])[0, 1]:.4f}, mean of the other dots "
            f"{seen[~own].mean() / seen[own].mean():.1e} of the mean of its own"
        )


def main() -> None:
    """Run the parts that the command line options select."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("transforms", "pictures", "bodies", "pitches", "times", "card"):
        parser.add_argument(f"--{name}", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wd.WarpdiffWarning)
        if options.transforms:
            transforms(rng)
        if options.pictures:
            pictures(rng)
        if options.bodies:
            bodies(rng)
        if options.pitches:
            pitches(rng)
        if options.times:
            times(rng)
        if options.card:
            card()


if __name__ == "__main__":
    main()
