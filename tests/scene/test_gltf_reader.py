"""glTF files must be read completely: encodings of triangles, texture transforms, tangents, colours, and names."""

import base64
import json
import math
import sys

import numpy as np
import pytest
from gltf_files import SQUARE, SQUARE_UVS, TRIANGLES, UP, GltfFile, square_file
from PIL import Image

from warpdiff.core.wording import WarpdiffWarning
from warpdiff.scene.mesh_files import load
from warpdiff.scene.mesh_import import prepare_surface

# Data of the square's positions and texture coordinates after compression by DracoPy 2.2.0, in base64.
DRACO = (
    "RFJBQ08CAgEBAAAABAIAAgAAAR//AREB/wAAAgMJAgEAAAkDAAEAAgAAAAAAAIA/AACAPwAAAAAAAAAA"
    "AAAAAAAAgD8AAIA/AAEBAAMDASABIAMAIISYkAAAAAAA/z8AAAAAAAAAAAAAAAAAAAAAgD8O"
)
QUARTER = math.pi / 2


def corners(surface, digits=4):
    """Return position, normal, tangent and texture coordinates at corners of faces, one row per distinct corner."""
    world = surface.vertices * surface.radius + surface.centre
    rows = np.concatenate([world, surface.normals, surface.tangents, surface.uvs], axis=1)[surface.faces]
    return np.unique(np.round(rows.reshape(-1, 11), digits) + 0.0, axis=0)


def interleaved():
    """Return a glTF file of a square with all vertex attributes in one buffer view."""
    file = GltfFile()
    data = np.concatenate([SQUARE, UP, SQUARE_UVS], axis=1).astype("<f4")
    view = file.view(data.tobytes(), stride=32)
    offsets = {"POSITION": (SQUARE, 0), "NORMAL": (UP, 12), "TEXCOORD_0": (SQUARE_UVS, 24)}
    file.primitive({name: file.accessor(array, view=view, offset=at) for name, (array, at) in offsets.items()})
    return file


def sparse():
    """Return a glTF file of a square; a sparse accessor (list of changed elements of an array) states two corners."""
    file = GltfFile()
    position = file.accessor(np.where(np.arange(4)[:, None] % 2, SQUARE, 7).astype("<f4"))
    values = {"bufferView": file.view(SQUARE[[0, 2]].tobytes())}
    indices = {"bufferView": file.view(np.array([0, 2], "<u1").tobytes()), "componentType": 5121}
    file.tree["accessors"][position]["sparse"] = {"count": 2, "indices": indices, "values": values}
    file.primitive({"POSITION": position, "NORMAL": UP, "TEXCOORD_0": SQUARE_UVS})
    return file


def sparse_without_data():
    """Return a glTF file of a square whose corners, except (0, 0, 0), are in a sparse accessor without a base array."""
    file = GltfFile()
    accessor = {"componentType": 5126, "count": 4, "type": "VEC3"}
    values = {"bufferView": file.view(SQUARE[1:].tobytes())}
    indices = {"bufferView": file.view(np.array([1, 2, 3], "<u4").tobytes()), "componentType": 5125}
    accessor["sparse"] = {"count": 3, "indices": indices, "values": values}
    file.tree["accessors"].append(accessor)
    file.primitive({"POSITION": 0, "NORMAL": UP, "TEXCOORD_0": SQUARE_UVS})
    return file


def integer_uvs(dtype):
    """Return a glTF file of a square with texture coordinates as normalised integers."""
    file = GltfFile()
    whole = (SQUARE_UVS * np.iinfo(dtype).max).astype(dtype)
    file.primitive({"POSITION": SQUARE, "NORMAL": UP, "TEXCOORD_0": file.accessor(whole, normalized=True)})
    return file


def quantised(normalized):
    """Return a glTF file of a square with integer positions, which the scale of its node converts to mesh units."""
    file = GltfFile()
    whole = (SQUARE * 127).astype("<i1")
    position = file.accessor(whole, normalized=True) if normalized else file.accessor((SQUARE * 1000).astype("<u2"))
    normal = file.accessor((UP * 127).astype("<i1"), normalized=True)
    file.primitive({"POSITION": position, "NORMAL": normal, "TEXCOORD_0": SQUARE_UVS})
    file.tree["nodes"][0]["scale"] = [1.0 if normalized else 0.001] * 3
    file.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    return file


def changed(change):
    """Return a glTF file of a square, after the function ``change`` has changed its JSON."""
    file = square_file()
    change(file.tree)
    return file


def moved(tree):
    """Distribute the transform of a square over three nodes of a glTF file: a shift, a quaternion, and a matrix."""
    half = math.sqrt(0.5)
    tree["nodes"] = [
        {"children": [1], "translation": [5, 0, 0]},
        {"children": [2], "rotation": [0, 0, half, half]},
        {"mesh": 0, "matrix": [0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 5, 0, 1]},
    ]


def instanced():
    """Return a glTF file in which the extension EXT_mesh_gpu_instancing places one instance of a square."""
    file = square_file()
    attributes = {"TRANSLATION": file.accessor(np.array([[0, 0, 3]], "<f4"))}
    file.tree["nodes"][0] |= {
        "translation": [0, 0, -3], "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}},
    }  # fmt: skip
    file.tree["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    return file


ENCODINGS = {
    "strip": lambda: square_file(indices=np.array([3, 0, 2, 1], "<u1"), mode=5),
    "strip with repeated vertices": lambda: square_file(indices=np.array([3, 3, 3, 0, 2, 1, 1, 1], "<u1"), mode=5),
    "fan": lambda: square_file(indices=np.array([0, 1, 2, 3], "<u4"), mode=6),
    "fan without indices": lambda: square_file(indices=None, mode=6),
    "without indices": lambda: square_file(
        {"POSITION": SQUARE[TRIANGLES], "NORMAL": UP[[0] * 6], "TEXCOORD_0": SQUARE_UVS[TRIANGLES]}, None
    ),
    "interleaved": interleaved,
    "sparse": sparse,
    "sparse without data": sparse_without_data,
    "uint8 UVs": lambda: integer_uvs("<u1"),
    "uint16 UVs": lambda: integer_uvs("<u2"),
    "int16 UVs": lambda: integer_uvs("<i2"),
    "int8 positions": lambda: quantised(normalized=True),
    "uint16 positions": lambda: quantised(normalized=False),
    "no scenes": lambda: changed(lambda tree: (tree.pop("scenes"), tree.pop("scene"))),
    "nodes": lambda: changed(moved),
    "instance": instanced,
    "integers as floats": lambda: changed(lambda tree: tree["accessors"][0].update(count=4.0)),
}


@pytest.mark.parametrize("suffix", ["gltf", "glb"])
@pytest.mark.parametrize("make", ENCODINGS.values(), ids=ENCODINGS)
def test_all_encodings_of_a_square_are_equal(make, suffix, tmp_path):
    plain = prepare_surface(square_file().write(tmp_path / "plain.gltf"))
    read = prepare_surface(make().write(tmp_path / f"square.{suffix}"))
    for surface in (plain, read):
        assert len(surface.faces) == 2
        np.testing.assert_array_equal(surface.handedness, 1.0)
    np.testing.assert_allclose(corners(read), corners(plain), atol=2e-4)


def test_instances_are_placed_by_translation_rotation_and_scale(tmp_path):
    file = square_file()
    attributes = {
        "TRANSLATION": file.accessor(np.array([[0, 0, 0], [5, 0, 0], [0, 5, 0]], "<f4")),
        "ROTATION": file.accessor(np.array([[0, 0, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]], "<f4")),
        "SCALE": file.accessor(np.array([[1, 1, 1], [1, 1, 1], [2, -2, 2]], "<f4")),
    }
    file.tree["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    surface = prepare_surface(file.write(tmp_path / "a.gltf"))
    world = surface.vertices * surface.radius + surface.centre
    np.testing.assert_allclose(world[4:8], [[5, 0, 0], [4, 0, 0], [4, -1, 0], [5, -1, 0]], atol=1e-5)
    np.testing.assert_allclose(world[8:], [[0, 5, 0], [2, 5, 0], [2, 3, 0], [0, 3, 0]], atol=1e-5)
    np.testing.assert_allclose(surface.tangents[[0, 4, 8]], [[1, 0, 0], [-1, 0, 0], [1, 0, 0]], atol=1e-6)
    # The outer side of a mirrored instance must be the outer side of the original mesh. Only its texture is mirrored.
    np.testing.assert_allclose(surface.normals, UP[[0] * 12], atol=1e-6)
    np.testing.assert_array_equal(surface.handedness, [1] * 8 + [-1] * 4)
    assert surface.geometry_names == ("mesh 0",)


@pytest.mark.parametrize(
    ("transform", "tangent", "handedness", "corner"),
    [({"rotation": QUARTER}, (0, -1, 0), 1, (1, 1)), ({"rotation": -QUARTER}, (0, 1, 0), 1, (-1, 1)),
     ({"scale": [-1, 1], "offset": [1, 0]}, (-1, 0, 0), -1, (1, 0)), ({"scale": [1, -2]}, (1, 0, 0), -1, (0, 3)),
     ({"scale": [2, 3], "offset": [0.25, 0.5]}, (1, 0, 0), 1, (0.25, -2.5)),
     ({"offset": [0.5, 0.0], "texCoord": 1}, (0, -1, 0), 1, (1.5, 0))],
    ids=["quarter turn", "back", "mirror u", "mirror v", "scale and offset", "other set"],
)  # fmt: skip
@pytest.mark.parametrize("has_tangents", [False, True])
def test_texture_transforms_turn_coordinates_and_tangents(
    transform, tangent, handedness, corner, has_tangents, tmp_path
):
    turned = SQUARE_UVS[[1, 2, 3, 0]]
    along_x = np.tile(np.array([1, 0, 0, 1], "<f4"), (4, 1))
    tangents = {"TANGENT": along_x} if has_tangents else {}
    file = square_file({"TEXCOORD_1": turned} | tangents, material=0)
    file.material(texture={"extensions": {"KHR_texture_transform": transform}})
    surface = prepare_surface(file.write(tmp_path / "a.gltf"))
    np.testing.assert_allclose(surface.uvs[0], corner, atol=1e-6)
    np.testing.assert_allclose(surface.tangents, np.tile(tangent, (4, 1)), atol=1e-6)
    np.testing.assert_array_equal(surface.handedness, handedness)


def test_tangents_of_the_file_are_used_if_they_belong_to_the_base_colour(tmp_path):
    diagonal = np.tile(np.array([0.6, 0.8, 0, -1], "<f4"), (4, 1))
    surface = prepare_surface(square_file({"TANGENT": diagonal}).write(tmp_path / "a.gltf"))
    np.testing.assert_allclose(surface.tangents, diagonal[:, :3], atol=1e-6)
    np.testing.assert_array_equal(surface.handedness, -1.0)
    # Tangents belong to the normal map, which uses the first set of texture coordinates. The base colour uses the
    # second set here, so that the tangents must be ignored.
    file = square_file({"TANGENT": diagonal, "TEXCOORD_1": SQUARE_UVS}, material=0)
    file.material(texture={"texCoord": 1})
    np.testing.assert_allclose(prepare_surface(file.write(tmp_path / "b.gltf")).tangents[:, 0], 1.0, atol=1e-6)
    # By the rules of the glTF format, tangents are ignored if the file has no normals.
    file = GltfFile()
    file.primitive({"POSITION": SQUARE, "TEXCOORD_0": SQUARE_UVS, "TANGENT": diagonal})
    np.testing.assert_allclose(prepare_surface(file.write(tmp_path / "c.gltf")).tangents[:, 0], 1.0, atol=1e-6)
    # If a mesh has no texture coordinates, the tangents of the file must be used.
    file = GltfFile()
    file.primitive({"POSITION": SQUARE, "NORMAL": UP, "TANGENT": diagonal})
    np.testing.assert_allclose(prepare_surface(file.write(tmp_path / "d.gltf")).tangents, diagonal[:, :3], atol=1e-6)


@pytest.mark.parametrize("slope", [0.2, 1.0, 3.0])
def test_a_mesh_without_normals_is_flat(slope, tmp_path):
    roof = np.array([[0, 0, 0], [1, 0, slope], [1, 1, slope], [0, 1, 0], [2, 0, 0], [2, 1, 0]], "<f4")
    faces = np.array([0, 1, 2, 0, 2, 3, 1, 4, 5, 1, 5, 2], "<u2")
    file = GltfFile()
    file.primitive({"POSITION": roof, "TEXCOORD_0": roof[:, :2].copy()}, faces)
    surface = prepare_surface(file.write(tmp_path / "roof.gltf"))
    expected = np.repeat([[-slope, 0, 1], [slope, 0, 1]], 2, axis=0) / math.hypot(1.0, slope)
    np.testing.assert_allclose(surface.normals[surface.faces].transpose(1, 0, 2), [expected] * 3, atol=1e-6)
    # Vertices of the file are duplicated for each face. A tangent that is given for a vertex of the file must apply to
    # all duplicates of the vertex.
    surface = prepare_surface(tmp_path / "roof.gltf", tangents=np.tile([1.0, 0, 0], (6, 1)))
    assert np.all(surface.tangents[:, 0] > 0.0)


def test_colours_of_vertices_are_linear_and_multiply_the_material(tmp_path):
    shares = np.array([[1, 0, 0], [0, 0.5, 0], [0, 0, 1], [0.25, 0.25, 0.25]], "<f4")
    factor = {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.4, 1.0, 1.0]}}
    for name, colours, material, expected in [
        ("alone", shares, None, shares),
        ("with a material", shares, factor, shares * [0.5, 0.4, 1.0]),
        ("RGBA of 8 bits", np.round(np.c_[shares, np.ones(4)] * 255).astype("<u1"), None, shares),
        ("RGB of 16 bits", np.round(shares * 65535).astype("<u2"), None, shares),
    ]:
        file = square_file()
        primitive = file.tree["meshes"][0]["primitives"][0]
        primitive["attributes"]["COLOR_0"] = file.accessor(colours, normalized=colours.dtype.kind == "u")
        if material is not None:
            primitive["material"] = file.material(**material)
        surface = prepare_surface(file.write(tmp_path / "a.gltf"))
        np.testing.assert_allclose(surface.vertex_colours, expected, atol=3e-3, err_msg=name)


def test_base_colours_of_materials_are_read(tmp_path):
    glossy = {"diffuseFactor": [0.1, 0.2, 0.3, 1.0], "glossinessFactor": 0.75}
    cases = [
        ({"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 1.0, 1.0]}}, (0.5, 0.25, 1.0)),
        ({"extensions": {"KHR_materials_pbrSpecularGlossiness": glossy}}, (0.1, 0.2, 0.3)),
    ]
    for values, expected in cases:
        file = square_file(material=0)
        file.material(**values)
        path = file.write(tmp_path / "a.gltf")
        appearance = load(path)[0].appearance
        np.testing.assert_allclose(appearance.base_colour, (*expected, 1.0))
    assert (appearance.metallic, appearance.roughness) == (0.0, 0.25)
    file = square_file(material=0)
    file.material(
        texture={}, alphaMode="MASK", alphaCutoff=0.3, doubleSided=True, emissiveFactor=[1, 0.5, 0],
        pbrMetallicRoughness={"metallicFactor": 0.25, "baseColorFactor": [1, 0.5, 1, 0.5]},
    )  # fmt: skip
    file.tree["samplers"] = [{"wrapS": 33071, "wrapT": 33648}]
    file.tree["textures"][0]["sampler"] = 0
    path = file.write(tmp_path / "b.gltf")
    appearance = load(path)[0].appearance
    assert (appearance.alpha_mode, appearance.alpha_cutoff) == ("mask", 0.3)
    assert (appearance.metallic, appearance.roughness, appearance.emission) == (0.25, 1.0, (1.0, 0.5, 0.0))
    assert appearance.base_texture.wrap == ("clamp", "mirror")
    surface = prepare_surface(path, plain={"*": True})
    (texture,) = surface.textures
    np.testing.assert_allclose(
        texture.texels, [[[1, 0, 0, 0.5], [0, 0.5, 0, 0.5]], [[0, 0, 1, 0.5], [1, 0.5, 1, 0.5]]], atol=1e-6
    )
    assert texture.wrap == ("clamp", "mirror")
    # All texels have an alpha of 0.5, which is above the cut-off of 0.3, so that the surface is opaque everywhere.
    assert surface.is_opaque


def test_names_are_kept_and_made_unique(tmp_path):
    file = square_file(material=0)
    for number, name in enumerate(["lid", "lid", None, "lid"]):
        file.tree["meshes"].append({"primitives": []} | ({"name": name} if name else {}))
        file.primitive({"POSITION": SQUARE, "TEXCOORD_0": SQUARE_UVS}, mesh=number + 1, material=number)
    file.tree["nodes"] = [{"mesh": number, "translation": [0, 0, number]} for number in (0, 1, 2, 3, 4, 1)]
    file.tree["scenes"][0]["nodes"] = list(range(6))
    for name in ("gold", None, "gold", "gold"):
        file.material(**({"name": name} if name else {}))
    surface = prepare_surface(file.write(tmp_path / "a.gltf"))
    assert surface.geometry_names == ("mesh 0", "lid", "lid (2)", "mesh 3", "lid (3)")
    assert surface.geometries[::2].tolist() == [0, 1, 2, 3, 4, 1]
    assert surface.material_names == ("gold", "material 1", "gold (2)", "gold (3)")
    assert surface.materials[::2].tolist() == [0, 0, 1, 2, 3, 0]
    without = prepare_surface(square_file().write(tmp_path / "b.gltf"))
    assert (without.material_names, without.materials.tolist()) == ((), [-1, -1])


def one_warning(path):
    """Prepare a mesh that must cause one warning; return the texts of all warnings."""
    with pytest.warns(WarpdiffWarning) as caught:
        prepare_surface(path)
    return [str(warning.message) for warning in caught]


def test_parts_that_are_not_read_are_named_in_one_warning(tmp_path):
    file = square_file(material=0, targets=[{}])
    file.material(texture={})
    file.tree["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]
    file.primitive({"POSITION": SQUARE}, mode=0)
    file.tree["meshes"][0]["name"] = "body"
    file.tree["nodes"][0] |= {"name": "man", "skin": 0}
    (message,) = one_warning(file.write(tmp_path / "a.gltf"))
    assert "a.gltf' has parts that are not read: " in message
    for words in (
        "morph targets of mesh 'body' apart",
        "points or lines of",
        "skin of node 'man'",
        "KHR_texture_basisu",
    ):
        assert words in message


def test_features_that_are_not_rendered_are_named_in_one_warning(tmp_path):
    file = square_file({"COLOR_0": np.ones((4, 3), "<f4")}, material=0)
    file.primitive({"POSITION": SQUARE + UP, "TEXCOORD_0": SQUARE_UVS}, material=1)
    file.material(texture={}, name="paint", normalTexture={"index": 0}, occlusionTexture={"index": 0})
    file.material(name="glass", extensions={"KHR_materials_transmission": {}, "ACME_gizmo": {}})
    (message,) = one_warning(file.write(tmp_path / "a.gltf"))
    assert (
        "normal map, occlusion, vertex colours on a texture of 'paint'; transmission, ACME_gizmo of 'glass'" in message
    )


def test_morph_targets_have_their_default_weights(tmp_path):
    lift = np.tile(np.array([0, 0, 2], "<f4"), (4, 1))
    for place in ("mesh", "node"):
        file = square_file()
        file.tree["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": file.accessor(lift)}]
        file.tree["meshes"][0]["weights"] = [0.5 if place == "mesh" else 9.0]
        file.tree["nodes"][0] |= {"weights": [0.5]} if place == "node" else {}
        with pytest.warns(WarpdiffWarning, match="apart from their default weights"):
            (part,) = load(file.write(tmp_path / "a.gltf"))
        np.testing.assert_allclose(part.vertices[:, 2], 1.0)


def test_files_in_the_folder_are_opened_by_their_decoded_names(tmp_path):
    file = square_file(material=0)
    file.material(texture={})
    file.tree["images"] = [{"uri": "a%20%E2%9D%A4/pain%74.png"}]
    file.tree["buffers"] = [{"byteLength": len(file.blob), "uri": "my%20data.bin"}]
    path = file.write(tmp_path / "a.gltf")
    with pytest.raises(
        ValueError, match=r"buffers\[0\] refers to 'my%20data.bin', .* there is no file '.*/my data.bin'"
    ):
        prepare_surface(path)
    (tmp_path / "my data.bin").write_bytes(file.blob)
    (message,) = one_warning(path)
    assert "refers to 'a%20%E2%9D%A4/pain%74.png', which is ignored: there is no file" in message
    (tmp_path / "a ❤").mkdir()
    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "a ❤" / "paint.png")
    np.testing.assert_array_equal(prepare_surface(path).textures[0].texels[0, 0], [1, 0, 0, 1])


@pytest.mark.parametrize("code", ["utf-8-sig", "utf-16", "utf-16-le", "latin-1", "cp1252"])
def test_a_text_in_another_encoding_is_read(code, tmp_path):
    file = square_file()
    file.tree["meshes"][0]["name"] = "Jörg"
    path = file.write(tmp_path / "a.gltf")
    path.write_bytes(json.dumps(json.loads(path.read_text()), ensure_ascii=False).encode(code))
    assert prepare_surface(path).geometry_names == ("Jörg",)


def draco_file():
    """Return a glTF file of a square with positions and texture coordinates that are compressed by Draco."""
    file = square_file()
    (primitive,) = file.tree["meshes"][0]["primitives"]
    for index in (primitive["attributes"]["POSITION"], primitive["attributes"]["TEXCOORD_0"], primitive["indices"]):
        del file.tree["accessors"][index]["bufferView"]
    compressed = {"bufferView": file.view(base64.b64decode(DRACO)), "attributes": {"POSITION": 1, "TEXCOORD_0": 0}}
    primitive["extensions"] = {"KHR_draco_mesh_compression": compressed}
    file.tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return file


def test_draco_compression_requires_an_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    message = r"extension KHR_draco_mesh_compression, which requires .* pip install 'warpdiff\[gltf\]'"
    with pytest.raises(ValueError, match=message):
        prepare_surface(draco_file().write(tmp_path / "a.gltf"))


def test_a_square_with_draco_compression_is_read(tmp_path):
    pytest.importorskip("DracoPy")
    plain = prepare_surface(square_file().write(tmp_path / "plain.gltf"))
    read = prepare_surface(draco_file().write(tmp_path / "a.gltf"))
    np.testing.assert_allclose(corners(read, 3), corners(plain, 3), atol=1e-3)
    file = draco_file()
    file.blob = file.blob[:-40] + b"\xff" * 40
    with pytest.raises(ValueError, match="must be sound Draco data"):
        prepare_surface(file.write(tmp_path / "b.gltf"))


def with_value(place, value):
    """Return a function that sets the value at a path in the JSON of a glTF file."""

    def change(tree):
        *parents, last = place
        for name in parents:
            tree = tree[name]
        tree[last] = value

    return change


def with_values(*values):
    """Return a function that sets several values in the JSON of a glTF file, each given with its path."""

    def change(tree):
        for place, value in values:
            with_value(place, value)(tree)

    return change


PRIMITIVE = ("meshes", 0, "primitives", 0)
REFUSED = {
    "cycle": (with_value(("nodes", 0, "children"), [0]), r"nodes\[0\] must have one parent"),
    "two parents": (
        with_values(
            (("nodes",), [{"children": [2]}, {"children": [2]}, {"mesh": 0}]), (("scenes", 0, "nodes"), [0, 1])
        ),
        r"nodes\[2\] must have one parent, got two",
    ),
    "listed twice": (with_value(("scenes", 0, "nodes"), [0, 0]), r"nodes\[0\] must have one parent"),
    "buffer view too long": (with_value(("bufferViews", 0, "byteLength"), 10**6), "ends at byte 1000000, but buffers"),
    "stride too large": (with_value(("bufferViews", 0, "byteStride"), 400), "ends at byte 1212 of bufferViews"),
    "count too large": (with_value(("accessors", 0, "count"), 10**12), "must end within its 48 bytes"),
    "count without data": (with_value(("accessors", 0), {"componentType": 5126, "count": 10**12, "type": "VEC3"}),
                           "count must fit into memory, got 1000000000000"),
    "count differs": (with_value(("accessors", 1, "count"), 3), "NORMAL must have 4 vectors, as POSITION has"),
    "index beyond": (with_value((*PRIMITIVE, "attributes", "POSITION"), 99), "must be an integer from 0 to 3, got 99"),
    "no number": (with_value(("nodes", 0, "mesh"), "0"), r"nodes\[0\].mesh must be an integer, got '0'"),
    "not finite": (with_value(("nodes", 0, "translation"), [math.nan, 0, 0]), "must be a finite number, got nan"),
    "huge": (with_value(("nodes", 0, "scale"), [1e90, 1e90, 1e90]), "radius of 1e-15 to 1e.15"),
    "component type": (with_value(("accessors", 0, "componentType"), 5124), "must be one of 5120, "),
    "width": (with_value(("accessors", 0, "type"), "VEC2"), "type must be VEC3, got 'VEC2'"),
    "no list": (with_value(("nodes",), {}), "nodes must be a list"),
    "no object": (with_value(("nodes", 0), 5), r"nodes\[0\] must be an object, got 5"),
    "version": (with_value(("asset", "version"), "1.0"), "must be glTF of version 2.0, got version '1.0'"),
    "no asset": (lambda tree: tree.pop("asset"), "must have a value 'asset'"),
    "extension": (with_value(("extensionsRequired",), ["ACME_gizmo"]), "requires the glTF extension ACME_gizmo"),
    "meshopt": (with_value(("extensionsRequired",), ["EXT_meshopt_compression"]), "EXT_meshopt_compression"),
    "mode": (with_value((*PRIMITIVE, "mode"), 7), "mode must be an integer from 0 to 6, got 7"),
    "outside": (with_value(("buffers",), [{"byteLength": 4, "uri": "../a.bin"}]), "it lies outside the mesh's folder"),
    "address": (with_value(("buffers",), [{"byteLength": 4, "uri": "http://a.b/c"}]), "it lies outside the mesh"),
    "data URI": (with_value(("buffers",), [{"byteLength": 4, "uri": "data:;base64,a"}]), "data URI is damaged"),
    "alpha mode": (
        with_values((("materials",), [{"alphaMode": "X"}]), ((*PRIMITIVE, "material"), 0)),
        r"materials\[0\]\.alphaMode must be OPAQUE, MASK or BLEND, got 'X'",
    ),
    "no triangles": (with_value(("scenes", 0, "nodes"), []), "must have triangles"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), REFUSED.values(), ids=REFUSED)
def test_wrong_values_are_refused_by_their_place(change, message, tmp_path):
    file = square_file()
    change(file.tree)
    path = file.write(tmp_path / "a.gltf")
    with pytest.raises(ValueError, match=message) as refused:
        prepare_surface(path)
    assert str(refused.value).startswith("mesh ")
    assert str(path) in str(refused.value)


def test_texts_that_are_no_json_are_refused(tmp_path):
    path = tmp_path / "a.gltf"
    for text in ("", "{", "[]", "5", "null", "[" * 100_000, '{"a": 1' + "0" * 5000 + "}", "\0\0\0\0"):
        path.write_text(text)
        with pytest.raises(ValueError, match="must be a sound glTF file"):
            prepare_surface(path)


@pytest.mark.usefixtures("unreadable_files")
def test_errors_of_the_system_name_the_file(tmp_path):
    path = tmp_path / "square.glb"
    path.touch()
    with pytest.raises(OSError, match=r"mesh: '.*square\.glb' cannot be read: Input/output error"):
        prepare_surface(path)
