"""Sample bodies that carry a tangent field: a tube, a disc, a snake."""

from warpdiff.scene.meshes import disc, snake, tube

__all__ = ["disc", "snake", "tube"]
