"""Writes the valid files in ``tests/corpus`` from which fuzzing starts: ``python tests/fuzz_corpus.py``.

Each folder has the files of one reader of ``bench/dev/fuzz_targets.py``. A file has few samples, so that a reader needs
little time for it. Names that begin with "export" are files that state their own size and unit.
"""

import datetime
import gzip
import json
import math
import os
import sys
import zipfile
from pathlib import Path

import gdstk
import numpy as np
import OpenImageIO as oiio  # noqa: N813 (the abbreviation of its manual)
import trimesh
from gltf_files import BUFFER, SQUARE, SQUARE_UVS, GltfFile, gltf, square_file
from PIL import Image

import warpdiff as wd
from warpdiff.apps.viewer.controls import controls, defaults

CORPUS = Path(__file__).with_name("corpus")
WAVES = np.add.outer(np.sin(np.arange(5.0)), np.cos(np.arange(6.0)))
COHERENCE = wd.Coherence(sigma_um=1.0)


def arrays():
    """Write height fields as NumPy arrays and as a file of `HeightField.save`."""
    for dtype in ("float64", "float32", "uint8", "uint16"):
        np.save(f"npy/scan-{dtype}.npy", (WAVES * 50.0 + 100.0).astype(dtype))
    wd.HeightField.of_known_scale(WAVES, 0.1).save("npz/scan.npz")
    wd.HeightField.of_known_scale(np.where(WAVES > 1.0, np.nan, WAVES), 0.1).filled().save("npz/filled.npz")


def image(path, kind, channels=1):
    """Write the test heights ``WAVES`` as an image of one sample type."""
    output = oiio.ImageOutput.create(path)
    output.open(path, oiio.ImageSpec(6, 5, channels, kind))
    output.write_image(np.repeat(((WAVES + 3.0) / 6.0).astype(np.float32)[:, :, None], channels, axis=2))
    output.close()


def images():
    """Write grey images of heights, images of environments, and a picture that `Image.save` writes."""
    for suffix, kind in (("png", "uint8"), ("png", "uint16"), ("tif", "uint16"), ("tif", "float"), ("exr", "float")):
        image(f"image/scan-{kind}.{suffix}", kind)
    for suffix in ("exr", "hdr"):
        image(f"environment/sky.{suffix}", "float", 3)
    wd.reflectance_map(wd.gratings.sinusoidal(1.0, 0.1), (0, 0, 1), size=4, coherence=COHERENCE, tolerance=0.1).save(
        "picture/map.exr"
    )


def exports():
    """Write height fields as instruments export them, as texts and .x3p files."""
    rng = np.random.default_rng(1)
    heights = np.round(20.0 * rng.normal(size=(7, 6)), 2)
    rows = [" ".join(map(str, row)) for row in heights]
    header = "# Channel: Z\n# Width: 1.2 µm\n# Height: 1400 nm\n# Value units: nm\n"
    Path("text/export-gwyddion.txt").write_text(header + "\n".join(rows), encoding="utf-8")
    Path("text/export-two.txt").write_text((header + "\n".join(rows) + "\n") * 2, encoding="utf-16")
    Path("text/export-german.csv").write_text(
        "Breite;1,2;µm\nHöhe;1,4;µm\nEinheit;nm\n" + "\n".join(rows).replace(" ", ";").replace(".", ","),
        encoding="cp1252",
    )
    points = (f"{0.2 * i:.1f},{0.2 * j:.1f},{1e-3 * z:.5f}" for (j, i), z in np.ndenumerate(heights))
    Path("text/export-points.xyz").write_text("x [um],y [um],z [um]\n" + "\n".join(points), encoding="utf-8")
    Path("text/export-small.txt.gz").write_bytes(gzip.compress((header + "\n".join(rows)).encode(), mtime=0))
    for name, data in (("x3p/export-list.x3p", True), ("x3p/export-binary.x3p", False)):
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
    """Write meshes in all formats, with a texture, a material library and a buffer."""
    disc = wd.meshes.disc(segments=4, rings=1)
    for suffix in ("ply", "stl", "off"):
        disc.export(f"mesh/mesh.{suffix}")
    disc.export("gltf/mesh.glb")
    Path("mesh/ascii.ply").write_bytes(trimesh.exchange.ply.export_ply(disc, encoding="ascii"))
    Path("mesh/ascii.stl").write_text(trimesh.exchange.stl.export_stl_ascii(disc), encoding="utf-8")
    Image.new("RGB", (3, 2), (200, 30, 30)).save("mesh/paint.png")
    Image.new("RGB", (3, 2), (200, 30, 30)).save("gltf/paint.png")
    Path("mesh/paint.mtl").write_text("newmtl paint\nKd 0.5 0.25 1.0\nmap_Kd paint.png\n", encoding="utf-8")
    Path("gltf/buffer.bin").write_bytes(BUFFER)
    Path("gltf/buffer.gltf").write_text(gltf(buffer="buffer.bin"), encoding="utf-8")
    Path("mesh/mesh.obj").write_text(
        "mtllib paint.mtl\nusemtl paint\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n"
        "f 1/1/1 2/2/1 3/3/1\n", encoding="utf-8",
    )  # fmt: skip


def gltf_scenes():
    """Write glTF files that use many parts of the format."""
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
    file.write(Path("gltf/scene-text.gltf"))
    file.write(Path("gltf/scene-binary.glb"))
    plain = GltfFile()
    plain.primitive({"POSITION": SQUARE, "TEXCOORD_0": SQUARE_UVS})
    Path("gltf/scene-plain.bin").write_bytes(plain.blob)
    plain.tree["buffers"] = [{"byteLength": len(plain.blob), "uri": "scene-plain.bin"}]
    plain.write(Path("gltf/scene-plain.gltf"))


def tables():
    """Write files of materials, measurements, cameras, plans (methods of computation) and exported colours."""
    head = "REFERENCES: |\n    A. Author, 2000\nDATA:\n"
    files = {
        "index/table.yml": head + "  - type: tabulated nk\n    data: |\n        0.38 1.5 0.1\n        0.78 1.4 0.2\n",
        "index/formula.yml": head
        + "  - type: formula 1\n    wavelength_range: 0.3 2.5\n    coefficients: 0 1.03 0.006 0.23 0.02 1.01 103.5\n",
        "index/blocks.csv": "wl,n\n0.38,1.53\n0.78,1.51\nwl,k\n0.38,0.1\n0.78,0.2\n",
        "index/columns.csv": "wavelength (nm);n;k\n380;1.53;0.1\n780;1.51;0.2\n",
        "spectrum/light.csv": "nm,power\n380,0.1\n580,1\n780,0.2\n",
        "camera/path.csv": "eye_x,eye_y,eye_z,target_x,target_y,target_z,fov_y_deg\n0,0,3,0,0,0,30\n1,0,3,0,0,0,40\n",
        "curve/curve.csv": "Wavelength (nm);R;error\n400;0,1;0,01\n500;0,2;0,01\n600;0,3;0,02\n",
        "curve/angles.txt": "# scan\nangle_deg R\n-10 0.1\n0 0.5\n10 0.2\n20 0.1\n",
    }
    for name, text in files.items():
        Path(name).write_text(text, encoding="utf-8")
    grating = wd.gratings.sinusoidal(1.0, 0.1)
    directions = (0.0, 0.0, 1.0), (0.1, 0.0, 1.0)
    wd.order_efficiencies(grating, directions[0], [500.0]).save("measured/orders.csv")
    wd.reflectance_spectra(grating, *directions, [500.0, 600.0], coherence=COHERENCE).save("measured/spectra.csv")
    wd.GratingMap(grating, turn_deg=[[0.0, 30.0], [60.0, 90.0]], depth_scale=0.5).save("dots/dots.csv")
    wd.plan(grating, *directions, coherence=COHERENCE).save("plan/plan.json")
    wd.bake(wd.gratings.sinusoidal(1.0, 0.02), coherence=COHERENCE, delta_e=10.0).save("lobes/lobes.npz")
    wd.bake_spectrum(grating, coherence=COHERENCE, size=16, tolerance=0.1).save("spectra/spectrum.npz")


def layouts():
    """Write a GDSII layout of a height field, and one with paths, labels, properties and arrays of another cell."""
    wd.gratings.lamellar(2.0, 0.1, samples=8).save("gds/foil.gds")
    inner = gdstk.Cell("INNER")
    inner.add(gdstk.rectangle((0, 0), (1, 2), layer=1), gdstk.FlexPath([(2, 0), (2, 3), (4, 3)], 0.5, layer=2))
    inner.paths[0].simple_path = True
    top = gdstk.Cell("TOP")
    top.add(gdstk.boolean(gdstk.rectangle((0, 0), (3, 3)), gdstk.rectangle((1, 1), (2, 2)), "not", layer=3)[0])
    top.add(gdstk.Reference(inner, (9, 0), columns=2, rows=3, spacing=(5, 4)))
    top.add(gdstk.Reference(inner, (0, 30), rotation=math.pi / 2, magnification=2.0, x_reflection=True))
    top.add(gdstk.Label("text", (1, 1), layer=4))
    top.polygons[0].set_gds_property(1, "keyhole")
    library = gdstk.Library("FUZZ")
    library.add(inner, top)
    library.write_gds("gds/cells.gds", timestamp=datetime.datetime(2000, 1, 1))


def messages():
    """Write messages that the page of the viewer sends."""
    draw = {
        "do": "draw", "generation": 1, "values": defaults(controls()), "aspect": 1.5, "moving": False,
        "probe": [0.5, 0.5], "camera": None,
    }  # fmt: skip
    camera = {"eye": [0, 1, 3], "target": [0, 0, 0], "up": [0, 1, 0], "fov_y_deg": 30.0}
    for name, message in {
        "draw": draw, "camera": draw | {"camera": camera, "moving": True, "generation": 7}, "shown": {"do": "shown"},
        "save": {"do": "save", "as": "png"},
    }.items():  # fmt: skip
        Path(f"message/{name}.json").write_text(json.dumps(message), encoding="utf-8")


def main():
    """Write all files from which fuzzing starts."""
    sys.path.insert(0, str(CORPUS.parents[1]))
    from bench.dev.fuzz_targets import TARGETS

    for target in TARGETS:
        target.folder.mkdir(parents=True, exist_ok=True)
    os.chdir(CORPUS)
    for write in (arrays, images, exports, meshes, gltf_scenes, tables, layouts, messages):
        write()


if __name__ == "__main__":
    main()
