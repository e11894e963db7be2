"""Read damaged files in a separate process: ``python damaged_bytes.py meshes SEED COUNT SECONDS``, in an empty folder.

The process prints the number of damaged files and a list of failures. If it crashes or hangs, the file that caused it
remains in the folder.
"""

import contextlib
import copy
import gzip
import json
import re
import signal
import struct
import sys
import time
import warnings
import zipfile
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the abbreviation of its manual)
import trimesh
from gltf_files import BUFFER, SQUARE, SQUARE_UVS, GltfFile, gltf, square_file
from PIL import Image

import warpdiff as wd
from warpdiff.scene.mesh_import import prepare_surface

MOST_BYTES = 4 << 30
MOST_S = 20
EXTREME_VALUES = [
    None, True, -1, 0, 1, 2, 3, 255, 2**31, 2**53, 10**30, 0.5, 1e300, float("nan"), float("inf"), "", "x", "../a.bin",
    "data:;base64,AAAA", "data:x", "\0", [], [0], [0, 0], [[]], {}, {"index": 0}, {"count": 10**9},
]  # fmt: skip
EXTREME_NUMBERS = [
    b"nan", b"inf", b"-1", b"0", b"1e308", b"1e-308", b"2147483648", b"99999999999999999999", b"/etc/passwd",
]  # fmt: skip


def scans():
    """Write valid height fields in all supported file formats, and return their paths."""
    waves = np.add.outer(np.sin(np.arange(9.0)), np.cos(np.arange(12.0)))
    for dtype in ("float64", "float32", "uint8", ">i4"):
        np.save(Path(f"scan-{dtype.strip('>')}.npy"), (waves * 50.0 + 100.0).astype(dtype))
    wd.HeightField.of_known_scale(waves, 0.1).save("scan.npz")
    for suffix, kind in (("png", "uint8"), ("png", "uint16"), ("tif", "uint16"), ("tif", "float"), ("exr", "float")):
        output = oiio.ImageOutput.create(name := f"scan-{kind}.{suffix}")
        output.open(name, oiio.ImageSpec(12, 9, 1, kind))
        output.write_image(((waves + 3.0) / 6.0).astype(np.float32)[:, :, None])
        output.close()
    exports()
    return sorted(Path().iterdir())


def exports():
    """Write height fields as instruments export them, as texts and .x3p files."""
    rng = np.random.default_rng(1)
    heights = np.round(20.0 * rng.normal(size=(7, 6)), 2)
    rows = [" ".join(map(str, row)) for row in heights]
    header = "# Channel: Z\n# Width: 1.2 µm\n# Height: 1400 nm\n# Value units: nm\n"
    Path("export-gwyddion.txt").write_text(header + "\n".join(rows), encoding="utf-8")
    Path("export-two.txt").write_text((header + "\n".join(rows) + "\n") * 2, encoding="utf-16")
    Path("export-german.csv").write_text(
        "Breite;1,2;µm\nHöhe;1,4;µm\nEinheit;nm\n" + "\n".join(rows).replace(" ", ";").replace(".", ","),
        encoding="cp1252",
    )
    points = (f"{0.2 * i:.1f},{0.2 * j:.1f},{1e-3 * z:.5f}" for (j, i), z in np.ndenumerate(heights))
    Path("export-points.xyz").write_text("x [um],y [um],z [um]\n" + "\n".join(points), encoding="utf-8")
    Path("export-small.txt.gz").write_bytes(gzip.compress((header + "\n".join(rows)).encode()))
    for name, data in (("export-list.x3p", True), ("export-binary.x3p", False)):
        with zipfile.ZipFile(name, "w", zipfile.ZIP_STORED if data else zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("main.xml", x3p_header(1e-9 * heights if data else None))
            if not data:
                archive.writestr("bindata/data.bin", (1e-9 * heights).tobytes())
                archive.writestr("bindata/valid.bin", np.packbits(heights > -50.0, bitorder="little").tobytes())


def x3p_header(heights):
    """Return the XML header of an .x3p file of 6 × 7 samples.

    With ``heights``, the header contains these heights. Otherwise it refers to another file of the archive.
    """
    link = "<PointDataLink>bindata/data.bin</PointDataLink><ValidPointsLink>bindata/valid.bin</ValidPointsLink>"
    data = f"<DataLink>{link}</DataLink>"
    if heights is not None:
        data = "<DataList>" + "".join(f"<Datum>{z:.3e}</Datum>" for z in heights.ravel()) + "</DataList>"
    axis = "<{0}><AxisType>I</AxisType><DataType>D</DataType><Increment>2e-7</Increment></{0}>"
    return (
        '<?xml version="1.0"?><p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2"><Record1><FeatureType>SUR'
        f"</FeatureType><Axes>{axis.format('CX')}{axis.format('CY')}<CZ><AxisType>A</AxisType><DataType>D</DataType></CZ>"
        "</Axes></Record1><Record3><MatrixDimension><SizeX>6</SizeX><SizeY>7</SizeY><SizeZ>1</SizeZ></MatrixDimension>"
        f"{data}</Record3></p:ISO5436_2>"
    )


def meshes():
    """Write valid meshes in all supported file formats, with their texture and buffer files, and return all paths."""
    disc = wd.meshes.disc(segments=4, rings=1)
    for suffix in ("ply", "stl", "glb", "off"):
        disc.export(f"mesh.{suffix}")
    (Path("ascii.ply")).write_bytes(trimesh.exchange.ply.export_ply(disc, encoding="ascii"))
    (Path("ascii.stl")).write_text(trimesh.exchange.stl.export_stl_ascii(disc))
    Image.new("RGB", (3, 2), (200, 30, 30)).save("paint.png")
    Path("paint.mtl").write_text("newmtl paint\nKd 0.5 0.25 1.0\nmap_Kd paint.png\n")
    Path("buffer.bin").write_bytes(BUFFER)
    Path("mesh.gltf").write_text(gltf(buffer="buffer.bin"))
    Path("mesh.obj").write_text(
        "mtllib paint.mtl\nusemtl paint\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n"
        "f 1/1/1 2/2/1 3/3/1\n"
    )
    return sorted(Path().iterdir())


def gltf_scenes():
    """Write valid glTF files that use many parts of the format, and return their paths."""
    file = square_file({"COLOR_0": np.ones((4, 4), "<f4"), "TANGENT": np.tile(np.array([1, 0, 0, 1], "<f4"), (4, 1))})
    file.material(
        texture={"texCoord": 0, "extensions": {"KHR_texture_transform": {"rotation": 0.5, "scale": [2, 1]}}},
        name="paint", alphaMode="MASK", normalTexture={"index": 0}, emissiveFactor=[0.5, 0, 1],
    )  # fmt: skip
    primitive = file.tree["meshes"][0]["primitives"][0]
    primitive |= {"material": 0, "mode": 5, "targets": [{"POSITION": primitive["attributes"]["NORMAL"]}]}
    file.tree["meshes"][0] |= {"name": "body", "weights": [0.5]}
    position = primitive["attributes"]["POSITION"]
    indices = {"bufferView": file.view(bytes([1, 2])), "componentType": 5121}
    values = {"bufferView": file.view(SQUARE[:2].tobytes())}
    file.tree["accessors"][position]["sparse"] = {"count": 2, "indices": indices, "values": values}
    file.tree["samplers"] = [{"wrapS": 33071, "wrapT": 10497}]
    file.tree["textures"][0]["sampler"] = 0
    instances = {"TRANSLATION": file.accessor(SQUARE), "SCALE": file.accessor(SQUARE + np.float32(1.0))}
    file.tree["nodes"] = [
        {"children": [1, 2], "rotation": [0, 0, 0, 1], "name": "top"},
        {"mesh": 0, "matrix": np.eye(4).ravel().tolist(), "weights": [0.25]},
        {"mesh": 0, "scale": [1, -1, 1], "extensions": {"EXT_mesh_gpu_instancing": {"attributes": instances}}},
    ]
    file.write(Path("scene-text.gltf"))
    file.write(Path("scene-binary.glb"))
    plain = GltfFile()
    plain.primitive({"POSITION": SQUARE, "TEXCOORD_0": SQUARE_UVS})
    Path("scene-plain.bin").write_bytes(plain.blob)
    plain.tree["buffers"] = [{"byteLength": len(plain.blob), "uri": "scene-plain.bin"}]
    plain.write(Path("scene-plain.gltf"))
    return sorted(Path().iterdir())


def damaged_gltf(content, rng):
    """Return the content of a glTF file with random damage: of its bytes, or of one to three values of its JSON."""
    if rng.random() < 0.3 or content[:1] not in b"{g" or not content:
        return mutant(content, rng)
    is_binary = content[:4] == b"glTF"
    size = int.from_bytes(content[12:16], "little")
    tree = json.loads(content[20 : 20 + size] if is_binary else content)
    for _ in range(rng.integers(1, 4)):
        places = list(containers(tree))
        container = places[rng.integers(len(places))]
        names = list(container) if isinstance(container, dict) else list(range(len(container)))
        name = names[rng.integers(len(names))]
        match rng.integers(4):
            case 0:
                del container[name]
            case 1:
                container[name] = copy.deepcopy(places[rng.integers(len(places))])
            case _:
                container[name] = copy.deepcopy(EXTREME_VALUES[rng.integers(len(EXTREME_VALUES))])
        if not tree:
            break
    text = json.dumps(tree).encode()
    if not is_binary:
        return text
    rest = content[20 + size :]
    header = b"glTF" + struct.pack("<IIII", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    return header + text + rest


def containers(tree):
    """Yield all objects and lists of a JSON value that are not empty."""
    if isinstance(tree, (dict, list)) and tree:
        yield tree
        for value in tree.values() if isinstance(tree, dict) else tree:
            yield from containers(value)


def read_scan(path):
    """Load a height-field file, and check that all heights not marked as missing are finite."""
    integers = re.search("uint|i4", path.name)
    has_pitch = path.suffix == ".npz" or path.name.startswith("export")
    heightfield = wd.HeightField.load(
        path, pitch_um=None if has_pitch else 0.1, height_range_um=0.3 if integers else None
    )
    assert np.isfinite(heightfield.heights_um[~heightfield.missing]).all()


def read_mesh(path):
    """Load the mesh that a file belongs to, and check that all vertices of its prepared surface are finite."""
    beside = {".mtl": "mesh.obj", ".png": "mesh.obj", ".bin": "mesh.gltf"}
    surface = prepare_surface(Path(beside.get(path.suffix, path)))
    assert np.isfinite(surface.vertices).all()


def read_gltf(path):
    """Load the scene that a file belongs to, once with a tangent given by the caller, and once with the tangents of the
    file.
    """
    for tangents in ((1.0, 0.2, 0.1), None):
        surface = prepare_surface(path.with_suffix(".gltf") if path.suffix == ".bin" else path, tangents=tangents)
        assert np.isfinite(surface.vertices).all()
        assert np.isfinite(surface.tangents).all()


def mutant(content, rng):
    """Return the content of a file with one to three random kinds of damage."""
    content = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        size = max(len(content), 1)
        at, length = int(rng.integers(size)), int(rng.integers(1, 17))
        match rng.integers(7):
            case 0:
                del content[at:]
            case 1:
                del content[at : at + length]
            case 2:
                content[at:at] = rng.bytes(length)
            case 3:
                content[at : at + length] = bytes([int(rng.choice([0, 255, 127]))]) * length
            case 4 if content:
                content[at % len(content)] ^= 1 << int(rng.integers(8))
            case 5:
                content[at:at] = content[: int(rng.integers(size + 1))]
            case _:
                numbers = list(re.finditer(rb"[-+.\deE]+", bytes(content)))
                if numbers:
                    begin, end = numbers[rng.integers(len(numbers))].span()
                    content[begin:end] = EXTREME_NUMBERS[rng.integers(len(EXTREME_NUMBERS))]
    return bytes(content)


def watch(folder, wrong):
    """Record network access, subprocesses and files opened outside the folder; allow Python's modules and ``/proc``."""
    allowed = [folder, *(Path(name).resolve() for name in {sys.prefix, sys.base_prefix, *sys.path}), Path("/proc")]

    def hook(event, arguments):
        if event.startswith(("socket.", "urllib.", "subprocess.", "os.system")):
            wrong.append(event)
        if event == "open" and isinstance(arguments[0], (str, bytes)):
            path = Path(str(arguments[0])).resolve()
            if not any(path.is_relative_to(parent) for parent in allowed):
                wrong.append(f"opens {path}")

    sys.addaudithook(hook)


def main(kind, seed, count, seconds, folder):
    """Read at most ``count`` damaged files within at most ``seconds`` seconds, and print the failures as JSON."""
    import resource

    files, read, damage = {
        "scans": (scans, read_scan, mutant), "meshes": (meshes, read_mesh, mutant),
        "gltf": (gltf_scenes, read_gltf, damaged_gltf),
    }[kind]  # fmt: skip
    sound = {path: path.read_bytes() for path in files()}
    warnings.simplefilter("ignore")
    for path in sound:
        # The reader refuses meshes in formats without texture coordinates, but only after it has read the whole file.
        with contextlib.suppress(ValueError):
            read(path)
    wrong, tried, end = [], 0, time.monotonic() + seconds
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    watch(Path(folder), wrong)
    while tried < count and time.monotonic() < end and len(wrong) < 10:
        rng = np.random.default_rng([seed, tried])
        path = list(sound)[rng.integers(len(sound))]
        path.write_bytes(damage(sound[path], rng))
        tried += 1
        # The alarm signal ends this process if the reader hangs.
        signal.alarm(MOST_S)
        try:
            read(path)
        except (ValueError, OSError, MemoryError) as error:
            if kind == "gltf" and not isinstance(error, ValueError):
                wrong.append(f"{tried - 1}: {path}: {error!r}")
            # The error of a mesh names the mesh file, even if its texture or buffer file is damaged. The error of an
            # export whose size was damaged names the argument that is missing.
            is_named = any(file.stem in str(error) for file in sound)
            if not is_named and not (path.stem.startswith("export") and "extent_um" in str(error)):
                wrong.append(f"{tried - 1}: {path}: {error!r}")
        except Exception as error:
            wrong.append(f"{tried - 1}: {path}: {error!r}")
        signal.alarm(0)
        path.write_bytes(sound[path])
    sys.stdout.write(json.dumps([tried, wrong]))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]), str(Path.cwd().resolve()))
