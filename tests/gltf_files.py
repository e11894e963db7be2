"""A textured triangle as a glTF file, with configurable locations of its buffer and image."""

import base64
import json
import struct

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
