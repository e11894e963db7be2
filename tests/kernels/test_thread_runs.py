"""Runs of threads: results do not depend on how the indices of a launch are divided among threads.

On the CPU, one thread processes all indices of a slice. On a GPU, each thread processes one index.
"""

import numpy as np
import pytest
import trimesh
from PIL import Image
from plain_specification import COHERENCE, WAVE, quad
from trimesh.visual.material import PBRMaterial

import warpdiff as wd
from warpdiff.device import kernel_calls
from warpdiff.scene import camera_rays


def in_runs_of(run):
    """Return a replacement of ``_Recorded.run``, which launches a kernel, with ``run`` indices per thread."""

    def launch(recorded, begin, end):
        first, stop = begin // recorded._block, -(-end // recorded._block)
        if not recorded._in_runs:
            recorded._launch.set_param_at_index_from_ctype(recorded._first, first)
            recorded._launch.set_dim(stop - first)
            recorded._launch.launch()
            return
        threads = (stop - first) // run
        for start, count, length in ((first, threads, run), (first + threads * run, 1, (stop - first) % run)):
            if count * length:
                recorded._launch.set_param_at_index_from_ctype(recorded._first, start)
                recorded._launch.set_param_at_index_from_ctype(recorded._first + 1, length)
                recorded._launch.set_dim((count, 1))
                recorded._launch.launch()

    return launch


def scene():
    """Return a rough metal that emits light, a matte surface, and a coloured mesh with a grating, side by side."""
    body = trimesh.Scene()
    metal = PBRMaterial(
        name="metal", baseColorFactor=[255, 200, 0, 255], metallicFactor=1.0, roughnessFactor=0.4,
        emissiveFactor=[0.1, 0.05, 0.0],
    )  # fmt: skip
    matte = PBRMaterial(name="matte", baseColorFactor=[50, 100, 150, 255])
    for x, name, own in ((-2.1, "metal", metal), (0.0, "matte", matte), (2.1, "grating", None)):
        body.add_geometry(quad(x, own), geom_name=name)
    return body


def test_a_picture_does_not_depend_on_the_number_of_indices_per_thread(monkeypatch):
    """A picture under lights of all kinds must be the same with one index and with three indices per thread.

    The shadows are found by grids of the faces that may occlude a light. Such grids are made only if there are many
    shadow rays per face, so that the limit is raised here.
    """
    monkeypatch.setattr(camera_rays, "_FACES_PER_RAY", 10**6)
    disc, point = wd.DirectionalLight((0.2, 0.1, 1.0), angular_diameter_deg=20.0), wd.PointLight((0.5, 0.5, 3.0))
    many = [wd.DirectionalLight((0.1 * k, 0.3, 1.0), power=0.1) for k in range(-35, 35)]
    sky = wd.Environment(0.5 + 0.4 * np.sin(np.arange(24.0)).reshape(2, 4, 3), directions=32)
    view = wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=2.0, width=24, height=8)
    surfaces, lights = {"grating": WAVE, "*": None}, [disc, point, *many, sky]
    options = {"coherence": COHERENCE, "tolerance": 0.3, "strict": False}
    options |= {"pigment": 0.5, "energy": "normalised", "material": wd.Material.metal("Au")}
    plan = wd.shade(scene(), surfaces, lights, view, **options).plan
    del options["coherence"]
    pictures = []
    for run in (1, 3):
        monkeypatch.setattr(kernel_calls._Recorded, "run", in_runs_of(run))
        image = wd.shade(scene(), surfaces, lights, view, **options, plan=plan)
        pictures.append(image.xyz)
    assert image.illuminated.sum() > 100
    np.testing.assert_allclose(pictures[1], pictures[0], rtol=1e-5)


def textured_scene(rng):
    """Return a grating map next to a textured metal that emits light, both half covered by a translucent pane."""
    images = [Image.fromarray(rng.integers(60, 255, (8, 8, 4), dtype=np.uint8)) for _ in range(3)]
    metal = PBRMaterial(
        name="metal", baseColorTexture=images[0].convert("RGB"), metallicRoughnessTexture=images[1].convert("RGB"),
        emissiveTexture=images[2].convert("RGB"), emissiveFactor=[0.1, 0.1, 0.1],
    )  # fmt: skip
    pane = PBRMaterial(name="pane", baseColorTexture=images[1], alphaMode="BLEND")
    body = trimesh.Scene()
    for x, name, own in ((-1.0, "metal", metal), (1.1, "map", None), (0.0, "pane", pane)):
        part = quad(x, own)
        part.apply_translation((0.0, 0.0, 0.5 * (name == "pane")))
        body.add_geometry(part, geom_name=name)
    return body


@pytest.mark.parametrize("options", [{}, {"refine": False, "footprint": False, "samples_per_pixel": 2}])
def test_a_picture_of_textures_and_dots_does_not_depend_on_the_number_of_indices_per_thread(options, rng, monkeypatch):
    """Transparent faces, textures and dots of a grating map must be the same with one and with three indices."""
    shape = (8, 8)
    dots = wd.GratingMap(
        WAVE, turn_deg=rng.uniform(0.0, 180.0, shape), depth_scale=rng.uniform(0.3, 1.0, shape),
        pitch_scale=rng.uniform(0.8, 1.2, shape),
    )  # fmt: skip
    lights = [wd.DirectionalLight((0.1, 0.4, 1.0)), wd.PointLight((0.5, 0.5, 3.0))]
    view = wd.View.orthographic((0, 0, 5), (0, 0, 0), extent_y=2.0, width=16, height=6)
    options = options | {"coherence": COHERENCE, "tolerance": 0.3, "strict": False, "pigment": 0.5}
    surfaces, body = {"map": dots, "*": None}, textured_scene(rng)
    pictures = []
    for run in (1, 3):
        monkeypatch.setattr(kernel_calls._Recorded, "run", in_runs_of(run))
        pictures.append(wd.shade(body, surfaces, lights, view, **options).xyz)
    assert (pictures[0].max(axis=2) > 0.0).sum() > 30
    np.testing.assert_allclose(pictures[1], pictures[0], rtol=1e-5)
