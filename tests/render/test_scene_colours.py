"""Base colours of scenes whose parts lack colours, textures or texture coordinates.

A plain surface has no height field, and reflects by its base colour.
"""

import itertools

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import ColorVisuals, TextureVisuals
from trimesh.visual.material import PBRMaterial, SimpleMaterial

import warpdiff as wd

CORNERS = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
WAVE = wd.gratings.sinusoidal(1.5, 0.1)
LIGHT = wd.DirectionalLight((0.3, 0.0, 1.0))
OPTIONS = {"coherence": wd.Coherence(sigma_um=5.0), "tolerance": 0.1, "refine": False, "footprint": False}
RED, BLUE = (255, 0, 0), (0, 0, 255)


def quad(material=None, *, uv=True, colours=None):
    """Return a square of width 2 in the plane z = 0."""
    body = trimesh.Trimesh(CORNERS, [[0, 1, 2], [0, 2, 3]], process=False)
    if colours is not None:
        body.visual = ColorVisuals(body, vertex_colors=np.tile([*colours, 255], (4, 1)).astype(np.uint8))
    elif material is not None:
        body.visual = TextureVisuals(uv=CORNERS[:, :2] if uv else None, material=material)
    return body


def texture(colour):
    return Image.new("RGB", (3, 5), colour)


# Kinds of parts by name: a function that makes the part, and its base colour as a plain surface (without a height
# field).
KINDS = {
    "bare": (quad, (1, 1, 1)),
    "unnamed metal": (lambda: quad(PBRMaterial(metallicFactor=1.0, roughnessFactor=0.4)), (1, 1, 1)),
    "vertices": (lambda: quad(colours=RED), (1, 0, 0)),
    "factor": (lambda: quad(PBRMaterial(baseColorFactor=[0, 255, 0, 255])), (0, 1, 0)),
    "texture": (lambda: quad(SimpleMaterial(image=texture(BLUE), name="paint")), (0, 0, 1)),
    "texture without coordinates": (lambda: quad(PBRMaterial(baseColorTexture=texture(RED)), uv=False), (1, 1, 1)),
}


def albedos(names, surfaces=None):
    """Return the base colour in the middle of each of several mesh parts, which lie side by side."""
    scene = trimesh.Scene()
    for index, name in enumerate(names):
        body = KINDS[name][0]()
        body.apply_translation((2.1 * index, 0.0, 0.0))
        scene.add_geometry(body, geom_name=f"{index} {name}")
    grating = quad(SimpleMaterial(diffuse=[255, 0, 255, 255]))
    grating.apply_translation((0.0, -9.0, 0.0))
    scene.add_geometry(grating, geom_name="grating")
    middle = 2.1 * 0.5 * (len(names) - 1)
    view = wd.View.orthographic(
        (middle, 0.0, 5.0), (middle, 0.0, 0.0), extent_y=2.1, width=5 * len(names), height=5
    )  # fmt: skip
    surfaces = surfaces or {"grating": WAVE, "*": None}
    image = wd.shade(scene, surfaces, LIGHT, view, **OPTIONS, tangents="x", layers=["albedo"])
    return image.layers["albedo"][2, 2::5]


@pytest.mark.filterwarnings("ignore:mesh has materials with features that are not rendered")
@pytest.mark.parametrize("first", KINDS)
def test_plain_parts_without_a_colour_are_white_beside_any_other_part(first):
    for second in KINDS:
        for names in ((first, second), (second, first)):
            expected = [KINDS[name][1] for name in names]
            np.testing.assert_allclose(albedos(names), expected, atol=1e-6, err_msg=str(names))


@pytest.mark.filterwarnings("ignore:mesh has materials with features that are not rendered")
def test_scenes_of_four_parts_have_the_colours_of_their_parts(rng):
    orders = list(itertools.permutations(KINDS, 4))
    for names in (orders[index] for index in rng.integers(len(orders), size=6)):
        np.testing.assert_allclose(albedos(names), [KINDS[name][1] for name in names], atol=1e-6, err_msg=str(names))


def test_a_height_field_without_a_colour_has_no_pigment_beside_a_coloured_part():
    surfaces = {"0 bare": WAVE, "*": None}
    np.testing.assert_allclose(
        albedos(["bare", "factor"], surfaces | {"grating": WAVE}), [(0, 0, 0), (0, 1, 0)], atol=1e-6
    )


def test_a_metal_without_a_colour_is_white_beside_coloured_parts():
    def luminance(own):
        scene = trimesh.Scene({"metal": quad(own), "grating": quad()})
        scene.geometry["grating"].apply_translation((5.0, 0.0, 0.0))
        scene.add_geometry(quad(colours=RED).apply_translation((-3.0, 0.0, 0.0)), geom_name="red")
        view = wd.View.orthographic((0, 0, 5.0), (0, 0, 0), extent_y=1.0, width=4, height=4)
        return wd.shade(scene, {"grating": WAVE, "*": None}, LIGHT, view, **OPTIONS, tangents="x").xyz

    metal = {"metallicFactor": 1.0, "roughnessFactor": 0.4}
    bare, white = (
        luminance(PBRMaterial(name="m", **metal, **values)) for values in ({}, {"baseColorFactor": [255] * 4})
    )
    assert white.min() > 1e-5
    np.testing.assert_allclose(bare, white, rtol=1e-5)
