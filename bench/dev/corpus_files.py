"""Test cases of ``bench/dev/corpus.py`` that write and read files: meshes, pictures, baked tables, pages, sequences."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from bench.dev.corpus_inputs import (
    ABOVE,
    MEDIUM,
    SIDE,
    box,
    box_view,
    directions,
    fingers,
    tube,
    tube_view,
    two_geometries,
)
from bench.dev.corpus_values import archive_values, image_values, named, page_values, pixel_values
from bench.dev.public_names import wd

if TYPE_CHECKING:
    from bench.dev.corpus_values import Values


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
    """Export the colours of a metal surface (baked lobes) for two kinds of coherence; collect files and colours.

    The kinds are an averaged coherence window and a light source of finite size.
    """
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
    """Sample a surface's colours over scattering vectors (baked spectrum), and collect the arrays of the saved file."""
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
