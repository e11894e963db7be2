"""Reader of glTF 2.0 files: triangles with all their attributes, the nodes that place them, and materials."""

from warpdiff.scene.gltf.gltf_reader import load

__all__ = ["load"]
