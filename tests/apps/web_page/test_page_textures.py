"""Textures and transparency of web pages: what a page cannot show is refused, or named in a warning."""

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

import warpdiff as wd


@pytest.fixture(scope="module")
def lobes():
    return wd.bake(wd.gratings.sinusoidal(2.0, 0.1), delta_e=20.0, coherence=wd.Coherence(sigma_um=2.0))


def square(height, **material):
    corners = np.array([[-1, -1, height], [1, -1, height], [1, 1, height], [-1, 1, height]], dtype=float)
    visual = TextureVisuals(uv=corners[:, :2], material=PBRMaterial(**material))
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)


def exported(path, mesh, lobes):
    view = wd.View((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    return wd.export_html(path, mesh, lobes, wd.DirectionalLight((0, 1, 1)), view)


def test_pages_refuse_several_images(lobes, tmp_path):
    images = [Image.new("RGB", (4, 4), colour) for colour in ("red", "green")]
    scene = trimesh.Scene([square(k, baseColorTexture=image) for k, image in enumerate(images)])
    with pytest.raises(ValueError, match="mesh must have at most one texture image in a page, got 2"):
        exported(tmp_path / "a.html", scene, lobes)


def test_pages_name_transparent_materials_in_a_warning(lobes, tmp_path):
    pane = square(0.0, baseColorFactor=[255, 255, 255, 100], alphaMode="BLEND")
    with pytest.warns(wd.WarpdiffWarning, match="mesh has transparent materials, which a page draws opaque"):
        exported(tmp_path / "a.html", pane, lobes)
