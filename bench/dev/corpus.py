"""Test cases whose arrays show whether a change of the code leaves all results identical to the bit.

::

    python -m bench.dev.corpus --write before.npz
    python -m bench.dev.corpus --compare before.npz

The script uses only public names, and imports the package that is installed for this Python. In an environment with the
wheel of another version, the script writes the arrays of that version. ``public_names`` maps public names that have
changed since version 0.1.0.

The cases cover all kinds of coherence, methods, sample counts, lights, materials, textures, cameras and files, with one
thread and with two. The values of a case include the numbers of its plan. Texts are not compared, except for names of
objects. Surfaces are small and synthetic. Other processors or other versions of libraries may round differently. Write
and compare the arrays on the same machine, in environments with the same versions of all libraries.
"""

from __future__ import annotations

import argparse
import base64
import dataclasses
import hashlib
import json
import os
import re
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from PIL import Image as Pixels

from bench.dev.public_names import plan_numbers, wd

if TYPE_CHECKING:
    from collections.abc import Callable

    Values = dict[str, Any]
    Case = Callable[[int], Values]

# Numbers of threads with which each test case is computed.
THREADS = (1, 2)
SIZE = {"width": 96, "height": 72}
SMALL = {"width": 24, "height": 18}
MEDIUM = {"width": 48, "height": 36}
ABOVE = wd.DirectionalLight((0.1, 0.9, 1.2))
SIDE = wd.DirectionalLight((-1.0, 0.6, 0.9), power=0.5, illuminant="A")
SOURCE = wd.Coherence("source", angular_diameter_deg=2.0)
WAVELENGTHS_NM = np.linspace(400.0, 700.0, 7)
# Methods that can sum over wavelength samples instead of using a colour table, which has colours by scattering vector.
SAMPLED_METHODS = ("low-rank", "power", "jacobi-anger", "taylor", "taylor-uncentred")
IMAGE_ARRAYS = ("xyz", "mask", "illuminated", "coverage", "error")
SUMMARY_NUMBERS = (
    "shape", "size_um", "pitch_um", "height_range_um", "rms_um", "rms_slope", "mean_slope", "max_uv", "scalar_error",
    "missing",
)  # fmt: skip
PERIOD_NUMBERS = (
    "period_um", "standard_error_um", "direction_deg", "harmonics_um", "share", "frequency", "is_coherent",
    "is_resolved",
)  # fmt: skip


# Surfaces, bodies, cameras and lights that the test cases use.


def fingers() -> Any:
    """Return a new height field of fingers as on a snake's skin, for which the package has cached nothing."""
    return wd.gratings.fingers(size_um=12.8, pitch_um=0.09, seed=5)


def tube() -> trimesh.Trimesh:
    """Return a tube with few faces."""
    return wd.meshes.tube(segments_along=48, segments_around=24)


def box() -> trimesh.Trimesh:
    """Return a box with a colour texture. Three of its sides are visible from the camera of ``box_view``."""
    rng = np.random.default_rng(7)
    texture = Pixels.fromarray(rng.integers(0, 255, (16, 16, 3), dtype=np.uint8))
    body = trimesh.creation.box((1.0, 1.0, 1.0))
    faces = np.arange(3 * len(body.faces)).reshape(-1, 3)
    corners = body.triangles.reshape(-1, 3)
    uv = corners[:, :2] + 0.3 * corners[:, 2:] + 0.5
    return trimesh.Trimesh(
        corners, faces, process=False, visual=trimesh.visual.TextureVisuals(uv=uv, image=texture)
    )  # fmt: skip


def two_geometries() -> trimesh.Scene:
    """Return a scene of a tube with a single base colour and a textured box.

    The geometries are named "tube" and "box".
    """
    scene = trimesh.Scene()
    body = tube()
    # Without a base colour, trimesh would write a texture for this material. The file would then have two textures, but
    # the package reads at most one texture per file.
    body.visual.material = trimesh.visual.material.PBRMaterial(baseColorFactor=(200, 120, 40, 255))
    scene.add_geometry(body, node_name="tube", geom_name="tube")
    at = trimesh.transformations.translation_matrix((0.0, 0.0, 0.9)) @ np.diag([0.5, 0.5, 0.5, 1.0])
    scene.add_geometry(box(), node_name="box", geom_name="box", transform=at)
    return scene


def tube_view(**size: int) -> Any:
    """Return a perspective camera that looks at the tube."""
    return wd.View((0.0, 1.6, 3.1), (0.0, 0.0, 0.0), fov_y_deg=27.0, **(size or SIZE))


def box_view(**size: int) -> Any:
    """Return an orthographic camera that looks at the box."""
    return wd.View.orthographic((1.2, 1.0, 1.6), (0.0, 0.0, 0.0), extent_y=2.2, **(size or SIZE))


def radiances(*, with_sun: bool) -> np.ndarray:
    """Return an environment map of a bluish sky above brown ground, shape (32, 64, 3).

    With ``with_sun``, the sky has a sun, one pixel wide.
    """
    rng = np.random.default_rng(11)
    up = np.linspace(1.0, -1.0, 32)[:, None, None]
    sky = np.array([0.3, 0.5, 0.9]) * (1.0 + up) + 0.2 * rng.random((32, 64, 3))
    ground = np.array([0.3, 0.2, 0.1]) * (1.0 + 0.3 * rng.random((32, 64, 1)))
    result = np.where(up > 0.0, sky, ground)
    if with_sun:
        result[7, 40] = 4e3, 3.6e3, 3e3
    return result


def directions(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random light and view directions on the upper hemisphere."""
    rng = np.random.default_rng(count)
    vectors = rng.normal(size=(2, count, 3))
    vectors[..., 2] = np.abs(vectors[..., 2]) + 0.1
    return vectors[0], vectors[1]


def coated_metal() -> Any:
    """Return the material of aluminium with a 300 nm film of glass."""
    return wd.Material.metal("Al").coated(wd.Material.dielectric(1.5), 300.0)


# Functions that collect, by name, the values of a result that are compared.


def image_values(image: Any) -> Values:
    """Return the arrays and layers of a picture, and the numbers of its plan and of its report."""
    return map_values(image) | plan_values(image.plan, getattr(image, "report", None))


def map_values(image: Any) -> Values:
    """Return the arrays of a picture or of a reflectance map, with the numbers of the plan."""
    arrays = {name: getattr(image, name) for name in IMAGE_ARRAYS} | dict(image.layers or {})
    return arrays | plan_values(image.plan)


def plan_values(plan: Any, report: Any = None) -> Values:
    """Return the numbers of a plan, and the numbers of a picture's report if there is a picture."""
    numbers = plan_numbers(plan, report)
    return {f"plan.{name}": str(value) if value is None else value for name, value in numbers.items()}


def named(prefix: str, values: Values) -> Values:
    """Return values by name, with a prefix added to each name."""
    return {f"{prefix}.{name}": value for name, value in values.items()}


def attributes(owner: Any, names: tuple[str, ...]) -> Values:
    """Return the values of the named attributes of an object."""
    return {name: getattr(owner, name) for name in names}


def archive_values(path: Path) -> Values:
    """Return the arrays of a .npz file that the package wrote."""
    with np.load(path) as archive:
        return dict(archive)


def pixel_values(path: Path) -> Values:
    """Return the pixels and channel names of a .png or .exr file that the package wrote."""
    import OpenImageIO as oiio  # noqa: N813 (as its own manual does)

    file = oiio.ImageInput.open(str(path))
    spec = file.spec()
    values = {
        "pixels": file.read_image(0, 0, 0, spec.nchannels, "unknown"),
        "channels": np.array(list(spec.channelnames)),
        "exposure": spec.get_float_attribute("warpdiff:exposure"),
    }
    file.close()
    return values


def page_values(path: Path) -> Values:
    """Return the packed arrays of an exported web page, and all numbers of its JSON header in their order."""
    page = path.read_text(encoding="utf-8")
    header = re.search(r'<script type="application/json"[^>]*>(.*?)</script>', page, re.DOTALL)
    data = re.search(r'<script type="text/plain"[^>]*>([A-Za-z0-9+/=\s]{1000,})</script>', page)
    if header is None or data is None:
        raise ValueError(
            f"{path.name} must contain a JSON header and a script of base64 data, but one of them is missing"
        )
    packed = np.frombuffer(zlib.decompress(base64.b64decode(data[1])), dtype=np.uint8)
    return {"packed": packed, "header": np.array(_numbers_in(json.loads(header[1])))}


def _numbers_in(value: Any) -> list[float]:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return [number for item in value for number in _numbers_in(item)]
    return [float(value)] if isinstance(value, (int, float)) else []


# Test cases that draw pictures.


def picture(
    body: Callable[[], Any], surface: Callable[[], Any], view: Any, lights: Any = ABOVE, **options: Any
) -> Case:
    """Return a test case that renders a body with a height field."""
    return lambda threads: image_values(
        wd.shade(body(), lights=lights, heightfield=surface(), view=view, threads=threads, **options)
    )


def tube_picture(lights: Any = ABOVE, view: Any = None, **options: Any) -> Case:
    """Return a test case that renders the tube with the height field of fingers."""
    return picture(tube, fingers, view or tube_view(), lights, **options)


def sampled_picture(method: str) -> Case:
    """Return a test case that renders a small picture of the tube by integration over sampled wavelengths."""
    return tube_picture(
        method=method, integration="sampled", refine=False, footprint=False, view=tube_view(**SMALL), tolerance=3e-2
    )


def explicit_tangents(threads: int) -> Values:
    """Render a sphere, as a perfect mirror without masking, with explicit tangents instead of texture coordinates."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    tangents = np.cross([0.0, 1.0, 0.0], ball.vertices + np.array([1e-3, 0.0, 0.0]))
    view = wd.View((0.0, 0.5, 4.0), (0.0, 0.0, 0.0), **SIZE)
    grating = wd.gratings.blazed(2.5, 0.25)
    options = {"tangents": tangents, "ior": float("inf"), "masking": False, "shadows": False, "tolerance": 0.2}
    return image_values(wd.shade(ball, grating, ABOVE, view, threads=threads, **options))


def explicit_plan(threads: int) -> Values:
    """Render with an explicit plan: the automatic plan with two additional terms of the series."""
    surface = fingers()
    plan = wd.plan(heightfield=surface, tolerance=3e-2, threads=threads)
    changed = dataclasses.replace(plan, terms=plan.terms + 2)
    return image_values(wd.shade(tube(), surface, ABOVE, tube_view(**MEDIUM), plan=changed, threads=threads))


def disc_view(**size: int) -> Any:
    """Return a camera that looks at the mesh of a disc from a position where diffraction orders are visible."""
    return wd.View((0.0, -1.9, 2.3), (0.0, 0.0, 0.0), **(size or SIZE))


def successive_pictures(threads: int) -> Values:
    """Render two pictures with the same renderer, with other lights and another camera in the second picture."""
    options = {"lights": ABOVE, "view": tube_view(), "tolerance": 3e-2, "threads": threads}
    renderer = wd.Renderer(tube(), heightfield=fingers(), **options)
    first = image_values(renderer.image())
    view = wd.View((0.4, 1.2, 2.0), (0.0, 0.0, 0.0), fov_y_deg=27.0, **SIZE)
    renderer.draw(lights=[SIDE, ABOVE], view=view)
    return first | named("second", image_values(renderer.image()))


def previews(threads: int) -> Values:
    """Collect the previews that a renderer completes at tolerances of 0.3 and 0.1, and the final picture."""
    renderer = wd.Renderer(tube(), fingers(), ABOVE, tube_view(**MEDIUM), tolerance=2e-2, threads=threads)
    completed: Values = {}

    def complete(tolerance: float) -> None:
        completed.update(named(f"{tolerance:g}", image_values(renderer.image())))

    renderer.draw(SIDE, previews={at: lambda at=at: complete(at) for at in (0.3, 0.1)})
    return completed | image_values(renderer.image())


def resized_renderer(threads: int) -> Values:
    """Render a smaller picture with the plan and the tables of a larger picture."""
    renderer = wd.Renderer(tube(), fingers(), [ABOVE, SIDE], tube_view(), tolerance=1e-1, refine=False, threads=threads)
    return image_values(renderer.resized(tube_view(**MEDIUM), refine=True).image())


# Test cases with environment lights.


def sky_picture(*, with_sun: bool, **options: Any) -> Case:
    """Return a test case that renders the tube under a sky, with the sky as background."""

    def draw(threads: int) -> Values:
        sky = wd.Environment(radiances(with_sun=with_sun), rotation_deg=30.0, scale=0.7, directions=100)
        view = tube_view(width=16, height=12)
        image = wd.shade(tube(), fingers(), [sky, SIDE], view, tolerance=1e-1, threads=threads, **options)
        return image_values(image) | {"background": sky.background(view)}

    return draw


def loaded_sky(threads: int) -> Values:
    """Render the box under a sky from an EXR file. The tolerance determines the number of sky directions."""
    import OpenImageIO as oiio  # noqa: N813 (as its own manual does)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sky.exr"
        image = oiio.ImageOutput.create(str(path))
        image.open(str(path), oiio.ImageSpec(64, 32, 3, oiio.FLOAT))
        image.write_image(radiances(with_sun=True).astype(np.float32))
        image.close()
        sky = wd.Environment.load(path, rotation_deg=-75.0)
    view = box_view(**SMALL)
    return image_values(wd.shade(box(), fingers(), sky, view, tolerance=0.3, refine=False, threads=threads))


# Test cases with materials and with normalised energy.


def materials_by_geometry(threads: int) -> Values:
    """Render a scene of a coated metal geometry and a dielectric geometry, under lights of different spectra."""
    materials = {"tube": coated_metal(), "box": wd.Material.dielectric(1.7)}
    lights = [ABOVE, wd.DirectionalLight((1.0, 1.0, 0.5), illuminant=wd.Spectrum.blackbody(2900.0))]
    image = wd.shade(
        two_geometries(), fingers(), lights, tube_view(), material=materials, tolerance=1e-1, layers=("geometry",),
        threads=threads,
    )  # fmt: skip
    return image_values(image)


def normalised_energy(threads: int) -> Values:
    """Compute spectra, colours and a map with normalised energy, for a mirror, copper and the default material."""
    options: Values = {"energy": "normalised", "threads": threads}
    metal = wd.Material.metal("Cu")
    surface = fingers()
    lights, views = directions(40)
    return {
        "brdf": wd.brdf(surface, lights, views, WAVELENGTHS_NM, ior=float("inf"), **options),
        "brdf of a metal": wd.brdf(surface, lights, views, WAVELENGTHS_NM, material=metal, **options),
        "xyz": wd.reflectance(surface, lights, views, material=metal, **options),
        **named("map", map_values(wd.reflectance_map(surface, (0.3, 0.2, 1.0), size=24, **options))),
    }


# Test cases that compute colours or spectra of arrays of directions.


def direction_colours(count: int, coherence: Any, **options: Any) -> Case:
    """Return a test case that computes the colours of ``count`` random directions."""
    return lambda threads: {
        "xyz": wd.reflectance(
            heightfield=fingers(), to_light=directions(count)[0], to_view=directions(count)[1], coherence=coherence,
            threads=threads, **options,
        )
    }  # fmt: skip


def spectra(threads: int) -> Values:
    """Compute relative and absolute reflectance spectra for all kinds of coherence, and order efficiencies."""
    coherences = (wd.Coherence(), wd.Coherence("centred"), SOURCE, wd.Coherence("replicas", periods=(2, 2)))
    values: Values = {}
    for coherence in coherences:
        options: Values = {"coherence": coherence, "threads": threads}
        values[f"{coherence.kind}.relative"] = wd.spectral_reflectance(
            fingers(), *directions(40), WAVELENGTHS_NM, **options
        )
        values[f"{coherence.kind}.absolute"] = wd.brdf(fingers(), *directions(40), WAVELENGTHS_NM, **options)
    orders = wd.order_efficiencies(wd.gratings.sinusoidal(2.0, 0.3), (0.3, 0.1, 1.0), WAVELENGTHS_NM)
    return values | {"orders": orders.orders, "efficiencies": orders.efficiencies}


def orders(_: int) -> Values:
    """Compute the order efficiencies of a metal, a coated metal and a mirror grating.

    The efficiencies of the mirror are computed with the energy normalisation, and those of the coated metal without it.
    """
    names = ("wavelengths_nm", "orders", "to_view", "efficiencies")
    light = (0.3, 0.1, 1.0)
    calls = {
        "metal": (wd.gratings.blazed(2.0, 0.3), {"material": wd.Material.metal("Au")}),
        "coated": (wd.gratings.lamellar(1.5, 0.1), {"material": coated_metal(), "energy": "stam"}),
        "mirror": (wd.gratings.bumps(), {"ior": float("inf"), "energy": "normalised"}),
    }
    values: Values = {}
    for name, (surface, options) in calls.items():
        result = wd.order_efficiencies(heightfield=surface, to_light=light, wavelengths_nm=WAVELENGTHS_NM, **options)
        values |= named(name, attributes(result, names)) | {f"{name}.of order (0, 1)": result[0, 1]}
    return values


def maps(threads: int) -> Values:
    """Compute reflectance maps over all view directions, with one and with four directions per pixel."""
    surface = wd.gratings.bumps()
    one, four = (
        wd.reflectance_map(
            heightfield=surface, to_light=(0.3, 0.2, 1.0), size=64, samples_per_pixel=samples, threads=threads
        )
        for samples in (1, 4)
    )
    return map_values(one) | named("four", map_values(four))


def material_colours(threads: int) -> Values:
    """Compute a coated metal's colours under two illuminants, its spectra, and the reflectance of a flat surface."""
    lights, views = directions(60)
    material = coated_metal()
    options: Values = {"material": material, "threads": threads}
    angles = np.linspace(0.0, 89.0, 7)[:, None]
    return {
        "flat": np.stack([material.reflectance(WAVELENGTHS_NM, angles, polarisation=which) for which in "sp"]),
        "black body": wd.reflectance(fingers(), lights, views, illuminant=wd.Spectrum.blackbody(2900.0), **options),
        "daylight": wd.reflectance(fingers(), lights, views, illuminant=wd.Spectrum.daylight(5000.0), **options),
        "relative": wd.spectral_reflectance(fingers(), lights, views, WAVELENGTHS_NM, **options),
    }


# Test cases that process height fields: cleaning, periods and files.


def surfaces(_: int) -> Values:
    """Collect synthetic height fields, and the results of all methods that clean them.

    For one cleaned height field, also collect the numbers of its summary and of a plan for its reflectance.
    """
    rng = np.random.default_rng(3)
    fields = {
        "fingers": fingers(), "bumps": wd.gratings.bumps(), "blazed": wd.gratings.blazed(2.0, 0.3),
        "disc": wd.gratings.disc("DVD", tracks=4, length_um=12.8, pitch_um=0.06),
    }  # fmt: skip
    heights = fields["fingers"].heights_um + 0.02 * np.arange(fields["fingers"].shape[1]) ** 1.1
    heights[rng.random(heights.shape) < 1e-3] += 2.0
    heights[30:33, 40:44] = np.nan
    rough = wd.HeightField(heights, 0.09).filled()
    fields |= {"levelled": rough.levelled(2), "despiked": rough.levelled(2).despiked(), "cropped": rough.cropped(6.0)}
    fields |= {"resampled": rough.resampled(0.2), "periodic": rough.levelled(2).periodic()}
    values: Values = {name: field.heights_um for name, field in fields.items()}
    values |= named("summary", attributes(fields["periodic"].summary(), SUMMARY_NUMBERS))
    return values | plan_values(wd.plan(fields["periodic"], tolerance=1e-1, strict=False))


def repeats(_: int) -> Values:
    """Find the periods of a noisy crossed grating with missing heights, and crop the grating to whole periods."""
    rng = np.random.default_rng(17)
    y, x = np.mgrid[:160, :200] * 0.1
    heights = 0.2 * np.cos(2.0 * np.pi * x / 2.3) + 0.1 * np.cos(2.0 * np.pi * (y + 0.2 * x) / 3.1)
    heights += 0.05 * np.cos(4.0 * np.pi * x / 2.3) + 0.02 * rng.standard_normal(heights.shape)
    heights[50:60, 70:90] = np.nan
    field = wd.HeightField(heights, 0.1)
    values: Values = {"whole periods": field.filled().whole_periods().heights_um}
    for index, period in enumerate(field.periods(3)):
        values |= named(f"period {index}", attributes(period, PERIOD_NUMBERS))
    return values


def height_files(_: int) -> Values:
    """Load height fields from 8-bit and 16-bit images, a floating-point TIFF, and a .npy file with missing heights."""
    rng = np.random.default_rng(23)
    heights = rng.random((24, 24)).astype(np.float32)
    gaps = heights.astype(np.float64)
    gaps[3:5, 6:9] = np.nan
    values: Values = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        Pixels.fromarray((255.0 * heights).astype(np.uint8)).save(folder / "byte.png")
        Pixels.fromarray((65_535.0 * heights).astype(np.uint16)).save(folder / "word.png")
        Pixels.fromarray(heights).save(folder / "float.tiff")
        np.save(folder / "gaps.npy", gaps)
        calls = {
            "byte.png": {"pitch_um": 0.1, "height_range_um": 0.7},
            "word.png": {"extent_um": 2.4, "height_range_um": 0.7},
            "float.tiff": {"pitch_um": (0.2, 0.1)},
            "gaps.npy": {"pitch_um": 0.09},
        }
        for file, options in calls.items():
            field = wd.HeightField.load(folder / file, **options)
            values |= named(file, attributes(field, ("heights_um", "missing", "pitch_um", "size_um")))
    return values


# Test cases that write and read files: meshes, pictures, baked tables, web pages and sequences.


def mesh_files(threads: int) -> Values:
    """Render meshes from three files: OBJ with a texture, PLY with vertex colours, and GLB with two geometries."""
    values: Values = {}
    options: Values = {"tolerance": 1e-1, "refine": False, "threads": threads}
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.8)
    red_to_blue = np.linspace(0, 255, len(ball.vertices)).astype(np.uint8)
    opaque = np.full_like(red_to_blue, 255)
    ball.visual.vertex_colors = np.stack([opaque - red_to_blue, red_to_blue // 2, red_to_blue, opaque], axis=1)
    materials = {"tube": wd.Material.metal("Ag"), "box": wd.Material.dielectric(1.6)}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        box().export(folder / "box.obj")
        ball.export(folder / "ball.ply")
        two_geometries().export(folder / "both.glb")
        obj = wd.shade(folder / "box.obj", fingers(), ABOVE, box_view(**MEDIUM), pigment=300.0, **options)
        ply = wd.shade(
            folder / "ball.ply", fingers(), ABOVE, box_view(**MEDIUM), pigment=300.0, tangents=(0.2, 1.0, 0.3),
            **options,
        )  # fmt: skip
        glb = wd.shade(
            folder / "both.glb", fingers(), ABOVE, tube_view(**MEDIUM), material=materials,
            layers=("normal", "geometry"), **options,
        )  # fmt: skip
    for kind, image in {"obj": obj, "ply": ply, "glb": glb}.items():
        values |= named(kind, image_values(image))
    return values


def saved_pictures(threads: int) -> Values:
    """Collect the pixels of PNG and EXR files of a picture, and its display colours for all displays and gamuts."""
    layers = ("normal", "depth", "geometry")
    image = wd.shade(
        tube(), fingers(), ABOVE, tube_view(**MEDIUM), tolerance=1e-1, layers=layers, pigment=0.0, threads=threads
    )
    values: Values = {"rgb": image.rgb, "auto_exposure": image.auto_exposure}
    for display in ("aces", "colorimetric", "clip"):
        for gamut in ("srgb", "display-p3"):
            values[f"{display}, {gamut}"] = image.display(display, gamut=gamut)
    values["table of ACES"] = image.display(exact=False, exposure=3.0, exposure_stops=-1.0)
    values["in front of itself"] = image.display("clip", background=image, exposure_from=image)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        calls: dict[str, Values] = {
            "plain.exr": {}, "bright.exr": {"exposure": 3.0, "exposure_stops": 1.0}, "plain.png": {},
            "words.png": {"bits": 16, "display": "colorimetric", "gamut": "display-p3"},
            "grey.png": {"background": (0.2, 0.2, 0.2), "exposure_stops": -0.5},
        }  # fmt: skip
        for file, options in calls.items():
            values |= named(file, pixel_values(image.save(folder / file, **options)))
    return values


def baked_lobes(threads: int) -> Values:
    """Bake lobes on a metal for two kinds of coherence, averaged and light source; collect their files and colours."""
    surface = wd.gratings.fingers(size_um=6.4, pitch_um=0.1, seed=4)
    lights, views = directions(200)
    calls: dict[str, Values] = {
        "averaged": {"coherence": wd.Coherence(sigma_um=4.0)},
        "source": {
            "coherence": wd.Coherence("source", angular_diameter_deg=8.0), "material": wd.Material.metal("Ni"),
            "illuminant": "A",
        },
    }  # fmt: skip
    values: Values = {}
    with tempfile.TemporaryDirectory() as name:
        for kind, options in calls.items():
            lobes = wd.bake(heightfield=surface, delta_e=8.0, threads=threads, **options)
            file = lobes.save(Path(name) / f"{kind}.npz")
            read = wd.BakedLobes.load(file)
            values |= named(f"{kind}.file", archive_values(file))
            values |= named(kind, {"error": lobes.error, "colours": lobes.colours(-(lights + views) / 4.0)})
            values[f"{kind}.reflectance"] = read.reflectance(lights, views)
            values[f"{kind}.cartesian"] = read.cartesian(16)
    return values


def baked_spectrum(threads: int) -> Values:
    """Bake a spectrum and collect the arrays of its file."""
    surface = wd.gratings.fingers(size_um=6.4, pitch_um=0.1, seed=4)
    coherence = wd.Coherence(sigma_um=4.0)
    table = wd.bake_spectrum(heightfield=surface, size=32, tolerance=3e-2, coherence=coherence, threads=threads)
    with tempfile.TemporaryDirectory() as name:
        return archive_values(table.save(Path(name) / "spectrum.npz"))


def pages(threads: int) -> Values:
    """Export two web pages and collect their data: the textured box, and the tube under a point light."""
    lobes = wd.bake(
        wd.gratings.fingers(size_um=6.4, pitch_um=0.1, seed=4), coherence=wd.Coherence(sigma_um=4.0), delta_e=8.0,
        threads=threads,
    )  # fmt: skip
    view = wd.View((1.2, 1.0, 1.6), (0.0, 0.0, 0.0))
    sized = wd.DirectionalLight((0.3, 1.0, 1.0), angular_diameter_deg=2.0)
    lights = [sized, wd.PointLight((0.0, 3.0, 3.0), power=3.0)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        first = wd.export_html(folder / "box.html", box(), lobes, lights=sized, view=view, pigment=200.0, title="box")
        second = wd.export_html(
            folder / "tube.html", tube(), lobes, lights, view, ior=1.7, masking=False, smooth=False, exposure=2.0
        )
        return named("box", page_values(first)) | named("tube", page_values(second))


def sequences(threads: int) -> Values:
    """Render a turntable, a light sweep and a camera path, and collect cameras, lights and pixels of all frames."""
    view = tube_view(**MEDIUM)
    renderer = wd.Renderer(tube(), fingers(), [ABOVE, SIDE], view, tolerance=1e-1, refine=False, threads=threads)
    path_text = "eye_x,eye_y,eye_z,target_x,target_y,target_z,fov_y_deg\n0,1.6,3.1,0,0,0,27\n0.5,1.2,3,0.1,0,0,30\n"
    values: Values = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        camera = folder / "camera.csv"
        camera.write_text(path_text)
        shots = {
            "turntable": wd.turntable(lights=[ABOVE, SIDE], view=view, count=3),
            "body at rest": wd.turntable([ABOVE], view, count=2, turns=-0.2, lights_follow=False),
            "light sweep": wd.light_sweep(ABOVE, view, (-0.5, 0.5, 1.0), count=2),
            "camera path": wd.camera_path(camera, lights=ABOVE, view=view, count=3),
        }
        for kind, of_kind in shots.items():
            files = wd.sequence(renderer, of_kind, folder / kind, formats=(".png", ".exr"), bits=16)
            for file in files:
                values |= named(f"{kind}.{file.name}", pixel_values(file))
            values[f"{kind}.eyes"] = [shot.view.eye for shot in of_kind]
            values[f"{kind}.lights"] = [[light.to_light for light in shot.lights] for shot in of_kind]
    return values


CASES: dict[str, Case] = {
    "refined picture": tube_picture(), "picture to 1e-1": tube_picture(tolerance=1e-1),
    "footprints alone": tube_picture(tolerance=1e-1, refine=False),
    "four subpixel cells": tube_picture(tolerance=1e-1, samples_per_pixel=4), "points": tube_picture(footprint=False),
    "sixteen points per pixel": tube_picture(footprint=False, samples_per_pixel=16),
    "centred window": tube_picture(coherence=wd.Coherence("centred"), view=tube_view(**SMALL)),
    "source": tube_picture(tolerance=1e-1, coherence=SOURCE),
    "periods": picture(
        wd.meshes.disc, lambda: wd.gratings.lamellar(2.5, 0.14), disc_view(),
        coherence=wd.Coherence("replicas", periods=(1, 10)),
    ),
    "direct sum": picture(
        wd.meshes.disc, lambda: wd.gratings.sinusoidal(2.5, 0.14), disc_view(width=12, height=9), method="direct",
        coherence=wd.Coherence(sigma_um=4.0), tolerance=1e-1,
    ),
    **{f"{method}, sampled": sampled_picture(method) for method in SAMPLED_METHODS},
    "table of powers": tube_picture(method="power", integration="table", tolerance=1e-1),
    "sampled footprints": tube_picture(
        method="low-rank", integration="sampled", view=tube_view(**SMALL), tolerance=1e-1
    ),
    # The picture of the snake has a texture, two lights, shadows, overlapping scales and all layers.
    "snake": picture(
        wd.meshes.snake, fingers, wd.View((0.5, 1.1, 1.2), (0.1, 0.0, 0.2), fov_y_deg=20.0, **SIZE), [ABOVE, SIDE],
        layers=("normal", "depth", "geometry"), tolerance=3e-2,
    ),
    # The picture of the box has flat faces with a texture, and an orthographic camera.
    "box": picture(
        box, lambda: wd.gratings.disc("CD", tracks=4, length_um=12.8, pitch_um=0.09), box_view(),
        wd.DirectionalLight((0.5, 1.0, 1.5), illuminant="FL11"), smooth=False, pigment=300.0, samples_per_pixel=4,
    ),
    "explicit tangents": explicit_tangents, "renderer": successive_pictures,
    "few directions": direction_colours(50, wd.Coherence()),
    "many directions": direction_colours(40_000, wd.Coherence(), illuminant="FL2", tolerance=3e-2),
    "many directions, centred": direction_colours(33_000, wd.Coherence("centred"), tolerance=3e-2), "spectra": spectra,
    "maps": maps, "surfaces": surfaces,
    # The following test cases use features that version 0.1 lacks.
    "explicit plan": explicit_plan, "previews": previews, "resized renderer": resized_renderer,
    "point light": picture(
        two_geometries, fingers, tube_view(), [wd.PointLight((1.2, 1.4, 0.4), power=2.0, illuminant="FL2"), SIDE],
        tolerance=1e-1,
    ),
    "disc light": tube_picture(
        wd.DirectionalLight((0.1, 0.9, 1.2), angular_diameter_deg=3.0), tolerance=1e-1, view=tube_view(**MEDIUM)
    ),
    "wide disc light": tube_picture(
        [wd.DirectionalLight((0.1, 0.9, 1.2), angular_diameter_deg=20.0), SIDE], tube_view(**SMALL), tolerance=1e-1
    ),
    "disc light, unrefined": tube_picture(
        wd.DirectionalLight((0.1, 0.9, 1.2), angular_diameter_deg=3.0), tolerance=1e-1, refine=False
    ),
    "sky": sky_picture(with_sun=False), "sky with a sun": sky_picture(with_sun=True, refine=False),
    "sky from a file": loaded_sky,
    "metal": tube_picture(
        wd.DirectionalLight((0.1, 0.9, 1.2), illuminant=wd.Spectrum.daylight(6000.0)), tolerance=1e-1,
        material=wd.Material.metal("Au"),
    ),
    "materials by geometry": materials_by_geometry, "material colours": material_colours,
    "normalised energy, picture": tube_picture(energy="normalised", tolerance=1e-1, view=tube_view(**MEDIUM)),
    "normalised energy, directions": normalised_energy, "orders": orders, "periods of a field": repeats,
    "height files": height_files, "mesh files": mesh_files, "saved pictures": saved_pictures,
    "baked lobes": baked_lobes, "baked spectrum": baked_spectrum, "pages": pages, "sequences": sequences,
}  # fmt: skip


# Functions that write the values of all test cases to a file, or compare them with the values in an earlier file.


def compute(names: list[str]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Compute all values of the named test cases.

    The keys of the values are "case/threads/name". The second result is a list of failures: exceptions, and values that
    depend on the number of threads.
    """
    values: dict[str, np.ndarray] = {}
    failures = []
    for name in names:
        by_threads = []
        for threads in THREADS:
            begin = time.perf_counter()
            try:
                arrays = {what: np.asarray(value) for what, value in CASES[name](threads).items()}
            except Exception as error:
                traceback.print_exc()
                failures.append(f"{name}, threads={threads}: {type(error).__name__}: {error}")
                continue
            seconds = time.perf_counter() - begin
            by_threads.append(arrays)
            values |= {f"{name}/{threads}/{what}": array for what, array in arrays.items()}
            print(f"{digest(arrays)}  {seconds:5.1f} s  {name}, threads={threads}", flush=True)
        if len(by_threads) == len(THREADS):
            failures += [f"{name} depends on the number of threads: {line}" for line in differences(*by_threads)]
    return values, failures


def digest(values: dict[str, np.ndarray]) -> str:
    """Return a hash of the names, types, shapes and bits of all values."""
    result = hashlib.sha256()
    for name, value in sorted(values.items()):
        result.update(f"{name} {value.dtype} {value.shape} ".encode())
        result.update(np.ascontiguousarray(value).tobytes())
    return result.hexdigest()[:16]


def differences(old: dict[str, np.ndarray], new: dict[str, np.ndarray]) -> list[str]:
    """Return a line of text for each value of the test cases that differs in at least one bit from its old version."""
    lines = [f"{name}: only {'new' if name in new else 'old'}" for name in sorted(set(old) ^ set(new))]
    for name in sorted(set(old) & set(new)):
        a, b = old[name], new[name]
        if a.dtype != b.dtype or a.shape != b.shape:
            lines.append(f"{name}: {a.dtype} {a.shape} is now {b.dtype} {b.shape}")
        elif a.tobytes() != b.tobytes():
            lines.append(f"{name}: {_difference(a, b)}")
    return lines


def _difference(a: np.ndarray, b: np.ndarray) -> str:
    if a.ndim == 0:
        return f"{a} is now {b}"
    share = f"{np.mean(a != b):.2g} of the values differ"
    if a.dtype.kind != "f":
        return share
    largest = np.nanmax(np.where(np.isfinite(a), np.abs(a), 0.0))
    return f"{share}, by at most {np.nanmax(np.abs(np.float64(a) - b)):.2g}; the largest value is {largest:.3g}"


def main() -> int:
    """Write the values, or compare them with an earlier file. Return 1 if a value differs or a test case fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--write", type=Path, metavar="FILE", help="write the reference to this .npz file")
    action.add_argument("--compare", type=Path, metavar="FILE", help="compare with the reference in this .npz file")
    parser.add_argument("--only", nargs="+", metavar="CASE", choices=list(CASES), help="compute only these cases")
    options = parser.parse_args()
    # The disk cache is disabled, because it may contain tables of another version of the package.
    os.environ["WARPDIFF_CACHE_DIR"] = ""
    warnings.simplefilter("ignore", wd.WarpdiffWarning)
    folder = Path(wd.__file__).parent
    print(f"warpdiff {wd.__version__} in {folder}, Python {sys.version.split()[0]}, NumPy {np.__version__}", flush=True)
    begin = time.perf_counter()
    names = options.only or list(CASES)
    values, lines = compute(names)
    seconds = time.perf_counter() - begin
    print(f"{len(names)} cases, {len(values)} arrays, {digest(values)} for all, {seconds:.0f} s")
    if options.write:
        np.savez_compressed(options.write, **values)
    else:
        with np.load(options.compare) as archive:
            before = {name: archive[name] for name in archive if name.split("/")[0] in names}
        lines += differences(before, values)
        if not lines:
            print("all values are equal to the bit")
    print("\n".join(lines))
    return int(bool(lines))


if __name__ == "__main__":
    sys.exit(main())
