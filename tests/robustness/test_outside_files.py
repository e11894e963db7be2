"""What a mesh file names outside of its own folder, or elsewhere on the net, is not opened."""

import subprocess
import sys
import tempfile

import pytest
from gltf_files import BUFFER, gltf
from PIL import Image

# In a process of its own, for an audit hook cannot be taken off. Modules are read before it is set.
READER = """
import pathlib, socket, sys, warnings
import numpy, PIL.Image, trimesh
from warpdiff.scene.mesh_import import prepare_surface

PIL.Image.init()
folder = watched = pathlib.Path("/nowhere")
def watch(event, arguments):
    if event.startswith("socket.") or event.startswith("urllib."):
        print("net", event)
    if event == "open" and isinstance(arguments[0], str):
        path = pathlib.Path(arguments[0]).resolve()
        if path.is_relative_to(watched) and not path.is_relative_to(folder):
            print("outside", path)
        elif path.is_relative_to(folder):
            print("inside", path.name)
sys.addaudithook(watch)
warnings.simplefilter("ignore")
for line in sys.stdin:
    folder, watched = (pathlib.Path(part).resolve() for part in line.rstrip().split("|"))
    try:
        surface = prepare_surface(next(folder.glob("mesh.*")))
    except ValueError as error:
        print("refused", error)
    else:
        print("base colour", surface.has_base_colour)
    print("end", flush=True)
"""
OBJ = """mtllib {library}
usemtl paint
v 0 0 0
v 1 0 0
v 0 1 0
vt 0 0
vt 1 0
vt 0 1
f 1/1 2/2 3/3
"""
# Nobody listens there.
URL = "http://127.0.0.1:9/paint.png"


def material(texture):
    return f"newmtl paint\nmap_Kd {texture}\n"


@pytest.fixture
def folders(tmp_path):
    """A mesh's folder, and the one about it, which holds a library, a texture and a buffer as well."""
    folder = tmp_path / "mesh"
    folder.mkdir()
    (tmp_path / "outside.mtl").write_text(material("paint.png"))
    (tmp_path / "outside.bin").write_bytes(BUFFER)
    Image.new("RGB", (2, 3), (200, 30, 30)).save(tmp_path / "outside.png")
    (folder / "link.png").symlink_to(tmp_path / "outside.png")
    return folder, tmp_path


@pytest.fixture(scope="module")
def load():
    """What a process says that reads the mesh in a folder; one process for all of them."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with (
        tempfile.TemporaryFile("w+") as errors,
        subprocess.Popen([sys.executable, "-c", READER], stderr=errors, **pipes) as reader,
    ):

        def read(folder, watched):
            print(folder, watched, sep="|", file=reader.stdin, flush=True)
            lines = list(iter(lambda: reader.stdout.readline().rstrip("\n") or "end", "end"))
            errors.seek(0)
            assert reader.poll() is None, errors.read()
            # The hook is at work: it saw the mesh itself.
            assert any(line.startswith("inside mesh.") for line in lines)
            return lines

        yield read


@pytest.mark.parametrize("kind", ["obj", "gltf"])
def test_what_lies_beside_the_mesh_is_read(folders, load, kind):
    folder, watched = folders
    Image.new("RGB", (2, 3), (200, 30, 30)).save(folder / "paint.png")
    (folder / "paint.mtl").write_text(material("paint.png"))
    (folder / f"mesh.{kind}").write_text(OBJ.format(library="paint.mtl") if kind == "obj" else gltf())
    lines = load(folder, watched)
    assert "inside paint.png" in lines
    assert lines[-1] == "base colour True"


@pytest.mark.permanent("streams that are closed, full or ASCII; no home; what a mesh names elsewhere")
@pytest.mark.parametrize(
    "files",
    [{"mesh.obj": OBJ.format(library="../outside.mtl")}, {"mesh.obj": OBJ.format(library="{watched}/outside.mtl")},
     {"mesh.obj": OBJ.format(library="a.mtl"), "a.mtl": material("../outside.png")},
     {"mesh.obj": OBJ.format(library="a.mtl"), "a.mtl": material("{watched}/outside.png")},
     {"mesh.obj": OBJ.format(library="a.mtl"), "a.mtl": material("link.png")},
     {"mesh.obj": OBJ.format(library="a.mtl"), "a.mtl": material(URL)}, {"mesh.obj": OBJ.format(library=URL)},
     {"mesh.gltf": gltf(image="../outside.png")}, {"mesh.gltf": gltf(image="{watched}/outside.png")},
     {"mesh.gltf": gltf(image="file://{watched}/outside.png")}, {"mesh.gltf": gltf(image=URL)},
     {"mesh.gltf": gltf(buffer="../outside.bin")}, {"mesh.gltf": gltf(buffer="file://{watched}/outside.bin")},
     {"mesh.gltf": gltf(buffer=URL)}],
    ids=[*("mtllib-above", "mtllib-absolute", "map-above", "map-absolute", "map-link", "map-url", "mtllib-url"),
         *("image-above", "image-absolute", "image-file", "image-url", "buffer-above", "buffer-file", "buffer-url")],
)  # fmt: skip
def test_nothing_outside_of_the_meshs_folder_is_opened(folders, load, files):
    folder, watched = folders
    for name, text in files.items():
        (folder / name).write_text(text.replace("{watched}", str(watched)))
    lines = load(folder, watched)
    assert not [line for line in lines if line.startswith(("outside", "net"))]
    assert lines[-1] == "base colour False" or lines[-1].startswith("refused")
