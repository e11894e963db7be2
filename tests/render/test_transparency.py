"""Pictures of scenes with cut-outs and blended faces: coverage, colours of faces behind others, and shadows."""

import base64
import io

import numpy as np
import pytest
import trimesh
from gltf_files import SQUARE_UVS, square_file
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

import warpdiff as wd
from warpdiff.core.wording import WarpdiffWarning
from warpdiff.optics.colorimetry import srgb_decode
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
    """Return coverage and luminance in the middle of a picture of plain squares from above.

    A scene must have a height field. A tiny grating far below the squares, outside of the picture, is therefore added.
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
    # Light passes the blended layers above a layer twice: once from the light to the layer, and once to the viewer.
    expected = sum(ALPHA * passed ** (2 * layer) for layer in range(layers))
    assert abs(luminance.mean() / white - expected) < 0.02


def test_blended_faces_cast_partial_shadows(white):
    light = wd.DirectionalLight((1.0, 0.0, 1.0))
    _, alone = middle({"ground": square(0.0, 2.0, OPAQUE)}, light)
    pane = square(2.0, 1.5, BLEND)
    pane.apply_translation((2.6, 0.0, 0.0))
    parts = {"ground": square(0.0, 2.0, OPAQUE), "pane": pane}
    _, shaded = middle(parts, light)
    # Each pixel may have an error of up to the tolerance of 0.1. A pixel is not divided further if its subpixel cells
    # agree by chance. Such errors often have the same sign, and do not cancel in the mean.
    assert abs(shaded.mean() / alone.mean() - (1.0 - ALPHA)) < 0.06
    assert alone.mean() < white
    sky = wd.Environment.clear_sky((0.0, 0.2, 1.0))
    _, open_sky = middle({"ground": square(0.0, 2.0, OPAQUE)}, sky)
    cover = {"ground": square(0.0, 2.0, OPAQUE), "pane": square(0.5, 1.9, BLEND)}
    _, below = middle(cover, sky)
    # The blended pane covers nearly the whole sky above the points below it, but the sky is visible through the pane.
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


def test_a_part_without_texture_coordinates_has_the_alpha_of_its_factor_beside_one_with_them(white):
    texels = np.full((8, 8, 4), 255, np.uint8)
    texels[[0, -1], :, 3] = 0
    material = PBRMaterial(name="cut", baseColorTexture=Image.fromarray(texels), alphaMode="MASK", alphaCutoff=0.5)
    bare = square(0.0, 2.0, material)
    bare.visual = TextureVisuals(material=material)
    other = square(-3.0, 1e-3, material)
    other.apply_translation((-1.5, 1.5, 0.0))
    for parts in ({"a": bare, "b": other}, {"b": other, "a": bare}):
        with pytest.warns(WarpdiffWarning, match="texture without texture coordinates of 'cut'"):
            coverage, luminance = middle(parts)
        np.testing.assert_allclose(coverage, 1.0, rtol=1e-6)
        np.testing.assert_allclose(luminance, white, rtol=1e-3)


def test_a_part_without_a_material_is_opaque_beside_transparent_parts(white):
    bare = square(0.0, 2.0, None)
    bare.visual = trimesh.visual.ColorVisuals(bare)
    other = square(-3.0, 1e-3, BLEND)
    other.apply_translation((-1.5, 1.5, 0.0))
    coverage, luminance = middle({"a": bare, "b": other}, tangents="x")
    np.testing.assert_allclose(coverage, 1.0, rtol=1e-6)
    np.testing.assert_allclose(luminance, white, rtol=1e-3)


def stencil():
    """Return an image of 3 × 4 pixels with opaque and transparent pixels in different colours, as a data URI."""
    texels = np.zeros((4, 3, 4), np.uint8)
    texels[..., :3] = np.arange(36).reshape(4, 3, 3) * 7
    texels[..., 3] = 255 * (np.array([[1, 0, 1], [0, 0, 1], [1, 1, 0], [0, 1, 0]]))
    stream = io.BytesIO()
    Image.fromarray(texels).save(stream, "png")
    return texels, "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


@pytest.mark.parametrize("wraps", [(10497, 33071), (33648, 10497), (33071, 33648)], ids=str)
@pytest.mark.parametrize(
    ("offset", "scale", "rotation"), [((0.3, -40.2), (2.0, 1.5), 0.4), ((-1.1, 0.2), (-1.0, 3.0), -2.0)], ids=str
)
def test_cut_outs_follow_texture_transforms_sets_and_continuations(tmp_path, wraps, offset, scale, rotation):
    """Cut-outs must follow KHR_texture_transform and the wrap modes of samplers, with v counted downwards."""
    file = square_file({"TEXCOORD_1": SQUARE_UVS, "TEXCOORD_0": 0.0 * SQUARE_UVS}, material=0)
    texels, uri = stencil()
    transform = {"offset": offset, "scale": scale, "rotation": rotation}
    file.material(
        texture={"texCoord": 1, "extensions": {"KHR_texture_transform": transform}}, alphaMode="MASK", alphaCutoff=0.5
    )
    file.tree["images"], file.tree["samplers"] = [{"uri": uri}], [{"wrapS": wraps[0], "wrapT": wraps[1]}]
    file.tree["textures"] = [{"source": 0, "sampler": 0}]
    view = wd.View.orthographic((0.5, 0.5, 5.0), (0.5, 0.5, 0.0), extent_y=1.0, width=40, height=40)
    image = wd.shade(
        file.write(tmp_path / "a.gltf"), wd.gratings.sinusoidal(2.0, 0.05), wd.DirectionalLight((0.3, 0.0, 1.0)), view,
        coherence=SHORT, tolerance=0.1, footprint=False, layers=["albedo"], pigment=1.0,
    )  # fmt: skip
    down, right = (np.mgrid[:40, :40] + 0.5) / 40.0
    u, v = scale[0] * right, scale[1] * down
    cosine, sine = np.cos(rotation), np.sin(rotation)
    u, v = cosine * u + sine * v + offset[0], -sine * u + cosine * v + offset[1]

    def texel(value, size, wrap):
        if wrap == 33071:
            value = np.clip(value, 0.0, 1.0)
        elif wrap == 33648:
            value = 1.0 - np.abs(value % 2.0 - 1.0)
        else:
            value = value % 1.0
        return value * size - 0.5

    def inside(index, size, wrap):
        return index % size if wrap == 10497 else np.clip(index, 0, size - 1)

    x, y = texel(u, 3, wraps[0]), texel(v, 4, wraps[1])
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    linear = np.concatenate([srgb_decode(texels[..., :3] / 255.0), texels[..., 3:] / 255.0], axis=-1)
    expected = sum(
        (np.where(i, y - row, 1 - y + row) * np.where(j, x - column, 1 - x + column))[..., None]
        * linear[inside(row + i, 4, wraps[1]), inside(column + j, 3, wraps[0])]
        for i in (0, 1)
        for j in (0, 1)
    )
    clear = np.abs(expected[..., 3] - 0.5) > 1e-3
    assert 300 < np.sum(expected[..., 3] >= 0.5) < 1300
    np.testing.assert_array_equal(image.mask[clear], expected[clear, 3] > 0.5)
    visible = clear & image.mask
    np.testing.assert_allclose(image.layers["albedo"][visible], expected[visible, :3], atol=1e-3)
