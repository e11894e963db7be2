"""Files outside of a mesh's folder, and URLs, are not opened, even if the mesh file refers to them."""

import sys
import warnings
from pathlib import Path

import pytest
from gltf_files import BUFFER, gltf
from PIL import Image

from warpdiff.scene.mesh_import import prepare_surface

OBJ = "mtllib {}\nusemtl paint\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
MTL = "newmtl paint\nmap_Kd {}\n"
# Address of a picture on a port that no server uses.
URL = "http://127.0.0.1:9/paint.png"
# Contents of mesh folders, by file name. ``{above}`` is replaced by the path of the parent folder.
OUTSIDE = {
    "mtllib-above": {"mesh.obj": OBJ.format("../outside.mtl")},
    "mtllib-absolute": {"mesh.obj": OBJ.format("{above}/outside.mtl")},
    "map-above": {"mesh.obj": OBJ.format("a.mtl"), "a.mtl": MTL.format("../outside.png")},
    "map-absolute": {"mesh.obj": OBJ.format("a.mtl"), "a.mtl": MTL.format("{above}/outside.png")},
    "map-link": {"mesh.obj": OBJ.format("a.mtl"), "a.mtl": MTL.format("link.png")},
    "map-url": {"mesh.obj": OBJ.format("a.mtl"), "a.mtl": MTL.format(URL)},
    "mtllib-url": {"mesh.obj": OBJ.format(URL)},
    "image-above": {"mesh.gltf": gltf(image="../outside.png")},
    "image-absolute": {"mesh.gltf": gltf(image="{above}/outside.png")},
    "image-file": {"mesh.gltf": gltf(image="file://{above}/outside.png")},
    "image-url": {"mesh.gltf": gltf(image=URL)},
    "buffer-above": {"mesh.gltf": gltf(buffer="../outside.bin")},
    "buffer-file": {"mesh.gltf": gltf(buffer="file://{above}/outside.bin")},
    "buffer-url": {"mesh.gltf": gltf(buffer=URL)},
}
opened = None


def _watch(event, arguments):
    """Record opened files and network access, as an audit hook of Python.

    Audit hooks cannot be removed, so this one records only while ``opened`` is a list.
    """
    if opened is None:
        return
    if event.startswith(("socket.", "urllib.")):
        opened.append(event)
    elif event == "open" and isinstance(arguments[0], (str, bytes)):
        opened.append(Path(str(arguments[0])).resolve())


sys.addaudithook(_watch)


@pytest.fixture
def folder(tmp_path):
    """Return the folder of a mesh. The parent folder contains a material library, a texture and a buffer."""
    (tmp_path / "outside.mtl").write_text(MTL.format("paint.png"))
    (tmp_path / "outside.bin").write_bytes(BUFFER)
    Image.new("RGB", (2, 3), (200, 30, 30)).save(tmp_path / "outside.png")
    folder = tmp_path / "mesh"
    folder.mkdir()
    (folder / "link.png").symlink_to(tmp_path / "outside.png")
    return folder


def load(folder):
    """Return whether the mesh of a folder has a colour (None if it is refused), and the files that were opened."""
    global opened  # noqa: PLW0603 (an audit hook cannot be removed)
    opened = []
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            has_colour = prepare_surface(next(folder.glob("mesh.*"))).has_base_colour
    except ValueError:
        has_colour = None
    finally:
        events, opened = opened, None
    names = [path for path in events if isinstance(path, str) or path.is_relative_to(folder.parent)]
    # The list of opened files must contain the mesh file itself, which shows that the audit hook works.
    assert any(path.stem == "mesh" for path in names if isinstance(path, Path))
    return has_colour, names


@pytest.mark.parametrize("kind", ["obj", "gltf"])
def test_files_in_the_folder_of_the_mesh_are_read(folder, kind):
    Image.new("RGB", (2, 3), (200, 30, 30)).save(folder / "paint.png")
    (folder / "paint.mtl").write_text(MTL.format("paint.png"))
    (folder / f"mesh.{kind}").write_text(OBJ.format("paint.mtl") if kind == "obj" else gltf())
    has_colour, names = load(folder)
    assert folder / "paint.png" in names
    assert has_colour


@pytest.mark.permanent("closed, full or ASCII streams, no home folder, files that a mesh references")
@pytest.mark.parametrize("files", OUTSIDE.values(), ids=OUTSIDE)
def test_no_file_outside_of_the_meshs_folder_is_opened(folder, files):
    for name, text in files.items():
        (folder / name).write_text(text.replace("{above}", str(folder.parent)))
    has_colour, names = load(folder)
    assert all(isinstance(path, Path) and path.is_relative_to(folder) for path in names)
    assert not has_colour
