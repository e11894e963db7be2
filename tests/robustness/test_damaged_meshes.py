"""Damaged mesh files raise one error with their path. Textures that cannot be read cause a warning with their name."""

import warnings

import numpy as np
import pytest
import trimesh
from gltf_files import gltf
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial, SimpleMaterial

import warpdiff as wd
from warpdiff.core.wording import WarpdiffWarning
from warpdiff.scene.mesh_import import prepare_surface

CORNERS = np.array([[0.0, 0.0, 0.0], [1.25, 0.0, 0.0], [0.0, 1.5, 0.0]])
PARTS = "".join(
    f"o part{k}\nv 0 0 {k}\nv 1.25 0 {k}\nv 0 1.5 {k}\nvt 0 0\nvt 1 0\nvt 0 1\n"
    f"f {3 * k + 1}/1 {3 * k + 2}/2 {3 * k + 3}/3\n"
    for k in range(2)
)
OBJ = "mtllib paint.mtl\nusemtl paint\n" + PARTS.partition("o part1")[0]
MTL = "newmtl paint\nKd 0.5 0.25 1.0\nmap_Kd paint.png\n"


def damaged(folder, name="paint.png"):
    """Write a PNG file that ends in the middle of its pixel data."""
    noise = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    Image.fromarray(noise).save(folder / name)
    (folder / name).write_bytes((folder / name).read_bytes()[:6000])


def spoilt(folder, name="paint.png"):
    """Write a PNG file in which the name of the second pixel-data chunk is overwritten."""
    noise = np.random.default_rng(0).integers(0, 255, (256, 256, 3), dtype=np.uint8)
    Image.fromarray(noise).save(folder / name)
    first, second, rest = (folder / name).read_bytes().split(b"IDAT", 2)
    (folder / name).write_bytes(first + b"IDAT" + second + b"\0\0\0\0" + rest)


def no_image(folder):
    (folder / "paint.png").write_text("not an image")


def too_large(folder):
    # An image with one bit per pixel compresses to a small file. Pillow refuses images of twice its size limit.
    Image.new("1", (20_000, 20_000)).save(folder / "paint.png")


@pytest.mark.parametrize(
    ("make", "message"),
    [(lambda _: None, r"'.*mesh\.obj' refers to 'paint\.png', which is ignored: the file does not exist"),
     (no_image, r"refers to 'paint\.png', which is ignored: Pillow cannot read it as an image"),
     (too_large, r"refers to 'paint\.png', which is ignored: Image size .* exceeds limit"),
     (damaged, r"texture 'paint\.png' is damaged and ignored: .*truncated"),
     (spoilt, r"texture 'paint\.png' is damaged and ignored: broken PNG file")],
    ids=["missing", "no-image", "too-large", "cut-off", "broken"],
)  # fmt: skip
def test_an_unreadable_texture_is_reported_and_replaced_by_the_plain_colour(tmp_path, make, message):
    (tmp_path / "mesh.obj").write_text(OBJ)
    (tmp_path / "paint.mtl").write_text(MTL)
    make(tmp_path)
    with pytest.warns(WarpdiffWarning, match=message) as caught:
        surface = prepare_surface(tmp_path / "mesh.obj")
    assert len(caught) == 1
    assert not surface.is_textured
    np.testing.assert_allclose(surface.plain_colour, [0.2140, 0.0509, 1.0], atol=4e-3)


def test_a_refused_texture_and_a_missing_material_library_are_reported(tmp_path):
    folder = tmp_path / "mesh"
    folder.mkdir()
    (folder / "mesh.obj").write_text(OBJ)
    with pytest.warns(WarpdiffWarning, match=r"refers to 'paint\.mtl', which is ignored: the file does not exist"):
        prepare_surface(folder / "mesh.obj")
    Image.new("RGB", (2, 2)).save(tmp_path / "outside.png")
    (folder / "paint.mtl").write_text(MTL.replace("paint.png", "../outside.png"))
    with pytest.warns(WarpdiffWarning, match=r"'\.\./outside\.png'.* ignored: it lies outside the mesh's folder"):
        prepare_surface(folder / "mesh.obj")
    (folder / "paint.mtl").write_text(MTL.replace("map_Kd paint.png\n", ""))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        prepare_surface(folder / "mesh.obj")


def test_a_damaged_texture_of_gltf_is_reported(tmp_path):
    (tmp_path / "mesh.gltf").write_text(gltf(image="paint.png"))
    damaged(tmp_path)
    with pytest.warns(WarpdiffWarning, match=r"texture 'paint\.png' is damaged and ignored"):
        prepare_surface(tmp_path / "mesh.gltf")


def test_a_damaged_texture_inside_of_a_glb_is_reported(tmp_path):
    image = Image.new("RGB", (8, 8), "white")
    material = PBRMaterial(baseColorFactor=[255, 128, 0, 255], baseColorTexture=image)
    visual = TextureVisuals(uv=CORNERS[:, :2], material=material)
    mesh = trimesh.Trimesh(CORNERS, [[0, 1, 2]], visual=visual, process=False)
    data = trimesh.Scene(mesh).export(file_type="glb")
    begin = data.index(b"IDAT") + 6
    (tmp_path / "mesh.glb").write_bytes(data[:begin] + b"\xff" * 6 + data[begin + 6 :])
    with pytest.warns(WarpdiffWarning, match=r"texture 'an image in mesh\.glb' is damaged and ignored"):
        surface = prepare_surface(tmp_path / "mesh.glb")
    np.testing.assert_allclose(surface.plain_colour, [1.0, 128 / 255, 0.0], atol=1e-6)


def test_a_damaged_texture_of_a_mesh_in_memory_is_reported(tmp_path):
    spoilt(tmp_path)
    material = SimpleMaterial(image=Image.open(tmp_path / "paint.png"), diffuse=[255, 0, 0, 255])
    visual = TextureVisuals(uv=CORNERS[:, :2], material=material)
    mesh = trimesh.Trimesh(CORNERS, [[0, 1, 2]], visual=visual, process=False)
    for _ in range(2):
        with pytest.warns(WarpdiffWarning, match="texture 'an image' is damaged and ignored: broken PNG file"):
            surface = prepare_surface(mesh)
    np.testing.assert_allclose(surface.plain_colour, [1.0, 0.0, 0.0], atol=1e-6)


def test_an_obj_file_cut_off_anywhere_is_read_or_refused_by_its_path(tmp_path):
    path = tmp_path / "cut.obj"
    refusals = set()
    for size in range(1, len(PARTS)):
        path.write_text(PARTS[:size])
        try:
            prepare_surface(path)
        except ValueError as error:
            refusals.add(str(error))
    assert all(message.startswith("mesh") and str(path) in message for message in refusals)
    assert not any("matmul" in message for message in refusals)
    assert any("vertices of 3 coordinates" in message for message in refusals)


@pytest.mark.parametrize("suffix", ["ply", "stl", "glb", "off"])
def test_a_damaged_file_of_another_format_is_refused_by_its_path(tmp_path, suffix):
    path = tmp_path / f"cut.{suffix}"
    wd.meshes.tube(segments_along=12, segments_around=12).export(path)
    path.write_bytes(path.read_bytes()[:400])
    # If a package for text encodings is installed, trimesh reads a truncated binary STL file as text without triangles.
    # The message then refers to the missing triangles.
    message = (
        r"mesh must (be a file that trimesh can read, .*damaged, truncated|have triangles, got .* without any"
        r"|be a sound glTF file: .* may be truncated)"
    )
    with pytest.raises(ValueError, match=message) as refused:
        prepare_surface(path)
    assert str(path) in str(refused.value)
