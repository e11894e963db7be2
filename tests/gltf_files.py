"""glTF files for tests: a textured triangle with configurable locations of its buffer and image, and other scenes."""

import base64
import io
import json
import struct

import numpy as np
from PIL import Image

# Binary glTF buffer: three vertex positions, three texture coordinates and three vertex indices.
BUFFER = struct.pack("<15f3H", 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 0, 1, 2)
DATA_URI = "data:application/octet-stream;base64," + base64.b64encode(BUFFER).decode()


def gltf(*, buffer=DATA_URI, image="paint.png"):
    """Return the glTF JSON of a textured triangle."""
    views = [(0, 36), (36, 24), (60, 6)]
    accessors = [(0, 5126, "VEC3"), (1, 5126, "VEC2"), (2, 5123, "SCALAR")]
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
            "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
            "textures": [{"source": 0}],
            "images": [{"uri": image}],
            "buffers": [{"uri": buffer, "byteLength": len(BUFFER)}],
            "bufferViews": [{"buffer": 0, "byteOffset": begin, "byteLength": size} for begin, size in views],
            "accessors": [
                {"bufferView": view, "componentType": kind, "count": 3, "type": shape}
                for view, kind, shape in accessors
            ],
        }
    )


DTYPES = {"<i1": 5120, "|i1": 5120, "|u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
# Texture coordinates of the square, v downwards, so that the image is upright as viewed from +z.
SQUARE_UVS = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], "<f4")
UP = np.tile(np.array([0, 0, 1], "<f4"), (4, 1))
TRIANGLES = np.array([0, 1, 2, 0, 2, 3], "<u2")


def image_uri():
    """Return a data URI of an image with a red, a green, a blue and a white quarter, row by row."""
    pixels = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "png")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


class GltfFile:
    """glTF file in memory: ``tree`` is its JSON, ``blob`` the content of its buffer."""

    def __init__(self):
        self.blob = b""
        self.tree = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": []}], "accessors": [], "bufferViews": [],
        }  # fmt: skip

    def view(self, data, stride=None):
        """Add a buffer view and return its index."""
        self.blob += b"\0" * (-len(self.blob) % 4)
        view = {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)}
        self.tree["bufferViews"].append(view | ({"byteStride": stride} if stride else {}))
        self.blob += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, array, *, view=None, offset=0, **values):
        """Add an accessor with the data of an array, in a view of its own unless ``view`` is given."""
        array = np.asarray(array)
        self.tree["accessors"].append(
            {"bufferView": self.view(array.tobytes()) if view is None else view, "byteOffset": offset,
             "componentType": DTYPES[array.dtype.str], "count": len(array),
             "type": SHAPES[1 if array.ndim == 1 else array.shape[1]]} | values
        )  # fmt: skip
        return len(self.tree["accessors"]) - 1

    def primitive(self, attributes, indices=TRIANGLES, *, mesh=0, **values):
        """Add a primitive. Attributes are arrays, or indices of accessors."""
        numbers = {
            name: value if isinstance(value, int) else self.accessor(value) for name, value in attributes.items()
        }
        primitive = {"attributes": numbers} | values
        if indices is not None:
            primitive["indices"] = self.accessor(indices)
        self.tree["meshes"][mesh]["primitives"].append(primitive)
        return primitive

    def material(self, *, texture=None, **values):
        """Add a material, with a base-colour texture of :func:`image_uri` if ``texture`` is a dictionary."""
        if texture is not None:
            self.tree["images"], self.tree["textures"] = [{"uri": image_uri()}], [{"source": 0}]
            values.setdefault("pbrMetallicRoughness", {})["baseColorTexture"] = {"index": 0} | texture
        self.tree.setdefault("materials", []).append(values)
        return len(self.tree["materials"]) - 1

    def write(self, path):
        """Write a .gltf file with its buffer as a data URI, or a .glb file, and return its path."""
        buffer = {"byteLength": len(self.blob)}
        if path.suffix == ".glb":
            text = json.dumps(self.tree | {"buffers": [buffer]}).encode()
            text += b" " * (-len(text) % 4)
            blob = self.blob + b"\0" * (-len(self.blob) % 4)
            chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + blob
            path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
        else:
            buffer["uri"] = "data:application/octet-stream;base64," + base64.b64encode(self.blob).decode()
            path.write_text(json.dumps({"buffers": [buffer]} | self.tree), encoding="utf-8")
        return path


def square_file(attributes=None, indices=TRIANGLES, **values):
    """Return a glTF file of a square of two triangles with normals and texture coordinates."""
    file = GltfFile()
    file.primitive({"POSITION": SQUARE, "NORMAL": UP, "TEXCOORD_0": SQUARE_UVS} | (attributes or {}), indices, **values)
    return file
