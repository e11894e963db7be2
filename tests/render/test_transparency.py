"""Pictures of scenes with cut-outs and blended faces: coverage, colours behind, and shadows."""

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

import warpdiff as wd
from warpdiff.scene.mesh_import import prepare_surface

OPAQUE = PBRMaterial(name="opaque", baseColorFactor=[255, 255, 255, 255])
# Alpha of the blended material, 102 of 255.
ALPHA = 0.4
BLEND = PBRMaterial(name="blend", baseColorFactor=[255, 255, 255, 102], alphaMode="BLEND")
SHORT = wd.Coherence(sigma_um=5.0)


def square(height, half, material, repeats=1):
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    uv = 0.5 * repeats * (corners[:, :2] + 1.0)
    visual = TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(half * corners + [0, 0, height], [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)


def middle(parts, light=None, **options):
    """Return coverage and luminance of the middle of a picture from above, where plain squares reflect light.

    A grating of a thousandth of the size, far below the squares and outside of the picture, completes the scene.
    """
    grating = square(-3.0, 1e-3, OPAQUE)
    grating.apply_translation((1.5, 1.5, 0.0))
    surfaces = {**dict.fromkeys(parts), "grating": wd.gratings.sinusoidal(2.0, 0.05)}
    view = wd.View.orthographic((0.0, 0.0, 5.0), (0, 0, 0), extent_y=2.0, width=24, height=24)
    light = light or wd.DirectionalLight((0.0, 0.0, 1.0))
    options = {"tolerance": 0.1, "coherence": SHORT, **options}
    image = wd.shade(trimesh.Scene({**parts, "grating": grating}), surfaces, light, view, **options)
    return image.coverage[6:-6, 6:-6], image.xyz[6:-6, 6:-6, 1]


@pytest.fixture(scope="module")
def white():
    """Return the luminance of an opaque white square."""
    _, luminance = middle({"a": square(0.0, 2.0, OPAQUE)})
    return float(luminance.mean())


def cut_out():
    """Return a material whose texture is opaque in half of its 8 × 8 texels, like a chess board."""
    texels = np.full((8, 8, 4), 255, np.uint8)
    texels[..., 3] = 255 * (np.indices((8, 8)).sum(axis=0) % 2)
    return PBRMaterial(name="cut", baseColorTexture=Image.fromarray(texels), alphaMode="MASK", alphaCutoff=0.5)


def test_cut_outs_show_what_lies_behind(white):
    coverage, luminance = middle({"a": square(0.0, 2.0, cut_out(), 2)})
    assert abs(coverage.mean() - 0.5) < 0.02
    assert abs(luminance.mean() / white - 0.5) < 0.02
    # A black square behind the holes covers the picture, and reflects nothing.
    black = PBRMaterial(name="black", baseColorFactor=[0, 0, 0, 255])
    coverage, luminance = middle({"a": square(0.0, 2.0, cut_out(), 2), "b": square(-0.5, 2.0, black)})
    np.testing.assert_allclose(coverage, 1.0, rtol=1e-6)
    assert abs(luminance.mean() / white - 0.5) < 0.02


@pytest.mark.parametrize("layers", [1, 2, 3])
def test_blended_layers_cover_by_their_alphas(layers, white):
    coverage, luminance = middle({f"layer {k}": square(-0.2 * k, 2.0, BLEND) for k in range(layers)})
    passed = 1.0 - ALPHA
    np.testing.assert_allclose(coverage, 1.0 - passed**layers, atol=0.15)
    assert abs(coverage.mean() - (1.0 - passed**layers)) < 0.02
    # Light passes the layers above on its way down, and again on its way up.
    expected = sum(ALPHA * passed ** (2 * layer) for layer in range(layers))
    assert abs(luminance.mean() / white - expected) < 0.02


def test_blended_faces_cast_partial_shadows(white):
    light = wd.DirectionalLight((1.0, 0.0, 1.0))
    _, alone = middle({"ground": square(0.0, 2.0, OPAQUE)}, light)
    pane = square(2.0, 1.5, BLEND)
    pane.apply_translation((2.6, 0.0, 0.0))
    parts = {"ground": square(0.0, 2.0, OPAQUE), "pane": pane}
    _, shaded = middle(parts, light)
    # Pixels may have errors of the tolerance, 0.1, which partly have the same sign: cells that agree by chance are not
    # subdivided further.
    assert abs(shaded.mean() / alone.mean() - (1.0 - ALPHA)) < 0.06
    assert alone.mean() < white
    sky = wd.Environment.clear_sky((0.0, 0.2, 1.0))
    _, open_sky = middle({"ground": square(0.0, 2.0, OPAQUE)}, sky)
    cover = {"ground": square(0.0, 2.0, OPAQUE), "pane": square(0.5, 1.9, BLEND)}
    _, below = middle(cover, sky)
    # The pane covers nearly the whole sky of the points below. They show it through the pane.
    assert 0.4 < below.mean() / open_sky.mean() < 1.0


def test_pictures_with_blended_faces_do_not_depend_on_threads():
    parts = {"a": square(0.0, 2.0, BLEND), "b": square(-0.3, 2.0, BLEND)}
    one, two = (middle(parts, threads=threads) for threads in (1, 2))
    np.testing.assert_array_equal(one, two)


def test_materials_that_are_nowhere_transparent_are_opaque():
    for material in (
        PBRMaterial(baseColorFactor=[255, 255, 255, 255], alphaMode="BLEND"),
        PBRMaterial(baseColorFactor=[255, 255, 255, 200], alphaMode="MASK", alphaCutoff=0.5),
        PBRMaterial(baseColorFactor=[255, 255, 255, 102]),
    ):
        assert prepare_surface(square(0.0, 1.0, material)).is_opaque
    assert not prepare_surface(square(0.0, 1.0, BLEND)).is_opaque
