"""Pictures, maps and arrays, to tell whether a change of the code leaves what is computed the same to the bit.

::

    python -m warpdiff.bench.studies.corpus --write before.npz
    python -m warpdiff.bench.studies.corpus --compare before.npz

All forms of coherence, methods, sample counts, kinds of light, texture and view, on one thread and on two; the numbers
of each plan are among the values. They are small and of synthetic surfaces. Another processor or another version of a
library may round otherwise: write and compare on one machine.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import os
import sys
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from PIL import Image as Pixels

import warpdiff as wd

if TYPE_CHECKING:
    from collections.abc import Callable

THREADS = (1, 2)
SIZE = {"width": 96, "height": 72}
SMALL = {"width": 24, "height": 18}
ABOVE = wd.DirectionalLight((0.1, 0.9, 1.2))
LAMP = wd.DirectionalLight((-1.0, 0.6, 0.9), power=0.5, illuminant="A")
SOURCE = wd.Coherence("source", angular_diameter_deg=2.0)
# Those that sample wavelengths, or that a table is made by, for few pixels.
METHODS = ("low-rank/sampled", "power/sampled", "jacobi-anger/sampled", "taylor/sampled", "taylor-uncentred/sampled")


def fingers() -> wd.HeightField:
    """A new one each time, which remembers nothing."""
    return wd.gratings.fingers(size_um=12.8, pitch_um=0.09, seed=5)


def tube() -> trimesh.Trimesh:
    """Few faces."""
    return wd.meshes.tube(segments_along=48, segments_around=24)


def box() -> trimesh.Trimesh:
    """A box with a texture of colours, facing the viewer with three sides."""
    rng = np.random.default_rng(7)
    texture = Pixels.fromarray(rng.integers(0, 255, (16, 16, 3), dtype=np.uint8))
    body = trimesh.creation.box((1.0, 1.0, 1.0))
    faces = np.arange(3 * len(body.faces)).reshape(-1, 3)
    corners = body.triangles.reshape(-1, 3)
    uv = corners[:, :2] + 0.3 * corners[:, 2:] + 0.5
    return trimesh.Trimesh(
        corners, faces, process=False, visual=trimesh.visual.TextureVisuals(uv=uv, image=texture)
    )  # fmt: skip


def near(**size: int) -> wd.View:
    """A view of the tube."""
    return wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, **(size or SIZE))


def directions(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lights and views all over the hemisphere."""
    rng = np.random.default_rng(count)
    drawn = rng.normal(size=(2, count, 3))
    drawn[..., 2] = np.abs(drawn[..., 2]) + 0.1
    return drawn[0], drawn[1]


def picture(image: wd.Image) -> dict[str, Any]:
    """What a picture holds, with its plan."""
    held = {name: getattr(image, name) for name in ("xyz", "mask", "lit", "coverage", "error")}
    return {**held, **(image.layers or {}), **numbers(image.plan)}


def numbers(plan: wd.Plan) -> dict[str, Any]:
    """A plan's."""
    return {f"plan.{name}": np.array(str(value)) for name, value in dataclasses.asdict(plan).items()}


def on_the_tube(light: Any = ABOVE, view: wd.View | None = None, **options: Any) -> Callable[[int], dict[str, Any]]:
    """A picture of fingers on a tube."""
    return lambda threads: picture(wd.shade(tube(), fingers(), light, view or near(), threads=threads, **options))


def of_the_snake(threads: int) -> dict[str, Any]:
    """Its texture, two lights, shadows, scales that overlap, normals and depths."""
    view = wd.View((0.5, 1.1, 1.2), (0.1, 0.0, 0.2), fov_y_deg=20.0, **SIZE)
    layers = ("normal", "depth", "geometry")
    return picture(
        wd.shade(wd.meshes.snake(), fingers(), [ABOVE, LAMP], view, threads=threads, layers=layers, tolerance=3e-2)
    )


def of_the_box(threads: int) -> dict[str, Any]:
    """Facets and a texture, seen by parallel rays."""
    view = wd.View.orthographic((1.2, 1.0, 1.6), (0.0, 0.0, 0.0), extent_y=2.2, **SIZE)
    light = wd.DirectionalLight((0.5, 1.0, 1.5), illuminant="FL11")
    hf = wd.gratings.disc("CD", tracks=4, length_um=12.8, pitch_um=0.09)
    image = wd.shade(box(), hf, light, view, smooth=False, pigment=300.0, samples_per_pixel=4, threads=threads)
    return picture(image)


def given_tangents(threads: int) -> dict[str, Any]:
    """A sphere without texture coordinates, a mirror, no masking."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    tangents = np.cross([0.0, 1.0, 0.0], ball.vertices + np.array([1e-3, 0.0, 0.0]))
    view = wd.View((0.0, 0.5, 4.0), (0.0, 0.0, 0.0), **SIZE)
    hf = wd.gratings.blazed(2.5, 0.25)
    options = {"tangents": tangents, "ior": float("inf"), "masking": False, "shadows": False, "tolerance": 0.2}
    return picture(wd.shade(ball, hf, ABOVE, view, threads=threads, **options))


def drawn_in_turn(threads: int) -> dict[str, Any]:
    """A renderer's pictures, lights and view moved."""
    renderer = wd.Renderer(tube(), fingers(), ABOVE, near(), tolerance=3e-2, threads=threads)
    first = picture(renderer.image())
    renderer.draw([LAMP, ABOVE], wd.View((0.4, 1.2, 2.0), (0.0, 0.0, 0.0), fov_y_deg=27.0, **SIZE))
    return first | {f"second.{name}": value for name, value in picture(renderer.image()).items()}


def of_directions(count: int, coherence: wd.Coherence, **options: Any) -> Callable[[int], dict[str, Any]]:
    """Colours of a list of directions."""
    return lambda threads: {
        "xyz": wd.reflectance(fingers(), *directions(count), coherence=coherence, threads=threads, **options)
    }


def copies(threads: int) -> dict[str, Any]:
    """A few periods of a grating, on a disc."""
    view = wd.View((0.0, -1.9, 2.3), (0.0, 0.0, 0.0), **SIZE)
    coherence = wd.Coherence("replicas", copies=(1, 10))
    hf = wd.gratings.lamellar(2.5, 0.14)
    return picture(wd.shade(wd.meshes.disc(), hf, ABOVE, view, coherence=coherence, threads=threads))


def directly(threads: int) -> dict[str, Any]:
    """A few pixels by the sum that approximates nothing."""
    hf = wd.gratings.sinusoidal(2.5, 0.14)
    view = near(width=12, height=9)
    return picture(wd.shade(tube(), hf, ABOVE, view, method="direct", threads=threads))


def spectra(threads: int) -> dict[str, Any]:
    """Relative and absolute, of all forms, and where the orders of a grating go."""
    forms = (wd.Coherence(), wd.Coherence("centred"), SOURCE, wd.Coherence("replicas", copies=(2, 2)))
    waves = np.linspace(400.0, 700.0, 7)
    found: dict[str, Any] = {}
    for form in forms:
        options: dict[str, Any] = {"coherence": form, "threads": threads}
        found[f"{form.kind}.relative"] = wd.spectral_reflectance(fingers(), *directions(40), waves, **options)
        found[f"{form.kind}.absolute"] = wd.brdf(fingers(), *directions(40), waves, **options)
    orders = wd.order_efficiencies(wd.gratings.sinusoidal(2.0, 0.3), (0.3, 0.1, 1.0), waves)
    return found | {"orders": orders.orders, "efficiencies": orders.efficiencies}


def maps(threads: int) -> dict[str, Any]:
    """The reflectance seen from above, a point and four in a pixel."""
    hf = wd.gratings.bumps()
    one, four = (
        wd.brdf_map(hf, (0.3, 0.2, 1.0), size=64, samples_per_pixel=samples, threads=threads) for samples in (1, 4)
    )
    return picture(one) | {f"four.{name}": value for name, value in picture(four).items()}


def surfaces(_: int) -> dict[str, Any]:
    """Heights, cleaned in all ways, and what is said of them."""
    rng = np.random.default_rng(3)
    made = {
        "fingers": fingers(), "bumps": wd.gratings.bumps(), "blazed": wd.gratings.blazed(2.0, 0.3),
        "disc": wd.gratings.disc("DVD", tracks=4, length_um=12.8, pitch_um=0.06),
    }  # fmt: skip
    heights = made["fingers"].heights_um + 0.02 * np.arange(made["fingers"].shape[1]) ** 1.1
    heights[rng.random(heights.shape) < 1e-3] += 2.0
    heights[30:33, 40:44] = np.nan
    rough = wd.HeightField(heights, 0.09).filled()
    made |= {"levelled": rough.levelled(2), "despiked": rough.levelled(2).despiked(), "cropped": rough.cropped(6.0)}
    made |= {"resampled": rough.resampled(0.2), "periodic": rough.levelled(2).periodic()}
    found: dict[str, Any] = {name: hf.heights_um for name, hf in made.items()}
    found["summary"] = np.array(str(made["periodic"].summary()))
    return found | {
        f"of {name}": value for name, value in numbers(wd.plan(made["periodic"], tolerance=1e-1, strict=False)).items()
    }


CASES: dict[str, Callable[[int], dict[str, Any]]] = {
    "refined picture": on_the_tube(),
    "picture to 1e-1": on_the_tube(tolerance=1e-1),
    "footprints alone": on_the_tube(tolerance=1e-1, refine=False),
    "four cells a pixel": on_the_tube(tolerance=1e-1, samples_per_pixel=4),
    "points": on_the_tube(footprint=False),
    "sixteen points a pixel": on_the_tube(footprint=False, samples_per_pixel=16),
    "centred window": on_the_tube(coherence=wd.Coherence("centred"), view=near(**SMALL)),
    "source": on_the_tube(tolerance=1e-1, coherence=SOURCE),
    "copies": copies,
    "directly": directly,
    **{
        name: on_the_tube(method=name, refine=False, footprint=False, view=near(**SMALL), tolerance=3e-2)
        for name in METHODS
    },
    "table of powers": on_the_tube(method="power/table", tolerance=1e-1),
    "sampled footprints": on_the_tube(method="low-rank/sampled", view=near(**SMALL), tolerance=1e-1),
    "snake": of_the_snake,
    "box": of_the_box,
    "given tangents": given_tangents,
    "renderer": drawn_in_turn,
    "few directions": of_directions(50, wd.Coherence()),
    "many directions": of_directions(40_000, wd.Coherence(), illuminant="FL2", tolerance=3e-2),
    "many directions, centred": of_directions(33_000, wd.Coherence("centred"), tolerance=3e-2),
    "spectra": spectra,
    "maps": maps,
    "surfaces": surfaces,
}  # fmt: skip


def computed() -> dict[str, np.ndarray]:
    """All values, by case, threads and name."""
    found = {}
    for name, case in CASES.items():
        for threads in THREADS:
            begin = time.perf_counter()
            values = {f"{name}/{threads}/{what}": np.asarray(value) for what, value in case(threads).items()}
            found |= values
            print(f"{digest(values)}  {time.perf_counter() - begin:5.1f} s  {name}, threads={threads}", flush=True)
    return found


def digest(values: dict[str, np.ndarray]) -> str:
    """A hash of names, kinds, shapes and bits, without the number of threads, on which nothing depends."""
    held = hashlib.sha256()
    for name, value in values.items():
        held.update(f"{name.split('/')[-1]} {value.dtype} {value.shape} ".encode())
        held.update(np.ascontiguousarray(value).tobytes())
    return held.hexdigest()[:16]


def differences(old: dict[str, np.ndarray], new: dict[str, np.ndarray]) -> list[str]:
    """What is not the same to the bit, a line each."""
    lines = [
        f"{name}: only {where}" for name in sorted(set(old) ^ set(new)) for where in ["new" if name in new else "old"]
    ]
    for name in sorted(set(old) & set(new)):
        a, b = old[name], new[name]
        if a.dtype != b.dtype or a.shape != b.shape:
            lines.append(f"{name}: {a.dtype} {a.shape} is now {b.dtype} {b.shape}")
        elif a.tobytes() != b.tobytes():
            lines.append(f"{name}: {_change(a, b)}")
    return lines


def _change(a: np.ndarray, b: np.ndarray) -> str:
    if a.dtype.kind != "f":
        return f"{a} is now {b}" if a.ndim == 0 else f"{np.mean(a != b):.2g} of the values differ"
    apart = np.abs(np.float64(a) - b)
    largest = np.nanmax(np.where(np.isfinite(a), np.abs(a), 0.0))
    return f"{np.mean(a != b):.2g} of the values differ, at most by {np.nanmax(apart):.2g}, of {largest:.3g}"


def main() -> int:
    """Write values, or compare with written ones; returns 1 if any differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--write", type=Path, metavar="FILE", help="a .npz file")
    what.add_argument("--compare", type=Path, metavar="FILE", help="one that was written before")
    options = parser.parse_args()
    # What another version left on disk is no computation of this one.
    os.environ["WARPDIFF_CACHE_DIR"] = ""
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    found = computed()
    print(f"{len(CASES)} cases, {len(found)} arrays, {digest(found)} in all")
    if options.write:
        np.savez_compressed(options.write, **found)
        return 0
    with np.load(options.compare) as held:
        lines = differences(dict(held), found)
    print("\n".join(lines) or "all the same to the bit")
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
