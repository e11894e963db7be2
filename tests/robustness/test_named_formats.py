"""Only decoders of named formats read images and meshes, whatever the suffix and the content of a file."""

import io
import zipfile

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the abbreviation of its manual)
import pytest
import trimesh
from PIL import Image

import warpdiff as wd
from warpdiff.core import openimageio
from warpdiff.scene import mesh_images
from warpdiff.scene.mesh_import import prepare_surface

OBJ = "mtllib paint.mtl\nusemtl paint\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"


def image_file(path, kind, channels=1):
    """Write an image of 4 × 3 pixels by the writer of one of OpenImageIO's formats."""
    output = oiio.ImageOutput.create(kind)
    output.open(str(path), oiio.ImageSpec(4, 3, channels, "uint8"))
    output.write_image(np.full((3, 4, channels), 100, np.uint8))
    output.close()
    return path


def load(path):
    return wd.HeightField.load(path, pitch_um=0.1, height_range_um=0.3)


@pytest.mark.parametrize(("kind", "suffix"), [("png", ".png"), ("tiff", ".pic2"), ("bmp", ".tif"), ("targa", ".tga")])
def test_named_formats_are_read_by_suffix_or_content(tmp_path, kind, suffix):
    assert load(image_file(tmp_path / f"a{suffix}", kind)).shape == (3, 4)


@pytest.mark.parametrize(("kind", "suffix"), [("sgi", ".sgi"), ("sgi", ".png"), ("sgi", ".pic2"), ("png", ".rla")])
def test_other_formats_are_refused(tmp_path, kind, suffix):
    with pytest.raises(ValueError, match=r"cannot be read as|has a format that is not read"):
        load(image_file(tmp_path / f"a{suffix}", kind))


def test_environments_are_read_from_exr_and_hdr_files_only(tmp_path):
    with pytest.raises(ValueError, match="give an EXR or HDR file"):
        wd.Environment.load(image_file(tmp_path / "a.png", "png", 3))


def test_opening_an_image_leaves_the_settings_of_the_library_unchanged(tmp_path):
    path = image_file(tmp_path / "a.png", "png")
    with openimageio.in_use() as library:
        before = library.get_int_attribute("try_all_readers")
        openimageio.opened(library, path, ("png",)).close()
        assert library.get_int_attribute("try_all_readers") == before


def test_textures_of_other_formats_are_not_decoded(tmp_path, monkeypatch):
    (tmp_path / "mesh.obj").write_text(OBJ)
    (tmp_path / "paint.mtl").write_text("newmtl paint\nmap_Kd paint.sgi\n")
    Image.new("RGB", (2, 3), (200, 30, 30)).save(tmp_path / "paint.sgi")
    loaded = []
    monkeypatch.setattr("PIL.SgiImagePlugin.SgiImageFile.load", lambda _: loaded.append(True), raising=False)
    with pytest.warns(wd.WarpdiffWarning, match="paint.sgi"):
        surface = prepare_surface(tmp_path / "mesh.obj")
    assert surface.textures == (None,)
    assert not loaded


def test_an_image_of_a_trimesh_object_has_a_named_format_or_none():
    stream = io.BytesIO()
    Image.new("RGB", (2, 3), (200, 30, 30)).save(stream, "SGI")
    with pytest.warns(wd.WarpdiffWarning, match="the format SGI is not read"):
        assert mesh_images.linear_rgba(Image.open(stream)) is None
    assert mesh_images.linear_rgba(Image.new("RGB", (2, 3))).shape == (3, 2, 4)


@pytest.mark.parametrize("suffix", [".zip", ".tar.gz", ".xyz", ".step"])
def test_archives_and_other_mesh_formats_are_refused_before_they_are_read(tmp_path, suffix, monkeypatch):
    path = tmp_path / f"mesh{suffix}"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("mesh.obj", OBJ)
    monkeypatch.setattr(trimesh, "load_scene", lambda *_, **__: pytest.fail("trimesh has read the file"))
    with pytest.raises(ValueError, match=r"mesh must be a file of the formats \.gltf, .*convert it"):
        prepare_surface(path)
